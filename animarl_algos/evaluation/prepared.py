"""Recordings and rollouts made comparable: same condition, same smoothing, same end of the film."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from animarl_algos.evaluation.metrics import Episodes, judged_metrics, slow_speeds
from animarl_algos.evaluation.rollouts import NO_CUE, Rollouts
from animarl_algos.evaluation.windows import smoothed
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.episode import UNFINISHED
from animarl_envs.demos.units import Unit, unit_of

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Prepared:
    """Recordings as rollouts, with what is worked out once for all comparisons with them."""

    demos: Demonstrations
    recorded: Rollouts
    slow: Floats
    unit: Unit
    smoothing: int
    rounding: float

    @classmethod
    def of(cls, demos: Demonstrations, smoothing: int) -> Prepared:
        """Smooth the recordings, and work out who is slow in them."""
        recorded = _filtered(Rollouts.from_demonstrations(demos), smoothing)
        grid = demos.resolution()
        rounding = 0.0 if grid is None else grid.reach
        return cls(demos, recorded, slow_speeds(recorded), unit_of(demos), smoothing, rounding)

    def filtered(self, rollouts: Rollouts) -> Rollouts:
        """Smooth rollouts as the recordings were."""
        return _filtered(rollouts, self.smoothing)

    def measures(self, rollouts: Rollouts) -> dict[str, Floats]:
        """Every judged metric of every episode, lengths in the recordings' unit."""
        episodes = Episodes(rollouts, self.demos, self.slow, self.rounding)
        scale = self.unit.per_arena_unit
        return {
            metric.key: (scale if metric.is_length else 1.0) * metric.measure(episodes)
            for metric in judged_metrics()
        }


def _filtered(rollouts: Rollouts, smoothing: int) -> Rollouts:
    moved = smoothed(rollouts.positions, rollouts.lengths, smoothing)
    return replace(rollouts, positions=moved)


def factual(rollouts: Rollouts, recorded: Demonstrations) -> Rollouts:
    """Those in the world's recorded condition, told it or nothing."""
    same = rollouts.condition == recorded.condition[rollouts.demo]
    told = (rollouts.cue == NO_CUE) | (rollouts.cue == rollouts.condition)
    return rollouts.select(same & told)


def censored(rollouts: Rollouts, recorded: Demonstrations | Rollouts) -> Rollouts:
    """Stop rollouts where their recording merely stops, as nothing is known of what came after.

    A rollout from the start of a recording that was cut (outcome ``UNFINISHED``) ends no later than
    that recording, and is then cut as well. What ended before by itself stays as it is.
    """
    cut = recorded.outcome[rollouts.demo] == UNFINISHED
    limit = np.asarray(recorded.lengths)[rollouts.demo]
    long = cut & (rollouts.lengths > limit)
    stopped = long | (cut & (rollouts.lengths == limit) & (rollouts.outcome == 0))
    if not stopped.any():
        return rollouts
    lengths = np.where(long, limit, rollouts.lengths)
    frame = np.arange(len(rollouts.positions)) - np.repeat(rollouts.offsets[:-1], rollouts.lengths)
    kept = frame < np.repeat(lengths, rollouts.lengths)
    return replace(
        rollouts,
        positions=rollouts.positions[kept],
        lengths=lengths,
        outcome=np.where(stopped, UNFINISHED, rollouts.outcome),
    )
