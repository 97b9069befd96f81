"""What a verdict asks of each episode: how it ended, how long, how far, how fast, how straight."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from animarl_algos.evaluation.metrics import path_lengths
from animarl_algos.evaluation.rollouts import Rollouts
from animarl_envs.arena import Arena
from animarl_envs.demos.episode import PURSUER_OUT, TARGET_OUT
from animarl_envs.demos.summary import RESTING_SHARE
from animarl_envs.demos.units import RECORDED_SCALE, Unit

Floats = NDArray[np.float64]

SLOW_SHARE = 0.25  # of the recorded median moving speed: a step below it is a slow one
REACHED, NEITHER = 1, 0  # endings, beside TARGET_OUT and PURSUER_OUT


@dataclass(frozen=True)
class Measure:
    """One question, and its answers in words.

    ``unit`` may hold ``{length}``. ``spread``: whole distributions are compared, not means only.
    ``noun`` names the values where they are too much alike or too varied.
    """

    key: str
    label: str
    unit: str
    too_much: str
    too_little: str
    noun: str
    spread: bool = False
    is_outcome: bool = False

    @property
    def is_share(self) -> bool:
        return self.unit == "share"


MEASURES = (
    Measure("reached", "Target reached", "share", "reaches the target too often",
            "reaches the target too rarely", "", is_outcome=True),
    Measure("target_out", "Ended by the target leaving", "share", "the target leaves too often",
            "the target leaves too rarely", "", is_outcome=True),
    Measure("pursuer_out", "Ended by a pursuer leaving", "share", "a pursuer leaves too often",
            "a pursuer leaves too rarely", "", is_outcome=True),
    Measure("leaving", "Somebody outside the arena", "share", "leaves the arena",
            "leaves the arena too rarely", "", is_outcome=True),
    Measure("duration", "Duration", "s", "episodes too long", "episodes too short", "durations",
            spread=True),
    Measure("path_length", "Path length", "{length}", "paths too long", "paths too short",
            "path lengths", spread=True),
    Measure("mean_speed", "Mean speed", "{length}/s", "too fast", "too slow", "mean speeds",
            spread=True),
    Measure("median_speed", "Median speed", "{length}/s", "too fast", "too slow", "median speeds"),
    Measure("slow_steps", "Slow steps", "share", "stands still too often",
            "stands still too rarely", "shares of slow steps"),
    Measure("turning", "Turning", "rad/s", "turns too much", "turns too little", "turning rates"),
)  # fmt: skip
"""In the order of the table. Speeds and turning are means over all individuals; path length is that
of the pursuers, or of the searcher."""


@dataclass(frozen=True, eq=False)
class SlowSpeeds:
    """Below which speed each individual counts as slow, ``(individuals,)`` [arena unit / s]."""

    limit: Floats

    @classmethod
    def of(cls, recorded: Rollouts) -> SlowSpeeds:
        """A quarter of the median speed of those recorded steps in which it moves at all.

        It moves where it is faster than 5 % of its 99th percentile.
        """
        speeds = recorded.speeds()
        limit = np.zeros(speeds.shape[1])
        for k, speed in enumerate(speeds.T):
            moving = speed[speed > RESTING_SHARE * np.quantile(speed, 0.99)]
            limit[k] = SLOW_SHARE * np.median(moving) if moving.size else 0.0
        return cls(limit)


def ending(rollouts: Rollouts) -> NDArray[np.int64]:
    """Reached, target out, pursuer out, or neither (time-out, or the recording was cut)."""
    outcome = rollouts.outcome
    known = np.where(np.isin(outcome, (TARGET_OUT, PURSUER_OUT)), outcome, NEITHER)
    return np.where(outcome > 0, REACHED, known).astype(np.int64)


def episode_measures(
    rollouts: Rollouts,
    arena: Arena,
    slow: SlowSpeeds,
    unit: Unit = RECORDED_SCALE,
    *,
    rounding: float = 0.0,
) -> dict[str, Floats]:
    """Every measure of every episode, ``(episodes,)`` each, under the keys of :data:`MEASURES`.

    ``slow_steps`` and the speeds are of single steps, averaged (or their median taken) over the
    steps of an episode and then over individuals. ``turning`` is the angle between successive
    steps summed over an episode and divided by its duration [rad/s]. Nobody is outside the
    ``arena`` by no more than ``rounding`` [arena unit]: one at a wall may have been rounded there.
    """
    ends, movers = ending(rollouts), rollouts.movers
    inside = arena.contains(rollouts.positions, margin=rounding).all(axis=1)
    outside = np.logical_or.reduceat(~inside, rollouts.offsets[:-1])
    mean, median, still, turned = np.zeros((4, len(rollouts)))
    for i in range(len(rollouts)):
        moved = np.diff(rollouts.path(i), axis=0)
        if len(moved) == 0:
            continue
        speed = np.linalg.norm(moved, axis=-1) / rollouts.dt
        mean[i], median[i] = speed.mean(), np.median(speed, axis=0).mean()
        still[i] = (speed < slow.limit).mean()
        cross = moved[:-1, :, 0] * moved[1:, :, 1] - moved[:-1, :, 1] * moved[1:, :, 0]
        angle = np.abs(np.arctan2(cross, (moved[:-1] * moved[1:]).sum(axis=-1)))
        turned[i] = angle.sum(axis=0).mean() / (len(moved) * rollouts.dt)
    scale = unit.per_arena_unit
    return {
        "reached": (ends == REACHED).astype(float),
        "target_out": (ends == TARGET_OUT).astype(float),
        "pursuer_out": (ends == PURSUER_OUT).astype(float),
        "leaving": (outside | np.isin(ends, (TARGET_OUT, PURSUER_OUT))).astype(float),
        "duration": (rollouts.lengths - 1) * rollouts.dt,
        "path_length": scale * path_lengths(rollouts)[:, movers].mean(axis=1),
        "mean_speed": scale * mean,
        "median_speed": scale * median,
        "slow_steps": still,
        "turning": turned,
    }
