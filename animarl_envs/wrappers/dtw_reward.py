"""The DTW reward: being near the recorded path is worth something, in all three views.

    R_t = R_touch_t - alpha * penalty_t

``penalty="closeness"`` (default): a payment of at most 1 a step, the nearer the more, while the
recording lasts. ``penalty="increment"``: the step's increase of ``min_j W(t, j)``, whose sum over
the episode is the final row minimum. ``penalty="cumulative"``: the row minimum itself, the paper's
equation. The latter two pay for ending early. See :mod:`animarl_envs.dtw`.

Infos: ``task_reward``, ``dtw_penalty`` (before weighting), ``dtw_distance`` (the row minimum) and
``aligned_step`` (the recorded step aligned with the present one).
"""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.utils import RecordConstructorArgs
from gymnasium.vector import VectorEnv, VectorWrapper
from numpy.typing import NDArray
from pettingzoo.utils.wrappers import BaseParallelWrapper

from animarl_envs.dtw import DTWTracker
from animarl_envs.errors import InputError
from animarl_envs.views import AnimalEnv, AnimalParallelEnv, AnimalVectorEnv


def _tracker(env: Any, view: type[Any], alpha: float, penalty: str) -> DTWTracker:
    """Return a tracker that follows the world of an unwrapped ``view``."""
    if not issubclass(type(env), view):
        raise InputError(
            f"this DTW reward wraps AnimaRL environments of type {view.__name__}, not "
            f"{type(env).__name__}: choose the wrapper of that view"
        )
    number = isinstance(alpha, int | float | np.number) and not isinstance(alpha, bool)
    if not number or not 0 <= alpha < np.inf:
        raise InputError(f"alpha is {alpha!r}: it must be zero or positive")
    world = env.world
    everyone = list(range(world.num_individuals))
    individuals = everyone if view is AnimalParallelEnv else [env.focal_index]
    if any(isinstance(tracker, DTWTracker) for tracker in world.trackers):
        raise InputError("the environment has a DTW reward already: wrap it once")
    demos = world.demos if world.scenario.paired else None
    scale = world.scenario.species.contact_radius
    tracker = DTWTracker(demos, world.num_copies, np.array(individuals), scale, penalty)
    world.trackers.append(tracker)
    return tracker


def _shape(tracker: DTWTracker, f: int, alpha: float, reward: float, info: dict[str, Any]) -> float:
    """Return the reward of the tracker's individual ``f``; write what it is made of to ``info``."""
    info["task_reward"] = float(reward)
    info["dtw_penalty"] = float(tracker.penalty[0, f])
    info["dtw_distance"] = float(tracker.row_minimum[0, f])
    info["aligned_step"] = int(tracker.aligned[0, f])
    return float(reward) - alpha * float(tracker.penalty[0, f])


class DTWReward(
    gym.Wrapper[NDArray[np.float32], np.int64, NDArray[np.float32], np.int64],
    RecordConstructorArgs,
):
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

    feedback = ("task_reward", "dtw_penalty")
    """What learners that need it look for before they start."""

    def __init__(
        self, env: gym.Env[Any, Any], alpha: float = 1.0, penalty: str = "closeness"
    ) -> None:
        RecordConstructorArgs.__init__(self, alpha=alpha, penalty=penalty)
        gym.Wrapper.__init__(self, env)
        self.alpha = alpha
        self._tracker = _tracker(env.unwrapped, AnimalEnv, alpha, penalty)

    def step(self, action: Any) -> tuple[NDArray[np.float32], float, bool, bool, dict[str, Any]]:
        observation, reward, terminated, truncated, info = self.env.step(action)
        shaped = _shape(self._tracker, 0, self.alpha, float(reward), info)
        return observation, shaped, terminated, truncated, info


class DTWRewardVector(VectorWrapper):
    """The DTW reward for an :class:`~animarl_envs.views.vector.AnimalVectorEnv`.

    Each copy's rows are reset with that copy; a step that only resets costs nothing. With
    ``SAME_STEP``, ``dtw_distance`` and ``aligned_step`` of an ended copy are in ``final_info``.
    Parameters as in :class:`DTWReward`.
    """

    def __init__(self, env: VectorEnv, alpha: float = 1.0, penalty: str = "closeness") -> None:
        super().__init__(env)
        self.alpha = alpha
        self._tracker = _tracker(env.unwrapped, AnimalVectorEnv, alpha, penalty)

    def step(
        self, actions: Any
    ) -> tuple[NDArray[np.float32], NDArray[Any], NDArray[Any], NDArray[Any], dict[str, Any]]:
        observations, rewards, terminated, truncated, infos = self.env.step(actions)
        tracker, inner = self._tracker, self.env.unwrapped
        assert isinstance(inner, AnimalVectorEnv)
        cost = np.where(inner.reset_by_step, 0.0, tracker.penalty[:, 0])
        told = {
            "task_reward": rewards,
            "dtw_penalty": cost,
            "dtw_distance": tracker.row_minimum[:, 0].copy(),
            "aligned_step": tracker.aligned[:, 0].copy(),
        }
        infos |= told | {f"_{key}": np.ones(self.num_envs, dtype=bool) for key in told}
        if "final_info" in infos:
            ended = infos["_final_info"]
            final = {
                "task_reward": rewards,
                "dtw_penalty": cost,
                "dtw_distance": tracker.final_minimum[:, 0].copy(),
                "aligned_step": tracker.final_aligned[:, 0].copy(),
            }
            infos["final_info"] |= final | {f"_{key}": ended.copy() for key in final}
        return observations, rewards - self.alpha * cost, terminated, truncated, infos


class DTWRewardParallel(BaseParallelWrapper):  # type: ignore[type-arg]
    """The DTW reward for an :class:`~animarl_envs.views.parallel.AnimalParallelEnv`.

    Every individual has its own row. Parameters as in :class:`DTWReward`.
    """

    def __init__(self, env: Any, alpha: float = 1.0, penalty: str = "closeness") -> None:
        super().__init__(env)
        self.alpha = alpha
        self._tracker = _tracker(env.unwrapped, AnimalParallelEnv, alpha, penalty)

    def step(self, actions: dict[str, int]) -> tuple[Any, Any, Any, Any, Any]:
        observations, rewards, terminated, truncated, infos = self.env.step(actions)
        for f, (agent, reward) in enumerate(rewards.items()):
            rewards[agent] = _shape(self._tracker, f, self.alpha, reward, infos[agent])
        return observations, rewards, terminated, truncated, infos
