"""Does a simulator move like the recordings? One row per question, one word for each.

A row is a difference, simulated minus recorded, with an interval and a tolerance, from which its
word follows (:mod:`animarl_algos.evaluation.verdict_rows`).
Two classifiers are rows of the same kind (:mod:`animarl_algos.evaluation.classifier`). Beside them
stands the realism score (:mod:`animarl_algos.evaluation.realism`).
"""

from __future__ import annotations

import io
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from animarl_algos.evaluation import statistics
from animarl_algos.evaluation.classifier import AUC, SEQUENCE, classify_all, tracked_rollouts
from animarl_algos.evaluation.laws import LAW, Law
from animarl_algos.evaluation.metrics import measures
from animarl_algos.evaluation.prepared import Prepared, comparison_smoothing
from animarl_algos.evaluation.realism import REFERENCES, realism
from animarl_algos.evaluation.rollouts import Rollouts
from animarl_algos.evaluation.statistics import UNDEFINED, Floats, Interval, interval
from animarl_algos.evaluation.verdict_rows import (
    ALIKE,
    AS_BUILT,
    BLIND,
    COLOURS,
    CONTROLS,
    DIFFERS,
    JUDGEMENTS,
    LITTLE,
    STRANGERS,
    UNKNOWN,
    Comparison,
    Questions,
    Row,
    classifier_row,
    farness,
    lower_first,
    rounded_count,
    strangers,
)
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.errors import InputError
from animarl_envs.files import read_json, read_regular, write_then_rename
from animarl_envs.fitting.tracking import Tracking

MIN_TEST_RECORDINGS = 10  # below, runs are cross-validated where that makes them more
MOST_COMPLAINTS = 3  # of one sentence
SUMMARY = ("duration", "path_length", "mean_speed")  # what methods are ranked by
NOTICED = ("mean_speed", "duration", "turning", "nearest_neighbour")  # changes beside the headline
LONGEST_TABLE = 64 * 2**20  # [bytes]
TEXT_COLUMNS = {"reason", "gate", "unit", "covers", "verdict"}
HALF = 0.5  # of the recorded value: a larger gap is implausible
LEAST_SHARE = 0.1  # of episodes, that an implausible gap of shares has at least


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
        return {word: int((self.table["judgement"] == word).sum()) for word in JUDGEMENTS}

    @property
    def judgement(self) -> str:
        """The word for all questions: what differs is said, then what is not known."""
        found = set(self.table["judgement"])
        return next((one for one in (DIFFERS, UNKNOWN, LITTLE) if one in found), ALIKE)

    @property
    def colour(self) -> str:
        """Red where a row differs, grey where something is not known, green where neither is."""
        colour = COLOURS[self.judgement]
        return COLOURS[ALIKE] if self.judgement == LITTLE else colour

    @property
    def complaints(self) -> tuple[str, ...]:
        """What differs, each thing once, farthest from alike first; classifiers come last.

        Who left is in the table where somebody was outside the arena.
        """
        rows = sorted(self.rows(DIFFERS), key=farness, reverse=True)
        rows.sort(key=lambda row: row.measure in (AUC, SEQUENCE))
        if any(row.measure == "leaving" for row in rows):
            rows = [row for row in rows if row.measure not in ("target_out", "pursuer_out")]
        return tuple(dict.fromkeys(row.verdict for row in rows))

    @property
    def headline(self) -> str:
        """How many questions have which word, what differs, and how many recordings would tell."""
        counts, total = self.counts, len(self.table)
        parts = []
        if counts[ALIKE]:
            parts.append(_count_words(counts[ALIKE], "are alike", "is alike"))
        if counts[LITTLE]:
            parts.append(_count_words(counts[LITTLE], "differ a little", "differs a little"))
        if counts[DIFFERS]:
            first = self.complaints[:MOST_COMPLAINTS]
            more = len(self.complaints) - len(first)
            said = "; ".join(first) + (f"; and {more} more" if more else "")
            parts.append(f"{_count_words(counts[DIFFERS], 'differ', 'differs')} ({said})")
        if counts[UNKNOWN]:
            said = _count_words(counts[UNKNOWN], "are not known", "is not known")
            many = f"{self.recordings} recording{'s' * (self.recordings != 1)}"
            said += f": {many} {'are' if self.recordings != 1 else 'is'} too few"
            needed = sorted(row.needed for row in self.rows(UNKNOWN) if math.isfinite(row.needed))
            if needed:
                half, most = needed[(len(needed) - 1) // 2], needed[-1]
                said += f"; about {rounded_count(half):,} would tell"
                if rounded_count(most) > rounded_count(half):
                    said += f" half of them, about {rounded_count(most):,} all"
            parts.append(said)
        return f"Of {total} question{'s' * (total != 1)} {', '.join(parts)}."

    @property
    def detectable(self) -> dict[str, tuple[float, str]]:
        """The smallest changes that these recordings show, by label: part of the recorded mean."""
        found = {}
        for row in self.rows():
            if row.measure in NOTICED and row.recorded and math.isfinite(row.detectable):
                found[lower_first(row.label)] = (row.detectable / abs(row.recorded), row.unit)
        return found

    @property
    def beside_law(self) -> str:
        """In how many questions the simulator is nearer to the recordings than the law, or not."""
        rows = [row for row in self.rows() if math.isfinite(row.law + row.simulated)]
        better = [row for row in rows if abs(row.value) < abs(row.law - row.recorded)]
        worse = [lower_first(row.label) for row in rows if row not in better]
        if not rows:
            return ""
        said = (
            f"Nearer to the recordings than a simple law in {len(better)} of {len(rows)} questions"
        )
        more = len(worse) - MOST_COMPLAINTS
        listed = ", ".join(worse[:MOST_COMPLAINTS]) + (f" and {more} more" if more > 0 else "")
        return said + (f"; not in {listed}." if worse else ".")

    @property
    def auc(self) -> Interval:
        """The classifier's area on two seconds."""
        return interval(self.row(AUC))

    @property
    def realism(self) -> Interval:
        """The realism score."""
        return UNDEFINED if self.components is None else interval(self.components.iloc[-1])

    @property
    def realism_beside(self) -> dict[str, float]:
        """The scores that realism is read beside, by name."""
        if self.components is None:
            return {}
        total = self.components.iloc[-1]
        return {name: float(total[name]) for name in REFERENCES if name in total}

    def rows(self, *words: str) -> list[Row]:
        """Return the rows, or those with one of these words."""
        rows = [Row(**{str(k): v for k, v in row.items()}) for row in self.table.to_dict("records")]
        return [row for row in rows if not words or row.judgement in words]

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
        said = {"headline": self.headline, "colour": self.colour, "counts": self.counts}
        with write_then_rename(Path(folder) / "verdict.json") as part:
            part.write_text(json.dumps(said | _plain(plain), indent=2))

    @classmethod
    def load(cls, folder: str | Path) -> Verdict:
        """Read what :meth:`save` wrote."""
        folder = Path(folder)
        plain = read_json(folder / "verdict.json")
        for some in plain["areas"].values():
            for name, ends in some.items():
                value, low, high = (math.nan if end is None else end for end in ends)
                some[name] = Interval(value, low, high)
        plain = {key: plain[key] for key in plain if key not in ("headline", "colour", "counts")}
        plain["rank_p"] = math.nan if plain["rank_p"] is None else plain["rank_p"]
        plain["ranks"] = {
            name: [math.nan if one is None else one for one in ranks]
            for name, ranks in plain["ranks"].items()
        }
        file = folder / "realism.csv"
        return cls(
            table=read_table(folder / "verdict.csv"),
            components=read_table(file) if file.exists() else None,
            **plain,
        )


def _count_words(count: int, many: str, one: str) -> str:
    return f"{count} {one if count == 1 else many}"


def read_table(file: Path) -> pd.DataFrame:
    """Read a table as it was written: a column of ``TEXT_COLUMNS`` may be empty throughout."""
    try:
        content = io.BytesIO(read_regular(file, LONGEST_TABLE))
        table = pd.read_csv(content, float_precision="round_trip")
    except pd.errors.EmptyDataError:
        return pd.DataFrame()
    for words in TEXT_COLUMNS & set(table):
        table[words] = table[words].astype(object).fillna("")
    return table


def _plain(value: Any) -> Any:
    if isinstance(value, Interval):
        return [_plain(end) for end in (value.estimate, value.low, value.high)]
    if isinstance(value, Mapping):
        return {key: _plain(one) for key, one in value.items()}
    if isinstance(value, list):
        return [_plain(one) for one in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


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
    first, *streams = np.random.default_rng(seed).spawn(7)
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
    starts, ranks = np.unique(counted.demo), compared.ranks
    return Verdict(
        table=table.drop(columns=[name for name in CONTROLS if table[name].isna().all()]),
        learner=rollouts.method,
        recordings=len(np.unique(unit[starts])),
        starts=len(starts),
        rollouts=int(np.count_nonzero(~counted.copies)),
        smoothing=prepared.smoothing,
        areas={key: dict(found.areas) for key, _, found in answers},
        components=components,
        importance=answers[0][2].importance,
        worse_than_untrained=bool(worse),
        ranks={} if ranks is None else dict(zip(ranks.measures, ranks.values.T.tolist())),
        rank_p=math.nan if ranks is None else ranks.p,
    )


def summary_table(prepared: Prepared, rollouts: Rollouts) -> Floats:
    """Duration, path length and speed ``(rollouts, 3)``, each in units of its recorded spread."""
    true, found = (measures(prepared, side) for side in (prepared.recorded, rollouts))
    return np.stack([found[key] / (float(np.std(true[key])) or 1.0) for key in SUMMARY], axis=1)


def implausible(verdict: Verdict) -> list[str]:
    """What is off by more than half of what was recorded, and whether training made it worse.

    Median speed, duration and the share of each ending, where they are not merely unknown, are
    looked at. One sentence each; none where nothing is.
    """
    found = []
    if verdict.worse_than_untrained:
        found.append(
            "An untrained network comes nearer to the recordings than the trained one: train "
            "longer, on more episodes, or with another learner, before anything is concluded."
        )
    shares = ("reached", "target_out", "pursuer_out")
    known = set(verdict.table["measure"])
    for key in ("median_speed", "duration", *shares):
        if key not in known:
            continue
        row = verdict.row(key)
        recorded, simulated = float(row["recorded"]), float(row["simulated"])
        least = max(HALF * abs(recorded), LEAST_SHARE if key in shares else 0.0)
        if not abs(simulated - recorded) > least:
            continue
        if key in shares and row["judgement"] != DIFFERS:  # few are off by half by chance
            continue
        values = (
            f"{100 * simulated:.0f} % simulated, {100 * recorded:.0f} % recorded"
            if key in shares
            else f"{simulated:.3g} {row['unit']} simulated, {recorded:.3g} {row['unit']} recorded"
        )
        found.append(f"{row['label']} is off by more than half: {values}.")
    return found
