"""``python -m animarl_algos.zoo train|optimize``."""

import argparse
import importlib
import importlib.util
import sys
import warnings
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import rl_zoo3
import rl_zoo3.exp_manager
import rl_zoo3.train
import torch

from animarl_algos.cli.shared import parse_settings
from animarl_algos.learner.callbacks import ProgressBar
from animarl_algos.learner.presets import PRESETS
from animarl_algos.recipes.registry import RECIPES
from animarl_algos.runs.run_settings import check_device
from animarl_algos.zoo import manager
from animarl_envs.errors import InputError, printable
from animarl_envs.files import unreadable_or_unwritable
from animarl_envs.settings import Count, check_value

COMMANDS = ("train", "optimize")
USAGE = """python -m animarl_algos.zoo COMMAND ...

train     learn, with rl_zoo3's options and --preset paper|default
optimize  tune with optuna into SQLite, scored on the validation split

Examples:

  python -m animarl_algos.zoo train --algo dqdil --env AnimaRL/Agent-v0 --n-timesteps 20000 --seed 1
  python -m animarl_algos.zoo optimize --algo dqdil --env AnimaRL/Agent-v0 --n-timesteps 20000 \\
      --n-trials 20

COMMAND --help lists the options of a command."""

NOTE = """Learners of this project through rl_zoo3, with its options and --preset.

Unless given, --eval-freq is a tenth of the steps, at most 25,000; -1 is for none.
KEY:VALUE pairs are YAML, never evaluated (-params learning_rate:0.001 offline_epochs:5).
'optimize' does not tune what -params gives.
An AnimaRL id is the world of gym.make(id), in which all individuals learn; --env-kwargs focal:prey
trains one. The model, its settings,
learning curves (CSV, TensorBoard) and evaluations on the validation split go to
<log-folder>/<algo>/<env>_<number>. -i loads a zip file, which holds pickles: only your own.
"""


class Parser(argparse.ArgumentParser):
    """rl_zoo3's options and ``--preset``; refuses what would end in a traceback of rl_zoo3."""

    def parse_args(self, *args: Any, **kwargs: Any) -> argparse.Namespace:  # type: ignore[override]
        """Parse arguments as rl_zoo3 does, without evaluating any."""
        self.description, self.formatter_class = NOTE, argparse.RawDescriptionHelpFormatter
        settings = "Settings of zoo_configs/<algo>.yml"
        self.add_argument("--preset", choices=PRESETS, default="default", help=settings)
        self.set_defaults(algo="dqdil-pt", eval_freq=manager.EVAL_BY_LENGTH)
        options: argparse.Namespace = super().parse_args(*args, **kwargs)
        for package in options.gym_packages:
            importlib.import_module(package)
        manager.species_of_id(options.env)
        if options.device != "auto":
            check_device(options.device)
        model = Path(options.trained_agent)
        if options.trained_agent and not (model.suffix == ".zip" and model.is_file()):
            raise InputError(f"{model}: there is no such zip file: name a model that 'train' saved")
        if options.track and importlib.util.find_spec("wandb") is None:
            raise InputError("--track needs Weights & Biases: pip install wandb, or leave it out")
        if options.trial_id is not None:
            raise InputError("--trial-id is not supported: give the trial's settings by -params")
        for name in ("eval_episodes", "n_eval_envs", "n_trials", "n_timesteps"):
            if getattr(options, name) != manager.UNSET_STEPS or name != "n_timesteps":
                check_value(f"--{name.replace('_', '-')}", getattr(options, name), Count)
        check_value("--n-evaluations", options.n_evaluations, Count | None)
        if options.optimize_hyperparameters:
            database = Path(options.log_folder) / options.algo / "optuna.db"
            options.storage = options.storage or f"sqlite:///{database}"
            options.study_name = options.study_name or f"{options.algo} {options.env}"
        return options


class StoreData(argparse.Action):
    """``KEY:VALUE ...`` as a dictionary; values are YAML data (rl_zoo3 evaluates them)."""

    def __call__(self, parser: Any, namespace: Any, values: Any, option_string: Any = None) -> None:
        """Store pairs ``key:value`` as a dictionary of plain data."""
        setattr(namespace, self.dest, parse_settings(values, option_string, ":"))


def register() -> None:
    """Put the learners and what is changed of rl_zoo3 into its tables and modules."""
    rl_zoo3.ALGOS.clear()
    rl_zoo3.ALGOS.update({name: named.algorithm for name, named in RECIPES.items()})
    vars(rl_zoo3.exp_manager).update(
        ProgressBarCallback=ProgressBar, TrialEvalCallback=manager.FinalScore
    )
    vars(rl_zoo3.train).update(
        argparse=SimpleNamespace(ArgumentParser=Parser),
        ExperimentManager=manager.AnimalExperimentManager,
        StoreDict=StoreData,
    )


def main() -> None:
    """Entry point; bad input is one sentence and exit code 2."""
    command, *arguments = sys.argv[1:] or ["-h"]
    if command in ("-h", "--help"):
        print(USAGE)
        sys.exit(0 if sys.argv[1:] else 2)
    try:
        if command == "enjoy":
            raise InputError("a trained model is watched with 'animarl watch --model LOG_FOLDER'")
        if command not in COMMANDS:
            raise InputError(f"command {command!r} is unknown: choose {', '.join(COMMANDS)}")
        register()
        torch.set_num_threads(1)
        warnings.filterwarnings("ignore", message="Training and eval env are not of the same type")
        if command == "optimize":
            arguments += ["-optimize", "--no-optim-plots"]
        sys.argv = [f"python -m animarl_algos.zoo {command}", *arguments]
        rl_zoo3.train.train()
    except InputError as error:
        print(f"animarl_algos.zoo: {printable(str(error))}", file=sys.stderr)
        sys.exit(2)
    except OSError as error:
        print(f"animarl_algos.zoo: {unreadable_or_unwritable(error)}", file=sys.stderr)
        sys.exit(2)
    except KeyboardInterrupt:
        print("\nanimarl_algos.zoo: interrupted", file=sys.stderr)
        sys.exit(130)


if __name__ == "__main__":
    main()
