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


def cue_of(condition: NDArray[np.int8], cue: Cue) -> NDArray[np.int8]:
    """Return the conditions ``(B,)`` as the cue tells them."""
    if cue == "actual":
        return condition.copy()
    if cue == "flipped":
        return np.asarray(1 - condition, dtype=np.int8)
    return np.full(condition.shape, cue, dtype=np.int8)


def check_cue(cue: Any, conditions: tuple[str, ...], species: str) -> None:
    """Raise InputError for an unknown cue, or for a species without conditions."""
    if cue not in ("actual", "flipped", 0, 1) or isinstance(cue, bool):
        raise InputError(f"cue is {cue!r}: choose 'actual', 'flipped', 0 or 1")
    if not conditions:
        raise InputError(f"{species} has no experimental conditions: leave the condition flag out")


def with_flag(space: spaces.Box) -> spaces.Box:
    """The space with one more component, 0 or 1."""
    low = np.append(space.low, np.float32(0.0))
    high = np.append(space.high, np.float32(1.0))
    return spaces.Box(low, high, dtype=np.float32)


def _check(env: Any, cue: Any) -> None:
    if not isinstance(getattr(env, "scenario", None), Scenario):
        raise InputError(
            f"the condition flag wraps AnimaRL environments, not {type(env).__name__}: it has no "
            "experimental condition"
        )
    species = env.scenario.species
    check_cue(cue, species.conditions, species.name)


class ConditionFlag(
    gym.Wrapper[NDArray[np.float32], np.int64, NDArray[np.float32], np.int64],
    RecordConstructorArgs,
):
    """The condition flag for a single environment."""

    condition_flag = True

    def __init__(self, env: gym.Env[Any, Any], cue: Cue = "actual") -> None:
        RecordConstructorArgs.__init__(self, cue=cue)
        gym.Wrapper.__init__(self, env)
        _check(env.unwrapped, cue)
        self.cue = cue
        self.observation_space = with_flag(env.observation_space)  # type: ignore

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        observation, info = self.env.reset(seed=seed, options=options)
        return self._flag(observation), info

    def step(self, action: Any) -> tuple[NDArray[np.float32], Any, bool, bool, dict[str, Any]]:
        observation, reward, terminated, truncated, info = self.env.step(action)
        return self._flag(observation), reward, terminated, truncated, info

    def _flag(self, observation: NDArray[np.float32]) -> NDArray[np.float32]:
        condition = self.env.unwrapped.world.condition  # type: ignore[attr-defined]
        return np.append(observation, cue_of(condition, self.cue)[0].astype(np.float32))


class ConditionFlagVector(VectorWrapper):
    """The condition flag for a vector environment."""

    condition_flag = True

    def __init__(self, env: VectorEnv, cue: Cue = "actual") -> None:
        super().__init__(env)
        _check(env.unwrapped, cue)
        self.cue = cue
        self.single_observation_space = with_flag(env.single_observation_space)  # type: ignore[arg-type]
        self.observation_space = batch_space(self.single_observation_space, env.num_envs)

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        observations, infos = self.env.reset(seed=seed, options=options)  # type: ignore[arg-type]
        return self._flag(observations, infos["condition"]), infos

    def step(
        self, actions: Any
    ) -> tuple[NDArray[np.float32], NDArray[Any], NDArray[Any], NDArray[Any], dict[str, Any]]:
        observations, rewards, terminated, truncated, infos = self.env.step(actions)
        if "final_obs" in infos:
            flags = cue_of(infos["final_info"]["condition"].astype(np.int8), self.cue)
            for b in np.flatnonzero(infos["_final_obs"]):
                infos["final_obs"][b] = np.append(infos["final_obs"][b], np.float32(flags[b]))
        return (
            self._flag(observations, infos["condition"]), rewards, terminated, truncated, infos
        )  # fmt: skip

    def _flag(
        self, observations: NDArray[np.float32], condition: NDArray[np.int64]
    ) -> NDArray[np.float32]:
        flags = cue_of(condition.astype(np.int8), self.cue)
        return np.concatenate([observations, flags[:, None].astype(np.float32)], axis=1)


class ConditionFlagParallel(BaseParallelWrapper):  # type: ignore[type-arg]
    """The condition flag for all individuals."""

    condition_flag = True

    def __init__(self, env: Any, cue: Cue = "actual") -> None:
        super().__init__(env)
        _check(env.unwrapped, cue)
        self.cue = cue
        self.observation_spaces = {
            agent: with_flag(env.observation_space(agent)) for agent in env.possible_agents
        }

    def observation_space(self, agent: str) -> spaces.Box:
        return self.observation_spaces[agent]

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, Any]:
        observations, infos = self.env.reset(seed=seed, options=options)  # type: ignore[arg-type]
        return self._flag(observations), infos

    def step(self, actions: dict[str, int]) -> tuple[Any, Any, Any, Any, Any]:
        observations, *rest = self.env.step(actions)
        return (self._flag(observations), *rest)  # type: ignore[return-value]

    def _flag(self, observations: dict[str, NDArray[np.float32]]) -> dict[str, Any]:
        flag = cue_of(self.env.unwrapped.world.condition, self.cue)[0].astype(np.float32)
        return {agent: np.append(row, flag) for agent, row in observations.items()}
