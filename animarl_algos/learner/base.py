"""A learner as it is made, acts, is saved and restored; :mod:`.algorithm` says how it learns."""

from __future__ import annotations

import inspect
from collections import deque
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any, ClassVar, Self

import gymnasium as gym
import numpy as np
import torch
from gymnasium.spaces import Discrete
from numpy.typing import NDArray
from stable_baselines3.common.base_class import maybe_make_env
from stable_baselines3.common.off_policy_algorithm import OffPolicyAlgorithm
from stable_baselines3.common.policies import BasePolicy
from stable_baselines3.common.type_aliases import GymEnv, Schedule

from animarl_algos.data.vec_env import (
    LABEL_OPTIONS,
    SlotLayout,
    check_environment_supports,
    check_observation,
    demonstrations_in,
    is_observed_as_declared,
    refuse_other_actions,
    refuse_other_slots,
)
from animarl_algos.learner import checkpoint
from animarl_algos.learner.callbacks import BoundaryCallback
from animarl_algos.learner.presets import (
    check_settings,
    constructor_settings,
    learner_preset,
    section_of,
)
from animarl_algos.learner.pretraining import OfflineProgress
from animarl_algos.learner.settings import (
    POLICIES,
    LearnerSettings,
    OfflineSettings,
    as_frequency,
    check_setting_combinations,
    declared_limit,
    longest_episode,
    translate_policy_kwargs,
)
from animarl_algos.learner.updates import UpdateSchedule
from animarl_algos.losses.terms import Phase, Recipe
from animarl_algos.networks.acting_rule import Acting
from animarl_algos.networks.networks import StackedQNetwork
from animarl_algos.networks.policies import GruPolicy, PolicySettings, State
from animarl_algos.replay.sequence_buffer import ReplaySettings, SequenceReplayBuffer
from animarl_envs import environment_id
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.errors import InputError
from animarl_envs.settings import Seed, check_value, describe_fields
from animarl_envs.species import get_species

TO_SB3 = (
    "learning_rate", "buffer_size", "learning_starts", "batch_size", "tau", "gamma", "train_freq",
    "gradient_steps", "replay_buffer_kwargs", "stats_window_size", "policy_kwargs",
)  # fmt: skip
"""Settings that stable-baselines3's constructor takes and keeps."""
NOT_IN_ZIP = (
    "demonstrations", "boundary_hooks", "memory", "treatments_told",
    "_last_obs", "_last_episode_starts", "_last_original_obs",
)  # fmt: skip
"""What a loaded learner makes anew, beside what stable-baselines3 leaves out."""
OF_LOAD = (
    "env", "device", "custom_objects", "print_system_info", "force_reset", "verbose",
    "tensorboard_log", "seed", "demonstrations",
)  # fmt: skip
"""What ``load`` takes beside settings."""
COUNTERS = (
    "num_timesteps", "_total_timesteps", "_episode_num", "_n_updates",
    "_current_progress_remaining", "exploration_rate", "root_seed",
)  # fmt: skip
"""Attributes that a checkpoint holds as they are."""


class BaseLearner(OffPolicyAlgorithm):
    """Settings, policy, replay memory and state of a learner of K independent individuals.

    Parameters
    ----------
    policy
        ``"GruPolicy"`` (with a memory) or ``"MlpPolicy"``.
    env
        Any Gymnasium environment with Discrete actions, its id, or a VecEnv. An id stands for
        ``gym.make(id)``, in which one individual acts; ``"newt"`` is short for
        ``"AnimaRL/Newt-v0"``. A VecEnv with the attributes ``individuals`` and ``num_copies``, such
        as ``SlotVecEnv("newt")``, trains all individuals.
    learning_rate
        Of Adam, a number or a schedule of the remaining progress.
    demonstrations
        :class:`~animarl_envs.demos.demonstrations.Demonstrations`, or an object with ``train``
        and ``val`` datasets; by default the environment's own, if it has any.
    seed, device, verbose, tensorboard_log
        As in stable-baselines3.
    settings
        Those of :class:`.settings.LearnerSettings`, which then are attributes. What is not given,
        ``policy`` too, is preset ``default``'s in ``zoo_configs``, as on the command line: of the
        species of ``env`` where it is one of the package's, else what is common to all; with
        ``offline_epochs`` above 0 that of the recipe's ``-pt`` name. ``default_settings(env)``
        returns the numbers.

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
    memory: State
    if TYPE_CHECKING:

        def __getattr__(self, setting: str) -> Any: ...

    def __init_subclass__(cls, **keywords: Any) -> None:
        """``help`` of a recipe shows all parameters, after what it says itself."""
        super().__init_subclass__(**keywords)
        text = inspect.cleandoc(BaseLearner.__doc__ or "")
        parameters = text.partition("Parameters\n")[2].partition("\n\n")[0]
        prose = [
            f"{name}\n    {said}"
            for name, said in describe_fields(LearnerSettings).items()
            if name not in ("policy", "learning_rate")
        ]
        own = inspect.cleandoc(cls.__dict__.get("__doc__") or "")
        if "Parameters\n---" not in own:
            cls.__doc__ = "\n".join([own, "", "Parameters", parameters, *prose])

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
        demonstrations: Any = None,
        tensorboard_log: str | None = None,
        verbose: int = 0,
        seed: int | None = None,
        device: torch.device | str = "auto",
        _init_setup_model: bool = True,
        **settings: Any,
    ) -> None:
        if env is None and _init_setup_model:
            raise InputError("there is no environment to learn in: give env=")
        given: dict[str, Any] = dict(settings)
        named = {"policy": policy, "learning_rate": learning_rate}
        given |= {name: value for name, value in named.items() if value is not None}
        if given.get("offline_epochs", 0) is None:
            del given["offline_epochs"]
        if isinstance(own := given.get("policy_kwargs"), dict):
            given["policy_kwargs"] = translate_policy_kwargs(own)
        if isinstance(env, str):
            env_id = environment_id(env)
            if "AnimaRL/" in env or (env not in gym.registry and env_id in gym.registry):
                if env_id not in gym.registry:
                    get_species(env)  # refuses it
                options: dict[str, Any] = {}
                if isinstance(demonstrations, Demonstrations):
                    options["demos"], demonstrations = demonstrations, None
                env = gym.make(env_id, **options)
        whole = constructor_settings(self.preset, self.pretrained_preset, env, given)
        policy = whole.pop("policy")
        if policy not in self.policy_aliases and isinstance(policy, str):
            raise InputError(
                f"policy {policy!r} is unknown: choose {' or '.join(self.policy_aliases)}"
            )
        made = None if env is None else maybe_make_env(env, verbose)
        if made is not None:
            check_observation(made.observation_space)
        policy_kwargs = dict(whole["policy_kwargs"])
        species = getattr(getattr(env, "scenario", None), "species", None)
        if getattr(species, "is_group", False):  # animals that are alike, with recordings or not
            policy_kwargs.setdefault("shared", True)
        try:
            super().__init__(
                policy,
                made,  # type: ignore[arg-type]
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
        vars(self).update(whole)
        self.demonstrations = demonstrations
        self.exploration_rate = self.exploration_initial_eps
        self.offline_progress = OfflineProgress()
        self.schedule = UpdateSchedule()
        self.acting_rule: Acting | None = None
        self.saved_by = self._kind()
        if _init_setup_model:
            recurrent = self.policy_class.recurrent
            check_setting_combinations(vars(self), self.recipe, recurrent, self.quantiles)
            self._setup_model()
            assert self.env is not None
            check_environment_supports(self.recipe, self.env, self.layout, self.alpha)
            if isinstance(demonstrations, Demonstrations):
                self.demonstrations = self._as_data(demonstrations)
            if demonstrations is not None:
                self.check_learnable()
            elif self.offline_epochs:  # there, though not looked at yet
                self.demonstration_data()

    @classmethod
    def _kind(cls) -> dict[str, Any]:
        """Return what a zip file says of the learner that it is of."""
        return {"name": cls.__name__, "recipe": cls.recipe.name, "quantiles": cls.quantiles}

    def _as_data(self, demos: Demonstrations) -> Any:
        """Return demonstrations in the terms of the environment, labelled as the preset says."""
        assert self.env is not None
        name = self.pretrained_preset if self.recipe.online else self.preset
        options = learner_preset(name or self.preset, section_of(self.env)).env_kwargs
        labels = {key: value for key, value in options.items() if key in LABEL_OPTIONS}
        return demonstrations_in(self.env, demos, self.layout, **labels)

    # -- set up -----------------------------------------------------------------------------------

    def _setup_model(self) -> None:
        self.train_freq = as_frequency(self.train_freq)  # type: ignore[assignment]
        if self.seed is not None:
            self.seed = check_value("seed", self.seed, Seed)
        self.offline_settings = OfflineSettings.of(self.offline_kwargs, "offline_kwargs: ")
        self._setup_lr_schedule()
        self.set_random_seed(self.seed)
        if self.env is not None:
            layout = SlotLayout.of(self.env)
            if (learned := vars(self).get("layout")) is not None:  # a file's
                refuse_other_slots(layout, learned)
            self.layout = layout
            self.episode_limit = longest_episode(self.env, self.max_episode_steps)
        self.target_update = as_frequency(self.target_update_interval)
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
        # One that never acts keeps nothing: of many animals the memory would be huge.
        rows = self.buffer_size
        if not self.recipe.online:
            rows = min(rows, self.episode_limit + 1)
        return SequenceReplayBuffer(
            rows,
            self.observation_size,
            self.layout.num_individuals,
            self.policy.num_actions,
            self.episode_limit,
            self.layout.num_copies,
            sequence_length=self.sequence_length,
            burn_in=self.burn_in,
            state_mode=self.state_mode,
            state_size=self.q_net.units,
            prioritized=self.prioritized,
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

        Raises
        ------
        InputError
            If the individuals, what they observe, the spaces or the number of copies differ, or if
            episodes may last longer than the replay memory holds, or nobody says how long.
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
            limit, held = self.max_episode_steps or declared_limit(slots), self.episode_limit
            if limit is not None and held is not None and limit > held:
                raise InputError(
                    f"its episodes last up to {limit} steps and the replay memory holds {held}: "
                    "give one with a shorter time limit"
                )
        try:
            super().set_env(slots, force_reset)
        except (AssertionError, ValueError) as error:
            self.n_envs = copies
            raise InputError(f"the environment does not suit this learner: {error}") from error
        if new:
            self.layout = layout
            self.episode_limit = longest_episode(slots, self.max_episode_steps)
            self.replay_buffer = self._make_replay_buffer()

    def phase(self, name: str) -> Phase:
        """Return the numbers of the ``"online"`` or ``"offline"`` phase."""
        online = name == "online"
        own = ("gamma", "alpha", "lambda2", "lambda3", "max_grad_norm")
        return Phase(
            name=name,
            lambda1=self.lambda1,
            scaled_penalties=self.offline_scaled_penalties and not online,
            n_steps=self.n_steps if online else 1,
            **{key: getattr(self, key if online else f"offline_{key}") for key in own},
        )

    # -- act --------------------------------------------------------------------------------------

    def predict(self, *observation: Any, **memory: Any) -> tuple[NDArray[Any], State]:  # type: ignore[override]
        """Actions of all slots and their memories; see :meth:`GruPolicy.predict`."""
        return self.policy.predict(*observation, **memory)

    def remember(self, state: State, executed: NDArray[np.integer]) -> State:
        """See :meth:`GruPolicy.remember`."""
        return self.policy.remember(state, executed)

    def leave_out(self, state: State, over: NDArray[np.bool_]) -> State:
        """See :meth:`GruPolicy.leave_out`."""
        return self.policy.leave_out(state, over)

    # -- save -------------------------------------------------------------------------------------

    def save(
        self,
        path: checkpoint.Place,
        exclude: Iterable[str] | None = None,
        include: Iterable[str] | None = None,
    ) -> None:
        """All settings, the networks and the acting rule, as in stable-baselines3."""
        self.acting_rule = self.policy.acting
        with checkpoint.whole_file(path, ".zip") as file:
            super().save(file, exclude, include)

    @classmethod
    def load(cls, path: checkpoint.Place, *arguments: Any, **keywords: Any) -> Self:  # type: ignore[override]
        """A learner from :meth:`save`; arguments as in stable-baselines3.

        The file holds pickles, which can run code: load only your own.

        Raises
        ------
        InputError
            If another class saved it, ``env`` has other individuals or shows other things, or a
            setting given anew is unknown, out of its range, or does not go with the others.
        """
        given = {name: value for name, value in keywords.items() if name not in OF_LOAD}
        keywords |= check_settings(given)
        with checkpoint.loading(path, cls._kind()):
            model = super().load(path, *arguments, **keywords)
        if given:
            recurrent = model.policy_class.recurrent
            check_setting_combinations(vars(model), cls.recipe, recurrent, cls.quantiles)
        return model

    def save_replay_buffer(self, path: checkpoint.Place) -> None:
        """Write the replay memory as an ``npz`` archive, whatever the name of ``path``."""
        checkpoint.save_replay(self._require_buffer(), path)

    def load_replay_buffer(self, path: checkpoint.Place, truncate_last_traj: bool = True) -> None:
        """Read the finished episodes of :meth:`save_replay_buffer`; training begins new ones.

        Raises
        ------
        InputError
            If it is none, or was saved with other settings.
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
        return [*super()._excluded_save_params(), *NOT_IN_ZIP]

    def _get_torch_save_params(self) -> tuple[list[str], list[str]]:
        return ["policy", "policy.optimizer"], []

    def identity(self) -> dict[str, Any]:
        """Return what a checkpoint must agree with, JSON-like."""
        return {
            "algorithm": type(self).__name__,
            "policy": self.policy_class.__name__,
            "individuals": list(self.layout.individuals),
            "num_copies": self.layout.num_copies,
            "observation_size": self.observation_size,
            "num_actions": self.policy.num_actions,
            "parameters": self.q_net.num_parameters,
            "buffer_size": self.buffer_size,
        }

    def training_state(self) -> checkpoint.State:
        """Return all that is needed to go on exactly, but the replay memory."""
        policy, progress = self.policy, self.offline_progress
        counters = {name: getattr(self, name) for name in COUNTERS} | {
            "schedule": vars(self.schedule),
            "offline_progress": progress.to_json(),
            "policy_random_state": policy.random_state,
            "acting": policy.acting.to_json(),
            "late_episodes": [
                {key: float(value) for key, value in info.items()}
                for info in self.ep_info_buffer or ()
            ],
        }
        arrays: dict[str, NDArray[Any]] = {}
        env: Any = self.env
        whole = hasattr(env, "get_state") and is_observed_as_declared(env, "get_state")
        if whole and self._last_obs is not None:
            arrays = {f"env/{key}": value for key, value in env.get_state().items()}
            arrays["last_observation"] = np.asarray(self._last_obs)
            arrays["episode_starts"] = np.asarray(self._last_episode_starts)
            arrays["hidden"], arrays["previous_action"] = self.memory
        tensors = {
            "q_net": policy.q_net.state_dict(),
            "q_net_target": policy.q_net_target.state_dict(),
            "optimizer": policy.optimizer.state_dict(),
            "best_weights": progress.best_weights,
            "average_weights": progress.average_weights,
        }
        return counters, arrays, tensors

    def restore_training_state(self, state: checkpoint.State) -> None:
        """Go on from a :meth:`training_state`.

        An environment without ``get_state`` and ``set_state``, or in a wrapper that changes its
        observations, starts new episodes instead of continuing those that were running.
        """
        counters, arrays, tensors = state
        policy, average = self.policy, tensors["average_weights"]
        if average is not None:  # follows the networks, where they are
            average = {name: value.to(self.device) for name, value in average.items()}
        vars(self).update({name: counters[name] for name in COUNTERS})
        self.schedule = UpdateSchedule(**counters["schedule"])
        self.offline_progress = OfflineProgress(
            **counters["offline_progress"],
            best_weights=tensors["best_weights"],
            average_weights=average,
        )
        policy.random_state = counters["policy_random_state"]
        policy.acting = Acting.from_json(counters["acting"])
        self.ep_info_buffer = deque(counters["late_episodes"], maxlen=self._stats_window_size)
        self.ep_success_buffer = deque(maxlen=self._stats_window_size)
        policy.q_net.load_state_dict(tensors["q_net"])
        policy.q_net_target.load_state_dict(tensors["q_net_target"])
        policy.optimizer.load_state_dict(tensors["optimizer"])
        self._last_obs = None
        if "last_observation" in arrays:
            env_state = {key[4:]: value for key, value in arrays.items() if key[:4] == "env/"}
            self.env.set_state(env_state)  # type: ignore[union-attr]
            self._last_obs = arrays["last_observation"]
            self._last_episode_starts = arrays["episode_starts"]
            self.memory = (arrays["hidden"], arrays["previous_action"])
