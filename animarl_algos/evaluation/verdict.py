"""Does a simulator move like the recordings? One row per question, one line of words for all.

Every row compares recordings and rollouts from the same starts, says how far apart they are, what
chance alone would give (:mod:`animarl_algos.evaluation.null`), and puts it in words. A row is taken
for alike if chance explains it, or if the gap is small (``NEAR``, ``NEAR_SHARE``, ``NEAR_AUC``).
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from animarl_algos.evaluation.classifier import Telling, among_themselves, tell_apart
from animarl_algos.evaluation.distances import null_distances
from animarl_algos.evaluation.energy_score import energy_scores, pooled_score
from animarl_algos.evaluation.motion import (
    MEASURES,
    RECORDED_SCALE,
    Measure,
    SlowSpeeds,
    Unit,
    ending,
    episode_measures,
    unit_of,
)
from animarl_algos.evaluation.null import Exchanges, Tested
from animarl_algos.evaluation.rollouts import NO_CUE, Rollouts
from animarl_algos.evaluation.statistics import (
    UNDEFINED,
    Interval,
    bootstrap_difference,
    bootstrap_mean,
    cells,
)
from animarl_algos.evaluation.windows import (
    WINDOW,
    Windows,
    comparison_smoothing,
    resting_step,
    smoothed,
    window_features,
)
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.resolution import rounded
from animarl_envs.errors import InputError
from animarl_envs.files import write_then_rename

if TYPE_CHECKING:
    import pandas as pd

Floats = NDArray[np.float64]

NEAR = 0.10  # of the recorded mean: a gap that is called small even if chance does not explain it
NEAR_SHARE = 0.05  # the same for a share of episodes or steps
NEAR_AUC = 0.65  # up to here a classifier hardly tells the two apart
FLOOR_MARGIN = 0.10  # ... or up to this much above what the locomotion model allows
FEWEST_DEMOS = 5  # with fewer, parts of them are dealt to the classifier's folds
PART = 15  # windows of such a part
OUTCOMES, AUC = "outcomes", "auc"
ALIKE, NEARLY = "as recorded", "nearly as recorded"
LIKE = "moves like the recordings"
WORSE = "worse than untrained"
SUMMARY = ("duration", "path_length", "mean_speed")  # what methods are ranked by


class Tracked(Protocol):
    """Closed-loop tracking of the evaluated demonstrations, frame for frame."""

    @property
    def positions(self) -> Floats:
        """``(frames, individuals, 2)``, arena frame [arena unit]."""
        ...


@dataclass(frozen=True, eq=False, kw_only=True)
class Verdict:
    """How a method's rollouts compare with the recordings.

    Parameters
    ----------
    table
        One row per question, columns ``measure, label, unit, recorded, simulated, difference,
        difference_low, difference_high, distance, null, p, recorded_null, energy, energy_pooled,
        alike, verdict``. ``distance`` is what was tested against ``null``, the 95 % quantile of
        exchanged recordings: the Wasserstein distance where there is a ``recorded_null`` (the
        upper end of the central 95 % for recordings drawn from recordings), the absolute
        difference elsewhere.
        ``energy`` is the mean energy score over starts, ``energy_pooled`` what recordings of other
        starts score. In the row ``auc``, ``recorded`` and ``null`` are those of
        recordings among themselves.
    words
        What is wrong, in the order of its weight; ``("moves like the recordings",)`` if nothing is.
    learner
        The method.
    starts, rollouts
        How many count.
    smoothing
        Frames of the moving average that both sides went through.
    auc, among, floor, ceiling
        Areas under the ROC curve of the classifier: of the rollouts, of recordings among
        themselves (their central 95 %), of closed-loop tracking and of random actions (NaN where
        they were not given).
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
    smoothing: int = 1
    auc: Interval = UNDEFINED
    among: Interval = UNDEFINED
    floor: Interval = UNDEFINED
    ceiling: Interval = UNDEFINED
    importance: Mapping[str, float]
    parts: bool = False

    @property
    def overall(self) -> str:
        """All words in one line."""
        return ", ".join(self.words)

    @property
    def like(self) -> bool:
        """Whether nothing was found wrong."""
        return self.words == (LIKE,)

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
        for key in ("auc", "among", "floor", "ceiling"):
            ends = vars(plain[key]).values()
            plain[key] = [end if math.isfinite(end) else None for end in ends]
        with write_then_rename(folder / "verdict.json") as part:
            part.write_text(json.dumps(plain | {"importance": dict(self.importance)}, indent=2))

    @classmethod
    def load(cls, folder: str | Path) -> Verdict:
        """Read what :meth:`save` wrote."""
        import pandas as pd

        folder = Path(folder)
        plain = json.loads((folder / "verdict.json").read_text())
        for key in ("auc", "among", "floor", "ceiling"):
            plain[key] = Interval(*(math.nan if end is None else end for end in plain[key]))
        table = pd.read_csv(
            folder / "verdict.csv", float_precision="round_trip", keep_default_na=True
        )
        table["unit"] = table["unit"].fillna("")
        return cls(table=table, **plain | {"words": tuple(plain["words"])})


def verdict(
    recorded: Demonstrations,
    rollouts: Rollouts,
    *,
    seed: int,
    floor: Tracked | None = None,
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
    prepared = _Prepared.of(recorded, smoothing)
    counted = prepared.filtered(_factual(rollouts, recorded))
    rows = _rows(prepared, counted, streams[0])
    comparison = _Classified.of(prepared, counted, floor, baselines or {}, references, streams[1:3])
    rows.append(_auc_row(comparison))
    words = _overall(rows, comparison)
    untrained = (baselines or {}).get("untrained")
    if untrained is not None and words != (LIKE,):
        other = prepared.filtered(_factual(untrained, recorded))
        if _farther(prepared, counted, other, streams[3]):
            words = (WORSE, *words)
    return Verdict(
        table=pd.DataFrame(rows),
        words=words,
        learner=rollouts.method,
        starts=len(np.unique(counted.demo)),
        rollouts=len(counted),
        smoothing=smoothing,
        auc=comparison.simulated.auc,
        among=comparison.among,
        floor=comparison.floor,
        ceiling=comparison.ceiling,
        importance=comparison.simulated.importance,
        parts=comparison.block is not None,
    )


def _factual(rollouts: Rollouts, recorded: Demonstrations) -> Rollouts:
    """Those in the world's recorded condition, told it or nothing."""
    same = rollouts.condition == recorded.condition[rollouts.demo]
    told = (rollouts.cue == NO_CUE) | (rollouts.cue == rollouts.condition)
    return rollouts.select(same & told)


@dataclass(frozen=True, eq=False)
class _Prepared:
    """Recordings as rollouts, with what is worked out once for all comparisons with them."""

    demos: Demonstrations
    recorded: Rollouts
    slow: SlowSpeeds
    unit: Unit
    smoothing: int

    @classmethod
    def of(cls, demos: Demonstrations, smoothing: int) -> _Prepared:
        recorded = _filtered(Rollouts.from_demonstrations(demos), smoothing)
        return cls(demos, recorded, SlowSpeeds.of(recorded), unit_of(demos), smoothing)

    def filtered(self, rollouts: Rollouts) -> Rollouts:
        return _filtered(rollouts, self.smoothing)

    def measures(self, rollouts: Rollouts) -> dict[str, Floats]:
        return episode_measures(rollouts, self.demos.arena, self.slow, self.unit)


def _filtered(rollouts: Rollouts, smoothing: int) -> Rollouts:
    moved = smoothed(rollouts.positions, rollouts.lengths, smoothing)
    return replace(rollouts, positions=moved)


# -- rows -----------------------------------------------------------------------------------------


def _rows(prepared: _Prepared, counted: Rollouts, rng: np.random.Generator) -> list[dict[str, Any]]:
    """The rows of endings and of motion."""
    starts = np.unique(counted.demo)
    exchanges = Exchanges.draw(counted.demo, prepared.demos.num_episodes, rng)
    true, simulated = prepared.measures(prepared.recorded), prepared.measures(counted)
    ends = [ending(one) for one in (prepared.recorded, counted)]
    rows = [_outcome_row(exchanges.chi_squared(np.concatenate(ends)))]
    for measure in MEASURES:
        a, b = true[measure.key], simulated[measure.key]
        if measure.is_outcome and not (a.any() or b.any()):
            continue
        both = np.concatenate([a, b])
        tested = exchanges.wasserstein(both) if measure.spread else exchanges.difference(both)
        one = cells(a[starts], np.full(len(starts), -1), starts, len(a))
        many = cells(b, counted.seed, counted.demo, len(a))
        gap = bootstrap_difference(many, one, rng)
        row = _row(measure, prepared.unit, one.mean, many.mean, gap, tested)
        if measure.spread:
            null = null_distances(a[starts], len(b), rng).wasserstein
            scores = energy_scores(b, np.searchsorted(starts, counted.demo), a[starts])
            row |= {
                "recorded_null": null.high,
                "energy": float(np.mean(scores)),
                "energy_pooled": pooled_score(a[starts]),
            }
        row["alike"], row["verdict"] = _judged(measure, row, tested, a[starts], b)
        rows.append(row)
    return rows


def _row(
    measure: Measure, unit: Unit, recorded: float, simulated: float, gap: Interval, tested: Tested
) -> dict[str, Any]:
    return {
        "measure": measure.key,
        "label": measure.label,
        "unit": measure.unit.format(length=unit.name),
        "recorded": recorded,
        "simulated": simulated,
        "difference": gap.estimate,
        "difference_low": gap.low,
        "difference_high": gap.high,
        "distance": tested.value,
        "null": tested.null,
        "p": tested.p,
        "recorded_null": math.nan,
        "energy": math.nan,
        "energy_pooled": math.nan,
    }


def _judged(
    measure: Measure, row: Mapping[str, Any], tested: Tested, recorded: Floats, simulated: Floats
) -> tuple[bool, str]:
    """Whether it counts as alike, and in words."""
    if tested.inside:
        return True, ALIKE
    allowed = NEAR_SHARE if measure.is_share else NEAR * abs(row["recorded"])
    if tested.value <= allowed:
        return True, NEARLY
    if abs(row["difference"]) < tested.value / 2:  # means agree more than the values do
        return False, (
            f"{measure.noun} too much alike"
            if simulated.std() < recorded.std()
            else f"{measure.noun} too varied"
        )
    return False, measure.too_much if row["difference"] > 0 else measure.too_little


def _outcome_row(tested: Tested) -> dict[str, Any]:
    outcomes = Measure(OUTCOMES, "Endings together (chi-squared)", "", "endings differ", "", "")
    row = _row(outcomes, RECORDED_SCALE, math.nan, math.nan, UNDEFINED, tested)
    return row | {
        "alike": tested.inside, "verdict": ALIKE if tested.inside else outcomes.too_much
    }  # fmt: skip


# -- the classifier -------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _Classified:
    """What the classifier makes of the rollouts and of what they are read beside."""

    simulated: Telling
    among: Interval
    floor: Interval
    ceiling: Interval
    block: int | None

    @classmethod
    def of(
        cls,
        prepared: _Prepared,
        counted: Rollouts,
        floor: Tracked | None,
        baselines: Mapping[str, Rollouts],
        references: Demonstrations | None,
        streams: list[np.random.Generator],
    ) -> _Classified:
        demos = prepared.demos
        block = PART if len(np.unique(counted.demo)) < FEWEST_DEMOS else None

        still = resting_step(prepared.recorded)

        def windows(rollouts: Rollouts) -> Windows:
            return window_features(rollouts, demos.arena, block=block, still=still)

        own = windows(prepared.recorded)
        rng, null_rng = streams
        simulated = tell_apart(own, windows(counted), rng, importance=True)
        ceiling = tracked = UNDEFINED
        if (random := baselines.get("random")) is not None:
            drawn = prepared.filtered(_factual(random, demos))
            ceiling = tell_apart(own, windows(drawn), rng, deals=1).auc
        if floor is not None:
            if floor.positions.shape != demos.positions.shape:
                raise InputError(
                    f"the tracking has shape {floor.positions.shape} and the demonstrations "
                    f"{demos.positions.shape}: track the evaluated ones"
                )
            stored = rounded(floor.positions, demos.resolution())
            followed = replace(Rollouts.from_demonstrations(demos), positions=stored)
            tracked = tell_apart(own, windows(prepared.filtered(followed)), rng).auc
        if references is None:
            among = among_themselves(own, null_rng)
        else:
            others = windows(prepared.filtered(Rollouts.from_demonstrations(references)))
            apart = replace(others, group=others.group + own.group.max() + 1)
            among = tell_apart(own, apart, null_rng, deals=1).auc
        return cls(simulated, among, tracked, ceiling, block)


def _auc_row(found: _Classified) -> dict[str, Any]:
    auc, among = found.simulated.auc, found.among
    measure = Measure(AUC, f"Told apart by a classifier on {WINDOW:g} s (AUC)", "", "", "", "")
    gap = Interval(*(part - among.estimate for part in (auc.estimate, auc.low, auc.high)))
    tested = Tested(abs(auc.estimate - 0.5), abs(among.high - 0.5), math.nan)
    row = _row(measure, RECORDED_SCALE, among.estimate, auc.estimate, gap, tested)
    if not math.isfinite(auc.estimate):
        return row | {"alike": True, "verdict": "too few demonstrations to say"}
    if auc.low <= np.fmax(0.5, among.estimate):
        return row | {"alike": True, "verdict": "not told apart"}
    if auc.estimate <= NEAR_AUC:
        return row | {"alike": True, "verdict": "hardly told apart"}
    if math.isfinite(found.floor.estimate) and (
        auc.estimate <= found.floor.estimate + FLOOR_MARGIN
    ):
        return row | {"alike": True, "verdict": "as near as the fitted locomotion allows"}
    by = max(found.simulated.importance.items(), key=lambda item: item[1])[0]
    return row | {"alike": False, "verdict": f"told apart, most of all by {by}"}


# -- words ----------------------------------------------------------------------------------------


def _overall(rows: list[dict[str, Any]], found: _Classified) -> tuple[str, ...]:
    """What is wrong, each thing once; the areas and the endings only if nothing else is said."""
    wrong = [row for row in rows if not row["alike"]]
    plain = {row["measure"]: row["verdict"] for row in wrong}
    rest = [plain.pop(key) for key in (OUTCOMES, AUC) if key in plain]
    if "leaving" in plain:  # who left is in the table
        plain = {k: words for k, words in plain.items() if k not in ("target_out", "pursuer_out")}
    return tuple(dict.fromkeys(plain.values())) or tuple(rest) or (LIKE,)


def _farther(
    prepared: _Prepared, ours: Rollouts, other: Rollouts, rng: np.random.Generator
) -> bool:
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
