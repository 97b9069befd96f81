"""One recorded episode, the splits it may belong to and the codes of how it ended."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

SPLITS = ("train", "val", "test")

FILLED = "filled"
"""Signal ``(frames, individuals)``: the position was not tracked but filled in."""

HEADING = "heading"
"""Signal ``(frames, individuals)``: where the bodies point, counter-clockwise from x in the arena
frame [rad]; of a lone individual ``(frames,)`` as well."""

INTERVAL = "interval"
"""Signal ``(frames,)``: the time that led to a frame [s], where a last step may be shorter."""

# Outcome codes, one per episode. k > 0: contact by individual k - 1 (of several targets: with it).
TIME_OUT = 0
TARGET_OUT = -1  # the target, or one of them, left the boundary
PURSUER_OUT = -2  # a pursuer left the boundary
UNFINISHED = -3  # the recording was cut for another reason


@dataclass(frozen=True)
class Episode:
    """One recorded episode; arrays are read-only views into the container.

    ``positions`` is ``(frames, individuals, 2)`` in the arena frame [arena unit], ``velocities``
    the same in arena unit / s with the velocity belonging to the position it led to, ``signals``
    the per-frame channels by name.
    """

    index: int
    positions: NDArray[np.float64]
    velocities: NDArray[np.float64]
    signals: Mapping[str, NDArray[Any]]
    condition: int
    outcome: int
    split: str
    recording: str
    dt: float

    @property
    def num_steps(self) -> int:
        """Decision steps: one less than the frames."""
        return len(self.positions) - 1

    @property
    def duration(self) -> float:
        """Duration [s]."""
        return self.num_steps * self.dt
