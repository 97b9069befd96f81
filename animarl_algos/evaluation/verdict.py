"""Does a simulator move like the recordings? One row per question, one line of words for all.

Every row compares recordings and rollouts from the same starts, says how far apart they are, what
chance alone would give (:mod:`animarl_algos.evaluation.null`), and puts it in words: endings and
motion in :mod:`animarl_algos.evaluation.verdict_rows`, the classifier in
:mod:`animarl_algos.evaluation.classifier_row`.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from animarl_algos.evaluation.classifier_row import AUC, Classified, Tracked, auc_row
from animarl_algos.evaluation.energy_score import energy_scores
from animarl_algos.evaluation.prepared import Prepared, factual
from animarl_algos.evaluation.rollouts import Rollouts
from animarl_algos.evaluation.statistics import UNDEFINED, Interval, bootstrap_mean, cells
from animarl_algos.evaluation.verdict_rows import (
    BY_LITTLE,
    DIFFERS,
    OUTCOMES,
    SAME,
    UNKNOWN,
    rows_of,
)
from animarl_algos.evaluation.windows import comparison_smoothing
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.errors import InputError
from animarl_envs.files import write_then_rename

if TYPE_CHECKING:
    import pandas as pd

Floats = NDArray[np.float64]

FEWEST = 10  # test starts, and recordings that they are of: below, there is too little to say
WORSE = "worse than untrained"
SUMMARY = ("duration", "path_length", "mean_speed")  # what methods are ranked by
AREAS = ("auc", "among", "floor", "perturbed", "ceiling")


@dataclass(frozen=True, eq=False, kw_only=True)
class Verdict:
    """How a method's rollouts compare with the recordings.

    Parameters
    ----------
    table
        One row per question, columns ``measure, label, unit, recorded, simulated, difference,
        difference_low, difference_high, distance, null, p, covers, reason, recorded_null, energy,
        energy_pooled, judgement, verdict``. ``judgement`` is one of
        :data:`~animarl_algos.evaluation.verdict_rows.JUDGEMENTS`, ``verdict`` says it in words.
        ``covers`` says what the interval of the difference speaks of, ``reason`` why there is none.
        ``distance`` is what was tested against ``null``, the 95 % quantile of exchanged recordings:
        the Wasserstein distance where there is a ``recorded_null`` (the upper end of the central
        95 % for recordings drawn from recordings), the absolute difference elsewhere.
        ``energy`` is the mean energy score over starts, ``energy_pooled`` what recordings of other
        starts score. In the row ``auc``, ``recorded`` and ``null`` are those of
        recordings among themselves.
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
    auc, among, floor, perturbed, ceiling
        Areas under the ROC curve of the classifier: of the rollouts, of recordings among
        themselves (their central 95 %), of closed-loop tracking, of such tracking with some actions
        at random, and of random actions (NaN where they were not given).
    importance
        By kind of feature, how much of the area rests on it.
    parts
        Whether parts of demonstrations were dealt to the folds, for lack of demonstrations.
    """

    table: pd.DataFrame
    words: tuple[str, ...]
    learner: str
    starts: int
    rollouts: int
    too_little: str = ""
    smoothing: int = 1
    auc: Interval = UNDEFINED
    among: Interval = UNDEFINED
    floor: Interval = UNDEFINED
    perturbed: Interval = UNDEFINED
    ceiling: Interval = UNDEFINED
    importance: Mapping[str, float]
    parts: bool = False

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

    def row(self, measure: str) -> dict[str, Any]:
        """The row of one measure, by column."""
        chosen = self.table[self.table["measure"] == measure]
        return {str(column): chosen[column].iloc[0] for column in chosen}

    def save(self, folder: str | Path) -> None:
        """Write ``verdict.csv`` and ``verdict.json`` into a folder."""
        folder = Path(folder)
        with write_then_rename(folder / "verdict.csv") as part:
            self.table.to_csv(part, index=False)
        plain = {k: v for k, v in vars(self).items() if k != "table"}
        for key in AREAS:
            ends = (plain[key].estimate, plain[key].low, plain[key].high)
            plain[key] = [end if math.isfinite(end) else None for end in ends]
        with write_then_rename(folder / "verdict.json") as part:
            part.write_text(json.dumps(plain | {"importance": dict(self.importance)}, indent=2))

    @classmethod
    def load(cls, folder: str | Path) -> Verdict:
        """Read what :meth:`save` wrote."""
        import pandas as pd

        folder = Path(folder)
        plain = json.loads((folder / "verdict.json").read_text())
        for key in AREAS:
            ends = plain.get(key, (None, None, None))  # older ones lack the perturbed
            estimate, low, high = (math.nan if end is None else end for end in ends)
            plain[key] = Interval(estimate, low, high)
        table = pd.read_csv(
            folder / "verdict.csv", float_precision="round_trip", keep_default_na=True
        )
        for words in ("unit", "covers", "reason"):
            table[words] = table[words].astype(object).fillna("")
        return cls(table=table, **plain | {"words": tuple(plain["words"])})


def verdict(
    recorded: Demonstrations,
    rollouts: Rollouts,
    *,
    seed: int,
    floor: Tracked | None = None,
    perturbed: Tracked | None = None,
    baselines: Mapping[str, Rollouts] | None = None,
    references: Demonstrations | None = None,
    smoothing: int | None = None,
) -> Verdict:
    """Judge a method by its rollouts.

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
        The same demonstrations as the fitted locomotion follows them; looked at on the grid on
        which recorded positions lie, as rollouts are.
    perturbed
        The same with some actions at random, to read areas by.
    baselines
        Rollouts of ``"random"`` actions, for the upper end of the classifier's scale, and of an
        ``"untrained"`` network, which a trained one should beat.
    references
        Other recordings, for recordings against recordings; by default halves of ``recorded``.
    smoothing
        Frames of a moving average through which all positions go first, 1 for none; by default
        those of :func:`~animarl_algos.evaluation.windows.comparison_smoothing`.

    Raises
    ------
    InputError
        If the rollouts are not of these demonstrations, or none is in their condition.
    """
    import pandas as pd

    if rollouts.individuals != recorded.individuals or rollouts.demo.max() >= len(recorded):
        raise InputError(
            f"the rollouts of {rollouts.method} were not made from {recorded.name}: "
            "compare them with the demonstrations they started from"
        )
    streams = np.random.default_rng(seed).spawn(4)
    if smoothing is None:
        smoothing = comparison_smoothing(recorded)
    prepared = Prepared.of(recorded, smoothing)
    counted = prepared.filtered(factual(rollouts, recorded))
    rows = rows_of(prepared, counted, streams[0])
    comparison = Classified.of(
        prepared, counted, floor, perturbed, baselines or {}, references, streams[1:3]
    )
    rows.append(auc_row(comparison))
    words = _overall(rows)
    untrained = (baselines or {}).get("untrained")
    if untrained is not None and words != (SAME,):
        other = prepared.filtered(factual(untrained, recorded))
        if _farther(prepared, counted, other, streams[3]):
            words = (WORSE, *words)
    return Verdict(
        table=pd.DataFrame(rows),
        words=words,
        learner=rollouts.method,
        starts=len(np.unique(counted.demo)),
        rollouts=int(np.count_nonzero(~counted.copies)),
        too_little=_too_little(recorded, counted),
        smoothing=smoothing,
        auc=comparison.simulated.auc,
        among=comparison.among,
        floor=comparison.floor,
        perturbed=comparison.perturbed,
        ceiling=comparison.ceiling,
        importance=comparison.simulated.importance,
        parts=comparison.block is not None,
    )


def _overall(rows: list[dict[str, Any]]) -> tuple[str, ...]:
    """Return what differs (else what differs by little), each thing once.

    The classifier and the endings together come in only if nothing else is said.
    """
    for judgement in (DIFFERS, BY_LITTLE):
        plain = {row["measure"]: row["verdict"] for row in rows if row["judgement"] == judgement}
        rest = [plain.pop(key) for key in (OUTCOMES, AUC) if key in plain]
        if "leaving" in plain:  # who left is in the table
            plain = {k: v for k, v in plain.items() if k not in ("target_out", "pursuer_out")}
        if plain or rest:
            return tuple(dict.fromkeys(plain.values())) or tuple(rest)
    return (SAME,)


def _too_little(recorded: Demonstrations, counted: Rollouts) -> str:
    """Return why there is too little data for a headline, or nothing."""
    starts = np.unique(counted.demo)
    recordings = len(np.unique(recorded.recording[starts]))
    for number, name in ((len(starts), "test start"), (recordings, "recording")):
        if number < FEWEST:
            return f"{number} {name}{'s' * (number != 1)}, and {FEWEST} are needed"
    return ""


def _farther(prepared: Prepared, ours: Rollouts, other: Rollouts, rng: np.random.Generator) -> bool:
    """Whether our rollouts are farther from the recordings than others from the same starts.

    By the energy score of duration, path length and speed together, each in units of its recorded
    spread; the 95 % interval of the difference over starts must exclude none.
    """
    true = prepared.measures(prepared.recorded)
    scale = [float(np.std(true[key])) or 1.0 for key in SUMMARY]

    def table(rollouts: Rollouts) -> Floats:
        found = prepared.measures(rollouts)
        return np.stack([found[key] / s for key, s in zip(SUMMARY, scale)], axis=1)

    recorded = table(prepared.recorded)
    scores = [energy_scores(table(one), one.demo, recorded) for one in (ours, other)]
    gap = scores[0] - scores[1]
    starts = np.arange(len(gap))
    return bootstrap_mean(cells(gap, np.zeros(len(gap)), starts, len(gap)), rng).low > 0
