"""Wrappers for each of the three views: the condition flag and the DTW reward.

The condition flag is the experimental condition as the last observation component. The cue can be
flipped without changing the world: ``cue="actual"`` tells the world's condition, ``"flipped"`` the
other one, 0 or 1 always that.

With the DTW reward, being near the recorded path is worth something::

    R_t = R_touch_t - refund_t - alpha * penalty_t

``penalty="closeness"`` (default): a payment of at most 1 a step, the nearer the more, while the
recording lasts; afterwards ``refund`` takes back what the world pays for lasting.
``penalty="increment"``: the step's increase of ``min_j W(t, j)``, whose sum over the episode is the
final row minimum. ``penalty="cumulative"``: the row minimum itself, the paper's equation. The
latter two pay for ending early. See :mod:`animarl_envs.dtw`.

Infos: ``task_reward``, ``dtw_penalty`` (before weighting), ``dtw_refund``, ``dtw_distance`` (the
row minimum) and ``aligned_step`` (the recorded step aligned with the present one).
"""

from typing import Any, Literal

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from gymnasium.utils import RecordConstructorArgs
from gymnasium.vector import VectorEnv, VectorWrapper
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray
from pettingzoo.utils.wrappers import BaseParallelWrapper

from animarl_envs.dtw import DTWTracker
from animarl_envs.errors import InputError
from animarl_envs.scenario import Scenario
from animarl_envs.settings import is_number
from animarl_envs.views import AnimalEnv, AnimalParallelEnv, AnimalVectorEnv

__all__ = [
    "ConditionFlag",
    "ConditionFlagParallel",
    "ConditionFlagVector",
    "DTWReward",
    "DTWRewardParallel",
    "DTWRewardVector",
]

Cue = Literal["actual", "flipped", 0, 1]


def cue_of(condition: NDArray[np.integer], cue: Cue) -> NDArray[np.int8]:
    """Return the conditions ``(...)`` that a cue shows."""
    flag = {"actual": condition, "flipped": 1 - condition}.get(str(cue))
    return np.array(np.full(condition.shape, cue) if flag is None else flag, dtype=np.int8)


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
    """Add the flag of a condition; the same in all views."""

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
        """Return the observation with the flag."""
        return self._flag(observation)


class ConditionFlagVector(_Flag, VectorWrapper):
    """The condition flag for a vector environment."""

    def __init__(self, env: VectorEnv, cue: Cue = "actual") -> None:
        super().__init__(env)
        self._set_cue(env.unwrapped, cue)
        self.single_observation_space = with_flag(env.single_observation_space)
        self.observation_space = batch_space(self.single_observation_space, env.num_envs)

    def reset(self, **arguments: Any) -> tuple[Any, dict[str, Any]]:
        """Reset; observations get the flag."""
        observations, infos = self.env.reset(**arguments)
        return self._flag(observations, infos["condition"]), infos

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Step; observations get the flag, also the last ones of ended episodes."""
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
        """Return the individual's space with the flag."""
        return self.observation_spaces[agent]

    def reset(self, *arguments: Any, **named: Any) -> tuple[Any, Any]:
        """Reset; observations get the flag."""
        observations, infos = self.env.reset(*arguments, **named)
        return {agent: self._flag(row) for agent, row in observations.items()}, infos

    def step(self, actions: dict[str, int]) -> tuple[Any, Any, Any, Any, Any]:
        """Step; observations get the flag."""
        observations, *rest = self.env.step(actions)
        return {agent: self._flag(row) for agent, row in observations.items()}, *rest  # type: ignore[return-value]


class _DTW:
    """Follow the world of a view and pay the DTW reward; the same in all views."""

    view: type[Any]

    def _follow(self, env: Any, alpha: float, penalty: str) -> None:
        if not issubclass(type(env), self.view):
            raise InputError(
                f"this DTW reward wraps AnimaRL environments of type {self.view.__name__}, not "
                f"{type(env).__name__}: choose the wrapper of that view"
            )
        if not is_number(alpha) or not 0 <= alpha < np.inf:
            raise InputError(f"alpha is {alpha!r}: it must be zero or positive")
        world = env.world
        if any(isinstance(tracker, DTWTracker) for tracker in world.trackers):
            raise InputError("the environment has a DTW reward already: wrap it once")
        everyone = range(world.num_individuals)
        individuals = [env.focal_index] if hasattr(env, "focal_index") else everyone
        demos = world.demos if world.scenario.paired else None
        scale = world.scenario.species.contact_radius
        self.alpha = alpha
        self._tracker = DTWTracker(demos, world.num_copies, np.array(individuals), scale, penalty)
        world.trackers.append(self._tracker)

    def _shape(self, f: int, reward: float, info: dict[str, Any]) -> float:
        """Return the reward of the tracked individual ``f``; write its parts to ``info``."""
        tracker = self._tracker
        cost, refund = float(tracker.penalty[0, f]), float(tracker.refund[0, f])
        info["task_reward"], info["dtw_penalty"] = float(reward), cost
        info["dtw_refund"] = refund
        info["dtw_distance"] = float(tracker.row_minimum[0, f])
        info["aligned_step"] = int(tracker.aligned[0, f])
        return float(reward) - refund - self.alpha * cost


class DTWReward(_DTW, gym.Wrapper[Any, Any, Any, Any], RecordConstructorArgs):
    """The DTW reward for a single :class:`~animarl_envs.views.single.AnimalEnv`.

    Parameters
    ----------
    env
        The environment; its episodes must start from demonstrations.
    alpha
        Weight of the penalty [1 / arena unit; 1 with ``"closeness"``].
    penalty
        ``"closeness"``, ``"increment"`` or ``"cumulative"``.

    Raises
    ------
    InputError
        If the environment is not one of this package or has no demonstrations.
    """

    view = AnimalEnv
    feedback = ("task_reward", "dtw_penalty", "dtw_refund", *AnimalEnv.feedback)
    """What learners that need it look for before they start."""

    def __init__(
        self, env: gym.Env[Any, Any], alpha: float = 1.0, penalty: str = "closeness"
    ) -> None:
        RecordConstructorArgs.__init__(self, alpha=alpha, penalty=penalty)
        gym.Wrapper.__init__(self, env)
        self._follow(env.unwrapped, alpha, penalty)

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Step and shape the reward; ``info`` gets its parts."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        return observation, self._shape(0, float(reward), info), terminated, truncated, info


class DTWRewardVector(_DTW, VectorWrapper):
    """The DTW reward for an :class:`~animarl_envs.views.vector.AnimalVectorEnv`.

    Each copy's rows are reset with that copy; a step that only resets costs nothing. With
    ``SAME_STEP``, ``dtw_distance`` and ``aligned_step`` of an ended copy are in ``final_info``.
    Parameters as in :class:`DTWReward`.
    """

    view = AnimalVectorEnv

    def __init__(self, env: VectorEnv, alpha: float = 1.0, penalty: str = "closeness") -> None:
        super().__init__(env)
        self._follow(env.unwrapped, alpha, penalty)

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Step and shape the rewards; ``infos`` get their parts."""
        observations, rewards, terminated, truncated, infos = self.env.step(actions)
        tracker = self._tracker
        stepped = ~self.env.unwrapped.reset_by_step  # type: ignore[attr-defined]
        cost, refund = (np.where(stepped, c[:, 0], 0.0) for c in (tracker.penalty, tracker.refund))
        paid = {"task_reward": rewards, "dtw_penalty": cost, "dtw_refund": refund}
        self._note(infos, paid, tracker.row_minimum, tracker.aligned, ~np.zeros_like(terminated))
        if "final_info" in infos:
            final, ended = infos["final_info"], infos["_final_info"]
            self._note(final, paid, tracker.final_minimum, tracker.final_aligned, ended)
        shaped = rewards - refund - self.alpha * cost
        return observations, shaped, terminated, truncated, infos

    def _note(
        self, infos: dict[str, Any], paid: Any, distance: Any, step: Any, copies: Any
    ) -> None:
        """Write rewards' parts and the alignment of ``copies`` (a mask) to ``infos``."""
        parts = {"dtw_distance": distance[:, 0].copy(), "aligned_step": step[:, 0].copy()} | paid
        infos |= parts | {f"_{key}": copies.copy() for key in parts}


class DTWRewardParallel(_DTW, BaseParallelWrapper):  # type: ignore[type-arg]
    """The DTW reward for an :class:`~animarl_envs.views.parallel.AnimalParallelEnv`.

    Every individual has its own row. Parameters as in :class:`DTWReward`.
    """

    view = AnimalParallelEnv

    def __init__(self, env: Any, alpha: float = 1.0, penalty: str = "closeness") -> None:
        super().__init__(env)
        self._follow(env.unwrapped, alpha, penalty)

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, Any]:
        """Reset; ``infos`` have the names of a step, all 0."""
        observations, infos = self.env.reset(seed=seed, options=options)
        for info in infos.values():
            info |= dict.fromkeys(("task_reward", "dtw_penalty", "dtw_refund"), 0.0)
            info |= {"dtw_distance": 0.0, "aligned_step": 0}
        return observations, infos

    def step(self, actions: dict[str, int]) -> tuple[Any, Any, Any, Any, Any]:
        """Step and shape the rewards; ``infos`` get their parts."""
        observations, rewards, terminated, truncated, infos = self.env.step(actions)
        for f, (agent, reward) in enumerate(rewards.items()):
            rewards[agent] = self._shape(f, reward, infos[agent])
        return observations, rewards, terminated, truncated, infos
