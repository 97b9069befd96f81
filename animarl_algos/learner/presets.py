"""The settings of the learners: what ``zoo_configs`` says, for the command line and for Python.

A learner's own file (:mod:`animarl_algos.learner.zoo_files`) holds its presets ``paper`` and
``default``; what it leaves open stands in ``zoo_configs/learner.yml``. A learner made in Python
takes from preset ``default`` what it is not told, for the species of its environment where that
says one.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import gymnasium as gym
from stable_baselines3.common.vec_env import VecEnv

from animarl_algos.learner.settings import linear_schedule
from animarl_algos.learner.zoo_files import (
    CONFIGS,
    checked_setting,
    merged,
    parsed,
    read_preset,
)
from animarl_envs import SPECIES, environment_id
from animarl_envs.errors import InputError
from animarl_envs.scenario import Scenario

BENEATH = CONFIGS / "learner.yml"
SURROUNDINGS: dict[str, Any] = {"n_timesteps": 1, "n_envs": 1, "env_kwargs": None}
"""What a section says beside the algorithm's arguments; 1 where a whole number is asked for."""
OF_NO_SPECIES = ""
"""The section of an environment that has none of its own: what is common to all."""
TABLES = ("offline_kwargs", "policy_kwargs", "replay_buffer_kwargs")


@dataclass(frozen=True)
class LearnerPreset:
    """A learner's settings in one environment.

    Attributes
    ----------
    n_timesteps
        Steps of the world.
    n_envs
        Copies of the world.
    env_kwargs
        Options of the training environment.
    arguments
        Of the algorithm, plain data; :func:`constructed` completes them.
    """

    n_timesteps: int
    n_envs: int
    env_kwargs: dict[str, Any]
    arguments: dict[str, Any]


def learner_preset(
    algo: str,
    env_id: str,
    preset: str = "default",
    overrides: Mapping[str, Any] | None = None,
    *,
    config: str | Path | None = None,
) -> LearnerPreset:
    """The settings of ``algo`` in an environment, ``overrides`` over those of the file.

    Parameters
    ----------
    algo
        Name of a recipe, such as ``qr-dqcil-pt``.
    env_id
        Gymnasium id.
    preset
        ``"paper"`` or ``"default"``.
    overrides
        Settings that go over the file's.
    config
        A file of the same format to read instead of ``zoo_configs/<algo>.yml``.

    Raises
    ------
    InputError
        If there is no such preset, a key is unknown, or a value is of the wrong kind.
    """
    known = known_settings()
    found, listed = read_preset(algo if config is None else Path(config), env_id, preset, known)
    if preset == "paper" and not listed:
        ids = [environment_id(name) for name in SPECIES]
        if not any(read_preset(algo, each, preset, known)[1] for each in ids):
            raise InputError(f"{algo} is not of the paper: choose preset 'default'")
        raise InputError(
            f"preset 'paper' has no numbers for {env_id}: choose 'default', or one of "
            f"{', '.join(ids)}"
        )
    given = (overrides or {}).items()
    found = merged(
        found, {k: checked_setting(k, v, known, f"{algo}: setting {k!r}") for k, v in given}
    )
    missing = [key for key in ("n_timesteps", "n_envs", "policy") if key not in found]
    if missing:
        raise InputError(f"{config or algo}: it does not say {missing[0]} for {env_id}: add it")
    arguments = {key: found[key] for key in sorted(found) if key not in SURROUNDINGS}
    env_kwargs = found.get("env_kwargs") or {}
    if not isinstance(env_kwargs, dict):
        raise InputError(f"{config or algo}: env_kwargs is {env_kwargs!r}: give a table of options")
    return LearnerPreset(found["n_timesteps"], found["n_envs"], env_kwargs, arguments)


def known_settings() -> dict[str, Any]:
    """Keys that a file may hold, each with a value of its kind."""
    return beneath() | SURROUNDINGS


def beneath() -> dict[str, Any]:
    """All settings of a learner, each as it is where no preset says another: plain data."""
    settings: dict[str, Any] = parsed(BENEATH.read_text(encoding="utf-8"), str(BENEATH))
    return settings


def constructed(arguments: Mapping[str, Any]) -> dict[str, Any]:
    """Settings of a preset as the algorithms take them, completed by those beneath all presets.

    Lists become tuples, a rate ``lin_1e-4`` a schedule.
    """
    whole = beneath() | dict(arguments)
    ready = {k: tuple(v) if isinstance(v, list) else v for k, v in whole.items()}
    if isinstance(rate := ready["learning_rate"], str):
        ready["learning_rate"] = linear_schedule(rate)
    return ready


def constructor_settings(
    plain: str, pretrained: str | None, env: Any, given: Mapping[str, Any]
) -> dict[str, Any]:
    """All settings of a learner made in Python: those ``given``, over those of preset ``default``.

    Parameters
    ----------
    plain, pretrained
        Names of the learner's files: as it is, and, if it has one, for ``offline_epochs`` above 0.
    env
        What it learns in: its species has a section of its own, and so have a few ordinary tasks,
        which holds for the policy that it names alone.
    given
        Settings by name; a table goes over the preset's key by key, and None empties it.

    Raises
    ------
    InputError
        If a setting is unknown.
    """
    section = section_of(env)
    settings = constructed(learner_preset(plain, section).arguments)
    asked = given.get("policy", settings["policy"])
    if not section.startswith("AnimaRL/") and asked not in (settings["policy"], None):
        section = OF_NO_SPECIES
        settings = constructed(learner_preset(plain, section).arguments)
    for name in given:
        if name not in settings:
            raise InputError(f"setting {name!r} is unknown: choose among {', '.join(settings)}")
    if given.get("offline_epochs") and not settings["offline_epochs"] and pretrained is not None:
        settings = constructed(learner_preset(pretrained, section).arguments)
    tables = {
        # None, as presets and records of runs have it, says that there is nothing in the table.
        name: {} if table is None else dict(settings[name] or {}) | dict(table)
        for name, table in ((name, given.get(name, {})) for name in TABLES)
    }
    return settings | dict(given) | tables


def section_of(env: Any) -> str:
    """The environment id under which files speak of ``env``: its species', or its own.

    Parameters
    ----------
    env
        An id, an environment, a VecEnv, or None.
    """
    if isinstance(env, str):
        return env
    scenario, spec = None, None
    if isinstance(env, VecEnv):
        if hasattr(env, "scenario"):
            scenario = env.scenario
        elif env.has_attr("scenario"):
            scenario = env.get_attr("scenario", indices=0)[0]
        if scenario is None and env.has_attr("spec"):
            spec = env.get_attr("spec", indices=0)[0]
    elif isinstance(env, gym.Env):
        spec = env.spec
        if env.has_wrapper_attr("scenario"):
            scenario = env.get_wrapper_attr("scenario")
    if isinstance(scenario, Scenario):
        return environment_id(scenario.species.name)
    return OF_NO_SPECIES if spec is None else str(spec.id)
