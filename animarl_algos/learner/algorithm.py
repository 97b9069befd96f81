"""Recurrent double Q-learning on sequences, as an extension of stable-baselines3.

:class:`SequenceQLearning` turns an SB3 off-policy algorithm (DQN, or QRDQN of sb3-contrib) into a
learner with a memory: K individuals, each with its own network, acting in the slots of a VecEnv and
learning from whole episodes or pieces of them. The class holds settings and parts; what is done is
told in the modules beside it: :mod:`.making`, :mod:`.checks`, :mod:`.offline`, :mod:`.online`,
:mod:`.collecting`, :mod:`.updating`, :mod:`.pace`, :mod:`.saving`. What the loss is made of is the
recipe's business (:mod:`animarl_algos.losses.terms`); how values are represented is the value
distribution's.
"""

from __future__ import annotations

import inspect
from collections.abc import Iterable
from typing import Any, ClassVar, Self, Unpack

import numpy as np
import torch
from gymnasium.spaces import Discrete
from numpy.typing import NDArray
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.noise import ActionNoise
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
from stable_baselines3.common.policies import BasePolicy
from stable_baselines3.common.type_aliases import (
    GymEnv,
    MaybeCallback,
    RolloutReturn,
    Schedule,
    TrainFreq,
)
from stable_baselines3.common.utils import configure_logger
from stable_baselines3.common.vec_env import VecEnv

from animarl_algos.data.slots import SlotLayout, refuse_other_actions
from animarl_algos.learner import checks, making, online, saving
from animarl_algos.learner.collecting import Collector, Memory
from animarl_algos.learner.demonstrations import (
    DemonstrationData,
    OfflineDataset,
    demonstrated_windows,
    refuse_foreign,
)
from animarl_algos.learner.exploration import (
    Exploration,
    LinearDecay,
    fit_boltzmann_temperature,
)
from animarl_algos.learner.habits import translated
from animarl_algos.learner.offline import OfflineProgress, run_offline_phase
from animarl_algos.learner.offline_settings import OfflineSettings
from animarl_algos.learner.presets import constructor_settings
from animarl_algos.learner.progress import BoundaryHook, with_progress_bar
from animarl_algos.learner.recorder import Recorder
from animarl_algos.learner.settings import (
    POLICIES,
    LearnerSettings,
    as_frequency,
    declared_limit,
    longest_episode,
)
from animarl_algos.learner.updating import Updater
from animarl_algos.learner.validation import demonstrated_values
from animarl_algos.losses.terms import OfflineLoss, Phase, Recipe
from animarl_algos.networks.networks import StackedQNetwork
from animarl_algos.networks.policies import GruPolicy
from animarl_algos.networks.value_stream import into_logits
from animarl_algos.replay.sequence_buffer import SequenceReplayBuffer
from animarl_envs.errors import InputError

TO_SB3 = (
    "learning_rate", "buffer_size", "learning_starts", "batch_size", "tau", "gamma", "train_freq",
    "gradient_steps", "replay_buffer_kwargs", "stats_window_size", "policy_kwargs",
)  # fmt: skip
"""Settings that stable-baselines3's constructor takes and keeps."""


class SequenceQLearning(OffPolicyAlgorithm):
    """Sequence Q-learning for K independent individuals; see the recipes for what is minimised.

    Steps are steps of the world: one step of all slots of a copy counts once.

    Parameters
    ----------
    policy
        ``"GruPolicy"`` (with a memory) or ``"MlpPolicy"``.
    env
        Any Gymnasium environment with Discrete actions, or a VecEnv; one with the attributes
        ``individuals`` and ``num_copies`` trains all individuals.
    learning_rate
        Of Adam, a number or a schedule of the remaining progress.
    demonstrations
        Object with ``train`` and ``val`` datasets; by default the environment's own, if it has any.
    seed, device, verbose, tensorboard_log
        As in stable-baselines3.
    settings
        Those of :class:`.settings.LearnerSettings`. What is not given, ``policy`` too, is preset
        ``default``'s in ``zoo_configs``, as on the command line: of the species of ``env`` where it
        is one of the package's, else what is common to all; with ``offline_epochs`` above 0 that of
        the recipe's ``-pt`` name. ``default_settings(env)`` returns the numbers.

    Raises
    ------
    InputError
        If a setting, the environment or the demonstrations do not suit the recipe.
    """

    policy_aliases: ClassVar[dict[str, type[BasePolicy]]] = dict(POLICIES)
    recipe: ClassVar[Recipe]
    quantiles: ClassVar[bool]
    """Whether values are quantiles of the return."""
    preset: ClassVar[str]
    """Name of the file in ``zoo_configs`` whose preset ``default`` completes the settings."""
    pretrained_preset: ClassVar[str | None] = None
    """The same with ``offline_epochs``, where it is another."""

    policy: GruPolicy
    policy_class: type[GruPolicy]
    replay_buffer: SequenceReplayBuffer | None  # type: ignore[assignment]
    target_update_interval: int | tuple[int, str]
    updates_per_episode: float
    exploration: str
    exploration_initial_eps: float
    exploration_final_eps: float
    exploration_steps: int
    exploration_fraction: float | None
    exploration_schedule: LinearDecay
    lambda1: float
    n_steps: int
    sequence_length: int | None
    burn_in: int
    state_mode: str
    prioritized: bool
    standardise_inputs: bool
    max_episode_steps: int | None
    offline_loss: str
    offline_epochs: int
    offline_learning_rate: float
    offline_batch_size: int
    offline_scaled_penalties: bool
    offline_patience: int | None
    offline_kwargs: dict[str, Any]
    offline_settings: OfflineSettings
    best_weights: dict[str, torch.Tensor] | None
    average_weights: dict[str, torch.Tensor] | None
    episode_limit: int | None
    memory: Memory
    collector: Collector
    updater: Updater

    def __init_subclass__(cls, **keywords: Any) -> None:
        """``help`` of a recipe shows all parameters, after what it says itself."""
        super().__init_subclass__(**keywords)
        own = inspect.cleandoc(cls.__dict__.get("__doc__") or "")
        if "Parameters\n---" not in own:
            cls.__doc__ = "\n\n".join([own, PARAMETERS])

    @classmethod
    def default_settings(
        cls, env: GymEnv | str | None = None, *, pretrained: bool = False
    ) -> dict[str, Any]:
        """What a learner in ``env`` takes where it is not told; of its ``-pt`` name, if asked."""
        name = cls.pretrained_preset if pretrained and cls.pretrained_preset else cls.preset
        return constructor_settings(name, None, env, {})

    def __init__(
        self,
        policy: str | type[GruPolicy] | None = None,
        env: GymEnv | str | None = None,
        learning_rate: float | Schedule | None = None,
        *,
        demonstrations: DemonstrationData | None = None,
        tensorboard_log: str | None = None,
        verbose: int = 0,
        seed: int | None = None,
        device: torch.device | str = "auto",
        _init_setup_model: bool = True,
        **settings: Unpack[LearnerSettings],
    ) -> None:
        if env is None and _init_setup_model:
            raise InputError("there is no environment to learn in: give env=")
        given: dict[str, Any] = dict(settings)
        named = {"policy": policy, "learning_rate": learning_rate}
        given |= {name: value for name, value in named.items() if value is not None}
        if given.get("offline_epochs", 0) is None:
            del given["offline_epochs"]
        if isinstance(own := given.get("policy_kwargs"), dict):
            given["policy_kwargs"] = translated(own)
        whole = constructor_settings(self.preset, self.pretrained_preset, env, given)
        policy = whole.pop("policy")
        if policy not in self.policy_aliases and isinstance(policy, str):
            raise InputError(
                f"policy {policy!r} is unknown: choose {' or '.join(self.policy_aliases)}"
            )
        policy_kwargs = dict(whole["policy_kwargs"])
        try:
            super().__init__(
                policy,
                env,  # type: ignore[arg-type]
                **{name: whole.pop(name) for name in TO_SB3},
                tensorboard_log=tensorboard_log,
                verbose=verbose,
                seed=seed,
                device=device,
                _init_setup_model=False,
            )  # type: ignore[call-arg]
        except AssertionError as error:
            raise InputError(f"the environment does not suit these learners: {error}") from error
        self.policy_kwargs = policy_kwargs  # sb3-contrib adds an optimiser of its own
        for name, value in whole.items():
            setattr(self, name, value)
        self.demonstrations = demonstrations
        self.exploration_rate = self.exploration_initial_eps
        self.offline_progress = OfflineProgress()
        self.best_weights = self.average_weights = None
        self.acting_rule: dict[str, Any] = {}
        if _init_setup_model:
            checks.refuse_what_does_not_go_together(self)
            self._setup_model()

    # -- set up -----------------------------------------------------------------------------------

    def _setup_model(self) -> None:
        self.train_freq = as_frequency(self.train_freq, "train_freq")  # type: ignore[assignment]
        checks.refuse_bad_settings(self)
        self._setup_lr_schedule()
        self.set_random_seed(self.seed)
        if self.env is not None:
            layout = SlotLayout.of(self.env)
            if (learned := vars(self).get("layout")) is not None:  # a file's
                making.refuse_other_slots(layout, learned)
            self.layout = layout
            self.episode_limit = longest_episode(self.env, self.max_episode_steps)
        self.target_update = as_frequency(self.target_update_interval, "target_update_interval")
        self.root_seed = making.root_seed(self.seed)
        self.observation_size = int(np.prod(self.observation_space.shape or ()))
        self.policy = making.make_policy(self)
        if self.env is not None:
            self.replay_buffer = making.make_replay_buffer(self)
        self.boundary_hooks: list[BoundaryHook] = []
        self.pace = saving.pace_from(vars(self))

    @property
    def q_net(self) -> StackedQNetwork:
        """The policy's network, under stable-baselines3's name for it."""
        return self.policy.q_net

    @property
    def q_net_target(self) -> StackedQNetwork:
        """Its target network."""
        return self.policy.q_net_target

    def set_env(self, env: GymEnv, force_reset: bool = True) -> None:
        """Learn in ``env`` from now on, which must suit the networks and the replay memory.

        A learner that was loaded without an environment gets its replay memory here, for as many
        copies as ``env`` has.

        Raises
        ------
        InputError
            If the individuals, what they observe, the spaces or the number of copies differ, or if
            episodes may last longer than the replay memory holds, or nobody says how long.
        """
        slots = self._wrap_env(env, self.verbose)
        layout = SlotLayout.of(slots)
        making.refuse_other_slots(layout, self.layout)
        if isinstance(slots.action_space, Discrete):
            refuse_other_actions(self.policy.num_actions, int(slots.action_space.n))
        new, copies = self.replay_buffer is None, self.n_envs
        if new:
            self.n_envs = slots.num_envs
        elif self.recipe.online:
            limit = self.max_episode_steps or declared_limit(slots)
            making.refuse_longer_episodes(limit, self.episode_limit)
        try:
            super().set_env(slots, force_reset)
        except (AssertionError, ValueError) as error:
            self.n_envs = copies
            raise InputError(f"the environment does not suit this learner: {error}") from error
        if new:
            self.layout = layout
            self.episode_limit = longest_episode(slots, self.max_episode_steps)
            self.replay_buffer = making.make_replay_buffer(self)

    def phase(self, name: str) -> Phase:
        """The numbers of the ``"online"`` or ``"offline"`` phase."""
        return checks.phase_of(self, name)

    @property
    def offline_recipe(self) -> Recipe:
        """The recipe whose offline terms are minimised; see ``offline_loss``."""
        cloning = self.offline_loss == OfflineLoss.CLONING
        return self.recipe.cloning() if cloning else self.recipe

    def refuse_what_does_not_suit(self) -> None:
        """Look at the environment and the demonstrations as :meth:`learn` would, before it.

        Raises
        ------
        InputError
            If they do not give what the recipe learns from.
        """
        checks.refuse_what_cannot_be_learnt(self)
        if checks.needs_demonstrations(self):
            refuse_foreign(self, self.demonstration_data())

    # -- learn ------------------------------------------------------------------------------------

    def learn(
        self,
        total_timesteps: int,
        callback: MaybeCallback = None,
        log_interval: int | None = 100,
        tb_log_name: str | None = None,
        reset_num_timesteps: bool = True,
        progress_bar: bool = False,
    ) -> Self:
        """Train: first the offline phase if it is due, then ``total_timesteps`` world steps.

        With ``reset_num_timesteps=False`` running episodes and memories are continued. A recipe
        without an online phase (BC) returns after the offline one. ``log_interval`` counts
        episodes.
        """
        self.boundary_hooks = []
        total_timesteps, callback = self._setup_learn(
            total_timesteps,
            callback,
            reset_num_timesteps,
            type(self).__name__ if tb_log_name is None else tb_log_name,
            progress_bar,
        )
        try:
            if self.offline_epochs:
                self.pretrain(progress_bar=progress_bar)
            if self.recipe.online:
                callback.on_training_start(locals(), globals())
                online.alternate(self, total_timesteps, callback, log_interval)
                callback.on_training_end()
            self.at_boundary()  # where an interruption of the last stretch is raised
        finally:
            for hook in self.boundary_hooks:
                hook.release()
        return self

    def pretrain(self, *, progress_bar: bool = False) -> OfflineProgress:
        """Run the offline phase, or what is left of it; returns its learning curves.

        One that is over stays as it is, also if ``offline_epochs`` is raised. With ``exploration``
        ``"boltzmann"`` the temperatures are fitted to its outcome, for all steps that follow.

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
        data = self.demonstration_data()
        run_offline_phase(self, data, progress_bar=progress_bar)
        if self.exploration == Exploration.BOLTZMANN:
            self.policy.temperature = self.fit_temperature(data.val)
        if self.recipe.inverse:
            into_logits(self.policy)
        return self.offline_progress

    def demonstration_data(self) -> DemonstrationData:
        """Those that were given, or else the environment's own."""
        if self.demonstrations is not None:
            return self.demonstrations
        checks.refuse_without_demonstrations(self)
        own = getattr(self.env, "offline_data", None)
        data: DemonstrationData = own() if callable(own) else own  # type: ignore[assignment]
        return data

    def at_boundary(self) -> None:
        """Between updates: let the hooks (checkpoints) look at a state that is whole."""
        for hook in self.boundary_hooks:
            hook.at_boundary()

    def reset_optimizer(self, learning_rate: float) -> None:
        """A new optimiser for the online network, with nothing accumulated."""
        policy = self.policy
        policy.optimizer = policy.optimizer_class(
            policy.q_net.parameters(),
            lr=learning_rate,  # type: ignore[call-arg]
            **policy.optimizer_kwargs,
        )

    def _setup_learn(
        self,
        total_timesteps: int,
        callback: MaybeCallback = None,
        reset_num_timesteps: bool = True,
        tb_log_name: str = "run",
        progress_bar: bool = False,
    ) -> tuple[int, BaseCallback]:
        if self.env is None:
            raise InputError(
                "there is no environment to learn in: give env=, or call set_env first"
            )
        self.refuse_what_does_not_suit()
        if reset_num_timesteps or self._last_obs is None:
            self.memory = self.policy.initial_state(self.n_envs)
            assert self.replay_buffer is not None
            self.replay_buffer.drop_running()
            self.pace.restart()
        total_timesteps, callback = super()._setup_learn(
            total_timesteps, callback, reset_num_timesteps, tb_log_name, progress_bar
        )
        self._last_obs = np.array(self._last_obs)
        self.updater = Updater(self.policy, self.recipe.online)
        self.collector = Collector(self.policy, Recorder(self.env, self.layout, self.recipe))
        online.start_exploration(self, total_timesteps)
        return total_timesteps, callback

    def _init_callback(self, callback: MaybeCallback, progress_bar: bool = False) -> BaseCallback:
        shown = progress_bar and bool(self.recipe.online)
        return super()._init_callback(with_progress_bar(callback) if shown else callback)

    def collect_rollouts(
        self,
        env: VecEnv,
        callback: BaseCallback,
        train_freq: TrainFreq,
        replay_buffer: SequenceReplayBuffer,  # type: ignore[override]
        action_noise: ActionNoise | None = None,
        learning_starts: int = 0,
        log_interval: int | None = None,
    ) -> RolloutReturn:
        """Act until ``train_freq`` is reached; see :func:`animarl_algos.learner.online.collect`."""
        return online.collect(
            self, env, callback, train_freq, replay_buffer, learning_starts, log_interval
        )

    def train(self, gradient_steps: int, batch_size: int = 32) -> None:
        """``gradient_steps`` updates on sequences from the replay memory."""
        assert self.replay_buffer is not None
        self._update_learning_rate(self.policy.optimizer)
        progress = 1.0 - self._current_progress_remaining
        self.updater.run(
            self.replay_buffer,
            gradient_steps,
            batch_size,
            self.phase("online"),
            progress,
            demonstrated_windows(self, gradient_steps, batch_size) if self.recipe.inverse else None,
        )
        self._n_updates += gradient_steps

    def dump_logs(self) -> None:
        """Write the log; see :func:`animarl_algos.learner.online.write_log`."""
        online.write_log(self)

    # -- act --------------------------------------------------------------------------------------

    def predict(
        self,
        observation: NDArray[Any] | dict[str, NDArray[Any]],
        state: tuple[NDArray[Any], ...] | None = None,
        episode_start: NDArray[Any] | None = None,
        deterministic: bool = False,
    ) -> tuple[NDArray[Any], Memory]:
        """Actions of all slots and their memories; see :meth:`GruPolicy.predict`."""
        return self.policy.predict(observation, state, episode_start, deterministic)

    def remember(self, state: Memory, executed: NDArray[np.integer]) -> Memory:
        """See :meth:`GruPolicy.remember`."""
        return self.policy.remember(state, executed)

    def leave_out(self, state: Memory, over: NDArray[np.bool_]) -> Memory:
        """See :meth:`GruPolicy.leave_out`."""
        return self.policy.leave_out(state, over)

    def fit_temperature(self, dataset: OfflineDataset) -> NDArray[np.float64]:
        """Boltzmann temperatures ``(K,)`` of maximum likelihood for the demonstrated actions.

        To act by them: ``model.policy.temperature = model.fit_temperature(data.val)``.
        """
        shown = demonstrated_values(self, dataset)
        fitted = [fit_boltzmann_temperature(v, a) for v, a in zip(shown.values, shown.actions)]
        return np.array(fitted)

    # -- save -------------------------------------------------------------------------------------

    def save(
        self,
        path: saving.Place,
        exclude: Iterable[str] | None = None,
        include: Iterable[str] | None = None,
    ) -> None:
        """All settings and the networks, as in stable-baselines3; epsilon and temperature too."""
        with saving.with_saved_numbers(self), saving.whole_zip(path) as file:
            super().save(file, exclude, include)

    @classmethod
    def load(cls, path: saving.Place, *arguments: Any, **keywords: Any) -> Self:  # type: ignore[override]
        """A learner from :meth:`save`; arguments as in stable-baselines3.

        The file holds pickles, which can run code: load only your own.

        Raises
        ------
        InputError
            If another class saved it, or ``env`` has other individuals or shows other things.
        """
        with saving.found_where_they_stood(), saving.only_of(cls, path):
            return super().load(path, *arguments, **keywords)

    def save_replay_buffer(self, path: saving.Place) -> None:
        """Write the replay memory as an ``npz`` archive, whatever the name of ``path``."""
        saving.save_replay(self._the_buffer(), path)

    def load_replay_buffer(self, path: saving.Place, truncate_last_traj: bool = True) -> None:
        """Read the finished episodes of :meth:`save_replay_buffer`; training begins new ones.

        Raises
        ------
        InputError
            If it is none, or was saved with other settings.
        """
        buffer = self._the_buffer()
        saving.load_replay(buffer, path)
        buffer.allocate_staging(self.layout.num_copies)
        self._last_obs = None

    def _the_buffer(self) -> SequenceReplayBuffer:
        if self.replay_buffer is None:
            raise InputError("there is no replay memory: give env=, or call set_env first")
        return self.replay_buffer

    def _excluded_save_params(self) -> list[str]:
        return [*super()._excluded_save_params(), *saving.NOT_IN_ZIP]

    def _get_torch_save_params(self) -> tuple[list[str], list[str]]:
        return ["policy", "policy.optimizer"], []


def _parameters(documented: type) -> str:
    """What a docstring says under Parameters, to the next empty line."""
    text = inspect.cleandoc(documented.__doc__ or "")
    return text.partition("Parameters\n----------\n")[2].partition("\n\n")[0]


PARAMETERS = "\n".join(
    ["Parameters", "----------", _parameters(SequenceQLearning), _parameters(LearnerSettings)]
)
