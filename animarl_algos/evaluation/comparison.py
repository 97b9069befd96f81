"""Every method against the recordings and against every other one.

Which episodes count is part of every row: ``"all"``, or ``"captures"`` (rollouts and recordings in
which the target was reached). The two can point in opposite directions, so both are always there.
"""

from __future__ import annotations

import math
from itertools import combinations, permutations
from typing import TYPE_CHECKING, Any

import numpy as np

from animarl_algos.evaluation.distances import (
    DISTANCE_RESAMPLES,
    Distances,
    bootstrap_distances,
    kde_floor,
)
from animarl_algos.evaluation.energy_score import FEW_ROLLOUTS, energy_cells, pooled_score
from animarl_algos.evaluation.metrics import DURATION, RETURN, Metric, compared_metrics
from animarl_algos.evaluation.null import Exchanges, NullDistances
from animarl_algos.evaluation.rollouts import NO_CUE, RECORDED, copies
from animarl_algos.evaluation.statistics import (
    RESAMPLES,
    UNDEFINED,
    Cells,
    Draws,
    Interval,
    bootstrap_difference,
    bootstrap_mean,
    cells,
    covers,
    within_intervals,
)

if TYPE_CHECKING:
    import pandas as pd

BASELINE = "BC"
PAIR_COLUMNS = [
    "metric", "counting", "first", "second", "demos", "pairing", "covers",
    "difference", "difference_low", "difference_high",
    "energy", "energy_low", "energy_high", "reason",
]  # fmt: skip
COUNTING = {"all": "all episodes", "captures": "captures only"}
OF_RECORDINGS = "demonstrations like these"
SAME_STARTS, SHARED_STARTS = "paired, same starts", "paired, shared starts only"


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
    return [
        (m, rule) for m in compared_metrics() for rule in COUNTING if rule == "all" or not m.share
    ]


def _done(rows: pd.DataFrame) -> list[bytes]:
    """What each rollout did, as far as its metrics say."""
    measured = rows.drop(columns=["method", "seed", "demo", "repetition"])
    return [row.tobytes() for row in measured.to_numpy(dtype=np.float64)]


def method_cells(rows: pd.DataFrame, metric: str, num_demos: int, counting: str = "all") -> Cells:
    """One method's metric as cells of seed and demonstration."""
    counts = rows["captured"].to_numpy() if counting == "captures" else True
    return cells(rows[metric], rows["seed"], rows["demo"], num_demos, counts)


def energy_of(rows: pd.DataFrame, metric: str, truth: Cells, counting: str = "all") -> Cells:
    """One method's energy score at every start, as cells of seed and demonstration."""
    counts = rows["captured"].to_numpy() | (counting == "all")
    values = rows[metric].where(counts)
    return energy_cells(values, rows["seed"], rows["demo"], truth.cell_means[0])


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
    many count, ``covers`` what an interval speaks of: of training runs, or of one network only.
    Each of the following comes with ``_low`` and ``_high``; where they are not defined, ``reason``
    says why.

    - ``mean``, and ``within``, the mean again with the interval of
      :func:`~animarl_algos.evaluation.statistics.within_intervals` among the simulated methods;
    - ``to_recorded``: less the recorded mean, on the ``to_recorded_demos`` starts that both have;
    - ``energy``: mean energy score per start, the primary measure of a distribution; beside it
      ``energy_pooled``, what the recordings of all other starts score;
    - ``kde`` and ``wasserstein``: distances of the pooled values; ``..._null``
      are mean and central 95 % of what a perfect simulator gives
      (:mod:`animarl_algos.evaluation.null`), ``kde_p`` and ``wasserstein_p`` how often it gives as
      much; ``kde_floor`` is the smallest bandwidth where it acts [unit of the metric].

    Beside a distance to the recordings (DTW) stand ``duration`` and ``reached`` of the same
    episodes, without which a short episode passes for a close one.
    """
    import pandas as pd

    metrics = factual(metrics)
    draws = Draws.by(rng, resamples)
    by_method = {str(name): rows for name, rows in metrics.groupby("method", sort=False)}
    exchanges = {
        name: Exchanges.draw(
            rows["demo"],
            num_demos,
            rng,
            distance_resamples,
            copies=copies(rows["demo"].tolist(), rows["seed"].tolist(), _done(rows)),
        )
        for name, rows in by_method.items()
        if name != RECORDED
    }
    table = []
    for metric, counting in counted_metrics():
        gathered = {
            name: method_cells(rows, metric.key, num_demos, counting)
            for name, rows in by_method.items()
        }
        simulated = {name: data for name, data in gathered.items() if name != RECORDED}
        within = dict(zip(simulated, within_intervals(list(simulated.values()), draws)))
        reference = gathered[RECORDED]
        for name, rows in by_method.items():
            if name == RECORDED and not metric.of_recordings:
                continue
            data, simulation = gathered[name], name != RECORDED
            shared = data.starts & reference.starts
            compared = simulation and metric.of_recordings
            row: dict[str, Any] = {
                "method": name,
                "metric": metric.key,
                "counting": counting,
                "rollouts": int(data.counts.sum()),
                "demos": int(data.starts.sum()),
                "seeds": len(data.counts),
                "covers": covers(data) if simulation else OF_RECORDINGS,
                "to_recorded_demos": int(shared.sum()) if compared else 0,
                "energy_pooled": math.nan,
                "duration": _mean_of(rows, DURATION, num_demos, counting),
                "reached": _mean_of(rows, RETURN, num_demos, counting),
                "reason": "",
            }
            put_interval(row, "mean", bootstrap_mean(data, draws, share=metric.share))
            put_interval(row, "within", within.get(name, UNDEFINED))
            gap = UNDEFINED
            if compared:
                gap = bootstrap_difference(data, reference, draws, share=metric.share)
            put_interval(row, "to_recorded", gap)
            energy, distances, null = UNDEFINED, Distances(UNDEFINED, UNDEFINED), NullDistances()
            floor = math.nan
            if simulation and metric.has_distribution:
                energy = energy_interval(energy_of(rows, metric.key, reference, counting), draws)
                truth = reference.cell_means[0]
                row["energy_pooled"] = pooled_score(truth[shared])
                values = rows[metric.key].where(rows["captured"] | (counting == "all"))
                distances = bootstrap_distances(
                    values, truth, rows["seed"], rows["demo"], rng, distance_resamples
                )
                null = exchanges[name].distances(np.concatenate([truth, values]))
                floor = kde_floor(values, truth)
            put_interval(row, "energy", energy)
            put_interval(row, "kde", distances.kde)
            put_interval(row, "kde_null", null.kde)
            put_interval(row, "wasserstein", distances.wasserstein)
            put_interval(row, "wasserstein_null", null.wasserstein)
            row |= {"kde_p": null.kde_p, "wasserstein_p": null.wasserstein_p, "kde_floor": floor}
            table.append(row)
    return pd.DataFrame(table)


def pair_table(
    metrics: pd.DataFrame, num_demos: int, rng: np.random.Generator, *, resamples: int = RESAMPLES
) -> pd.DataFrame:
    """Every simulated method minus every other, paired by demonstration.

    Returns
    -------
    One row per metric, counting rule and ordered pair: ``first``, ``second``, the ``difference`` of
    their means and of their ``energy`` scores (below zero, the first is closer to the recordings)
    with 95 % intervals, and the ``reason`` where there is none. Only starts that both have count:
    ``demos`` of them, which ``pairing`` says if they are not all. These are not planned contrasts:
    nothing corrects them for their number.
    """
    import pandas as pd

    metrics = factual(metrics)
    draws = Draws.by(rng, resamples)
    by_method = {str(name): rows for name, rows in metrics.groupby("method", sort=False)}
    recorded = by_method.pop(RECORDED, None)
    table = []
    for metric, counting in counted_metrics():
        data = {n: method_cells(r, metric.key, num_demos, counting) for n, r in by_method.items()}
        energies: dict[str, Cells] = {}
        if metric.has_distribution and recorded is not None:
            truth = method_cells(recorded, metric.key, num_demos, counting)
            energies = {n: energy_of(r, metric.key, truth, counting) for n, r in by_method.items()}
        both_ways: dict[tuple[str, str], dict[str, Any]] = {}
        for first, second in combinations(data, 2):
            row = _pair_row(data[first], data[second], draws, metric.share)
            energy = UNDEFINED
            if energies:
                energy = energy_interval(energies[first], draws, less=energies[second])
            put_interval(row, "energy", energy)
            both_ways[first, second] = row
            both_ways[second, first] = _turned(row)
        for first, second in permutations(data, 2):
            names = {"metric": metric.key, "counting": counting, "first": first, "second": second}
            table.append(names | both_ways[first, second])
    return pd.DataFrame(table, columns=PAIR_COLUMNS)


def energy_interval(scores: Cells, draws: Draws, *, less: Cells | None = None) -> Interval:
    """Mean energy score, or its difference to that of another method."""
    if scores.counts.sum() == 0 or (less is not None and less.counts.sum() == 0):
        return Interval.without_ends(math.nan, FEW_ROLLOUTS)
    return (
        bootstrap_mean(scores, draws) if less is None else bootstrap_difference(scores, less, draws)
    )


def _pair_row(first: Cells, second: Cells, draws: Draws, share: bool) -> dict[str, Any]:
    starts = [data.starts for data in (first, second)]
    row: dict[str, Any] = {
        "demos": int((starts[0] & starts[1]).sum()),
        "pairing": SAME_STARTS if (starts[0] == starts[1]).all() else SHARED_STARTS,
        "covers": covers(first, second),
        "reason": "",
    }
    put_interval(row, "difference", bootstrap_difference(first, second, draws, share=share))
    return row


def _turned(row: dict[str, Any]) -> dict[str, Any]:
    """The same pair the other way round."""
    turned = dict(row)
    for key in ("difference", "energy"):
        value = interval(row, key)
        ends = Interval(-value.estimate, -value.high, -value.low)
        turned |= {key: ends.estimate, f"{key}_low": ends.low, f"{key}_high": ends.high}
    return turned


def _mean_of(rows: pd.DataFrame, metric: Metric, num_demos: int, counting: str) -> float:
    return method_cells(rows, metric.key, num_demos, counting).mean


def find_method(names: Any, wanted: str) -> str | None:
    """The name among ``names`` that equals ``wanted`` but for its case."""
    return next((str(n) for n in names if str(n).casefold() == wanted.casefold()), None)


def interval(row: Any, key: str) -> Interval:
    """The interval that a table row holds under ``key``, ``key_low`` and ``key_high``."""
    return Interval(float(row[key]), float(row[f"{key}_low"]), float(row[f"{key}_high"]))


def put_interval(row: dict[str, Any], key: str, value: Interval) -> None:
    """Put what :func:`interval` reads into a row, and why it is undefined into its ``reason``."""
    row |= {key: value.estimate, f"{key}_low": value.low, f"{key}_high": value.high}
    if value.reason:
        told = [row["reason"]] if row.get("reason") else []
        row["reason"] = "; ".join([*told, f"{key}: {value.reason}"])
