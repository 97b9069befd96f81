"""How far an interval reaches below and above an estimate over crossed seeds and demonstrations.

Every training seed was asked every demonstration, so an estimate errs for two reasons: which
demonstrations there happened to be, and which networks training happened to give. Their margins are
worked out apart and added as squares, below and above the estimate (the method of variance
estimates recovery: Zou and Donner 2008, Stat. Med. 27, 1693; for crossed effects Graybill and Wang
1980, J. Am. Stat. Assoc. 75, 869). A single t interval on the sum of variances, with
Satterthwaite's degrees of freedom, is too short with three seeds that vary about as much as the
demonstrations.

- Demonstrations: the studentised bootstrap (bootstrap-t: Efron and Tibshirani 1993, chapter 12) of
  the mean over demonstrations, which follows skewed values; Student's t where there are too few.
- Seeds: Student's t on what the seeds' means vary beyond their share of the demonstrations.
  Rollouts are within cells of seed and demonstration and never count as independent.

Coverage is measured by ``benchmarks/stated_coverage.py`` and told in ``docs/statistics.md``.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Hashable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from animarl_envs.errors import InputError

Floats = NDArray[np.float64]

RESAMPLES = 10_000
CONFIDENCE = 0.95
FEWEST_RESAMPLED = 8  # demonstrations; of fewer, resamples often have no spread to divide by
FEWEST_ALONE = 20  # ... and of fewer than these a margin is at least that of Student's t


def draw_weights(rng: np.random.Generator, count: int, resamples: int = RESAMPLES) -> Floats:
    """How often each of ``count`` units is drawn, ``(resamples, count)``; rows sum to ``count``."""
    if count < 1:
        raise InputError("there is nothing to resample: give at least one unit")
    drawn = rng.integers(count, size=(resamples, count))
    place = drawn + count * np.arange(resamples)[:, None]
    counted = np.bincount(place.ravel(), minlength=resamples * count)
    return counted.reshape(resamples, count).astype(np.float64)


@dataclass(eq=False)
class Draws:
    """Resamples of any number of demonstrations, the same ones whenever they are asked for."""

    seed: int
    resamples: int = RESAMPLES
    _known: dict[int, Floats] = field(default_factory=dict, repr=False)

    @classmethod
    def by(cls, rng: np.random.Generator, resamples: int = RESAMPLES) -> Draws:
        return cls(int(rng.integers(2**62)), resamples)

    def of(self, count: int) -> Floats:
        """``(resamples, count)``."""
        if count not in self._known:
            rng = np.random.default_rng([self.seed, count])
            self._known[count] = draw_weights(rng, count, self.resamples)
        return self._known[count]


@dataclass(frozen=True, eq=False)
class Part:
    """One term of an estimate, a sum or difference of means.

    ``deviations`` is ``(..., seeds, demos)``: what each cell adds to the term's deviation, so that
    their mean is zero. Parts with equal ``seeds`` are of the same networks, and with equal
    ``demos`` on the same demonstrations, in the same order.
    """

    deviations: Floats
    seeds: Hashable = 0
    demos: Hashable = 0


def margins(
    parts: Sequence[Part], draws: Draws, confidence: float = CONFIDENCE
) -> tuple[Floats, Floats]:
    """Lengths of the interval below and above the estimate, ``(...,)`` each."""
    by_demos: dict[Hashable, list[Floats]] = defaultdict(list)
    by_seeds: dict[Hashable, dict[Hashable, list[Floats]]] = defaultdict(lambda: defaultdict(list))
    for part in parts:
        by_demos[part.demos].append(part.deviations.mean(axis=-2))
        by_seeds[part.seeds][part.demos].append(part.deviations)
    squares = np.zeros((2, *parts[0].deviations.shape[:-2]))
    for means in by_demos.values():
        below, above = demo_margins(np.sum(means, axis=0), draws, confidence)
        squares += np.square([below, above])
    networks = [[np.sum(same, axis=0) for same in one.values()] for one in by_seeds.values()]
    squares += seed_square(networks, confidence)
    below, above = np.sqrt(squares)
    return below, above


def demo_margins(
    values: Floats, draws: Draws, confidence: float = CONFIDENCE
) -> tuple[Floats, Floats]:
    """Of the mean of ``values`` ``(..., demos)``, by the studentised bootstrap, or by t."""
    number = values.shape[-1]
    if number < 2:
        raise InputError("one demonstration shows no spread: give two at least")
    error = values.std(axis=-1, ddof=1) / np.sqrt(number)
    low, high = (np.full(error.shape, sign * _t(number - 1, confidence)) for sign in (-1, 1))
    if number >= FEWEST_RESAMPLED:
        quantiles = _studentised_quantiles(values, draws.of(number), confidence)
        defined = np.isfinite(quantiles).all(axis=0)
        if number < FEWEST_ALONE:
            quantiles = np.stack([np.minimum(quantiles[0], low), np.maximum(quantiles[1], high)])
        low, high = np.where(defined, quantiles, [low, high])
    return np.maximum(high, 0.0) * error, np.maximum(-low, 0.0) * error


def seed_square(networks: Sequence[Sequence[Floats]], confidence: float = CONFIDENCE) -> Floats:
    """Square of the margin that networks add, ``(...,)``; zero for single seeds, which show none.

    Of each set of networks, its tables ``(..., seeds, demos)``, each on demonstrations of its own.
    Variances of several sets are added, with Welch's degrees of freedom.
    """
    between, within, per_freedom = np.zeros((3, *networks[0][0].shape[:-2]))
    for tables in networks:
        seeds = tables[0].shape[-2]
        if seeds < 2:
            continue
        rows = np.sum([table.mean(axis=-1) for table in tables], axis=0)
        variance = rows.var(axis=-1, ddof=1) / seeds
        between = between + variance
        per_freedom = per_freedom + np.square(variance) / (seeds - 1)
        within = within + sum(_cell_variance(table) for table in tables)
    varies = per_freedom > 0
    freedom = np.where(varies, np.square(between) / np.where(varies, per_freedom, 1.0), 1.0)
    return np.asarray(_t(freedom, confidence) ** 2 * np.maximum(between - within, 0.0))


def _cell_variance(table: Floats) -> Floats:
    """What cells of seed and demonstration add to the variance of their mean."""
    seeds, demos = table.shape[-2:]
    if demos < 2:
        return np.zeros(table.shape[:-2])
    rows, columns = table.mean(axis=-1, keepdims=True), table.mean(axis=-2, keepdims=True)
    left = table - rows - columns + rows.mean(axis=-2, keepdims=True)
    freedom = (seeds - 1) * (demos - 1)
    return np.asarray(np.square(left).sum(axis=(-2, -1)) / freedom / (seeds * demos))


def share_margins(
    share: Floats, values: Floats, confidence: float = CONFIDENCE
) -> tuple[Floats, Floats]:
    """Of a share, the mean of ``values`` ``(..., demos)`` about it, after Wilson (1927).

    The number of independent episodes is what the spread between demonstrations says it is; if they
    all are alike, that of the demonstrations.
    """
    number = values.shape[-1]
    t = _t(number - 1, confidence)
    variance = values.var(axis=-1, ddof=1) / number
    spread = share * (1.0 - share)
    with np.errstate(divide="ignore", invalid="ignore"):
        episodes = np.where((variance > 0) & (spread > 0), spread / variance, number)
    shrink = 1.0 + t**2 / episodes
    centre = (share + t**2 / (2 * episodes)) / shrink
    half = t / shrink * np.sqrt(spread / episodes + t**2 / (4 * episodes**2))
    return np.maximum(share - centre + half, 0.0), np.maximum(centre + half - share, 0.0)


def _studentised_quantiles(values: Floats, weights: Floats, confidence: float) -> Floats:
    """Quantiles ``(2, ...)`` of resampled deviations, each over its own standard error."""
    number = values.shape[-1]
    flat = (values - values.mean(axis=-1, keepdims=True)).reshape(-1, number).T
    mean = weights @ flat / number
    variance = np.maximum(weights @ np.square(flat) / number - np.square(mean), 0.0)
    floor = 1e-12 * np.square(flat).mean(axis=0)  # of rounding, not of spread
    with np.errstate(divide="ignore", invalid="ignore"):
        t = mean / np.sqrt(np.where(variance > floor, variance, 0.0) / (number - 1))
    t = np.where(np.isnan(t), 0.0, t)  # no spread and no deviation
    tail = 50.0 * (1.0 - confidence)
    with np.errstate(invalid="ignore"):
        ends = np.percentile(t, [tail, 100.0 - tail], axis=0)
    return np.asarray(ends).reshape(2, *values.shape[:-1])


def _t(freedom: float | Floats, confidence: float) -> Floats:
    from scipy.special import stdtrit

    return np.asarray(stdtrit(freedom, 0.5 + confidence / 2))
