"""What learners ask of an environment: its slots, what it declares, and how long episodes last.

Any Gymnasium environment or VecEnv will do. What AnimaRL's own ones declare beside the spaces
(individuals, feedback, the condition flag, time limits) is looked up by name, through wrappers.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import (
    DummyVecEnv,
    VecEnv,
    VecEnvWrapper,
    unwrap_vec_normalize,
)

from animarl_algos.data.species_data import LABEL_OPTIONS, SpeciesDemonstrations
from animarl_algos.losses.terms import Recipe
from animarl_envs import environment_id
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.splits import learnable
from animarl_envs.errors import InputError
from animarl_envs.scenario import refuse_other_species
from animarl_envs.species import get_species


def refuse_other_actions(learned: int, here: int) -> None:
    """Refuse a world with another number of actions than the learner has values for."""
    if learned != here:
        raise InputError(
            f"Action spaces do not match, {learned} actions learned and {here} here: give the "
            "environment it was trained in, of animals with the same thrust magnitudes"
        )


def refuse_other_observation(learned: tuple[str, ...], here: tuple[str, ...]) -> None:
    """Refuse an observation other than the one that was learned from, of the same size or not.

    Where one of the two is not known, as of environments of other packages, nothing is compared.
    """
    if not learned or not here or learned == here:
        return
    if learned[0] != here[0]:
        what = f"is of the species {here[0]}, this learner of {learned[0]}"
    elif new := [name for name in here if name not in learned]:
        what = f"shows {new[0]!r}, which this learner has not learned from"
    elif gone := [name for name in learned if name not in here]:
        what = f"does not show {gone[0]!r}, which this learner has learned from"
    else:
        what = "shows what this learner has learned from in another order"
    raise InputError(f"the environment {what}: give the one it was trained in")


@dataclass(frozen=True)
class SlotLayout:
    """Slot ``s`` of a VecEnv is individual ``s % K`` of copy ``s // K`` of the world.

    A VecEnv without the attributes ``num_copies`` and ``individuals`` (any ordinary Gymnasium
    environment) has one individual per copy, called ``agent``. All slots of a copy end together.
    """

    num_copies: int
    individuals: tuple[str, ...]  # the K names
    condition_flag: bool  # the last observation component is the experimental condition
    observed: tuple[str, ...] = ()  # the species, then the names of components, if anybody says

    @property
    def num_individuals(self) -> int:
        """Number of individuals of a copy, K."""
        return len(self.individuals)

    @classmethod
    def of(cls, env: VecEnv) -> SlotLayout:
        """Return the layout that an environment declares, or that of a single agent."""
        scaled = unwrap_vec_normalize(env)
        if scaled is not None and scaled.norm_obs:
            raise InputError(
                "VecNormalize would change the scale of observations that the replay memory holds: "
                "give the learner standardise_inputs=True instead"
            )
        if scaled is not None and scaled.norm_reward:
            raise InputError(
                "VecNormalize would change the scale of rewards that the replay memory holds: give "
                "it norm_reward=False"
            )
        individuals = tuple(getattr(env, "individuals", ("agent",)))
        num_copies = int(getattr(env, "num_copies", env.num_envs))
        if num_copies * len(individuals) != env.num_envs:
            raise InputError(
                f"the environment has {env.num_envs} slots, not {num_copies} copies of "
                f"{len(individuals)} individuals: make num_copies and individuals agree"
            )
        flagged = bool(declared(env, "condition_flag"))
        if flagged and not is_observed_as_declared(env, "condition_flag"):
            raise InputError(
                "a wrapper around the condition flag changes the observation, and the flag must be "
                "the last component: put the condition flag outermost, or leave that wrapper out"
            )
        observed = getattr(env, "observed", ())
        known = observed if isinstance(observed, tuple) else ()  # another's word for something else
        return cls(num_copies, individuals, flagged, known)


def check_observation(space: gym.Space[Any]) -> None:
    """Refuse an observation that is no array of numbers."""
    if not isinstance(space, gym.spaces.Box):
        raise InputError(
            f"observations are {type(space).__name__} and the networks take numbers in a Box: wrap "
            "the environment in gymnasium.wrappers.FlattenObservation"
        )


def check_environment_supports(
    recipe: Recipe, env: VecEnv, layout: SlotLayout, alpha: float
) -> None:
    """Refuse an environment that does not give what a recipe learns from.

    Or that weighs the distance by another ``alpha`` than the learner.
    """
    given = declared_feedback(env)
    for needed, name, words in (
        (recipe.needs_distance, "dtw_penalty", "the distance to a demonstration"),
        (recipe.needs_alignment, "aligned_action", "aligned demonstrated actions"),
    ):
        if needed and name not in given:
            raise InputError(
                f"recipe {recipe.name} needs {words} and the environment declares none ({name!r} "
                f"in its attribute feedback): learn in {_suggested_slots(env, recipe)}"
            )
    if recipe.needs_distance and (own := declared(env, "alpha")) not in (None, alpha):
        raise InputError(
            f"alpha is {own} of the environment's DTW reward and {alpha} of the learner, which "
            "weighs the distance by its own: give both the same"
        )
    if recipe.needs_condition and not layout.condition_flag:
        raise InputError(
            f"recipe {recipe.name} needs the condition flag as the last observation component and "
            f"the environment has none: learn in {_suggested_slots(env, recipe)}, or wrap it in "
            "the condition-flag wrapper"
        )


def _suggested_slots(env: VecEnv, recipe: Recipe) -> str:
    """Return the lines that make an environment for a recipe, of the species of ``env`` if any."""
    scenario, focal = declared(env, "scenario"), declared(env, "focal_index")
    species = "agent" if scenario is None else scenario.species.name
    flag = ", condition_flag=True" if recipe.needs_condition else ""
    every = f'SlotVecEnv("{species}"{flag})'
    if scenario is None or focal is None or len(scenario.names) == 1:
        return every
    one = f'SlotVecEnv("{species}", focal="{scenario.names[focal]}"{flag})'
    return f"{every}, or for one individual in {one}"


def demonstrations_in(
    env: VecEnv, demos: Demonstrations, layout: SlotLayout, options: Mapping[str, Any]
) -> SpeciesDemonstrations:
    """Return the splits of ``demos`` that training may see, in the terms of ``env``.

    They are labelled as ``env`` says, else as ``options`` of a :class:`SlotVecEnv` do.

    Raises
    ------
    InputError
        If they are of other animals or another time step, or ``env`` is of another package.
    """
    scenario, focal = declared(env, "scenario"), declared(env, "focal_index")
    if scenario is None:
        raise InputError(
            f"{demos.name}: the environment is none of AnimaRL's, which demonstrations of animals "
            "fit: learn in one, or give datasets as attributes train and val"
        )
    refuse_other_species(demos, scenario.species.name)
    known = learnable(demos)
    replace(scenario, demos=known)  # refuses others
    learners = layout.individuals if focal is None else (scenario.names[focal],)
    labels = {key: options[key] for key in LABEL_OPTIONS if key in options}
    if (own := getattr(env, "labels", None)) is not None:
        labels = dict(zip(LABEL_OPTIONS, own, strict=True))
    return SpeciesDemonstrations(scenario.species, known, learners, layout.condition_flag, **labels)


def refuse_other_slots(there: SlotLayout, here: SlotLayout) -> None:
    """Refuse the slots of an environment that are not those a learner was made for."""
    if _described(there) != _described(here):
        raise InputError(
            f"the environment has {_described(there)}, this learner {_described(here)}: give "
            "one with the same individuals"
        )
    refuse_other_observation(here.observed, there.observed)


def _described(layout: SlotLayout) -> str:
    flag = "a" if layout.condition_flag else "no"
    return f"the individuals {', '.join(layout.individuals)} and {flag} condition flag"


def declared(env: Any, name: str) -> Any:
    """Return an attribute of an environment, a VecEnv or its environments; None if none has it."""
    if isinstance(env, gym.Env):
        return env.get_wrapper_attr(name) if env.has_wrapper_attr(name) else None
    if not isinstance(env, VecEnv) or hasattr(env, name):
        return getattr(env, name, None)
    return env.get_attr(name, indices=0)[0] if env.has_attr(name) else None


def is_observed_as_declared(env: VecEnv, name: str) -> bool:
    """Whether no wrapper around what has the attribute ``name`` has another observation space."""
    layer: Any = env
    while name not in vars(layer) and not hasattr(type(layer), name):
        if isinstance(layer, VecEnvWrapper):
            layer = layer.venv
        elif isinstance(layer, DummyVecEnv):
            layer = layer.envs[0]
        elif isinstance(layer, gym.Wrapper):
            layer = layer.env
        else:
            break  # in another process
    return bool(layer.observation_space == env.observation_space)


def declared_feedback(env: VecEnv) -> tuple[str, ...]:
    """Return the names of what an environment says that it hands out beside the reward."""
    names = declared(env, "feedback")
    return tuple(names) if isinstance(names, tuple | list) else ()  # another's word


def feedback_of(
    env: VecEnv, names: tuple[str, ...], infos: list[dict[str, Any]]
) -> dict[str, NDArray[Any]]:
    """Return what came with the last step, ``(slots,)`` each, without what the environment lacks.

    Of the ``names`` that the environment declares. It is the attribute ``extras`` of the VecEnv
    where there is one (fast), otherwise in ``infos``. Where a warm-up replays other actions than
    were asked for, they are ``executed``.
    """
    values = getattr(env, "extras", None)
    if values is None:
        present = [name for name in names if name in infos[0]]
        values = {name: [info[name] for info in infos] for name in present}
    return {name: np.asarray(values[name]).reshape(-1) for name in names if name in values}


def longest_episode(env: Any, given: int | None) -> int | None:
    """Return the time limit [steps]: as ``given``, or as the environment declares it.

    Raises InputError if it declares none.
    """
    if given is not None or env is None:
        return given
    limit = declared_limit(env)
    if limit is None:
        raise InputError(
            "the environment does not say how long an episode can last: give max_episode_steps, or "
            "wrap it in gymnasium.wrappers.TimeLimit"
        )
    return limit


def check_episodes_fit(env: VecEnv, given: int | None, held: int | None) -> None:
    """Refuse episodes that may last longer than a replay memory holds [steps]."""
    limit = given or declared_limit(env)
    if limit is not None and held is not None and limit > held:
        raise InputError(
            f"its episodes last up to {limit} steps and the replay memory holds {held}: "
            "give one with a shorter time limit"
        )


def declared_limit(env: VecEnv) -> int | None:
    """Return the time limit [steps] that an environment tells of itself, if any.

    That is ``max_episode_steps`` of the VecEnv or of its environments, ``time_limit`` of AnimaRL's,
    or what the Gymnasium specs say; of several the longest.
    """
    # The last is that of Gymnasium's TimeLimit, around an environment without a spec.
    for name in ("max_episode_steps", "time_limit", "_max_episode_steps"):
        if name == "time_limit" and declared(env, "scenario") is None:
            continue  # another package's, maybe in seconds
        limit = getattr(env, name, None)
        if limit is None and env.has_attr(name):
            each = env.get_attr(name)
            limit = None if None in each else max(each)
        if limit is not None:
            return int(limit)
    limits = [spec.max_episode_steps for spec in env.get_attr("spec") if spec is not None]
    return max(map(int, limits)) if limits and all(limits) else None


def make_environment(env: str, demonstrations: Any) -> tuple[Any, Any]:
    """Return an environment of AnimaRL by its id or name, with demonstrations put into it.

    Other ids, and other demonstrations, are returned as they are.
    """
    env_id = environment_id(env)
    if "AnimaRL/" not in env and (env in gym.registry or env_id not in gym.registry):
        return env, demonstrations
    if env_id not in gym.registry:
        get_species(env)  # refuses it
    if isinstance(demonstrations, Demonstrations):
        return gym.make(env_id, demos=demonstrations), None
    return gym.make(env_id), demonstrations
