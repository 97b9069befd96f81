"""The rows of a verdict: endings and motion, each beside what chance alone would give.

Every row is judged in one of four ways: it is not distinguishable from the recordings (chance gives
as much), it differs by little (``LITTLE``, ``LITTLE_SHARE``), it differs, or there is too little
data to say.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from animarl_algos.evaluation.distances import null_distances
from animarl_algos.evaluation.energy_score import energy_scores, pooled_score
from animarl_algos.evaluation.motion import MEASURES, Measure, ending
from animarl_algos.evaluation.null import Exchanges, Tested
from animarl_algos.evaluation.prepared import Prepared
from animarl_algos.evaluation.rollouts import Rollouts
from animarl_algos.evaluation.statistics import (
    UNDEFINED,
    Interval,
    bootstrap_difference,
    cells,
    covers,
)
from animarl_envs.demos.units import RECORDED_SCALE, Unit

Floats = NDArray[np.float64]

SAME, BY_LITTLE, DIFFERS, UNKNOWN = JUDGEMENTS = (
    "not distinguishable", "differs, but by little", "differs", "too little data to say",
)  # fmt: skip
LITTLE = 0.10  # of the recorded mean: a gap that is called little where chance does not explain it
LITTLE_SHARE = 0.05  # the same for a share of episodes or steps
OUTCOMES = "outcomes"


def rows_of(
    prepared: Prepared, counted: Rollouts, rng: np.random.Generator
) -> list[dict[str, Any]]:
    """The rows of endings and of motion."""
    starts = np.unique(counted.demo)
    num_demos = prepared.demos.num_episodes
    exchanges = Exchanges.draw(counted.demo, num_demos, rng, copies=counted.copies)
    true, simulated = prepared.measures(prepared.recorded), prepared.measures(counted)
    ends = [ending(one) for one in (prepared.recorded, counted)]
    known = np.unique(np.concatenate(ends))
    shares = [(side[:, None] == known).mean(axis=0) for side in (ends[0][starts], ends[1])]
    moved = 0.5 * float(np.abs(shares[0] - shares[1]).sum())
    rows = [_outcome_row(exchanges.chi_squared(np.concatenate(ends)), moved)]
    for measure in MEASURES:
        a, b = true[measure.key], simulated[measure.key]
        if measure.is_outcome and not (a.any() or b.any()):
            continue
        both = np.concatenate([a, b])
        tested = exchanges.wasserstein(both) if measure.spread else exchanges.difference(both)
        one = cells(a[starts], np.full(len(starts), -1), starts, len(a))
        many = cells(b, counted.seed, counted.demo, len(a))
        gap = bootstrap_difference(many, one, rng)
        row = row_of(measure, prepared.unit, one.mean, many.even.mean, gap, tested)
        row["covers"] = covers(many)
        if measure.spread:
            null = null_distances(a[starts], len(b), rng).wasserstein
            scores = energy_scores(b, np.searchsorted(starts, counted.demo), a[starts])
            row |= {
                "recorded_null": null.high,
                "energy": float(np.mean(scores)),
                "energy_pooled": pooled_score(a[starts]),
            }
        row["judgement"], row["verdict"] = judge_row(measure, row, tested, a[starts], b)
        rows.append(row)
    return rows


def row_of(
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
        "covers": "",
        "reason": gap.reason,
        "recorded_null": math.nan,
        "energy": math.nan,
        "energy_pooled": math.nan,
    }


def judge_row(
    measure: Measure, row: Mapping[str, Any], tested: Tested, recorded: Floats, simulated: Floats
) -> tuple[str, str]:
    """Return the judgement of a row, and the words for it."""
    if tested.inside:
        return SAME, SAME
    if abs(row["difference"]) < tested.value / 2:  # means agree more than the values do
        wrong = (
            f"{measure.noun} too much alike"
            if simulated.std() < recorded.std()
            else f"{measure.noun} too varied"
        )
    else:
        wrong = measure.too_much if row["difference"] > 0 else measure.too_little
    allowed = LITTLE_SHARE if measure.is_share else LITTLE * abs(row["recorded"])
    if tested.value > allowed:
        return DIFFERS, wrong
    much = (
        f"{100 * tested.value:.2g} percentage points"
        if measure.is_share
        else f"{100 * tested.value / abs(row['recorded']):.2g} %"
    )
    return BY_LITTLE, f"{BY_LITTLE}: {wrong} by {much}"


def _outcome_row(tested: Tested, moved: float) -> dict[str, Any]:
    """Return the row of all endings; ``moved``: the share of episodes that end in another way."""
    outcomes = Measure(OUTCOMES, "Endings together (chi-squared)", "", "endings differ", "", "")
    row = row_of(outcomes, RECORDED_SCALE, math.nan, math.nan, UNDEFINED, tested)
    if tested.inside:
        return row | {"judgement": SAME, "verdict": SAME}
    if moved <= LITTLE_SHARE:
        words = f"{BY_LITTLE}: {outcomes.too_much} in {100 * moved:.2g} % of episodes"
        return row | {"judgement": BY_LITTLE, "verdict": words}
    return row | {"judgement": DIFFERS, "verdict": outcomes.too_much}
