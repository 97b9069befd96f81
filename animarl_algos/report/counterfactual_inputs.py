"""Everything that the page of a counterfactual shows."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from animarl_algos.evaluation.comparison import interval
from animarl_algos.evaluation.effects import Asked, Effects
from animarl_algos.evaluation.rollouts import Rollouts
from animarl_algos.evaluation.statistics import UNDEFINED, Interval
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.species import Species

if TYPE_CHECKING:
    import pandas as pd

ARROW = " \u2192 "


@dataclass(frozen=True, eq=False, kw_only=True)
class CounterfactualInputs:
    """Everything that the page shows.

    ``demos`` are the evaluated ones; ``teams`` what the teams of condition 0 and of condition 1 do;
    ``seeds`` the training seeds by method; ``world`` is printed as it is; ``machine`` and
    ``wall_time`` are those of the trainings.
    """

    demos: Demonstrations
    species: Species
    asked: Mapping[str, Asked]
    teams: tuple[Rollouts, Rollouts] | None
    effects: Effects
    seeds: Mapping[str, tuple[int, ...]]
    world: Mapping[str, str]
    environment: Mapping[str, Any]
    machine: Mapping[str, str]
    wall_time: Mapping[str, float]
    settings: Mapping[str, Any]
    versions: Mapping[str, str]
    command: str

    @property
    def unit(self) -> str:
        return f"{self.species.length_unit}s"

    @property
    def recorded(self) -> str:
        """What the demonstrations are called: recorded only if they were."""
        return "demonstrated" if self.demos.synthetic else "recorded"

    @property
    def conditions(self) -> tuple[str, str]:
        first, second = self.species.conditions
        return first, second

    @property
    def planned(self) -> tuple[int, int]:
        """The flip that was planned in advance; the first, where none was."""
        return self.species.planned_flip or (0, 1)

    def flip(self, of: int, told: int) -> str:
        return f"{self.conditions[of]}{ARROW}{self.conditions[told]}"

    def row(self, method: str, quantity: str, of: int, counting: str = "all") -> pd.Series | None:
        """The row of a quantity from starts of condition ``of``; None if there is none."""
        table = self.effects.table
        chosen = table[
            (table["method"] == method)
            & (table["quantity"] == quantity)
            & (table["condition"] == of)
            & (table["counting"] == counting)
        ]
        return None if chosen.empty else chosen.iloc[0]

    def value(self, method: str, quantity: str, of: int, counting: str = "all") -> Interval:
        """Its value with interval; undefined if there is none."""
        row = self.row(method, quantity, of, counting)
        return UNDEFINED if row is None else interval(row, "value")
