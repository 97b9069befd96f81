"""Numbers and sentences of a report: every claim is worked out from the tables, none is canned."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from animarl_algos.evaluation.comparison import interval
from animarl_algos.evaluation.metrics import DTW, METRICS, RETURN, Metric
from animarl_algos.evaluation.rollouts import RECORDED
from animarl_algos.evaluation.statistics import UNDEFINED, Interval
from animarl_algos.report.style import method_label
from animarl_algos.report.words import Words, scaled

if TYPE_CHECKING:
    import pandas as pd

MINUS = "\u2212"
NOTHING = "\u2013"
FEW_SEEDS = 5


def number(value: float, digits: int = 3) -> str:
    """``digits`` significant digits, never more than whole numbers need; a dash for NaN."""
    if not math.isfinite(value):
        return NOTHING
    if value == 0:
        return "0"
    if abs(value) < 1e-4:
        return f"{value:.0e}".replace("-", MINUS)
    decimals = max(0, digits - 1 - math.floor(math.log10(abs(value))))
    return _fixed(value, min(decimals, 4 if digits > 2 else 5))


def with_interval(value: Interval, percent: bool = False) -> str:
    """``1.23 [1.01, 1.46]``, all with the decimals that suit the interval's width."""
    if not math.isfinite(value.estimate):
        return NOTHING
    scale = 100.0 if percent else 1.0
    parts = [scale * part for part in (value.estimate, value.low, value.high)]
    if not math.isfinite(parts[1]):
        return number(parts[0])
    width = parts[2] - parts[1]
    decimals = 0 if percent else _decimals(width, parts[0])
    mean, low, high = (_fixed(part, decimals) for part in parts)
    return f"{mean} [{low}, {high}]"


def _fixed(value: float, decimals: int) -> str:
    """So many decimals, a true minus sign, and no negative zero."""
    text = f"{value:.{decimals}f}"
    return text.lstrip("-") if float(text) == 0 else text.replace("-", MINUS)


def _decimals(width: float, value: float) -> int:
    """Two digits of the interval's width, or three of the value if there is no width."""
    scale, digits = (width, 2) if width > 0 else (abs(value), 3)
    if scale <= 0:
        return 0
    return min(4, max(0, digits - 1 - math.floor(math.log10(scale))))


def comparison_row(
    comparison: pd.DataFrame, method: str, metric: Metric, counting: str = "all"
) -> Any | None:
    """The row of a comparison table, ``None`` if there is none."""
    chosen = comparison[
        (comparison["method"] == method)
        & (comparison["metric"] == metric.key)
        & (comparison["counting"] == counting)
    ]
    return None if chosen.empty else chosen.iloc[0]


def headline(
    comparison: pd.DataFrame, pairs: pd.DataFrame, learner: str, words: Words
) -> list[str]:
    """What the evaluation of ``learner`` found, in plain sentences."""
    sentences = [
        *_captures(comparison, learner),
        *_likeness(comparison, learner, words),
        *_closeness(comparison, pairs, learner, words),
    ]
    return [words.say(sentence) for sentence in sentences]


def pair_difference(
    pairs: pd.DataFrame, first: str, second: str, metric: Metric, counting: str = "all"
) -> Interval:
    """Mean of ``first`` minus that of ``second``; undefined if the table lacks the pair."""
    if pairs.empty:
        return UNDEFINED
    chosen = pairs[
        (pairs["first"] == first)
        & (pairs["second"] == second)
        & (pairs["metric"] == metric.key)
        & (pairs["counting"] == counting)
    ]
    return UNDEFINED if chosen.empty else interval(chosen.iloc[0], "difference")


def _captures(comparison: pd.DataFrame, learner: str) -> Iterator[str]:
    simulated = comparison_row(comparison, learner, RETURN)
    recorded = comparison_row(comparison, RECORDED, RETURN)
    if simulated is None or recorded is None:
        return
    gap = interval(simulated, "to_recorded")
    size = f"difference {with_interval(gap, percent=True)} percentage points"
    yield (
        f"{method_label(learner)} reaches the target in {_share(simulated)} of "
        f"{int(simulated['rollouts'])} rollouts, the recordings in {_share(recorded)} of "
        f"{int(recorded['rollouts'])}: "
        + (
            f"not told apart at this sample size ({size})."
            if not gap.excludes_zero
            else f"{'more' if gap.estimate > 0 else 'less'} often than recorded ({size})."
        )
    )


def _share(row: Any) -> str:
    value = interval(row, "mean")
    low, high = _fixed(100 * value.low, 0), _fixed(100 * value.high, 0)
    return f"{_fixed(100 * value.estimate, 0)} % [{low}, {high}]"


def _likeness(comparison: pd.DataFrame, learner: str, words: Words) -> Iterator[str]:
    for metric in METRICS:
        row = comparison_row(comparison, learner, metric)
        if metric.more_less is None or row is None or not math.isfinite(row["to_recorded"]):
            continue
        more, less = metric.more_less
        gap, unit = words.interval(row, "to_recorded", metric), words.unit_of(metric)
        if gap.excludes_zero:
            size = gap if gap.estimate > 0 else Interval(-gap.estimate, -gap.high, -gap.low)
            found = (
                f"{with_interval(size)} {unit} {more if gap.estimate > 0 else less} than recorded"
            )
        else:
            found = (
                "on average not told apart from the recordings at this sample size (difference "
                f"{with_interval(gap)} {unit})"
            )
        sentence = f"{metric.label}, all episodes: {found}"
        kde, null = interval(row, "kde"), interval(row, "kde_null")
        if math.isfinite(kde.estimate) and math.isfinite(null.high):
            place = "within" if kde.estimate <= null.high else "above"
            place = "below" if kde.estimate < null.low else place
            sentence += (
                f"; kernel-density distance {with_interval(kde)} on a scale from 0 to 2, "
                f"{place} the {number(null.low, 2)} to {number(null.high, 2)} that a perfect "
                "simulator gives at this sample size"
            )
        yield f"{sentence}."


def _closeness(
    comparison: pd.DataFrame, pairs: pd.DataFrame, learner: str, words: Words
) -> Iterator[str]:
    mine = comparison_row(comparison, learner, DTW)
    if mine is None:
        return
    closer, farther, unclear = [], [], []
    for name in comparison["method"].unique():
        row = comparison_row(comparison, name, DTW)
        if row is None or name == learner:
            continue
        more = scaled(pair_difference(pairs, str(name), learner, DTW), words.factor(DTW))
        mean = number(words.interval(row, "mean", DTW).estimate)
        text = f"{method_label(name)} ({mean}, difference {with_interval(more)})"
        if not more.excludes_zero:
            unclear.append(text)
        elif more.estimate > 0:
            closer.append(text)
        else:
            farther.append(text)
    sentence = (
        f"Mean DTW distance of {method_label(learner)} to the recordings: "
        f"{with_interval(words.interval(mine, 'mean', DTW))} {words.unit_of(DTW)}"
    )
    parts = [
        f"{place} {listed(names)}"
        for place, names in (
            ("closer than", closer),
            ("farther than", farther),
            ("not told apart from", unclear),
        )
        if names
    ]
    paired = "; from the same starts, it is " if parts else ""
    yield f"{sentence}{paired}{', '.join(parts)}."


def cautions(comparison: pd.DataFrame, learner: str, synthetic: bool) -> list[str]:
    """What limits the conclusions: few seeds, synthetic demonstrations."""
    row = comparison_row(comparison, learner, DTW)
    seeds = 0 if row is None else int(row["seeds"])
    sentences = []
    if synthetic:
        sentences.append(
            "The demonstrations are synthetic: they were generated, not recorded from animals."
        )
    if seeds == 1:
        sentences.append(
            "One training seed: the intervals speak of demonstrations, for the networks trained "
            "here, not of what another training would give."
        )
    elif 1 < seeds < FEW_SEEDS:
        sentences.append(
            f"Only {seeds} training seeds: what another training would give is known but roughly, "
            "and the intervals are wide for it."
        )
    return sentences


def listed(names: list[str]) -> str:
    """Names in a sentence: ``a``, ``a and b``, ``a, b and c``."""
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
