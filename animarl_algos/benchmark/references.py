"""Rows that the learners are read beside: none of them is trained.

``recordings``
    Other recordings of the same condition, each given to one test start: how alike recordings are.
``tracking``
    The test recordings themselves as the fitted locomotion follows them in closed loop, knowing
    where to go: what the locomotion model allows.
``experts``
    The artificial agents that made the demonstrations, in their own locomotion, where these are
    known: the most that any method can hope for.
``nearest``
    What was done in the nearest recorded second (:mod:`.nearest`).
``scripted``
    Pursuers straight at the target, which evades; a moth that surges, zigzags and loops.
``constant-velocity``, ``still``, ``random``
    The action that changes the velocity least, that stops soonest, any.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from animarl_algos.benchmark.nearest import NearestSegment
from animarl_algos.evaluation.classifier import followed
from animarl_algos.evaluation.collect import Policy, RandomPolicy, collect_rollouts
from animarl_algos.evaluation.rollouts import Rollouts
from animarl_algos.evaluation.teams import teams_of
from animarl_algos.runs.run import Run
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.splits import learnable
from animarl_envs.errors import InputError
from animarl_envs.fitting.tracking import track
from animarl_envs.locomotion import next_velocity
from animarl_envs.scenario import Scenario
from animarl_envs.species import SearchSpecies, Species
from animarl_envs.worlds import make_world
from animarl_envs.worlds.search.programmed_moth import ProgrammedMoth

Floats = NDArray[np.float64]
RECORDINGS = "recordings"
OWN_VELOCITY = (("own velocity ahead", "own velocity left"), ("velocity ahead", "velocity left"))
"""By what names worlds have an individual's velocity, in the frame of its actions."""


def reference_rollouts(
    name: str, world: Run, seed: int, repetitions: int, *, fold: bool = False
) -> Rollouts:
    """The rollouts of one row, from every test start; ``fold``: those of a cross-validation."""
    demos = world.demos
    test, species = demos.select(split="test"), world.species
    if name == RECORDINGS:
        return others_as_rollouts(beside_fold(demos) if fold else learnable(demos), test, seed)
    if name == "tracking":
        tracked = followed(test, track(test, species.locomotion, species.arena))
        return replace(tracked, method=name, seed=np.full(len(tracked), seed))
    if name == "experts":
        return expert_rollouts(demos, species, seed, repetitions)
    scenario = world.scenario
    if name == "scripted" and not isinstance(species, SearchSpecies):
        scenario = replace(scenario, drivers=("scripted",) * species.num_individuals)
    return collect_rollouts(
        partial(make_world, scenario),
        _policy(name, scenario, seed, demos),
        method=name,
        seed=seed,
        repetitions=repetitions,
        cue="actual" if name == "nearest" else None,
    )


def expert_rollouts(
    demos: Demonstrations, species: Species, seed: int, repetitions: int
) -> Rollouts:
    """The teams that made the demonstrations, each from the test starts of its own condition.

    Raises
    ------
    InputError
        If they are not known.
    """
    teams = teams_of(demos)
    if teams is None:
        raise InputError(f"{demos.name}: who made it is not known: leave 'experts' out")
    test = demos.select(split="test")
    parts = []
    for condition in np.unique(test.condition).tolist():
        own = np.flatnonzero(test.condition == condition)
        made = teams[condition].roll_out(
            species, test.select(episodes=own), name="experts", seed=seed, repetitions=repetitions
        )
        parts.append(replace(made, demo=own[made.demo]))
    return Rollouts.concatenate(parts, "experts")


def others_as_rollouts(others: Demonstrations, test: Demonstrations, seed: int) -> Rollouts:
    """Each of the ``others`` as if it were a rollout from a test start of its condition.

    They are dealt evenly and each once, so that no classifier meets one of them twice.

    Raises
    ------
    InputError
        If none has the condition of a test episode.
    """
    rng = np.random.default_rng(seed)
    taken, start, repetition = [], [], []
    for condition in np.unique(test.condition).tolist():
        starts = rng.permutation(np.flatnonzero(test.condition == condition))
        there = rng.permutation(np.flatnonzero(others.condition == condition))
        taken += there.tolist()
        start += [starts[i % len(starts)] for i in range(len(there))]
        repetition += [i // len(starts) for i in range(len(there))]
    if not taken:
        raise InputError(f"{test.name}: no other recording has the condition of a test episode")
    made = Rollouts.from_demonstrations(others).select(np.array(taken))
    return replace(
        made,
        method=RECORDINGS,
        demo=np.array(start),
        repetition=np.array(repetition),
        seed=np.full(len(taken), seed),
    )


def beside_fold(demos: Demonstrations) -> Demonstrations:
    """The recordings that the test episodes of a fold are compared with: its validation split.

    Over all folds of a cross-validation each recording is taken once, beside another one.
    """
    return demos.select(split="val")


def _policy(name: str, scenario: Scenario, seed: int, demos: Demonstrations) -> Policy:
    species = scenario.species
    if name == "nearest":
        return NearestSegment(species, learnable(demos), seed)
    if name == "random":
        return RandomPolicy(seed, species.num_actions)
    if name == "scripted":
        return ProgrammedPolicy(species, seed) if isinstance(species, SearchSpecies) else Idle()
    return Steering(scenario, keep=1.0 if name == "constant-velocity" else 0.0)


class Idle:
    """Action 0 for everybody, where the world's script decides."""

    def predict(
        self,
        observation: Any,
        state: Any = None,
        episode_start: Any = None,
        deterministic: bool = False,
    ) -> tuple[NDArray[np.int64], Any]:
        return np.zeros(len(observation), dtype=np.int64), state


class ProgrammedPolicy:
    """The programmed moth, one per slot; new ones wherever no state is handed on."""

    def __init__(self, species: SearchSpecies, seed: int) -> None:
        self._species, self._rng = species, np.random.default_rng(seed)

    def predict(
        self,
        observation: NDArray[np.floating],
        state: ProgrammedMoth | None = None,
        episode_start: Any = None,
        deterministic: bool = False,
    ) -> tuple[NDArray[np.int64], ProgrammedMoth]:
        if state is None:
            state = ProgrammedMoth(len(observation), self._rng, self._species)
            state.reset()
        return state.act(observation[:, None]).ravel().astype(np.int64), state


class Steering:
    """The action after which the velocity is nearest to ``keep`` times what it is.

    Parameters
    ----------
    scenario
        Whose observations hold each individual's own velocity.
    keep
        1 holds the velocity, 0 stops.
    """

    def __init__(self, scenario: Scenario, keep: float) -> None:
        species = scenario.species
        names = [one.name for one in make_world(scenario, 1).observation_components]
        found = [pair for pair in OWN_VELOCITY if set(pair) <= set(names)]
        if not found:
            raise InputError(f"{species.name}: what is observed holds no velocity of one's own")
        self._columns = [names.index(name) for name in found[0]]
        self._keep = keep
        self._next: list[Callable[[Floats], Floats]] = [
            partial(
                next_velocity,
                acceleration=own.action_vectors[None],
                damping=own.damping,
                thrust=own.thrust,
                dt=species.dt,
            )
            for own in species.locomotion
        ]

    def predict(
        self,
        observation: NDArray[np.floating],
        state: Any = None,
        episode_start: Any = None,
        deterministic: bool = False,
    ) -> tuple[NDArray[np.int64], Any]:
        own = observation[:, self._columns].astype(np.float64)
        actions = np.empty(len(own), dtype=np.int64)
        number = len(self._next)
        for k, after in enumerate(self._next):
            now = own[k::number, None]
            missed = np.linalg.norm(after(now) - self._keep * now, axis=-1)
            actions[k::number] = missed.argmin(axis=1)
        return actions, state
