"""Every method against the recordings and against every other one, and the planned contrasts.

Which episodes count is part of every row: ``"all"``, or ``"captures"`` (rollouts and recordings in
which the target was reached). The two can point in opposite directions, so both are always there.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import permutations as ordered_pairs
from typing import TYPE_CHECKING, Any

import numpy as np

from animarl_algos.evaluation.distances import (
    DISTANCE_RESAMPLES,
    FEW_ROLLOUTS,
    bootstrap_kde,
    energy_cells,
    pooled_score,
)
from animarl_algos.evaluation.exchange_test import Exchanges
from animarl_algos.evaluation.metrics import DURATION, METRICS, RETURN, Metric
from animarl_algos.evaluation.rollouts import NO_CUE, RECORDED, copies
from animarl_algos.evaluation.statistics import (
    NOTHING_SHARED,
    RESAMPLES,
    UNDEFINED,
    Cells,
    Draws,
    Floats,
    Interval,
    bootstrap_difference,
    bootstrap_mean,
    cells,
    covers,
    put_intervals,
    shared_starts,
    single_cells,
    within_intervals,
)

if TYPE_CHECKING:
    import pandas as pd

COUNTING = {"all": "all episodes", "captures": "captures only"}
PLANNED_CONTRASTS = (("DQDIL", "DQAAS"), ("DQDIL-PT", "DQAAS"), ("DQDIL-PT", "DQDIL"))
GATE_LEVEL = 0.05
PAIR_COLUMNS = [
    "metric", "counting", "first", "second", "demos", "pairing", "covers",
    "difference", "difference_low", "difference_high",
    "energy", "energy_low", "energy_high", "reason",
]  # fmt: skip
CONTRAST_COLUMNS = [
    "metric", "measure", "first", "second", "demos", "covers",
    "difference", "difference_low", "difference_high",
    "gate", "gate_f", "gate_p", "gate_unit", "gate_passed", "reason",
]  # fmt: skip


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


class _Methods:
    """Rows that may be compared, by method, gathered into cells of seed and demonstration."""

    def __init__(self, metrics: pd.DataFrame, num_demos: int) -> None:
        by_method = factual(metrics).groupby("method", sort=False)
        self.rows = {str(name): rows for name, rows in by_method}
        self.simulated = [name for name in self.rows if name != RECORDED]
        self.num_demos = num_demos

    def values(self, name: str, metric: Metric, counting: str) -> pd.Series[float]:
        """Of every rollout, NaN where it does not count."""
        rows = self.rows[name]
        return rows[metric.key].where(rows["captured"] | (counting == "all"))

    def cells(self, name: str, metric: Metric, counting: str = "all") -> Cells:
        rows = self.rows[name]
        return cells(
            self.values(name, metric, counting), rows["seed"], rows["demo"], self.num_demos
        )

    def energy(self, name: str, metric: Metric, counting: str = "all") -> Cells:
        """Energy score at every start."""
        rows, truth = self.rows[name], self.cells(RECORDED, metric, counting).cell_means[0]
        return energy_cells(self.values(name, metric, counting), rows["seed"], rows["demo"], truth)

    def exchanges(self, name: str, rng: np.random.Generator, resamples: int) -> Exchanges:
        rows = self.rows[name]
        measured = rows.drop(columns=["method", "seed", "demo", "repetition"])
        done = [row.tobytes() for row in measured.to_numpy(dtype=np.float64)]
        same = copies(rows["demo"].tolist(), rows["seed"].tolist(), done)
        return Exchanges.draw(rows["demo"], self.num_demos, rng, resamples, copies=same)


def _counted_metrics(measured: pd.DataFrame) -> list[tuple[Metric, str]]:
    """Every measured metric with every rule of what counts.

    A share among captures would say nothing; where nobody can be reached, there are none.
    """
    known = [metric for metric in METRICS if metric.compared and metric.key in measured]
    rules = tuple(COUNTING) if RETURN in known else ("all",)
    return [(m, rule) for m in known for rule in rules if rule == "all" or not m.share]


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
    One row per method, metric and counting rule. ``rollouts``, ``demos`` and ``seeds`` say how many
    count, ``covers`` what an interval speaks of. Each of the following comes with ``_low`` and
    ``_high``; where they are not defined, ``reason`` says why.

    - ``mean``, and ``within``, the mean again with the interval of
      :func:`~animarl_algos.evaluation.statistics.within_intervals` among the simulated methods;
    - ``to_recorded``: less the recorded mean, on the ``to_recorded_demos`` starts that both have;
    - ``energy``: mean energy score per start, the primary measure of a distribution; beside it
      ``energy_pooled``, what the recordings of all other starts score;
    - ``kde``: the kernel-density distance of the pooled values; ``kde_null`` are mean and central
      95 % of what a perfect simulator gives, ``kde_p`` how often it gives as much.

    Beside a distance to the recordings (DTW) stand ``duration`` and ``reached`` of the same
    episodes, without which a short episode passes for a close one.
    """
    import pandas as pd

    methods, draws = _Methods(metrics, num_demos), Draws.by(rng, resamples)
    exchanges = {
        name: methods.exchanges(name, rng, distance_resamples) for name in methods.simulated
    }
    table, reaches = [], RETURN.key in metrics
    for metric, counting in _counted_metrics(metrics):
        gathered = {name: methods.cells(name, metric, counting) for name in methods.rows}
        among = within_intervals([gathered[name] for name in methods.simulated], draws)
        within = dict(zip(methods.simulated, among))
        reference = gathered[RECORDED]
        truth = reference.cell_means[0]
        for name, data in gathered.items():
            simulation, rows = name != RECORDED, methods.rows[name]
            compared = simulation and metric.of_recordings
            if not (simulation or metric.of_recordings):
                continue
            shared = data.starts & reference.starts
            gap = energy = kde = kde_null = UNDEFINED
            pooled = kde_p = math.nan
            if compared:
                gap = bootstrap_difference(data, reference, draws, share=metric.share)
            if compared and metric.has_distribution:
                energies = methods.energy(name, metric, counting)
                energy = _energy_interval(bootstrap_mean(energies, draws), energies)
                pooled = pooled_score(truth[shared])
                values = methods.values(name, metric, counting)
                kde = bootstrap_kde(
                    values, truth, rows["seed"], rows["demo"], rng, distance_resamples
                )
                kde_null, kde_p = exchanges[name].kde(np.concatenate([truth, values]))
            reason = "" if simulation else "recordings are what is compared with"
            if simulation and not metric.has_distribution:
                reason = "a share has no distribution" if metric.share else "it is a distance"
            row: dict[str, Any] = {
                "method": name,
                "metric": metric.key,
                "counting": counting,
                "rollouts": int(data.counts.sum()),
                "demos": int(data.starts.sum()),
                "seeds": len(data.counts),
                "covers": covers(data) if simulation else "demonstrations like these",
                "to_recorded_demos": int(shared.sum()) if compared else 0,
                "energy_pooled": pooled,
                "duration": methods.cells(name, DURATION, counting).mean,
                "reached": methods.cells(name, RETURN, counting).mean if reaches else math.nan,
                "reason": reason,
            }
            mean = bootstrap_mean(data, draws, share=metric.share)
            put_intervals(
                row, mean=mean, within=within.get(name, UNDEFINED), to_recorded=gap, energy=energy,
                kde=kde, kde_null=kde_null,
            )  # fmt: skip
            table.append(row | {"kde_p": kde_p})
    return pd.DataFrame(table)


def pair_table(
    metrics: pd.DataFrame, num_demos: int, rng: np.random.Generator, *, resamples: int = RESAMPLES
) -> pd.DataFrame:
    """Every simulated method minus every other, paired by demonstration.

    One row per metric, counting rule and ordered pair: the ``difference`` of their means and of
    their ``energy`` scores (below zero, the ``first`` is closer to the recordings) with 95 %
    intervals, and the ``reason`` where there is none. Only starts that both have count: ``demos``
    of them, which ``pairing`` says if they are not all. Nothing corrects for the number of pairs.
    """
    import pandas as pd

    methods, draws = _Methods(metrics, num_demos), Draws.by(rng, resamples)
    table = []
    for metric, counting in _counted_metrics(metrics):
        data = {name: methods.cells(name, metric, counting) for name in methods.simulated}
        energies = {}
        if metric.has_distribution and RECORDED in methods.rows:
            energies = {name: methods.energy(name, metric, counting) for name in data}
        for first, second in ordered_pairs(data, 2):
            one, other = data[first], data[second]
            same = (one.starts == other.starts).all()
            row: dict[str, Any] = {
                "metric": metric.key,
                "counting": counting,
                "first": first,
                "second": second,
                "demos": int((one.starts & other.starts).sum()),
                "pairing": "paired, same starts" if same else "paired, shared starts only",
                "covers": covers(one, other),
                "reason": "",
            }
            energy = UNDEFINED
            if energies:
                sides = energies[first], energies[second]
                energy = _energy_interval(bootstrap_difference(*sides, draws), *sides)
            gap = bootstrap_difference(one, other, draws, share=metric.share)
            put_intervals(row, difference=gap, energy=energy)
            table.append(row)
    return pd.DataFrame(table, columns=PAIR_COLUMNS)


def contrast_table(
    metrics: pd.DataFrame,
    num_demos: int,
    rng: np.random.Generator,
    *,
    planned: Sequence[tuple[str, str]] = PLANNED_CONTRASTS,
    resamples: int = RESAMPLES,
) -> pd.DataFrame:
    """The planned contrasts, behind their gate; empty if fewer than two methods take part.

    Compared is, by ``measure``, how far a method is from the recordings; below zero, the first is
    closer. All episodes count, from the ``demos`` starts that all methods have.

    - ``energy score``: per seed and start, the primary measure;
    - ``absolute gap``: between the mean over repetitions and the recorded value, as in the paper;
      it is smallest for a simulator that always does the same, so it stands beside the first;
    - ``distance``: for DTW the distance itself.

    The gate is a one-way ANOVA over all methods that take part, with the null of exchanged training
    seeds (``gate_unit``). Only behind a passed gate does a contrast have an interval; elsewhere
    ``reason`` says why not.
    """
    import pandas as pd

    methods = _Methods(metrics, num_demos)
    own = {name.casefold(): name for name in methods.rows}
    named = [(own.get(one.casefold()), own.get(other.casefold())) for one, other in planned]
    pairs = [(one, other) for one, other in named if one is not None and other is not None]
    taking_part = list(dict.fromkeys(name for pair in pairs for name in pair))
    table: list[dict[str, Any]] = []
    if len(taking_part) < 2 or num_demos < 2:
        return pd.DataFrame(table, columns=CONTRAST_COLUMNS)
    draws = Draws.by(rng, resamples)
    for metric in (metric for metric in METRICS if metric.planned):
        for measure in ("energy score", "absolute gap") if metric.of_recordings else ("distance",):
            found = {}
            for name in taking_part:
                if measure == "energy score":
                    found[name] = methods.energy(name, metric)
                else:
                    means = methods.cells(name, metric).cell_means
                    if measure == "absolute gap":
                        means = np.abs(means - methods.cells(RECORDED, metric).cell_means)
                    found[name] = single_cells(means)
            shared = dict(zip(found, shared_starts(list(found.values()))))
            demos = shared[taking_part[0]].sums.shape[1]
            gate, words = None, NOTHING_SHARED
            if demos > 0:
                gate = permutation_anova([data.seed_means for data in shared.values()], rng,
                                         resamples)  # fmt: skip
                words = gate.decision
            elif measure == "energy score" and not all(d.counts.any() for d in found.values()):
                words = FEW_ROLLOUTS
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
                    "gate_passed": words == "passed",
                    "reason": "",
                }
                value = bootstrap_difference(shared[first], shared[second], draws)
                if words != "passed":
                    value = Interval(value.estimate, reason=f"the gate: {words}")
                put_intervals(row, difference=value)
                table.append(row)
    return pd.DataFrame(table, columns=CONTRAST_COLUMNS)


def _energy_interval(found: Interval, *sides: Cells) -> Interval:
    enough = all(data.counts.any() for data in sides)
    return found if enough else Interval(math.nan, reason=FEW_ROLLOUTS)


# -- the gate -------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Anova:
    """One-way F of the methods' training seeds with its permutation p.

    If methods do not differ, which seeds belong to which method means nothing, so the null is what
    all ways to deal the seeds to the methods give: ``arrangements`` of them. With 2 methods of 3
    seeds there are 20, of which the observed one and its mirror image are equally good, so that p
    is never below 0.1. ``least`` is the smallest p that any of them could have had.
    """

    f: float
    p: float
    seeds: tuple[int, ...]
    arrangements: int
    exact: bool
    least: float

    @property
    def decision(self) -> str:
        """Whether the gate is passed, where the most extreme arrangement would have done."""
        if self.least > GATE_LEVEL:
            return "cannot be decided with so few seeds"
        return "passed" if self.p <= GATE_LEVEL else "not passed"

    @property
    def permutes(self) -> str:
        """In words, over what the null goes."""
        dealt = " + ".join(str(number) for number in self.seeds)
        ways = "all" if self.exact else "a sample of the"
        return (
            f"which method a training seed belongs to ({dealt} seeds, {ways} "
            f"{self.arrangements:,} ways)"
        )


def permutation_anova(
    methods: Sequence[Floats], rng: np.random.Generator, permutations: int = RESAMPLES
) -> Anova:
    """Whether the methods, each ``(seeds,)``, differ more than their training seeds do.

    All arrangements are gone through if there are no more than ``permutations``, else so many
    drawn. The observed one counts among those as extreme, so p is never zero and is valid for any
    number.
    """
    from scipy.stats import f_oneway

    sizes, values = tuple(map(len, methods)), np.concatenate(methods)
    ways = math.factorial(len(values)) // math.prod(math.factorial(size) for size in sizes)
    alike = math.prod(math.factorial(sizes.count(size)) for size in set(sizes))
    exact = ways <= permutations
    least = alike / ways if exact else max(alike / ways, 1 / (1 + permutations))
    if len(values) == len(sizes):  # one seed each: nothing varies within a method
        return Anova(math.nan, math.nan, sizes, ways, exact, 1.0)
    if np.ptp(values) == 0:
        return Anova(0.0, 1.0, sizes, ways, exact, least)
    labels = np.repeat(np.arange(len(sizes)), sizes)
    if exact:
        dealt = np.array(list(_arrangements(sizes)))
    else:
        dealt = rng.permuted(np.broadcast_to(labels, (permutations, len(labels))), axis=1)
    # Squares between methods: the total stays, so they order arrangements as F does.
    belongs = np.stack([labels, *dealt])[:, None] == np.arange(len(sizes))[:, None]
    means = (belongs * (values - values.mean())).sum(axis=-1) / sizes
    between = (means**2 * sizes).sum(axis=-1)
    at_least = int(np.count_nonzero(between[1:] >= between[0] * (1 - 1e-9)))
    p = at_least / ways if exact else (1 + at_least) / (1 + permutations)
    return Anova(float(f_oneway(*methods).statistic), p, sizes, ways, exact, least)


def _arrangements(sizes: tuple[int, ...]) -> Iterator[list[int]]:
    """All ways to deal ``sum(sizes)`` seeds, as the method of each seed."""
    if not any(sizes):
        yield []
    for method in np.flatnonzero(sizes).tolist():
        left = tuple(size - (one == method) for one, size in enumerate(sizes))
        for others in _arrangements(left):
            yield [method, *others]
