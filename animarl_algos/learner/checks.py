"""What a learner refuses before it starts, and its settings in stable-baselines3's words."""

from collections.abc import Mapping
from typing import Any

import gymnasium as gym
from stable_baselines3.common.torch_layers import FlattenExtractor
from stable_baselines3.common.type_aliases import TrainFrequencyUnit
from stable_baselines3.common.vec_env import VecEnv
from torch import nn

from animarl_algos.data.vec_env import SlotLayout, declared
from animarl_algos.learner.settings import as_frequency
from animarl_algos.losses.terms import Recipe, ScoredActionsTemporalDifference
from animarl_algos.networks.networks import StackedQNetwork
from animarl_algos.replay.sequence_buffer import StateMode
from animarl_envs.errors import InputError


def check_setting_combinations(
    settings: Mapping[str, Any], recipe: Recipe, recurrent: bool, quantiles: bool
) -> None:
    """Refuse settings of a new learner of which one makes another useless.

    ``recurrent`` says whether the policy has a memory, ``quantiles`` whether values are quantiles
    of the return.
    """
    updates, epochs = settings["gradient_steps"], settings["offline_epochs"]
    frequency = as_frequency(settings["train_freq"])
    if updates == 0:
        raise InputError("gradient_steps is 0: give at least 1, or -1 for as many as steps")
    if frequency.unit is TrainFrequencyUnit.EPISODE and updates != 1:
        raise InputError(
            f"gradient_steps is {updates} and train_freq counts episodes: "
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
    if recipe.inverse and settings["exploration"] != "boltzmann":
        raise InputError(
            f"exploration is {settings['exploration']!r} and recipe {recipe.name} learns from "
            "steps that its policy samples: set it to 'boltzmann'"
        )
    if epochs and not recipe.offline:
        raise InputError(
            f"recipe {recipe.name} learns without demonstrations: set offline_epochs to 0"
        )
    if not epochs and not recipe.online:
        raise InputError(
            f"recipe {recipe.name} learns from demonstrations alone: give offline_epochs"
        )


def check_observation(space: gym.Space[Any]) -> None:
    """Refuse an observation that is no array of numbers."""
    if not isinstance(space, gym.spaces.Box):
        raise InputError(
            f"observations are {type(space).__name__} and the networks take numbers in a Box: wrap "
            "the environment in gymnasium.wrappers.FlattenObservation"
        )


def check_environment_supports(recipe: Recipe, env: VecEnv, layout: SlotLayout) -> None:
    """Refuse an environment that does not give what a recipe learns from."""
    given = declared(env, "feedback") or ()
    for needed, name, words in (
        (recipe.needs_distance, "dtw_penalty", "the distance to a demonstration"),
        (recipe.needs_alignment, "aligned_action", "aligned demonstrated actions"),
    ):
        if needed and name not in given:
            raise InputError(
                f"recipe {recipe.name} needs {words} and the environment declares none ({name!r} "
                "in its attribute feedback): learn in a SlotVecEnv with demonstrations, or wrap a "
                "single environment in the DTW reward"
            )
    if recipe.needs_condition and not layout.condition_flag:
        raise InputError(
            f"recipe {recipe.name} needs the condition flag as the last observation component and "
            "the environment has none: wrap it in the condition-flag wrapper"
        )


def check_demonstrations(data: Any, recipe: Recipe, network: StackedQNetwork, env: Any) -> None:
    """Refuse demonstrations of other individuals, another observation or other actions."""
    if not (hasattr(data, "train") and hasattr(data, "val")):
        raise InputError(
            f"demonstrations is a {type(data).__name__}: give Demonstrations, or an object with "
            "the datasets train and val"
        )
    for name, dataset in (("training", data.train), ("validation", data.val)):
        batch = next(iter(dataset.batches(1)), None)
        if batch is None:
            raise InputError(
                f"the {name} split holds no demonstrated episode: split the data again"
            )
        mine = (len(network.individuals), network.input_mean.shape[-1])
        theirs = (batch.num_individuals, batch.observations.shape[-1])
        if mine != theirs:
            raise InputError(
                f"the {name} demonstrations have {theirs[0]} individuals with {theirs[1]} "
                f"observation components, the environment {mine[0]} with {mine[1]}: make them for "
                "this environment, or ask gym.make for observation='full' and recorded=True"
            )
        known = getattr(dataset, "individuals", None)  # of this package's datasets, if named
        placed = getattr(env, "individuals", None)  # of a VecEnv of slots
        if isinstance(known, tuple) and placed is not None and known != tuple(placed):
            raise InputError(
                f"the {name} demonstrations are of {', '.join(known)}, the environment's "
                f"individuals are {', '.join(network.individuals)}: make them for this environment"
            )
        scored = batch.action_penalties
        highest = int(batch.actions.max()) if scored is None else scored.shape[-1] - 1
        if highest >= network.num_actions:
            raise InputError(
                f"the {name} demonstrations hold action {highest}, the environment has "
                f"{network.num_actions}: make them for this environment"
            )
        scores = any(isinstance(t, ScoredActionsTemporalDifference) for t in recipe.offline)
        if scores and scored is None:
            raise InputError(
                f"the {name} demonstrations carry no penalties of all actions, which "
                f"{recipe.name} learns from offline: make the dataset with the fitted dynamics of "
                "their species"
            )


AS_IT_IS = {
    "activation_fn": (
        nn.ReLU, "hidden layers are rectified here, so give torch.nn.ReLU or leave it out",
    ),
    "features_extractor_class": (
        FlattenExtractor,
        "observations are flattened here, so give FlattenExtractor, leave it out, or put the "
        "features into the observation with a wrapper",
    ),
    "features_extractor_kwargs": (None, "flattening takes none, so leave it out"),
}  # fmt: skip
"""Names of stable-baselines3 that may say what the networks do anyway, and why nothing else."""


def translate_policy_kwargs(policy_kwargs: Mapping[str, Any]) -> dict[str, Any]:
    """Return a table ``policy_kwargs`` without the names that only stable-baselines3 has.

    ``net_arch=[64, 64]`` becomes ``hidden=64, depth=2``: the layers that encode an observation, as
    many as are listed; the memory and the dueling head come on top. ``activation_fn=ReLU`` and
    ``features_extractor_class=FlattenExtractor`` are what the networks do anyway.
    """
    table = dict(policy_kwargs)
    layers = table.pop("net_arch", None)
    if layers is not None:
        both = [name for name in ("hidden", "depth") if name in table]
        if both:
            raise InputError(
                f"policy_kwargs: net_arch and {both[0]} say the same thing: give hidden and depth, "
                "or net_arch alone"
            )
        listed = isinstance(layers, list | tuple) and all(type(n) is int for n in layers)
        if not listed or len(set(layers)) != 1:
            raise InputError(
                f"policy_kwargs: net_arch is {layers!r}: all hidden layers are of one width here, "
                "so give a list such as [64, 64], or hidden=64 and depth=2"
            )
        table |= {"hidden": layers[0], "depth": len(layers)}
    for name, (usual, why) in AS_IT_IS.items():
        asked = table.pop(name, usual)
        if asked is not usual and asked != {}:
            shown = getattr(asked, "__name__", repr(asked))
            raise InputError(f"policy_kwargs: {name} is {shown}: {why}")
    return table
