"""What settings a learner has, and reading those that have more than one form."""

from __future__ import annotations

from typing import Any

import numpy as np
from stable_baselines3.common.type_aliases import TrainFreq, TrainFrequencyUnit
from stable_baselines3.common.utils import LinearSchedule
from stable_baselines3.common.vec_env import VecEnv

from animarl_algos.losses.terms import PhaseSettings
from animarl_algos.networks.policies import GruPolicy, MlpPolicy
from animarl_algos.ranges import COUNT, POSITIVE
from animarl_envs.errors import InputError

POLICIES = {"GruPolicy": GruPolicy, "MlpPolicy": MlpPolicy}
"""By their names in files and arguments."""


class LearnerSettings(PhaseSettings, total=False):
    """Keyword arguments of every learner; their defaults are preset ``default``'s.

    Parameters
    ----------
    offline_learning_rate
        Of Adam in the offline phase.
    buffer_size
        Replay memory [world steps]; whole episodes are evicted, oldest first.
    batch_size, offline_batch_size
        Sequences per individual and update.
    gamma, alpha, lambda1, lambda2, lambda3, max_grad_norm
        Of the online phase; see :class:`animarl_algos.losses.terms.Phase`. Those with
        ``offline_`` in front are the same of the offline phase. ``offline_scaled_penalties``
        measures the penalties of all actions in units of their mean instead of arena units, as in
        the paper.
    n_steps
        Rewards summed before the value of what follows, as far as the sequence goes on; online.
    tau
        Share of the online weights that a target update takes over.
    target_update_interval
        ``(n, "episode")``, ``(n, "step")`` or a number of steps; offline, every epoch.
    train_freq, gradient_steps
        ``(n, "episode")``: ``updates_per_episode`` updates for each finished episode, once n have
        finished; ``gradient_steps`` stays 1. ``(n, "step")`` or a number: ``gradient_steps``
        updates after n steps of each copy, or with -1 as many as steps were done in all copies.
    updates_per_episode
        May be fractional.
    learning_starts
        Steps acted at random before the first update.
    exploration
        ``"boltzmann"``: after an offline phase, actions are sampled at the temperatures under which
        the validation actions are likeliest, so that online collection acts as the policy acts.
        ``"epsilon"``, and without an offline phase: epsilon-greedy (the paper).
    exploration_initial_eps, exploration_final_eps, exploration_steps
        Epsilon, linear over this many steps, then constant; unused where actions are sampled.
        ``exploration_fraction`` gives the steps as a share of ``total_timesteps`` instead.
    sequence_length, burn_in, state_mode, prioritized, replay_buffer_kwargs
        See :class:`animarl_algos.replay.sequence_buffer.SequenceReplayBuffer`.
    standardise_inputs
        Whether the networks see observations centred and scaled by mean and sd of those that the
        memory holds at the first update (of random steps, with ``learning_starts``); where the
        offline phase has standardised them, that stays.
    max_episode_steps
        Longest episode; None: what the environment declares.
    offline_loss
        ``"recipe"``: the recipe's own offline terms. ``"cloning"``: cross-entropy of soft labels
        instead, after which the values of states, of which cloning says nothing, begin at 0.
    offline_epochs
        Epochs on the demonstrations before the first step in the environment; the best by
        validation is kept, for each individual its own. ``offline_patience`` stops after so many
        epochs without a better one.
    offline_kwargs
        How its minibatches are drawn and its steps taken, see
        :class:`animarl_algos.learner.offline_settings.OfflineSettings`.
    policy_kwargs
        See :class:`animarl_algos.networks.policies.GruPolicy`; stable-baselines3's ``net_arch`` and
        ``activation_fn`` as :mod:`animarl_algos.learner.sb3_compat` translates them. This table,
        ``offline_kwargs`` and ``replay_buffer_kwargs`` go over the preset's key by key; None
        empties them.
    stats_window_size
        Episodes in the means of the log.
    """

    buffer_size: int
    batch_size: int
    tau: float
    target_update_interval: int | tuple[int, str]
    train_freq: int | tuple[int, str]
    gradient_steps: int
    updates_per_episode: float
    learning_starts: int
    exploration: str
    exploration_initial_eps: float
    exploration_final_eps: float
    exploration_steps: int
    exploration_fraction: float | None
    sequence_length: int | None
    burn_in: int
    state_mode: str
    prioritized: bool
    standardise_inputs: bool
    replay_buffer_kwargs: dict[str, Any] | None
    max_episode_steps: int | None
    offline_loss: str
    offline_epochs: int | None
    offline_learning_rate: float
    offline_batch_size: int
    offline_patience: int | None
    offline_kwargs: dict[str, Any] | None
    policy_kwargs: dict[str, Any] | None
    stats_window_size: int


def as_frequency(value: Any, name: str) -> TrainFreq:
    """``(n, "step")``, ``(n, "episode")``, or ``n`` for steps.

    Raises
    ------
    InputError
        If it is neither.
    """
    if isinstance(value, TrainFreq):
        return value
    number, unit = value, "step"
    if isinstance(value, tuple | list) and len(value) == 2:
        number, unit = value
    if unit not in ("step", "episode") or not isinstance(number, int | float | np.number):
        raise InputError(
            f'{name} is {value!r}: give (n, "step"), (n, "episode") or a number of steps'
        )
    COUNT.check(name, number)
    return TrainFreq(int(number), TrainFrequencyUnit(unit))


def longest_episode(env: VecEnv | None, given: int | None) -> int | None:
    """The time limit [steps]: as ``given``, or as the environment declares it.

    Looked for are ``max_episode_steps`` or ``time_limit`` of the VecEnv or its environments, and
    the Gymnasium spec.

    Raises
    ------
    InputError
        If it declares none.
    """
    if given is not None or env is None:
        return given
    limit = declared_limit(env)
    if limit is None:
        raise InputError(
            "the environment does not say how long an episode can last: give max_episode_steps"
        )
    return limit


def declared_limit(env: VecEnv) -> int | None:
    """The time limit [steps] that an environment tells of itself, if any."""
    for name in ("max_episode_steps", "time_limit"):
        declared = getattr(env, name, None)
        if declared is None and env.has_attr(name):
            each = env.get_attr(name)
            declared = None if None in each else max(each)
        if declared is not None:
            return int(declared)
    specs = [spec for spec in env.get_attr("spec") if spec is not None]
    if specs and all(spec.max_episode_steps for spec in specs):
        return max(int(spec.max_episode_steps) for spec in specs)
    return None


def checked_value(key: str, value: Any, like: Any, place: str) -> Any:
    """A setting as plain data, of the kind of ``like``, the default of its parameter.

    Numbers may be written ``1e-4``, which YAML itself takes for text. A learning rate may be
    ``lin_1e-4``: linear to zero over the run, as in rl_zoo3.

    Raises
    ------
    InputError
        If the kind is another; the sentence starts with ``place``.
    """
    if isinstance(value, str):
        if key == "learning_rate" and value.startswith(LINEAR):
            linear_start(value, place)
            return value
        try:
            value = value if isinstance(like, str) else float(value)
        except ValueError:
            raise InputError(f"{place} is {value!r}: give a number, not text") from None
    if isinstance(like, bool):
        if not isinstance(value, bool):
            raise InputError(f"{place} is {value!r}: give true or false")
        return value
    if isinstance(like, int | float):
        if isinstance(value, bool) or not isinstance(value, int | float | None):
            raise InputError(f"{place} is {value!r}: give a number")
        if isinstance(like, int) and isinstance(value, float):
            if not value.is_integer():
                raise InputError(f"{place} is {value!r}: give a whole number")
            return int(value)
        if value is not None:
            return int(value) if isinstance(like, int) else float(value)
    if isinstance(like, str) and not isinstance(value, str):
        raise InputError(f"{place} is {value!r}: give a name")
    if key.endswith("kwargs") and not isinstance(value, dict | None):
        raise InputError(f"{place} is {value!r}: give a table")
    return value


LINEAR = "lin_"


def linear_start(value: str, place: str) -> float:
    """The first value of ``lin_<number>``."""
    try:
        start = float(value.removeprefix(LINEAR))
    except ValueError:
        raise InputError(f"{place} is {value!r}: write lin_ and a number") from None
    POSITIVE.check(f"{place}, the number after lin_,", start)
    return start


def linear_schedule(rate: str) -> LinearSchedule:
    """A rate ``lin_<number>`` as stable-baselines3 takes it: falling to zero over the run."""
    return LinearSchedule(linear_start(rate, "learning_rate"), 0.0, 1.0)
