"""Recordings and rollouts made comparable: the same condition, smoothing and units."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from animarl_algos.evaluation.motion import SlowSpeeds, episode_measures
from animarl_algos.evaluation.rollouts import NO_CUE, Rollouts
from animarl_algos.evaluation.windows import smoothed
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.units import Unit, unit_of

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Prepared:
    """Recordings as rollouts, with what is worked out once for all comparisons with them."""

    demos: Demonstrations
    recorded: Rollouts
    slow: SlowSpeeds
    unit: Unit
    smoothing: int
    rounding: float

    @classmethod
    def of(cls, demos: Demonstrations, smoothing: int) -> Prepared:
        recorded = _filtered(Rollouts.from_demonstrations(demos), smoothing)
        grid = demos.resolution()
        rounding = 0.0 if grid is None else grid.reach
        return cls(demos, recorded, SlowSpeeds.of(recorded), unit_of(demos), smoothing, rounding)

    def filtered(self, rollouts: Rollouts) -> Rollouts:
        return _filtered(rollouts, self.smoothing)

    def measures(self, rollouts: Rollouts) -> dict[str, Floats]:
        return episode_measures(
            rollouts, self.demos.arena, self.slow, self.unit, rounding=self.rounding
        )


def _filtered(rollouts: Rollouts, smoothing: int) -> Rollouts:
    moved = smoothed(rollouts.positions, rollouts.lengths, smoothing)
    return replace(rollouts, positions=moved)


def factual(rollouts: Rollouts, recorded: Demonstrations) -> Rollouts:
    """Those in the world's recorded condition, told it or nothing."""
    same = rollouts.condition == recorded.condition[rollouts.demo]
    told = (rollouts.cue == NO_CUE) | (rollouts.cue == rollouts.condition)
    return rollouts.select(same & told)
