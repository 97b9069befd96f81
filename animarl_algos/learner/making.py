"""What a learner makes of its settings and its environment: the policy and the replay memory."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from animarl_algos.data.slots import SlotLayout, refuse_other_observation
from animarl_algos.learner.presets import constructor_settings
from animarl_algos.networks.acting_rule import Acting
from animarl_algos.networks.policies import GruPolicy
from animarl_algos.replay.sequence_buffer import SequenceReplayBuffer
from animarl_envs.errors import InputError

if TYPE_CHECKING:
    from animarl_algos.learner.algorithm import SequenceQLearning


def root_seed(seed: int | None) -> int:
    """The seed of a learner's own random streams; without ``seed``, from the system."""
    return int(np.random.SeedSequence().generate_state(1)[0]) if seed is None else int(seed)


def make_policy(model: SequenceQLearning) -> GruPolicy:
    """Networks and optimiser for the individuals of ``model``, acting as it does.

    Raises
    ------
    InputError
        If ``policy_kwargs`` do not suit.
    """
    kwargs = dict(model.policy_kwargs)
    if model.quantiles and "n_quantiles" not in kwargs:  # in zip files of older versions
        kwargs |= constructor_settings(model.preset, None, None, {})["policy_kwargs"]
    if "optimizer_class" not in kwargs:
        fused = {"fused": True}  # Adam's steps of all parameters in one call
        given = kwargs.get("optimizer_kwargs") or {}
        if not isinstance(given, dict):
            raise InputError(f"policy_kwargs: optimizer_kwargs is {given!r}: give a table")
        kwargs["optimizer_kwargs"] = fused | given
    policy: GruPolicy = model.policy_class(
        model.observation_space,
        model.action_space,
        model.lr_schedule,
        individuals=model.layout.individuals,
        condition_flag=model.layout.condition_flag,
        treatment_head=model.recipe.needs_condition and model.layout.condition_flag,
        seed=model.root_seed,
        **kwargs,
    ).to(model.device)
    policy.epsilon = model.exploration_rate
    if model.recipe.inverse:
        policy.temperature = 1.0
    if model.acting_rule:
        policy.acting = Acting.from_json(model.acting_rule)
    return policy


def make_replay_buffer(model: SequenceQLearning) -> SequenceReplayBuffer:
    """An empty replay memory for the episodes of the environment of ``model``."""
    assert model.episode_limit is not None
    return SequenceReplayBuffer(
        model.buffer_size,
        model.observation_size,
        model.layout.num_individuals,
        model.policy.num_actions,
        model.episode_limit,
        sequence_length=model.sequence_length,
        burn_in=model.burn_in,
        state_mode=model.state_mode,
        state_size=model.policy.q_net.units,
        prioritized=model.prioritized,
        seed=model.root_seed,
        names=model.layout.individuals,
        device=model.device,
        num_copies=model.layout.num_copies,
        **model.replay_buffer_kwargs,
    )


def refuse_other_slots(there: SlotLayout, here: SlotLayout) -> None:
    """Refuse the slots of an environment that are not those a learner was made for.

    Raises
    ------
    InputError
        If the names, the condition flag or what is observed differ.
    """
    if _described(there) != _described(here):
        raise InputError(
            f"the environment has {_described(there)}, this learner {_described(here)}: give "
            "one with the same individuals"
        )
    refuse_other_observation(here.observed, there.observed)


def _described(layout: SlotLayout) -> str:
    flag = "a" if layout.condition_flag else "no"
    return f"the individuals {', '.join(layout.individuals)} and {flag} condition flag"


def refuse_longer_episodes(limit: int | None, held: int | None) -> None:
    """Refuse episodes of up to ``limit`` steps where the replay memory holds ``held``.

    Raises
    ------
    InputError
        If they may be longer.
    """
    assert held is not None
    if limit is not None and limit > held:
        raise InputError(
            f"its episodes last up to {limit} steps and the replay memory holds "
            f"{held}: give one with a shorter time limit"
        )
