"""The settings of a learner: each with its type, default, range, unit and meaning, once.

The check of YAML files and of ``--set``, the constructor's defaults, ``help`` of a learner's class
and the tables of ``docs/learners.md`` are made from :class:`LearnerSettings`. An instance of it is
what a run records in ``settings.json`` and what a learner reads.
"""

from __future__ import annotations

import ast
import inspect
import math
from collections.abc import Mapping, Sequence
from contextlib import suppress
from copy import copy
from dataclasses import dataclass, field
from typing import Annotated, Any, Literal

from annotated_types import Ge, Gt, Le, Lt
from pydantic import AfterValidator, WithJsonSchema, WrapValidator
from stable_baselines3.common.torch_layers import FlattenExtractor
from stable_baselines3.common.type_aliases import TrainFreq, TrainFrequencyUnit
from stable_baselines3.common.utils import LinearSchedule
from torch import nn

from animarl_algos.losses.terms import Phase, Recipe
from animarl_algos.networks.policies import GruPolicy, MlpPolicy
from animarl_algos.replay.sequence_buffer import StateMode
from animarl_envs.errors import InputError
from animarl_envs.settings import (
    Checked,
    Count,
    CountOrZero,
    NotNegative,
    Positive,
    Probability,
    describe_fields,
    field_types,
    is_number,
)

POLICIES = {"GruPolicy": GruPolicy, "MlpPolicy": MlpPolicy}
"""By their names in files and arguments."""
LINEAR = "lin_"


def as_frequency(value: Any) -> TrainFreq:
    """Return ``(n, "step")``, ``(n, "episode")``, or ``n`` for steps, as stable-baselines3 has it.

    Raises InputError if it is neither.
    """
    number: Any = value
    unit: Any = "step"
    if isinstance(value, tuple | list) and len(value) == 2:
        number, unit = value
        unit = getattr(unit, "value", unit)
    if (
        unit not in ("step", "episode")
        or not is_number(number)
        or not 1 <= number < math.inf
        or number % 1
    ):
        raise InputError('give (n, "step"), (n, "episode") or a number n of steps, n at least 1')
    return TrainFreq(int(number), TrainFrequencyUnit(unit))


def _check_frequency(value: Any) -> Any:
    as_frequency(value)
    return value


def _check_rate(value: Any) -> Any:
    """Check a number, ``lin_<number>``, or a schedule of the remaining progress."""
    if isinstance(value, str) and value.startswith(LINEAR):
        linear_schedule(value)
        return value
    rate = value(1.0) if callable(value) else value
    if not is_number(rate) or not 0 <= rate < math.inf or (rate == 0 and not callable(value)):
        raise InputError("give a number above 0")
    return value if callable(value) else float(value)


def linear_schedule(rate: str) -> LinearSchedule:
    """Return ``lin_<number>`` as stable-baselines3 takes it: falling to zero over the run."""
    try:
        start = float(rate.removeprefix(LINEAR))
    except ValueError:
        raise InputError("write lin_ and a number") from None
    if not 0 < start < math.inf:
        raise InputError("write lin_ and a number above 0")
    return LinearSchedule(start, 0.0, 1.0)


Rate = Annotated[Any, AfterValidator(_check_rate), WithJsonSchema({"type": "number"})]
Frequency = Annotated[Any, AfterValidator(_check_frequency), WithJsonSchema({"type": "array"})]
Table = Annotated[
    dict[str, Any],
    WrapValidator(lambda table, check: None if table is None else check(table)),
]
"""A table; None in a file takes away what is below it, and is an empty one in settings."""
TABLES = ("offline_kwargs", "policy_kwargs", "replay_buffer_kwargs")
Share = Annotated[float, Gt(0), Le(1)]


@dataclass(frozen=True, kw_only=True)
class LearnerSettings(Checked):
    """All settings of a learner; the defaults hold where no preset sets another."""

    policy: Literal["GruPolicy", "MlpPolicy"] = "GruPolicy"
    """With a memory, or without."""
    learning_rate: Rate = 1e-4
    """Of Adam, online: a number, lin_<number> (linear to 0), or a schedule of what remains."""
    buffer_size: Count = 500_000
    """Replay memory [world steps]; whole episodes are evicted, oldest first."""
    batch_size: Count = 32
    """Sequences per individual and update, online."""
    gamma: Probability = 0.9
    """Discount per step."""
    n_steps: Count = 1
    """Rewards summed before the value of what follows, as far as the sequence goes on; online."""
    tau: Share = 1.0
    """Share of the online weights that a target update takes over."""
    target_update_interval: Frequency = (2000, "episode")
    """``(n, "episode")``, ``(n, "step")`` or a number of steps; offline, every epoch."""
    train_freq: Frequency = (1, "episode")
    """``(n, "episode")``: ``updates_per_episode`` updates for each finished episode, once n have
    finished; ``gradient_steps`` stays 1. ``(n, "step")`` or a number: ``gradient_steps`` updates
    after n steps of each copy, or with -1 as many as steps were done in all copies."""
    gradient_steps: Annotated[int, Ge(-1)] = 1
    """Updates after ``train_freq`` steps; -1: as many as steps."""
    updates_per_episode: NotNegative = 1.0
    """Updates for each finished episode; may be fractional."""
    learning_starts: CountOrZero = 0
    """Steps acted at random before the first update."""
    exploration: Literal["epsilon", "boltzmann"] = "epsilon"
    """``"boltzmann"``: after an offline phase, actions are sampled at the temperatures under which
    the validation actions are likeliest, so that online collection acts as the policy acts.
    ``"epsilon"``, and without an offline phase: epsilon-greedy (the paper)."""
    exploration_initial_eps: Probability = 0.5
    """Epsilon at the start; unused where actions are sampled."""
    exploration_final_eps: Probability = 0.3
    """Epsilon at the end, which it reaches linearly and then keeps."""
    exploration_steps: CountOrZero = 50_000
    """Steps over which epsilon falls."""
    exploration_fraction: Share | None = None
    """The same steps as a share of ``total_timesteps`` instead."""
    alpha: NotNegative = 1.0
    """Weight of the distance penalty in the reward, ``R - alpha * penalty``, online."""
    lambda1: NotNegative = 1e-5
    """Weight of the squared l2 norm of the weights, in both phases."""
    lambda2: NotNegative = 1.0
    """Weight of the treatment cross-entropy, online."""
    lambda3: NotNegative = 10.0
    """Weight of the action supervision, online."""
    max_grad_norm: Positive | None = 10.0
    """Largest gradient norm of one individual, online; None does not clip."""
    sequence_length: Count | None = None
    """Steps of the sequences that are learned from; None: whole episodes. This and the four that
    follow: :class:`animarl_algos.replay.sequence_buffer.SequenceReplayBuffer`."""
    burn_in: CountOrZero = 0
    """First steps of a sequence, which only rebuild the memory."""
    state_mode: str = "recompute"
    """Where the memory at the start of a sequence comes from."""
    prioritized: bool = True
    """Whether sequences are drawn by their temporal difference errors."""
    replay_buffer_kwargs: Table = field(default_factory=dict)
    """Further arguments of the replay memory."""
    standardise_inputs: bool = False
    """Whether the networks see observations centred and scaled by mean and sd of those that the
    memory holds at the first update (of random steps, with ``learning_starts``); where the offline
    phase has standardised them, that stays."""
    max_episode_steps: Count | None = None
    """Longest episode [steps]; None: what the environment declares."""
    offline_loss: Literal["recipe", "cloning"] = "recipe"
    """``"recipe"``: the recipe's own offline terms. ``"cloning"``: cross-entropy of soft labels
    instead, after which the values of states, of which cloning says nothing, begin at 0."""
    offline_epochs: CountOrZero = 0
    """Epochs on the demonstrations before the first step in the environment; the best by validation
    is kept, for each individual its own."""
    offline_learning_rate: Positive = 1e-4
    """Of Adam in the offline phase."""
    offline_batch_size: Count = 16
    """Sequences per individual and update, offline."""
    offline_gamma: Probability = 0.99
    """Discount per step, offline."""
    offline_alpha: NotNegative = 10.0
    """Weight of the distance penalty, offline."""
    offline_scaled_penalties: bool = False
    """Whether the penalties of all actions are measured in units of their mean instead of arena
    units (the paper), offline."""
    offline_lambda2: NotNegative = 10.0
    """Weight of the treatment cross-entropy, offline."""
    offline_lambda3: NotNegative = 50.0
    """Weight of the action supervision, offline."""
    offline_max_grad_norm: Positive | None = 20.0
    """Largest gradient norm of one individual, offline; None does not clip."""
    offline_patience: Count | None = None
    """Epochs without a better one after which the offline phase stops."""
    offline_kwargs: Table = field(default_factory=dict)
    """How the offline phase draws its minibatches and takes its steps, see
    :class:`OfflineSettings`."""
    policy_kwargs: Table = field(default_factory=dict)
    """See :class:`animarl_algos.networks.policies.GruPolicy`; stable-baselines3's ``net_arch`` and
    ``activation_fn`` are translated. This table, ``offline_kwargs`` and ``replay_buffer_kwargs`` go
    over the preset's key by key; None empties them."""
    stats_window_size: Count = 100
    """Episodes in the means of the log."""

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in TABLES:
            object.__setattr__(self, name, getattr(self, name) or {})

    @property
    def offline(self) -> OfflineSettings:
        """The settings in ``offline_kwargs``."""
        return OfflineSettings.of(self.offline_kwargs, "offline_kwargs: ")

    def sb3_arguments(self) -> dict[str, Any]:
        """Return the arguments of stable-baselines3's constructor."""
        rate = self.learning_rate
        schedule = linear_schedule(rate) if isinstance(rate, str) else rate
        # copies, because sb3-contrib adds an optimiser to its own
        arguments = {name: copy(getattr(self, name)) for name in SB3_ARGUMENTS}
        return arguments | {"learning_rate": schedule}

    def phase(self, name: str) -> Phase:
        """Return the numbers of the ``"online"`` or ``"offline"`` phase."""
        if name == "online":
            return Phase(
                name=name,
                gamma=self.gamma,
                alpha=self.alpha,
                lambda1=self.lambda1,
                lambda2=self.lambda2,
                lambda3=self.lambda3,
                max_grad_norm=self.max_grad_norm,
                n_steps=self.n_steps,
            )
        return Phase(
            name=name,
            gamma=self.offline_gamma,
            alpha=self.offline_alpha,
            lambda1=self.lambda1,
            lambda2=self.offline_lambda2,
            lambda3=self.offline_lambda3,
            max_grad_norm=self.offline_max_grad_norm,
            scaled_penalties=self.offline_scaled_penalties,
        )


def document_parameters(own: str | None, base: str | None) -> str:
    """Return a recipe's documentation with all parameters of its learner, for ``help``."""
    own, base = inspect.cleandoc(own or ""), inspect.cleandoc(base or "")
    if "Parameters\n---" in own:
        return own
    parameters = base.partition("Parameters\n")[2].partition("\n\nAttributes")[0]
    prose = [
        f"{name}\n    {meaning}"
        for name, meaning in describe_fields(LearnerSettings).items()
        if name not in ("policy", "learning_rate")
    ]
    return "\n".join([own, "", "Parameters", parameters, *prose])


SB3_ARGUMENTS = (
    "buffer_size",
    "learning_starts",
    "batch_size",
    "tau",
    "gamma",
    "train_freq",
    "gradient_steps",
    "replay_buffer_kwargs",
    "target_update_interval",
    "exploration_initial_eps",
    "exploration_final_eps",
    "exploration_fraction",
    "max_grad_norm",
    "stats_window_size",
    "policy_kwargs",
)
"""Settings that stable-baselines3's constructor takes and keeps as attributes."""


def take_settings(attributes: dict[str, Any], settings: LearnerSettings) -> LearnerSettings:
    """Return the settings of a learner with those that stand among its ``attributes``.

    stable-baselines3's ``load`` puts those there that it is given, and files of earlier versions
    hold all of them so. Those that are no attributes of its own are taken away.
    """
    changes = {name: attributes[name] for name in SB3_ARGUMENTS if name in attributes}
    for name in field_types(LearnerSettings):
        if name not in (*SB3_ARGUMENTS, "policy", "learning_rate") and name in attributes:
            changes[name] = attributes.pop(name)
    changes["policy"] = policy_name(attributes["policy_class"])
    if isinstance(frequency := changes["train_freq"], TrainFreq):
        changes["train_freq"] = (frequency.frequency, frequency.unit.value)
    rate = attributes["learning_rate"]
    if not (isinstance(settings.learning_rate, str) and isinstance(rate, LinearSchedule)):
        changes["learning_rate"] = rate
    return settings.changed(**changes)


def policy_name(policy: Any) -> Any:
    """Return the name of a policy class, or whatever else was given."""
    if not isinstance(policy, type):
        return policy
    return "GruPolicy" if getattr(policy, "recurrent", False) else "MlpPolicy"


@dataclass(frozen=True, kw_only=True)
class OfflineSettings(Checked):
    """Settings of the offline phase beside its length, rate and loss; the defaults are the paper's.

    Raises InputError if a number is out of its range, or one makes another useless.
    """

    sequence_length: Count | None = None
    """None: minibatches of whole episodes, each once an epoch. A number: of windows of so many
    steps, drawn independently with replacement; 1 for networks without a memory."""
    burn_in: CountOrZero = 0
    """Steps before each window that only rebuild the memory."""
    updates_per_epoch: Count | None = None
    """Updates between two looks at the validation split; None: one pass over the steps. The
    offline phase is ``offline_epochs`` times as long."""
    passes_per_epoch: Positive | None = None
    """With ``updates_per_epoch``: no more of them than are so many passes over the steps. Few
    demonstrations are known by heart before many updates are over."""
    warm_up: CountOrZero = 0
    """Updates over which the learning rate rises linearly to ``offline_learning_rate``."""
    anneal: bool = False
    """Whether it then falls to 0 over the whole phase, as half a cosine (Loshchilov & Hutter
    2017)."""
    weight_decay: NotNegative = 0.0
    """Share of each weight that an update takes away, per unit of the learning rate (decoupled, as
    in AdamW: Loshchilov & Hutter 2019)."""
    average: Annotated[float, Ge(0), Lt(1)] = 0.0
    """Largest decay d of the moving average of the weights, ``min(d, (1 + t) / (10 + t))`` after t
    updates, which then is what is validated, kept and used; 0: the weights themselves."""
    standardise: bool = False
    """Whether observations are standardised by the mean and sd of the training split within the
    network."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.sequence_length is None and (self.burn_in or self.updates_per_epoch):
            raise InputError(
                "burn_in and updates_per_epoch are for windows: give sequence_length, or leave "
                "them out for whole episodes"
            )
        if self.passes_per_epoch is not None and self.updates_per_epoch is None:
            raise InputError("passes_per_epoch limits updates_per_epoch: give both, or neither")

    def updates(self, steps: int, batch_size: int) -> int:
        """Return the updates of an epoch with minibatches of windows of so many steps."""
        assert self.sequence_length is not None
        whole_pass = steps / (batch_size * self.sequence_length)
        updates = whole_pass if self.updates_per_epoch is None else self.updates_per_epoch
        if self.passes_per_epoch is not None:
            updates = min(updates, self.passes_per_epoch * whole_pass)
        return max(1, round(updates))

    def rate_factor(self, update: int, updates: int) -> float:
        """Return the factor of the learning rate at an update (the first is 0) of so many."""
        factor = min(1.0, (update + 1) / self.warm_up) if self.warm_up else 1.0
        if self.anneal:
            factor *= 0.5 * (1.0 + math.cos(math.pi * update / updates))
        return factor


@dataclass(frozen=True, kw_only=True)
class LearnerFile(LearnerSettings):
    """Settings that a section of a file of ``zoo_configs`` may have.

    Numbers may be written ``1e-4``, which YAML takes for text, and tables as rl_zoo3 writes them,
    ``"dict(net_arch=[64, 64])"``; literals alone are read, nothing is evaluated.
    """

    n_timesteps: Count = 1
    """Steps of the world."""
    n_envs: Count = 1
    """Copies of the world."""
    env_kwargs: Table = field(default_factory=dict)
    """Options of the training environment."""

    @classmethod
    def check(cls, given: Mapping[str, Any], place: str = "") -> dict[str, Any]:
        """Return ``given`` with every value checked, texts of numbers and tables read."""
        return super().check({name: _read_text(value) for name, value in given.items()}, place)


def _read_text(value: Any) -> Any:
    """Return the number or the table that a text holds, any other value as it is."""
    if not isinstance(value, str):
        return value
    with suppress(ValueError):
        return float(value)
    with suppress(ValueError, SyntaxError):
        call = ast.parse(value, mode="eval").body
        if value.startswith("dict(") and isinstance(call, ast.Call) and not call.args:
            return {str(k.arg): ast.literal_eval(k.value) for k in call.keywords}
    return value


RUN_KEYS = ("n_timesteps", "n_envs", "env_kwargs")
"""What a file says beside the learner's arguments."""


# -- combinations ---------------------------------------------------------------------------------


def check_setting_combinations(
    settings: LearnerSettings, recipe: Recipe, recurrent: bool, quantiles: bool
) -> None:
    """Refuse settings of a new learner of which one makes another useless.

    ``recurrent`` says whether the policy has a memory, ``quantiles`` whether values are quantiles
    of the return.
    """
    _ = settings.offline  # which refuses its own combinations
    updates, epochs = settings.gradient_steps, settings.offline_epochs
    frequency = as_frequency(settings.train_freq)
    if updates == 0:
        raise InputError("gradient_steps is 0: give at least 1, or -1 for as many as steps")
    if frequency.unit is TrainFrequencyUnit.EPISODE and updates != 1:
        raise InputError(
            f"gradient_steps is {updates} and train_freq counts episodes: "
            "give updates_per_episode instead, or a train_freq in steps"
        )
    length, burn_in, n_steps = settings.sequence_length, settings.burn_in, settings.n_steps
    forgetful = burn_in == 0 and settings.state_mode != StateMode.STORED
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
    given = settings.policy_kwargs.get("n_quantiles")
    if (given is not None) != quantiles:
        raise InputError(
            f"policy_kwargs: n_quantiles is {given!r}: only the learners on quantiles have it, and "
            "they need it: choose another class"
        )
    if epochs and not recipe.offline:
        raise InputError(
            f"recipe {recipe.name} learns without demonstrations: set offline_epochs to 0"
        )
    if not epochs and not recipe.online:
        raise InputError(
            f"recipe {recipe.name} learns from demonstrations alone: give offline_epochs"
        )


SB3_NAMES_WITH_FIXED_VALUE = {
    "activation_fn": (
        nn.ReLU,
        "hidden layers are rectified here, so give torch.nn.ReLU or leave it out",
    ),
    "features_extractor_class": (
        FlattenExtractor,
        "observations are flattened here, so give FlattenExtractor, leave it out, or put the "
        "features into the observation with a wrapper",
    ),
    "features_extractor_kwargs": (None, "flattening takes none, so leave it out"),
}
"""Names of stable-baselines3 that may say what the networks do anyway, and why nothing else."""


SB3_ORDER = (
    *("buffer_size", "learning_starts", "batch_size", "tau", "gamma", "train_freq"),
    "gradient_steps",
)
"""Settings that stable-baselines3 takes without their names, after the learning rate."""
UNSET_IS_NONE = ("policy", "learning_rate", "offline_epochs")
"""Settings whose value None stands for the preset's."""
SB3_FIXED_ARGUMENTS = {
    "optimize_memory_usage": (False, "episodes are stored once, without their next observations"),
    "replay_buffer_class": (
        None,
        "the replay memory is one of sequences, see replay_buffer_kwargs",
    ),
    "monitor_wrapper": (True, "episodes are always monitored"),
}


def translate_sb3_arguments(unnamed: Sequence[Any], given: Mapping[str, Any]) -> dict[str, Any]:
    """Return settings by name, without arguments of stable-baselines3 that ask for the usual.

    ``unnamed`` are in stable-baselines3's order (:data:`SB3_ORDER`).

    Raises InputError if there are too many, one is given twice, or one cannot be what is asked for.
    """
    named = dict(zip(SB3_ORDER, unnamed))
    if len(unnamed) > len(SB3_ORDER):
        raise InputError(
            f"{len(unnamed)} settings have no name: only {', '.join(SB3_ORDER)} may follow the "
            "learning rate without one"
        )
    if twice := sorted(named.keys() & given.keys()):
        raise InputError(f"setting {twice[0]!r} is given twice: by its place and by its name")
    settings = named | dict(given)
    for name in UNSET_IS_NONE:
        if settings.get(name, ...) is None:
            del settings[name]
    if isinstance(table := settings.get("policy_kwargs"), dict):
        settings["policy_kwargs"] = translate_policy_kwargs(table)
    for name, (usual, why) in SB3_FIXED_ARGUMENTS.items():
        if settings.get(name, usual) == usual:
            settings.pop(name, None)
        else:
            raise InputError(f"{name} is {settings[name]!r}: {why}; leave it out")
    return settings


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
    for name, (usual, why) in SB3_NAMES_WITH_FIXED_VALUE.items():
        value = table.pop(name, usual)
        if value is not usual and value != {}:
            text = getattr(value, "__name__", repr(value))
            raise InputError(f"policy_kwargs: {name} is {text}: {why}")
    return table
