"""Numbers and words of a report: units, digits, what demonstrations are called.

"Recorded" is said of recordings alone; what was generated is "demonstrated". Lengths are told in
the unit of the recordings, or in arena units where nobody knows it.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import Any

import pandas as pd

from animarl_algos.evaluation.metrics import ARENA_UNITS, DTW, Metric
from animarl_algos.evaluation.rollouts import RECORDED
from animarl_algos.evaluation.statistics import UNDEFINED, Interval, interval
from animarl_algos.report.style import method_label
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.summary import RECORDED_SCALE, Unit, unit_of

MINUS, NOTHING = "\u2212", "\u2013"
FEW_SEEDS = 5
ENDINGS = {"ed": "demonstrated", "ings": "demonstrations", "ing": "demonstration"}
WITHOUT_GOAL = {"pursuers (or the moth's)": "animals", ": all episodes, and captures only": ""}


@dataclass(frozen=True)
class Words:
    """Vocabulary of a report.

    It depends on whether demonstrations are synthetic, the unit of lengths, and whether there is a
    target or a source to reach.
    """

    synthetic: bool = False
    unit: Unit = RECORDED_SCALE
    has_goal: bool = True

    @classmethod
    def of(cls, demos: Demonstrations) -> Words:
        """Return the vocabulary of some demonstrations."""
        return cls(demos.synthetic, unit_of(demos), demos.has_goal)

    def adapt(self, text: str) -> str:
        """Return a text about recordings, adapted to synthetic demonstrations or free animals."""
        for words, instead in () if self.has_goal else WITHOUT_GOAL.items():
            text = text.replace(words, instead)
        if not self.synthetic:
            return text

        def generated(match: re.Match[str]) -> str:
            word = ENDINGS[match[1].lower()]
            return word.capitalize() if match[0][0].isupper() else word

        return re.sub(r"\brecord(ed|ings?)\b", generated, text, flags=re.IGNORECASE)

    def label(self, method: str) -> str:
        """Return a method's name, or what its demonstrations are called."""
        return self.adapt(method) if method.casefold() == RECORDED else method_label(method)

    def unit_of(self, metric: Metric) -> str:
        """Return the unit of a metric's values."""
        return "%" if metric.share else metric.unit.replace(ARENA_UNITS, self.unit.name)

    def axis(self, metric: Metric) -> str:
        """Return the label of a figure's axis."""
        unit = "% of episodes" if metric.share else self.unit_of(metric)
        return f"{metric.label} ({unit})" if unit else metric.label

    def factor(self, metric: Metric) -> float:
        """Return the factor from the tables' values to the unit of the report."""
        return self.unit.per_arena_unit if metric.is_length else 1.0

    def interval(self, row: Any, metric: Metric) -> Interval:
        """Return the value of a row with its interval, in the unit of the report."""
        return scaled(UNDEFINED if row is None else interval(row), self.factor(metric))

    def format_value(self, row: Any, metric: Metric) -> str:
        """Return the value of a row as text, shares in percent; a dash if there is no row."""
        return with_interval(self.interval(row, metric), metric.share)

    @property
    def speed(self) -> str:
        """Unit of speeds."""
        return f"{self.unit.name}/s"


def scaled(value: Interval, factor: float) -> Interval:
    """Return the same in another unit."""
    low, high = sorted((value.low * factor, value.high * factor))
    return Interval(value.estimate * factor, low, high)


def pick(table: pd.DataFrame, **values: Any) -> Any | None:
    """Return the first row of a table that has these values; None if there is none."""
    for key, value in values.items():
        table = table if table.empty else table[table[key] == value]
    return None if table.empty else table.iloc[0]


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
    # Two digits of the interval's width, or three of the value if there is no width.
    width, decimals = parts[2] - parts[1], 0
    size, digits = (width, 2) if width > 0 else (abs(parts[0]), 3)
    if size > 0 and not percent:
        decimals = min(4, max(0, digits - 1 - math.floor(math.log10(size))))
    mean, low, high = (_fixed(part, decimals) for part in parts)
    return f"{mean} [{low}, {high}]"


def _fixed(value: float, decimals: int) -> str:
    """So many decimals, a true minus sign, and no negative zero."""
    text = f"{value:.{decimals}f}"
    return text.lstrip("-") if float(text) == 0 else text.replace("-", MINUS)


def cautions(comparison: pd.DataFrame, learner: str, synthetic: bool) -> list[str]:
    """Return what limits the conclusions: few seeds, synthetic demonstrations."""
    row = pick(comparison, method=learner, measure=DTW.key, counting="all")
    seeds = 0 if row is None else int(row["seeds"])
    sentences = []
    if synthetic:
        sentences.append(
            "The demonstrations are synthetic: they were generated, not recorded from animals."
        )
    if seeds == 1:
        sentences.append(
            "One training seed: the intervals speak of episodes like these, for the networks "
            "trained here, not of what another training would give."
        )
    elif 1 < seeds < FEW_SEEDS:
        sentences.append(
            f"Only {seeds} training seeds: what another training would give is known but roughly, "
            "and the intervals are wide for it."
        )
    return sentences


def capitalised(text: str) -> str:
    """Return the text with a capital at its start, unless it is a change such as ``speed=x2``."""
    return text if "=" in text else text[:1].upper() + text[1:]
