"""Recordings and rollouts made comparable: same condition, same smoothing, same end of the film.

A recording that merely ends says that the animals went on for at least as long. Rollouts from its
start stop there too, and durations are compared as survival: by the log-rank scores of Mantel
(1966) and Peto and Peto (1972), and told as the mean time up to the longest one that both sides
know (the area under the survival curve).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import ArrayLike

from animarl_algos.evaluation.metrics import MetricInputs, judged_metrics, slow_speeds
from animarl_algos.evaluation.order_in_time import (
    EpisodeMeasures,
    lags_for,
    median_steps,
    order_measures,
)
from animarl_algos.evaluation.rollouts import NO_CUE, Rollouts
from animarl_algos.evaluation.statistics import Floats
from animarl_algos.evaluation.windows import resting_step, smoothed
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.episode import TIME_OUT, UNFINISHED
from animarl_envs.demos.summary import Unit, unit_of


@dataclass(frozen=True, eq=False)
class Prepared:
    """Recordings smoothed, with what is worked out once for all comparisons with them.

    ``smoothing`` are the frames of the moving average that both sides go through, 1 for none.
    """

    demos: Demonstrations
    smoothing: int = 1
    _orders: WeakKeyDictionary[Rollouts, EpisodeMeasures] = field(
        default_factory=WeakKeyDictionary, init=False, repr=False
    )

    @cached_property
    def recorded(self) -> Rollouts:
        return self.filtered(Rollouts.from_demonstrations(self.demos))

    @cached_property
    def rest(self) -> Floats:
        """``(individuals,)`` steps up to this length are at rest [arena unit]."""
        return resting_step(self.recorded)

    @cached_property
    def lags(self) -> tuple[int, ...]:
        """At which order in time is looked at [steps]."""
        return lags_for(median_steps(self.recorded), self.recorded.dt)

    @cached_property
    def slow(self) -> Floats:
        return slow_speeds(self.recorded)

    @property
    def unit(self) -> Unit:
        return unit_of(self.demos)

    def filtered(self, rollouts: Rollouts) -> Rollouts:
        """Smooth rollouts as the recordings were."""
        moved = smoothed(rollouts.positions, rollouts.lengths, self.smoothing)
        return replace(rollouts, positions=moved)

    def counted(self, rollouts: Rollouts) -> Rollouts:
        """Rollouts in the recorded condition, cut where their recording was, and smoothed."""
        return self.filtered(censored(factual(rollouts, self.demos), self.demos))

    def measures(self, rollouts: Rollouts) -> dict[str, Floats]:
        """Every judged metric of every episode, lengths in the recordings' unit."""
        grid, scale = self.demos.resolution(), self.unit.per_arena_unit
        reach = 0.0 if grid is None else grid.reach
        order = partial(self.order, rollouts)
        episodes = MetricInputs(rollouts, self.demos, self.slow, reach, order)
        return {
            metric.key: (scale if metric.is_length else 1.0) * metric.measure(episodes)
            for metric in judged_metrics(self.demos)
        }

    def order(self, rollouts: Rollouts) -> EpisodeMeasures:
        """Order in time, reactions and places of every episode."""
        if rollouts not in self._orders:
            measured = order_measures(rollouts, self.lags, self.rest, self.demos.arena)
            self._orders[rollouts] = measured
        return self._orders[rollouts]


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
    return replace(
        rollouts,
        positions=rollouts.positions[frame < np.repeat(lengths, rollouts.lengths)],
        lengths=lengths,
        outcome=np.where(stopped, UNFINISHED, rollouts.outcome),
    )


def has_ended(rollouts: Rollouts) -> np.ndarray:
    """``(rollouts,)``, false where time or the film ran out."""
    return ~np.isin(rollouts.outcome, (UNFINISHED, TIME_OUT))


def log_rank_scores(duration: ArrayLike, ended: ArrayLike) -> Floats:
    """Return what each episode of both sides adds to the log-rank statistic, ``(episodes,)``.

    It is whether the episode ``ended`` (not merely the film), less the cumulative hazard (Nelson
    and Aalen) of all episodes up to its end: zero on average on both sides if both end at the same
    rate. The higher, the earlier an episode ended.
    """
    duration, ended = np.asarray(duration, np.float64), np.asarray(ended, bool)
    times, place = np.unique(duration, return_inverse=True)
    here = np.bincount(place, minlength=len(times))
    events = np.bincount(place, ended, minlength=len(times))
    at_risk = here[::-1].cumsum()[::-1]
    return np.asarray(ended - np.cumsum(events / at_risk)[place])


def mean_survival(duration: ArrayLike, ended: ArrayLike, limit: float) -> float:
    """Return the mean duration up to ``limit``, the area under the Kaplan-Meier curve."""
    from scipy.stats import CensoredData, ecdf

    duration, ended = np.asarray(duration, np.float64), np.asarray(ended, bool)
    if not ended.any():
        return limit
    curve = ecdf(CensoredData(uncensored=duration[ended], right=duration[~ended])).sf
    times = np.concatenate([[0.0], np.minimum(curve.quantiles, limit), [limit]])
    levels = np.concatenate([[1.0], curve.probabilities])
    return float((np.diff(times) * levels).sum())
