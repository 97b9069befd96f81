"""One-way analysis of variance over training seeds, with the null of exchanged labels.

If methods do not differ, which seeds belong to which method means nothing, so the null of F is what
all ways to deal the seeds to the methods give. Only so many ways exist: with 2 methods of 3 seeds
20, of which the observed one and its mirror image are equally good, so that p is never below 0.1.
Where no arrangement at all would reach the level, the question cannot be decided.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from animarl_algos.evaluation.studentised import RESAMPLES, Floats
from animarl_envs.errors import InputError

TOO_FEW_SEEDS = "cannot be decided with so few seeds"


@dataclass(frozen=True)
class Anova:
    """One-way F of the methods' seeds with its permutation p.

    ``arrangements`` is the number of ways to deal the seeds to the methods; ``least`` the smallest
    p that any of them could have had.
    """

    f: float
    p: float
    seeds: tuple[int, ...]
    arrangements: int
    exact: bool
    least: float

    def can_decide(self, level: float) -> bool:
        """Whether the most extreme arrangement would have passed."""
        return self.least <= level

    @property
    def permutes(self) -> str:
        """In words, over what the null goes."""
        dealt = " + ".join(str(number) for number in self.seeds)
        ways = "all" if self.exact else "a sample of the"
        return (
            f"which method a training seed belongs to ({dealt} seeds, {ways} "
            f"{self.arrangements:,} ways)"
        )


def f_statistic(values: Floats, method: NDArray[np.integer]) -> Floats:
    """One-way F of ``(..., seeds)`` with the method of each, ``(..., seeds)`` from 0 on.

    Variance between methods over that within them; NaN where nothing varies.
    """
    number = int(method.max()) + 1
    belongs = method[..., None, :] == np.arange(number)[:, None]
    size = belongs.sum(axis=-1)
    mean = np.where(belongs, values[..., None, :], 0.0).sum(axis=-1) / size
    grand = values.mean(axis=-1)
    between = (size * np.square(mean - grand[..., None])).sum(axis=-1)
    within = np.maximum(np.square(values - grand[..., None]).sum(axis=-1) - between, 0.0)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray((between / (number - 1)) / (within / (values.shape[-1] - number)))


def permutation_anova(
    methods: Sequence[Floats], rng: np.random.Generator, permutations: int = RESAMPLES
) -> Anova:
    """Whether the methods differ more than their training seeds do.

    Parameters
    ----------
    methods
        One array ``(seeds,)`` per method, of any lengths.
    permutations
        All arrangements are gone through if there are no more than this, else so many drawn.

    Returns
    -------
    The observed arrangement counts among those as extreme, so p is never zero and is valid for any
    number of permutations.

    Raises
    ------
    InputError
        If there are fewer than two methods, or a value is missing.
    """
    arrays = [np.asarray(method, dtype=np.float64).ravel() for method in methods]
    if (
        len(arrays) < 2
        or min(map(len, arrays)) < 1
        or not np.isfinite(np.concatenate(arrays)).all()
    ):
        raise InputError("an ANOVA needs two methods at least, of finite values")
    sizes = tuple(len(array) for array in arrays)
    values, labels = np.concatenate(arrays), np.repeat(np.arange(len(sizes)), sizes)
    ways = math.factorial(len(values)) // math.prod(math.factorial(size) for size in sizes)
    alike = math.prod(math.factorial(sizes.count(size)) for size in set(sizes))
    exact = ways <= permutations
    least = alike / ways if exact else max(alike / ways, 1 / (1 + permutations))
    if len(values) == len(sizes):  # one seed each: nothing varies within a method
        return Anova(math.nan, math.nan, sizes, ways, exact, 1.0)
    if np.ptp(values) == 0:
        return Anova(0.0, 1.0, sizes, ways, exact, least)
    if exact:
        dealt = np.array(list(_arrangements(sizes)))
    else:
        dealt = rng.permuted(np.broadcast_to(labels, (permutations, len(labels))), axis=1)
    observed = float(f_statistic(values, labels))
    null = f_statistic(np.broadcast_to(values, dealt.shape), dealt)
    at_least = int(np.count_nonzero(~(null < observed * (1 - 1e-9))))
    p = at_least / ways if exact else (1 + at_least) / (1 + permutations)
    return Anova(observed, p, sizes, ways, exact, least)


def _arrangements(sizes: Sequence[int]) -> Iterator[NDArray[np.int64]]:
    """All ways to deal ``sum(sizes)`` seeds, as the method of each seed."""

    def deal(free: tuple[int, ...], method: int) -> Iterator[list[tuple[int, int]]]:
        if method == len(sizes):
            yield []
            return
        for chosen in combinations(free, sizes[method]):
            rest = tuple(seed for seed in free if seed not in chosen)
            for others in deal(rest, method + 1):
                yield [*((seed, method) for seed in chosen), *others]

    for pairs in deal(tuple(range(sum(sizes))), 0):
        labels = np.empty(sum(sizes), dtype=np.int64)
        for seed, method in pairs:
            labels[seed] = method
        yield labels
