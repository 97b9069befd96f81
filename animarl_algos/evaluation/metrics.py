"""The one registry of what is measured of each episode, and where it is shown.

A new metric is one entry in ``METRICS``. The table of episodes, the comparison with the recordings,
the verdict, the choice of acting, the leaderboard, the report's figures, tables and sentences and
the table in the terminal all follow the entries.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from animarl_algos.evaluation.order_in_time import (
    MEASURES,
    EpisodeMeasures,
    angle,
    lags_for,
    median_steps,
    order_measures,
    seconds_of,
)
from animarl_algos.evaluation.rollouts import Rollouts
from animarl_algos.evaluation.statistics import Floats
from animarl_algos.evaluation.windows import resting_step
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.episode import PURSUER_OUT, TARGET_OUT, Episodes
from animarl_envs.demos.summary import RECORDED_SCALE, RESTING_SHARE
from animarl_envs.dtw import dtw_alignment
from animarl_envs.errors import InputError

if TYPE_CHECKING:
    import pandas as pd


ARENA_UNITS = RECORDED_SCALE.name
SLOW_SHARE = 0.25  # of the recorded median moving speed: a step below it is a slow one
GOAL, GROUP, ANIMAL = "goal", "group", "animal"  # what a metric may be about
REACHED, NEITHER = 1, 0  # endings, beside TARGET_OUT and PURSUER_OUT


@dataclass(frozen=True, eq=False)
class MetricInputs:
    """What metrics are worked out from: rollouts and the demonstrations they started from.

    Parameters
    ----------
    rollouts, demos
        ``rollouts.demo`` counts the episodes of ``demos``.
    slow
        ``(individuals,)`` speeds below which a step is slow [arena unit / s], see
        :func:`slow_speeds`; by default those of the demonstrations.
    rounding
        Who is outside the arena by no more than this [arena unit] may have been rounded there.
    ordered
        Measures the order in time of the rollouts, by default as they are, without smoothing.
    """

    rollouts: Rollouts
    demos: Demonstrations
    slow: Floats | None = None
    rounding: float = 0.0
    ordered: Callable[[], EpisodeMeasures] | None = None

    @cached_property
    def order(self) -> EpisodeMeasures:
        """Order in time, reactions and places, at the lags of the demonstrations."""
        if self.ordered is not None:
            return self.ordered()
        recorded = Rollouts.from_demonstrations(self.demos)
        lags = lags_for(median_steps(recorded), self.demos.dt)
        return order_measures(self.rollouts, lags, resting_step(recorded), self.demos.arena)

    @cached_property
    def dtw(self) -> Floats:
        """``(2, rollouts)``: DTW distance of those who move by themselves, and the same per step.

        Means over individuals, of whole paths and of the distance of aligned positions [arena
        unit].
        """
        distance, pairs = dtw_alignments(self.rollouts, self.demos)
        return np.stack([self._mean_over_movers(each) for each in (distance, distance / pairs)])

    @property
    def path_length(self) -> Floats:
        """``(rollouts,)``: mean over those who move by themselves [arena unit]."""
        return self._mean_over_movers(path_lengths(self.rollouts))

    @property
    def duration(self) -> Floats:
        """``(rollouts,)`` [s]."""
        return np.asarray((self.rollouts.lengths - 1) * self.rollouts.dt, dtype=np.float64)

    @cached_property
    def ending(self) -> NDArray[np.int64]:
        """``(rollouts,)``: reached, target out, pursuer out, or neither."""
        return ending(self.rollouts)

    @property
    def outside(self) -> NDArray[np.bool_]:
        """``(rollouts,)``, whether somebody was outside the arena, or left it."""
        inside = self.demos.arena.contains(self.rollouts.positions, margin=self.rounding)
        ever = np.logical_or.reduceat(~inside.all(axis=1), self.rollouts.offsets[:-1])
        return np.asarray(ever | np.isin(self.ending, (TARGET_OUT, PURSUER_OUT)))

    @cached_property
    def motion(self) -> Floats:
        """``(4, rollouts)``, means over individuals.

        Mean and median speed of single steps [arena unit / s], share of slow steps, and the angle
        between successive steps summed over an episode, divided by its duration [rad/s].
        """
        rollouts, slow = self.rollouts, self.slow
        if slow is None:
            slow = slow_speeds(Rollouts.from_demonstrations(self.demos))
        found = np.zeros((4, len(rollouts)))
        for i in range(len(rollouts)):
            moved = np.diff(rollouts.path(i), axis=0)
            if len(moved) == 0:
                continue
            speed = np.linalg.norm(moved, axis=-1) / rollouts.dt
            turned = np.abs(angle(moved[:-1], moved[1:])).sum(axis=0).mean()
            median = np.median(speed, axis=0).mean()
            found[:, i] = speed.mean(), median, (speed < slow).mean(), turned / self.duration[i]
        return found

    def _mean_over_movers(self, values: Floats) -> Floats:
        return np.asarray(values[:, self.rollouts.movers].mean(axis=1))


Measure = Callable[[MetricInputs], Floats]


@dataclass(frozen=True, kw_only=True)
class Metric:
    """One number per episode.

    Parameters
    ----------
    key
        Its column in ``metrics.csv`` and its name in the other tables.
    label, unit
        As figures, tables and sentences name it.
    measure
        ``(rollouts,)`` values of some episodes.
    share
        It is a share, 0 or 1 for most: shown in percent, without distribution, and over all
        episodes alone.
    of_recordings
        Recordings have it too. False: it is itself a comparison with them.
    planned
        Planned pairs of methods have a gate by it.
    caption, heading
        Of its figure in the report, and of its column in the terminal; not shown there without.
    compared, judged, on_board
        Where it is shown: in the table of episodes and the comparison, in the verdict, and on the
        leaderboard.
    is_ending
        Of how an episode ended: no row in the verdict where neither side knows it.
    about
        ``"goal"``: only where a target is pursued or a source searched; ``"group"``: only of
        three or more that are alike; ``"animal"``: only of one animal alone.
    of_order
        The measure of :mod:`animarl_algos.evaluation.order_in_time` that it is, so that the row of
        its kind leaves it out. One that ends in ``" in"`` or ``" at"`` stands for several lags.
    too_much, too_little
        What the verdict says where rollouts have more of it, or less.
    noun
        Its values, where they may be too much alike or too varied: the verdict then compares their
        spread too, and the energy score is worked out.
    """

    key: str
    label: str
    unit: str
    measure: Measure
    share: bool = False
    of_recordings: bool = True
    planned: bool = False
    caption: str = ""
    heading: str = ""
    compared: bool = True
    judged: bool = True
    on_board: bool = True
    is_ending: bool = False
    about: str = ""
    of_order: str = ""
    too_much: str = ""
    too_little: str = ""
    noun: str = ""

    @property
    def words(self) -> tuple[str, str]:
        """What the verdict says of too much and of too little."""
        name = self.label[:1].lower() + self.label[1:]
        return self.too_much or f"{name} too high", self.too_little or f"{name} too low"

    @property
    def is_length(self) -> bool:
        """Whether its unit is one of length, or of speed, in arena units."""
        return self.unit.startswith(ARENA_UNITS)

    @property
    def has_distribution(self) -> bool:
        """Whether its distribution is compared with that of the recordings."""
        return self.of_recordings and not self.share

    @property
    def axis(self) -> str:
        """Of a figure."""
        unit = "% of episodes" if self.share else self.unit
        return f"{self.label} ({unit})" if unit else self.label


RETURN = Metric(
    key="return",
    label="Target reached",
    unit="share of episodes",
    measure=lambda episodes: episodes.rollouts.captured.astype(float),
    share=True,
    about=GOAL,
    judged=False,  # "reached" is
    caption="Share of episodes in which a pursuer reached the target (the moth the source), all "
    "episodes.",
    heading="target\nreached, %",
)
PATH_LENGTH = Metric(
    key="path_length",
    label="Path length",
    unit=ARENA_UNITS,
    measure=lambda episodes: episodes.path_length,
    planned=True,
    too_much="paths too long",
    too_little="paths too short",
    noun="path lengths",
    caption="Path length per episode, mean over the pursuers (or the moth's): all episodes, and "
    "captures only.",
    heading="path length",
)
DURATION = Metric(
    key="duration",
    label="Duration",
    unit="s",
    measure=lambda episodes: episodes.duration,
    planned=True,
    too_much="episodes too long",
    too_little="episodes too short",
    noun="durations",
    caption="Duration per episode: all episodes, and captures only.",
    heading="duration, s",
)
DTW_PER_STEP = Metric(
    key="dtw_per_step",
    label="DTW distance per step",
    unit=ARENA_UNITS,
    measure=lambda episodes: episodes.dtw[1],
    of_recordings=False,
)
DTW = Metric(
    key="dtw",
    label="DTW distance",
    unit=ARENA_UNITS,
    measure=lambda episodes: episodes.dtw[0],
    of_recordings=False,
    planned=True,
    caption="Distance of each rollout to the demonstration that it started from after the best "
    "alignment in time (dynamic time warping, DTW), mean over the "
    "pursuers (or the moth's), summed along the warping path: all episodes, and captures only.",
    heading="DTW distance",
)


def _of_verdict(
    key: str, label: str, unit: str, measure: Measure, much: str, little: str,
    **more: Any,
) -> Metric:  # fmt: skip
    """A metric that the verdict judges and the comparison of methods leaves out."""
    return Metric(
        key=key, label=label, unit=unit, measure=measure, too_much=much, too_little=little,
        compared=False, on_board=key in ("reached", "mean_speed"), **more,
    )  # fmt: skip


def _ended(key: str, label: str, end: int, much: str, little: str) -> Metric:
    return _of_verdict(
        key, label, "share", lambda e: (e.ending == end).astype(float), much, little,
        share=True, is_ending=True, about=GOAL,
    )  # fmt: skip


def _of_order(key: str, name: str, about: str, label: str = "") -> Metric:
    """A measure of order in time that has a row of its own where it is what matters."""
    one = MEASURES[name]
    return _of_verdict(
        key, label or name[:1].upper() + name[1:], one.unit, _order_of(name), one.much, one.little,
        about=about, of_order=name,
    )  # fmt: skip


def _order_of(name: str) -> Measure:
    return lambda episodes: episodes.order.column(name)


METRICS = [
    RETURN,
    PATH_LENGTH,
    DURATION,
    DTW,
    DTW_PER_STEP,
    _ended("reached", "Target reached", REACHED,
           "reaches the target too often", "reaches the target too rarely"),
    _ended("target_out", "Ended by the target leaving", TARGET_OUT,
           "the target leaves too often", "the target leaves too rarely"),
    _ended("pursuer_out", "Ended by a pursuer leaving", PURSUER_OUT,
           "a pursuer leaves too often", "a pursuer leaves too rarely"),
    _of_verdict("leaving", "Somebody outside the arena", "share",
                lambda e: e.outside.astype(float),
                "leaves the arena", "leaves the arena too rarely", share=True, is_ending=True),
    _of_verdict("mean_speed", "Mean speed", f"{ARENA_UNITS}/s", lambda e: e.motion[0],
                "too fast", "too slow", noun="mean speeds"),
    _of_verdict("median_speed", "Median speed", f"{ARENA_UNITS}/s", lambda e: e.motion[1],
                "too fast", "too slow"),
    _of_verdict("slow_steps", "Slow steps", "share", lambda e: e.motion[2],
                "stands still too often", "stands still too rarely", share=True),
    _of_verdict("turning", "Turning", "rad/s", lambda e: e.motion[3],
                "turns too much", "turns too little"),
    _of_order("nearest_neighbour", "nearest neighbour", GROUP),
    _of_order("near_neighbour", "5 % nearest neighbour", GROUP, "Nearest neighbour, 5 % quantile"),
    _of_order("extent", "extent of the group", GROUP),
    _of_order("polarisation", "polarisation", GROUP),
    _of_order("milling", "milling", GROUP),
    _of_order("leadership_lag", "leadership lag", GROUP),
    _of_order("speed_correlation", "speed with the others", GROUP, "Speed correlation"),
    _of_order("displacement", "displacement in", ANIMAL),
    _of_order("turn_autocorrelation", "turn autocorrelation at", ANIMAL),
    _of_order("bouts", "length of bouts of motion", ANIMAL),
    _of_order("rests", "length of rests", ANIMAL),
]  # fmt: skip
"""In the order in which they are shown. Resampling goes by it too: put new ones last."""


def judged_metrics(recorded: Episodes) -> list[Metric]:
    """Return the metrics that a verdict judges, of this kind of recordings: endings first.

    Of several lags, each has a metric.
    """
    chosen = []
    for metric in _of_kind(recorded):
        if not (metric.judged and metric.of_recordings):
            continue
        if metric.of_order.endswith((" in", " at")):
            for lag in lags_for(median_steps(recorded), recorded.dt):
                after = f" {seconds_of(lag, recorded.dt)}"
                name = metric.of_order + after
                chosen.append(
                    replace(
                        metric, key=metric.key + after.replace(" ", "_"),
                        label=metric.label + after, of_order=name, measure=_order_of(name),
                    )
                )  # fmt: skip
        else:
            chosen.append(metric)
    return sorted(chosen, key=lambda metric: not metric.is_ending)


def compared_metrics(recorded: Episodes) -> list[Metric]:
    """Return the metrics that methods are compared by, of this kind of recordings."""
    return [metric for metric in _of_kind(recorded) if metric.compared]


def _of_kind(recorded: Episodes) -> list[Metric]:
    kind = GROUP if recorded.is_group else ANIMAL if recorded.num_individuals == 1 else ""
    return [one for one in METRICS if one.about in ("", GOAL if recorded.has_goal else kind)]


def slow_speeds(recorded: Rollouts) -> Floats:
    """Return the speed below which each individual is slow, ``(individuals,)`` [arena unit / s].

    It is a quarter of the median speed of those recorded steps in which it moves at all, faster
    than 5 % of its 99th percentile.
    """
    speeds = recorded.speeds()
    if recorded.is_group:  # animals of a group are alike
        speeds = np.repeat(speeds.reshape(-1, 1), speeds.shape[1], axis=1)
    limit = np.zeros(speeds.shape[1])
    for k, speed in enumerate(speeds.T):
        moving = speed[speed > RESTING_SHARE * np.quantile(speed, 0.99)]
        limit[k] = SLOW_SHARE * np.median(moving) if moving.size else 0.0
    return limit


def ending(rollouts: Rollouts) -> NDArray[np.int64]:
    """Reached, target out, pursuer out, or neither (time-out, or the recording was cut)."""
    outcome = rollouts.outcome
    known = np.where(np.isin(outcome, (TARGET_OUT, PURSUER_OUT)), outcome, NEITHER)
    return np.where(outcome > 0, REACHED, known).astype(np.int64)


def add_metric(metric: Metric) -> None:
    """Have one more metric measured and shown, in this process; its key must be new."""
    if any(metric.key == known.key for known in METRICS):
        raise InputError(f"there is a metric {metric.key!r} already: give it another key")
    METRICS.append(metric)


def path_lengths(rollouts: Rollouts) -> Floats:
    """Distance travelled by each individual, ``(rollouts, individuals)`` [arena unit]."""
    step = np.zeros(rollouts.positions.shape[:2])
    step[1:] = np.linalg.norm(np.diff(rollouts.positions, axis=0), axis=-1)
    step[rollouts.offsets[:-1]] = 0.0  # no step leads from one episode to the next
    return np.asarray(np.add.reduceat(step, rollouts.offsets[:-1], axis=0))


def dtw_alignments(rollouts: Rollouts, demos: Demonstrations) -> tuple[Floats, Floats]:
    """DTW distance of each individual's whole path to its demonstration's, and pairs of frames.

    Closed at both ends, Euclidean local cost, summed along the best warping path, which aligns so
    many pairs; ``(rollouts, individuals)`` [arena unit], twice.
    """
    distance, pairs = np.empty((2, len(rollouts), len(rollouts.individuals)))
    for i, demo in enumerate(rollouts.demo.tolist()):
        path, recorded = rollouts.path(i), demos.path(demo)
        for k in range(distance.shape[1]):
            distance[i, k], pairs[i, k] = dtw_alignment(path[:, k], recorded[:, k])
    return distance, pairs


def measure(rollouts: Rollouts, demos: Demonstrations) -> pd.DataFrame:
    """One row per rollout, one column per metric of :func:`compared_metrics`.

    Beside them ``method, seed, demo, repetition, condition, cue, outcome, captured``; ``rollouts``
    are of one method, ``rollouts.demo`` counts the episodes of ``demos``. The DTW distance is that
    to the same individual of the demonstration, so zero for the recordings.

    Raises InputError if the rollouts are not of these demonstrations.
    """
    import pandas as pd

    if rollouts.individuals != demos.individuals or rollouts.demo.max() >= demos.num_episodes:
        raise InputError(
            f"the rollouts of {rollouts.method} were not made from {demos.name}: "
            "evaluate them against the demonstrations they started from"
        )
    episodes = MetricInputs(rollouts, demos)
    return pd.DataFrame(
        {
            "method": rollouts.method,
            "seed": rollouts.seed,
            "demo": rollouts.demo,
            "repetition": rollouts.repetition,
            "condition": rollouts.condition,
            "cue": rollouts.cue,
            "outcome": rollouts.outcome,
            "captured": rollouts.captured,
            **{metric.key: metric.measure(episodes) for metric in compared_metrics(demos)},
        }
    )


def measure_recordings(demos: Demonstrations) -> pd.DataFrame:
    """The same table for the recordings themselves, in the order of the episodes."""
    return measure(Rollouts.from_demonstrations(demos), demos)
