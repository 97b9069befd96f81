"""Every method against the recordings and against every other one.

Which episodes count is part of every row: ``"all"``, or ``"captures"`` (rollouts and recordings in
which the target was reached). The two can point in opposite directions, so both are always there.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import permutations as ordered_pairs
from typing import TYPE_CHECKING, Any

import numpy as np

from animarl_algos.evaluation.metrics import DURATION, METRICS, RETURN, Metric
from animarl_algos.evaluation.rollouts import NO_CUE, RECORDED
from animarl_algos.evaluation.statistics import (
    FEW_ROLLOUTS,
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
    energy_cells,
    pooled_score,
    put_intervals,
    shared_starts,
)

if TYPE_CHECKING:
    import pandas as pd

COUNTING = {"all": "all episodes", "captures": "captures only"}
PLANNED_CONTRASTS = (("DQDIL", "DQAAS"), ("DQDIL-PT", "DQAAS"), ("DQDIL-PT", "DQDIL"))
GATE_LEVEL = 0.05
PAIR_COLUMNS = [
    "metric", "counting", "first", "second", "demos", "pairing", "covers",
    "difference", "difference_low", "difference_high",
    "energy", "energy_low", "energy_high", "gate", "gate_p", "reason",
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

    - ``mean``;
    - ``to_recorded``: less the recorded mean, on the ``to_recorded_demos`` starts that both have;
    - ``energy``: mean energy score per start, the measure of a distribution; beside it
      ``energy_pooled``, what the recordings of all other starts score.

    Beside a distance to the recordings (DTW) stand ``duration`` and ``reached`` of the same
    episodes, without which a short episode passes for a close one.
    """
    import pandas as pd

    methods, draws = _Methods(metrics, num_demos), Draws.by(rng, resamples)
    table, reaches = [], RETURN.key in metrics
    for metric, counting in _counted_metrics(metrics):
        gathered = {name: methods.cells(name, metric, counting) for name in methods.rows}
        reference = gathered[RECORDED]
        truth = reference.cell_means[0]
        for name, data in gathered.items():
            simulation = name != RECORDED
            compared = simulation and metric.of_recordings
            if not (simulation or metric.of_recordings):
                continue
            shared = data.starts & reference.starts
            gap, energy, pooled = UNDEFINED, UNDEFINED, math.nan
            if compared:
                gap = bootstrap_difference(data, reference, draws, share=metric.share)
            if compared and metric.has_distribution:
                energies = methods.energy(name, metric, counting)
                energy = _energy_interval(bootstrap_mean(energies, draws), energies)
                pooled = pooled_score(truth[shared])
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
            put_intervals(row, mean=mean, to_recorded=gap, energy=energy)
            table.append(row)
    return pd.DataFrame(table)


def pair_table(
    metrics: pd.DataFrame, num_demos: int, rng: np.random.Generator, *, resamples: int = RESAMPLES
) -> pd.DataFrame:
    """Every simulated method minus every other, paired by demonstration.

    One row per metric, counting rule and ordered pair: the ``difference`` of their means and of
    their ``energy`` scores (below zero, the ``first`` is closer to the recordings) with 95 %
    intervals, and the ``reason`` where there is none. Only starts that both have count: ``demos``
    of them, which ``pairing`` says if they are not all. Nothing corrects for the number of pairs.

    A pair that was planned (``PLANNED_CONTRASTS``) also has the ``gate``, all episodes counting: an
    ANOVA over the training seeds of all methods that are in such a pair, by their energy scores
    (DTW distances by themselves), and its ``gate_p``. Nothing is concluded from a planned pair
    whose gate is not passed.
    """
    import pandas as pd

    methods, draws = _Methods(metrics, num_demos), Draws.by(rng, resamples)
    own = {name.casefold(): name for name in methods.simulated}
    planned = {
        (own[one.casefold()], own[other.casefold()])
        for one, other in PLANNED_CONTRASTS
        if {one.casefold(), other.casefold()} <= set(own)
    }
    table = []
    for metric, counting in _counted_metrics(metrics):
        data = {name: methods.cells(name, metric, counting) for name in methods.simulated}
        energies = {}
        if metric.has_distribution and RECORDED in methods.rows:
            energies = {name: methods.energy(name, metric, counting) for name in data}
        opened = None
        if planned and metric.planned and counting == "all":
            opened = _gate_of(energies or data, {one for pair in planned for one in pair}, rng)
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
            if opened is not None and (first, second) in planned:
                row |= {"gate": opened.decision, "gate_p": opened.p}
            table.append(row)
    found = pd.DataFrame(table, columns=PAIR_COLUMNS)
    return found.assign(gate=found["gate"].astype(object).fillna(""))


def _gate_of(data: Mapping[str, Cells], taking_part: set[str], rng: np.random.Generator) -> Gate:
    """Of the methods that take part, on the starts that all of them have."""
    shared = shared_starts([cells for name, cells in data.items() if name in taking_part])
    if shared[0].counts.shape[1] == 0:
        return Gate(math.nan, math.nan)
    return gate([cells.seed_means for cells in shared], rng)


def _energy_interval(found: Interval, *sides: Cells) -> Interval:
    enough = all(data.counts.any() for data in sides)
    return found if enough else Interval(math.nan, reason=FEW_ROLLOUTS)


# -- the gate -------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Gate:
    """How rarely chance alone makes methods differ as much, and the smallest ``p`` there could be.

    With 2 methods of 3 seeds there are 20 ways to deal the seeds, of which the observed one and its
    mirror image are equally good, so that p is never below 0.1.
    """

    p: float
    least: float

    @property
    def decision(self) -> str:
        """Whether the gate is passed, where the most extreme arrangement would have done."""
        if math.isnan(self.least):
            return "no shared start with two rollouts"
        if self.least > GATE_LEVEL:
            return "cannot be decided with so few seeds"
        return "passed" if self.p <= GATE_LEVEL else "not passed"


def gate(
    methods: Sequence[Floats], rng: np.random.Generator, permutations: int = RESAMPLES
) -> Gate:
    """Whether the methods, each ``(seeds,)``, differ more than their training seeds do.

    A one-way ANOVA whose null exchanges which method a seed belongs to, ``permutations`` times. The
    observed way counts among those as extreme, so p is never zero and is valid for any number.
    """
    sizes, values = np.array(list(map(len, methods))), np.concatenate(methods)
    ways = math.factorial(len(values)) // math.prod(map(math.factorial, sizes.tolist()))
    alike = math.prod(math.factorial(int((sizes == size).sum())) for size in np.unique(sizes))
    least = max(alike / ways, 1 / (1 + permutations))
    if len(values) == len(sizes):  # one seed each: nothing varies within a method
        return Gate(math.nan, 1.0)
    labels = np.repeat(np.arange(len(sizes)), sizes)
    dealt = rng.permuted(np.broadcast_to(labels, (permutations, len(labels))), axis=1)
    # Squares between methods: the total stays, so they order the ways as F does.
    belongs = np.stack([labels, *dealt])[:, None] == np.arange(len(sizes))[:, None]
    between = ((belongs * (values - values.mean())).sum(axis=-1) ** 2 / sizes).sum(axis=-1)
    at_least = int(np.count_nonzero(between[1:] >= between[0] * (1 - 1e-9)))
    return Gate((1 + at_least) / (1 + permutations), least)
