"""The condition flag: the experimental condition as the last observation component.

The cue can be flipped without changing the world: ``cue="actual"`` tells the world's condition,
``"flipped"`` the other one, 0 or 1 always that.
"""

from __future__ import annotations

from typing import Any, Literal

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from gymnasium.utils import RecordConstructorArgs
from gymnasium.vector import VectorEnv, VectorWrapper
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray
from pettingzoo.utils.wrappers import BaseParallelWrapper

from animarl_envs.errors import InputError
from animarl_envs.scenario import Scenario

Cue = Literal["actual", "flipped", 0, 1]


def cue_of(condition: NDArray[np.integer], cue: Cue) -> NDArray[np.int8]:
    """Return the conditions ``(...)`` as the cue tells them."""
    told = {"actual": condition, "flipped": 1 - condition}.get(str(cue))
    return np.array(np.full(condition.shape, cue) if told is None else told, dtype=np.int8)


def check_cue(cue: Any, conditions: tuple[str, ...], species: str) -> None:
    """Raise InputError for an unknown cue, or for a species without conditions."""
    if cue not in ("actual", "flipped", 0, 1) or isinstance(cue, bool):
        raise InputError(f"cue is {cue!r}: choose 'actual', 'flipped', 0 or 1")
    if not conditions:
        raise InputError(f"{species} has no experimental conditions: leave the condition flag out")


def with_flag(space: Any) -> spaces.Box:
    """Return the space with one more component, 0 or 1."""
    low = np.append(space.low, np.float32(0.0))
    high = np.append(space.high, np.float32(1.0))
    return spaces.Box(low, high, dtype=np.float32)


class _Flag:
    """Adds the flag of a condition; the same in all views."""

    condition_flag = True

    def _set_cue(self, env: Any, cue: Cue) -> None:
        if not isinstance(getattr(env, "scenario", None), Scenario):
            raise InputError(
                f"the condition flag wraps AnimaRL environments, not {type(env).__name__}: it has "
                "no experimental condition"
            )
        check_cue(cue, env.scenario.species.conditions, env.scenario.species.name)
        self.cue, self._world = cue, env.world

    def _flag(self, observation: Any, condition: Any = None) -> Any:
        """Add the flag to ``(..., n)``, by default that of a world with one copy."""
        condition = self._world.condition[0] if condition is None else condition
        flag = cue_of(np.asarray(condition), self.cue).astype(np.float32)
        return np.concatenate([observation, flag[..., None]], axis=-1)


class ConditionFlag(_Flag, gym.ObservationWrapper[Any, Any, Any], RecordConstructorArgs):
    """The condition flag for a single environment."""

    def __init__(self, env: gym.Env[Any, Any], cue: Cue = "actual") -> None:
        RecordConstructorArgs.__init__(self, cue=cue)
        gym.ObservationWrapper.__init__(self, env)
        self._set_cue(env.unwrapped, cue)
        self.observation_space = with_flag(env.observation_space)

    def observation(self, observation: NDArray[np.float32]) -> Any:
        return self._flag(observation)


class ConditionFlagVector(_Flag, VectorWrapper):
    """The condition flag for a vector environment."""

    def __init__(self, env: VectorEnv, cue: Cue = "actual") -> None:
        super().__init__(env)
        self._set_cue(env.unwrapped, cue)
        self.single_observation_space = with_flag(env.single_observation_space)
        self.observation_space = batch_space(self.single_observation_space, env.num_envs)

    def reset(self, **arguments: Any) -> tuple[Any, dict[str, Any]]:
        observations, infos = self.env.reset(**arguments)
        return self._flag(observations, infos["condition"]), infos

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        observations, *rest, infos = self.env.step(actions)
        if "final_obs" in infos:
            for b in np.flatnonzero(infos["_final_obs"]):
                last, condition = infos["final_obs"][b], infos["final_info"]["condition"][b]
                infos["final_obs"][b] = self._flag(last, condition)
        return self._flag(observations, infos["condition"]), *rest, infos  # type: ignore[return-value]


class ConditionFlagParallel(_Flag, BaseParallelWrapper):  # type: ignore[type-arg]
    """The condition flag for all individuals."""

    def __init__(self, env: Any, cue: Cue = "actual") -> None:
        super().__init__(env)
        self._set_cue(env.unwrapped, cue)
        self.observation_spaces = {
            agent: with_flag(env.observation_space(agent)) for agent in env.possible_agents
        }

    def observation_space(self, agent: str) -> spaces.Box:
        return self.observation_spaces[agent]

    def reset(self, *arguments: Any, **named: Any) -> tuple[Any, Any]:
        observations, infos = self.env.reset(*arguments, **named)
        return {agent: self._flag(row) for agent, row in observations.items()}, infos

    def step(self, actions: dict[str, int]) -> tuple[Any, Any, Any, Any, Any]:
        observations, *rest = self.env.step(actions)
        return {agent: self._flag(row) for agent, row in observations.items()}, *rest  # type: ignore[return-value]
