"""A run's folder: everything needed to repeat it, to continue it, and to show it.

settings.json       as resolved, with versions, machine, command and the demonstrations' fingerprint
demonstrations.npz  with their splits and provenance
locomotion.json     the fitted parameters
checkpoints/        the last whole checkpoint of each learner
policies/           final weights of each learner (tensors only), and the rule that it acts by
logs/               learning curves: CSV and TensorBoard
rollouts/           on the test split, by method
evaluation/         tables, and the verdict
wall_time.json      seconds by stage
report.html
"""

from __future__ import annotations

import importlib.metadata
import json
import platform
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from animarl_algos.data.slots import focal_drivers
from animarl_algos.data.vec_env import SlotVecEnv
from animarl_algos.learner.algorithm import SequenceQLearning
from animarl_algos.learner.checkpoint import in_short, latest_checkpoint, serialised
from animarl_algos.learner.presets import constructed
from animarl_algos.recipes.registry import named_recipe
from animarl_algos.runs.machine import machine
from animarl_algos.runs.run_curves import logged_curves
from animarl_algos.runs.run_settings import BEHAVIOUR_CLONING, RunSettings, checked_species
from animarl_algos.runs.run_world import (
    in_the_world,
    of_the_species,
    of_the_training,
    of_those_who_move,
)
from animarl_algos.runs.weights import read_weights, weights_file
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.packaged import load_packaged
from animarl_envs.demos.splits import learnable
from animarl_envs.errors import InputError
from animarl_envs.files import write_then_rename
from animarl_envs.fitting import LocomotionFit
from animarl_envs.fitting.custom_species import species_of
from animarl_envs.scenario import PACKAGED, Condition, Scenario, make_scenario
from animarl_envs.species import Species
from animarl_envs.species.options import with_options

if TYPE_CHECKING:
    import pandas as pd

PACKAGES = (
    "animarl", "gymnasium", "numba", "numpy", "pettingzoo", "sb3-contrib", "scikit-learn",
    "scipy", "stable-baselines3", "torch",
)  # fmt: skip
DEMONSTRATIONS = "demonstrations.npz"


@dataclass(frozen=True)
class RunFolder:
    """Paths of a run, and what is in them.

    ``acting_rule`` goes over the rule that trained policies of the run act by.
    """

    path: Path
    acting_rule: str | None = None

    def start(self, settings: RunSettings, demos: Demonstrations, command: str) -> None:
        """Write what the run is, or make sure that what is there is the same run.

        Raises
        ------
        InputError
            If the folder holds another run.
        """
        own, other = settings.learner(), settings.learner(BEHAVIOUR_CLONING)
        resolved = {
            "settings": asdict(settings) | {"overrides": dict(settings.overrides)},
            "learner": own.arguments,
            "baseline": other.arguments,
            "environment": _environment(settings, demos, own.env_kwargs),
            "fingerprint": demos.fingerprint(),
        }
        file = self.path / "settings.json"
        if file.exists():
            before = self._read()
            for key, value in resolved.items():
                if (there := before.get(key)) != (here := _plain(value)):
                    if isinstance(there, dict) and isinstance(here, dict):
                        keys = [k for k in here | there if here.get(k) != there.get(k)]
                        key = f"{key}: {', '.join(keys)}"
                    raise InputError(
                        f"{self.path}: it holds another run (its {key} differ): "
                        "choose another --out, or remove it"
                    )
            return
        demos.save(self.path / DEMONSTRATIONS)
        record = resolved | {
            "versions": versions(), "machine": machine(), "command": command,
        }  # fmt: skip
        with write_then_rename(file) as part:
            part.write_text(json.dumps(_plain(record), indent=2) + "\n")

    def _read(self) -> dict[str, Any]:
        file = self.path / "settings.json"
        try:
            record: dict[str, Any] = json.loads(file.read_text())
            if not isinstance(record, dict):
                raise ValueError("it is no table")
            return record
        except (FileNotFoundError, NotADirectoryError):
            raise InputError(
                f"{self.path}: it is not a run folder (settings.json is missing): "
                "make one with 'animarl run' or 'animarl train'"
            ) from None
        except ValueError as error:
            raise InputError(f"{file}: it is damaged ({error}): start the run again") from None

    @property
    def record(self) -> dict[str, Any]:
        """``settings``, ``learner`` and the ``baseline`` it is compared with, ``environment``,
        ``fingerprint``, ``versions``, ``machine`` and ``command``.
        """
        return self._read()

    @property
    def settings(self) -> RunSettings:
        """As the run was asked for."""
        try:
            return RunSettings(**self._read()["settings"])
        except (KeyError, TypeError) as error:
            raise InputError(
                f"{self.path / 'settings.json'}: it is not of this version of animarl ({error}): "
                "start the run again"
            ) from None

    def extend(self, steps: int | None = None, device: str | None = None) -> None:
        """Raise the number of steps of a run that is to be continued; move it to a device."""
        settings = self.settings
        if steps is not None and steps < settings.steps:
            raise InputError(
                f"{self.path}: the run has {settings.steps} steps already: ask for more with "
                "--steps"
            )
        trained = named_recipe(settings.algo).algorithm.recipe.online and (
            self.has_policy(settings.algo)
        )
        further = steps is not None and steps > settings.steps
        checkpoint = latest_checkpoint(self.path / "checkpoints" / settings.algo)
        if further and trained and checkpoint is None:
            raise InputError(
                f"{self.path}: its checkpoints are gone, so it cannot go on: start a new run"
            )
        asked = replace(
            settings,
            steps=settings.steps if steps is None else steps,
            device=settings.device if device is None else device,
        )
        record = self._read() | {"settings": asdict(asked)}
        with write_then_rename(self.path / "settings.json") as part:
            part.write_text(json.dumps(record, indent=2) + "\n")

    @property
    def demos(self) -> Demonstrations:
        """The demonstrations (packaged ones need no copy), all splits, of those who move."""
        file, record = self.path / DEMONSTRATIONS, self._read()
        if file.exists() or record["settings"]["file"] != PACKAGED:
            demos = Demonstrations.load(file)
        else:
            demos = load_packaged(self.settings.species)
            if demos.fingerprint() != record["fingerprint"]:
                raise InputError(
                    f"{self.path}: it was trained on packaged demonstrations of another version: "
                    "train it anew"
                )
        return of_those_who_move(demos, self.environment_options)

    @property
    def learnable_demos(self) -> Demonstrations:
        """Those of the train and val splits: all that fitting, training and choosing are given."""
        return learnable(self.demos)

    @property
    def fit(self) -> LocomotionFit:
        """The fitted locomotion."""
        return LocomotionFit.load(self.path / "locomotion.json")

    def species(self, demos: Demonstrations, fit: LocomotionFit) -> Species:
        """The species that the run trains and is evaluated in.

        With the recording's arena and names, the fitted locomotion, and over these the run's own
        options (``env_kwargs``).
        """
        species = species_of(demos, fit.locomotion, base=self.settings.species)
        return with_options(species, **of_the_species(self.environment_options))

    def scenario(self, split: str, condition: Condition = "demo") -> Scenario:
        """The world of the run, from the starts of ``split``: to evaluate in and to watch.

        Episodes start from each demonstration and in its condition, or in the one given. Those who
        did not learn replay their demonstration.
        """
        demos, options = self.demos, self.environment_options
        species = self.species(demos, self.fit)
        return make_scenario(
            species,
            demos=demos,
            split=split,
            condition=condition,
            drivers=focal_drivers(species.individuals, self.settings.focal),
            **in_the_world(options),
        )

    @property
    def environment_options(self) -> dict[str, Any]:
        """Options of the training environment."""
        recorded: dict[str, Any] = self._read()["environment"]
        return recorded

    def environment(self, species: Species, demos: Demonstrations) -> SlotVecEnv:
        """The training environment: episodes start from the train split.

        All individuals learn, or the run's focal one.
        """
        settings = self.settings
        return SlotVecEnv(
            species,
            settings.copies,
            demos=demos,
            focal=settings.focal,
            condition_flag=None,
            **of_the_training(self.environment_options),
        )

    def learner(self, algo: str, env: SlotVecEnv) -> SequenceQLearning:
        """A new learner with the settings that were recorded when the run began."""
        settings, record = self.settings, self._read()
        plain = record["learner" if algo == settings.algo else "baseline"]
        return named_recipe(algo).algorithm(
            env=env, seed=settings.seed, device=settings.device, **constructed(plain)
        )

    def save_policy(self, name: str, model: SequenceQLearning) -> None:
        """The final weights, tensors only."""
        with write_then_rename(self.path / "policies" / f"{name}.pt") as part:
            part.write_bytes(serialised(model.policy.q_net.state_dict()))

    def load_policy(self, name: str, model: SequenceQLearning) -> None:
        """Put the final weights into a learner of the same settings."""
        file = weights_file(self.path / "policies", name)
        try:
            weights = read_weights(file)
            model.policy.q_net.load_state_dict(weights)
            model.policy.q_net_target.load_state_dict(weights)
        except FileNotFoundError:
            raise InputError(
                f"{file}: there is no trained policy yet: train the run first"
            ) from None
        except (RuntimeError, ValueError, TypeError, LookupError) as error:
            raise InputError(
                f"{file}: it is not a policy of this run ({in_short(error)}): "
                "remove it and train again"
            ) from None

    def has_policy(self, name: str) -> bool:
        return weights_file(self.path / "policies", name).exists()

    def log_folder(self, name: str) -> Path:
        """A new folder for the logs of one session of one learner."""
        base = self.path / "logs" / name
        return base / f"{len(list(base.glob('[0-9]*'))):03d}"

    def learning_curves(self) -> pd.DataFrame:
        """All logged quantities: ``method, phase, seed, step, quantity, value``."""
        return logged_curves(self.path / "logs", self.settings.seed)


def _environment(
    settings: RunSettings, demos: Demonstrations, options: dict[str, Any]
) -> dict[str, Any]:
    """The options, and those by which worlds differ in full, whatever their defaults become."""
    moving = of_those_who_move(demos, options)
    species = with_options(checked_species(settings, moving), **of_the_species(options))
    return {"observation": species.observation, "rebound": species.arena.rebound} | options


def versions() -> dict[str, str]:
    """Versions of Python and of the packages that decide a result."""
    packages = {name: importlib.metadata.version(name) for name in PACKAGES}
    return {"python": platform.python_version()} | packages


def _plain(value: Any) -> Any:
    """As JSON would give it back."""
    return json.loads(json.dumps(value, default=str))
