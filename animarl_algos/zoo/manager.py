"""rl_zoo3's experiment manager, with this project's settings and environments."""

from __future__ import annotations

import shutil
import sys
import time
from contextlib import closing, suppress
from copy import deepcopy
from pathlib import Path
from typing import Any

import numpy as np
import optuna
import yaml
from rl_zoo3.callbacks import TrialEvalCallback
from rl_zoo3.exp_manager import ExperimentManager
from rl_zoo3.hyperparams_opt import HYPERPARAMS_SAMPLER
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback, EvalCallback
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.logger import configure
from stable_baselines3.common.monitor import ResultsWriter
from stable_baselines3.common.vec_env import VecEnv

from animarl_algos.learner.algorithm import SequenceQLearning
from animarl_algos.learner.callbacks import ProgressBar
from animarl_algos.learner.checkpoint import summarise_error
from animarl_algos.learner.exploration import Exploration
from animarl_algos.learner.presets import learner_preset, merged
from animarl_algos.learner.settings import default_settings
from animarl_algos.networks.acting_rule import Kind
from animarl_algos.ranges import COUNT, COUNT_OR_NONE
from animarl_algos.recipes.registry import named_recipe
from animarl_algos.zoo.environments import (
    slot_environment,
    species_of_id,
    validation_environment,
)
from animarl_envs.errors import InputError
from animarl_envs.species import Species

EVAL_BY_LENGTH = 0
"""An evaluation frequency that stands for a tenth of the run, at most :data:`MOST_BETWEEN`."""
MOST_BETWEEN = 25_000
"""Steps of the world; rl_zoo3's own default, longer than many a run."""
UNSET_STEPS = -1
"""rl_zoo3's ``--n-timesteps`` where the user gives none: those of the preset."""
OF_TRAINING = {
    "copies": "give -params n_envs:16",
    "split": "it learns from train and is scored on val",
}
"""Options of the slot VecEnv that are no environment's, and what to do instead."""


class AnimalExperimentManager(ExperimentManager):  # type: ignore[misc]
    """Settings from a preset; AnimaRL ids as slots in training, as validation in evaluation.

    Attributes
    ----------
    preset
        ``"paper"`` or ``"default"``, set by a subclass.
    """

    preset = "default"

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        config = kwargs.get("config")
        self.own_config: str | None = config
        self.species = species_of_id(self.env_name.gym_id)
        if config is None:
            self.config = f"zoo_configs/{self.algo}.yml ({self.preset})"

    # -- settings ---------------------------------------------------------------------------------

    def read_hyperparameters(self) -> tuple[dict[str, Any], dict[str, Any]]:
        """Return the settings of the preset with those of the command line over them, checked."""
        if self.trial_id is not None:
            raise InputError("--trial-id is not supported: give the trial's settings by -params")
        overrides = self.custom_hyperparams or {}
        found = learner_preset(
            self.algo, self.env_name.gym_id, self.preset, overrides, config=self.own_config
        )
        self._check_numbers()
        given = self.env_kwargs | (self._eval_env_kwargs_args or {})
        for name, instead in OF_TRAINING.items():
            if self.species is not None and name in given:
                raise InputError(f"--env-kwargs {name}: training sets it itself: {instead}")
        options = found.env_kwargs if self.species is not None else {}
        if self.species is not None:  # said in full, whatever the default becomes
            options = {"observation": Species.observation} | options
        options = options | self.env_kwargs
        self.eval_env_kwargs = options | (self._eval_env_kwargs_args or {})
        settings = found.arguments | {
            "n_timesteps": found.n_timesteps,
            "n_envs": found.n_envs,
            "env_kwargs": options,
        }
        print(f"Settings from {self.config}:\n{yaml.safe_dump(settings)}")
        # A trained agent brings what the preset leaves open; a new one takes it from the files.
        open_ones = {} if self.continue_training else default_settings()
        return open_ones | deepcopy(settings), settings

    def _check_numbers(self) -> None:
        if self.n_timesteps != UNSET_STEPS:
            COUNT.check("--n-timesteps", self.n_timesteps)
        COUNT.check("--eval-episodes", self.n_eval_episodes)
        COUNT.check("--n-eval-envs", self.n_eval_envs)
        COUNT_OR_NONE.check("--n-evaluations", self.n_evaluations)

    def setup_experiment(self) -> tuple[BaseAlgorithm, dict[str, Any]] | None:
        """rl_zoo3's; a refused run leaves no folder behind."""
        run = Path(self.save_path)
        self._new_folders = [folder for folder in (run, *run.parents) if not folder.exists()]
        try:
            result: tuple[BaseAlgorithm, dict[str, Any]] | None = super().setup_experiment()
            if result is not None:
                assert isinstance(result[0], SequenceQLearning)
                result[0].check_learnable()
        except InputError:
            self._leave_no_folder()
            raise
        return result

    def _leave_no_folder(self) -> None:
        if self._new_folders:
            run, *above = self._new_folders
            shutil.rmtree(run, ignore_errors=True)
            with suppress(OSError):  # one that holds something stays, and so do those above it
                for folder in above:
                    folder.rmdir()

    def _save_config(self, saved_hyperparams: dict[str, Any]) -> None:
        """The settings as resolved and the command, as plain YAML."""
        folder = Path(self.params_path)
        (folder / "config.yml").write_text(yaml.safe_dump(saved_hyperparams))
        arguments = {key: _plain(value) for key, value in vars(self.args).items()}
        (folder / "args.yml").write_text(yaml.safe_dump(arguments | {"preset": self.preset}))
        (folder / "command.txt").write_text(" ".join(sys.orig_argv))
        print(f"Log path: {self.save_path}")

    # -- environments -----------------------------------------------------------------------------

    def create_envs(self, n_envs: int, eval_env: bool = False, no_log: bool = False) -> VecEnv:
        """Slots that all learn; for evaluation, slots that start from the validation split."""
        if self.species is None:
            return super().create_envs(n_envs, eval_env, no_log or self.optimize_hyperparameters)
        make = validation_environment if eval_env else slot_environment
        options = self.eval_env_kwargs if eval_env else self.env_kwargs
        env = make(self.env_name.gym_id, n_envs, **options)
        env.seed(self.seed)
        return env

    def create_log_folder(self) -> None:
        """Make no folder for tuning, which would leave it empty."""
        if not self.optimize_hyperparameters:
            super().create_log_folder()  # type: ignore[no-untyped-call]

    def create_callbacks(self) -> None:
        """rl_zoo3's, with a progress bar in steps of the world, every individual scored, and the
        log of episodes that plots read.
        """
        if self.species is not None and not self.optimize_hyperparameters:
            self.callbacks.append(EpisodeLog(Path(self.save_path), self.env_name.gym_id))
        if self.show_progress:
            self.callbacks.append(ProgressBar())
            self.show_progress = False
        if self.eval_freq == EVAL_BY_LENGTH:
            self.eval_freq = min(MOST_BETWEEN, max(1, self.n_timesteps // 10))
            self.args.eval_freq = self.eval_freq
        super().create_callbacks()  # type: ignore[no-untyped-call]
        for callback in self.callbacks:
            if isinstance(callback, EvalCallback):
                callback.n_eval_episodes = self._slot_episodes(callback.eval_env)

    def _slot_episodes(self, env: VecEnv) -> int:
        """Episodes of slots that make ``n_eval_episodes`` of the world."""
        return int(self.n_eval_episodes * env.num_envs // self.n_eval_envs)

    # -- learning ---------------------------------------------------------------------------------

    def _load_pretrained_agent(self, hyperparams: dict[str, Any], env: VecEnv) -> BaseAlgorithm:
        """rl_zoo3's; a file that is no model, or one for another environment, is refused."""
        try:
            return super()._load_pretrained_agent(hyperparams, env)
        except InputError as error:
            said, place = str(error), str(self.trained_agent)
            raise InputError(said if said.startswith(place) else f"{place}: {said}") from None
        except Exception as error:  # reading damaged pickles can raise any
            said = summarise_error(error) or type(error).__name__
            raise InputError(
                f"{self.trained_agent}: it is no model of {self.algo} ({said}): name one that "
                "'train' saved with this --algo and --env"
            ) from error

    def learn(self, model: BaseAlgorithm) -> None:
        """Train, with learning curves as CSV and TensorBoard in the folder of the run."""
        for callback in self.callbacks:
            if isinstance(callback, EvalCallback):
                callback.deterministic = self._scored_greedily(model)
        if self.tensorboard_log is not None:  # stable-baselines3 writes there by itself
            super().learn(model)
            return
        outputs = ["csv", "tensorboard"]
        shown = any(isinstance(callback, ProgressBar) for callback in self.callbacks)
        if self.verbose > 0 and not shown:
            outputs.append("stdout")
        with closing(configure(self.save_path, outputs)) as logger:
            model.set_logger(logger)
            super().learn(model)

    def _scored_greedily(self, model: BaseAlgorithm) -> bool:
        """Whether evaluation takes the best actions: not of a policy that acts by sampling."""
        assert isinstance(model, SequenceQLearning)
        fitted = model.exploration == Exploration.BOLTZMANN  # once the offline phase is over
        samples = fitted or model.policy.acting.kind is Kind.BOLTZMANN
        return bool(self.deterministic_eval) and not samples

    def objective(self, trial: optuna.Trial) -> float:
        """The score on the validation split at the end of training; unpromising trials stop early.

        Every trial has the same seed, so that settings alone differ.
        """
        given = self.custom_hyperparams or {}
        drawn = HYPERPARAMS_SAMPLER[self.algo](trial, self.n_actions, self.n_envs, given)
        arguments = merged(deepcopy(self._hyperparams), drawn)
        env = self.create_envs(self.n_envs, no_log=True)
        scored = self.create_envs(self.n_eval_envs, eval_env=True)
        episodes = self._slot_episodes(scored)
        try:
            model = named_recipe(self.algo).algorithm(
                env=env,
                seed=self.seed,
                device=self.device,
                verbose=max(0, self.verbose - 1),
                **arguments,
            )
            greedily = self._scored_greedily(model)
            watch = TrialEvalCallback(
                scored,
                trial,
                n_eval_episodes=episodes,
                eval_freq=max(1, self.n_timesteps // self.n_evaluations // self.n_envs),
                deterministic=greedily,
            )
            model.learn(self.n_timesteps, callback=watch)
            if watch.is_pruned:
                raise optuna.TrialPruned
            score, _ = evaluate_policy(
                model, scored, n_eval_episodes=episodes, deterministic=greedily
            )
        except InputError as error:  # offline training that diverged says so
            print(f"Trial {trial.number} is given up: {error}")
            raise optuna.TrialPruned from error
        finally:
            env.close()
            scored.close()
        return float(np.mean(score))

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


class EpisodeLog(BaseCallback):
    """Write return, length [steps] and time [s] of each training episode to ``0.monitor.csv``.

    rl_zoo3's plots read it. The return is the ``episode`` entry of the infos: of a
    :class:`~animarl_algos.data.vec_env.SlotVecEnv`, which has no ``Monitor``, the task return, a
    mean over the pursuers that learn.
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
                since = round(time.time() - self._began, 6)
                self._writer.write_row(info["episode"] | {"t": since})
        return True

    def _on_training_end(self) -> None:
        if self._writer is not None:
            self._writer.close()
