"""A step of the world on its way into the replay memory: by copy and individual, and checked."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from animarl_algos.losses.terms import Recipe
from animarl_algos.replay.sequence_buffer import SequenceReplayBuffer
from animarl_envs.array_types import Bools
from animarl_envs.errors import InputError

if TYPE_CHECKING:
    from animarl_algos.data.slot_layout import SlotLayout
    from animarl_algos.networks.policies import State


class Step(NamedTuple):
    """What a VecEnv returned for a step of all slots; ``feedback`` is what the learners declare."""

    observations: NDArray[Any]  # after it; where a slot is done, the next episode's first
    rewards: NDArray[Any]
    dones: Bools
    infos: list[dict[str, Any]]
    feedback: dict[str, NDArray[Any]]


def store_step(
    buffer: SequenceReplayBuffer,
    step: Step,
    before: NDArray[Any],
    memory: State,
    layout: SlotLayout,
    recipe: Recipe,
    alpha: float,
) -> None:
    """Store a step from the observation ``before`` it, with the memory that the policy had there.

    Raises InputError if the environment gave less than it declares, or ended the individuals of a
    copy at different steps.
    """
    dones, infos, feedback = step.dones, step.infos, step.feedback
    successors = step.observations.copy()
    for s in np.flatnonzero(dones):
        successors[s] = infos[s]["terminal_observation"]

    def by_copy(values: Any) -> Any:
        """Reshape (S, ...) to (copies, K, ...), if there are any."""
        shape = (layout.num_copies, layout.num_individuals, *np.shape(values)[1:])
        return None if values is None else np.reshape(values, shape)

    for name, needed in (
        ("dtw_penalty", recipe.needs_distance),
        ("aligned_action", recipe.needs_alignment),
    ):
        if needed and name not in feedback:
            raise InputError(f"the environment declares {name!r} and gave none with a step")
    done = by_copy(dones)[:, 0]
    if not (by_copy(dones) == done[:, None]).all():
        raise InputError(
            "the individuals of a copy ended at different steps: an episode must end for all "
            "of its slots together"
        )
    timed_out = by_copy([info.get("TimeLimit.truncated", False) for info in infos])
    truncated = done & timed_out[:, 0].astype(bool)
    observations = by_copy(np.asarray(before).reshape(len(dones), -1))
    warmup, condition = (by_copy(feedback.get(name)) for name in ("warmup", "condition"))
    if condition is None and layout.condition_flag:
        condition = observations[..., -1]
    buffer.add(
        observations=observations,
        actions=by_copy(feedback["executed"]),
        rewards=by_copy(_learned_rewards(step.rewards, feedback, recipe, alpha)),
        next_observations=by_copy(successors.reshape(len(dones), -1)),
        terminated=done & ~truncated,
        truncated=truncated,
        penalties=by_copy(feedback.get("dtw_penalty")),
        labels=by_copy(feedback.get("aligned_action")),
        warmup=None if warmup is None else warmup[:, 0],
        hidden=by_copy(memory[0]),
        condition=None if condition is None else condition[:, 0],
    )


def _learned_rewards(
    rewards: NDArray[Any], feedback: dict[str, NDArray[Any]], recipe: Recipe, alpha: float
) -> NDArray[Any]:
    """Return the rewards of a step, or the task's, if the recipe weighs the distance itself.

    Of the latter what is taken back after the recording's end is gone.
    """
    if not recipe.needs_distance or "task_reward" not in feedback:
        return rewards
    lasting = feedback["task_reward"]
    task = lasting - feedback.get("dtw_refund", 0.0)
    shaped = [task - weight * feedback["dtw_penalty"] for weight in (1.0, alpha)]
    if not any(np.allclose(rewards, each, atol=1e-4) for each in (lasting, *shaped)):
        raise InputError(
            "the reward of a step is neither the task's nor that less the distance: a wrapper "
            f"changed it, and recipe {recipe.name} would not learn from that: leave the "
            "wrapper out, or change the reward within the environment"
        )
    return task
