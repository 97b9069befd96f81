"""Acting in a VecEnv and storing what comes of it, one step of every copy at a time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv

from animarl_algos.data.slots import Feedback, SlotLayout, provided
from animarl_algos.losses.terms import Recipe
from animarl_algos.replay.sequence_buffer import SequenceReplayBuffer
from animarl_envs.errors import InputError


@dataclass(frozen=True)
class Ended:
    """Which copies ended at a step, and how: both ``(copies,)`` bool."""

    terminated: NDArray[np.bool_]
    truncated: NDArray[np.bool_]

    @property
    def count(self) -> int:
        return int((self.terminated | self.truncated).sum())


def check_environment(env: VecEnv, layout: SlotLayout, recipe: Recipe) -> None:
    """Refuse an environment that does not give what a recipe learns from.

    Raises
    ------
    InputError
        Before the first step, and before an offline phase.
    """
    given = provided(env)
    if recipe.needs_distance and "dtw_penalty" not in given:
        raise _lacking(recipe, "the distance to a demonstration", "dtw_penalty")
    if recipe.needs_alignment and "aligned_action" not in given:
        raise _lacking(recipe, "aligned demonstrated actions", "aligned_action")
    if recipe.needs_condition and not layout.condition_flag:
        raise InputError(
            f"recipe {recipe.name} needs the condition flag as the last observation component and "
            "the environment has none: wrap it in the condition-flag wrapper"
        )


def _lacking(recipe: Recipe, what: str, name: str) -> InputError:
    return InputError(
        f"recipe {recipe.name} needs {what} and the environment declares none ({name!r} in its "
        "attribute feedback): learn in a SlotVecEnv with demonstrations, or wrap a single "
        "environment in the DTW reward"
    )


class Recorder:
    """Turns the slots of a VecEnv's step into a step of the replay memory."""

    def __init__(self, env: VecEnv, layout: SlotLayout, recipe: Recipe) -> None:
        self._feedback = Feedback(env)
        self._layout = layout
        self._recipe = recipe
        self._none = np.zeros(layout.num_copies, dtype=bool)

    def record(
        self,
        buffer: SequenceReplayBuffer,
        observation: NDArray[Any],
        hidden: NDArray[np.float32],
        actions: NDArray[np.integer],
        next_observation: NDArray[Any],
        reward: NDArray[np.floating],
        dones: NDArray[np.bool_],
        infos: list[dict[str, Any]],
    ) -> Ended:
        """Store one step of all slots.

        Parameters
        ----------
        observation, next_observation
            ``(S, n)``; where a slot is done, ``next_observation`` is already the next episode's
            first.
        hidden
            ``(S, H)``, recurrent states before the step.
        actions, reward, dones
            ``(S,)``.
        infos
            One dictionary per slot.
        """
        feedback, layout = self._feedback, self._layout
        feedback.update(infos)
        actions = self.executed(actions)
        per_copy = (layout.num_copies, layout.num_individuals)
        task_reward = feedback.get("task_reward")
        penalty = feedback.get("dtw_penalty")
        label = feedback.get("aligned_action")
        warmup = feedback.get("warmup")
        if self._recipe.needs_distance and penalty is None:
            raise _lacking(self._recipe, "the distance to a demonstration", "dtw_penalty")
        if self._recipe.needs_alignment and label is None:
            raise _lacking(self._recipe, "aligned demonstrated actions", "aligned_action")
        ended = self._ended(dones)
        successors = feedback.successors(next_observation, dones)
        condition = feedback.get("condition")
        if condition is not None:
            condition = condition.reshape(per_copy)[:, 0]
        elif layout.condition_flag:
            condition = observation.reshape(layout.num_copies, layout.num_individuals, -1)[:, 0, -1]
        buffer.add(
            observation.reshape(*per_copy, -1),
            actions.reshape(per_copy),
            (reward if task_reward is None else task_reward).reshape(per_copy),
            successors.reshape(*per_copy, -1),
            ended.terminated,
            ended.truncated,
            penalties=None if penalty is None else penalty.reshape(per_copy),
            labels=None if label is None else label.reshape(per_copy),
            warmup=None if warmup is None else warmup.reshape(per_copy)[:, 0],
            hidden=hidden.reshape(*per_copy, -1),
            condition=condition,
        )
        return ended

    def executed(self, actions: NDArray[np.integer]) -> NDArray[np.integer]:
        """The actions ``(S,)`` of the step just recorded; see :meth:`.slots.Feedback.executed`."""
        return self._feedback.executed(actions)

    def _ended(self, dones: NDArray[np.bool_]) -> Ended:
        if not dones.any():
            return Ended(self._none, self._none)
        per_copy = dones.reshape(self._layout.num_copies, -1)
        done = per_copy[:, 0]
        if not (per_copy == done[:, None]).all():
            raise InputError(
                "the individuals of a copy ended at different steps: an episode must end for all "
                "of its slots together"
            )
        truncated = self._feedback.truncated(done)
        return Ended(done & ~truncated, truncated)
