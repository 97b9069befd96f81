"""rl_zoo3's experiment manager, with this project's settings and environments.

All individuals learn; scores come from the validation split.
"""

import sys
import time
import warnings
from contextlib import closing
from copy import deepcopy
from pathlib import Path
from typing import Any

import numpy as np
import optuna
import yaml
from rl_zoo3 import ALGOS
from rl_zoo3.callbacks import TrialEvalCallback
from rl_zoo3.exp_manager import ExperimentManager
from rl_zoo3.hyperparams_opt import HYPERPARAMS_SAMPLER
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback, EvalCallback
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.logger import configure
from stable_baselines3.common.monitor import ResultsWriter
from stable_baselines3.common.vec_env import VecEnv, VecEnvWrapper, VecMonitor
from stable_baselines3.common.vec_env.base_vec_env import VecEnvObs, VecEnvStepReturn

from animarl_algos.data.vec_env import MixedMeansWarning, SlotVecEnv
from animarl_algos.learner.algorithm import SequenceQLearning
from animarl_algos.learner.checkpoint import summarise_error
from animarl_algos.learner.presets import learner_preset
from animarl_algos.networks.acting_rule import Kind
from animarl_algos.recipes.registry import named_recipe
from animarl_algos.runs.run_settings import environment_options
from animarl_envs.errors import InputError

EVAL_BY_LENGTH = 0
"""An evaluation frequency that stands for a tenth of the run, at most :data:`MOST_BETWEEN`."""
MOST_BETWEEN = 25_000
"""Steps of the world; rl_zoo3's own default, longer than many a run."""
UNSET_STEPS = -1
"""rl_zoo3's ``--n-timesteps`` where the user gives none: those of the preset."""
TRAINING_ONLY_OPTIONS = {
    "copies": "give -params n_envs:16",
    "split": "it learns from train and is scored on val",
}
"""Options of the slot VecEnv that are no environment's, and what to do instead."""
QUANTILES = (10, 20, 50)


def sample_settings(trial: optuna.Trial, algo: str, given: dict[str, Any]) -> dict[str, Any]:
    """Sample hyperparameters for a recipe; settings that are given are not sampled."""
    named = named_recipe(algo)
    recipe = named.algorithm.recipe
    scales: dict[str, tuple[float, float]] = {}  # logarithmic
    if recipe.online:
        scales |= {"learning_rate": (1e-6, 1e-3), "updates_per_episode": (0.25, 4.0)}
    if named.pretrained:
        scales |= {"offline_learning_rate": (1e-5, 1e-2)}
    for weight, used, online, offline in (
        ("alpha", recipe.needs_distance, (0.01, 10.0), (0.1, 50.0)),
        ("lambda2", recipe.needs_condition, (0.1, 10.0), (0.1, 50.0)),
        ("lambda3", recipe.needs_alignment, (0.1, 50.0), (0.1, 100.0)),
    ):
        if used and recipe.online:
            scales[weight] = online
        if used and named.pretrained:
            scales[f"offline_{weight}"] = offline
    linear = {"gamma": (0.8, 0.99), "exploration_final_eps": (0.02, 0.5)} if recipe.online else {}
    drawn: dict[str, Any] = {
        name: trial.suggest_float(name, *ends, log=name in scales)
        for name, ends in (scales | linear).items()
        if name not in given
    }
    if algo.startswith("qr-") and "n_quantiles" not in (given.get("policy_kwargs") or {}):
        quantiles = trial.suggest_categorical("n_quantiles", QUANTILES)
        drawn["policy_kwargs"] = {"n_quantiles": quantiles}
    return drawn


class AnimalExperimentManager(ExperimentManager):  # type: ignore[misc]
    """Settings from a preset; AnimaRL ids as slots in training, as validation in evaluation."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self.species = species_of_id(self.env_name.gym_id)
        self.preset = self.args.preset

    # -- settings ---------------------------------------------------------------------------------

    def read_hyperparameters(self) -> tuple[dict[str, Any], dict[str, Any]]:
        """Return the settings of the preset with those of the command line over them, checked."""
        overrides, file = self.custom_hyperparams or {}, self.args.conf_file
        preset = learner_preset(
            self.algo, self.env_name.gym_id, self.preset, overrides, config=file
        )
        given, options = self._eval_env_kwargs_args or {}, dict(self.env_kwargs)
        if self.species is not None:
            for name, instead in TRAINING_ONLY_OPTIONS.items():
                if name in options | given:
                    raise InputError(f"--env-kwargs {name}: training sets it itself: {instead}")
            options = preset.env_kwargs | options
        self.eval_env_kwargs = options | given
        run = {"n_timesteps": preset.n_timesteps, "n_envs": preset.n_envs, "env_kwargs": options}
        settings = preset.arguments | run
        source = file or f"zoo_configs/{self.algo}.yml ({self.preset})"
        print(f"Settings from {source}:\n{yaml.safe_dump(settings)}")
        # A trained agent brings what the preset leaves open; a new one takes it from the files.
        whole = vars(preset.settings) | deepcopy(run)
        network = whole["policy_kwargs"]
        samples = whole["exploration"] == "boltzmann" or "temperature" in network
        self.deterministic_eval = self.deterministic_eval and not samples

        def sample(trial: optuna.Trial, *_: Any) -> dict[str, Any]:
            drawn = sample_settings(trial, self.algo, overrides)
            return drawn | {"policy_kwargs": network | drawn.get("policy_kwargs", {})}

        samplers: dict[str, Any] = HYPERPARAMS_SAMPLER
        samplers[self.algo] = sample
        return deepcopy(settings) if self.continue_training else whole, settings

    def setup_experiment(self) -> tuple[BaseAlgorithm, dict[str, Any]] | None:
        """rl_zoo3's; the folder is made, with settings and command, once the learner is checked."""
        if self.optimize_hyperparameters:
            algorithm = named_recipe(self.algo).algorithm
            learners: dict[str, Any] = ALGOS
            # Every trial has the same seed, so that settings alone differ.
            learners[self.algo] = lambda **given: algorithm(**given | {"seed": self.seed})
        result: tuple[BaseAlgorithm, dict[str, Any]] | None = super().setup_experiment()
        if result is not None:
            model, settings = result
            assert isinstance(model, SequenceQLearning)
            model.check_learnable()
            folder = Path(self.params_path)
            for place in (Path(self.log_folder), folder):
                place.mkdir(parents=True, exist_ok=True)
            (folder / "config.yml").write_text(yaml.safe_dump(settings))
            arguments = {key: _plain(value) for key, value in vars(self.args).items()}
            (folder / "args.yml").write_text(yaml.safe_dump(arguments))
            (folder / "command.txt").write_text(" ".join(sys.orig_argv))
            print(f"Log path: {self.save_path}")
        return result

    def _save_config(self, saved_hyperparams: dict[str, Any]) -> None:
        """Do nothing yet: see :meth:`setup_experiment`."""

    def create_log_folder(self) -> None:
        """Do nothing yet: see :meth:`setup_experiment`."""

    # -- environments -----------------------------------------------------------------------------

    def create_envs(self, n_envs: int, eval_env: bool = False, no_log: bool = False) -> VecEnv:
        """Slots that all learn; for evaluation, slots that start from the validation split."""
        if self.species is None:
            return super().create_envs(n_envs, eval_env, no_log=True)
        make = validation_environment if eval_env else slot_environment
        options = self.eval_env_kwargs if eval_env else self.env_kwargs
        env = make(self.env_name.gym_id, n_envs, **options)
        env.seed(self.seed)
        if eval_env:  # as many episodes of the world as were asked for, each of several slots
            self.n_eval_episodes = self.args.eval_episodes * env.num_envs // n_envs
        return env

    def create_callbacks(self) -> None:
        """Make rl_zoo3's and, without Monitor's files, the log of episodes that plots read."""
        if not self.optimize_hyperparameters:
            self.callbacks.append(EpisodeLog(Path(self.save_path), self.env_name.gym_id))
        if self.eval_freq == EVAL_BY_LENGTH:
            self.eval_freq = min(MOST_BETWEEN, max(1, self.n_timesteps // 10))
            self.args.eval_freq = self.eval_freq
        # rl_zoo3 divides by the copies, but these learners call back once for each world step.
        self.save_freq, self.eval_freq = (
            frequency * self.n_envs for frequency in (self.save_freq, self.eval_freq)
        )
        super().create_callbacks()  # type: ignore[no-untyped-call]

    # -- learning ---------------------------------------------------------------------------------

    def _load_pretrained_agent(self, hyperparams: dict[str, Any], env: VecEnv) -> BaseAlgorithm:
        """rl_zoo3's; a file that is no model, or one for another environment, is refused."""
        try:
            return super()._load_pretrained_agent(hyperparams, env)
        except InputError as error:
            reason, place = str(error), str(self.trained_agent)
            raise InputError(reason if reason.startswith(place) else f"{place}: {reason}") from None
        except Exception as error:  # reading damaged pickles can raise any
            reason = summarise_error(error) or type(error).__name__
            raise InputError(
                f"{self.trained_agent}: it is no model of {self.algo} ({reason}): name one that "
                "'train' saved with this --algo and --env"
            ) from error

    def learn(self, model: BaseAlgorithm) -> None:
        """Train, with learning curves as CSV and TensorBoard in the folder of the run.

        A policy that samples is scored as it acts.
        """
        assert isinstance(model, SequenceQLearning)
        fitted = model.settings.exploration == "boltzmann"  # once the offline phase is over
        samples = fitted or model.policy.acting.kind is Kind.BOLTZMANN
        for callback in self.callbacks:
            if isinstance(callback, EvalCallback):
                callback.deterministic = callback.deterministic and not samples
        if self.tensorboard_log is not None:  # stable-baselines3 writes there by itself
            super().learn(model)
            return
        outputs = ["csv", "tensorboard"]
        if self.verbose > 0 and not self.show_progress:
            outputs.append("stdout")
        with closing(configure(self.save_path, outputs)) as logger:
            model.set_logger(logger)
            super().learn(model)

    def hyperparameters_optimization(self) -> None:
        """rl_zoo3's, with a word where no trial came to its end."""
        Path(self.log_path).mkdir(parents=True, exist_ok=True)
        try:
            super().hyperparameters_optimization()
        except ValueError as error:
            if "No trials are completed" not in str(error):
                raise
            raise InputError(
                "no trial came to its end: give more --n-trials or --pruner none"
            ) from error


def _plain(value: Any) -> Any:
    return value if isinstance(value, str | int | float | bool | list | dict | None) else str(value)


class FinalScore(TrialEvalCallback):  # type: ignore[misc]
    """rl_zoo3's evaluation of a trial, whose last score is that at the end of training."""

    def _init_callback(self) -> None:
        super()._init_callback()
        assert isinstance(self.model, SequenceQLearning)
        self.eval_freq *= self.model.layout.num_copies  # by which rl_zoo3 has divided it

    def _on_training_end(self) -> None:
        if not self.is_pruned:
            score, _ = evaluate_policy(
                self.model,
                self.eval_env,
                n_eval_episodes=self.n_eval_episodes,
                deterministic=self.deterministic,
            )
            self.last_mean_reward = float(np.mean(score))


class EpisodeLog(BaseCallback):
    """Write return, length [steps] and time [s] of each training episode to ``0.monitor.csv``.

    rl_zoo3's plots read it. The return is the ``episode`` entry of the infos: of a
    :class:`~animarl_algos.data.vec_env.SlotVecEnv` the task return, a mean over the pursuers that
    learn.
    """

    def __init__(self, folder: Path, env_id: str) -> None:
        super().__init__()
        self.folder, self.env_id = folder, env_id
        self._writer: ResultsWriter | None = None

    def _on_training_start(self) -> None:
        self._began = time.time()
        header: dict[str, float | str] = {"t_start": self._began, "env_id": self.env_id}
        self._writer = ResultsWriter(str(self.folder / "0.monitor.csv"), header=header)

    def _on_step(self) -> bool:
        assert self._writer is not None
        for info in self.locals["infos"]:
            if "episode" in info:
                episode = {key: info["episode"][key] for key in ("r", "l")}
                self._writer.write_row(episode | {"t": round(time.time() - self._began, 6)})
        return True

    def _on_training_end(self) -> None:
        if self._writer is not None:
            self._writer.close()


# -- environments ----------------------------------------------------------------------------------

NOT_SLOTS = ("others", "render_mode")
"""Options of a single environment that the slot VecEnv has not."""


def species_of_id(env_id: str) -> str | None:
    """Return the species of an AnimaRL id, None for any other environment that is registered."""
    species = environment_options(env_id).get("species")
    return species if isinstance(species, str) else None


def slot_environment(
    env_id: str, copies: int, *, split: str = "train", **options: Any
) -> SlotVecEnv:
    """Return the slot VecEnv of an AnimaRL id; ``options`` win over its registered ones.

    The condition is the last observation component if the species has conditions and the
    demonstrations hold both.
    """
    registered = {k: v for k, v in environment_options(env_id).items() if k not in NOT_SLOTS}
    options = {"condition_flag": None} | registered | options
    return SlotVecEnv(options.pop("species"), copies, split=split, **options)


def validation_environment(env_id: str, copies: int, **options: Any) -> VecEnv:
    """Return what policies are scored in: episodes of the validation split, :class:`Scored`."""
    options["dtw"] = "closeness"  # whatever the learner is paid for, scores are comparable
    slots = Scored(slot_environment(env_id, copies, split="val", **options))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", MixedMeansWarning)  # the score is a mean over all
        return VecMonitor(slots)


class Scored(VecEnvWrapper):
    """Pays the task reward and up to 1 a step for closeness to the recorded path.

    An episode's return is what it achieved, and how much of its recording it followed
    (:mod:`animarl_envs.dtw`), per individual: the score by which rl_zoo3 picks the best model and
    optuna the best settings. (A score by the distance alone is best for whoever ends at once.)
    Without demonstrations it is the task return.
    """

    venv: SlotVecEnv

    def reset(self) -> VecEnvObs:
        """Reset, and begin new episode scores."""
        return self.venv.reset()

    def step_wait(self) -> VecEnvStepReturn:
        """Step, and write scores of ended episodes to ``infos``."""
        observations, rewards, dones, infos = self.venv.step_wait()
        if "dtw_penalty" in self.venv.extras:
            rewards = rewards - self.venv.extras["dtw_refund"] - self.venv.extras["dtw_penalty"]
        return observations, rewards, dones, infos
