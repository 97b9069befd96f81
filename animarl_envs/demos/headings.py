"""Recorded headings of each individual, where demonstrations hold them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.episode import HEADING


def recorded_headings(demos: Demonstrations) -> NDArray[np.float64] | None:
    """Headings of all ``(frames, individuals)``, counter-clockwise from x in the arena [rad].

    ``None`` where the signal ``heading`` is absent or has not a column for each individual.
    """
    heading = demos.signals.get(HEADING)
    if heading is None or heading[:1].size != demos.num_individuals:
        return None
    return heading.astype(np.float64).reshape(len(heading), -1)
