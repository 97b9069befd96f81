"""Everything that a report shows, checked to belong together."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

from animarl_algos.evaluation.decisions import Decisions
from animarl_algos.evaluation.rollouts import Rollouts
from animarl_algos.evaluation.tables import Evaluation
from animarl_algos.report.words import Words
from animarl_envs.arena import Arena
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.errors import InputError
from animarl_envs.fitting import LocomotionFit

if TYPE_CHECKING:
    import pandas as pd

CURVE_COLUMNS = ("method", "phase", "seed", "step", "quantity", "value")


@dataclass(frozen=True, eq=False, kw_only=True)
class ReportInputs:
    """Everything that a report shows.

    Parameters
    ----------
    title
        Of the page.
    learner
        The method that the summary, the trajectories and the speeds are about.
    demos
        The evaluated demonstrations.
    rollouts
        By method name, all seeds and cues joined.
    evaluation
        Of these rollouts against these demonstrations.
    conditions
        Names of conditions 0 and 1, if the species has any.
    fit
        The fitted locomotion, if it was fitted.
    decisions
        What the learner values along a demonstration, if it has values.
    learning_curves
        Tidy, columns ``method, phase, seed, step, quantity, value``; the phase ``"offline"``
        counts epochs, every other one environment steps.
    settings
        As resolved; may be nested.
    seeds, versions, command, created
        Training seeds, package versions, the command that repeats the run, and when it was made.
    episodes
        Number of demonstrations per split, where the run knows them.
    contact_radius
        How near a pursuer comes to touch the target, or the searcher to reach the source [arena
        unit]; the player draws it.
    environment
        Options of the world that was trained in and evaluated.
    machine
        What the run was made with and on: commit, processor, accelerator.
    wall_time
        Seconds by stage, where they were measured.
    warnings
        What was doubtful while the run was made; said beside the verdict.

    Raises
    ------
    InputError
        If the evaluation is of other demonstrations, the learner has no rollouts, or the learning
        curves lack a column.
    """

    title: str
    learner: str
    demos: Demonstrations
    rollouts: Mapping[str, Rollouts]
    evaluation: Evaluation
    conditions: tuple[str, ...] = ()
    fit: LocomotionFit | None = None
    decisions: Decisions | None = None
    learning_curves: pd.DataFrame | None = None
    settings: Mapping[str, Any] = field(default_factory=dict)
    seeds: tuple[int, ...] = ()
    versions: Mapping[str, str] = field(default_factory=dict)
    command: str = ""
    created: str = ""
    episodes: Mapping[str, int] = field(default_factory=dict)
    contact_radius: float | None = None
    environment: Mapping[str, Any] = field(default_factory=dict)
    machine: Mapping[str, str] = field(default_factory=dict)
    wall_time: Mapping[str, float] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()

    @property
    def words(self) -> Words:
        """What the demonstrations and the unit of lengths are called."""
        return Words.of(self.demos)

    @property
    def arena(self) -> Arena:
        """The recorded field, with walls if the world had them."""
        arena = self.demos.arena
        return replace(arena, rebound=bool(self.environment.get("rebound", arena.rebound)))

    def __post_init__(self) -> None:
        if self.evaluation.fingerprint != self.demos.fingerprint():
            raise InputError(
                f"the evaluation is of other demonstrations than {self.demos.name}: "
                "evaluate the run again"
            )
        if self.learner not in self.rollouts:
            raise InputError(
                f"there are no rollouts of {self.learner!r}: choose one of "
                f"{', '.join(self.rollouts)}"
            )
        if self.learning_curves is not None:
            missing = [c for c in CURVE_COLUMNS if c not in self.learning_curves.columns]
            if missing:
                raise InputError(
                    f"the learning curves lack the column {missing[0]!r}: "
                    f"give {', '.join(CURVE_COLUMNS)}"
                )
