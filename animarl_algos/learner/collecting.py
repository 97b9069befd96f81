"""One step of acting: choose, step the environment, store, and forget where episodes ended."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv

from animarl_algos.data.slots import Feedback, SlotLayout, provided
from animarl_algos.losses.terms import Recipe
from animarl_algos.networks.acting_rule import Acting
from animarl_algos.networks.policies import GruPolicy
from animarl_algos.replay.sequence_buffer import SequenceReplayBuffer
from animarl_envs.errors import InputError

Memory = tuple[NDArray[np.float32], NDArray[np.int64]]
"""Of all slots: recurrent states ``(S, H)`` and previous actions ``(S,)``."""


@dataclass(frozen=True)
class Step:
    """The outcome of one step of all slots.

    Attributes
    ----------
    actions, rewards, dones
        ``(S,)``.
    observation, memory
        Before the next step; where an episode ended, of the next one.
    infos
        One dictionary per slot.
    finished
        Number of copies whose episode ended.
    """

    actions: NDArray[np.int64]
    observation: NDArray[Any]
    memory: Memory
    rewards: NDArray[np.floating]
    dones: NDArray[np.bool_]
    infos: list[dict[str, Any]]
    finished: int


def check_environment_supports(recipe: Recipe, env: VecEnv, layout: SlotLayout) -> None:
    """Refuse an environment that does not give what a recipe learns from.

    Raises
    ------
    InputError
        Before the first step, and before an offline phase.
    """
    given = provided(env)
    if recipe.needs_distance and "dtw_penalty" not in given:
        raise _lacking(recipe, "dtw_penalty")
    if recipe.needs_alignment and "aligned_action" not in given:
        raise _lacking(recipe, "aligned_action")
    if recipe.needs_condition and not layout.condition_flag:
        raise InputError(
            f"recipe {recipe.name} needs the condition flag as the last observation component and "
            "the environment has none: wrap it in the condition-flag wrapper"
        )


IN_WORDS = {
    "dtw_penalty": "the distance to a demonstration",
    "aligned_action": "aligned demonstrated actions",
}


def _lacking(recipe: Recipe, name: str) -> InputError:
    return InputError(
        f"recipe {recipe.name} needs {IN_WORDS[name]} and the environment declares none ({name!r} "
        "in its attribute feedback): learn in a SlotVecEnv with demonstrations, or wrap a single "
        "environment in the DTW reward"
    )


class Collector:
    """Acts in a VecEnv by a policy and stores each step in the replay memory."""

    def __init__(self, policy: GruPolicy, env: VecEnv, layout: SlotLayout, recipe: Recipe) -> None:
        self._policy, self._env, self._layout, self._recipe = policy, env, layout, recipe
        self._feedback = Feedback(env)

    def step(
        self,
        buffer: SequenceReplayBuffer,
        observation: NDArray[Any],
        memory: Memory,
        *,
        at_random: bool = False,
    ) -> Step:
        """Make one step of all slots from ``observation`` and store it in ``buffer``.

        Actions are chosen by the policy's acting rule, or uniformly ``at_random``.
        """
        policy, feedback = self._policy, self._feedback
        actions, (hidden, _) = self._choose(observation, memory, at_random)
        new, rewards, dones, infos = self._env.step(actions)
        new = np.array(new)  # an environment may overwrite its own
        feedback.update(infos)
        executed = feedback.executed(actions)
        finished = self._store(buffer, observation, memory[0], executed, new, rewards, dones)
        previous = executed.astype(np.int64)
        if finished:  # episodes that begin have no memory and no previous action
            hidden[dones], previous[dones] = 0.0, policy.num_actions
        return Step(actions, new, (hidden, previous), rewards, dones, infos, finished)

    def _choose(
        self, observation: NDArray[Any], memory: Memory, at_random: bool
    ) -> tuple[NDArray[np.int64], Memory]:
        policy = self._policy
        rule = policy.acting
        if at_random:
            policy.acting = Acting.epsilon_greedy(1.0)
        try:
            return policy.predict(observation, memory)
        finally:
            policy.acting = rule

    def _store(
        self,
        buffer: SequenceReplayBuffer,
        observation: NDArray[Any],
        hidden: NDArray[np.float32],
        actions: NDArray[np.integer],
        next_observation: NDArray[Any],
        reward: NDArray[np.floating],
        dones: NDArray[np.bool_],
    ) -> int:
        """Store one step of all slots; return the number of copies whose episode ended.

        ``hidden`` are the recurrent states before the step. Where a slot is done,
        ``next_observation`` is already the next episode's first.
        """
        feedback, layout, recipe = self._feedback, self._layout, self._recipe
        per_copy = (layout.num_copies, layout.num_individuals)
        task_reward = feedback.get("task_reward")
        penalty = feedback.get("dtw_penalty")
        label = feedback.get("aligned_action")
        warmup = feedback.get("warmup")
        if recipe.needs_distance and penalty is None:
            raise _lacking(recipe, "dtw_penalty")
        if recipe.needs_alignment and label is None:
            raise _lacking(recipe, "aligned_action")
        done = self._copies_done(dones)
        truncated = feedback.truncated(done)
        successors = feedback.successors(next_observation, dones)
        condition = feedback.get("condition")
        if condition is not None:
            condition = condition.reshape(per_copy)[:, 0]
        elif layout.condition_flag:
            condition = observation.reshape(*per_copy, -1)[:, 0, -1]
        buffer.add(
            observation.reshape(*per_copy, -1),
            actions.reshape(per_copy),
            (reward if task_reward is None else task_reward).reshape(per_copy),
            successors.reshape(*per_copy, -1),
            done & ~truncated,
            truncated,
            penalties=None if penalty is None else penalty.reshape(per_copy),
            labels=None if label is None else label.reshape(per_copy),
            warmup=None if warmup is None else warmup.reshape(per_copy)[:, 0],
            hidden=hidden.reshape(*per_copy, -1),
            condition=condition,
        )
        return int(done.sum())

    def _copies_done(self, dones: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Return which copies' episodes ended, of ``dones`` (S,)."""
        per_copy = dones.reshape(self._layout.num_copies, -1)
        done = per_copy[:, 0]
        if dones.any() and not (per_copy == done[:, None]).all():
            raise InputError(
                "the individuals of a copy ended at different steps: an episode must end for all "
                "of its slots together"
            )
        return done
