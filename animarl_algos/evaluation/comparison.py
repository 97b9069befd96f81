"""Every method against the recordings and against every other one.

Which episodes count is part of every row: ``"all"``, or ``"captures"`` (rollouts and recordings in
which the target was reached). The two can point in opposite directions, so both are always there.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import permutations
from typing import TYPE_CHECKING, Any

import numpy as np

from animarl_algos.evaluation.distances import (
    DISTANCE_RESAMPLES,
    Distances,
    bootstrap_distances,
    null_distances,
)
from animarl_algos.evaluation.metrics import METRICS, Metric
from animarl_algos.evaluation.rollouts import NO_CUE, RECORDED
from animarl_algos.evaluation.statistics import (
    RESAMPLES,
    UNDEFINED,
    Cells,
    Floats,
    Interval,
    cells,
    draw_weights,
    percentile_interval,
    resampled_means,
    within_demo_intervals,
)

if TYPE_CHECKING:
    import pandas as pd

BASELINE = "BC"
PAIR_COLUMNS = [
    "metric", "counting", "first", "second", "difference", "difference_low", "difference_high"
]  # fmt: skip
COUNTING = {"all": "all episodes", "captures": "captures only"}


@dataclass(frozen=True, eq=False)
class Resamples:
    """Bootstrap weights of one evaluation: demonstrations shared, seeds per method."""

    demos: Floats
    seeds: dict[str, Floats]

    def mean(self, method: str, data: Cells) -> Interval:
        return percentile_interval(data.mean, self.means(method, data))

    def means(self, method: str, data: Cells) -> Floats:
        return resampled_means(data, self.seeds[method], self.demos)

    def difference(self, first: str, a: Cells, second: str, b: Cells) -> Interval:
        """Mean of ``a`` minus mean of ``b``, on the same demonstrations."""
        return percentile_interval(a.mean - b.mean, self.means(first, a) - self.means(second, b))

    def within(self, methods: dict[str, Cells]) -> list[Interval]:
        """Mean of each method, with the spread that all share taken out."""
        return within_demo_intervals(
            [data.mean for data in methods.values()],
            [self.means(name, data) for name, data in methods.items()],
        )


def draw_resamples(
    metrics: pd.DataFrame, num_demos: int, rng: np.random.Generator, resamples: int = RESAMPLES
) -> Resamples:
    """The resamples that all comparisons of one evaluation share."""
    demos = draw_weights(rng, num_demos, resamples)
    seeds = {
        str(method): draw_weights(rng, rows["seed"].nunique(), resamples)
        for method, rows in metrics.groupby("method", sort=False)
    }
    return Resamples(demos, seeds)


def factual(metrics: pd.DataFrame) -> pd.DataFrame:
    """The rows that may be compared with the recordings.

    In them the world is in the condition of the recording, and the policy was told so, or told
    nothing.
    """
    recorded = metrics[metrics["method"] == RECORDED].set_index("demo")["condition"]
    same_world = metrics["condition"].to_numpy() == recorded.loc[metrics["demo"]].to_numpy()
    true_cue = (metrics["cue"] == metrics["condition"]) | (metrics["cue"] == NO_CUE)
    kept: pd.DataFrame = metrics[same_world & true_cue]
    return kept


def counted_metrics() -> list[tuple[Metric, str]]:
    """Every metric with every rule of what counts; a share among captures would say nothing."""
    return [(m, rule) for m in METRICS for rule in COUNTING if rule == "all" or not m.share]


def method_cells(rows: pd.DataFrame, metric: str, num_demos: int, counting: str = "all") -> Cells:
    """One method's metric as cells of seed and demonstration."""
    counts = rows["captured"].to_numpy() if counting == "captures" else True
    return cells(rows[metric], rows["seed"], rows["demo"], num_demos, counts)


def comparison_table(
    metrics: pd.DataFrame,
    num_demos: int,
    rng: np.random.Generator,
    *,
    resamples: int = RESAMPLES,
    distance_resamples: int = DISTANCE_RESAMPLES,
) -> pd.DataFrame:
    """Means, differences and distances of every method, with 95 % intervals.

    Parameters
    ----------
    metrics
        Rows of :func:`~animarl_algos.evaluation.metrics.measure`, the recordings among them.
    num_demos
        Number of evaluated demonstrations.

    Returns
    -------
    One row per method, metric and counting rule. ``rollouts``, ``demos`` and ``seeds`` say how
    many count. Each of ``mean``, ``within``, ``to_recorded``, ``kde``, ``kde_null``,
    ``wasserstein`` and ``wasserstein_null`` comes with ``_low`` and ``_high``; for
    the two nulls that is the central 95 % of the null distribution. ``within`` is the mean again,
    with the interval of
    :func:`~animarl_algos.evaluation.statistics.within_demo_intervals` among the simulated methods.
    """
    import pandas as pd

    metrics = factual(metrics)
    weights = draw_resamples(metrics, num_demos, rng, resamples)
    by_method = {str(name): rows for name, rows in metrics.groupby("method", sort=False)}
    table = []
    for metric, counting in counted_metrics():
        nulls: dict[int, Distances] = {}
        gathered = {
            name: method_cells(rows, metric.key, num_demos, counting)
            for name, rows in by_method.items()
        }
        simulated = {name: data for name, data in gathered.items() if name != RECORDED}
        within = dict(zip(simulated, weights.within(simulated)))
        for name, rows in by_method.items():
            if name == RECORDED and not metric.of_recordings:
                continue
            data, reference = gathered[name], gathered[RECORDED]
            number = int(data.counts.sum())
            row: dict[str, Any] = {
                "method": name,
                "metric": metric.key,
                "counting": counting,
                "rollouts": number,
                "demos": int((data.counts.sum(axis=0) > 0).sum()),
                "seeds": len(data.counts),
            }
            simulation = name != RECORDED
            put_interval(row, "mean", weights.mean(name, data))
            put_interval(row, "within", within.get(name, UNDEFINED))
            put_interval(
                row,
                "to_recorded",
                weights.difference(name, data, RECORDED, reference)
                if simulation and metric.of_recordings
                else UNDEFINED,
            )
            distances, null = Distances(UNDEFINED, UNDEFINED), Distances(UNDEFINED, UNDEFINED)
            if simulation and metric.has_distribution:
                values = rows[metric.key].where(rows["captured"] | (counting == "all"))
                truth = reference.cell_means[0]
                distances = bootstrap_distances(
                    values, truth, rows["seed"], rows["demo"], rng, distance_resamples
                )
                if number not in nulls:
                    nulls[number] = null_distances(truth, number, rng, distance_resamples)
                null = nulls[number]
            put_interval(row, "kde", distances.kde)
            put_interval(row, "kde_null", null.kde)
            put_interval(row, "wasserstein", distances.wasserstein)
            put_interval(row, "wasserstein_null", null.wasserstein)
            table.append(row)
    return pd.DataFrame(table)


def pair_table(
    metrics: pd.DataFrame, num_demos: int, rng: np.random.Generator, *, resamples: int = RESAMPLES
) -> pd.DataFrame:
    """Every simulated method minus every other, paired by demonstration.

    Returns
    -------
    One row per metric, counting rule and ordered pair: ``first``, ``second``, and the
    ``difference`` of their means with its 95 % interval. These are not planned contrasts:
    nothing corrects them for their number.
    """
    import pandas as pd

    metrics = factual(metrics)
    weights = draw_resamples(metrics, num_demos, rng, resamples)
    simulated = metrics[metrics["method"] != RECORDED].groupby("method", sort=False)
    by_method = {str(name): rows for name, rows in simulated}
    table = []
    for metric, counting in counted_metrics():
        data = {n: method_cells(r, metric.key, num_demos, counting) for n, r in by_method.items()}
        for first, second in permutations(data, 2):
            row: dict[str, Any] = {
                "metric": metric.key, "counting": counting, "first": first, "second": second
            }  # fmt: skip
            put_interval(
                row, "difference", weights.difference(first, data[first], second, data[second])
            )
            table.append(row)
    return pd.DataFrame(table, columns=PAIR_COLUMNS)


def find_method(names: Any, wanted: str) -> str | None:
    """The name among ``names`` that equals ``wanted`` but for its case."""
    return next((str(n) for n in names if str(n).casefold() == wanted.casefold()), None)


def interval(row: Any, key: str) -> Interval:
    """The interval that a table row holds under ``key``, ``key_low`` and ``key_high``."""
    return Interval(float(row[key]), float(row[f"{key}_low"]), float(row[f"{key}_high"]))


def put_interval(row: dict[str, Any], key: str, value: Interval) -> None:
    """Put what :func:`interval` reads into a row."""
    row |= {key: value.estimate, f"{key}_low": value.low, f"{key}_high": value.high}
