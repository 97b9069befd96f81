"""Which words and which units a report uses: those of its demonstrations.

"Recorded" is said of recordings alone; what was generated is "demonstrated". Lengths are told in
the unit of the recordings, or in arena units where nobody knows it.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any

from animarl_algos.evaluation.comparison import interval
from animarl_algos.evaluation.metrics import ARENA_UNITS, Metric
from animarl_algos.evaluation.statistics import Interval
from animarl_algos.report.style import is_recorded, method_label
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.units import RECORDED_SCALE, Unit, unit_of

GENERATED = {
    "recorded": "demonstrated",
    "recordings": "demonstrations",
    "recording": "demonstration",
}


@dataclass(frozen=True)
class Words:
    """How one report speaks.

    Parameters
    ----------
    synthetic
        Whether the demonstrations were generated.
    unit
        Of lengths.
    """

    synthetic: bool = False
    unit: Unit = RECORDED_SCALE

    @classmethod
    def of(cls, demos: Demonstrations) -> Words:
        return cls(demos.synthetic, unit_of(demos))

    def say(self, text: str) -> str:
        """A text that speaks of recordings, as it is true of these demonstrations."""
        if not self.synthetic:
            return text

        def generated(found: re.Match[str]) -> str:
            word = GENERATED[found[0].lower()]
            return word.capitalize() if found[0][0].isupper() else word

        return re.sub(r"\brecord(?:ed|ings?)\b", generated, text, flags=re.IGNORECASE)

    def label(self, method: str) -> str:
        """A method's name, or what its demonstrations are called."""
        return self.say(method) if is_recorded(method) else method_label(method)

    def unit_of(self, metric: Metric) -> str:
        """The unit that a metric's values are told in."""
        if metric.share:
            return "%"
        return metric.unit.replace(ARENA_UNITS, self.unit.name)

    def axis(self, metric: Metric) -> str:
        """Of a figure."""
        unit = "% of episodes" if metric.share else self.unit_of(metric)
        return f"{metric.label} ({unit})" if unit else metric.label

    def factor(self, metric: Metric) -> float:
        """By which the tables' values are multiplied, where they are not shares."""
        return self.unit.per_arena_unit if metric.is_length else 1.0

    def interval(self, row: Any, key: str, metric: Metric) -> Interval:
        """An estimate of a table with its interval, in the unit told (shares as shares)."""
        return scaled(interval(row, key), self.factor(metric))

    @property
    def speed(self) -> str:
        return f"{self.unit.name}/s"


def scaled(value: Interval, factor: float) -> Interval:
    """The same in another unit."""
    return Interval(value.estimate * factor, value.low * factor, value.high * factor)
