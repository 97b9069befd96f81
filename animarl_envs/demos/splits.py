"""Dealing episodes to train, validation and test without leakage."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from animarl_envs.demos.demonstrations import SPLITS


def assign_splits(
    groups: Sequence[str] | NDArray[np.str_],
    seed: int,
    fractions: tuple[float, float, float] = (0.8, 0.1, 0.1),
) -> NDArray[np.str_]:
    """Deal whole groups (episodes or recordings) to train, val and test, repeatably.

    Groups are shuffled and dealt until each split has its share of episodes; none straddles
    two splits. With three groups or more no split stays empty.
    """
    groups = np.asarray(groups)
    names = np.unique(groups)
    np.random.default_rng(seed).shuffle(names)
    sizes = np.array([(groups == name).sum() for name in names])
    centre = (np.cumsum(sizes) - sizes / 2) / sizes.sum()
    edges = np.cumsum(fractions)
    part = np.minimum(np.searchsorted(edges, centre, side="right"), 2)
    if len(names) >= 3:
        for missing in range(3):
            if fractions[missing] > 0 and not (part == missing).any():
                donor = np.bincount(part, minlength=3).argmax()
                part[np.flatnonzero(part == donor)[-1]] = missing
    lookup = dict(zip(names.tolist(), part.tolist(), strict=True))
    return np.array([SPLITS[lookup[g]] for g in groups.tolist()])
