"""The mirror image of a world, for learners that may take left for right."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from animarl_envs.locomotion import ACTION_VECTORS

if TYPE_CHECKING:
    from animarl_envs.worlds.base import ObservationComponent


@dataclass(frozen=True)
class Mirror:
    """Observations and actions of a world, seen in a mirror along the x axis of the arena frame.

    Attributes
    ----------
    order
        ``(n,)``: the mirrored observation has component ``order[c]`` in place ``c``, ...
    sign
        ``(n,)``: ... times ``sign[c]``, 1 or -1.
    actions
        ``(actions,)``: the mirrored action of each.
    """

    order: NDArray[np.int64]
    sign: NDArray[np.float32]
    actions: NDArray[np.int64]

    def observation(self, seen: NDArray[np.float32]) -> NDArray[np.float32]:
        """Mirrored observations ``(..., n)``."""
        return seen[..., self.order] * self.sign


def mirror_of(
    components: Sequence[ObservationComponent],
    vectors: NDArray[np.float64] = ACTION_VECTORS,
) -> Mirror:
    """The mirror of observations of these components and actions of these vectors.

    ``vectors`` ``(actions, 2)`` are the accelerations in an egocentric frame; the mirror image of
    each must be among them.
    """
    place = {component.name: c for c, component in enumerate(components)}
    order = [place[component.mirror or component.name] for component in components]
    apart = np.linalg.norm(vectors[:, None] * [1.0, -1.0] - vectors[None], axis=2)
    return Mirror(
        np.array(order, dtype=np.int64),
        np.array([component.sign for component in components], dtype=np.float32),
        np.argmin(apart, axis=1),
    )
