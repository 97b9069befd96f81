"""What a run is asked for: checked, recorded in its folder, found again on resume."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, get_args

import gymnasium as gym
import torch

from animarl_algos.learner.presets import LearnerPreset, learner_preset
from animarl_algos.learner.zoo_files import PRESETS, read_preset
from animarl_algos.networks.acting_rule import Acting
from animarl_algos.recipes.registry import named_recipe
from animarl_envs import environment_id
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.errors import InputError
from animarl_envs.fitting.custom_species import species_of
from animarl_envs.fitting.result import Method
from animarl_envs.locomotion import Locomotion
from animarl_envs.scenario import refuse_other_species
from animarl_envs.species import CUSTOM, SPECIES, Species, get_species

BEHAVIOUR_CLONING = "bc"
FIT_METHODS = get_args(Method)  # joint, onset, noise
CHOSEN, AUTO = "chosen", "auto"
PIPELINE: dict[str, Any] = {"acting": CHOSEN, "fit_method": "joint", "thrusts": AUTO}
"""Keys of ``zoo_configs/pipeline.yml``, each with a value of its kind."""


@dataclass(frozen=True, kw_only=True)
class RunSettings:
    """It decides the run together with the demonstrations.

    ``preset`` (of the file ``config``, by default that of the package) gives the learner's
    settings, ``overrides`` go over them. Only the individual ``focal`` learns, if one is named.
    ``acting`` is ``"chosen"`` after training, or a rule as
    :meth:`animarl_algos.networks.acting_rule.Acting.parse` reads it. ``thrusts`` is the number of
    thrust magnitudes, or ``"auto"``: chosen on the training split, or 1 where ``fit_method`` is not
    ``"joint"``.
    """

    file: str
    source: str | None = None
    species: str
    algo: str
    preset: str = "default"
    config: str | None = None
    steps: int
    seed: int = 0
    copies: int = 16
    focal: str | None = None
    device: str = "cpu"
    fit_method: str = "joint"
    repetitions: int = 5
    thrusts: str = AUTO
    acting: str = CHOSEN
    baselines: bool = True
    checkpoint_every: int = 20_000
    overrides: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        named_recipe(self.algo)
        if self.species != CUSTOM:
            get_species(self.species)
        if self.preset not in PRESETS:
            raise InputError(f"preset {self.preset!r} is unknown: choose {' or '.join(PRESETS)}")
        if self.fit_method not in FIT_METHODS:
            raise InputError(
                f"fit_method {self.fit_method!r} is unknown: choose joint, onset or noise"
            )
        for name in ("steps", "copies", "repetitions", "checkpoint_every"):
            if getattr(self, name) < 1:
                raise InputError(f"{name} is {getattr(self, name)}: it must be at least 1")
        if self.acting != CHOSEN:
            Acting.parse(self.acting)
        if self.thrusts != AUTO and not (self.thrusts.isdecimal() and 1 <= int(self.thrusts) <= 10):
            raise InputError(f"thrusts is {self.thrusts!r}: give a number from 1 to 10, or {AUTO}")
        if self.fit_method != "joint" and self.thrusts not in ("1", AUTO):
            raise InputError(
                f"thrusts is {self.thrusts!r} but fit_method {self.fit_method} fits one thrust: "
                "choose 1, or fit_method joint"
            )
        if self.seed < 0:
            raise InputError(f"seed is {self.seed}: it must not be negative")
        check_device(self.device)

    @property
    def compared(self) -> tuple[str, ...]:
        """Learners that are trained beside the run's own: BC, where that adapts online."""
        adapts = bool(named_recipe(self.algo).algorithm.recipe.online)
        return (BEHAVIOUR_CLONING,) if self.baselines and adapts else ()

    def learner(self, algo: str | None = None) -> LearnerPreset:
        """The settings of the run's learner, or of the one it is compared with.

        The other one gets the run's policy, without quantiles, but none of its other ``overrides``
        or its ``config``.
        """
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
        )


def pipeline_settings(env_id: str, preset: str) -> dict[str, Any]:
    """``acting``, ``fit_method`` and ``thrusts`` of ``zoo_configs/pipeline.yml``."""
    return read_preset("pipeline", env_id, preset, PIPELINE)[0]


def check_device(device: str) -> None:
    """Refuse a device that PyTorch does not know or this machine does not have."""
    try:
        kind = torch.device(device).type
    except RuntimeError:
        raise InputError(f"device {device!r} is unknown: choose cpu or cuda") from None
    if kind not in ("cpu", "cuda"):
        raise InputError(f"device {device!r} is not supported: choose cpu or cuda")
    if kind == "cuda" and not torch.cuda.is_available():
        raise InputError(f"device {device!r} is asked for but this machine has none: choose cpu")


def asked_species(env: str | None, species: str | None) -> str | None:
    """The species that ``--env`` and ``--species`` name; None if neither is given.

    Raises
    ------
    InputError
        If they contradict each other, or the environment is none of this suite.
    """
    if env is None:
        return species
    try:
        named = gym.spec(env).kwargs.get("species")
    except gym.error.Error:
        named = None
    if not isinstance(named, str):
        raise InputError(
            f"environment {env!r} is none of AnimaRL's: choose among "
            f"{', '.join(environment_id(s) for s in (*SPECIES, CUSTOM))}, or train it with "
            "python -m animarl_algos.zoo"
        )
    if species not in (None, named):
        raise InputError(f"--env {env} and --species {species} contradict each other: give one")
    return named


def checked_species(settings: RunSettings, demos: Demonstrations) -> Species:
    """The species of a run, its locomotion not yet fitted; what does not fit is refused.

    Raises
    ------
    InputError
        If the demonstrations are of another species or layout, or the learner needs conditions
        and there are none, or nobody has the focal one's name.
    """
    named, algo = settings.species, settings.algo
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
    if settings.focal is not None and settings.focal not in demos.individuals:
        raise InputError(
            f"focal is {settings.focal!r}: choose one of {', '.join(demos.individuals)}"
        )
    return species
