"""Does a simulator move like the recordings? One row per question, one word for each.

A row is a difference, simulated minus recorded, with an interval and a tolerance, from which its
word follows (:mod:`animarl_algos.evaluation.verdict_rows`).
Two classifiers are rows of the same kind (:mod:`animarl_algos.evaluation.classifier`). Beside them
stands the realism score (:mod:`animarl_algos.evaluation.realism`).
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from animarl_algos.evaluation import statistics
from animarl_algos.evaluation.classifier import AUC, classify_all, tracked_rollouts
from animarl_algos.evaluation.headline import count_judgements, list_complaints, write_headline
from animarl_algos.evaluation.laws import LAW, Law
from animarl_algos.evaluation.metrics import summary_table
from animarl_algos.evaluation.prepared import Prepared, comparison_smoothing
from animarl_algos.evaluation.ranks import rank_recordings
from animarl_algos.evaluation.realism import realism
from animarl_algos.evaluation.rollouts import Rollouts
from animarl_algos.evaluation.statistics import UNDEFINED, Interval, interval
from animarl_algos.evaluation.verdict_rows import (
    ALIKE,
    AS_BUILT,
    BLIND,
    COLOURS,
    CONTROLS,
    DIFFERS,
    LITTLE,
    STRANGERS,
    UNKNOWN,
    Comparison,
    Questions,
    Row,
    classifier_row,
    strangers,
)
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.errors import InputError
from animarl_envs.files import read_json, write_then_rename
from animarl_envs.fitting.tracking import Tracking


@dataclass(frozen=True, eq=False, kw_only=True)
class Verdict:
    """How a method's rollouts compare with the recordings.

    Parameters
    ----------
    table
        One row per question, its columns the fields of :class:`Row`.
    learner
        The method.
    recordings, starts, rollouts
        How many count; of a policy that always does the same, one rollout a start.
    smoothing
        Frames of the moving average that both sides went through.
    areas
        By classifier and name the areas that theirs are read beside
        (:class:`~animarl_algos.evaluation.classifier.ClassifierResult`).
    components
        The realism score, see :func:`~animarl_algos.evaluation.realism.realism`.
    importance
        By kind of feature, how much of the area rests on it.
    worse_than_untrained
        Whether an untrained network comes nearer to the recordings.
    ranks, rank_p
        By measure the rank of each recording among the rollouts from its start, from 0 to 1, and
        how often a perfect simulator's are as uneven (:mod:`animarl_algos.evaluation.ranks`).
    """

    table: pd.DataFrame
    learner: str
    recordings: int
    starts: int
    rollouts: int
    smoothing: int = 1
    areas: Mapping[str, Mapping[str, Interval]] = field(default_factory=dict)
    components: pd.DataFrame | None = None
    importance: Mapping[str, float]
    worse_than_untrained: bool = False
    ranks: Mapping[str, list[float]] = field(default_factory=dict)
    rank_p: float = math.nan

    @property
    def counts(self) -> dict[str, int]:
        """How many questions have each word."""
        return count_judgements(self.rows())

    @property
    def judgement(self) -> str:
        """The word for all questions: what differs is said, then what is not known."""
        words = set(self.table["judgement"])
        return next((one for one in (DIFFERS, UNKNOWN, LITTLE) if one in words), ALIKE)

    @property
    def colour(self) -> str:
        """Red where a row differs, grey where something is not known, green where neither is."""
        colour = COLOURS[self.judgement]
        return COLOURS[ALIKE] if self.judgement == LITTLE else colour

    @property
    def complaints(self) -> tuple[str, ...]:
        """What differs, farthest from alike first."""
        return list_complaints(self.rows())

    @property
    def headline(self) -> str:
        """How many questions have which word, what differs, and how many recordings would tell."""
        return write_headline(self.rows(), self.recordings)

    @property
    def auc(self) -> Interval:
        """The classifier's area on two seconds."""
        return interval(self.row(AUC))

    @property
    def realism(self) -> Interval:
        """The realism score."""
        return UNDEFINED if self.components is None else interval(self.components.iloc[-1])

    def rows(self) -> list[Row]:
        """Return the rows of the table."""
        return [Row(**{str(k): v for k, v in row.items()}) for row in self.table.to_dict("records")]

    def row(self, measure: str) -> dict[str, Any]:
        """Return the row of one measure, by column."""
        chosen = self.table[self.table["measure"] == measure]
        return {str(column): chosen[column].iloc[0] for column in chosen}

    def save(self, folder: str | Path) -> None:
        """Write ``verdict.csv``, ``verdict.json`` and ``realism.csv`` into a folder."""
        plain = dict(vars(self))
        for file, key in (("verdict.csv", "table"), ("realism.csv", "components")):
            if (table := plain.pop(key)) is not None:
                with write_then_rename(Path(folder) / file) as part:
                    table.to_csv(part, index=False)
        summary = {"headline": self.headline, "colour": self.colour, "counts": self.counts}
        with write_then_rename(Path(folder) / "verdict.json") as part:
            part.write_text(json.dumps(summary | _plain(plain), indent=2))

    @classmethod
    def load(cls, folder: str | Path) -> Verdict:
        """Read what :meth:`save` wrote."""
        folder = Path(folder)
        plain = _with_nan(read_json(folder / "verdict.json"))
        for some in plain["areas"].values():
            some |= {name: Interval(*ends) for name, ends in some.items()}
        plain = {key: plain[key] for key in plain if key not in ("headline", "colour", "counts")}
        file = folder / "realism.csv"
        return cls(
            table=statistics.read_table(folder / "verdict.csv"),
            components=statistics.read_table(file) if file.exists() else None,
            **plain,
        )


def _plain(value: Any) -> Any:
    if isinstance(value, Interval):
        return [_plain(end) for end in (value.estimate, value.low, value.high)]
    if isinstance(value, Mapping):
        return {key: _plain(one) for key, one in value.items()}
    if isinstance(value, list):
        return [_plain(one) for one in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _with_nan(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _with_nan(one) for key, one in value.items()}
    if isinstance(value, list):
        return [_with_nan(one) for one in value]
    return math.nan if value is None else value


def compare(
    recorded: Demonstrations, rollouts: Rollouts, seed: int, questions: Questions = AS_BUILT
) -> tuple[Comparison, list[np.random.Generator]]:
    """Compare recordings with the rollouts that count, and return the other random streams."""
    if rollouts.individuals != recorded.individuals or rollouts.demo.max() >= len(recorded):
        raise InputError(
            f"the rollouts of {rollouts.method} were not made from {recorded.name}: "
            "compare them with the demonstrations they started from"
        )
    prepared = Prepared(recorded, comparison_smoothing(recorded))
    first, *streams = np.random.default_rng(seed).spawn(8)
    return Comparison.of(prepared, prepared.counted(rollouts), first, questions), streams


def verdict(
    recorded: Demonstrations,
    rollouts: Rollouts,
    *,
    seed: int,
    floor: Tracking | None = None,
    baselines: Mapping[str, Rollouts] | None = None,
    references: Demonstrations | None = None,
    questions: Questions = AS_BUILT,
) -> Verdict:
    """Judge a method by its rollouts.

    Raises InputError if the rollouts are not of these demonstrations, or none is in their
    condition.

    Parameters
    ----------
    recorded
        The evaluated demonstrations, of the validation or the test split.
    rollouts
        From their starts. Those in another condition than recorded, or told another one, are left
        out.
    seed
        Of exchanges, folds and resamples.
    floor
        The same demonstrations as the fitted locomotion follows them, to read areas by.
    baselines
        Rollouts of ``"random"`` actions, for the upper end of the classifier's scale, of an
        ``"untrained"`` network, which a trained one should beat, and of a group's ``"blind"`` one,
        which does not see its neighbours.
    references
        Other recordings, for recordings against recordings; by default halves of ``recorded``.
    questions
        Tolerances and primary measures of the user's choice.

    All positions go through the moving average of
    :func:`~animarl_algos.evaluation.prepared.comparison_smoothing` first.
    """
    baselines = baselines or {}
    compared, streams = compare(recorded, rollouts, seed, questions)
    prepared, counted, unit = compared.prepared, compared.counted, compared.unit
    random, others = baselines.get("random"), None
    if references is not None:
        others = prepared.filtered(Rollouts.from_demonstrations(references))
    controls = {LAW: Law.fit(others or prepared.recorded).rollouts(prepared, streams[4])}
    controls |= {} if random is None else {"random": prepared.counted(random)}
    if (mixed := strangers(prepared)) is not None:
        controls[STRANGERS] = mixed
    if BLIND in baselines:
        controls[BLIND] = prepared.counted(baselines[BLIND])
    rows = list(compared.rows(controls))
    sides = {} if random is None else {"ceiling": random.factual(recorded)}
    sides |= {} if floor is None else {"floor": tracked_rollouts(recorded, floor)}
    beside = {name: prepared.filtered(one) for name, one in sides.items()}
    answers = list(classify_all(prepared, counted, beside, references, unit, streams[:3]))
    rows += [classifier_row(*answer) for answer in answers]
    components = realism(
        prepared, counted, streams[3], references=others, random=beside.get("ceiling")
    )
    untrained = baselines.get("untrained")
    worse = False
    if untrained is not None:
        # By the energy score of the summary; the interval over recordings must exclude zero.
        true = summary_table(prepared, prepared.recorded)
        ours, other = (
            statistics.energy_scores(summary_table(prepared, one), one.demo, true)
            for one in (counted, prepared.counted(untrained))
        )
        apart = statistics.single_cells((ours - other)[None]).by_unit(unit)
        worse = statistics.bootstrap_mean(apart, streams[5]).low > 0
    table = pd.DataFrame(rows)
    starts, ranks = np.unique(counted.demo), rank_recordings(compared, streams[6])
    return Verdict(
        table=table.drop(columns=[name for name in CONTROLS if table[name].isna().all()]),
        learner=rollouts.method,
        recordings=len(np.unique(unit[starts])),
        starts=len(starts),
        rollouts=int(np.count_nonzero(~counted.copies)),
        smoothing=prepared.smoothing,
        areas={key: dict(result.areas) for key, _, result in answers},
        components=components,
        importance=answers[0][2].importance,
        worse_than_untrained=bool(worse),
        ranks=dict(zip(ranks.measures, ranks.values.T.tolist())),
        rank_p=ranks.p,
    )
