"""Recurrent double Q-learning on sequences, as an extension of stable-baselines3.

:class:`SequenceQLearning` turns an SB3 off-policy algorithm (DQN, or QRDQN of sb3-contrib) into a
learner with a memory: K individuals, each with its own network, acting in the slots of a VecEnv and
learning from whole episodes or pieces of them. What the loss is made of is the recipe's business
(:mod:`animarl_algos.losses.terms`); how values are represented is the value distribution's.
"""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np
import torch
from gymnasium.spaces import Discrete
from numpy.typing import NDArray
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.policies import BasePolicy
from stable_baselines3.common.type_aliases import GymEnv, Schedule
from stable_baselines3.common.utils import configure_logger

from animarl_algos.data.slots import SlotLayout, refuse_other_actions
from animarl_algos.learner.checked import CheckedLearner
from animarl_algos.learner.exploration import fit_boltzmann_temperature
from animarl_algos.learner.offline import (
    DemonstrationData,
    OfflineDataset,
    OfflineProgress,
    refuse_foreign,
    run_offline_phase,
)
from animarl_algos.learner.recorder import check_environment
from animarl_algos.learner.settings import as_frequency, declared_limit, longest_episode
from animarl_algos.learner.validation import demonstrated_values
from animarl_algos.networks.acting_rule import Acting
from animarl_algos.networks.policies import GruPolicy, MlpPolicy
from animarl_algos.replay.sequence_buffer import SequenceReplayBuffer
from animarl_envs.errors import InputError

PAPER_EPOCHS = 30


class SequenceQLearning(CheckedLearner):
    """Sequence Q-learning for K independent individuals; see the recipes for what is minimised.

    Steps are steps of the world: one step of all slots of a copy counts once.

    Parameters
    ----------
    policy
        ``"GruPolicy"`` (with a memory) or ``"MlpPolicy"``.
    env
        Any Gymnasium environment with Discrete actions, or a VecEnv; one with the attributes
        ``individuals`` and ``num_copies`` trains all individuals.
    demonstrations
        Object with ``train`` and ``val`` datasets; by default the environment's own, if it has any.
    learning_rate, offline_learning_rate
        Of Adam, a number or (online) a schedule of the remaining progress.
    buffer_size
        Replay memory [world steps]; whole episodes are evicted, oldest first.
    batch_size, offline_batch_size
        Sequences per individual and update.
    gamma, alpha, lambda1, lambda2, lambda3, max_grad_norm
        Of the online phase; see :class:`animarl_algos.losses.terms.Phase`. Those with
        ``offline_`` in front are the same of the offline phase. ``offline_scaled_penalties``
        measures the penalties of all actions in units of their mean instead of arena units, as in
        the paper.
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
    exploration_initial_eps, exploration_final_eps, exploration_steps
        Epsilon, linear over this many steps, then constant. ``exploration_fraction`` gives the
        steps as a share of ``total_timesteps`` instead.
    sequence_length, burn_in, state_mode, prioritized, replay_buffer_kwargs
        See :class:`animarl_algos.replay.sequence_buffer.SequenceReplayBuffer`.
    max_episode_steps
        Longest episode; by default what the environment declares.
    offline_epochs
        Epochs on the demonstrations before the first step in the environment, by default none, or
        the paper's 30 where a recipe learns from demonstrations alone; the best by validation is
        kept, for each individual its own. ``offline_patience`` stops after so many epochs without a
        better one. How its minibatches are drawn and its steps taken is ``offline_kwargs``, see
        :class:`animarl_algos.learner.offline_settings.OfflineSettings`.

    Raises
    ------
    InputError
        If a setting, the environment or the demonstrations do not suit the recipe.
    """

    policy_aliases: ClassVar[dict[str, type[BasePolicy]]] = {
        "GruPolicy": GruPolicy,
        "MlpPolicy": MlpPolicy,
    }

    def __init__(
        self,
        policy: str | type[GruPolicy] = "GruPolicy",
        env: GymEnv | str | None = None,
        *,
        demonstrations: DemonstrationData | None = None,
        learning_rate: float | Schedule = 1e-4,
        buffer_size: int = 500_000,
        batch_size: int = 32,
        gamma: float = 0.9,
        tau: float = 1.0,
        target_update_interval: int | tuple[int, str] = (2000, "episode"),
        train_freq: int | tuple[int, str] = (1, "episode"),
        gradient_steps: int = 1,
        updates_per_episode: float = 1.0,
        learning_starts: int = 0,
        exploration_initial_eps: float = 0.5,
        exploration_final_eps: float = 0.3,
        exploration_steps: int = 50_000,
        exploration_fraction: float | None = None,
        alpha: float = 1.0,
        lambda1: float = 1e-5,
        lambda2: float = 1.0,
        lambda3: float = 10.0,
        max_grad_norm: float | None = 10.0,
        sequence_length: int | None = None,
        burn_in: int = 0,
        state_mode: str = "recompute",
        prioritized: bool = True,
        replay_buffer_kwargs: dict[str, Any] | None = None,
        max_episode_steps: int | None = None,
        offline_epochs: int | None = None,
        offline_learning_rate: float = 1e-4,
        offline_batch_size: int = 16,
        offline_gamma: float = 0.99,
        offline_alpha: float = 10.0,
        offline_scaled_penalties: bool = False,
        offline_lambda2: float = 10.0,
        offline_lambda3: float = 50.0,
        offline_max_grad_norm: float | None = 20.0,
        offline_patience: int | None = None,
        offline_kwargs: dict[str, Any] | None = None,
        policy_kwargs: dict[str, Any] | None = None,
        stats_window_size: int = 100,
        tensorboard_log: str | None = None,
        verbose: int = 0,
        seed: int | None = None,
        device: torch.device | str = "auto",
        _init_setup_model: bool = True,
    ) -> None:
        if policy not in self.policy_aliases and isinstance(policy, str):
            raise InputError(
                f"policy {policy!r} is unknown: choose {' or '.join(self.policy_aliases)}"
            )
        arguments: dict[str, Any] = {
            "learning_rate": learning_rate,
            "buffer_size": buffer_size,
            "learning_starts": learning_starts,
            "batch_size": batch_size,
            "tau": tau,
            "gamma": gamma,
            "train_freq": train_freq,
            "gradient_steps": gradient_steps,
            "replay_buffer_kwargs": replay_buffer_kwargs,
            "stats_window_size": stats_window_size,
            "tensorboard_log": tensorboard_log,
            "policy_kwargs": dict(policy_kwargs or {}),
            "verbose": verbose,
            "seed": seed,
            "device": device,
            "_init_setup_model": False,
        }
        if env is None and _init_setup_model:
            raise InputError("there is no environment to learn in: give env=")
        try:
            super().__init__(policy, env, **arguments)  # type: ignore[arg-type]
        except AssertionError as error:
            raise InputError(f"the environment does not suit these learners: {error}") from error
        self.policy_kwargs = dict(policy_kwargs or {})  # sb3-contrib adds an optimiser of its own
        self.demonstrations = demonstrations
        self.target_update_interval = target_update_interval
        self.updates_per_episode = updates_per_episode
        self.exploration_initial_eps = exploration_initial_eps
        self.exploration_final_eps = exploration_final_eps
        self.exploration_steps = exploration_steps
        self.exploration_fraction = exploration_fraction
        self.exploration_rate = exploration_initial_eps
        self.alpha = alpha
        self.lambda1, self.lambda2, self.lambda3 = lambda1, lambda2, lambda3
        self.max_grad_norm = max_grad_norm
        self.sequence_length, self.burn_in, self.state_mode = sequence_length, burn_in, state_mode
        self.prioritized = prioritized
        self.max_episode_steps = max_episode_steps
        if offline_epochs is None:
            offline_epochs = 0 if self.recipe.online else PAPER_EPOCHS
        self.offline_epochs = offline_epochs
        self.offline_learning_rate = offline_learning_rate
        self.offline_batch_size = offline_batch_size
        self.offline_gamma, self.offline_alpha = offline_gamma, offline_alpha
        self.offline_scaled_penalties = offline_scaled_penalties
        self.offline_lambda2, self.offline_lambda3 = offline_lambda2, offline_lambda3
        self.offline_max_grad_norm = offline_max_grad_norm
        self.offline_patience = offline_patience
        self.offline_kwargs = dict(offline_kwargs or {})
        self.offline_progress = OfflineProgress()
        self.best_weights = self.average_weights = None
        self.layout = SlotLayout(1, ("agent",), condition_flag=False)
        self._updates_due = 0.0
        self._target_count = 0
        self._rollout_steps = self._rollout_episodes = 0
        self.acting_rule = {}
        if _init_setup_model:
            self.refuse_what_does_not_go_together()
            self._setup_model()

    # -- set up -----------------------------------------------------------------------------------

    def _setup_model(self) -> None:
        self.train_freq = as_frequency(self.train_freq, "train_freq")  # type: ignore[assignment]
        self.refuse_bad_settings()
        self._setup_lr_schedule()
        self.set_random_seed(self.seed)
        if self.env is not None:
            self.layout = SlotLayout.of(self.env)
            self.episode_limit = longest_episode(self.env, self.max_episode_steps)
        self.target_update = as_frequency(self.target_update_interval, "target_update_interval")
        self.root_seed = self._root_seed()
        self.observation_size = int(np.prod(self.observation_space.shape or ()))
        policy_kwargs = {"n_quantiles": self.default_quantiles} | self.policy_kwargs
        if "optimizer_class" not in policy_kwargs:
            fused = {"fused": True}  # Adam's steps of all parameters in one call
            given = policy_kwargs.get("optimizer_kwargs") or {}
            if not isinstance(given, dict):
                raise InputError(f"policy_kwargs: optimizer_kwargs is {given!r}: give a table")
            policy_kwargs["optimizer_kwargs"] = fused | given
        self.policy = self.policy_class(  # type: ignore[assignment]
            self.observation_space,
            self.action_space,
            self.lr_schedule,
            individuals=self.layout.individuals,
            condition_flag=self.layout.condition_flag,
            treatment_head=self.recipe.needs_condition and self.layout.condition_flag,
            seed=self.root_seed,
            **policy_kwargs,
        ).to(self.device)
        self.policy.epsilon = self.exploration_rate
        if self.acting_rule:
            self.policy.acting = Acting.from_json(self.acting_rule)
        if self.env is not None:
            self.replay_buffer = self._make_replay_buffer()
        self.boundary_hooks = []

    def set_env(self, env: GymEnv, force_reset: bool = True) -> None:
        """Learn in ``env`` from now on, which must suit the networks and the replay memory.

        A learner that was loaded without an environment gets its replay memory here, for as many
        copies as ``env`` has.

        Raises
        ------
        InputError
            If the individuals, the spaces or the number of copies differ, or if episodes may last
            longer than the replay memory holds, or nobody says how long.
        """
        slots = self._wrap_env(env, self.verbose)
        there, here = SlotLayout.of(slots), self.layout
        if _described(there) != _described(here):
            raise InputError(
                f"the environment has {_described(there)}, this learner {_described(here)}: give "
                "one with the same individuals"
            )
        if isinstance(slots.action_space, Discrete):
            refuse_other_actions(self.policy.num_actions, int(slots.action_space.n))
        new, copies = self.replay_buffer is None, self.n_envs
        if new:
            self.n_envs = slots.num_envs
        elif self.recipe.online:
            self._refuse_longer_episodes(self.max_episode_steps or declared_limit(slots))
        try:
            super().set_env(slots, force_reset)
        except (AssertionError, ValueError) as error:
            self.n_envs = copies
            raise InputError(f"the environment does not suit this learner: {error}") from error
        if new:
            self.layout = there
            self.episode_limit = longest_episode(slots, self.max_episode_steps)
            self.replay_buffer = self._make_replay_buffer()

    def _refuse_longer_episodes(self, limit: int | None) -> None:
        assert self.episode_limit is not None
        if limit is not None and limit > self.episode_limit:
            raise InputError(
                f"its episodes last up to {limit} steps and the replay memory holds "
                f"{self.episode_limit}: give one with a shorter time limit"
            )

    def _root_seed(self) -> int:
        """The seed of this learner's own random streams; without ``seed``, from the system."""
        if self.seed is not None:
            return int(self.seed)
        return int(np.random.SeedSequence().generate_state(1)[0])

    def _make_replay_buffer(self) -> SequenceReplayBuffer:
        assert self.episode_limit is not None
        return SequenceReplayBuffer(
            self.buffer_size,
            self.observation_size,
            self.layout.num_individuals,
            self.policy.num_actions,
            self.episode_limit,
            sequence_length=self.sequence_length,
            burn_in=self.burn_in,
            state_mode=self.state_mode,
            state_size=self.policy.q_net.units,
            prioritized=self.prioritized,
            seed=self.root_seed,
            names=self.layout.individuals,
            device=self.device,
            num_copies=self.layout.num_copies,
            **self.replay_buffer_kwargs,
        )

    # -- before the first step --------------------------------------------------------------------

    def prepare(self, callback: BaseCallback, *, progress_bar: bool) -> None:
        """Run the offline phase if it is due, and set the exploration for the steps to come."""
        if self.offline_epochs:
            self.pretrain(progress_bar=progress_bar)

    def pretrain(self, *, progress_bar: bool = False) -> OfflineProgress:
        """Run the offline phase, or what is left of it; returns its learning curves.

        One that is over stays as it is, also if ``offline_epochs`` is raised.

        Raises
        ------
        InputError
            If there are no ``offline_epochs``, or the demonstrations do not suit.
        """
        if not self.offline_epochs:
            raise InputError("there is nothing to pretrain: give offline_epochs")
        if self.offline_progress.done:
            return self.offline_progress
        if not hasattr(self, "_logger"):
            self._logger = configure_logger(self.verbose, self.tensorboard_log, "offline")
        run_offline_phase(self, self._demonstrations(), progress_bar=progress_bar)
        return self.offline_progress

    def refuse_what_does_not_suit(self) -> None:
        """Look at the environment and the demonstrations as :meth:`learn` would, before it.

        Raises
        ------
        InputError
            If they do not give what the recipe learns from.
        """
        assert self.env is not None
        check_environment(self.env, self.layout, self.recipe)
        if self.offline_epochs and not self.offline_progress.done:
            refuse_foreign(self, self._demonstrations())

    def _demonstrations(self) -> DemonstrationData:
        """Those that were given, or else the environment's own."""
        if self.demonstrations is not None:
            return self.demonstrations
        own = getattr(self.env, "offline_data", None)
        if own is None:
            raise InputError(
                f"recipe {self.recipe.name} has an offline phase and neither it nor its "
                "environment was given demonstrations: pass demonstrations="
            )
        data: DemonstrationData = own() if callable(own) else own
        return data

    # -- act --------------------------------------------------------------------------------------

    def predict(
        self,
        observation: NDArray[Any] | dict[str, NDArray[Any]],
        state: tuple[NDArray[Any], ...] | None = None,
        episode_start: NDArray[Any] | None = None,
        deterministic: bool = False,
    ) -> tuple[NDArray[Any], tuple[NDArray[Any], ...] | None]:
        """Actions of all slots and their memories; see :meth:`GruPolicy.predict`."""
        return self.policy.predict(observation, state, episode_start, deterministic)

    def fit_temperature(self, dataset: OfflineDataset) -> NDArray[np.float64]:
        """Boltzmann temperatures ``(K,)`` of maximum likelihood for the demonstrated actions.

        To act by them: ``model.policy.temperature = model.fit_temperature(data.val)``.
        """
        shown = demonstrated_values(self, dataset)
        fitted = [fit_boltzmann_temperature(v, a) for v, a in zip(shown.values, shown.actions)]
        return np.array(fitted)


def _described(layout: SlotLayout) -> str:
    flag = "a" if layout.condition_flag else "no"
    return f"the individuals {', '.join(layout.individuals)} and {flag} condition flag"
