"""One measure of a method, and all of them: what a score of the leaderboard holds."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from animarl_algos.evaluation.classifier import AUC, SEQUENCE
from animarl_algos.evaluation.metrics import Metric, judged_metrics
from animarl_algos.evaluation.statistics import Cells

Floats = NDArray[np.float64]

REALISM, ENERGY = "realism", "energy"


def differences() -> list[Metric]:
    """Return the metrics whose difference to the recordings stands on the board."""
    return [metric for metric in judged_metrics() if metric.on_board]


def labels() -> dict[str, str]:
    """Return the measures in their order, what a simulator is judged by first, with their names."""
    return {
        REALISM: "realism",
        AUC: "classifier AUC",
        SEQUENCE: "AUC of order in time",
        ENERGY: "energy score",
        "energy_duration": "energy score of duration",
        "energy_path_length": "energy score of path length",
        "energy_mean_speed": "energy score of speed",
        "outcomes": "endings (chi-squared)",
        **{one.key: one.label[:1].lower() + one.label[1:] for one in differences()},
        "dtw_per_step": "DTW per step",
        "dtw_first_second": "DTW per step, first second",
        "kde_duration": "KDE distance of durations",
        "kde_path_length": "KDE distance of path lengths",
    }


@dataclass(frozen=True)
class Measured:
    """One measure of one method.

    ``value`` has the interval ``low`` to ``high``, over demonstrations and seeds; ``reason`` says
    why there is none. Of outcome, duration, path length and speed it is the difference to the
    recordings. ``null`` is what chance alone stays below in 95 % of cases, and what recordings of
    other starts come to where ``p`` is not given (energy scores, DTW). NaN is what is not defined.
    """

    measure: str
    unit: str = ""
    value: float = math.nan
    low: float = math.nan
    high: float = math.nan
    null: float = math.nan
    p: float = math.nan
    reason: str = ""

    @property
    def inside(self) -> bool:
        """Whether it is no larger than its null (realism: no smaller); one half always is."""
        if self.measure == REALISM:
            return self.value >= self.null
        return abs(self.value) <= (
            max(self.null, 0.5) if self.measure in (AUC, SEQUENCE) else self.null
        )


@dataclass(frozen=True, kw_only=True)
class Score:
    """A method on one set of demonstrations; ``energies`` is ``(seeds, starts)``, NaN for none."""

    data: str = ""
    kind: str = ""
    method: str
    seeds: tuple[int, ...]
    starts: int
    rollouts: int
    covers: str
    words: str
    measures: tuple[Measured, ...]
    energies: Floats

    def of(self, measure: str) -> Measured:
        """One measure."""
        return next(one for one in self.measures if one.measure == measure)

    @property
    def energy_cells(self) -> Cells:
        """The joint energy score by seed and start."""
        present = np.isfinite(self.energies)
        return Cells(np.where(present, self.energies, 0.0), present.astype(np.float64))

    def to_json(self) -> dict[str, Any]:
        plain = asdict(self) | {"energies": self.energies.tolist()}
        return dict(_without_nan(plain))

    @classmethod
    def from_json(cls, plain: Mapping[str, Any]) -> Score:
        rows: list[dict[str, Any]] = [
            {k: math.nan if v is None else v for k, v in one.items()} for one in plain["measures"]
        ]
        measures = tuple(Measured(**row) for row in rows)
        energies = np.array(plain["energies"], dtype=np.float64)
        seeds = tuple(plain["seeds"])
        return cls(**{**plain, "measures": measures, "energies": energies, "seeds": seeds})


def _without_nan(value: Any) -> Any:
    """As JSON has it: None for what is not finite."""
    if isinstance(value, dict):
        return {k: _without_nan(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_without_nan(v) for v in value]
    if isinstance(value, float | np.floating):
        return float(value) if math.isfinite(value) else None
    return value
