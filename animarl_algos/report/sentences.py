"""Numbers and sentences of a report: every claim is worked out from the tables, none is canned."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from animarl_algos.evaluation.comparison import interval
from animarl_algos.evaluation.metrics import DTW, Metric
from animarl_algos.evaluation.statistics import UNDEFINED, Interval

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
