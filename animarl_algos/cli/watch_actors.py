"""Who acts in an environment that is watched: a trained policy, a programmed moth, or nobody."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

import animarl_envs
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.errors import InputError
from animarl_envs.scenario import PACKAGED, Scenario
from animarl_envs.species import SearchSpecies, Species
from animarl_envs.worlds.base import World
from animarl_envs.worlds.executed import ExecutedActions

if TYPE_CHECKING:
    from animarl_algos.runs.run_folder import RunFolder

Actor = Callable[[World, bool], NDArray[np.integer]]
"""From a world of one copy, and whether an episode starts now, to its actions ``(1, K)``."""


@dataclass(frozen=True, eq=False)
class Trained:
    """A run's policy with its fitted species and its demonstrations.

    ``focal`` is whom it drives, if a single individual learned; its actions for the others are
    idle. ``senses`` are options of a scenario.
    """

    policy: Any
    species: Species
    demos: Demonstrations
    focal: str | None
    senses: dict[str, Any]


def load_trained(
    model: str | Path,
    species: str,
    seed: int,
    acting: str | None = None,
    given: Demonstrations | None = None,
) -> Trained:
    """The trained policy of a run's folder or of a packaged model, and the world it learned in.

    It acts as it does in tests. The demonstrations are those ``given``, or else the run's own.

    Raises
    ------
    InputError
        If the folder holds no trained policy, or one of another species or of other individuals
        than those given, or lacks its demonstrations.
    """
    from animarl_algos.data.slots import FocalPolicy
    from animarl_algos.runs.acting import acting_of
    from animarl_algos.runs.pretrained import model_folder
    from animarl_algos.runs.run_folder import RunFolder
    from animarl_algos.runs.run_world import in_the_world

    folder = model_folder(model)
    run = RunFolder(folder, acting)
    settings = run.settings
    if settings.species != species:
        raise InputError(
            f"{folder}: it was trained as {settings.species}, not as {species}: watch "
            f"{animarl_envs.environment_id(settings.species)}"
        )
    if not run.has_policy(settings.algo):
        raise InputError(f"{folder}: there is no trained policy yet: let 'animarl train' finish")
    recorded = _recordings(run, given)
    shown = recorded if given is None else _of_same_animals(given, recorded, run)
    fitted = run.species(recorded, run.fit)
    learner = run.learner(settings.algo, run.environment(fitted, recorded))
    run.load_policy(settings.algo, learner)
    learner.policy.acting = acting_of(run, settings.algo)
    learner.policy.seed(seed)
    policy: Any = learner
    if settings.focal is not None:
        policy = FocalPolicy(learner, fitted.individuals, settings.focal)
    senses = in_the_world(run.environment_options)
    return Trained(policy, fitted, shown, settings.focal, senses)


def _recordings(run: RunFolder, given: Demonstrations | None) -> Demonstrations:
    """What the run learned from; a model that was exported without them is given the same."""
    from animarl_algos.runs.run_folder import DEMONSTRATIONS
    from animarl_algos.runs.run_world import of_those_who_move

    file = run.settings.file
    if file == PACKAGED or (run.path / DEMONSTRATIONS).exists():
        return run.demos
    if given is None or given.fingerprint() != run.record["fingerprint"]:
        other = "" if given is None else f", and {given.name} holds others"
        raise InputError(
            f"{run.path}: the demonstrations that it learned from ({file}) are not in it{other}: "
            "give their file by --demos, or export it again --with-demonstrations"
        )
    return of_those_who_move(given, run.environment_options)


def _of_same_animals(
    given: Demonstrations, recorded: Demonstrations, run: RunFolder
) -> Demonstrations:
    """The given ones, of those who move in the run; refused if these are not who learned."""
    from animarl_algos.runs.run_world import of_those_who_move

    given = of_those_who_move(given, run.environment_options)
    shown, learned = (
        ", ".join(f"{name} ({role})" for name, role in zip(d.individuals, d.roles))
        for d in (given, recorded)
    )
    if shown != learned:
        raise InputError(
            f"{given.name}: it shows {shown}, but {run.path} learned from {learned}: give --demos "
            "of the same individuals, in this order"
        )
    return given


def trained_environment(model: str | Path) -> str:
    """The id of the environment that a run or a packaged model was trained in."""
    from animarl_algos.runs.pretrained import model_folder
    from animarl_algos.runs.run_folder import RunFolder

    return animarl_envs.environment_id(RunFolder(model_folder(model)).settings.species)


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
