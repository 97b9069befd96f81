"""Ranks where intervals allow them: by the joint energy score, paired by test start.

A method is better than another where the 95 % interval of the difference of their energy scores,
over demonstrations and seeds, lies below zero. Its rank is then a range: from one more than the
number of methods that are better, to the number of all less those that are worse. Nothing corrects
the pairs for their number.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from animarl_algos.benchmark.measured import Score
from animarl_algos.benchmark.scores import SEED
from animarl_algos.evaluation.statistics import bootstrap_difference

UNRANKED = ("recordings", "tracking")
"""References that were told where the recordings go."""
ROUNDING = 1e-9
"""Differences of energy scores up to it are those of sums in another order, and rank nothing."""


@dataclass(frozen=True)
class Rank:
    """The best and the worst place that the intervals allow."""

    best: int
    worst: int

    def __str__(self) -> str:
        return f"{self.best}" if self.best == self.worst else f"{self.best}–{self.worst}"


def ranked(scores: Sequence[Score], resamples: int) -> dict[str, Rank]:
    """The rank of each method of one set of demonstrations that can be ranked, by its name."""
    taking_part = [
        one for one in scores if one.method not in UNRANKED and one.energy_cells.counts.any()
    ]
    better = {one.method: 0 for one in taking_part}
    worse = dict(better)
    for i, first in enumerate(taking_part):
        for second in taking_part[i + 1 :]:
            gap = bootstrap_difference(
                first.energy_cells, second.energy_cells, np.random.default_rng(SEED), resamples
            )
            if gap.excludes_zero and abs(gap.estimate) > ROUNDING:
                winner, loser = (first, second) if gap.high < 0 else (second, first)
                better[loser.method] += 1
                worse[winner.method] += 1
    return {name: Rank(1 + n, len(better) - worse[name]) for name, n in better.items()}
