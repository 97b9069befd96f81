"""A whole evaluation: every method against the recordings and every other one, tables as files.

Which episodes count is part of every row: ``"all"``, or ``"captures"`` (rollouts and recordings in
which the target was reached). The two can point in opposite directions, so both are always there.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import permutations as ordered_pairs
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from animarl_algos.evaluation import statistics
from animarl_algos.evaluation.metrics import (
    METRICS,
    TARGET_REACHED,
    Metric,
    measure,
    measure_recordings,
)
from animarl_algos.evaluation.prepared import censored
from animarl_algos.evaluation.rollouts import RECORDED, Rollouts
from animarl_algos.evaluation.statistics import RESAMPLES, Cells, Draws
from animarl_algos.evaluation.verdict import Verdict, verdict
from animarl_algos.evaluation.verdict_rows import AS_BUILT, Questions
from animarl_envs.array_types import Floats, Ints
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.errors import InputError
from animarl_envs.files import read_json, write_then_rename
from animarl_envs.fitting.tracking import Tracking

TABLES = ("metrics", "comparison", "pairs")
NUMBERS = ("fingerprint", "seed", "resamples")
COUNTING = {"all": "all episodes", "captures": "captures only"}
ENERGY = "energy of "
"""Before the key of a metric: its energy score."""
PLANNED_CONTRASTS = (("DQDIL", "DQAAS"), ("DQDIL-PT", "DQAAS"), ("DQDIL-PT", "DQDIL"))
GATE_LEVEL = 0.05


class _Measure(NamedTuple):
    """A metric, or its energy score, of every method by seed and start."""

    metric: Metric
    key: str
    counting: str
    data: Mapping[str, Cells]
    share: bool = False
    truth: Floats | None = None  # recorded values, of an energy score


def _measures(metrics: pd.DataFrame, unit: Ints) -> Iterator[_Measure]:
    """Yield every metric by every rule of what counts, and its energy score, by recording.

    A share among captures would say nothing; where nobody can be reached, there are none.
    """
    methods = [*metrics[metrics["factual"]].groupby("method", sort=False)]
    known = [metric for metric in METRICS if metric.compared and metric.key in metrics]
    for metric in known:
        for rule in COUNTING if TARGET_REACHED in known and not metric.share else ("all",):
            values = {
                str(name): (
                    rows[metric.key].where(rows["captured"] | (rule == "all")),
                    rows["seed"],
                    rows["demo"],
                )
                for name, rows in methods
                if metric.of_recordings or name != RECORDED
            }
            data = {name: statistics.cells(*each, len(unit)) for name, each in values.items()}
            yield _Measure(metric, metric.key, rule, _by_unit(data, unit), metric.share)
            if metric.has_distribution and RECORDED in data:
                truth = data[RECORDED].cell_means[0]
                del values[RECORDED]
                scores = {
                    name: statistics.energy_cells(*each, truth) for name, each in values.items()
                }
                yield _Measure(
                    metric, ENERGY + metric.key, rule, _by_unit(scores, unit), truth=truth
                )


def _by_unit(data: Mapping[str, Cells], unit: Ints) -> dict[str, Cells]:
    return {name: cells.by_unit(unit) for name, cells in data.items()}


def comparison_table(
    metrics: pd.DataFrame,
    unit: Ints,
    rng: np.random.Generator,
    *,
    resamples: int = RESAMPLES,
) -> pd.DataFrame:
    """Means and energy scores of every method, with 95 % intervals.

    Parameters
    ----------
    metrics
        Rows of :func:`~animarl_algos.evaluation.metrics.measure`, the recordings among them.
    unit
        ``(starts,)`` the recording of each evaluated demonstration, from 0.

    Returns
    -------
    One row per method, measure and counting rule. A measure is a metric or its energy score, the
    mean over starts, whose ``null`` is what the recordings of all other starts score. ``demos``
    (recordings) and ``seeds`` say how many count, ``rollouts`` of how many (of an energy score,
    starts times seeds), and ``covers`` what the interval from ``low`` to ``high`` speaks of; where
    there is none, ``reason`` says why.
    """
    draws, table = Draws.by(rng, resamples), []
    for each in _measures(metrics, unit):
        for name, data in each.data.items():
            value = statistics.bootstrap_mean(data, draws, share=each.share)
            null = (
                math.nan
                if each.truth is None
                else statistics.pooled_score(each.truth[data.starts[unit]])
            )
            table.append(
                statistics.row_of(
                    value,
                    method=name,
                    measure=each.key,
                    counting=each.counting,
                    rollouts=int(data.counts.sum()),
                    demos=int(data.starts.sum()),
                    seeds=len(data.counts),
                    null=null,
                    covers="demonstrations like these"
                    if name == RECORDED
                    else statistics.covers(data),
                )
            )
    return pd.DataFrame(table)


def pair_table(
    metrics: pd.DataFrame, unit: Ints, rng: np.random.Generator, *, resamples: int = RESAMPLES
) -> pd.DataFrame:
    """Every simulated method minus every other and minus the recordings, paired by demonstration.

    One row per measure, counting rule and ordered pair: the ``value`` is the difference of their
    means, or of their energy scores (below zero, the ``first`` is closer to the recordings), with
    its 95 % interval, and the ``reason`` where there is none. Only starts that both have count:
    ``demos`` of them, which ``pairing`` says if they are not all. Nothing corrects for the number
    of pairs.

    A pair that was planned (``PLANNED_CONTRASTS``) also has the ``gate``, all episodes counting: an
    ANOVA over the training seeds of all methods that are in such a pair, by their energy scores
    (DTW distances by themselves), and its ``gate_p``. Nothing is concluded from a planned pair
    whose gate is not passed.
    """
    draws, table = Draws.by(rng, resamples), []
    names = metrics.loc[metrics["factual"], "method"].unique()
    own = {str(name).casefold(): str(name) for name in names if name != RECORDED}
    planned = {
        (own[one.casefold()], own[other.casefold()])
        for one, other in PLANNED_CONTRASTS
        if {one.casefold(), other.casefold()} <= set(own)
    }
    taking_part = {one for pair in planned for one in pair}
    for each in _measures(metrics, unit):
        metric, opened = each.metric, None
        gated = each.truth is not None or not metric.has_distribution
        if planned and metric.planned and each.counting == "all" and gated:
            data = [one for name, one in each.data.items() if name in taking_part]
            opened = gate([one.seed_means for one in statistics.shared_starts(data)], rng)
        for first, second in ordered_pairs(each.data, 2):
            if first == RECORDED:
                continue
            one, other = each.data[first], each.data[second]
            gap = statistics.bootstrap_difference(one, other, draws, share=each.share)
            same = (one.starts == other.starts).all()
            row = statistics.row_of(
                gap,
                measure=each.key,
                counting=each.counting,
                first=first,
                second=second,
                demos=int((one.starts & other.starts).sum()),
                pairing="paired, same starts" if same else "paired, shared starts only",
                covers=statistics.covers(one, *([] if second == RECORDED else [other])),
                gate="",
                gate_p=math.nan,
            )
            if opened is not None and (first, second) in planned:
                row |= {"gate": opened.decision, "gate_p": opened.p}
            table.append(row)
    return pd.DataFrame(table)


# -- the gate -------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Gate:
    """How rarely chance alone makes methods differ as much, and the smallest ``p`` there could be.

    With 2 methods of 3 seeds there are 20 ways to deal the seeds, of which the observed one and its
    mirror image are equally good, so that p is never below 0.1.
    """

    p: float
    least: float

    @property
    def decision(self) -> str:
        """Whether the gate is passed, where the most extreme arrangement would have done."""
        if math.isnan(self.least):
            return "no shared start with two rollouts"
        if self.least > GATE_LEVEL:
            return "cannot be decided with so few seeds"
        return "passed" if self.p <= GATE_LEVEL else "not passed"


def gate(
    methods: Sequence[Floats], rng: np.random.Generator, permutations: int = RESAMPLES
) -> Gate:
    """Whether the methods, each ``(seeds,)``, differ more than their training seeds do.

    A one-way ANOVA whose null exchanges which method a seed belongs to, ``permutations`` times. The
    observed way counts among those as extreme, so p is never zero and is valid for any number.
    Methods without seeds, those that share no start, cannot be compared.
    """
    if not all(map(len, methods)):
        return Gate(math.nan, math.nan)
    sizes, values = np.array(list(map(len, methods))), np.concatenate(methods)
    ways = math.factorial(len(values)) // math.prod(map(math.factorial, sizes.tolist()))
    alike = math.prod(math.factorial(int((sizes == size).sum())) for size in np.unique(sizes))
    least = max(alike / ways, 1 / (1 + permutations))
    if len(values) == len(sizes):  # one seed each: nothing varies within a method
        return Gate(math.nan, 1.0)
    labels = np.repeat(np.arange(len(sizes)), sizes)
    dealt = rng.permuted(np.broadcast_to(labels, (permutations, len(labels))), axis=1)
    # Squares between methods: the total stays, so they order the ways as F does.
    belongs = np.stack([labels, *dealt])[:, None] == np.arange(len(sizes))[:, None]
    between = ((belongs * (values - values.mean())).sum(axis=-1) ** 2 / sizes).sum(axis=-1)
    at_least = int(np.count_nonzero(between[1:] >= between[0] * (1 - 1e-9)))
    return Gate((1 + at_least) / (1 + permutations), least)


# -- whole evaluations ----------------------------------------------------------------------------


@dataclass(frozen=True, eq=False, kw_only=True)
class Evaluation:
    """The tables of an evaluation, each a tidy data frame, and the verdict on one method.

    ``metrics`` has one row per rollout and recording, ``comparison`` one per method, metric and
    counting rule, ``pairs`` one per ordered pair of methods.
    ``fingerprint`` is that of the evaluated demonstrations.
    """

    metrics: pd.DataFrame
    comparison: pd.DataFrame
    pairs: pd.DataFrame
    verdict: Verdict
    fingerprint: str
    seed: int
    resamples: int

    def save(self, folder: str | Path) -> Path:
        """Write a CSV per table, the verdict and ``evaluation.json``, each whole or not at all."""
        folder = Path(folder)
        for name in TABLES:
            with write_then_rename(folder / f"{name}.csv") as part:
                getattr(self, name).to_csv(part, index=False)
        self.verdict.save(folder)
        with write_then_rename(folder / "evaluation.json") as part:
            part.write_text(
                json.dumps({key: getattr(self, key) for key in NUMBERS}, indent=2) + "\n"
            )
        return folder

    @classmethod
    def load(cls, folder: str | Path) -> Evaluation:
        """Read what :meth:`save` wrote, or raise InputError if a file is missing or damaged."""
        folder = Path(folder)
        try:
            numbers = read_json(folder / "evaluation.json")
            tables: dict[str, Any] = {n: statistics.read_table(folder / f"{n}.csv") for n in TABLES}
            return cls(**tables, **numbers, verdict=Verdict.load(folder))
        except FileNotFoundError as error:
            raise InputError(
                f"{folder}: {Path(error.filename).name} is missing: evaluate the run again"
            ) from None
        except (ValueError, TypeError) as error:
            raise InputError(
                f"{folder}: the evaluation is damaged ({error}): evaluate the run again"
            ) from error


def evaluate(
    rollouts: Mapping[str, Rollouts],
    demos: Demonstrations,
    *,
    seed: int,
    learner: str | None = None,
    floor: Tracking | None = None,
    references: Demonstrations | None = None,
    resamples: int = RESAMPLES,
    questions: Questions = AS_BUILT,
) -> Evaluation:
    """Measure and compare the rollouts of several methods.

    Rollouts from the start of a recording that was cut stop there too, as in the verdict.

    Parameters
    ----------
    rollouts
        By method name, all its seeds and cues joined.
    demos
        The evaluated demonstrations, which the rollouts started from.
    seed
        Of the resampling.
    learner
        The method that the verdict is about; the first by default.
    floor, references, questions
        See :func:`~animarl_algos.evaluation.verdict.verdict`.
    """
    if not rollouts:
        raise InputError("there are no rollouts to evaluate: collect those of one method at least")
    learner = learner or next(iter(rollouts))
    if learner not in rollouts:
        raise InputError(
            f"there are no rollouts of {learner!r}: choose one of {', '.join(rollouts)}"
        )
    tables = [measure_recordings(demos)]
    for name, some in rollouts.items():  # nothing is known of what came after a cut
        tables.append(measure(censored(some, demos), demos).assign(method=name))
    metrics = pd.concat(tables, ignore_index=True)
    compared = set(metrics.loc[metrics["factual"], "method"])
    for name in rollouts:
        if name not in compared:
            raise InputError(
                f"no rollout of {name!r} is in the condition of its recording: collect them with "
                "condition='demo' and the actual cue"
            )
    streams = np.random.default_rng(seed).spawn(4)
    unit = np.unique(demos.recording, return_inverse=True)[1].astype(np.int64)
    return Evaluation(
        metrics=metrics,
        comparison=comparison_table(metrics, unit, streams[0], resamples=resamples),
        pairs=pair_table(metrics, unit, streams[3], resamples=resamples),
        verdict=verdict(
            demos,
            replace(rollouts[learner], method=learner),
            seed=seed,
            floor=floor,
            baselines={name: r for name, r in rollouts.items() if name != learner},
            references=references,
            questions=questions,
        ),
        fingerprint=demos.fingerprint(),
        seed=seed,
        resamples=resamples,
    )


def write_tables(tables: Mapping[str, pd.DataFrame], folder: str | Path) -> None:
    """Every table that has columns as ``NAME.csv`` and ``NAME.parquet``, whole or not at all.

    Their column ``reason`` says why a number of the row is missing; reasons that a table has
    already are kept.
    """
    for name, table in tables.items():
        if not len(table.columns):
            continue
        given = table["reason"].fillna("") if "reason" in table else [""] * len(table)
        reasons = []
        for own, (_, row) in zip(given, table.iterrows()):
            missing = [str(k) for k, one in row.items() if isinstance(one, float) and np.isnan(one)]
            why = f"not defined with so few values: {', '.join(missing)}" if missing else ""
            reasons.append(str(own) or why)
        tidy = table.assign(reason=reasons)
        with write_then_rename(Path(folder) / f"{name}.csv") as part:
            tidy.to_csv(part, index=False)
        with write_then_rename(Path(folder) / f"{name}.parquet") as part:
            tidy.to_parquet(part, index=False, engine="pyarrow")
