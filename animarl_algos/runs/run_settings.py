"""The options of ``animarl run`` and ``train``, which a run's folder records.

The command line is made from these models, so that its help does not import what learns: checks
that need it import it.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Annotated, Any, Literal

import gymnasium as gym
from annotated_types import Ge, Le

from animarl_envs import environment_id
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.errors import InputError
from animarl_envs.fitting.custom_species import species_of
from animarl_envs.locomotion import Locomotion
from animarl_envs.scenario import PACKAGED, refuse_other_species
from animarl_envs.settings import Checked, Count, Seed
from animarl_envs.species import CUSTOM, SPECIES, Species, get_species, species_name
from animarl_envs.tasks import find_task

if TYPE_CHECKING:
    from animarl_algos.learner.presets import LearnerPreset

BEHAVIOUR_CLONING = "bc"
CHOSEN, AUTO = "chosen", "auto"
Copies = Annotated[int, Ge(1), Le(100_000)]
Preset = Literal["paper", "default"]


@dataclass(frozen=True, kw_only=True)
class PipelineSettings(Checked):
    """Settings of the stages around a learner, as in ``zoo_configs/pipeline.yml``."""

    fit_method: Literal["joint", "onset", "species"] = "joint"
    """joint, onset (the paper's rule) or species (its own parameters, nothing is fitted; with
    --env); by default the preset's."""
    thrusts: str = AUTO
    """Thrust magnitudes, 1 to 10, or auto: chosen on training data."""
    acting: str = CHOSEN
    """How trained policies act: greedy, boltzmann:TEMPERATURE, epsilon:SHARE, or chosen (by
    rollouts, after training); by default the preset's."""


@dataclass(frozen=True, kw_only=True)
class RunSettings(PipelineSettings):
    """What decides a run together with the demonstrations.

    Raises InputError if a setting is out of its range, or does not go with another.
    """

    file: str = PACKAGED
    """Demonstrations (.npz of 'animarl import'), or 'packaged': those of the species."""
    source: str | None = None
    """Format of FILE ('animarl data sources'); by default found by content."""
    species: str
    """agent, fly, newt, silkmoth, solo, shoal or custom; by default that of FILE."""
    algo: str = "soft-bc"
    """soft-bc, bc, dqn, dqaas, dqdil, dqdil-pt, dqcil, dqcil-pt; qr-dqn and so on."""
    preset: Preset = "default"
    """Settings: paper (the paper's) or default (tuned)."""
    config: str | None = None
    """YAML file to read instead of zoo_configs/ALGO.yml."""
    steps: Count
    """Environment steps of the online phase; by default the preset's."""
    seed: Seed = 0
    """Random seed; the same seed gives the same results."""
    copies: Copies = 16
    """Worlds simulated side by side; by default the preset's."""
    focal: str | None = None
    """Only this individual learns, and the others replay; default: all learn."""
    device: str = "cpu"
    """cpu (default) or cuda."""
    cloning: str = CHOSEN
    """Recipe of the clone: exact, exact-few, nearly-exact, recurrent, cells, recorded,
    recorded-few, recorded-many, search, search-remembered, or chosen (by the demonstrations;
    zoo_configs/cloning.yml)."""
    repetitions: Copies = 5
    """Rollouts per test demonstration."""
    baselines: bool = True
    """Compare with BC, an untrained network and random actions."""
    checkpoint_every: Count = 20_000
    """Steps between two checkpoints."""
    overrides: dict[str, Any] = field(default_factory=dict)
    """Settings of the learner that go over the preset's."""

    def __post_init__(self) -> None:
        super().__post_init__()
        from animarl_algos.data.recipe_choice import CLONINGS
        from animarl_algos.networks.acting_rule import Acting
        from animarl_algos.recipes.registry import named_recipe

        object.__setattr__(self, "species", species_name(self.species))
        named_recipe(self.algo)
        if self.species != CUSTOM:
            get_species(self.species)
        if self.acting != CHOSEN:
            Acting.parse(self.acting)
        if self.thrusts != AUTO and not (self.thrusts.isdecimal() and 1 <= int(self.thrusts) <= 10):
            raise InputError(f"thrusts is {self.thrusts!r}: give a number from 1 to 10, or {AUTO}")
        if self.fit_method != "joint" and self.thrusts not in ("1", AUTO):
            raise InputError(
                f"thrusts is {self.thrusts!r} but fit_method {self.fit_method} fits one thrust: "
                "choose 1, or fit_method joint"
            )
        if self.cloning not in (CHOSEN, *CLONINGS):
            known = ", ".join((CHOSEN, *CLONINGS))
            raise InputError(f"cloning is {self.cloning!r}: choose among {known}")
        check_device(self.device)

    @property
    def compared(self) -> tuple[str, ...]:
        """Learners that are trained beside the run's own: BC, where that adapts online."""
        from animarl_algos.recipes.registry import named_recipe

        adapts = bool(named_recipe(self.algo).algorithm.recipe.online)
        return (BEHAVIOUR_CLONING,) if self.baselines and adapts else ()

    def learner(self, algo: str | None = None) -> LearnerPreset:
        """Return the settings of the run's learner, or of the one it is compared with.

        The other one gets the run's policy, without quantiles, but none of its other ``overrides``
        or its ``config``.
        """
        from animarl_algos.learner.presets import learner_preset

        own = algo is None or algo == self.algo
        shared = {k: v for k, v in self.overrides.items() if k in ("policy", "policy_kwargs")}
        if isinstance(network := shared.get("policy_kwargs"), dict):
            shared["policy_kwargs"] = {k: v for k, v in network.items() if k != "n_quantiles"}
        return learner_preset(
            algo or self.algo,
            environment_id(self.species),
            self.preset,
            self.overrides if own else shared,
            config=self.config if own else None,
            cloning=None if self.cloning == CHOSEN else self.cloning,
        )

    @property
    def clones(self) -> bool:
        """Whether the learner takes anything from a recipe of the clone."""
        from animarl_algos.data.recipe_choice import CLONINGS

        recipes = [self.changed(cloning=name).learner() for name in CLONINGS[:2]]
        return recipes[0] != recipes[1]


def pipeline_settings(env_id: str, preset: str) -> dict[str, Any]:
    """Return ``acting``, ``fit_method`` and ``thrusts`` of ``zoo_configs/pipeline.yml``."""
    from animarl_algos.learner.presets import read_preset

    return read_preset("pipeline", env_id, preset, PipelineSettings)[0]


def check_device(device: str) -> None:
    """Refuse a device that PyTorch does not know or this machine does not have."""
    import torch

    try:
        kind = torch.device(device).type
    except RuntimeError:
        kind = ""
    if kind not in ("cpu", "cuda"):
        raise InputError(f"device {device!r} is unknown: choose cpu or cuda")
    if kind == "cuda" and not torch.cuda.is_available():
        raise InputError(f"device {device!r} is asked for but this machine has none: choose cpu")


def environment_options(env: str) -> dict[str, Any]:
    """Return the options that an environment was registered with; also by its species' name.

    Raises InputError if none of this id is registered.
    """
    try:
        named = environment_id(env)
        return dict(gym.spec(named if named in gym.registry else env).kwargs)
    except gym.error.Error as error:
        known = ", ".join(sorted(i for i in gym.registry if i.startswith("AnimaRL/")))
        raise InputError(
            f"environment {env!r} is not registered: choose one of {known}, or import the package "
            "of yours before (--gym-packages of python -m animarl_algos.zoo)"
        ) from error


def species_of_options(env: str | None, species: str | None) -> str | None:
    """Return the species that ``--env`` and ``--species`` name; None if neither is given.

    Raises InputError if they contradict each other, or the environment is no animals' world.
    """
    species = None if species is None else species_name(species)
    if env is None:
        return species
    named = species_name(env)
    if find_task(env) is not None:
        raise InputError(
            f"{env} is a task and no animals' world: train it with 'python -m animarl_algos.zoo "
            f"train --algo dqn --env {environment_id(env)}', or give the id of the animals"
        )
    if named not in (*SPECIES, CUSTOM):
        raise InputError(
            f"environment {env!r} is none of AnimaRL's: choose among "
            f"{', '.join(environment_id(s) for s in (*SPECIES, CUSTOM))}, or train it with "
            "python -m animarl_algos.zoo"
        )
    if species not in (None, named):
        raise InputError(f"--env {env} and --species {species} contradict each other: give one")
    return named


def checked_species(settings: RunSettings, demos: Demonstrations) -> Species:
    """Return the species of a run, its locomotion not yet fitted.

    Raises InputError if the demonstrations are of another species or layout, or the learner needs
    conditions and there are none, or nobody has the focal one's name.
    """
    from animarl_algos.recipes.registry import named_recipe

    named, algo, focal = settings.species, settings.algo, settings.focal
    refuse_other_species(demos, named, "--species")
    unfitted = (Locomotion(1.0, 1.0),) * demos.num_individuals
    species = species_of(demos, unfitted, base=named)
    if named_recipe(algo).algorithm.recipe.needs_condition:
        instead = algo.replace("cil", "dil")
        if not species.conditions:
            raise InputError(
                f"{algo} needs two experimental conditions and {named} has none: choose {instead}"
            )
        if len(set(demos.condition.tolist())) < 2:
            raise InputError(
                f"{demos.name}: {algo} needs episodes of both conditions and all are of "
                f"condition {demos.condition[0]}: choose {instead}"
            )
    if focal is not None and focal not in demos.individuals:
        raise InputError(f"focal is {focal!r}: choose one of {', '.join(demos.individuals)}")
    return species
