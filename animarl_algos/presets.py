"""Settings of the learners, read from ``zoo_configs``: plain data, checked, never evaluated."""

from __future__ import annotations

import inspect
from importlib import resources
from typing import Any

import yaml

from animarl_algos.recipes import named_recipe
from animarl_envs import environment_id
from animarl_envs.errors import InputError

CONFIGS = resources.files("zoo_configs")


def read_section(config: str, species: str) -> dict[str, Any]:
    """The section of a species in ``zoo_configs/<config>.yml``, or the file's ``default``.

    Raises
    ------
    InputError
        If there is no such file or it is not a table of sections.
    """
    file = CONFIGS / f"{config}.yml"
    try:
        sections = yaml.safe_load(file.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise InputError(f"{file}: there is no such configuration") from None
    except yaml.YAMLError as error:
        raise InputError(f"{file}: it is not valid YAML ({error}): mend it") from error
    if not isinstance(sections, dict):
        raise InputError(f"{file}: it holds no sections: write one per environment id")
    section = sections.get(environment_id(species), sections.get("default"))
    if not isinstance(section, dict):
        raise InputError(f"{file}: it has no section for {environment_id(species)}: add one")
    return dict(section)


def learner_settings(algo: str, species: str, overrides: dict[str, Any]) -> dict[str, Any]:
    """Arguments of the algorithm: the YAML section, then ``overrides``, each checked by name.

    Raises
    ------
    InputError
        If a key is not an argument of the algorithm.
    """
    recipe = named_recipe(algo)
    settings = read_section(algo.removeprefix("qr-"), species) | overrides
    known = set(inspect.signature(recipe.algorithm.__init__).parameters) - {"self", "env"}
    for key in settings:
        if key not in known:
            raise InputError(
                f"setting {key!r} is unknown to {algo}: choose among {', '.join(sorted(known))}"
            )
    return {k: tuple(v) if isinstance(v, list) else v for k, v in settings.items()}
