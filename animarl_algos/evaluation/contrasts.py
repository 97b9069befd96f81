"""The contrasts between methods that were planned in advance, behind the gate of one test."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from animarl_algos.evaluation.comparison import (
    draw_resamples,
    factual,
    find_method,
    method_cells,
    put_interval,
)
from animarl_algos.evaluation.metrics import METRICS, Metric
from animarl_algos.evaluation.rollouts import RECORDED
from animarl_algos.evaluation.statistics import RESAMPLES, Cells, Floats, permutation_anova

if TYPE_CHECKING:
    import pandas as pd

PLANNED_CONTRASTS = (("DQDIL", "DQAAS"), ("DQDIL-PT", "DQAAS"), ("DQDIL-PT", "DQDIL"))
GATE_LEVEL = 0.05
SEEDS_FOR_GATE = 3  # with fewer seeds, labels are exchanged within demonstrations instead


def contrast_table(
    metrics: pd.DataFrame,
    num_demos: int,
    rng: np.random.Generator,
    *,
    planned: Sequence[tuple[str, str]] = PLANNED_CONTRASTS,
    resamples: int = RESAMPLES,
) -> pd.DataFrame:
    """The planned contrasts, behind their gate; empty if fewer than two methods take part.

    Compared is the gap to the recordings: per seed and demonstration, the absolute difference
    between the mean over repetitions and the recorded value; for DTW the distance itself. All
    episodes count. A negative difference means that the first method is closer.

    The gate is a one-way ANOVA over the methods that take part, with a permutation null: over
    training seeds where every method has at least three, otherwise within demonstrations, and then
    it speaks of these trained networks only.
    """
    import pandas as pd

    columns = [
        "metric", "first", "second", "difference", "difference_low", "difference_high",
        "gate_f", "gate_p", "gate_unit", "gate_passed",
    ]  # fmt: skip
    metrics = factual(metrics)
    by_method = {str(name): rows for name, rows in metrics.groupby("method", sort=False)}
    pairs = []
    for a, b in planned:
        first, second = find_method(by_method, a), find_method(by_method, b)
        if first is not None and second is not None:
            pairs.append((first, second))
    taking_part = list(dict.fromkeys(name for pair in pairs for name in pair))
    if len(taking_part) < 2 or num_demos < 2:
        return pd.DataFrame(columns=columns)
    weights = draw_resamples(metrics, num_demos, rng, resamples)
    table = []
    for metric in (metric for metric in METRICS if metric.planned):
        truth = method_cells(by_method[RECORDED], metric.key, num_demos).cell_means
        gaps = {
            name: gap_cells(method_cells(by_method[name], metric.key, num_demos), truth, metric)
            for name in taking_part
        }
        gate = _gate(list(gaps.values()), rng, resamples)
        for first, second in pairs:
            row: dict[str, Any] = {"metric": metric.key, "first": first, "second": second}
            put_interval(
                row, "difference", weights.difference(first, gaps[first], second, gaps[second])
            )
            row |= {
                "gate_f": gate.f,
                "gate_p": gate.p,
                "gate_unit": gate.unit,
                "gate_passed": gate.p < GATE_LEVEL,
            }
            table.append(row)
    return pd.DataFrame(table, columns=columns)


def gap_cells(data: Cells, truth: Floats, metric: Metric) -> Cells:
    """Absolute gap of each cell mean to the recording's value ``(1, demos)``; DTW as it is."""
    means = data.cell_means
    gaps = np.abs(means - truth) if metric.of_recordings else means
    present = np.isfinite(gaps)
    return Cells(np.where(present, gaps, 0.0), present.astype(np.float64))


def _gate(gaps: list[Cells], rng: np.random.Generator, permutations: int) -> Any:
    seeds = {len(gap.sums) for gap in gaps}
    if len(seeds) == 1 and seeds.pop() >= SEEDS_FOR_GATE:
        per_seed = np.stack([gap.sums.sum(axis=1) / gap.counts.sum(axis=1) for gap in gaps])
        return permutation_anova(per_seed, rng, permutations, paired=False, unit="seeds")
    per_demo = np.stack([np.nanmean(gap.cell_means, axis=0) for gap in gaps])
    return permutation_anova(per_demo, rng, permutations, paired=True, unit="demonstrations")
