"""The one registry of what is measured of each episode, and where it is shown.

A new metric is one entry in ``METRICS``, or one line of ``measures.csv`` if
:mod:`animarl_algos.evaluation.order_in_time` computes it. The table of episodes, the comparison
with the recordings, the verdict, the realism score, the choice of acting, the leaderboard, the
report's figures, tables and sentences and the table in the terminal all follow the entries.
"""

import csv
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from animarl_algos.evaluation.order_in_time import plain_name
from animarl_algos.evaluation.prepared import MeasuredEpisodes, Prepared, ending
from animarl_algos.evaluation.rollouts import Rollouts
from animarl_envs.array_types import Floats
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.episode import PURSUER_OUT, TARGET_OUT, Episodes
from animarl_envs.demos.summary import RECORDED_SCALE
from animarl_envs.errors import InputError

ARENA_UNITS = RECORDED_SCALE.name
GOAL, GROUP, ANIMAL = "goal", "group", "animal"  # what a metric may be about
KINEMATIC, ORDER, INTERACTIVE, PLACE = "kinematic", "order in time", "interactive", "place"
BETWEEN_ANIMALS = "between animals"  # of a group
KINDS = {
    KINEMATIC: "Motion of individuals",
    ORDER: "Order in time",
    INTERACTIVE: "Reactions to others",
    PLACE: "Place",
    BETWEEN_ANIMALS: "Differences between animals",
}
"""Kinds of metrics that share a row of the verdict; the one farthest from alike stands for it."""
OF_MEAN, OF_SHARE, OF_SPREAD, OF_WIDTH = "mean", "share", "spread", "width"
TOLERANCES = {OF_MEAN: 0.10, OF_SHARE: 0.05, OF_SPREAD: 0.25, OF_WIDTH: 0.25}
"""Differences that count as alike: as part of the recorded mean; as a share; in standard deviations
between recordings, for what may be zero; and as part of the recorded spread."""

SUMMARY = ("duration", "path_length", "mean_speed")  # what methods are ranked by

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
    kind
        One of :data:`KINDS`, whose row in the verdict it is part of; empty: it has its own row.
    tolerance
        Which of :data:`TOLERANCES` it is judged by.
    by_time
        Pieces of one recording weigh as much as they last, and not all the same.
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
    whole
        It stands for whole episodes in the realism score, as do all metrics of order.
    too_much, too_little
        What the verdict says where rollouts have more of it, or less.
    noun
        Its values, where they may be too much alike or too varied: the verdict then compares their
        spread too, and the energy score is worked out.
    own
        Of a measure of the user's own: its values of any rollouts, by the scale of an arena unit.
    chooses
        Of such a measure: the choice of acting judges rollouts by it, too.
    """

    key: str
    label: str
    unit: str
    measure: Measure
    kind: str = ""
    tolerance: str = OF_MEAN
    by_time: bool = True
    share: bool = False
    of_recordings: bool = True
    planned: bool = False
    caption: str = ""
    heading: str = ""
    compared: bool = True
    is_ending: bool = False
    about: str = ""
    whole: bool = False
    too_much: str = ""
    too_little: str = ""
    noun: str = ""
    own: Callable[[Rollouts, float], Floats] | None = None
    chooses: bool = False

    @property
    def is_share(self) -> bool:
        """Whether its values lie between 0 and 1 and are shown in percent."""
        return self.share or self.unit == "share"

    def complaint(self, more: bool) -> str:
        """Return the verdict's words for a value that is too high (``more``) or too low."""
        given = self.too_much if more else self.too_little
        return given or f"{self.label[:1].lower()}{self.label[1:]} too {'high' if more else 'low'}"

    @property
    def is_length(self) -> bool:
        """Whether its values are lengths or speeds in arena units."""
        return self.own is None and self.unit.startswith(ARENA_UNITS)

    @property
    def has_distribution(self) -> bool:
        """Whether its distribution is compared with that of the recordings."""
        return self.of_recordings and not self.share


def _of_verdict(key: str, label: str, unit: str, measure: Measure, **more: Any) -> Metric:
    """Return a metric that the verdict judges and the comparison of methods leaves out."""
    return Metric(key=key, label=label, unit=unit, measure=measure, compared=False, **more)


def _share_of_endings(key: str, label: str, end: int, much: str, little: str) -> Metric:
    return _of_verdict(
        key,
        label,
        "share",
        lambda e: (ending(e.rollouts) == end).astype(float),
        too_much=much,
        too_little=little,
        tolerance=OF_SHARE,
        by_time=False,
        share=True,
        is_ending=True,
        about=GOAL,
    )


METRICS = [
    Metric(
        key="reached",
        label="Target reached",
        unit="share",
        share=True,
        is_ending=True,
        measure=lambda e: e.rollouts.captured.astype(float),
        about=GOAL,
        by_time=False,
        tolerance=OF_SHARE,
        heading="target\nreached, %",
        too_much="reaches the target too often",
        too_little="reaches the target too rarely",
        caption="Share of episodes in which a pursuer reached the target (the moth the source), "
        "all episodes.",
    ),
    Metric(
        key="path_length",
        label="Path length",
        unit=ARENA_UNITS,
        planned=True,
        by_time=False,
        measure=lambda e: e.path_length,
        noun="path lengths",
        heading="path length",
        too_much="paths too long",
        too_little="paths too short",
        caption="Path length per episode, mean over the pursuers (or the moth's): all episodes, "
        "and captures only.",
    ),
    Metric(
        key="duration",
        label="Duration",
        unit="s",
        measure=lambda e: e.duration,
        planned=True,
        too_much="episodes too long",
        too_little="episodes too short",
        noun="durations",
        heading="duration, s",
        by_time=False,
        caption="Duration per episode: all episodes, and captures only.",
    ),
    Metric(
        key="dtw",
        label="DTW distance",
        unit=ARENA_UNITS,
        of_recordings=False,
        planned=True,
        measure=lambda e: e.dtw[0],
        heading="DTW distance",
        by_time=False,
        caption="Distance of each rollout to the recording that it started from after the "
        "best alignment in time (dynamic time warping, DTW), mean over the pursuers (or "
        "the moth's), summed along the warping path: all episodes, and captures only.",
    ),
    Metric(
        key="dtw_per_step",
        label="DTW distance per step",
        unit=ARENA_UNITS,
        measure=lambda e: e.dtw[1],
        of_recordings=False,
    ),
    _share_of_endings(
        "target_out",
        "Ended by the target leaving",
        TARGET_OUT,
        "the target leaves too often",
        "the target leaves too rarely",
    ),
    _share_of_endings(
        "pursuer_out",
        "Ended by a pursuer leaving",
        PURSUER_OUT,
        "a pursuer leaves too often",
        "a pursuer leaves too rarely",
    ),
    _of_verdict(
        "leaving",
        "Somebody outside the arena",
        "share",
        lambda e: e.outside.astype(float),
        share=True,
        is_ending=True,
        by_time=False,
        tolerance=OF_SHARE,
        too_much="leaves the arena",
        too_little="leaves the arena too rarely",
    ),
    _of_verdict(
        "mean_speed",
        "Mean speed",
        f"{ARENA_UNITS}/s",
        lambda e: e.motion[0],
        too_much="too fast",
        too_little="too slow",
        noun="mean speeds",
    ),
    _of_verdict(
        "median_speed",
        "Median speed",
        f"{ARENA_UNITS}/s",
        lambda e: e.motion[1],
        too_much="median speed too high",
        too_little="median speed too low",
    ),
    _of_verdict(
        "slow_steps",
        "Slow steps",
        "share",
        lambda e: e.motion[2],
        share=True,
        tolerance=OF_SHARE,
        too_much="stands still too often",
        too_little="stands still too rarely",
    ),
    _of_verdict(
        "turning",
        "Turning",
        "rad/s",
        lambda e: e.motion[3],
        too_much="turns too much",
        too_little="turns too little",
    ),
    _of_verdict(
        "occupancy",
        "Occupancy distance",
        "share",
        lambda e: e.occupancy,
        tolerance=OF_SHARE,
        too_much="goes to other places than recorded",
        too_little="keeps too much to the usual places",
    ),
]
"""In the order in which they are shown. Resampling goes by it too: put new ones last."""
TARGET_REACHED, PATH_LENGTH, DURATION, DTW, DTW_PER_STEP = METRICS[:5]


def _order_of(name: str) -> Measure:
    return lambda episodes: episodes.order.column(name)


def _of_order() -> dict[str, Metric]:
    """Return the metrics of ``measures.csv`` by the name that ``order_in_time`` gives them."""
    file = Path(__file__).with_name("measures.csv")
    return {
        row["name"]: _of_verdict(
            row["key"],
            row["name"][:1].upper() + row["name"][1:],
            row["unit"],
            _order_of(row["name"]),
            kind=row["kind"],
            tolerance=row["tolerance"],
            about=row["about"],
            too_much=row["much"],
            too_little=row["little"],
            whole=bool(row["whole"]),
        )
        for row in csv.DictReader(file.read_text("utf-8").splitlines())
    }


ORDER_METRICS = _of_order()
"""By name; those at several lags end in *in* or *at*."""


def order_metrics(prepared: Prepared) -> list[Metric]:
    """Return a metric for each column of order in time, at each lag and of each individual.

    Those about this kind of recordings have rows of their own in the verdict, and no kind.
    """
    about = _kind_of(prepared.demos)
    metrics = []
    for name in prepared.order(prepared.recorded).names:
        plain = plain_name(name)
        metric = ORDER_METRICS[plain]
        metrics.append(
            replace(
                metric,
                key=metric.key + name.removeprefix(plain).replace(",", "").replace(" ", "_"),
                label=name[:1].upper() + name[1:],
                measure=_order_of(name),
                kind="" if metric.about and metric.about == about else metric.kind,
            )
        )
    return metrics


def judged_metrics(prepared: Prepared) -> list[Metric]:
    """Return the metrics that a verdict judges, of this kind of recordings.

    Endings come first, then other metrics with rows of their own, then those that share one.
    """
    own = [metric for metric in _about(prepared.demos) if metric.of_recordings]
    order = order_metrics(prepared)
    own += [metric for metric in order if not metric.kind]
    shared = [metric for kind in KINDS for metric in order if metric.kind == kind]
    return sorted(own, key=lambda metric: not metric.is_ending) + shared


def measures(prepared: Prepared, rollouts: Rollouts) -> dict[str, Floats]:
    """Return every judged metric of every episode, lengths in the recordings' unit."""
    episodes, scale = prepared.episodes(rollouts), prepared.unit.per_arena_unit
    return {
        metric.key: np.asarray((scale if metric.is_length else 1.0) * metric.measure(episodes))
        for metric in judged_metrics(prepared)
    }


def summary_table(prepared: Prepared, rollouts: Rollouts) -> Floats:
    """Duration, path length and speed ``(rollouts, 3)``, each in units of its recorded spread."""
    true, simulated = (measures(prepared, side) for side in (prepared.recorded, rollouts))
    return np.stack([simulated[key] / (float(np.std(true[key])) or 1.0) for key in SUMMARY], axis=1)


def compared_metrics(recorded: Episodes) -> list[Metric]:
    """Return the metrics that methods are compared by, of this kind of recordings."""
    return [metric for metric in _about(recorded) if metric.compared]


def _kind_of(recorded: Episodes) -> str:
    if recorded.has_goal:
        return GOAL
    return GROUP if recorded.is_group else ANIMAL if recorded.num_individuals == 1 else ""


def _about(recorded: Episodes) -> list[Metric]:
    return [one for one in METRICS if one.about in ("", _kind_of(recorded))]


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
