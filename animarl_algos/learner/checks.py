"""Which settings of a learner go together, and which arguments its parts take."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from stable_baselines3.common.type_aliases import TrainFrequencyUnit

from animarl_algos.checked import refuse_unknown
from animarl_algos.learner.exploration import Exploration
from animarl_algos.learner.settings import as_frequency
from animarl_algos.losses.terms import Recipe
from animarl_algos.networks.policies import GruPolicy
from animarl_algos.replay.sequence_buffer import SequenceReplayBuffer, StateMode
from animarl_envs.errors import InputError

SET_BY_LEARNER = {
    "observation_space", "action_space", "lr_schedule", "individuals", "condition_flag",
    "treatment_head", "buffer_size", "observation_dim", "num_individuals", "num_actions",
    "max_episode_steps", "sequence_length", "burn_in", "state_mode", "state_size", "prioritized",
    "seed", "names", "device", "num_copies", "epsilon", "acting",
}  # fmt: skip
"""Arguments of the policy and the replay memory that come from elsewhere than their ``kwargs``."""


def check_arguments(settings: Mapping[str, Any], policy_class: type[GruPolicy]) -> None:
    """Refuse unknown arguments of the policy and of the replay memory.

    Raises
    ------
    InputError
        If one is unknown, or no update would be done.
    """
    for name, taker in (
        ("policy_kwargs", policy_class),
        ("replay_buffer_kwargs", SequenceReplayBuffer),
    ):
        refuse_unknown(name, settings[name], taker, SET_BY_LEARNER)
    if settings["gradient_steps"] == 0:
        raise InputError("gradient_steps is 0: give at least 1, or -1 for as many as steps")


def check_setting_combinations(
    settings: Mapping[str, Any], recipe: Recipe, recurrent: bool, quantiles: bool
) -> None:
    """Refuse settings of a new learner of which one makes another useless.

    Parameters
    ----------
    recurrent
        Whether the policy has a memory.
    quantiles
        Whether values are quantiles of the return.

    Raises
    ------
    InputError
        If there are any.
    """
    frequency = as_frequency(settings["train_freq"])
    if frequency.unit is TrainFrequencyUnit.EPISODE and settings["gradient_steps"] != 1:
        raise InputError(
            f"gradient_steps is {settings['gradient_steps']} and train_freq counts episodes: "
            "give updates_per_episode instead, or a train_freq in steps"
        )
    length, burn_in, n_steps = (settings[n] for n in ("sequence_length", "burn_in", "n_steps"))
    forgetful = burn_in == 0 and settings["state_mode"] != StateMode.STORED
    if recurrent and length == 1 and forgetful:
        raise InputError(
            "sequence_length is 1 and the policy has a memory, which learns nothing from "
            "single steps: give longer pieces, a burn_in, state_mode 'stored', or MlpPolicy"
        )
    if length is not None and n_steps > length - burn_in:
        raise InputError(
            f"n_steps is {n_steps} and {length - burn_in} steps of a sequence are learned from: "
            "give a longer sequence_length, or fewer n_steps"
        )
    given = settings["policy_kwargs"].get("n_quantiles")
    if (given is not None) != quantiles:
        raise InputError(
            f"policy_kwargs: n_quantiles is {given!r}: only the learners on quantiles have it, and "
            "they need it: choose another class"
        )
    if recipe.inverse and settings["exploration"] != Exploration.BOLTZMANN:
        raise InputError(
            f"exploration is {settings['exploration']!r} and recipe {recipe.name} learns from "
            "steps that its policy samples: set it to 'boltzmann'"
        )
    epochs = settings["offline_epochs"]
    if epochs and not recipe.offline:
        raise InputError(
            f"recipe {recipe.name} learns without demonstrations: set offline_epochs to 0"
        )
    if not epochs and not recipe.online:
        raise InputError(
            f"recipe {recipe.name} learns from demonstrations alone: give offline_epochs"
        )
