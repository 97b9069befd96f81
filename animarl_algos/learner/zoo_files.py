"""Files of ``zoo_configs``: plain data, checked, never evaluated.

A file holds a section per environment id and in it the presets ``paper`` and ``default``. The
section ``common`` goes under every section of its file, and the files named by ``base`` under
both, so that a number stands in one place. What goes over another setting replaces it, but tables
(``env_kwargs``, ``policy_kwargs``, ``replay_buffer_kwargs``) are merged key by key.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from copy import deepcopy
from functools import lru_cache
from importlib import resources
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Any

from animarl_algos.learner.settings import POLICIES, checked_value
from animarl_envs.errors import InputError
from animarl_envs.importing.plain_yaml import parse_yaml

CONFIGS = resources.files("zoo_configs")
PRESETS = ("paper", "default")
Sections = dict[str, dict[str, dict[str, Any]]]


def read_preset(
    config: str | Path, env_id: str, preset: str, known: Mapping[str, Any]
) -> tuple[dict[str, Any], bool]:
    """Settings of an environment: those of the bases, then ``common``, then its own section.

    With them comes whether it has a section of its own for the preset.

    Raises
    ------
    InputError
        If there is no such preset, a key is unknown, or a value is of the wrong kind.
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
        content = parsed(file.read_text(encoding="utf-8"), name)
    except (FileNotFoundError, IsADirectoryError):
        raise InputError(f"{name}: there is no such configuration") from None
    except UnicodeDecodeError as error:
        raise InputError(f"{name}: it is not valid YAML ({error}): mend it") from None
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


def parsed(text: str, place: str) -> Any:
    """The data in a YAML text; its caller may change it."""
    return deepcopy(_parsed_once(text, place))


@lru_cache
def _parsed_once(text: str, place: str) -> Any:
    """Every learner that is made reads the same few files, and parsing takes milliseconds each."""
    return parse_yaml(text, place)


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
            key: checked_setting(key, value, known, f"{place}: {preset}: {key!r}")
            for key, value in settings.items()
        }
    return section


def checked_setting(key: str, value: Any, known: Mapping[str, Any], place: str) -> Any:
    """The value, of the kind that ``known`` has for this key.

    Raises
    ------
    InputError
        If the key is unknown or the value of another kind; the sentence starts with ``place``.
    """
    if key not in known:
        raise InputError(f"{place} is unknown: choose among {', '.join(sorted(known))}")
    value = checked_value(key, value, known[key], place)
    if key == "policy" and value not in POLICIES:
        raise InputError(f"{place} is {value!r}: choose {' or '.join(POLICIES)}")
    return value
