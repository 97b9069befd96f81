"""The rows of a verdict: every metric and every kind of order, judged by one test for all.

Rows have one type, :class:`Row`. A row is not distinguishable from the recordings, differs by
little (``LITTLE``, ``LITTLE_SHARE``), differs, or has too little data to say. What is chance and
what is not is decided by :func:`exchange_test` over all measures of all rows together, so that more
rows are no more false alarms.

If a simulator is perfect, the recording of a start is one more rollout of it. So the null of any
statistic is found by exchanging, start by start, the recording with one of the episodes from there:
an exact permutation test. Who acts by a fixed rule in a world without chance does the same from a
start however often it is let go; such copies are one rollout.

Differences are studentised in every exchange (Chung and Romano 2013, Ann. Stat. 41, 484): where few
rollouts are far off, as those of animals that freeze, the recordings alone have a small error, and
those of an exchange a large one. Of several measures the statistic is the largest such difference
(maxT; Westfall and Young 1993, *Resampling-Based Multiple Testing*, algorithm 2.5, single step). So
a perfect simulator has no measure below .05 in 95 % of experiments, however many measures there are
and however they depend on each other.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from animarl_algos.evaluation import order_in_time, statistics
from animarl_algos.evaluation.metrics import DURATION, GROUP, Metric, judged_metrics, measures
from animarl_algos.evaluation.prepared import (
    Prepared,
    ending,
    has_ended,
    log_rank_scores,
    mean_survival,
)
from animarl_algos.evaluation.rollouts import Rollouts
from animarl_algos.evaluation.statistics import Floats, Ints, covers
from animarl_envs.demos.episode import UNFINISHED
from animarl_envs.errors import InputError

SAME, BY_LITTLE, DIFFERS, UNKNOWN = JUDGEMENTS = (
    "not distinguishable", "differs, but by little", "differs", "too little data to say",
)  # fmt: skip
EXCHANGES = 1000
CHANCE = 0.05
FLOOR = 0.1  # of the mean variance over exchanges: values of few recordings may be alike
LEVEL = 0.03  # of all measures together
ENDINGS_LEVEL = 0.01  # of the endings together
LITTLE = 0.10  # of the recorded mean: a gap that is called little where chance does not explain it
LITTLE_SHARE = 0.05  # the same for a share of episodes or steps, and for what has no unit
OUTCOMES = "outcomes"
CONTROLS = ("strangers", "blind")  # columns of a group alone
KINDS = {
    order_in_time.KINEMATIC: "Motion of individuals",
    order_in_time.ORDER: "Order in time",
    order_in_time.INTERACTIVE: "Reactions to others",
    order_in_time.PLACE: "Place",
}
"""Rows of several measures each; the one that differs most stands for them."""
MOST_PHRASES = 4  # of one row


# -- one test for all measures --------------------------------------------------------------------


class Tested(NamedTuple):
    """A statistic that is zero where nothing differs, beside its null.

    ``null`` is the null's 95 % quantile and ``p`` the share of the null, the value included, that
    is at least as large.
    """

    value: float
    null: float
    p: float


@dataclass(frozen=True, eq=False)
class Exchanges:
    """Which episode of every start is called the recorded one.

    Both sides are ``(1 + exchanges, episodes)`` of zeros and ones; the first row is the truth.
    Episodes are the recordings in their order, then the rollouts in theirs, without those that do
    not count; ``start`` ``(episodes,)`` is where each began.
    """

    recorded: Floats
    simulated: Floats
    start: Ints

    @classmethod
    def draw(
        cls,
        demo: ArrayLike,
        starts: int,
        rng: np.random.Generator,
        exchanges: int = EXCHANGES,
        *,
        copies: ArrayLike = False,
    ) -> Exchanges:
        """Exchanges for rollouts from the starts ``demo`` ``(rollouts,)``.

        ``copies`` ``(rollouts,)`` marks those that repeat an earlier one, see
        :attr:`~animarl_algos.evaluation.rollouts.Rollouts.copies`; by default none does.
        """
        demo = np.asarray(demo)
        if len(demo) == 0 or demo.min() < 0 or demo.max() >= starts:
            raise InputError(f"rollouts must start from recordings 0 to {starts - 1}")
        start = np.concatenate([np.arange(starts), demo])
        recorded, simulated = np.zeros((2, 1 + exchanges, len(start)))
        rows = np.arange(1 + exchanges)
        counts = np.ones(len(start), dtype=bool)
        counts[starts:] = np.logical_not(copies)
        for one in np.unique(demo):
            members = np.flatnonzero((start == one) & counts)  # the recording is the first
            chosen = rng.integers(len(members), size=1 + exchanges)
            chosen[0] = 0
            simulated[:, members] = 1.0
            recorded[rows, members[chosen]] = 1.0
            simulated[rows, members[chosen]] = 0.0
        return cls(recorded, simulated, start)

    def chi_squared(self, category: ArrayLike) -> Tested:
        """Pearson's statistic of categories by recorded and simulated, however small the counts."""
        category = np.asarray(category)
        sides = self.simulated, self.recorded
        sizes = [side.sum(axis=1) for side in sides]
        total = np.zeros(len(self.recorded))
        for one in np.unique(category):
            counts = [side @ (category == one) for side in sides]
            share = sum(counts) / sum(sizes)
            for count, size in zip(counts, sizes):
                with np.errstate(invalid="ignore", divide="ignore"):
                    total += np.where(share > 0, (count - size * share) ** 2 / (size * share), 0.0)
        at_least = int(np.count_nonzero(total[1:] >= total[0] * (1 - 1e-9) - 1e-12))
        null = float(np.quantile(total[1:], 1 - CHANCE))
        return Tested(float(total[0]), null, (1 + at_least) / len(total))


@dataclass(frozen=True)
class ExchangeTest:
    """What the joint test found, all ``(measures,)`` but the ``level`` at which measures differ.

    Means of recordings and of rollouts, where every start counts alike; their studentised
    difference in standard deviations of its null (``statistic``); p corrected for the number of
    measures (NaN where one is undefined); and how far apart means of this
    spread may be by chance over all measures together (``null``).
    """

    recorded: Floats
    simulated: Floats
    statistic: Floats
    adjusted_p: Floats
    null: Floats
    level: float = CHANCE

    @property
    def p(self) -> float:
        """Of the global test: the least adjusted p."""
        return self.least_p(slice(None))

    def least_p(self, places: slice | list[int] | Ints) -> float:
        """Return the least adjusted p of some measures, NaN where none is defined."""
        p = self.adjusted_p[places]
        return float(np.nanmin(p)) if np.isfinite(p).any() else math.nan

    @property
    def differs(self) -> NDArray[np.bool_]:
        """Which measures differ at the level of all measures together."""
        return np.asarray(self.adjusted_p <= self.level)


def exchange_test(
    values: Floats,
    exchanges: Exchanges,
    *,
    level: float = CHANCE,
    group: Ints | None = None,
    rng: np.random.Generator | None = None,
) -> ExchangeTest:
    """Test all measures together.

    Parameters
    ----------
    values
        ``(episodes, measures)``: recordings in their order, then rollouts in theirs. NaN where a
        measure is undefined in an episode, which then does not count.
    exchanges, level
        The null, and the level at which measures are said to differ.
    group, rng
        Where several recordings are of one animal: ``(starts,)`` the animal of each. The null then
        turns the sign of all differences of an animal together (a sign-flip test), as what its
        recordings have in common is no evidence beyond one animal.
    """
    known = np.isfinite(values)
    filled = np.where(known, values, 0.0)
    with np.errstate(invalid="ignore", divide="ignore"):
        means = [
            side @ filled / (side @ known) for side in (exchanges.recorded, exchanges.simulated)
        ]
        gap = means[1] - means[0]
        square = np.zeros(gap.shape)  # of standard errors, after Welch
        for side, mean in zip((exchanges.recorded, exchanges.simulated), means):
            number = side @ known
            square += np.maximum(side @ filled**2 / number - mean**2, 0.0) / number
        scale = np.sqrt(square + FLOOR * np.nan_to_num(square[1:]).mean(axis=0))
        if group is not None and rng is not None:
            gap, scale = _flipped_gaps(values, exchanges, group, rng), np.ones_like(gap)
        # Differences of rounding only are none.
        tiny = 1e-9 * np.maximum(np.nanmax(np.abs(filled), axis=0), 1e-300)
        some = np.isfinite(gap[1:]).any(axis=0)  # episodes may be too short for a measure
        varies = np.nanstd(np.where(some, gap[1:], 0.0), axis=0) > tiny
        studentised = gap / np.where(varies, scale, 1.0)
        spread = np.nanstd(np.where(varies, studentised[1:], 0.0), axis=0)
        scaled = np.where(varies, studentised / np.where(varies, spread, 1.0), np.nan)
    size = np.abs(scaled)
    defined = np.isfinite(size[0])
    adjusted, null = np.full((2, values.shape[1]), np.nan)
    if defined.any():
        largest = np.nanmax(size[1:, defined], axis=1)
        reached = largest[:, None] >= size[0, defined] * (1 - 1e-9)
        adjusted[defined] = (1 + reached.sum(axis=0)) / (1 + len(largest))
        null = np.where(defined, scale[0] * spread * np.quantile(largest, 1 - level), np.nan)
    return ExchangeTest(means[0][0], means[1][0], scaled[0], adjusted, null, level)


def _flipped_gaps(
    values: Floats, exchanges: Exchanges, group: Ints, rng: np.random.Generator
) -> Floats:
    """Return the mean difference, then those with the signs of whole animals turned."""
    starts = len(group)
    known = np.isfinite(values) & (exchanges.simulated[0] > 0)[:, None]
    owner = np.zeros((starts, len(values)))
    owner[exchanges.start, np.arange(len(values))] = 1.0
    rollouts = owner @ np.where(known, values, 0.0) / (owner @ known)
    apart = rollouts - np.where(exchanges.recorded[0, :starts, None] > 0, values[:starts], np.nan)
    there = np.isfinite(apart)
    signs = rng.choice([-1.0, 1.0], size=(len(exchanges.recorded), int(group.max()) + 1))
    signs[0] = 1.0
    return np.asarray(signs[:, group] @ np.where(there, apart, 0.0) / there.sum(axis=0))


# -- rows -----------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class Row:
    """One row of a verdict, of a leaderboard and of their files.

    ``measure``, ``label`` and ``unit`` are of the numbers: means of both sides, the ``value`` that
    the row is about with its 95 % interval from ``low`` to ``high`` (the difference of both sides;
    the statistic of the endings; the area of a judge), what was tested (``distance``), what chance
    stays below over all rows together (``null``; of a judge the upper end for recordings among
    themselves), and the ``p`` that is adjusted for their number. ``judgement`` is one of
    ``JUDGEMENTS``, ``verdict`` the same in words; ``covers`` says what the interval speaks of,
    ``reason`` why there is none. ``energy`` compares distributions; beside it stands what
    recordings of other starts come to.
    Of a group, ``strangers`` is the recorded mean were its animals of different recordings, and
    ``blind`` that of rollouts in which none sees its own neighbours.
    """

    measure: str
    label: str
    unit: str = ""
    recorded: float = math.nan
    simulated: float = math.nan
    value: float = math.nan
    low: float = math.nan
    high: float = math.nan
    distance: float = math.nan
    null: float = math.nan
    p: float = math.nan
    judgement: str = SAME
    verdict: str = SAME
    covers: str = ""
    reason: str = ""
    energy: float = math.nan
    energy_pooled: float = math.nan
    strangers: float = math.nan
    blind: float = math.nan


@dataclass(frozen=True)
class JointTests:
    """The joint test of all measures, and that of the endings.

    ``counted`` are the rollouts that count, smoothed as the recordings, ``metrics`` the judged
    ones of both sides. Tested together are the ``columns``: metrics, the spread of those that have
    one (both without a kind), and order in time, of recordings and then of rollouts.
    """

    prepared: Prepared
    counted: Rollouts
    metrics: tuple[Mapping[str, Floats], Mapping[str, Floats]]
    columns: order_in_time.EpisodeMeasures
    test: ExchangeTest
    ends: tuple[NDArray[np.int64], NDArray[np.int64]]
    endings: Tested

    @classmethod
    def of(
        cls, prepared: Prepared, counted: Rollouts, group: Ints | None, rng: np.random.Generator
    ) -> JointTests:
        """Test; ``group`` ``(starts,)`` is the recording of each start, where some share one."""
        sides, starts = (prepared.recorded, counted), len(prepared.recorded)
        measured = (measures(prepared, sides[0]), measures(prepared, counted))
        ended = np.concatenate([has_ended(side) for side in sides])
        alone = np.concatenate([np.ones(starts, dtype=bool), ~counted.copies])
        columns, own = dict[str, Floats](), set()  # order that has rows of its own
        for metric in judged_metrics(prepared.demos):
            both = np.concatenate([side[metric.key] for side in measured])
            both = -log_rank_scores(both, ended) if _is_censored(metric, prepared) else both
            columns[metric.key] = both
            if metric.noun:
                columns[_spread(metric)] = np.abs(both - np.median(both[alone]))
            own.add(metric.of_order)
        order = prepared.order(sides[0])
        rest = [i for i, name in enumerate(order.names) if name not in own]
        later = np.concatenate([prepared.order(side).values for side in sides])[:, rest]
        tested = (
            *(order_in_time.Measure(name, "") for name in columns),
            *(order.measures[i] for i in rest),
        )
        values = np.concatenate([np.stack([*columns.values()], axis=1), later], axis=1)
        exchanges = Exchanges.draw(counted.demo, starts, rng, copies=counted.copies)
        test = exchange_test(values, exchanges, level=LEVEL, group=group, rng=rng)
        ends = ending(prepared.recorded), ending(counted)
        endings = exchanges.chi_squared(np.concatenate(ends))
        found = order_in_time.EpisodeMeasures(tested, values)
        return cls(prepared, counted, measured, found, test, ends, endings)

    @property
    def differs(self) -> bool:
        """Whether any measure differs, or the endings do."""
        return bool(self.test.differs.any()) or self.endings.p <= ENDINGS_LEVEL

    @property
    def can_end(self) -> bool:
        """Whether episodes end by themselves on either side, not with the film alone."""
        sides = (self.prepared.recorded, self.counted)
        return self.prepared.demos.has_goal or any(has_ended(side).any() for side in sides)

    def gap(self, place: int) -> float:
        """Return how far apart both sides are in a column."""
        return abs(float(self.test.simulated[place] - self.test.recorded[place]))


def verdict_rows(
    tests: JointTests, rng: np.random.Generator, blind: Rollouts | None = None
) -> list[Row]:
    """Return the rows of endings, of motion and of order; ``blind`` are a group's control."""
    kinds = [kind for kind in KINDS if kind in tests.columns.kinds]
    return [
        *([_endings_row(tests, np.unique(tests.counted.demo))] if tests.can_end else []),
        *_metric_rows(tests, rng, blind),
        *(_kind_row(kind, tests) for kind in kinds),
    ]


def _endings_row(tests: JointTests, starts: Ints) -> Row:
    ends, tested = tests.ends, tests.endings
    judgement = words = SAME
    if tested.p <= ENDINGS_LEVEL:
        known = np.unique(np.concatenate(ends))
        shares = [(side[:, None] == known).mean(axis=0) for side in (ends[0][starts], ends[1])]
        moved = 0.5 * float(np.abs(shares[0] - shares[1]).sum())
        judgement, words = DIFFERS, "endings differ"
        if moved <= LITTLE_SHARE:
            judgement = BY_LITTLE
            words = f"{BY_LITTLE}: endings differ in {100 * moved:.2g} % of episodes"
    return Row(
        measure=OUTCOMES, label="Endings together (chi-squared)", judgement=judgement,
        verdict=words, distance=tested.value, reason="a test: no interval", **tested._asdict(),
    )  # fmt: skip


def _metric_rows(
    tests: JointTests, rng: np.random.Generator, blind: Rollouts | None
) -> Iterator[Row]:
    prepared, counted, test, names = tests.prepared, tests.counted, tests.test, tests.columns.names
    starts = np.unique(counted.demo)
    controls = {"strangers": _strangers(prepared)}
    controls["blind"] = {} if blind is None else measures(prepared, blind)
    for metric in judged_metrics(prepared.demos):
        a, b = (side[metric.key] for side in tests.metrics)
        nobody = metric.is_ending and not (a.any() or b.any())
        if nobody or (metric is DURATION and not tests.can_end):
            continue
        many = statistics.cells(b, counted.seed, counted.demo, len(a))
        one = statistics.cells(a[starts], np.full(len(starts), -1), starts, len(a))
        gap = statistics.bootstrap_difference(many, one, rng, share=metric.share)
        recorded, drawn = one.mean, many.even.mean
        if _is_censored(metric, prepared):
            recorded, drawn = _mean_durations(prepared.recorded, counted, starts)
        place = worst = names.index(metric.key)
        if metric.noun:
            spread = names.index(_spread(metric))
            p = np.nan_to_num(test.adjusted_p, nan=1.0)
            worst = spread if p[spread] < p[place] else place
        more = bool(test.statistic[worst] > 0)
        wrong, size = metric.words[0 if more else 1], abs(drawn - recorded)
        if worst != place:
            wrong = f"{metric.noun} {'too varied' if more else 'too much alike'}"
            size = tests.gap(worst)
        allowed = LITTLE_SHARE if metric.share else LITTLE * abs(recorded)
        judgement = words = SAME
        if test.differs[worst] and size > (allowed if metric.unit else max(allowed, LITTLE_SHARE)):
            judgement, words = DIFFERS, wrong
        elif test.differs[worst]:
            points = f"{100 * size:.2g} percentage points"
            by = points if metric.share else f"{100 * size / abs(recorded):.2g} %"
            judgement, words = BY_LITTLE, f"{BY_LITTLE}: {wrong} by {by}"
        more_columns: dict[str, Any] = {}
        if metric.noun:
            scores = statistics.energy_scores(b, np.searchsorted(starts, counted.demo), a[starts])
            more_columns |= {"energy": float(np.mean(scores))}
            more_columns |= {"energy_pooled": statistics.pooled_score(a[starts])}
        if metric.about == GROUP:
            known = {name: side[metric.key] for name, side in controls.items() if side}
            known = {name: values[np.isfinite(values)] for name, values in known.items()}
            more_columns |= {name: float(v.mean()) for name, v in known.items() if len(v)}
        yield Row(
            **statistics.row_of(gap, measure=metric.key, label=metric.label, judgement=judgement),
            unit=metric.unit.replace("arena units", prepared.unit.name), verdict=words,
            recorded=recorded, simulated=drawn, distance=tests.gap(worst),
            null=float(test.null[worst]), p=test.least_p([place, worst]), covers=covers(many),
            **more_columns,
        )  # fmt: skip


def _kind_row(kind: str, tests: JointTests) -> Row:
    """Return the row of all measures of a kind; the one that differs most speaks for it."""
    columns, test, own = tests.columns, tests.test, tests.prepared.unit
    members = np.flatnonzero(np.array(columns.kinds) == kind)
    size = np.abs(test.statistic[members])
    if not np.isfinite(size).any():
        return Row(measure=kind, label=KINDS[kind])
    worst = int(members[np.nanargmax(size)])
    known, name = columns.measures, columns.names[worst]
    scale = own.per_arena_unit if known[worst].unit.startswith("arena units") else 1.0
    unit = known[worst].unit.replace("arena units", own.name)
    recorded, simulated = scale * float(test.recorded[worst]), scale * float(test.simulated[worst])
    judgement = words = SAME
    differing = members[test.differs[members]]
    if len(differing):
        order = differing[np.argsort(-np.abs(test.statistic[differing]))]
        told = [known[i].words(bool(test.simulated[i] > test.recorded[i])) for i in order]
        words, *more = dict.fromkeys(told)
        figures = f"{name}: {simulated:.2g}, recorded {recorded:.2g} {unit}"
        words = f"{words} ({figures.rstrip()})"
        words = ", ".join([words, *more[: MOST_PHRASES - 1]])
        least = [0.0 if known[i].unit else LITTLE_SHARE for i in differing]
        allowed = np.maximum(LITTLE * np.abs(test.recorded[differing]), least)
        gaps = np.abs(test.simulated[differing] - test.recorded[differing])
        judgement = DIFFERS if (gaps > allowed).any() else BY_LITTLE
        words = words if judgement == DIFFERS else f"{BY_LITTLE}: {words}"
    return Row(
        measure=kind, label=f"{KINDS[kind]}: {name}", unit=unit, recorded=recorded,
        simulated=simulated, value=simulated - recorded, distance=scale * tests.gap(worst),
        null=scale * float(test.null[worst]), p=test.least_p(members), judgement=judgement,
        verdict=words, reason="one of several measures: no interval",
    )  # fmt: skip


def _mean_durations(recorded: Rollouts, counted: Rollouts, starts: Ints) -> tuple[float, float]:
    """Return the mean survival of both sides, up to the longest time that both know."""
    sides = (recorded.select(starts), counted)
    lasted = [(side.lengths - 1) * side.dt for side in sides]
    ended = [has_ended(side) for side in sides]
    whole = [bool(e[d == d.max()].all()) for d, e in zip(lasted, ended)]  # the curve ends at zero
    known = [d.max() for d, all_ended in zip(lasted, whole) if not all_ended]
    limit = float(min(known) if known else max(d.max() for d in lasted))
    first, second = (mean_survival(d, e, limit) for d, e in zip(lasted, ended))
    return first, second


def _strangers(prepared: Prepared) -> dict[str, Floats]:
    """Return the metrics of groups put together of animals that never met.

    Each goes where it went, in another episode than its neighbours: what animals of the same
    motion and places come to that do not see each other.
    """
    recorded, count = prepared.recorded, len(prepared.recorded)
    if not recorded.is_group or count < 2:
        return {}
    paths = []
    for i in range(count):
        each = [recorded.path((i + k) % count)[:, k] for k in range(recorded.num_individuals)]
        shortest = min(map(len, each))
        paths.append(np.stack([path[:shortest] for path in each], axis=1))
    lengths = np.array([len(path) for path in paths])
    mixed = replace(recorded, positions=np.concatenate(paths), lengths=lengths)
    return measures(prepared, mixed)


def _is_censored(metric: Metric, prepared: Prepared) -> bool:
    return metric is DURATION and bool((prepared.recorded.outcome == UNFINISHED).any())


def _spread(metric: Metric) -> str:
    return f"spread of {metric.key}"
