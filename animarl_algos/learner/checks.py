"""What a learner's settings may be, and what is refused before anything is made."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from stable_baselines3.common.type_aliases import TrainFrequencyUnit

from animarl_algos.learner.exploration import Exploration, LinearDecay
from animarl_algos.learner.offline_settings import OfflineSettings
from animarl_algos.learner.recorder import check_environment
from animarl_algos.learner.settings import as_frequency
from animarl_algos.losses.terms import WEIGHTS, OfflineLoss, Phase
from animarl_algos.ranges import (
    COUNT,
    COUNT_OR_NONE,
    NOT_NEGATIVE,
    POSITIVE,
    SEED,
    SHARE,
    WHOLE,
    Range,
    refuse_unknown,
)
from animarl_algos.replay.sequence_buffer import SequenceReplayBuffer
from animarl_algos.replay.state_mode import StateMode
from animarl_envs.errors import InputError

if TYPE_CHECKING:
    from animarl_algos.learner.algorithm import SequenceQLearning

LEARNER = {
    "buffer_size": COUNT,
    "batch_size": COUNT,
    "offline_batch_size": COUNT,
    "learning_starts": WHOLE,
    "gradient_steps": Range(least=-1, whole=True),
    "updates_per_episode": NOT_NEGATIVE,
    "tau": SHARE,
    "n_steps": COUNT,
    "offline_learning_rate": POSITIVE,
    "exploration_fraction": replace(SHARE, optional=True),
    "sequence_length": COUNT_OR_NONE,
    "burn_in": WHOLE,
    "max_episode_steps": COUNT_OR_NONE,
    "offline_epochs": WHOLE,
    "offline_patience": COUNT_OR_NONE,
    "_stats_window_size": COUNT,
    "seed": replace(SEED, optional=True),
}
"""Settings of :class:`.algorithm.SequenceQLearning`, beside those of its phases."""
SET_BY_LEARNER = {
    "observation_space", "action_space", "lr_schedule", "individuals", "condition_flag",
    "treatment_head", "buffer_size", "observation_dim", "num_individuals", "num_actions",
    "max_episode_steps", "sequence_length", "burn_in", "state_mode", "state_size", "prioritized",
    "seed", "names", "device", "num_copies", "epsilon", "acting",
}  # fmt: skip
"""Arguments of the policy and the replay memory that come from elsewhere than their ``kwargs``."""


def phase_of(model: SequenceQLearning, name: str) -> Phase:
    """The numbers of the ``"online"`` or ``"offline"`` phase, checked."""
    prefix = "" if name == "online" else "offline_"
    own = {"gamma", "max_grad_norm", *WEIGHTS} - {"lambda1"}  # of which there is one for both
    settings = {key: getattr(model, prefix + key) for key in own}
    scaled = name == "offline" and model.offline_scaled_penalties
    steps = model.n_steps if name == "online" else 1
    return Phase(
        name=name, lambda1=model.lambda1, scaled_penalties=scaled, n_steps=steps, **settings
    )


def refuse_bad_settings(model: SequenceQLearning) -> None:
    """Before anything is made; whole numbers become ints.

    Raises
    ------
    InputError
        If a setting is out of its range.
    """
    for name, numbers in LEARNER.items():
        setattr(model, name, numbers.check(name.lstrip("_"), getattr(model, name)))
    rate = model.learning_rate
    if callable(rate):
        NOT_NEGATIVE.check("learning_rate at the start", rate(1.0))
    else:
        POSITIVE.check("learning_rate", rate)
    if model.exploration not in list(Exploration):
        raise InputError(f"exploration is {model.exploration!r}: choose {' or '.join(Exploration)}")
    if model.offline_loss not in list(OfflineLoss):
        raise InputError(
            f"offline_loss is {model.offline_loss!r}: choose {' or '.join(OfflineLoss)}"
        )
    LinearDecay(model.exploration_initial_eps, model.exploration_final_eps, model.exploration_steps)
    for phase in ("online", "offline"):
        phase_of(model, phase)
    model.offline_settings = OfflineSettings.of(model.offline_kwargs)
    refuse_unknown("policy_kwargs", model.policy_kwargs, model.policy_class, SET_BY_LEARNER)
    refuse_unknown(
        "replay_buffer_kwargs", model.replay_buffer_kwargs, SequenceReplayBuffer, SET_BY_LEARNER
    )
    if model.gradient_steps == 0:
        raise InputError("gradient_steps is 0: give at least 1, or -1 for as many as steps")


def refuse_what_does_not_go_together(model: SequenceQLearning) -> None:
    """Of a new learner; one that was saved acts and learns as it did.

    Raises
    ------
    InputError
        If one setting makes another useless.
    """
    frequency = as_frequency(model.train_freq, "train_freq")
    if frequency.unit is TrainFrequencyUnit.EPISODE and model.gradient_steps != 1:
        raise InputError(
            f"gradient_steps is {model.gradient_steps} and train_freq counts episodes: "
            "give updates_per_episode instead, or a train_freq in steps"
        )
    forgetful = model.burn_in == 0 and model.state_mode != StateMode.STORED
    if model.policy_class.recurrent and model.sequence_length == 1 and forgetful:
        raise InputError(
            "sequence_length is 1 and the policy has a memory, which learns nothing from "
            "single steps: give longer pieces, a burn_in, state_mode 'stored', or MlpPolicy"
        )
    if model.sequence_length is not None and model.n_steps > model.sequence_length - model.burn_in:
        raise InputError(
            f"n_steps is {model.n_steps} and {model.sequence_length - model.burn_in} steps of a "
            "sequence are learned from: give a longer sequence_length, or fewer n_steps"
        )
    quantiles = model.policy_kwargs.get("n_quantiles")
    if (quantiles is not None) != model.quantiles:
        raise InputError(
            f"policy_kwargs: n_quantiles is {quantiles!r}: only the learners on quantiles have "
            "it, and they need it: choose another class"
        )
    if model.recipe.inverse and model.exploration != Exploration.BOLTZMANN:
        raise InputError(
            f"exploration is {model.exploration!r} and recipe {model.recipe.name} learns from "
            "steps that its policy samples: set it to 'boltzmann'"
        )
    if model.offline_epochs and not model.recipe.offline:
        raise InputError(
            f"recipe {model.recipe.name} learns without demonstrations: set offline_epochs to 0"
        )
    if not model.offline_epochs and not model.recipe.online:
        raise InputError(
            f"recipe {model.recipe.name} learns from demonstrations alone: give offline_epochs"
        )


def needs_demonstrations(model: SequenceQLearning) -> bool:
    """Whether what is still to be done looks at demonstrations."""
    pretraining = model.offline_epochs > 0 and not model.offline_progress.done
    return model.recipe.inverse or pretraining


def refuse_what_cannot_be_learnt(model: SequenceQLearning) -> None:
    """Of the environment, as far as can be said without looking at its data.

    Raises
    ------
    InputError
        If it does not give what the recipe learns from.
    """
    assert model.env is not None
    check_environment(model.env, model.layout, model.recipe)
    if needs_demonstrations(model):
        refuse_without_demonstrations(model)


def refuse_without_demonstrations(model: SequenceQLearning) -> None:
    """Refuse to learn from demonstrations where neither learner nor environment has any.

    Raises
    ------
    InputError
        If there are none.
    """
    own = getattr(model.env, "offline_data", None)
    none_there = own is None or getattr(model.env, "demos", own) is None
    if model.demonstrations is None and none_there:
        raise InputError(
            f"recipe {model.recipe.name} learns from demonstrations and neither it nor its "
            "environment was given demonstrations: pass demonstrations="
        )
