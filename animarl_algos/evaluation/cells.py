"""One metric by training seed and demonstration, what all statistics are worked out from."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from animarl_envs.errors import InputError

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Cells:
    """Sums and counts of one metric per training seed and demonstration, each ``(seeds, demos)``.

    The mean over any resample of seeds and demonstrations is a ratio of the two.
    """

    sums: Floats
    counts: Floats

    def __post_init__(self) -> None:
        if self.sums.ndim != 2 or self.sums.shape != self.counts.shape:
            raise InputError(
                f"sums {self.sums.shape} and counts {self.counts.shape} must both be (seeds, demos)"
            )

    @property
    def mean(self) -> float:
        total = self.counts.sum()
        return float(self.sums.sum() / total) if total else math.nan

    @property
    def cell_means(self) -> Floats:
        """Mean per seed and demonstration, NaN where nothing counts."""
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.asarray(self.sums / self.counts)

    @property
    def present(self) -> NDArray[np.bool_]:
        """``(seeds, demos)``, where something counts."""
        return self.counts > 0

    @property
    def starts(self) -> NDArray[np.bool_]:
        """``(demos,)``, where something counts for any seed."""
        return np.asarray(self.present.any(axis=0))

    @property
    def even(self) -> Cells:
        """The same with every demonstration weighing one, and within it every seed the same."""
        share = self.present / np.maximum(self.present.sum(axis=0), 1)
        return Cells(np.where(self.present, self.cell_means, 0.0) * share, share)

    @property
    def deviations(self) -> Floats:
        """What each cell adds to the mean's deviation, ``(seeds, demos)``, zero on average.

        The mean is a ratio of sums; this is its linear part, exact where counts are equal. A cell
        in which nothing counts adds nothing.
        """
        total = self.counts.sum()
        if total == 0:
            return np.zeros(self.sums.shape)
        left = self.sums - self.sums.sum() / total * self.counts
        return np.asarray(left * (left.size / total))

    def of(self, demos: NDArray[np.bool_]) -> Cells:
        """Those of some demonstrations, without seeds that have none of them."""
        sums, counts = self.sums[:, demos], self.counts[:, demos]
        seeds = counts.sum(axis=1) > 0
        return Cells(sums[seeds], counts[seeds])


def cells(
    values: ArrayLike, seed: ArrayLike, demo: ArrayLike, num_demos: int, counts: ArrayLike = True
) -> Cells:
    """Gather one value per rollout into cells of seed and demonstration.

    Parameters
    ----------
    values, seed, demo
        ``(rollouts,)``: the metric, the training seed, and the demonstration's index below
        ``num_demos``.
    counts
        ``(rollouts,)`` bool, which rollouts count; NaN values never do.
    """
    values = np.asarray(values, dtype=np.float64)
    seeds, row = np.unique(np.asarray(seed), return_inverse=True)
    chosen = np.isfinite(values) & np.asarray(counts)
    place = (row.ravel()[chosen], np.asarray(demo)[chosen])
    sums, number = np.zeros((len(seeds), num_demos)), np.zeros((len(seeds), num_demos))
    np.add.at(sums, place, values[chosen])
    np.add.at(number, place, 1.0)
    return Cells(sums, number)
