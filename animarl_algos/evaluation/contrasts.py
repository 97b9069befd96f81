"""The contrasts between methods that were planned in advance, behind the gate of one test."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from animarl_algos.evaluation.anova import TOO_FEW_SEEDS, Anova, permutation_anova
from animarl_algos.evaluation.cells import Cells, Floats
from animarl_algos.evaluation.comparison import (
    energy_of,
    factual,
    find_method,
    method_cells,
    put_interval,
)
from animarl_algos.evaluation.energy_score import FEW_ROLLOUTS
from animarl_algos.evaluation.metrics import METRICS, Metric
from animarl_algos.evaluation.rollouts import RECORDED
from animarl_algos.evaluation.statistics import (
    NOTHING_SHARED,
    RESAMPLES,
    Draws,
    Interval,
    bootstrap_difference,
    covers,
    shared_starts,
)

if TYPE_CHECKING:
    import pandas as pd

PLANNED_CONTRASTS = (("DQDIL", "DQAAS"), ("DQDIL-PT", "DQAAS"), ("DQDIL-PT", "DQDIL"))
GATE_LEVEL = 0.05
ENERGY, GAP, DISTANCE = "energy score", "absolute gap", "distance"
PASSED, NOT_PASSED = "passed", "not passed"
COLUMNS = [
    "metric", "measure", "first", "second", "demos", "covers",
    "difference", "difference_low", "difference_high",
    "gate", "gate_f", "gate_p", "gate_unit", "gate_passed", "reason",
]  # fmt: skip


def contrast_table(
    metrics: pd.DataFrame,
    num_demos: int,
    rng: np.random.Generator,
    *,
    planned: Sequence[tuple[str, str]] = PLANNED_CONTRASTS,
    resamples: int = RESAMPLES,
) -> pd.DataFrame:
    """The planned contrasts, behind their gate; empty if fewer than two methods take part.

    Compared is, by ``measure``, how far a method is from the recordings. A negative difference
    means that the first method is closer. All episodes count, from the ``demos`` starts that all
    methods have.

    - ``energy score``: per seed and start, the primary measure;
    - ``absolute gap``: between the mean over repetitions and the recorded value, as in the paper;
      it is smallest for a simulator that always does the same, so it stands beside the first;
    - ``distance``: for DTW the distance itself.

    The gate is a one-way ANOVA over all methods that take part, with the null of exchanged training
    seeds (``gate_unit``); it is ``"passed"``, ``"not passed"`` or cannot be decided, where no
    arrangement of so few seeds would reach the level. Only behind a passed gate does a contrast
    have an interval; elsewhere ``reason`` says why not.
    """
    import pandas as pd

    metrics = factual(metrics)
    by_method = {str(name): rows for name, rows in metrics.groupby("method", sort=False)}
    pairs = []
    for a, b in planned:
        first, second = find_method(by_method, a), find_method(by_method, b)
        if first is not None and second is not None:
            pairs.append((first, second))
    taking_part = list(dict.fromkeys(name for pair in pairs for name in pair))
    if len(taking_part) < 2 or num_demos < 2:
        return pd.DataFrame(columns=COLUMNS)
    draws = Draws.by(rng, resamples)
    recorded = by_method[RECORDED]
    table: list[dict[str, Any]] = []
    for metric in (metric for metric in METRICS if metric.planned):
        truth = method_cells(recorded, metric.key, num_demos)
        for measure in (ENERGY, GAP) if metric.of_recordings else (DISTANCE,):
            found = {
                name: _misses(by_method[name], metric, measure, truth, num_demos)
                for name in taking_part
            }
            table += _rows(metric, measure, found, pairs, draws, rng, resamples)
    return pd.DataFrame(table, columns=COLUMNS)


def gap_cells(data: Cells, truth: Floats, metric: Metric) -> Cells:
    """Absolute gap of each cell mean to the recording's value ``(1, demos)``; DTW as it is."""
    means = data.cell_means
    gaps = np.abs(means - truth) if metric.of_recordings else means
    present = np.isfinite(gaps)
    return Cells(np.where(present, gaps, 0.0), present.astype(np.float64))


def _misses(
    rows: pd.DataFrame, metric: Metric, measure: str, truth: Cells, num_demos: int
) -> Cells:
    if measure == ENERGY:
        return energy_of(rows, metric.key, truth)
    return gap_cells(method_cells(rows, metric.key, num_demos), truth.cell_means, metric)


def _rows(
    metric: Metric,
    measure: str,
    found: dict[str, Cells],
    pairs: Sequence[tuple[str, str]],
    draws: Draws,
    rng: np.random.Generator,
    permutations: int,
) -> list[dict[str, Any]]:
    """Of one metric and measure, a row for every contrast."""
    shared = dict(zip(found, shared_starts(list(found.values()))))
    demos = next(iter(shared.values())).sums.shape[1]
    gate = None
    if demos > 0:
        per_seed = [data.sums.sum(axis=1) / data.counts.sum(axis=1) for data in shared.values()]
        gate = permutation_anova(per_seed, rng, permutations)
        words = _decision(gate)
    else:
        empty = any(data.counts.sum() == 0 for data in found.values())
        words = FEW_ROLLOUTS if empty and measure == ENERGY else NOTHING_SHARED
    passed = words == PASSED
    rows = []
    for first, second in pairs:
        row: dict[str, Any] = {
            "metric": metric.key,
            "measure": measure,
            "first": first,
            "second": second,
            "demos": demos,
            "covers": covers(found[first], found[second]),
            "gate": words,
            "gate_f": np.nan if gate is None else gate.f,
            "gate_p": np.nan if gate is None else gate.p,
            "gate_unit": "" if gate is None else gate.permutes,
            "gate_passed": passed,
            "reason": "",
        }
        value = bootstrap_difference(shared[first], shared[second], draws)
        if not passed:
            value = Interval.without_ends(value.estimate, f"the gate: {words}")
        put_interval(row, "difference", value)
        rows.append(row)
    return rows


def _decision(gate: Anova) -> str:
    if not gate.can_decide(GATE_LEVEL):
        return TOO_FEW_SEEDS
    return PASSED if gate.p <= GATE_LEVEL else NOT_PASSED
