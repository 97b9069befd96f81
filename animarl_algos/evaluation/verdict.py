"""Does a simulator move like the recordings? One row per question, one judgement for all.

Every row compares recordings and rollouts from the same starts, says how far apart they are, what
chance alone would give, and puts it in words: endings, motion and order in time in
:mod:`animarl_algos.evaluation.verdict_rows`, two judges in
:mod:`animarl_algos.evaluation.classifier`. Beside them stands the realism score, how likely the
recordings are under the rollouts (:mod:`animarl_algos.evaluation.realism`).
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
from animarl_algos.evaluation.classifier import AUC, SEQUENCE, followed, judges
from animarl_algos.evaluation.metrics import measures
from animarl_algos.evaluation.prepared import Prepared, comparison_smoothing
from animarl_algos.evaluation.realism import REFERENCES, realism
from animarl_algos.evaluation.rollouts import Rollouts
from animarl_algos.evaluation.statistics import UNDEFINED, Floats, Interval, Ints, interval
from animarl_algos.evaluation.verdict_rows import (
    BY_LITTLE,
    CONTROLS,
    DIFFERS,
    OUTCOMES,
    SAME,
    UNKNOWN,
    JointTests,
    Row,
    verdict_rows,
)
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.errors import InputError
from animarl_envs.files import write_then_rename
from animarl_envs.fitting.tracking import Tracking

FEWEST = 10  # test starts, and recordings that they are of: below, there is too little to say
WORSE = "worse than untrained"
SUMMARY = ("duration", "path_length", "mean_speed")  # what methods are ranked by
WORDS = {"reason", "gate", "unit", "covers"}
HALF = 0.5  # of the recorded value: a larger gap is implausible
LEAST_SHARE = 0.1  # of episodes, that an implausible gap of shares has at least


@dataclass(frozen=True, eq=False, kw_only=True)
class Verdict:
    """How a method's rollouts compare with the recordings.

    Parameters
    ----------
    table
        One row per question, its columns the fields of
        :class:`~animarl_algos.evaluation.verdict_rows.Row`. In the rows of the two judges,
        ``recorded`` and ``null`` are those of recordings among themselves.
    words
        What differs, in the order of its weight; where nothing does, what differs by little; where
        nothing does that either, ``("not distinguishable",)``.
    learner
        The method.
    starts, rollouts
        How many count; of a policy that always does the same, one rollout a start.
    too_little
        Why there is too little data to say anything; empty where there is enough.
    smoothing
        Frames of the moving average that both sides went through.
    areas
        By judge and name the areas that theirs are read beside
        (:class:`~animarl_algos.evaluation.classifier.Telling`).
    components
        The realism score, see :func:`~animarl_algos.evaluation.realism.realism`.
    importance
        By kind of feature, how much of the area rests on it.
    """

    table: pd.DataFrame
    words: tuple[str, ...]
    learner: str
    starts: int
    rollouts: int
    too_little: str = ""
    smoothing: int = 1
    areas: Mapping[str, Mapping[str, Interval]] = field(default_factory=dict)
    components: pd.DataFrame | None = None
    importance: Mapping[str, float]

    @property
    def overall(self) -> str:
        """All words in one line."""
        return ", ".join(self.words)

    @property
    def judgement(self) -> str:
        """The headline, which says no more than the weakest row."""
        if self.too_little:
            return UNKNOWN
        found = set(self.table["judgement"])
        return next(one for one in (DIFFERS, UNKNOWN, BY_LITTLE, SAME) if one in found)

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

    def row(self, measure: str) -> dict[str, Any]:
        """The row of one measure, by column."""
        chosen = self.table[self.table["measure"] == measure]
        return {str(column): chosen[column].iloc[0] for column in chosen}

    def save(self, folder: str | Path) -> None:
        """Write ``verdict.csv``, ``verdict.json`` and ``realism.csv`` into a folder."""
        plain = dict(vars(self))
        for file, key in (("verdict.csv", "table"), ("realism.csv", "components")):
            if (table := plain.pop(key)) is not None:
                with write_then_rename(Path(folder) / file) as part:
                    table.to_csv(part, index=False)
        with write_then_rename(Path(folder) / "verdict.json") as part:
            part.write_text(json.dumps(_plain(plain), indent=2))

    @classmethod
    def load(cls, folder: str | Path) -> Verdict:
        """Read what :meth:`save` wrote."""
        folder = Path(folder)
        plain = json.loads((folder / "verdict.json").read_text())
        for some in plain["areas"].values():
            for name, ends in some.items():
                value, low, high = (math.nan if end is None else end for end in ends)
                some[name] = Interval(value, low, high)
        plain |= {"table": read_table(folder / "verdict.csv"), "words": tuple(plain["words"])}
        file = folder / "realism.csv"
        return cls(components=read_table(file) if file.exists() else None, **plain)


def read_table(file: Path) -> pd.DataFrame:
    """Read a table as it was written: a column of :data:`WORDS` may be empty throughout."""
    try:
        table = pd.read_csv(file, float_precision="round_trip")
    except pd.errors.EmptyDataError:
        return pd.DataFrame()
    for words in WORDS & set(table):
        table[words] = table[words].astype(object).fillna("")
    return table


def _plain(value: Any) -> Any:
    if isinstance(value, Interval):
        return [_plain(end) for end in (value.estimate, value.low, value.high)]
    if isinstance(value, Mapping):
        return {key: _plain(one) for key, one in value.items()}
    return None if isinstance(value, float) and not math.isfinite(value) else value


def compared(
    recorded: Demonstrations, rollouts: Rollouts, seed: int
) -> tuple[Prepared, Rollouts, JointTests, Ints, list[np.random.Generator]]:
    """Recordings and the rollouts that count, their tests, what is resampled, and random streams.

    What is resampled ``(starts,)`` are recordings; starts where each is of its own, or all of one.
    """
    if rollouts.individuals != recorded.individuals or rollouts.demo.max() >= len(recorded):
        raise InputError(
            f"the rollouts of {rollouts.method} were not made from {recorded.name}: "
            "compare them with the demonstrations they started from"
        )
    prepared = Prepared(recorded, comparison_smoothing(recorded))
    names, group = np.unique(recorded.recording, return_inverse=True)
    own = len(names) in (1, len(recorded))
    streams, counted = np.random.default_rng(seed).spawn(7), prepared.counted(rollouts)
    tests = JointTests.of(prepared, counted, None if own else group, streams[0])
    return prepared, counted, tests, np.arange(len(recorded)) if own else group, streams


def verdict(
    recorded: Demonstrations,
    rollouts: Rollouts,
    *,
    seed: int,
    floor: Tracking | None = None,
    baselines: Mapping[str, Rollouts] | None = None,
    references: Demonstrations | None = None,
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

    All positions go through the moving average of
    :func:`~animarl_algos.evaluation.prepared.comparison_smoothing` first.
    """
    baselines = baselines or {}
    prepared, counted, tests, unit, streams = compared(recorded, rollouts, seed)
    unseeing = prepared.counted(baselines["blind"]) if "blind" in baselines else None
    rows = verdict_rows(tests, streams[0], unseeing)
    random = baselines.get("random")
    sides = {} if random is None else {"ceiling": random.factual(recorded)}
    sides |= {} if floor is None else {"floor": followed(recorded, floor)}
    beside = {name: prepared.filtered(one) for name, one in sides.items()}
    asked = [*judges(prepared, counted, beside, references, unit, (*streams[1:3], streams[4]))]
    rows += [row for row, _ in asked]
    others = None
    if references is not None:
        others = prepared.filtered(Rollouts.from_demonstrations(references))
    components = realism(
        prepared, counted, streams[5], references=others, random=beside.get("ceiling")
    )
    words, untrained = _overall(rows), baselines.get("untrained")
    if untrained is not None and words != (SAME,):
        # By the energy score of the summary; the interval over starts must exclude no difference.
        true = summary_table(prepared, prepared.recorded)
        ours, other = (
            statistics.energy_scores(summary_table(prepared, one), one.demo, true)
            for one in (counted, prepared.counted(untrained))
        )
        apart = statistics.single_cells((ours - other)[None])
        if statistics.bootstrap_mean(apart, streams[3]).low > 0:
            words = (WORSE, *words)
    table = pd.DataFrame(rows)
    starts = np.unique(counted.demo)
    numbers = {"test start": len(starts), "recording": len(np.unique(recorded.recording[starts]))}
    few = [f"{n} {name}{'s' * (n != 1)}" for name, n in numbers.items() if n < FEWEST]
    return Verdict(
        table=table.drop(columns=[name for name in CONTROLS if table[name].isna().all()]),
        words=words,
        learner=rollouts.method,
        starts=len(starts),
        rollouts=int(np.count_nonzero(~counted.copies)),
        too_little=f"{few[0]}, and {FEWEST} are needed" if few else "",
        smoothing=prepared.smoothing,
        areas={row.measure: dict(found.areas) for row, found in asked},
        components=components,
        importance=asked[0][1].importance,
    )


def _overall(rows: list[Row]) -> tuple[str, ...]:
    """Return what differs (else what differs by little), each thing once.

    The judges and the endings together come in only if nothing else is said.
    """
    for judgement in (DIFFERS, BY_LITTLE):
        plain = {row.measure: row.verdict for row in rows if row.judgement == judgement}
        rest = [plain.pop(key) for key in (OUTCOMES, AUC, SEQUENCE) if key in plain]
        if "leaving" in plain:  # who left is in the table
            plain = {k: v for k, v in plain.items() if k not in ("target_out", "pursuer_out")}
        if plain or rest:
            return tuple(dict.fromkeys(plain.values())) or tuple(rest)
    return (SAME,)


def summary_table(prepared: Prepared, rollouts: Rollouts) -> Floats:
    """Duration, path length and speed ``(rollouts, 3)``, each in units of its recorded spread."""
    true, found = (measures(prepared, side) for side in (prepared.recorded, rollouts))
    return np.stack([found[key] / (float(np.std(true[key])) or 1.0) for key in SUMMARY], axis=1)


def implausible(verdict: Verdict) -> list[str]:
    """What is off by more than half of what was recorded, and whether training made it worse.

    Median speed, duration and the share of each ending, where chance does not explain it, are
    looked at. One sentence each; none where nothing is.
    """
    found = []
    if WORSE in verdict.words:
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
        if key in shares and row["judgement"] == SAME:  # few episodes are off by half by chance
            continue
        values = (
            f"{100 * simulated:.0f} % simulated, {100 * recorded:.0f} % recorded"
            if key in shares
            else f"{simulated:.3g} {row['unit']} simulated, {recorded:.3g} {row['unit']} recorded"
        )
        found.append(f"{row['label']} is off by more than half: {values}.")
    return found
