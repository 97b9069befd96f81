"""The rows of a verdict: every metric and every kind of order, judged by one test for all.

Rows have one type, :class:`Row`. A row is not distinguishable from the recordings, differs by
little (``LITTLE``, ``LITTLE_SHARE``), differs, or has too little data to say. What is chance and
what is not is decided by :func:`~animarl_algos.evaluation.exchange_test.exchange_test` over all
measures of all rows together, so that more rows are no more false alarms.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from animarl_algos.evaluation.exchange_test import (
    Exchanges,
    ExchangeTest,
    Tested,
    exchange_test,
    least_p,
)
from animarl_algos.evaluation.metrics import DURATION, GROUP, Metric, judged_metrics, measures
from animarl_algos.evaluation.order_in_time import (
    INTERACTIVE,
    KINEMATIC,
    ORDER,
    PLACE,
    EpisodeMeasures,
    Measure,
)
from animarl_algos.evaluation.prepared import (
    Prepared,
    ending,
    has_ended,
    log_rank_scores,
    mean_survival,
)
from animarl_algos.evaluation.rollouts import Rollouts
from animarl_algos.evaluation.statistics import (
    Floats,
    Ints,
    bootstrap_difference,
    cells,
    covers,
    energy_scores,
    pooled_score,
)
from animarl_envs.demos.episode import UNFINISHED
from animarl_envs.demos.summary import Unit

SAME, BY_LITTLE, DIFFERS, UNKNOWN = JUDGEMENTS = (
    "not distinguishable", "differs, but by little", "differs", "too little data to say",
)  # fmt: skip
LEVEL = 0.03  # of all measures together
ENDINGS_LEVEL = 0.01  # of the endings together
LITTLE = 0.10  # of the recorded mean: a gap that is called little where chance does not explain it
LITTLE_SHARE = 0.05  # the same for a share of episodes or steps, and for what has no unit
OUTCOMES = "outcomes"
CONTROLS = ("strangers", "blind")  # columns of a group alone
KINDS = {
    KINEMATIC: "Motion of individuals",
    ORDER: "Order in time",
    INTERACTIVE: "Reactions to others",
    PLACE: "Place",
}
"""Rows of several measures each; the one that differs most stands for them."""
MOST_PHRASES = 4  # of one row


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


def measure_columns(prepared: Prepared, counted: Rollouts) -> EpisodeMeasures:
    """What is tested together, of recordings and then of rollouts.

    Metrics, the spread of those that have one (both without a kind), and order in time.
    """
    sides = (prepared.recorded, counted)
    true, simulated = (measures(prepared, side) for side in sides)
    names, columns = [], []
    alone = np.concatenate([np.ones(len(sides[0]), dtype=bool), ~counted.copies])
    metrics = judged_metrics(prepared.demos)
    for metric in metrics:
        both = np.concatenate([true[metric.key], simulated[metric.key]])
        if _is_censored(metric, prepared):
            both = -log_rank_scores(both, np.concatenate([has_ended(side) for side in sides]))
        names.append(metric.key)
        columns.append(both)
        if metric.noun:
            names.append(_spread(metric))
            columns.append(np.abs(both - np.median(both[alone])))
    order = prepared.order(sides[0])
    own = {metric.of_order for metric in metrics}  # these have rows of their own
    rest = [i for i, name in enumerate(order.names) if name not in own]
    later = np.concatenate([prepared.order(side).values for side in sides])[:, rest]
    tested = *(Measure(name, "") for name in names), *(order.measures[i] for i in rest)
    return EpisodeMeasures(tested, np.concatenate([np.stack(columns, axis=1), later], axis=1))


@dataclass(frozen=True)
class JointTests:
    """The joint test of all measures, and that of the endings.

    ``counted`` are the rollouts that count, smoothed as the recordings; ``group`` ``(starts,)`` is
    the recording of each start, where several starts are of one.
    """

    columns: EpisodeMeasures
    test: ExchangeTest
    ends: tuple[NDArray[np.int64], NDArray[np.int64]]
    endings: Tested

    @classmethod
    def of(
        cls, prepared: Prepared, counted: Rollouts, group: Ints | None, rng: np.random.Generator
    ) -> JointTests:
        columns, starts = measure_columns(prepared, counted), len(prepared.recorded)
        exchanges = Exchanges.draw(counted.demo, starts, rng, copies=counted.copies)
        start = np.concatenate([np.arange(starts), counted.demo])
        test = exchange_test(
            columns.values, exchanges, level=LEVEL, start=start, group=group, rng=rng
        )  # fmt: skip
        ends = ending(prepared.recorded), ending(counted)
        return cls(columns, test, ends, exchanges.chi_squared(np.concatenate(ends)))

    @property
    def differs(self) -> bool:
        """Whether any measure differs, or the endings do."""
        return bool(self.test.differs.any()) or self.endings.p <= ENDINGS_LEVEL


def verdict_rows(
    prepared: Prepared,
    counted: Rollouts,
    tests: JointTests,
    rng: np.random.Generator,
    blind: Rollouts | None = None,
) -> list[Row]:
    """Return the rows of endings, of motion and of order; ``blind`` are a group's control."""
    columns, test = tests.columns, tests.test
    can_end = _can_end(prepared, counted)
    rows = [_endings_row(tests, np.unique(counted.demo))] if can_end else []
    controls = _strangers(prepared), {} if blind is None else measures(prepared, blind)
    rows += _metric_rows(prepared, counted, tuple(columns.names), test, rng, controls)
    found = [kind for kind in KINDS if kind in columns.kinds]
    return rows + [_kind_row(kind, columns, test, prepared.unit) for kind in found]


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
        measure=OUTCOMES,
        label="Endings together (chi-squared)",
        value=tested.value,
        distance=tested.value,
        null=tested.null,
        p=tested.p,
        judgement=judgement,
        verdict=words,
        reason="a test: no interval",
    )


def _metric_rows(
    prepared: Prepared,
    counted: Rollouts,
    names: tuple[str, ...],
    test: ExchangeTest,
    rng: np.random.Generator,
    controls: tuple[Mapping[str, Floats], Mapping[str, Floats]],
) -> Iterator[Row]:
    starts = np.unique(counted.demo)
    true, simulated = (measures(prepared, side) for side in (prepared.recorded, counted))
    endless, (alone, blind) = not _can_end(prepared, counted), controls
    for metric in judged_metrics(prepared.demos):
        a, b = true[metric.key], simulated[metric.key]
        if (metric.is_ending and not (a.any() or b.any())) or (metric is DURATION and endless):
            continue
        many = cells(b, counted.seed, counted.demo, len(a))
        one = cells(a[starts], np.full(len(starts), -1), starts, len(a))
        gap = bootstrap_difference(many, one, rng, share=metric.share)
        recorded, drawn = one.mean, many.even.mean
        if _is_censored(metric, prepared):
            recorded, drawn = _mean_durations(prepared.recorded, counted, starts)
        place = worst = names.index(metric.key)
        if metric.noun:
            spread = names.index(_spread(metric))
            p = np.nan_to_num(test.adjusted_p, nan=1.0)
            worst = spread if p[spread] < p[place] else place
        judgement, words = _judge_metric(metric, test, recorded, drawn, worst, worst != place)
        spread_too = {}
        if metric.noun:
            scores = energy_scores(b, np.searchsorted(starts, counted.demo), a[starts])
            spread_too = {
                "energy": float(np.mean(scores)),
                "energy_pooled": pooled_score(a[starts]),
            }
        yield Row(
            measure=metric.key,
            label=metric.label,
            unit=metric.unit.replace("arena units", prepared.unit.name),
            recorded=recorded,
            simulated=drawn,
            value=gap.estimate,
            low=gap.low,
            high=gap.high,
            distance=_gap(test, worst),
            null=float(test.null[worst]),
            p=least_p(test.adjusted_p[[place, worst]]),
            judgement=judgement,
            verdict=words,
            covers=covers(many),
            reason=gap.reason,
            strangers=_known_mean(alone[metric.key]) if metric.about == GROUP else math.nan,
            blind=_known_mean(blind[metric.key]) if metric.about == GROUP and blind else math.nan,
            **spread_too,
        )


def _judge_metric(
    metric: Metric, test: ExchangeTest, recorded: float, drawn: float, worst: int, by_spread: bool
) -> tuple[str, str]:
    """Return the judgement and its words, by the column ``worst``: the mean's, or the spread's."""
    if not test.differs[worst]:
        return SAME, SAME
    more = bool(test.statistic[worst] > 0)
    much, little = metric.words
    wrong, size = much if more else little, abs(drawn - recorded)
    if by_spread:
        wrong = f"{metric.noun} {'too varied' if more else 'too much alike'}"
        size = _gap(test, worst)
    allowed = LITTLE_SHARE if metric.share else LITTLE * abs(recorded)
    if size > (allowed if metric.unit else max(allowed, LITTLE_SHARE)):
        return DIFFERS, wrong
    points = f"{100 * size:.2g} percentage points"
    by = points if metric.share else f"{100 * size / abs(recorded):.2g} %"
    return BY_LITTLE, f"{BY_LITTLE}: {wrong} by {by}"


def _kind_row(kind: str, columns: EpisodeMeasures, test: ExchangeTest, own: Unit) -> Row:
    """Return the row of all measures of a kind; the one that differs most speaks for it."""
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
        measure=kind,
        label=f"{KINDS[kind]}: {name}",
        unit=unit,
        recorded=recorded,
        simulated=simulated,
        value=simulated - recorded,
        distance=scale * _gap(test, worst),
        null=scale * float(test.null[worst]),
        p=least_p(test.adjusted_p[members]),
        judgement=judgement,
        verdict=words,
        reason="one of several measures: no interval",
    )


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


def _strangers(prepared: Prepared) -> Mapping[str, Floats]:
    """Return the metrics of groups put together of animals that never met.

    Each goes where it went, in another episode than its neighbours: what animals of the same
    motion and places come to that do not see each other.
    """
    recorded, count = prepared.recorded, len(prepared.recorded)
    if not recorded.is_group or count < 2:
        return defaultdict(lambda: np.array([math.nan]))
    paths = []
    for i in range(count):
        each = [recorded.path((i + k) % count)[:, k] for k in range(recorded.num_individuals)]
        shortest = min(map(len, each))
        paths.append(np.stack([path[:shortest] for path in each], axis=1))
    lengths = np.array([len(path) for path in paths])
    mixed = replace(recorded, positions=np.concatenate(paths), lengths=lengths)
    return measures(prepared, mixed)


def _known_mean(values: Floats) -> float:
    known = values[np.isfinite(values)]
    return float(known.mean()) if len(known) else math.nan


def _can_end(prepared: Prepared, counted: Rollouts) -> bool:
    """Whether episodes end by themselves on either side, not with the film alone."""
    sides = (prepared.recorded, counted)
    return prepared.demos.has_goal or any(has_ended(side).any() for side in sides)


def _is_censored(metric: Metric, prepared: Prepared) -> bool:
    return metric is DURATION and bool((prepared.recorded.outcome == UNFINISHED).any())


def _spread(metric: Metric) -> str:
    return f"spread of {metric.key}"


def _gap(test: ExchangeTest, place: int) -> float:
    return abs(float(test.simulated[place] - test.recorded[place]))
