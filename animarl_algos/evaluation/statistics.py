"""Statistics of rollouts against recordings: arrays and a seeded generator in, numbers out.

Rollouts are nested: several from each recorded start, several starts, several training seeds.
Repetitions from one start are never treated as independent; what varies are demonstrations and
seeds, crossed. Their margins are worked out apart and added as squares, below and above the
estimate (Zou and Donner 2008, Stat. Med. 27, 1693; Graybill and Wang 1980, J. Am. Stat. Assoc. 75,
869). ``docs/statistics.md`` says how, and how often these intervals cover.
"""

from __future__ import annotations

import io
import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from animarl_envs.array_types import Bools, Floats, Ints
from animarl_envs.files import read_regular

RESAMPLES = 10_000
CONFIDENCE = 0.95
TAILS = (50.0 * (1 - CONFIDENCE), 50.0 * (1 + CONFIDENCE))  # [%]
FEWEST_RESAMPLED = 8  # demonstrations; of fewer, resamples often have no spread to divide by
FEWEST_ALONE = 50  # ... and up to these a margin is at least that of Student's t
FARTHEST = 2.0  # times as far as the farthest demonstration, or Student's t, is the longest margin

LONGEST_TABLE = 64 * 2**20  # [bytes]
TEXT_COLUMNS = {"reason", "gate", "unit", "covers", "verdict"}

NO_VALUE = "no episode counts"
ONE_DEMO = "one demonstration: no spread to be seen"
ONE_SEED = "one training seed: no spread to be seen"
NOTHING_SHARED = "no shared start"
FEW_ROLLOUTS = "fewer than two rollouts a start"


@dataclass(frozen=True)
class Interval:
    """An estimate with its interval; NaN where it is not defined, and then a ``reason``."""

    estimate: float
    low: float = math.nan
    high: float = math.nan
    reason: str = ""

    @property
    def excludes_zero(self) -> bool:
        return self.low > 0 or self.high < 0


UNDEFINED = Interval(math.nan)


def interval(row: Any) -> Interval:
    """Return the value that a row of a table is about."""
    return Interval(float(row["value"]), float(row["low"]), float(row["high"]), row["reason"])


def row_of(value: Interval, **columns: Any) -> dict[str, Any]:
    """Return a row of a table: what it is about, its value with its interval, or why there is none.

    All tables of an evaluation name these so: ``value``, ``low``, ``high``, ``reason``.
    """
    ends = {"value": value.estimate, "low": value.low, "high": value.high}
    return columns | ends | {"reason": value.reason}


def read_table(file: Path) -> pd.DataFrame:
    """Read a table as it was written: a column of ``TEXT_COLUMNS`` may be empty throughout."""
    try:
        content = io.BytesIO(read_regular(file, LONGEST_TABLE))
        table = pd.read_csv(content, float_precision="round_trip")
    except pd.errors.EmptyDataError:
        return pd.DataFrame()
    for words in TEXT_COLUMNS & set(table):
        table[words] = table[words].astype(object).fillna("")
    return table


@dataclass(frozen=True, eq=False)
class Cells:
    """Sums and counts of one metric per training seed and demonstration, each ``(seeds, demos)``.

    The mean over any resample of seeds and demonstrations is a ratio of the two. ``lacking`` says
    why there is none where nothing counts.
    """

    sums: Floats
    counts: Floats
    lacking: str = NO_VALUE

    @property
    def mean(self) -> float:
        total = self.counts.sum()
        return float(self.sums.sum() / total) if total else math.nan

    @property
    def cell_means(self) -> Floats:
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.asarray(self.sums / self.counts)

    @property
    def seed_means(self) -> Floats:
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.asarray(self.sums.sum(axis=1) / self.counts.sum(axis=1))

    @property
    def starts(self) -> Bools:
        """``(demos,)``, where something counts for any seed."""
        return np.asarray((self.counts > 0).any(axis=0))

    @property
    def even(self) -> Cells:
        """The same with every demonstration weighing one, and within it every seed the same."""
        present = self.counts > 0
        share = present / np.maximum(present.sum(axis=0), 1)
        return Cells(np.where(present, self.cell_means, 0.0) * share, share)

    @property
    def deviations(self) -> Floats:
        """What each cell adds to the mean's deviation, ``(seeds, demos)``, zero on average.

        The mean is a ratio of sums; this is its linear part, exact where counts are equal.
        """
        total = self.counts.sum()
        if total == 0:
            return np.zeros(self.sums.shape)
        left = self.sums - self.sums.sum() / total * self.counts
        return np.asarray(left * (left.size / total))

    def by_unit(self, unit: Ints) -> Cells:
        """Join what is of one recording; ``unit`` ``(demos,)`` is the recording of each."""
        owner = np.zeros((len(unit), int(unit.max(initial=-1)) + 1))
        owner[np.arange(len(unit)), unit] = 1.0
        if not self.sums.size:
            return self
        return Cells(self.sums @ owner, self.counts @ owner, self.lacking)

    def of(self, demos: Bools) -> Cells:
        """Those of some demonstrations, without seeds that have none of them."""
        sums, counts = self.sums[:, demos], self.counts[:, demos]
        seeds = counts.sum(axis=1) > 0
        return Cells(sums[seeds], counts[seeds])


def cells(
    values: ArrayLike, seed: ArrayLike, demo: ArrayLike, num_demos: int, counts: ArrayLike = True
) -> Cells:
    """Gather one value per rollout into cells of seed and demonstration.

    All are ``(rollouts,)``: the metric, the training seed, the demonstration's index below
    ``num_demos``, and whether a rollout counts; NaN values never do.
    """
    values = np.asarray(values, dtype=np.float64)
    seeds, row = np.unique(np.asarray(seed), return_inverse=True)
    chosen = np.isfinite(values) & np.asarray(counts)
    place = (row.ravel()[chosen], np.asarray(demo)[chosen])
    sums, number = np.zeros((2, len(seeds), num_demos))
    np.add.at(sums, place, values[chosen])
    np.add.at(number, place, 1.0)
    return Cells(sums, number)


def single_cells(values: Floats) -> Cells:
    """Cells that hold one value each, ``(seeds, demos)``; NaN does not count."""
    present = np.isfinite(values)
    return Cells(np.where(present, values, 0.0), present.astype(np.float64))


def shared_starts(methods: Sequence[Cells]) -> list[Cells]:
    """The methods on the starts that all of them have, every start weighing the same."""
    chosen = np.logical_and.reduce([data.starts for data in methods])
    return [data.of(chosen).even for data in methods]


def covers(*methods: Cells) -> str:
    """What the interval of a statistic of these methods speaks of (recordings left out)."""
    if min(len(data.sums) for data in methods) > 1:
        return "training runs like these"
    return "this network only" if len(methods) == 1 else "these networks only"


# -- energy score ---------------------------------------------------------------------------------


def energy_score(simulated: ArrayLike, recorded: ArrayLike) -> float:
    """The unbiased estimate for one start, in the values' unit (Gneiting and Raftery 2007, J. Am.
    Stat. Assoc. 102, 359).

    Of rollouts X, X' and the recording y: E|X - y| - E|X - X'| / 2 is smallest on average for the
    distribution that y is drawn from.

    ``simulated`` is ``(rollouts,)`` and ``recorded`` a number, or ``(rollouts, d)`` and ``(d,)``:
    ``d`` numbers are compared by Euclidean distance. A single estimate may be negative; NaN for
    fewer than two rollouts, which do not show a spread.
    """
    drawn = np.asarray(simulated, np.float64)
    number = len(drawn)
    if number < 2:
        return math.nan
    drawn, true = drawn.reshape(number, -1), np.asarray(recorded, np.float64).reshape(-1)
    error = np.linalg.norm(drawn - true, axis=1).mean()
    apart = np.linalg.norm(drawn[:, None] - drawn[None], axis=2).sum()
    return float(error - apart / (2 * number * (number - 1)))


def energy_scores(simulated: ArrayLike, demo: ArrayLike, recorded: ArrayLike) -> Floats:
    """The score at every start, ``(starts,)``; ``demo`` ``(rollouts,)`` is the start of each."""
    drawn, start = np.asarray(simulated, np.float64), np.asarray(demo)
    return np.array(
        [energy_score(drawn[start == i], one) for i, one in enumerate(np.asarray(recorded))]
    )


def energy_cells(
    simulated: ArrayLike, seed: ArrayLike, demo: ArrayLike, recorded: ArrayLike
) -> Cells:
    """The score of every training seed at every start; NaN values do not count."""
    drawn, of, start = np.asarray(simulated, np.float64), np.asarray(seed), np.asarray(demo)
    seeds, known = np.unique(of), np.isfinite(drawn).reshape(len(drawn), -1).all(axis=1)
    rows = [(drawn[chosen], start[chosen]) for chosen in ((of == one) & known for one in seeds)]
    scores = single_cells(np.array([energy_scores(*row, recorded) for row in rows]))
    return replace(scores, lacking=FEW_ROLLOUTS)


def pooled_score(recorded: ArrayLike) -> float:
    """What the recordings of the *other* starts would score, drawn as if they were rollouts.

    A simulator of the right distribution that does not know its start scores this on average; one
    that knows it scores less.
    """
    true = np.asarray(recorded, np.float64)
    scores = [energy_score(np.delete(true, i, 0), one) for i, one in enumerate(true)]
    return float(np.mean(scores)) if len(true) > 2 else math.nan


# -- intervals ------------------------------------------------------------------------------------


@dataclass(eq=False)
class Draws:
    """Resamples of any number of demonstrations, the same ones whenever they are asked for."""

    seed: int
    resamples: int = RESAMPLES
    _known: dict[int, Floats] = field(default_factory=dict, repr=False)

    @classmethod
    def by(cls, rng: np.random.Generator | Draws, resamples: int = RESAMPLES) -> Draws:
        return rng if isinstance(rng, Draws) else cls(int(rng.integers(2**62)), resamples)

    def of(self, count: int) -> Floats:
        """How often each of ``count`` is drawn, ``(resamples, count)``; rows sum to ``count``."""
        if count not in self._known:
            size = (self.resamples, count)
            place = np.random.default_rng([self.seed, count]).integers(count, size=size)
            place += count * np.arange(self.resamples)[:, None]
            counted = np.bincount(place.ravel(), minlength=self.resamples * count)
            self._known[count] = counted.reshape(size).astype(np.float64)
        return self._known[count]


def percentile_interval(estimate: float, resampled: Floats) -> Interval:
    """Percentile interval of resampled estimates, for what has no standard error of its own.

    It is undefined (NaN) when more than one resample in twenty has no value. It is too short for
    means of few or of skewed values: see :func:`bootstrap_mean`.
    """
    defined = resampled[np.isfinite(resampled)]
    if not math.isfinite(estimate):
        return Interval(estimate, reason=NO_VALUE)
    if len(defined) < 0.95 * len(resampled):
        return Interval(estimate, reason="too few resamples have a value")
    return Interval(float(estimate), *np.percentile(defined, TAILS).tolist())


def bootstrap_mean(
    data: Cells,
    rng: np.random.Generator | Draws,
    resamples: int = RESAMPLES,
    *,
    share: bool = False,
) -> Interval:
    """Mean over rollouts with its interval over demonstrations and seeds.

    ``rng`` may be draws that several statistics share. The values of a ``share`` are 0 or 1: its
    interval stays between them, and has a width even if all episodes end alike.
    """
    present = data.of(data.starts)
    if not present.counts.size:
        return Interval(math.nan, reason=data.lacking)
    if present.sums.shape[1] < 2:
        return Interval(present.mean, reason=ONE_DEMO)
    deviations, mean = present.deviations, present.mean
    if share:
        by_demos = share_margins(mean, deviations.mean(axis=0) + mean)
        below, above = np.sqrt(np.square(by_demos) + seed_square([deviations])).tolist()
        return Interval(mean, max(mean - below, 0.0), min(mean + above, 1.0))
    below, above = margins([deviations], Draws.by(rng, resamples)).tolist()
    return Interval(mean, mean - below, mean + above)


def mean_over_seeds(values: Floats) -> Interval:
    """Mean of one value per training seed, ``(seeds,)``, with Student's t interval."""
    mean = float(values.mean())
    if len(values) < 2:
        return Interval(mean, reason=ONE_SEED)
    margin = math.sqrt(seed_square([values[:, None]]))
    return Interval(mean, mean - margin, mean + margin)


def bootstrap_difference(
    first: Cells,
    second: Cells,
    rng: np.random.Generator | Draws,
    resamples: int = RESAMPLES,
    *,
    share: bool = False,
) -> Interval:
    """``mean(first) - mean(second)`` of different networks on the same demonstrations.

    Only starts that both have count, each as much as any other. Recordings are cells with one row.
    The interval of shares is Newcombe's hybrid score interval (1998, Stat. Med. 17, 873, method
    10), which stays between -1 and 1 and always has a width.
    """
    pair = shared_starts([first, second])
    if min(data.counts.sum() for data in pair) == 0:
        empty = [data.lacking for data in (first, second) if not data.counts.any()]
        return Interval(math.nan, reason=[*empty, NOTHING_SHARED][0])
    estimate = pair[0].mean - pair[1].mean
    if pair[0].sums.shape[1] < 2:
        return Interval(estimate, reason=ONE_DEMO)
    if share:
        one, other = (bootstrap_mean(data, rng, share=True) for data in pair)
        below = math.hypot(one.estimate - one.low, other.high - other.estimate)
        above = math.hypot(one.high - one.estimate, other.estimate - other.low)
        return Interval(estimate, max(estimate - below, -1.0), min(estimate + above, 1.0))
    terms = [pair[0].deviations, -pair[1].deviations]
    below, above = margins(terms, Draws.by(rng, resamples)).tolist()
    return Interval(estimate, estimate - below, estimate + above)


# -- margins --------------------------------------------------------------------------------------


def margins(terms: Sequence[Floats], draws: Draws) -> Floats:
    """Lengths of the interval below and above a sum of means, ``(2, ...)``.

    Each of the ``terms`` ``(..., seeds, demos)`` is of networks of its own on the same
    demonstrations: what each cell adds to the deviation of the sum, zero on average.
    """
    of_demos = demo_margins(np.sum([term.mean(axis=-2) for term in terms], axis=0), draws)
    return np.asarray(np.sqrt(np.square(of_demos) + seed_square(terms)))


def demo_margins(values: Floats, draws: Draws) -> tuple[Floats, Floats]:
    """Of the mean of ``values`` ``(..., demos)``, below and above it.

    By the studentised bootstrap (bootstrap-t: Efron and Tibshirani 1993, chapter 12), which follows
    skewed values; by Student's t where there are few. Resamples of values that are nearly all alike
    have hardly an error to divide by, so that a margin has a longest length.
    """
    number, mean = values.shape[-1], values.mean(axis=-1)
    error = values.std(axis=-1, ddof=1) / np.sqrt(number)
    by_t = _t(number - 1) * error
    if number < FEWEST_RESAMPLED:
        return by_t, by_t
    flat = (values - mean[..., None]).reshape(-1, number).T
    weights = draws.of(number)
    moved = weights @ flat / number
    variance = np.maximum(weights @ np.square(flat) / number - np.square(moved), 0.0)
    floor = 1e-12 * np.square(flat).mean(axis=0)  # of rounding, not of spread
    with np.errstate(divide="ignore", invalid="ignore"):
        t = moved / np.sqrt(np.where(variance > floor, variance, 0.0) / (number - 1))
        t = np.where(np.isnan(t), 0.0, t)  # no spread and no deviation
        low, high = np.percentile(t, TAILS, axis=0).reshape(2, *mean.shape)
    defined = np.isfinite(low) & np.isfinite(high)
    sides = [(high, mean - values.min(axis=-1)), (-low, values.max(axis=-1) - mean)]
    both = []
    for quantile, farthest in sides:
        margin = np.where(defined, np.maximum(np.where(defined, quantile, 0.0), 0.0) * error, by_t)
        margin = np.maximum(margin, by_t) if number <= FEWEST_ALONE else margin
        both.append(np.minimum(margin, np.maximum(FARTHEST * farthest, by_t)))
    return both[0], both[1]


def seed_square(terms: Sequence[Floats]) -> Floats:
    """Square of the margin that networks add, ``(...,)``; zero for single seeds, which show none.

    Student's t on what the seeds' means vary beyond their share of the demonstrations; variances of
    several terms are added, with Welch's degrees of freedom.
    """
    between, within, per_freedom = np.zeros((3, *terms[0].shape[:-2]))
    for table in terms:
        seeds, demos = table.shape[-2:]
        if seeds < 2:
            continue
        rows, columns = table.mean(axis=-1, keepdims=True), table.mean(axis=-2, keepdims=True)
        variance = rows[..., 0].var(axis=-1, ddof=1) / seeds
        between = between + variance
        per_freedom = per_freedom + np.square(variance) / (seeds - 1)
        if demos > 1:  # what cells of seed and demonstration add to the variance of their mean
            left = np.square(table - rows - columns + rows.mean(axis=-2, keepdims=True))
            freedom = (seeds - 1) * (demos - 1)
            within = within + left.sum(axis=(-2, -1)) / freedom / (seeds * demos)
    varies = per_freedom > 0
    welch = np.where(varies, np.square(between) / np.where(varies, per_freedom, 1.0), 1.0)
    return np.asarray(_t(welch) ** 2 * np.maximum(between - within, 0.0))


def share_margins(share: float, values: Floats) -> tuple[float, float]:
    """Of a share, the mean of ``values`` ``(demos,)`` about it, after Wilson (1927).

    The number of independent episodes is what the spread between demonstrations says it is; if they
    all are alike, that of the demonstrations.
    """
    number = len(values)
    t = float(_t(number - 1))
    variance, spread = float(values.var(ddof=1)) / number, share * (1.0 - share)
    episodes = spread / variance if variance > 0 and spread > 0 else number
    shrink = 1.0 + t**2 / episodes
    centre = (share + t**2 / (2 * episodes)) / shrink
    half = t / shrink * math.sqrt(spread / episodes + t**2 / (4 * episodes**2))
    return max(share - centre + half, 0.0), max(centre + half - share, 0.0)


def student_t(probability: float, freedom: float | Floats) -> Floats:
    """Return the quantile of Student's t."""
    from scipy.special import stdtrit

    return np.asarray(stdtrit(freedom, probability))


def normal(probability: float) -> float:
    """Return the quantile of the normal distribution."""
    from scipy.special import ndtri

    return float(ndtri(probability))


def _t(freedom: float | Floats) -> Floats:
    return student_t(0.5 + CONFIDENCE / 2, freedom)
