"""Numbers and sentences of a report: every claim is worked out from the tables, none is canned."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from animarl_algos.evaluation.comparison import interval
from animarl_algos.evaluation.metrics import DTW, DURATION, PATH_LENGTH, RETURN, Metric
from animarl_algos.evaluation.rollouts import RECORDED
from animarl_algos.evaluation.statistics import Interval
from animarl_algos.evaluation.style import method_label

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
    decimals = max(0, digits - 1 - math.floor(math.log10(abs(value))))
    return f"{value:.{min(decimals, 4)}f}".replace("-", MINUS)


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
    mean, low, high = (f"{part:.{decimals}f}".replace("-", MINUS) for part in parts)
    return f"{mean} [{low}, {high}]"


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


def headline(comparison: pd.DataFrame, focus: str) -> list[str]:
    """What the evaluation of ``focus`` found, in plain sentences."""
    return [
        sentence
        for part in (_captures, _likeness, _closeness)
        for sentence in part(comparison, focus)
    ]


def _captures(comparison: pd.DataFrame, focus: str) -> Iterator[str]:
    simulated = comparison_row(comparison, focus, RETURN)
    recorded = comparison_row(comparison, RECORDED, RETURN)
    if simulated is None or recorded is None:
        return
    gap = interval(simulated, "to_recorded")
    yield (
        f"{method_label(focus)} reaches the target in "
        f"{with_interval(interval(simulated, 'mean'), percent=True)} % of "
        f"{int(simulated['rollouts'])} rollouts; the recordings do in "
        f"{with_interval(interval(recorded, 'mean'), percent=True)} % of "
        f"{int(recorded['rollouts'])}. {_verdict(gap, 'more often', 'less often')}"
    )


def _likeness(comparison: pd.DataFrame, focus: str) -> Iterator[str]:
    for metric, more, less in ((PATH_LENGTH, "longer", "shorter"), (DURATION, "longer", "shorter")):
        row = comparison_row(comparison, focus, metric)
        if row is None:
            continue
        gap = interval(row, "to_recorded")
        kde, null = interval(row, "kde"), interval(row, "kde_null")
        sentence = (
            f"{metric.label}, all episodes: {with_interval(gap)} {metric.unit} from the "
            f"recordings on average. {_verdict(gap, more, less)}"
        )
        if math.isfinite(kde.estimate) and math.isfinite(null.high):
            place = "above" if kde.estimate > null.high else "within"
            if kde.estimate < null.low:
                place = "below"
            sentence += (
                f" The distributions differ by {number(kde.estimate, 2)} of 2, {place} the "
                f"{number(null.low, 2)} to {number(null.high, 2)} that recordings against "
                "recordings give at this sample size."
            )
        yield sentence


def _closeness(comparison: pd.DataFrame, focus: str) -> Iterator[str]:
    mine = comparison_row(comparison, focus, DTW)
    if mine is None:
        return
    own = interval(mine, "mean")
    closer, farther, unclear = [], [], []
    for name in comparison["method"].unique():
        row = comparison_row(comparison, name, DTW)
        if row is None or name == focus:
            continue
        other = interval(row, "mean")
        text = f"{method_label(name)} ({with_interval(other)})"
        if own.overlaps(other) or not math.isfinite(own.low):
            unclear.append(text)
        elif own.estimate < other.estimate:
            closer.append(text)
        else:
            farther.append(text)
    sentence = (
        f"Mean DTW distance of {method_label(focus)} to the recordings: {with_interval(own)} "
        f"{DTW.unit}"
    )
    parts = [
        f"{words} {_listed(names)}"
        for words, names in (
            ("closer than", closer),
            ("farther than", farther),
            ("with an interval that overlaps that of", unclear),
        )
        if names
    ]
    yield sentence + (f"; {'; '.join(parts)}." if parts else ".")


def cautions(comparison: pd.DataFrame, synthetic: bool) -> list[str]:
    """What limits the conclusions: few seeds, synthetic demonstrations."""
    learned = comparison[comparison["method"] != RECORDED]
    seeds = int(learned["seeds"].min()) if len(learned) else 0
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
            f"Only {seeds} training seeds: where seeds differ much, the intervals are too short."
        )
    return sentences


def _verdict(gap: Interval, more: str, less: str) -> str:
    if not math.isfinite(gap.low):
        return "No interval can be given for the difference."
    if not gap.excludes_zero:
        return "The interval of the difference includes zero."
    return f"That is {more if gap.estimate > 0 else less} than recorded."


def _listed(names: list[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
