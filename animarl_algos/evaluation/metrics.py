"""The one registry of what is measured of each episode, and where it is shown.

A new metric is one entry in ``METRICS``. The table of episodes, the comparison with the recordings,
the verdict, the choice of acting, the leaderboard, the report's figures, tables and sentences and
the table in the terminal all follow the entries.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import pandas as pd

from animarl_algos.evaluation.order_in_time import MEASURES, lags_for, median_steps, seconds_of
from animarl_algos.evaluation.prepared import MeasuredEpisodes, Prepared, ending
from animarl_algos.evaluation.rollouts import Rollouts
from animarl_algos.evaluation.statistics import Floats
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.episode import PURSUER_OUT, TARGET_OUT, Episodes
from animarl_envs.demos.summary import RECORDED_SCALE
from animarl_envs.errors import InputError

ARENA_UNITS = RECORDED_SCALE.name
GOAL, GROUP, ANIMAL = "goal", "group", "animal"  # what a metric may be about


Measure = Callable[[MeasuredEpisodes], Floats]


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
    compared
        Whether it is in the table of episodes, in the comparison and on the leaderboard, beside the
        verdict.
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


def _of_verdict(
    key: str, label: str, unit: str, measure: Measure, much: str, little: str,
    **more: Any,
) -> Metric:  # fmt: skip
    """A metric that the verdict judges and the comparison of methods leaves out."""
    return Metric(
        key=key, label=label, unit=unit, measure=measure, too_much=much, too_little=little,
        compared=False, **more,
    )  # fmt: skip


def _ended(key: str, label: str, end: int, much: str, little: str) -> Metric:
    return _of_verdict(
        key, label, "share", lambda e: (ending(e.rollouts) == end).astype(float), much, little,
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
    Metric(key="reached", label="Target reached", unit="share", share=True, is_ending=True,
           measure=lambda e: e.rollouts.captured.astype(float), about=GOAL,
           too_much="reaches the target too often", too_little="reaches the target too rarely",
           heading="target\nreached, %",
           caption="Share of episodes in which a pursuer reached the target (the moth the source), "
                   "all episodes."),
    Metric(key="path_length", label="Path length", unit=ARENA_UNITS, planned=True,
           measure=lambda e: e.path_length, noun="path lengths", heading="path length",
           too_much="paths too long", too_little="paths too short",
           caption="Path length per episode, mean over the pursuers (or the moth's): all episodes, "
                   "and captures only."),
    Metric(key="duration", label="Duration", unit="s", measure=lambda e: e.duration, planned=True,
           too_much="episodes too long", too_little="episodes too short", noun="durations",
           heading="duration, s", caption="Duration per episode: all episodes, and captures only."),
    Metric(key="dtw", label="DTW distance", unit=ARENA_UNITS, of_recordings=False, planned=True,
           measure=lambda e: e.dtw[0], heading="DTW distance",
           caption="Distance of each rollout to the demonstration that it started from after the "
                   "best alignment in time (dynamic time warping, DTW), mean over the pursuers (or "
                   "the moth's), summed along the warping path: all episodes, and captures only."),
    Metric(key="dtw_per_step", label="DTW distance per step", unit=ARENA_UNITS,
           measure=lambda e: e.dtw[1], of_recordings=False),
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
TARGET_REACHED, PATH_LENGTH, DURATION, DTW, DTW_PER_STEP = METRICS[:5]


def judged_metrics(recorded: Episodes) -> list[Metric]:
    """Return the metrics that a verdict judges, of this kind of recordings: endings first.

    Of several lags, each has a metric.
    """
    chosen = []
    for metric in _of_kind(recorded):
        if not metric.of_recordings:
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


def measures(prepared: Prepared, rollouts: Rollouts) -> dict[str, Floats]:
    """Return every judged metric of every episode, lengths in the recordings' unit."""
    episodes, scale = prepared.episodes(rollouts), prepared.unit.per_arena_unit
    return {
        metric.key: (scale if metric.is_length else 1.0) * metric.measure(episodes)
        for metric in judged_metrics(prepared.demos)
    }


def compared_metrics(recorded: Episodes) -> list[Metric]:
    """Return the metrics that methods are compared by, of this kind of recordings."""
    return [metric for metric in _of_kind(recorded) if metric.compared]


def _of_kind(recorded: Episodes) -> list[Metric]:
    kind = GROUP if recorded.is_group else ANIMAL if recorded.num_individuals == 1 else ""
    return [one for one in METRICS if one.about in ("", GOAL if recorded.has_goal else kind)]


def add_metric(metric: Metric) -> None:
    """Have one more metric measured and shown, in this process; its key must be new."""
    if any(metric.key == known.key for known in METRICS):
        raise InputError(f"there is a metric {metric.key!r} already: give it another key")
    METRICS.append(metric)


def measure(rollouts: Rollouts, demos: Demonstrations) -> pd.DataFrame:
    """One row per rollout, one column per metric of :func:`compared_metrics`.

    Beside them ``method, seed, demo, repetition, condition, cue, outcome, captured, factual``
    (whether it may be compared with the recording); ``rollouts`` are of one method,
    ``rollouts.demo`` counts the episodes of ``demos``. The DTW distance is that
    to the same individual of the demonstration, so zero for the recordings.

    Raises InputError if the rollouts are not of these demonstrations.
    """
    if rollouts.individuals != demos.individuals or rollouts.demo.max() >= demos.num_episodes:
        raise InputError(
            f"the rollouts of {rollouts.method} were not made from {demos.name}: "
            "evaluate them against the demonstrations they started from"
        )
    episodes = Prepared(demos).episodes(rollouts)
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
            "factual": rollouts.is_factual(demos),
            **{metric.key: metric.measure(episodes) for metric in compared_metrics(demos)},
        }
    )


def measure_recordings(demos: Demonstrations) -> pd.DataFrame:
    """The same table for the recordings themselves, in the order of the episodes."""
    return measure(Rollouts.from_demonstrations(demos), demos)
