"""Everything that a page shows: what all pages know of their runs, and what each shows besides."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

from animarl_algos.evaluation.comparison import Evaluation
from animarl_algos.evaluation.rollouts import Rollouts
from animarl_algos.report.path_figures import Stage, contact_drawn
from animarl_algos.report.words import ARROW, Words
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.errors import InputError
from animarl_envs.species import Species


@dataclass(frozen=True, eq=False, kw_only=True)
class PageInputs:
    """What every page knows of the runs that it shows.

    ``demos`` are the evaluated demonstrations, ``species`` whose contact radius, goal and
    conditions these are (None where only the recordings are known). ``command`` repeats the page;
    ``world`` are the species' numbers in words, ``environment`` the options of the world that was
    trained in, ``settings`` as resolved, ``machine`` what the trainings were made with and on, and
    ``wall_time`` seconds by stage.
    """

    demos: Demonstrations
    species: Species | None = None
    command: str = ""
    world: Mapping[str, str] = field(default_factory=dict)
    environment: Mapping[str, Any] = field(default_factory=dict)
    settings: Mapping[str, Any] = field(default_factory=dict)
    versions: Mapping[str, str] = field(default_factory=dict)
    machine: Mapping[str, str] = field(default_factory=dict)
    wall_time: Mapping[str, float] = field(default_factory=dict)

    @cached_property
    def words(self) -> Words:
        """What the demonstrations and the unit of lengths are called."""
        return Words.of(self.demos)

    @property
    def recorded(self) -> str:
        """What the demonstrations are called: recorded only if they were."""
        return self.words.say("recorded")

    @cached_property
    def stage(self) -> Stage:
        """Where they move: the recorded field, with walls if the world had them."""
        demos = self.demos
        walls = bool(self.environment.get("rebound", demos.arena.rebound))
        return Stage(
            replace(demos.arena, rebound=walls),
            demos.roles,
            demos.individuals,
            self.words,
            None if self.species is None else contact_drawn(self.species),
        )

    def condition(self, number: int) -> str:
        """Return the name of a condition."""
        names = () if self.species is None else self.species.conditions
        return names[number] if len(names) > number else f"condition {number}"

    def flip(self, of: int, told: int) -> str:
        """Return the names of a condition and of the one that was told instead."""
        return f"{self.condition(of)}{ARROW}{self.condition(told)}"


@dataclass(frozen=True, eq=False, kw_only=True)
class ReportInputs(PageInputs):
    """Everything that the report of a run, or of several runs, shows.

    Raises InputError if the evaluation is of other demonstrations, or the learner has no rollouts.

    Parameters
    ----------
    learner
        The method that the summary, the trajectories and the speeds are about.
    rollouts, evaluation
        By method name, all seeds and cues joined; their evaluation against these demonstrations.
    episodes
        Number of demonstrations per split, where the run knows them.
    folds
        Of a cross-validation, in which all recordings were tested; 0 for none.
    warnings
        What was doubtful while the run was made; said beside the verdict.
    """

    title: str
    learner: str
    rollouts: Mapping[str, Rollouts]
    evaluation: Evaluation
    seeds: tuple[int, ...] = ()
    created: str = ""
    episodes: Mapping[str, int] = field(default_factory=dict)
    folds: int = 0
    warnings: tuple[str, ...] = ()

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
