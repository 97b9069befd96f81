"""Which rollouts a report shows: by rank, from starts that are all different."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from animarl_algos.evaluation.comparison import factual
from animarl_algos.evaluation.metrics import DTW
from animarl_algos.evaluation.rollouts import Rollouts
from animarl_algos.report.inputs import ReportInputs


class Examples(NamedTuple):
    """Rollouts of one condition, from the nearest to its demonstration to the farthest."""

    condition: str  # its name; empty where there is one only
    chosen: list[int]  # indices of rollouts


def at_ranks(values: ArrayLike, starts: ArrayLike, quantiles: Sequence[float]) -> NDArray[np.int64]:
    """Indices of the values nearest in rank to the quantiles, no two from one start.

    There are fewer than asked for where there are fewer starts.
    """
    starts = np.asarray(starts)
    order = np.argsort(np.asarray(values), kind="stable")
    chosen: list[int] = []
    used: set[int] = set()
    for quantile in quantiles:
        wanted = quantile * (len(order) - 1)
        for rank in np.argsort(np.abs(np.arange(len(order)) - wanted), kind="stable").tolist():
            start = int(starts[order[rank]])
            if start not in used:
                used.add(start)
                chosen.append(int(order[rank]))
                break
    ranks = np.argsort(order)
    return np.array(sorted(chosen, key=lambda i: ranks[i]), dtype=np.int64)


def factual_rollouts(inputs: ReportInputs) -> tuple[Rollouts, NDArray[np.float64]]:
    """The rollouts of the learner that the tables compare, and their DTW distances."""
    rollouts = inputs.rollouts[inputs.learner]
    rows = inputs.evaluation.metrics
    first = int(np.flatnonzero(rows["method"] == inputs.learner)[0])
    compared = factual(rows)
    compared = compared[compared["method"] == inputs.learner]
    chosen = compared.index.to_numpy() - first  # rows stand in the order of the rollouts
    return rollouts.select(chosen), compared[DTW.key].to_numpy(dtype=np.float64)


def examples(inputs: ReportInputs, quantiles: Sequence[float]) -> Iterator[Examples]:
    """Per condition present, the factual rollouts at these quantiles of the DTW distance."""
    rollouts, dtw = factual_rollouts(inputs)
    present = np.unique(rollouts.condition).tolist()
    named = len(present) > 1 and len(inputs.conditions) == 2
    for condition in present:
        among = np.flatnonzero(rollouts.condition == condition)
        ranked = at_ranks(dtw[among], rollouts.demo[among], quantiles)
        name = inputs.conditions[condition] if named else ""
        yield Examples(name, among[ranked].tolist())
