"""``python -m animarl_algos.zoo train|optimize``."""

from __future__ import annotations

import argparse
import importlib.util
import sys
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import rl_zoo3
import rl_zoo3.exp_manager
import rl_zoo3.hyperparams_opt
import rl_zoo3.train
import torch
import yaml

from animarl_algos.learner.presets import PRESETS
from animarl_algos.recipes.registry import RECIPES
from animarl_algos.runs.run_settings import check_device
from animarl_algos.zoo.environments import species_of_id
from animarl_algos.zoo.manager import EVAL_BY_LENGTH, AnimalExperimentManager
from animarl_algos.zoo.samplers import sampler
from animarl_envs.checks import printable
from animarl_envs.errors import InputError
from animarl_envs.files import unreadable_or_unwritable

USAGE = """python -m animarl_algos.zoo COMMAND ...

train     learn, with rl_zoo3's options and --preset paper|default
optimize  tune with optuna into SQLite, scored on the validation split

Examples:

  python -m animarl_algos.zoo train --algo dqdil --env AnimaRL/Agent-v0 --n-timesteps 20000 --seed 1
  python -m animarl_algos.zoo optimize --algo dqdil --env AnimaRL/Agent-v0 --n-timesteps 20000 \\
      --n-trials 20

COMMAND --help lists the options of a command."""

TRAIN_NOTE = """Learners of this project through rl_zoo3, whose options follow. Beside them:

  --preset {paper,default}  settings of zoo_configs/<algo>.yml (default: default)
  --eval-freq               unless given: a tenth of the steps, at most 25,000; -1 for none

KEY:VALUE pairs are YAML, never evaluated (-params learning_rate:0.001 offline_epochs:5).
'optimize' does not tune what -params gives.
AnimaRL ids train all individuals; --env-kwargs focal:prey trains one. The model, its settings,
learning curves (CSV, TensorBoard) and evaluations on the validation split go to
<log-folder>/<algo>/<env>_<number>. -i loads a zip file, which holds pickles: only your own.
"""

DEFAULT_ALGO = "dqdil-pt"


class StoreData(argparse.Action):
    """``KEY:VALUE ...`` as a dictionary; values are YAML data (rl_zoo3 evaluates them)."""

    def __call__(
        self,
        parser: argparse.ArgumentParser,
        namespace: argparse.Namespace,
        values: str | Sequence[Any] | None,
        option_string: str | None = None,
    ) -> None:
        stored = {}
        for pair in values or []:
            key, colon, value = pair.partition(":")
            if not colon:
                raise InputError(f"{option_string} {pair}: write KEY:VALUE")
            try:
                stored[key] = yaml.safe_load(value)
            except yaml.YAMLError:
                raise InputError(f"{option_string} {pair}: the value is not valid YAML") from None
        setattr(namespace, self.dest, stored)


def register() -> None:
    """Put the learners, and what optuna may choose for them, into rl_zoo3's tables."""
    rl_zoo3.ALGOS.clear()
    rl_zoo3.ALGOS.update({name: named.algorithm for name, named in RECIPES.items()})
    samplers: dict[str, Any] = rl_zoo3.hyperparams_opt.HYPERPARAMS_SAMPLER
    samplers.update({name: sampler(name) for name in RECIPES})


def train(arguments: list[str]) -> None:
    """rl_zoo3's training with this project's manager."""
    own = argparse.ArgumentParser(add_help=False, allow_abbrev=False)
    own.add_argument("--preset", choices=PRESETS, default="default")
    asked, rest = own.parse_known_args(arguments)
    if {"-h", "--help"} & set(rest):
        print(TRAIN_NOTE)
    peeked = _peek(rest)
    if peeked.env is not None:
        for package in peeked.gym_packages:
            __import__(package)
        species_of_id(peeked.env)
    if peeked.device != "auto":
        check_device(peeked.device)
    model = peeked.trained_agent
    if model is not None and not (model.suffix == ".zip" and model.is_file()):
        raise InputError(f"{model}: there is no such zip file: name a model that 'train' saved")
    if peeked.track and importlib.util.find_spec("wandb") is None:
        raise InputError("--track needs Weights & Biases: pip install wandb, or leave it out")
    if peeked.n_trials < 1:
        raise InputError(f"--n-trials is {peeked.n_trials}: give at least 1")
    torch.set_num_threads(1)

    class Manager(AnimalExperimentManager):
        preset = asked.preset

    vars(rl_zoo3.train).update(ExperimentManager=Manager, StoreDict=StoreData)
    warnings.filterwarnings("ignore", message="Training and eval env are not of the same type")
    # The last of a repeated option counts, so these only if the user gives none.
    defaults = [f"--algo={DEFAULT_ALGO}", f"--eval-freq={EVAL_BY_LENGTH}"]
    sys.argv = ["python -m animarl_algos.zoo train", *defaults, *rest]
    rl_zoo3.train.train()


def optimize(arguments: list[str]) -> None:
    """Training with ``-optimize``, into an SQLite file beside the logs unless told otherwise."""
    peeked = _peek(arguments)
    if peeked.storage is None:
        file = Path(peeked.log_folder) / peeked.algo / "optuna.db"
        arguments += ["--storage", f"sqlite:///{file}"]
    if peeked.study_name is None:
        arguments += ["--study-name", f"{peeked.algo} {peeked.env}"]
    train([*arguments, "-optimize", "--no-optim-plots"])


def _peek(arguments: list[str]) -> argparse.Namespace:
    """A look at some of rl_zoo3's options before it parses them itself, abbreviated or not."""
    look = argparse.ArgumentParser(add_help=False)
    look.add_argument("--algo", default=DEFAULT_ALGO)
    for option in ("--env", "--storage", "--study-name"):
        look.add_argument(option)
    look.add_argument("-f", "--log-folder", default="logs")
    look.add_argument("-i", "--trained-agent", type=Path)
    look.add_argument("--device", default="auto")
    look.add_argument("--track", action="store_true")
    look.add_argument("--n-trials", type=int, default=1)
    look.add_argument("--gym-packages", nargs="+", default=[])
    return look.parse_known_args(arguments)[0]


COMMANDS: dict[str, Callable[[list[str]], None]] = {
    "train": train,
    "optimize": optimize,
}


def main() -> None:
    """Entry point; bad input is one sentence and exit code 2."""
    arguments = sys.argv[1:]
    if not arguments or arguments[0] in ("-h", "--help"):
        print(USAGE)
        sys.exit(0 if arguments else 2)
    try:
        if arguments[0] not in COMMANDS:
            raise InputError(f"command {arguments[0]!r} is unknown: choose {', '.join(COMMANDS)}")
        register()
        COMMANDS[arguments[0]](arguments[1:])
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
