"""Recurrent double Q-learning on sequences, as an extension of stable-baselines3.

:class:`SequenceQLearning` turns an SB3 off-policy algorithm (DQN, or QRDQN of sb3-contrib) into a
learner with a memory: K individuals, each with its own network, acting in the slots of a VecEnv and
learning from whole episodes or pieces of them. It joins parts that know no learner:
:mod:`.settings` (all numbers), :mod:`.pretraining` (the offline phase), :mod:`.updates` (when to
learn, and how) and :mod:`.checkpoint`. The recipe says what the loss is made of
(:mod:`animarl_algos.losses.terms`), the value distribution how values are represented.
"""

from __future__ import annotations

import inspect
from collections.abc import Iterable
from functools import lru_cache
from typing import Any, ClassVar, Self

import numpy as np
import torch
from gymnasium.spaces import Discrete
from numpy.typing import NDArray
from stable_baselines3.common.base_class import maybe_make_env
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
from stable_baselines3.common.utils import polyak_update
from stable_baselines3.common.vec_env import VecEnv

from animarl_algos.data.dataset import OfflineDataset, check_demonstrations
from animarl_algos.data.slot_layout import (
    SlotLayout,
    check_environment_supports,
    check_episodes_fit,
    check_observation,
    declared,
    declared_feedback,
    demonstrations_in,
    feedback_of,
    longest_episode,
    make_environment,
    refuse_other_actions,
    refuse_other_slots,
)
from animarl_algos.learner import checkpoint
from animarl_algos.learner.callbacks import BoundaryCallback, open_logger, with_progress_bar
from animarl_algos.learner.presets import (
    check_settings,
    learner_preset,
    resolve_settings,
    section_of,
)
from animarl_algos.learner.pretraining import (
    DemonstratedValues,
    OfflineProgress,
    Pretraining,
    demonstrated_values,
    fit_boltzmann_temperature,
)
from animarl_algos.learner.settings import (
    POLICIES,
    LearnerSettings,
    as_frequency,
    check_setting_combinations,
    document_parameters,
    policy_name,
    take_settings,
    translate_sb3_arguments,
)
from animarl_algos.learner.transitions import Step, store_step
from animarl_algos.learner.updates import (
    UpdateSchedule,
    minibatch_values,
    standardise_inputs,
    update,
)
from animarl_algos.losses.terms import Recipe
from animarl_algos.losses.values import mean_recall, treatment_counts
from animarl_algos.networks.acting_rule import Acting, Kind
from animarl_algos.networks.networks import StackedQNetwork
from animarl_algos.networks.policies import GruPolicy, PolicySettings, State, zero_value_stream
from animarl_algos.replay.sequence_buffer import ReplaySettings, SequenceReplayBuffer
from animarl_envs.array_types import Bools, Floats
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.errors import InputError
from animarl_envs.settings import Seed, check_value

EXCLUDED_FROM_ZIP = (
    *("demonstrations", "boundary_hooks", "memory", "treatment_counts"),
    *("_last_obs", "_last_episode_starts", "_last_original_obs"),
)
"""Attributes that a loaded learner makes anew, beside those that stable-baselines3 leaves out."""
LOAD_ARGUMENTS = {"verbose", "tensorboard_log", "seed", "demonstrations"} | set(
    inspect.signature(OffPolicyAlgorithm.load).parameters
)
"""Arguments of ``load`` beside settings."""
STEP_VARIABLES = ("actions", "new_obs", "rewards", "dones", "infos")
"""Variables of a step, one entry for each slot, that callbacks of stable-baselines3 read."""
epsilon_greedy = lru_cache(maxsize=1)(Acting.epsilon_greedy)  # mostly as in the step before


class SequenceQLearning(OffPolicyAlgorithm):
    """Sequence Q-learning for K independent individuals; see the recipes for what is minimised.

    Steps are steps of the world: one step of all slots of a copy counts once.

    Parameters
    ----------
    policy
        ``"GruPolicy"`` (with a memory) or ``"MlpPolicy"``.
    env
        Any Gymnasium environment with Discrete actions, its id, or a VecEnv. An id stands for
        ``gym.make(id)``, in which one individual acts; ``"newt"`` is short for
        ``"AnimaRL/Newt-v0"``. A VecEnv with the attributes ``individuals`` and ``num_copies``, such
        as ``SlotVecEnv("newt")``, trains all individuals.
    learning_rate, sb3_order
        Of Adam, a number or a schedule of the remaining progress. More settings may follow without
        their names, in stable-baselines3's order (``settings.SB3_ORDER``).
    demonstrations
        :class:`~animarl_envs.demos.demonstrations.Demonstrations`, or an object with ``train``
        and ``val`` datasets; by default the environment's own, if it has any.
    settings
        All settings at once (:class:`.settings.LearnerSettings`), without presets.
    seed, verbose, tensorboard_log
        As in stable-baselines3.
    device
        ``"auto"`` is the processor, on which updates took less time than on the GPUs measured.
    given
        Single settings, by name. Those that are not given are preset ``default``'s in
        ``zoo_configs``, as on the command line: of the species of ``env`` where it is one of the
        package's, else what is common to all; with ``offline_epochs`` above 0 that of the recipe's
        ``-pt`` name. ``default_settings(env)`` returns the numbers.

    Attributes
    ----------
    settings
        The settings in use, frozen. Those that stable-baselines3 has are its attributes, too.

    Raises InputError if a setting, the environment or the demonstrations do not suit the recipe.
    """

    policy_aliases: ClassVar[dict[str, type[BasePolicy]]] = dict(POLICIES)
    recipe: ClassVar[Recipe]
    quantiles: ClassVar[bool]
    """Whether values are quantiles of the return."""
    preset: ClassVar[str]
    """Name of the file in ``zoo_configs`` whose preset ``default`` completes the settings."""
    pretrained_preset: ClassVar[str | None] = None
    """The same with ``offline_epochs``, where it is another."""

    settings: LearnerSettings
    layout: SlotLayout
    policy: GruPolicy
    policy_class: type[GruPolicy]
    replay_buffer: SequenceReplayBuffer | None  # type: ignore[assignment]
    memory: State

    def __init_subclass__(cls, **keywords: Any) -> None:
        """Add all parameters to the documentation of a recipe, for ``help``."""
        super().__init_subclass__(**keywords)
        cls.__doc__ = document_parameters(cls.__dict__.get("__doc__"), SequenceQLearning.__doc__)

    @classmethod
    def default_settings(
        cls, env: GymEnv | str | None = None, *, pretrained: bool = False
    ) -> dict[str, Any]:
        """Return what a learner in ``env`` takes by default, ``pretrained`` by its ``-pt`` name."""
        name = cls.pretrained_preset if pretrained and cls.pretrained_preset else cls.preset
        return vars(resolve_settings(name, None, env, {}))

    def __init__(
        self,
        policy: str | type[GruPolicy] | None = None,
        env: GymEnv | str | None = None,
        learning_rate: float | Schedule | None = None,
        *sb3_order: Any,
        demonstrations: Any = None,
        settings: LearnerSettings | None = None,
        tensorboard_log: str | None = None,
        verbose: int = 0,
        seed: int | None = None,
        device: torch.device | str = "auto",
        _init_setup_model: bool = True,
        **given: Any,
    ) -> None:
        if env is None and _init_setup_model:
            raise InputError("there is no environment to learn in: give env=")
        if isinstance(env, str):
            env, demonstrations = make_environment(env, demonstrations)
        given |= {"policy": policy_name(policy), "learning_rate": learning_rate}
        given = translate_sb3_arguments(sb3_order, given)
        if settings is None:
            settings = resolve_settings(self.preset, self.pretrained_preset, env, given)
        elif given:
            settings = settings.changed(**check_settings(given))
        made = None if env is None else maybe_make_env(env, verbose)
        if made is not None:
            check_observation(made.observation_space)
        species = getattr(getattr(env, "scenario", None), "species", None)
        if getattr(species, "is_group", False):  # animals that are alike, with recordings or not
            settings = settings.changed(policy_kwargs={"shared": True} | settings.policy_kwargs)
        try:
            super().__init__(
                policy if isinstance(policy, type) else settings.policy,
                made,  # type: ignore[arg-type]
                **settings.sb3_arguments(),
                tensorboard_log=tensorboard_log,
                verbose=verbose,
                seed=seed,
                device="cpu" if device == "auto" else device,
                _init_setup_model=False,
            )  # type: ignore[call-arg]
        except AssertionError as error:
            raise InputError(f"the environment does not suit these learners: {error}") from error
        self.policy_kwargs = dict(settings.policy_kwargs)  # sb3-contrib adds an optimiser
        self.settings = settings
        self.demonstrations = demonstrations
        self.exploration_rate = settings.exploration_initial_eps
        self.offline_progress = OfflineProgress()
        self.schedule = UpdateSchedule()
        self.acting_rule: Acting | None = None
        self.saved_by = self._kind()
        if _init_setup_model:
            recurrent = self.policy_class.recurrent
            check_setting_combinations(settings, self.recipe, recurrent, self.quantiles)
            self._setup_model()
            assert self.env is not None
            check_environment_supports(self.recipe, self.env, self.layout, settings.alpha)
            if isinstance(demonstrations, Demonstrations):
                self.demonstrations = self._as_data(demonstrations)
            if demonstrations is not None:
                self.check_learnable()
            elif settings.offline_epochs:  # there, though not looked at yet
                self.demonstration_data()

    @classmethod
    def _kind(cls) -> dict[str, Any]:
        """Return the kind of learner that a zip file records."""
        return {"name": cls.__name__, "recipe": cls.recipe.name, "quantiles": cls.quantiles}

    def _as_data(self, demos: Demonstrations) -> Any:
        """Return demonstrations in the terms of the environment, labelled as the preset says."""
        assert self.env is not None
        name = self.pretrained_preset if self.recipe.online else self.preset
        options = learner_preset(name or self.preset, section_of(self.env)).env_kwargs
        return demonstrations_in(self.env, demos, self.layout, options)

    # -- set up -----------------------------------------------------------------------------------

    def _setup_model(self) -> None:
        self.settings = take_settings(vars(self), self.settings)
        self.train_freq = as_frequency(self.train_freq)  # type: ignore[assignment]
        if self.seed is not None:
            self.seed = check_value("seed", self.seed, Seed)
        self._setup_lr_schedule()
        self.set_random_seed(self.seed)
        if self.env is not None:
            layout = SlotLayout.of(self.env)
            if (learned := vars(self).get("layout")) is not None:  # a file's
                refuse_other_slots(layout, learned)
            self.layout = layout
            self.episode_limit = longest_episode(self.env, self.settings.max_episode_steps)
        self.target_update = as_frequency(self.settings.target_update_interval)
        drawn = np.random.SeedSequence().generate_state(1)[0] if self.seed is None else self.seed
        self.root_seed = int(drawn)
        self.observation_size = int(np.prod(self.observation_space.shape or ()))
        self.policy = self._make_policy()
        if self.env is not None:
            self.replay_buffer = self._make_replay_buffer()
        self.boundary_hooks: list[BoundaryCallback] = []

    def _make_policy(self) -> GruPolicy:
        return self.policy_class(
            self.observation_space,
            self.action_space,
            self.lr_schedule,
            individuals=self.layout.individuals,
            condition_flag=self.layout.condition_flag,
            treatment_head=self.recipe.needs_condition and self.layout.condition_flag,
            acting=self.acting_rule or Acting.epsilon_greedy(self.exploration_rate),
            seed=self.root_seed,
            **PolicySettings.check(self.policy_kwargs, "policy_kwargs: "),
        ).to(self.device)

    def _make_replay_buffer(self) -> SequenceReplayBuffer:
        assert self.episode_limit is not None
        # One that never acts keeps nothing: the memory of many animals would be huge.
        rows = self.buffer_size if self.recipe.online else self.episode_limit + 1
        return SequenceReplayBuffer(
            min(rows, self.buffer_size),
            self.observation_size,
            self.layout.num_individuals,
            self.policy.num_actions,
            self.episode_limit,
            self.layout.num_copies,
            sequence_length=self.settings.sequence_length,
            burn_in=self.settings.burn_in,
            state_mode=self.settings.state_mode,
            state_size=self.q_net.units,
            prioritized=self.settings.prioritized,
            seed=self.root_seed,
            names=self.layout.individuals,
            device=self.device,
            **ReplaySettings.check(self.replay_buffer_kwargs, "replay_buffer_kwargs: "),
        )

    def set_random_seed(self, seed: int | None = None) -> None:
        """Seed torch, NumPy, the environment and the acting draws."""
        super().set_random_seed(seed)
        if seed is not None and "policy" in vars(self):  # later than the first call
            self.policy.seed(seed)

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

        Raises InputError if the individuals, what they observe, the spaces or the number of copies
        differ, or if episodes may last longer than the replay memory holds, or nobody says how
        long.
        """
        slots = self._wrap_env(env, self.verbose)
        layout = SlotLayout.of(slots)
        refuse_other_slots(layout, self.layout)
        if isinstance(slots.action_space, Discrete):
            refuse_other_actions(self.policy.num_actions, int(slots.action_space.n))
        new, copies = self.replay_buffer is None, self.n_envs
        if new:
            self.n_envs = slots.num_envs
        elif self.recipe.online:
            check_episodes_fit(slots, self.settings.max_episode_steps, self.episode_limit)
        try:
            super().set_env(slots, force_reset)
        except (AssertionError, ValueError) as error:
            self.n_envs = copies
            raise InputError(f"the environment does not suit this learner: {error}") from error
        if new:
            self.layout = layout
            self.episode_limit = longest_episode(slots, self.settings.max_episode_steps)
            self.replay_buffer = self._make_replay_buffer()

    # -- act --------------------------------------------------------------------------------------

    def predict(  # type: ignore[override]
        self,
        observation: NDArray[Any] | dict[str, NDArray[Any]],
        state: tuple[NDArray[Any], ...] | None = None,
        episode_start: NDArray[Any] | None = None,
        deterministic: bool = False,
    ) -> tuple[NDArray[Any], State]:
        """Return actions of all slots and their memories; see :meth:`GruPolicy.predict`."""
        return self.policy.predict(observation, state, episode_start, deterministic)

    def remember(self, state: State, executed: NDArray[np.integer]) -> State:
        """Do as :meth:`GruPolicy.remember`."""
        return self.policy.remember(state, executed)

    def leave_out(self, state: State, over: Bools) -> State:
        """Do as :meth:`GruPolicy.leave_out`."""
        return self.policy.leave_out(state, over)

    @property
    def offline_recipe(self) -> Recipe:
        """The recipe whose offline terms are minimised; see ``offline_loss``."""
        return self.recipe.cloning() if self.settings.offline_loss == "cloning" else self.recipe

    def demonstration_data(self) -> Any:
        """Return the demonstrations that were given, or else the environment's own."""
        if self.demonstrations is not None:
            return self.demonstrations
        own = getattr(self.env, "offline_data", None)
        single = declared(self.env, "scenario") if own is None else None
        if single is not None and single.all_splits is not None:
            self.demonstrations = self._as_data(single.all_splits)
            return self.demonstrations
        if own is None or getattr(self.env, "demos", own) is None:
            raise InputError(
                f"recipe {self.recipe.name} learns from demonstrations and neither it nor its "
                "environment was given demonstrations: pass demonstrations="
            )
        return own() if callable(own) else own

    def check_learnable(self) -> None:
        """Check the environment and the demonstrations as :meth:`learn` does before it begins."""
        assert self.env is not None
        check_environment_supports(self.recipe, self.env, self.layout, self.settings.alpha)
        if self.settings.offline_epochs > 0 and not self.offline_progress.done:
            data = self.demonstration_data()
            check_demonstrations(data, self.offline_recipe, self.q_net, self.env)

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
        name = type(self).__name__ if tb_log_name is None else tb_log_name
        total_timesteps, callback = self._setup_learn(
            total_timesteps, callback, reset_num_timesteps, name, progress_bar
        )
        try:
            if self.settings.offline_epochs:
                self.pretrain(progress_bar=progress_bar)
            if self.recipe.online:
                callback.on_training_start(locals(), globals())
                self._learn_online(total_timesteps, callback, log_interval)
                callback.on_training_end()
            self.at_boundary()  # where an interruption of the last stretch is raised
        finally:
            for hook in self.boundary_hooks:
                hook.release()
        return self

    def pretrain(self, *, progress_bar: bool = False) -> OfflineProgress:
        """Run the offline phase, or what is left of it; return its learning curves.

        One that is over stays as it is, also if ``offline_epochs`` is raised. With ``exploration``
        ``"boltzmann"`` the temperatures are fitted to its outcome, for all steps that follow.

        Raises InputError if there are no ``offline_epochs``, or the demonstrations do not suit.
        """
        if not self.settings.offline_epochs:
            raise InputError("there is nothing to pretrain: give offline_epochs")
        if self.offline_progress.done:
            return self.offline_progress
        open_logger(self, "offline")
        data, policy = self.demonstration_data(), self.policy
        check_demonstrations(data, self.offline_recipe, self.q_net, self.env)
        self.offline_phase().run(data, self.logger, self.at_boundary, progress_bar=progress_bar)
        if self.settings.offline_loss == "cloning":
            zero_value_stream(policy.q_net)
            zero_value_stream(policy.q_net_target)
        policy.reset_optimizer(self.lr_schedule(1.0))
        if self.settings.exploration == "boltzmann":
            policy.acting = Acting.boltzmann(self.fit_temperature(data.val))
        return self.offline_progress

    def offline_phase(self) -> Pretraining:
        """Return the offline phase, as far as it has come."""
        return Pretraining(
            self.policy, self.offline_recipe, self.settings, self.root_seed, self.offline_progress
        )

    def at_boundary(self) -> None:
        """Let the hooks (checkpoints) look at a whole state, between updates."""
        for hook in self.boundary_hooks:
            hook.at_boundary()

    def _setup_learn(  # type: ignore[override]
        self, total_timesteps: int, *args: Any
    ) -> tuple[int, BaseCallback]:
        callback, reset_num_timesteps, *rest = args
        if self.env is None:
            raise InputError(
                "there is no environment to learn in: give env=, or call set_env first"
            )
        self.check_learnable()
        if reset_num_timesteps or self._last_obs is None:
            self.memory = self.policy.initial_state(self.n_envs)
            self._require_buffer().drop_running()
            self.schedule.restart_rollout()
        open_logger(self)
        total_timesteps, callback = super()._setup_learn(
            total_timesteps, callback, reset_num_timesteps, *rest
        )
        self._last_obs = np.array(self._last_obs)
        self.feedback_names = declared_feedback(self.env)
        self.treatment_counts: Any = 0  # apart, since the last log
        self._set_exploration()
        return total_timesteps, callback

    def _init_callback(self, callback: MaybeCallback, progress_bar: bool = False) -> BaseCallback:
        with_bar = progress_bar and bool(self.recipe.online)
        return super()._init_callback(with_progress_bar(callback) if with_bar else callback)

    def _learn_online(
        self, total_timesteps: int, callback: BaseCallback, log_interval: int | None
    ) -> None:
        """Alternate rollouts and updates until ``total_timesteps`` world steps are done."""
        assert self.env is not None and isinstance(self.train_freq, TrainFreq)
        while self.num_timesteps < total_timesteps:
            self.at_boundary()
            rollout = self.collect_rollouts(
                self.env,
                callback=callback,
                train_freq=self.train_freq,
                replay_buffer=self._require_buffer(),
                learning_starts=self.learning_starts,
                log_interval=log_interval,
            )
            if not rollout.continue_training:
                break
            self._train_if_due()

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
        """Act until ``train_freq`` steps of every copy, or episodes of all copies, are done.

        The end of training and a callback that returns False end it too. What was collected until
        then counts when training is continued, as if it had never been stopped.
        """
        copies, schedule, continue_training = self.layout.num_copies, self.schedule, True
        callback.on_rollout_start()
        while (
            continue_training
            and self.num_timesteps < self._total_timesteps
            and schedule.needs_more_steps(train_freq)
        ):
            self._set_exploration()  # whatever a callback left there
            # Callbacks of stable-baselines3 read these by name.
            actions, (hidden, _) = self._choose_actions(learning_starts)
            new_obs, rewards, dones, infos = env.step(actions)
            new_obs = np.array(new_obs)  # an environment may overwrite its own
            feedback = {"executed": actions} | feedback_of(env, self.feedback_names, infos)
            step = Step(new_obs, rewards, dones, infos, feedback)
            before: Any = self._last_obs
            alpha = self.settings.alpha
            store_step(replay_buffer, step, before, self.memory, self.layout, self.recipe, alpha)
            previous = feedback["executed"].astype(np.int64)
            # Episodes that begin have no memory and no previous action.
            hidden[dones], previous[dones] = 0.0, self.policy.num_actions
            self.memory = hidden, previous
            self._last_obs, self._last_episode_starts = new_obs, dones
            finished = int(dones.sum()) // self.layout.num_individuals
            self._count(copies, finished)
            if finished:
                over = np.flatnonzero(dones)
                self._update_info_buffer([infos[s] for s in over], dones[over])
            continue_training = self._call_back(callback, locals())
            if log_interval is not None and self._episode_num % log_interval < finished:
                self.dump_logs()
        if continue_training:
            callback.on_rollout_end()
        return RolloutReturn(schedule.steps * copies, schedule.episodes, continue_training)

    def _call_back(self, callback: BaseCallback, variables: dict[str, Any]) -> bool:
        """Call ``callback`` once for each world step, as in one environment; False to stop.

        So ``CheckpointCallback(100)`` saves after 100 world steps, however many copies make them.
        ``variables`` are the locals of a step of all copies; the callback sees those of one copy.
        """
        done, K, copies = self.num_timesteps, self.layout.num_individuals, self.layout.num_copies
        continue_training = True
        for b in range(copies):
            own = slice(b * K, (b + 1) * K)
            self.num_timesteps = done - copies + b + 1
            callback.update_locals(
                variables | {name: variables[name][own] for name in STEP_VARIABLES}
            )
            continue_training = callback.on_step()
            if not continue_training:
                break
        self.num_timesteps = done
        return continue_training

    def _choose_actions(self, learning_starts: int) -> tuple[NDArray[Any], State]:
        """Return an action per slot and the memory after it: uniform before ``learning_starts``."""
        rule = self.policy.acting
        if self.num_timesteps < learning_starts:
            self.policy.acting = Acting.epsilon_greedy(1.0)
        try:
            return self.policy.predict(self._last_obs, self.memory)  # type: ignore[arg-type]
        finally:
            self.policy.acting = rule

    def _count(self, steps: int, episodes: int) -> None:
        """Count world steps and episodes that have just passed; do what depends on their number."""
        self.num_timesteps += steps
        self._episode_num += episodes
        self.schedule.count_step(episodes)
        self._update_current_progress_remaining(self.num_timesteps, self._total_timesteps)
        self._set_exploration()
        if self.schedule.is_target_due(self.target_update, steps, episodes):
            polyak_update(self.q_net.parameters(), self.q_net_target.parameters(), self.tau)

    def _set_exploration(self) -> None:
        """Set epsilon as it is due after the steps done; a policy that samples has none."""
        steps, share = self.settings.exploration_steps, self.settings.exploration_fraction
        if share is not None:
            steps = round(share * self._total_timesteps)
        passed = min(self.num_timesteps / steps, 1.0) if steps else 1.0
        first, last = self.settings.exploration_initial_eps, self.settings.exploration_final_eps
        self.exploration_rate = first + passed * (last - first)
        if self.policy.acting.kind is not Kind.BOLTZMANN:
            self.policy.acting = epsilon_greedy(self.exploration_rate)

    def _train_if_due(self) -> None:
        """Make the updates that a rollout asks for, once it is whole."""
        schedule, frequency, buffer = self.schedule, self.train_freq, self._require_buffer()
        assert isinstance(frequency, TrainFreq)
        if schedule.needs_more_steps(frequency):
            return
        updates = schedule.take_updates(
            frequency,
            copies=self.layout.num_copies,
            gradient_steps=self.gradient_steps,
            updates_per_episode=self.settings.updates_per_episode,
        )
        if self.num_timesteps < self.learning_starts or buffer.num_sequences == 0:
            schedule.updates_due = 0.0
        elif updates:
            if self.settings.standardise_inputs:
                standardise_inputs(self.policy, buffer, done=self.offline_progress.done)
            self.train(updates, self.batch_size)

    def train(self, gradient_steps: int, batch_size: int = 32) -> None:
        """Make ``gradient_steps`` updates on sequences from the replay memory."""
        buffer, policy, terms = self._require_buffer(), self.policy, self.recipe.online
        self._update_learning_rate(policy.optimizer)
        phase = self.settings.phase("online")
        needs_target = any(term.needs_target for term in terms)
        for _ in range(gradient_steps):
            batch = buffer.sample(batch_size, 1.0 - self._current_progress_remaining)
            minibatch = minibatch_values(policy, batch, phase, needs_target=needs_target)
            losses, priorities = update(
                minibatch, terms, policy.optimizer, prioritized=buffer.prioritized
            )
            if priorities is not None:
                buffer.update_priorities(batch.indices, priorities)
            if (logits := minibatch.treatment_logits) is not None:
                counts = treatment_counts(logits, minibatch.batch.condition, minibatch.valid)
                self.treatment_counts += counts
            self.logger.record_mean("train/loss", minibatch.total)
            for name, loss in losses.items():
                for individual, value in zip(self.layout.individuals, loss.tolist()):
                    self.logger.record_mean(f"train/{name}/{individual}", value)
        self._n_updates += gradient_steps

    def dump_logs(self) -> None:
        """Log SB3's own figures, epsilon and the memory's size beside the mean losses."""
        record, buffer = self.logger.record, self._require_buffer()
        record("train/n_updates", self._n_updates, exclude="tensorboard")
        if isinstance(self.treatment_counts, torch.Tensor):
            accuracy = mean_recall(self.treatment_counts).tolist()
            for individual, value in zip(self.layout.individuals, accuracy):
                record(f"train/treatment_balanced_accuracy/{individual}", value)
            self.treatment_counts = 0
        record("rollout/exploration_rate", self.exploration_rate)
        record("rollout/buffer_episodes", buffer.num_episodes)
        record("rollout/buffer_steps", buffer.num_steps)
        super().dump_logs()

    def demonstrated_values(self, dataset: OfflineDataset) -> DemonstratedValues:
        """Return the action values along demonstrated episodes."""
        phase = self.settings.phase("offline")
        return demonstrated_values(self.policy, phase, dataset, self.settings.offline_batch_size)

    def fit_temperature(self, dataset: OfflineDataset) -> Floats:
        """Return Boltzmann temperatures ``(K,)`` of maximum likelihood for demonstrated actions.

        To act by them: ``model.policy.acting = Acting.boltzmann(model.fit_temperature(data.val))``.
        """
        along = self.demonstrated_values(dataset)
        fitted = [fit_boltzmann_temperature(v, a) for v, a in zip(along.values, along.actions)]
        return np.array(fitted)

    # -- save -------------------------------------------------------------------------------------

    def save(
        self,
        path: checkpoint.Place,
        exclude: Iterable[str] | None = None,
        include: Iterable[str] | None = None,
    ) -> None:
        """Write all settings, the networks and the acting rule, as in stable-baselines3."""
        self.acting_rule = self.policy.acting
        with checkpoint.whole_file(path, ".zip") as file:
            super().save(file, exclude, include)

    @classmethod
    def load(cls, path: checkpoint.Place, *arguments: Any, **keywords: Any) -> Self:  # type: ignore[override]
        """Return a learner from :meth:`save`; arguments as in stable-baselines3.

        The file holds pickles, which can run code: load only your own.

        Raises InputError if another class saved it, ``env`` has other individuals or shows other
        things, or settings given anew are not valid.
        """
        given = {name: value for name, value in keywords.items() if name not in LOAD_ARGUMENTS}
        keywords |= check_settings(given)
        with checkpoint.loading(path, cls._kind()):
            model = super().load(path, *arguments, **keywords)
        if given:
            recurrent = model.policy_class.recurrent
            check_setting_combinations(model.settings, cls.recipe, recurrent, cls.quantiles)
        return model

    def save_replay_buffer(self, path: checkpoint.Place) -> None:
        """Write the replay memory as an ``npz`` archive, whatever the name of ``path``."""
        checkpoint.save_replay(self._require_buffer(), path)

    def load_replay_buffer(self, path: checkpoint.Place, truncate_last_traj: bool = True) -> None:
        """Read the finished episodes of :meth:`save_replay_buffer`; training begins new ones.

        Raises InputError if it is none, or was saved with other settings.
        """
        buffer = self._require_buffer()
        checkpoint.load_replay(buffer, path)
        buffer.allocate_staging(self.layout.num_copies)
        self._last_obs = None

    def _require_buffer(self) -> SequenceReplayBuffer:
        if self.replay_buffer is None:
            raise InputError("there is no replay memory: give env=, or call set_env first")
        return self.replay_buffer

    def _excluded_save_params(self) -> list[str]:
        return [*super()._excluded_save_params(), *EXCLUDED_FROM_ZIP]

    def _get_torch_save_params(self) -> tuple[list[str], list[str]]:
        return ["policy", "policy.optimizer"], []
