"""Settings of the learners, read from ``zoo_configs``: plain data, checked, never evaluated.

A file holds a section per environment id and in it the presets ``paper`` and ``default``. The
section ``common`` goes under every section of its file, and the files named by ``base`` under
both, so that a number stands in one place. Keys are arguments of the algorithm and rl_zoo3's
``n_timesteps``, ``n_envs`` and ``env_kwargs``. What goes over another setting replaces it, but
tables (``env_kwargs``, ``policy_kwargs``, ``replay_buffer_kwargs``) are merged key by key.
"""

from __future__ import annotations

import inspect
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from importlib import resources
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Any

import yaml

from animarl_algos.learner.algorithm import SequenceQLearning
from animarl_algos.learner.settings import checked_value
from animarl_algos.recipes.registry import named_recipe
from animarl_envs import SPECIES, environment_id
from animarl_envs.errors import InputError

CONFIGS = resources.files("zoo_configs")
PRESETS = ("paper", "default")
SURROUNDINGS: dict[str, Any] = {"n_timesteps": 1, "n_envs": 1, "env_kwargs": None}
"""What a section says beside the algorithm's arguments; 1 where a whole number is asked for."""
PIPELINE: dict[str, Any] = {"test_epsilon": 0.5, "fit_method": "joint"}
"""Keys of ``pipeline.yml``."""
POLICIES = tuple(SequenceQLearning.policy_aliases)
NOT_FOR_FILES = {
    "self", "env", "demonstrations", "seed", "device", "verbose", "tensorboard_log",
    "_init_setup_model",
}  # fmt: skip
Sections = dict[str, dict[str, dict[str, Any]]]


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
        Of the algorithm, plain data; :func:`~animarl_algos.learner.settings.constructed` makes
        them ready.
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
    known = known_settings(algo)
    found, listed = read_preset(algo if config is None else Path(config), env_id, preset, known)
    if preset == "paper" and not listed:
        ids = ", ".join(environment_id(name) for name in SPECIES)
        raise InputError(
            f"preset 'paper' has no numbers for {env_id}: choose 'default', or one of {ids}"
        )
    given = (overrides or {}).items()
    found = merged(found, {k: _checked(k, v, known, f"{algo}: setting {k!r}") for k, v in given})
    missing = [key for key in ("n_timesteps", "n_envs", "policy") if key not in found]
    if missing:
        raise InputError(f"{config or algo}: it does not say {missing[0]} for {env_id}: add it")
    arguments = {key: found[key] for key in sorted(found) if key not in SURROUNDINGS}
    env_kwargs = found.get("env_kwargs") or {}
    if not isinstance(env_kwargs, dict):
        raise InputError(f"{config or algo}: env_kwargs is {env_kwargs!r}: give a table of options")
    return LearnerPreset(found["n_timesteps"], found["n_envs"], env_kwargs, arguments)


def known_settings(algo: str) -> dict[str, Any]:
    """Keys that a file may hold for ``algo``, each with its default (for its kind)."""
    parameters = inspect.signature(named_recipe(algo).algorithm.__init__).parameters
    arguments = {k: p.default for k, p in parameters.items() if k not in NOT_FOR_FILES}
    whole = {"offline_epochs": 0}  # its own default depends on the recipe
    return arguments | whole | SURROUNDINGS


def pipeline_settings(env_id: str, preset: str) -> dict[str, Any]:
    """``test_epsilon`` and ``fit_method`` of ``zoo_configs/pipeline.yml``."""
    return read_preset("pipeline", env_id, preset, PIPELINE)[0]


def read_preset(
    config: str | Path, env_id: str, preset: str, known: Mapping[str, Any]
) -> tuple[dict[str, Any], bool]:
    """Settings of an environment: those of the bases, then ``common``, then its own section.

    With them comes whether it has a section of its own for the preset.

    Raises
    ------
    InputError
        See :func:`learner_preset`.
    """
    if preset not in PRESETS:
        raise InputError(f"preset {preset!r} is unknown: choose {' or '.join(PRESETS)}")
    return _resolve(config, env_id, preset, known, ())


def _resolve(
    config: str | Path,
    env_id: str,
    preset: str,
    known: Mapping[str, Any],
    within: Collection[str],
) -> tuple[dict[str, Any], bool]:
    if str(config) in within:
        raise InputError(f"{config}: it is its own base: name another file under base")
    bases, sections = read_file(config, known)
    settings: dict[str, Any] = {}
    listed = preset in sections.get(env_id, {})
    for base in bases:
        inherited, there = _resolve(base, env_id, preset, known, (*within, str(config)))
        settings, listed = merged(settings, inherited), listed or there
    for section in ("common", env_id):
        settings = merged(settings, sections.get(section, {}).get(preset, {}))
    return settings, listed


def merged(lower: Mapping[str, Any], upper: Mapping[str, Any]) -> dict[str, Any]:
    """Both settings, the upper ones where both speak; the entries of a table one by one."""
    tables = {
        key: lower[key] | value
        for key, value in upper.items()
        if isinstance(value, dict) and isinstance(lower.get(key), dict)
    }
    return {**lower, **upper, **tables}


def read_file(config: str | Path, known: Mapping[str, Any]) -> tuple[list[str], Sections]:
    """The names of the base files, and section -> preset -> settings, every key checked.

    Parameters
    ----------
    config
        Name of a file of ``zoo_configs`` without its suffix, or the path of one.
    known
        Keys that are allowed, each with a value of the right kind.

    Raises
    ------
    InputError
        If there is no such file, or it is not of this form; the sentence names the place.
    """
    file: Traversable = config if isinstance(config, Path) else CONFIGS / f"{config}.yml"
    name = str(config) if isinstance(config, Path) else f"zoo_configs/{config}.yml"
    try:
        content = yaml.safe_load(file.read_text(encoding="utf-8"))
    except (FileNotFoundError, IsADirectoryError):
        raise InputError(f"{name}: there is no such configuration") from None
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        first_line = str(error).splitlines()[0]
        raise InputError(f"{name}: it is not valid YAML ({first_line}): mend it") from None
    if not isinstance(content, dict):
        raise InputError(f"{name}: it holds no sections: write one per environment id")
    base = content.pop("base", [])
    bases = [base] if isinstance(base, str) else base
    if not isinstance(bases, list) or not all(isinstance(b, str) for b in bases):
        raise InputError(f"{name}: base is {base!r}: name a file of zoo_configs, or a list of them")
    return bases, {
        str(section): _checked_section(presets, f"{name}: {section}", known)
        for section, presets in content.items()
    }


def _checked_section(
    presets: Any, place: str, known: Mapping[str, Any]
) -> dict[str, dict[str, Any]]:
    if not isinstance(presets, dict) or set(presets) - set(PRESETS):
        wrong = sorted(map(str, set(presets) - set(PRESETS))) if isinstance(presets, dict) else []
        found = f"{wrong[0]!r}" if wrong else f"{presets!r}"
        raise InputError(
            f"{place}: it holds {found}: a section holds the presets {' and '.join(PRESETS)}, "
            "and these the settings"
        )
    section = {}
    for preset, settings in presets.items():
        if not isinstance(settings, dict):
            raise InputError(f"{place}: {preset} is {settings!r}: give a table of settings")
        section[preset] = {
            key: _checked(key, value, known, f"{place}: {preset}: {key!r}")
            for key, value in settings.items()
        }
    return section


def _checked(key: str, value: Any, known: Mapping[str, Any], place: str) -> Any:
    if key not in known:
        raise InputError(f"{place} is unknown: choose among {', '.join(sorted(known))}")
    value = checked_value(key, value, known[key], place)
    if key == "policy" and value not in POLICIES:
        raise InputError(f"{place} is {value!r}: choose {' or '.join(POLICIES)}")
    return value
