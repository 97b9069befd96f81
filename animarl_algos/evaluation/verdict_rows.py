"""The rows of a verdict: one difference, one interval, one tolerance and one word each.

A row is a difference, simulated minus recorded, with an interval and a tolerance: how much may
differ and still count as alike. All intervals together hold their true values in 95 % of
experiments (:mod:`animarl_algos.evaluation.differences`). The word of a row follows from them, as
in tests of equivalence (Schuirmann 1987, J. Pharmacokinet. Biopharm. 15, 657; Lakens 2017, Soc.
Psychol. Personal. Sci. 8, 355):

- *alike*: the interval lies within the tolerance;
- *differs*: it excludes zero, and the estimate is beyond the tolerance;
- *differs a little*: it excludes zero, and the estimate is within the tolerance;
- *not known*: it holds zero and reaches beyond the tolerance.

Classifiers are rows of the same kind: alike up to an area of ``LITTLE_AUC``.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from animarl_algos.evaluation import statistics
from animarl_algos.evaluation.classifier import AUC, LITTLE_AUC, SEQUENCE, ClassifierResult
from animarl_algos.evaluation.differences import (
    LEVEL,
    MIN_RECORDINGS,
    Differences,
    Sides,
    group_differences,
    simultaneous_differences,
)
from animarl_algos.evaluation.laws import LAW
from animarl_algos.evaluation.metrics import (
    ARENA_UNITS,
    DURATION,
    KINDS,
    OF_MEAN,
    OF_SHARE,
    OF_SPREAD,
    OF_WIDTH,
    TOLERANCES,
    Metric,
    judged_metrics,
    measures,
)
from animarl_algos.evaluation.prepared import (
    Prepared,
    comparison_smoothing,
    has_ended,
    restricted_mean_scores,
)
from animarl_algos.evaluation.rollouts import Rollouts
from animarl_algos.evaluation.statistics import UNDEFINED, Interval
from animarl_envs.array_types import Floats, Ints
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.errors import InputError

ALIKE, LITTLE, DIFFERS, UNKNOWN = JUDGEMENTS = (
    "alike",
    "differs a little",
    "differs",
    "not known",
)
FINDINGS = (
    "recorded",
    "simulated",
    "value",
    "low",
    "high",
    "tolerance",
    "judgement",
    "colour",
    "verdict",
)
"""Columns of a verdict's table that other tables show, beside what a row is of."""
COLOURS = {ALIKE: "green", LITTLE: "amber", DIFFERS: "red", UNKNOWN: "grey"}
POWER = 0.84  # standard errors beyond the margin, for a change to be found in 80 % of experiments
STRANGERS, BLIND = "strangers", "blind"
CONTROLS = (LAW, "random", STRANGERS, BLIND)
"""Columns of means of others in place of the simulator."""


@dataclass(frozen=True, kw_only=True)
class Row:
    """One row of a verdict and of its files.

    ``recorded`` and ``simulated`` are means, ``value`` their difference with its interval from
    ``low`` to ``high`` and the ``tolerance`` that it is compared with. Of a classifier, ``value``
    is the area under its curve, and ``recorded`` that of recordings among themselves.
    ``judgement`` is one of ``JUDGEMENTS``, ``colour`` its colour, ``verdict`` the same in words.
    ``needed`` is the number of recordings with which a word that is not known would be, and
    ``detectable`` the smallest difference that these recordings show in 80 % of experiments.
    ``covers`` says what the interval speaks of, ``reason`` why there is none. ``primary`` rows have
    a level of their own. The others are means of :data:`CONTROLS`: of a simple ``law`` that was
    fitted to recordings, of ``random`` actions, of ``strangers``, recorded animals of different
    episodes, and of a group's ``blind`` rollouts in which none sees its own neighbours.
    """

    measure: str
    label: str
    unit: str = ""
    recorded: float = math.nan
    simulated: float = math.nan
    value: float = math.nan
    low: float = math.nan
    high: float = math.nan
    tolerance: float = math.nan
    judgement: str = UNKNOWN
    colour: str = COLOURS[UNKNOWN]
    verdict: str = UNKNOWN
    needed: float = math.nan
    detectable: float = math.nan
    covers: str = ""
    reason: str = ""
    primary: bool = False
    law: float = math.nan
    random: float = math.nan
    strangers: float = math.nan
    blind: float = math.nan


def judge(value: float, low: float, high: float, tolerance: float, *, zero: float = 0.0) -> str:
    """Return the word for a difference from ``zero`` with its interval and its tolerance."""
    if not (math.isfinite(low) and math.isfinite(high) and tolerance > 0):
        return UNKNOWN
    if zero - tolerance <= low and high <= zero + tolerance:
        return ALIKE
    if low <= zero <= high:
        return UNKNOWN
    return DIFFERS if abs(value - zero) > tolerance else LITTLE


def judge_area(area: Interval) -> str:
    """Return the word for the area of a classifier, which only errs below one half."""
    if not (math.isfinite(area.low) and math.isfinite(area.high)):
        return UNKNOWN
    if area.high <= LITTLE_AUC:
        return ALIKE
    if area.low > LITTLE_AUC:
        return DIFFERS
    return LITTLE if area.low > 0.5 else UNKNOWN


def recordings_needed(units: int, margin: float, allowed: float) -> float:
    """Return with about how many recordings a margin would be as small as ``allowed``."""
    if not (units > 1 and allowed > 0 and math.isfinite(margin)):
        return math.nan
    tail = 1 - LEVEL / 20
    wider = float(statistics.student_t(tail, units - 1) / statistics.normal(tail))  # of few
    return max(units + 1.0, math.ceil(units * (margin / wider / allowed) ** 2))


def rounded_count(number: float) -> int:
    """Return a number of recordings with two digits, rounded up."""
    step = 10 ** max(0, math.floor(math.log10(number)) - 1)
    return int(math.ceil(number / step) * step)


def figures(metric_unit: str, *values: float) -> list[str]:
    """Return values with as many digits as tell them apart, shares in percent."""
    scaled = [100 * value if metric_unit == "share" else value for value in values]
    for digits in (2, 3, 4):
        rounded = [_significant(value, digits) for value in scaled]
        if len(set(rounded)) == len(rounded):
            break
    return rounded


def _significant(value: float, digits: int) -> str:
    if value == 0 or not math.isfinite(value):
        return f"{value:g}"
    decimals = max(0, digits - 1 - math.floor(math.log10(abs(value))))
    text = f"{value:,.{min(decimals, 6)}f}"
    return text if float(text.replace(",", "")) else "0"


def unknown_words(needed: float, reason: str = "") -> str:
    """Return why a row is not known, and with how many recordings it would be."""
    if reason:
        return f"{UNKNOWN}: {reason}"
    if not math.isfinite(needed):
        return UNKNOWN
    return f"{UNKNOWN}: about {rounded_count(needed):,} recordings would tell"


@dataclass(frozen=True)
class Questions:
    """What a user may change of the questions of a verdict.

    Parameters
    ----------
    tolerances
        By the name of a measure, in place of its own of
        :data:`~animarl_algos.evaluation.metrics.TOLERANCES` and in the same terms.
    primary
        Names of measures that were chosen before looking, which have a level of their own.
    """

    tolerances: Mapping[str, float] = field(default_factory=dict)
    primary: tuple[str, ...] = ()

    @classmethod
    def parse(cls, tolerances: Iterable[str] = (), primary: Iterable[str] = ()) -> Questions:
        """Read ``NAME=NUMBER`` of each tolerance, and names.

        Raises InputError if one is no positive number.
        """
        numbers = {}
        for given in tolerances:
            name, _, text = given.partition("=")
            try:
                numbers[name] = float(text)
            except ValueError:
                numbers[name] = math.nan
            if not 0 < numbers[name] < math.inf:
                raise InputError(
                    f"--tolerance {given}: give NAME=NUMBER with a number above 0, such as "
                    "speed=0.2 for a fifth of the recorded mean"
                )
        return cls(numbers, tuple(primary))

    def keys(self, given: Iterable[str], metrics: Iterable[Metric]) -> tuple[str, ...]:
        """Return the keys of the metrics that these names mean."""
        names = row_names(metrics)
        return tuple(sorted({names[resolve(name, names)] for name in given}))

    def allowed(self, metrics: tuple[Metric, ...], differences: Differences) -> Floats:
        """Return the tolerance of each metric, ``(measures,)``."""
        names = row_names(metrics)
        wanted = {names[resolve(name, names)]: one for name, one in self.tolerances.items()}
        return np.array(
            [
                _tolerance(metric, wanted.get(metric.key), mean, sd)
                for metric, mean, sd in zip(metrics, differences.recorded, differences.between)
            ]
        )

    def check(self, recorded: Demonstrations) -> None:
        """Raise InputError if a name is that of no measure of such recordings."""
        if self.tolerances or self.primary:
            metrics = judged_metrics(Prepared(recorded.select(episodes=np.arange(1))))
            self.keys([*self.tolerances, *self.primary], metrics)


AS_BUILT = Questions()


@dataclass(frozen=True, eq=False)
class Comparison:
    """All metrics of both sides, with their differences.

    ``counted`` are the rollouts that count, smoothed as the recordings; ``unit`` ``(starts,)`` is
    the recording of each start. ``values`` are those of both sides, ``(episodes, measures)`` each.
    ``of_conditions``: the others are recordings of another condition.
    """

    prepared: Prepared
    counted: Rollouts
    unit: Ints
    metrics: tuple[Metric, ...]
    differences: Differences
    tolerances: Floats
    primary: tuple[str, ...]
    values: tuple[Floats, Floats]
    of_conditions: bool = False

    @classmethod
    def of(
        cls,
        prepared: Prepared,
        counted: Rollouts,
        rng: np.random.Generator,
        questions: Questions,
    ) -> Comparison:
        """Measure recordings and rollouts, and take their differences start by start."""
        metrics, first, second = _columns(prepared, counted)
        primary = questions.keys(questions.primary, metrics)
        sides = _sides(prepared.demos, metrics, primary, np.asarray(counted.demo)[~counted.copies])
        differences = simultaneous_differences(first, second[~counted.copies], sides, rng)
        allowed, both = questions.allowed(metrics, differences), (first, second)
        return cls(prepared, counted, sides.unit, metrics, differences, allowed, primary, both)

    @classmethod
    def between(
        cls,
        first: Demonstrations,
        second: Demonstrations,
        rng: np.random.Generator,
        questions: Questions,
    ) -> Comparison:
        """Measure recordings of two conditions, both as the first, and take their differences."""
        prepared = Prepared(first, comparison_smoothing(first))
        other = prepared.filtered(Rollouts.from_demonstrations(second))
        metrics, one, two = _columns(prepared, other)
        primary = questions.keys(questions.primary, metrics)
        sides = [
            _sides(demos, metrics, primary, np.arange(len(demos))) for demos in (first, second)
        ]
        differences = group_differences(one, two, (sides[0], sides[1]), rng)
        allowed, unit = questions.allowed(metrics, differences), sides[0].unit
        return cls(prepared, other, unit, metrics, differences, allowed, primary, (one, two), True)

    def rows(self, controls: Mapping[str, Rollouts] | None = None) -> Iterator[Row]:
        """Yield a row for each metric of its own, then one for each kind of the others.

        ``controls`` are rollouts by :data:`CONTROLS`, prepared as the others.
        """
        beside = {name: measures(self.prepared, side) for name, side in (controls or {}).items()}
        rows = [self._row(place, beside) for place in range(len(self.metrics))]
        yield from (row for row, metric in zip(rows, self.metrics) if not metric.kind)
        for kind, label in KINDS.items():
            members = [row for row, metric in zip(rows, self.metrics) if metric.kind == kind]
            known = [row for row in members if math.isfinite(row.low)]
            if members:
                row = max(known, key=farness) if known else members[0]
                yield replace(row, measure=kind, label=f"{label}: {lower_first(row.label)}")

    def _row(self, place: int, controls: Mapping[str, Mapping[str, Floats]]) -> Row:
        metric, differences = self.metrics[place], self.differences
        tolerance = float(self.tolerances[place])
        value, margin = float(differences.value[place]), float(differences.margin[place])
        recorded = float(differences.recorded[place])
        simulated = float(differences.simulated[place])
        low, high = value - margin, value + margin
        if metric.is_share:
            low, high = max(low, -1.0), min(high, 1.0)
        judgement, units = judge(value, low, high, tolerance), int(differences.units[place])
        needed, reason = math.nan, ""
        if not math.isfinite(margin):
            few = units < MIN_RECORDINGS
            recordings = f"{units} recording{'s' * (units != 1)}"
            reason = f"{recordings}, too few for an interval" if few else "it does not vary"
        elif judgement == UNKNOWN:
            needed = recordings_needed(units, margin, max(abs(value), tolerance - abs(value)))
        unit = metric.unit.replace(ARENA_UNITS, self.prepared.unit.name)
        words = judgement
        if judgement in (DIFFERS, LITTLE):
            one, other = figures(unit, simulated, recorded)
            unit_name = "%" if unit == "share" else unit
            complaint = metric.complaint(value > 0)
            if self.of_conditions:
                complaint = f"{lower_first(metric.label)} {'higher' if value > 0 else 'lower'}"
            words = f"{complaint}: {one} for {other} {unit_name}".rstrip()
            words = words if judgement == DIFFERS else f"{LITTLE}: {words}"
        elif judgement == UNKNOWN:
            words = unknown_words(needed, reason)
        error = POWER * float(differences.error[place])
        more: dict[str, float] = {}
        for name, side in controls.items():
            ends = metric.is_ending or metric is DURATION  # which these take from the recordings
            values = side.get(metric.key, np.zeros(0))
            if len(values := values[np.isfinite(values)]) and not (
                ends and name in (LAW, STRANGERS)
            ):
                more[name] = float(values.mean())
        seeds = "training runs like these" if len(np.unique(self.counted.seed)) > 1 else ""
        return Row(
            measure=metric.key,
            label=metric.label,
            unit=unit,
            recorded=recorded,
            simulated=simulated,
            value=value,
            low=low,
            high=high,
            tolerance=tolerance,
            judgement=judgement,
            colour=COLOURS[judgement],
            verdict=words,
            needed=needed,
            detectable=max(margin, tolerance) + error,
            covers="" if self.of_conditions else seeds or "this network only",
            reason=reason,
            primary=metric.key in self.primary,
            **more,
        )


def _columns(prepared: Prepared, other: Rollouts) -> tuple[tuple[Metric, ...], Floats, Floats]:
    """Return metrics and spreads of both sides, each ``(episodes, measures)``."""
    starts = len(prepared.recorded)
    measured = [measures(prepared, side) for side in (prepared.recorded, other)]
    metrics, columns = list[Metric](), list[Floats]()
    ended = np.concatenate([has_ended(side) for side in (prepared.recorded, other)])
    can_end = prepared.demos.has_goal or bool(ended.any())
    for metric in judged_metrics(prepared):
        both = np.concatenate([side[metric.key] for side in measured])
        if (metric.is_ending and not both.any()) or (metric is DURATION and not can_end):
            continue
        if metric is DURATION:
            both = restricted_mean_scores(both, ended)
        metrics.append(metric)
        columns.append(both)
        if metric.noun:
            metrics.append(spread_of(metric))
            columns.append(np.concatenate([_apart(both[:starts]), _apart(both[starts:])]))
    values = np.stack(columns, axis=1)
    return tuple(metrics), values[:starts], values[starts:]


def _sides(
    demos: Demonstrations, metrics: tuple[Metric, ...], primary: tuple[str, ...], demo: Ints
) -> Sides:
    lasted = np.maximum(demos.lengths - 1, 1)[:, None].astype(np.float64)
    return Sides(
        demo=demo,
        unit=np.unique(demos.recording, return_inverse=True)[1].astype(np.int64),
        weight=np.where([metric.by_time for metric in metrics], lasted, 1.0),
        binary=np.array([metric.share and metric.is_ending for metric in metrics]),
        primary=np.array([metric.key in primary for metric in metrics]),
    )


def _apart(values: Floats) -> Floats:
    """Return how far values lie from their median."""
    return np.asarray(np.abs(values - np.nanmedian(values)))


def spread_of(metric: Metric) -> Metric:
    """Return the metric of how far values lie from their median."""
    return replace(
        metric,
        key=f"spread_of_{metric.key}",
        label=f"Spread of {metric.noun}",
        tolerance=OF_WIDTH,
        noun="",
        too_much=f"{metric.noun} too varied",
        too_little=f"{metric.noun} too much alike",
    )


def row_names(metrics: Iterable[Metric]) -> dict[str, str]:
    """Return the keys of metrics by every name that a user may give them."""
    names = {}
    for metric in metrics:
        for name in (metric.key.removeprefix("mean_"), metric.label, metric.key):
            names[_plain_key(name)] = metric.key
    return names


def resolve(name: str, names: Mapping[str, str]) -> str:
    """Return the key of ``names`` that a user means, or raise InputError with those there are."""
    plain = _plain_key(name)
    if plain not in names:
        known = ", ".join(sorted(set(names.values())))
        raise InputError(f"no measure of this verdict is named {name!r}: choose one of {known}")
    return plain


def _plain_key(name: str) -> str:
    return name.strip().casefold().replace(" ", "_").replace("-", "_")


def lower_first(label: str) -> str:
    """Return a label as it stands within a sentence; abbreviations stay."""
    return label if label[1:2].isupper() else label[:1].lower() + label[1:]


def _tolerance(metric: Metric, given: float | None, recorded: float, between: float) -> float:
    part = TOLERANCES[metric.tolerance] if given is None else given
    if metric.tolerance == OF_SHARE:
        return part
    if metric.tolerance in (OF_MEAN, OF_WIDTH) and recorded != 0:
        return part * abs(recorded)
    return (part if metric.tolerance == OF_SPREAD else TOLERANCES[OF_SPREAD]) * between


def farness(row: Row) -> tuple[int, bool, float]:
    """Return how far a row is from alike, for sorting: first by its word, then by its distance.

    Of the same word, rows of one metric are farther than rows that stand for several.
    """
    order = (ALIKE, LITTLE, UNKNOWN, DIFFERS)
    if row.measure in (AUC, SEQUENCE):
        away = (row.value - 0.5) / (LITTLE_AUC - 0.5)
    else:
        away = abs(row.value) / row.tolerance if row.tolerance > 0 else 0.0
    single = row.measure not in (*KINDS, AUC, SEQUENCE)
    return order.index(row.judgement), single, away if math.isfinite(away) else 0.0


def strangers(prepared: Prepared) -> Rollouts | None:
    """Return episodes put together of animals that never met; None of one animal alone.

    Each goes where it went, in another episode than its neighbours: what animals of the same
    motion and places come to that do not see each other.
    """
    recorded, count = prepared.recorded, len(prepared.recorded)
    if recorded.num_individuals < 2 or count < 2:
        return None
    paths = []
    for i in range(count):
        each = [recorded.path((i + k) % count)[:, k] for k in range(recorded.num_individuals)]
        shortest = min(map(len, each))
        paths.append(np.stack([path[:shortest] for path in each], axis=1))
    lengths = np.array([len(path) for path in paths])
    return replace(recorded, positions=np.concatenate(paths), lengths=lengths)


def classifier_row(key: str, label: str, result: ClassifierResult) -> Row:
    """Return the row of a classifier."""
    area, among = result.auc, result.areas.get("among", UNDEFINED)
    judgement, needed, reason = judge_area(area), math.nan, area.reason
    part = lower_first(KINDS.get(result.main_part, result.main_part))
    by = f", most of all by {part}" if part else ""
    if judgement in (DIFFERS, LITTLE) and result.tells_tracking_as_well:
        judgement = UNKNOWN
        reason = f"perfect control in this locomotion is recognised as well{by}"
    words = judgement
    if judgement in (DIFFERS, LITTLE):
        pairs = f"a classifier tells simulated from recorded in {100 * area.estimate:.0f} of 100"
        words = f"{pairs} pairs{by}"
        words = words if judgement == DIFFERS else f"{LITTLE}: {words}"
    elif judgement == UNKNOWN:
        above = max(LITTLE_AUC - area.estimate, area.estimate - 0.5)
        needed = recordings_needed(result.units, (area.high - area.low) / 2, above)
        words = unknown_words(needed, reason)
    return Row(
        **statistics.row_of(area, measure=key, label=label, judgement=judgement, verdict=words),
        colour=COLOURS[judgement],
        recorded=among.estimate,
        simulated=area.estimate,
        tolerance=LITTLE_AUC - 0.5,
        needed=needed,
    )
