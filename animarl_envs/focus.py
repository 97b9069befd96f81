"""What each recorded individual is heading for: the x axis of its egocentric frame.

The focus of a pursuer is the target; the focus of the target is its nearest pursuer, chosen anew at
each frame (ties: the lower index). Where one pursues several, the focus of each target is the
pursuer, that of the pursuer its nearest target. A searcher must not be told where the source is:
its focus is the fixed upwind direction. Individuals of a group without a target face their nearest
companion.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

UPWIND = (-1.0, 0.0)
"""Where the wind comes from, arena frame: the source is the origin, the moth starts at +x."""

FALLBACK = (1.0, 0.0)
"""Focus direction at zero distance, and of an individual that is alone."""


def focus_directions(positions: NDArray[np.floating], roles: Sequence[str]) -> NDArray[np.float64]:
    """Unit vectors towards the focus of each individual.

    Parameters
    ----------
    positions
        ``(..., individuals, 2)``, arena frame [arena unit].
    roles
        ``"pursuer"``, ``"target"`` or ``"searcher"`` for each individual; the target comes last,
        or a pursuer of several targets (:func:`lone_pursuer`).

    Returns
    -------
    ``(..., individuals, 2)``, arena frame; ``FALLBACK`` where the distance is zero.
    """
    points: NDArray[np.float64] = np.asarray(positions, dtype=np.float64)
    out = np.empty_like(points)
    for i, candidates in enumerate(foci(roles)):
        if not candidates:
            out[..., i, :] = UPWIND if candidates is None else FALLBACK
            continue
        offset = points[..., candidates, :] - points[..., i, None, :]
        distance = np.hypot(offset[..., 0], offset[..., 1])
        nearest = np.argmin(distance, axis=-1)[..., None]  # the first of equals
        apart = np.take_along_axis(distance, nearest, axis=-1)
        towards = np.take_along_axis(offset, nearest[..., None], axis=-2)[..., 0, :]
        out[..., i, :] = np.where(
            apart > 0, towards / np.where(apart > 0, apart, 1.0), np.array(FALLBACK)
        )
    return out


def foci(roles: Sequence[str]) -> list[list[int] | None]:
    """Return, for each individual, those whose nearest is its focus; ``None`` for a searcher."""
    last = len(roles) - 1
    one, many = [last], list(range(last))
    if "target" in roles:
        return [many if i == last else one for i in range(len(roles))]
    if "searcher" in roles:
        return [None for _ in roles]
    return [[j for j in range(len(roles)) if j != i] for i in range(len(roles))]


def first_pursuer(roles: Sequence[str]) -> int:
    """The first individual that is no target."""
    return next(i for i, role in enumerate(roles) if role != "target")


def lone_pursuer(roles: Sequence[str]) -> bool:
    """Whether the last individual pursues all others."""
    *many, last = roles
    return last == "pursuer" and set(many) == {"target"}


def distances_to_target(
    positions: NDArray[np.float64], roles: Sequence[str]
) -> NDArray[np.float64]:
    """``(frames, pursuers)`` to the target, or of a searcher to the source at the origin.

    Of a lone pursuer to each target: ``(frames, targets)``.
    """
    if "target" in roles:
        return np.asarray(np.linalg.norm(positions[:, :-1] - positions[:, -1:], axis=2))
    if "searcher" in roles:
        return np.asarray(np.linalg.norm(positions, axis=2))
    return np.full((len(positions), 1), np.inf)
