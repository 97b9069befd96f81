"""What a change really does, where that is known, to stand beside a predicted shift.

The teams that made the recordings of artificial agents can act in the changed world, from the same
starts. Recordings of the other condition show what it does to animals, from starts of their own.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from functools import cached_property
from math import hypot
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from animarl_algos.evaluation.rollouts import Rollouts
from animarl_algos.evaluation.statistics import Interval
from animarl_algos.evaluation.teams import roll_out_teams, teams_of
from animarl_algos.whatif.changes import ChangedWorld
from animarl_envs.array_types import Floats
from animarl_envs.demos.summary import unit_of
from animarl_envs.errors import InputError
from animarl_envs.species.base import Reading
from animarl_envs.species.options import change_world

RECORDINGS, TEAMS = "recordings", "teams"
TEAM_SEED = 0


class Truth(Protocol):
    """What made the recordings.

    ``description`` is a sentence for pages; ``paired`` says whether episodes of the truth start
    where those of an answer do.
    """

    description: str
    paired: bool

    def check(self, scenario: ChangedWorld) -> None:
        """Raise InputError if the truth of a change is not known."""

    def roll_out(self, scenario: ChangedWorld, reading: Reading) -> tuple[Rollouts, Rollouts]:
        """Return true episodes in the unchanged and in the changed world."""


def find_truth(source: str, run: Any, repetitions: int) -> Truth:
    """Return the truth that ``--truth`` names for a run.

    Raises
    ------
    InputError
        If the teams are not known, or their weights cannot be read.
    """
    if source == RECORDINGS:
        return RecordedConditions(run)
    return TeamTruth(run, None if source == TEAMS else Path(source), repetitions)


class RecordedConditions:
    """The test recordings of both conditions, as two groups."""

    description = (
        "The true shift is the difference between the test recordings of the two conditions, which "
        "began from starts of their own."
    )
    paired = False

    def __init__(self, run: Any) -> None:
        self.demos = run.demos.select(split="test")
        self.conditions = run.scenario.species.conditions

    def check(self, scenario: ChangedWorld) -> None:
        """Raise InputError unless the condition alone is changed to one that was recorded."""
        if scenario.condition is None or len(scenario.changes) > 1:
            raise InputError(
                f"--truth {RECORDINGS}: no recordings show {scenario.name}: ask for condition=NAME "
                "alone, or leave --truth out"
            )
        if not (self.demos.condition == self.conditions.index(scenario.condition)).any():
            raise InputError(
                f"--truth {RECORDINGS}: no test recording has the condition {scenario.condition}: "
                "deal the splits so that test has both conditions"
            )

    def roll_out(self, scenario: ChangedWorld, reading: Reading) -> tuple[Rollouts, Rollouts]:
        """Return the recordings of the other condition and of the one that is asked for."""
        recorded = Rollouts.from_demonstrations(self.demos)
        changed = recorded.condition == self.conditions.index(str(scenario.condition))
        return recorded.select(~changed), recorded.select(changed)


class SimulatedTruth(ABC):
    """What made the recordings acts again, from the same starts, in both worlds."""

    paired = True

    def roll_out(self, scenario: ChangedWorld, reading: Reading) -> tuple[Rollouts, Rollouts]:
        """Return true episodes in the unchanged and in the changed world."""
        return self._unchanged, self.simulate(scenario, reading)

    @cached_property
    def _unchanged(self) -> Rollouts:
        return self.simulate(ChangedWorld(()), "habit")

    @abstractmethod
    def simulate(self, scenario: ChangedWorld, reading: Reading) -> Rollouts:
        """Return true episodes in one world."""


class TeamTruth(SimulatedTruth):
    """The trained teams that made the recordings of a run, one for each condition.

    Parameters
    ----------
    folder
        Of the published agents' weights (:func:`animarl_algos.evaluation.teams.teams_of`); None for
        the packaged teams.
    repetitions
        Rollouts from each start, of a team that acts by chance.
    """

    description = (
        "The true shift is that of the trained teams that made the recordings, in the changed "
        "world and from the same starts; under another condition the team that was trained so."
    )

    def __init__(self, run: Any, folder: Path | None, repetitions: int) -> None:
        teams = None if run.settings.focal else teams_of(run.demos, folder)
        if teams is None:
            raise InputError(
                f"--truth {folder or TEAMS}: it is not known which teams made these recordings, or "
                f"one individual alone learned: give --truth {RECORDINGS}, or leave it out"
            )
        self.teams, self.repetitions = teams, repetitions
        self.test, self.unit = run.demos.select(split="test"), unit_of(run.demos)
        self.species = teams[0].embody(run.scenario.species)

    def check(self, scenario: ChangedWorld) -> None:
        """Raise InputError for a wanted speed or an individual that is removed."""
        if scenario.speeds or scenario.removed:
            raise InputError(
                f"{scenario.name}: the truth of teams is known of thrusts, arenas, starts and "
                "conditions: change these, or leave --truth out"
            )

    def simulate(self, scenario: ChangedWorld, reading: Reading) -> Rollouts:
        """Return what the teams do in one world."""
        options = scenario.options(self.species, self.unit)
        species = change_world(self.species, reading, **options)
        starts, name = scenario.move_starts(self.test, species), scenario.condition
        return roll_out_teams(
            self.teams,
            species,
            starts,
            name="truth",
            seed=TEAM_SEED,
            repetitions=self.repetitions,
            condition=None if name is None else species.conditions.index(name),
        )


def mean_by_start(rollouts: Rollouts, values: Floats, starts: int) -> Floats:
    """Return the mean of the rollouts from each start, ``(starts,)``."""
    total = np.bincount(rollouts.demo, values, starts)
    return np.asarray(total / np.bincount(rollouts.demo, minlength=starts))


def subtract(first: Interval, second: Interval) -> Interval:
    """Return the difference of two independent means (Zou and Donner 2008, Stat. Med. 27, 1693)."""
    below = hypot(first.estimate - first.low, second.high - second.estimate)
    above = hypot(first.high - first.estimate, second.estimate - second.low)
    estimate = first.estimate - second.estimate
    return Interval(estimate, estimate - below, estimate + above)
