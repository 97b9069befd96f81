"""Who acts in an environment that is watched: a trained policy, a programmed moth, or nobody."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

import animarl_envs
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.errors import InputError
from animarl_envs.scenario import Scenario
from animarl_envs.species import SearchSpecies
from animarl_envs.worlds.base import World
from animarl_envs.worlds.executed import ExecutedActions

if TYPE_CHECKING:
    from animarl_algos.runs.run import Run

Actor = Callable[[World, bool], NDArray[np.integer]]
"""From a world of one copy, and whether an episode starts now, to its actions ``(1, K)``."""


def load_trained(
    model: str | Path,
    species: str,
    seed: int,
    acting: str | None = None,
    given: Demonstrations | None = None,
) -> tuple[Run, Demonstrations]:
    """Return a run or a packaged model whose policy acts as in tests, and what it is shown with.

    The demonstrations are those ``given``, or else the run's own.

    Raises
    ------
    InputError
        If the folder holds no trained policy, or one of another species or of other individuals
        than those given, or lacks its demonstrations.
    """
    from animarl_algos.runs.pretrained import model_folder
    from animarl_algos.runs.run import Run

    folder = model_folder(model)
    run = Run(folder, acting)
    settings = run.settings
    if settings.species != species:
        raise InputError(
            f"{folder}: it was trained as {settings.species}, not as {species}: watch "
            f"{animarl_envs.environment_id(settings.species)}"
        )
    run.use_demonstrations(given)
    shown = run.demos if given is None else _of_same_animals(given, run)
    if run.has_policy(settings.algo):
        run.acting(settings.algo)  # chosen already: watching chooses none
    run.policy.policy.seed(seed)
    return run, shown


def _of_same_animals(given: Demonstrations, run: Run) -> Demonstrations:
    """The given ones, of those who move in the run; refused if these are not who learned."""
    from animarl_algos.runs.run_world import select_individuals

    given = select_individuals(given, run.environment_options)
    shown, learned = (
        ", ".join(f"{name} ({role})" for name, role in zip(d.individuals, d.roles))
        for d in (given, run.demos)
    )
    if shown != learned:
        raise InputError(
            f"{given.name}: it shows {shown}, but {run.path} learned from {learned}: give --demos "
            "of the same individuals, in this order"
        )
    return given


def trained_environment(model: str | Path) -> str:
    """Return the id of the environment that a run or a packaged model was trained in."""
    from animarl_algos.runs.pretrained import model_folder
    from animarl_algos.runs.run import Run

    return animarl_envs.environment_id(Run(model_folder(model)).settings.species)


def idle_actor(world: World, start: bool) -> NDArray[np.integer]:
    """No decisions: the world replays or follows its script."""
    return np.zeros((1, world.num_individuals), dtype=np.int64)


def programmed_actor(scenario: Scenario, seed: int) -> Actor:
    """The programmed moth: surge, zigzag, loop."""
    from animarl_envs.worlds.search.programmed_moth import ProgrammedMoth

    species = scenario.species
    assert isinstance(species, SearchSpecies)
    moth = ProgrammedMoth(1, np.random.default_rng(seed), species)

    def act(world: World, start: bool) -> NDArray[np.integer]:
        if start:
            moth.reset()
        return moth.act(world.observation)

    return act


def trained_actor(policy: Any) -> Actor:
    """A policy of ``predict``; one that was trained with the condition's flag is told it."""
    from animarl_algos.evaluation.collect import remembered

    state: Any = None
    executed_by: ExecutedActions | None = None

    def act(world: World, start: bool) -> NDArray[np.integer]:
        nonlocal state, executed_by
        if start or executed_by is None:
            executed_by = ExecutedActions(world)
        num = world.num_individuals
        observation = world.observation[0]
        if policy.observation_space.shape[-1] == observation.shape[-1] + 1:
            flag = np.full((num, 1), world.condition[0], dtype=observation.dtype)
            observation = np.concatenate([observation, flag], axis=1)
        starts = np.full(num, start)
        actions, state = policy.predict(observation, state=state, episode_start=starts)
        asked = np.asarray(actions).reshape(1, num)
        state = remembered(policy, state, asked, executed_by(asked))
        return asked

    return act
