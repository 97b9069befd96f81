"""Settings of the learners in files of ``zoo_configs``, for the command line and for Python.

A file holds a section per environment id (a task has that of its animals) and in it the presets
``paper`` and ``default``. The section ``common`` goes under every section of its file, and the
files named by ``base`` under both, so that a number stands in one place. What goes over another
setting replaces it, but tables (``env_kwargs``, ``policy_kwargs``, ``replay_buffer_kwargs``) are
merged key by key. Files are plain data, never evaluated; what they leave open has the default of
:class:`animarl_algos.learner.settings.LearnerSettings`. A learner made in Python takes from preset
``default`` what it is not told, for the species of its environment where that says one.
"""

from collections.abc import Mapping
from copy import deepcopy
from dataclasses import dataclass
from functools import lru_cache
from importlib import resources
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Any

from animarl_algos.data.slot_layout import declared
from animarl_algos.learner.settings import RUN_KEYS, TABLES, LearnerFile, LearnerSettings
from animarl_envs import SPECIES, environment_id
from animarl_envs.errors import InputError
from animarl_envs.files import parse_yaml
from animarl_envs.scenario import Scenario
from animarl_envs.settings import Checked, field_types
from animarl_envs.tasks import find_task

CONFIGS = resources.files("zoo_configs")
PRESETS = ("paper", "default")
COMMON_SECTION = ""
"""The section of an environment that has none of its own: what is common to all."""
Sections = dict[str, dict[str, dict[str, Any]]]


@dataclass(frozen=True)
class LearnerPreset:
    """A learner's settings in one environment."""

    n_timesteps: int  # of the world
    n_envs: int  # its copies
    env_kwargs: dict[str, Any]  # its options in training
    arguments: dict[str, Any]  # what files and overrides say of the learner

    @property
    def settings(self) -> LearnerSettings:
        """All settings of the learner."""
        return LearnerSettings.of(self.arguments)


def learner_preset(
    algo: str,
    env_id: str,
    preset: str = "default",
    overrides: Mapping[str, Any] | None = None,
    *,
    config: str | Path | None = None,
    cloning: str | None = None,
) -> LearnerPreset:
    """Return the settings of ``algo``, such as ``qr-dqcil-pt``, in an environment (its id).

    ``overrides`` go over those of the file: ``config``, by default ``zoo_configs/<algo>.yml``.
    ``cloning`` is a section of ``cloning.yml``, by default that of the environment. Raises
    InputError if there is no such preset, a key is unknown, or a value is of the wrong kind.
    """
    file = algo if config is None else Path(config)
    settings, listed = read_preset(file, env_id, preset, cloning=cloning)
    if preset == "paper" and not listed:
        ids = [environment_id(name) for name in SPECIES]
        if not any(read_preset(algo, each, preset)[1] for each in ids):
            raise InputError(f"{algo} is not of the paper: choose preset 'default'")
        raise InputError(
            f"preset 'paper' has no numbers for {env_id}: choose 'default', or one of "
            f"{', '.join(ids)}"
        )
    given = LearnerFile.check(overrides or {}, f"{algo}: setting ")
    settings = deepcopy(merge_tables(settings, given))
    missing = [key for key in ("n_timesteps", "n_envs", "policy") if key not in settings]
    if missing:
        raise InputError(
            f"{config or algo}: it does not say {', '.join(missing)} for {env_id}: add this, or "
            f"begin the file with 'base: {algo}', which says all"
        )
    arguments = {key: settings[key] for key in sorted(settings) if key not in RUN_KEYS}
    options = settings.get("env_kwargs") or {}
    return LearnerPreset(settings["n_timesteps"], settings["n_envs"], options, arguments)


def resolve_settings(
    algo: str, pretrained: str | None, env: Any, given: Mapping[str, Any]
) -> LearnerSettings:
    """Return the settings of a learner made in Python: those ``given`` over preset ``default``.

    ``algo`` and ``pretrained`` name the learner's files: as it is, and, if it has one, for
    ``offline_epochs`` above 0. The species of ``env`` has a section of its own, and so have a few
    ordinary tasks, which holds for the policy that it names alone. A table in ``given`` goes over
    the preset's key by key, and None empties it; ``train_freq`` without ``gradient_steps`` has one
    of these, since a preset's number belongs to its own ``train_freq``. Raises InputError if a
    setting is unknown.
    """
    given = check_settings(given)
    section = section_of(env)
    settings = learner_preset(algo, section).settings
    policy = given.get("policy", settings.policy)
    if not section.startswith("AnimaRL/") and policy != settings.policy:
        section = COMMON_SECTION
        settings = learner_preset(algo, section).settings
    if given.get("offline_epochs") and not settings.offline_epochs and pretrained is not None:
        settings = learner_preset(pretrained, section).settings
    tables = {name: getattr(settings, name) | given[name] for name in TABLES if given.get(name)}
    paired = {"gradient_steps": 1} if "train_freq" in given else {}
    return settings.changed(**{**paired, **given, **tables})


def section_of(env: Any) -> str:
    """Return the environment id under which files speak of ``env``: its species', or its own.

    ``env`` is an id, an environment, a VecEnv, or None.
    """
    if isinstance(env, str):
        return env
    scenario, spec = (declared(env, name) for name in ("scenario", "spec"))
    if isinstance(scenario, Scenario):
        return environment_id(scenario.species.name)
    return COMMON_SECTION if spec is None else str(spec.id)


def check_settings(given: Mapping[str, Any]) -> dict[str, Any]:
    """Return settings given in Python, checked.

    Raises InputError if one is unknown or out of its range.
    """
    known = field_types(LearnerSettings)
    for name in given:
        if name not in known:
            raise InputError(
                f"setting {name!r} is unknown: choose among {', '.join(sorted(known))}"
            )
    return LearnerFile.check(given)


# -- files ----------------------------------------------------------------------------------------


def read_preset(
    config: str | Path,
    env_id: str,
    preset: str,
    model: type[Checked] = LearnerFile,
    *,
    cloning: str | None = None,
    within: tuple[str, ...] = (),
) -> tuple[dict[str, Any], bool]:
    """Return settings of an environment: of the bases, then ``common``, then its own section.

    Where a file has a section ``cloning``, that takes the place of the environment's. With the
    settings comes whether the environment has a section of its own for the preset. ``within`` are
    the files that named this one as their base. Raises InputError if there is no such preset, a
    key is unknown, or a value is of the wrong kind.
    """
    if preset not in PRESETS:
        raise InputError(f"preset {preset!r} is unknown: choose {' or '.join(PRESETS)}")
    if str(config) in within:
        raise InputError(f"{config}: it is its own base: name another file under base")
    bases, sections = read_file(config, model)
    task = find_task(env_id)
    if task is not None and env_id not in sections:  # the section of its animals
        env_id = environment_id(task.base.name)
    settings: dict[str, Any] = {}
    listed = preset in sections.get(env_id, {})
    for base in bases:
        inherited, there = read_preset(
            base, env_id, preset, model, cloning=cloning, within=(*within, str(config))
        )
        settings, listed = merge_tables(settings, inherited), listed or there
    for section in ("common", cloning if cloning in sections else env_id):
        settings = merge_tables(settings, sections.get(section, {}).get(preset, {}))
    return settings, listed


def merge_tables(lower: Mapping[str, Any], upper: Mapping[str, Any]) -> dict[str, Any]:
    """Return both settings, the upper ones where both set a value; tables key by key."""
    tables = {
        key: lower[key] | value
        for key, value in upper.items()
        if isinstance(value, dict) and isinstance(lower.get(key), dict)
    }
    return {**lower, **upper, **tables}


def read_file(config: str | Path, model: Any = LearnerFile) -> tuple[list[str], Sections]:
    """Return the names of the base files, and section -> preset -> settings, every key checked.

    ``config`` is the name of a file of ``zoo_configs`` without its suffix, or the path of one;
    ``model`` is what a section may say. Raises InputError if there is no such file, or it is not of
    this form; the sentence names the place.
    """
    file: Traversable = config if isinstance(config, Path) else CONFIGS / f"{config}.yml"
    name = str(config) if isinstance(config, Path) else f"zoo_configs/{config}.yml"
    try:
        return _parse(file.read_text(encoding="utf-8"), name, model)
    except (FileNotFoundError, IsADirectoryError):
        raise InputError(f"{name}: there is no such configuration") from None
    except UnicodeDecodeError as error:
        raise InputError(f"{name}: it is not valid YAML ({error}): fix it") from None


@lru_cache  # every learner that is made reads the same few files
def _parse(text: str, name: str, model: Any) -> tuple[list[str], Sections]:
    content = parse_yaml(text, name)
    if not isinstance(content, dict):
        raise InputError(f"{name}: it holds no sections: write one per environment id")
    base = content.pop("base", [])
    bases = [base] if isinstance(base, str) else base
    if not isinstance(bases, list) or not all(isinstance(b, str) for b in bases):
        raise InputError(f"{name}: base is {base!r}: name a file of zoo_configs, or a list of them")
    sections: Sections = {}
    for section, presets in content.items():
        place = f"{name}: {section}"
        wrong = presets
        if isinstance(presets, dict):
            if set(presets) & field_types(model).keys():  # rl_zoo3's: settings without a preset
                presets = {"default": ({} if bases else {"n_envs": 1}) | presets}
            wrong = next((str(key) for key in presets if key not in PRESETS), None)
        if wrong is not None:
            raise InputError(
                f"{place}: it holds {wrong!r}: a section holds the presets "
                f"{' and '.join(PRESETS)}, and these the settings"
            )
        for preset, settings in presets.items():
            if not isinstance(settings, dict):
                raise InputError(f"{place}: {preset} is {settings!r}: give a table of settings")
            named = {str(key): value for key, value in settings.items()}
            checked = model.check(named, f"{place}: {preset}: ")
            sections.setdefault(str(section), {})[preset] = checked
    return bases, sections
