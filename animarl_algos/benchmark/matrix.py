"""What a benchmark compares: species times recipes times seeds, read from one YAML file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from animarl_algos.evaluation.statistics import RESAMPLES
from animarl_algos.learner.presets import PRESETS
from animarl_algos.recipes.registry import named_recipe
from animarl_algos.runs.run_settings import RunSettings, pipeline_settings
from animarl_envs import environment_id
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.episode import SPLITS
from animarl_envs.demos.packaged import load_packaged, packaged_names
from animarl_envs.demos.splits import cross_validated
from animarl_envs.errors import InputError
from animarl_envs.importing.plain_yaml import parse_yaml, read_yaml
from animarl_envs.importing.readers import read
from animarl_envs.species import CUSTOM, SPECIES

FOLDER = resources.files("zoo_configs") / "benchmark"
REFERENCES = (
    "recordings", "tracking", "experts", "nearest", "scripted", "constant-velocity", "still",
    "random",
)  # fmt: skip
AROUND = ("acting", "fit_method", "thrusts")
WORLD_ALGO = "bc"  # any: the world of those who learned nothing is that of its preset
WORLD_COPIES = 16  # side by side, of the environment that others' methods train in


@dataclass(frozen=True, kw_only=True)
class Matrix:
    """Species times methods times seeds, and how each is trained and rolled out.

    Parameters
    ----------
    species
        Names of packaged species.
    files
        Further demonstrations: path by name of the row; no name of a packaged species.
    recipes, seeds, references
        The learners, the seeds of each, and the rows beside them (:data:`REFERENCES`).
    preset
        Of ``zoo_configs``, for all recipes.
    steps
        World steps of recipes that learn online; by default their preset's.
    acting, fit_method, thrusts
        As in :class:`~animarl_algos.runs.run_settings.RunSettings`; by default the preset's.
    settings
        Settings of single recipes of the matrix, over those of the preset.
    episodes
        At most so many of each split, drawn once; by default all.
    folds
        Into how many folds a set of ``species`` or ``files`` is cross-validated, by its name: every
        episode is tested once, by what was trained without its recording. By default its own split
        is taken.
    repetitions
        Rollouts from each test start.
    resamples
        Of the intervals.
    """

    species: tuple[str, ...] = ()
    files: Mapping[str, str] = field(default_factory=dict)
    recipes: tuple[str, ...] = ()
    seeds: tuple[int, ...] = (0,)
    references: tuple[str, ...] = REFERENCES
    preset: str = "default"
    steps: int | None = None
    acting: str | None = None
    fit_method: str | None = None
    thrusts: str | None = None
    settings: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    episodes: Mapping[str, int] = field(default_factory=dict)
    folds: Mapping[str, int] = field(default_factory=dict)
    repetitions: int = 5
    resamples: int = RESAMPLES

    def __post_init__(self) -> None:
        for key in ("species", "recipes", "references"):
            _listed(self, key, str, "names")
        _listed(self, "seeds", int, "whole numbers")
        for key, kind in (
            ("files", str), ("settings", Mapping), ("episodes", int), ("folds", int),
        ):  # fmt: skip
            table = getattr(self, key)
            if not isinstance(table, Mapping) or not all(isinstance(k, str) for k in table):
                raise InputError(f"{key} is {table!r}: give a table")
            if wrong := [name for name, one in table.items() if not isinstance(one, kind)]:
                raise InputError(
                    f"{key} of {wrong[0]} is {table[wrong[0]]!r}: see what belongs there"
                )
        for key in AROUND:
            value = getattr(self, key)
            if type(value) is int:  # 3 thrusts are "3" of them
                object.__setattr__(self, key, str(value))
            elif not isinstance(value, str | None):
                raise InputError(f"{key} is {value!r}: give a text")
        if not (self.species or self.files):
            raise InputError("species is empty: name one at least")
        for name in self.species:
            if name not in packaged_names():
                known = ", ".join(packaged_names())
                raise InputError(f"species {name!r} is unknown: choose among {known}")
        for name in self.files:
            if name in packaged_names() or not name.replace("-", "").replace("_", "").isalnum():
                raise InputError(
                    f"files names {name!r}: give it a name of letters, digits, - and _ that is no "
                    "packaged species"
                )
        for name in (*self.recipes, *self.settings):
            named_recipe(name)
        if beside := [name for name in self.settings if name not in self.recipes]:
            raise InputError(
                f"settings are given for {beside[0]!r}, which is not among the recipes: add it "
                "there, or leave its settings out"
            )
        if unknown := [name for name in self.references if name not in REFERENCES]:
            raise InputError(
                f"reference {unknown[0]!r} is unknown: choose among {', '.join(REFERENCES)}"
            )
        if self.preset not in PRESETS:
            raise InputError(f"preset {self.preset!r} is unknown: choose {' or '.join(PRESETS)}")
        if not self.seeds or min(self.seeds) < 0:
            raise InputError(f"seeds is {list(self.seeds)}: give one at least, none negative")
        for key in ("steps", "repetitions", "resamples"):
            if (value := getattr(self, key)) is not None:
                _positive(key, value)
        for split, number in self.episodes.items():
            if split not in SPLITS:
                raise InputError(f"episodes names {split!r}: choose among {', '.join(SPLITS)}")
            _positive(f"episodes of {split}", number)
        there = (*self.species, *self.files)
        if unknown := [name for name in self.folds if name not in there]:
            raise InputError(f"folds names {unknown[0]!r}: choose among {', '.join(there)}")
        if self.folds and self.episodes:
            raise InputError("folds and episodes are both given: folds need all episodes")

    def recorded(self) -> dict[str, tuple[Demonstrations, ...]]:
        """The demonstrations of every row group, by name, as many as are asked for.

        Split as they are, or as often as there are folds.
        """
        found = {name: load_packaged(name) for name in self.species}
        found |= {name: read(Path(file), None) for name, file in self.files.items()}
        dealt = {
            name: tuple(cross_validated(demos, self.folds[name]))
            if name in self.folds
            else (self._fewer(demos),)
            for name, demos in found.items()
        }
        for name, (demos, *_) in dealt.items():
            for split in SPLITS:
                if not (demos.split == split).any():
                    raise InputError(f"{name}: no episode is in its {split} split: deal it again")
        return dealt

    def _fewer(self, demos: Demonstrations) -> Demonstrations:
        """The same episodes whenever it is asked."""
        if not self.episodes:
            return demos
        rng = np.random.default_rng(0)
        kept = []
        for split in SPLITS:
            there = np.flatnonzero(demos.split == split)
            number = min(len(there), self.episodes.get(split, len(there)))
            kept.append(rng.choice(there, number, replace=False))
        return demos.select(episodes=np.sort(np.concatenate(kept)))

    def run_settings(self, name: str, demos: Demonstrations, algo: str, seed: int) -> RunSettings:
        """Of one training."""
        species = demos.species if demos.species in SPECIES else CUSTOM
        around = pipeline_settings(environment_id(species), self.preset)
        around |= {"preset": self.preset}
        around |= {k: v for k in AROUND if (v := getattr(self, k)) is not None}
        asked = RunSettings(
            file=name, species=species, algo=algo, steps=1, seed=seed,
            repetitions=self.repetitions, baselines=False,
            overrides=dict(self.settings.get(algo, {})), **around,
        )  # fmt: skip
        learner = asked.learner()
        online = bool(named_recipe(algo).algorithm.recipe.online)
        steps = self.steps if self.steps is not None and online else learner.n_timesteps
        return asked.changed(steps=steps, copies=learner.n_envs)

    def world_settings(self, name: str, demos: Demonstrations) -> RunSettings:
        """Of the world that all methods share, and that those without training act in."""
        asked = self.run_settings(name, demos, WORLD_ALGO, 0)
        seen = {"env_kwargs": {"observation": "full"}}
        return asked.changed(overrides=seen, copies=WORLD_COPIES)


def read_matrix(preset: str, config: Path | None = None) -> Matrix:
    """A preset of ``zoo_configs/benchmark``, or the file ``config``.

    Raises
    ------
    InputError
        If there is no such preset or file, or a key or a value is wrong; the place is named.
    """
    place = matrix_file(preset, config)
    if config is None:
        if preset not in matrix_names():
            raise InputError(f"preset {preset!r} is unknown: choose {', '.join(matrix_names())}")
        content = parse_yaml((FOLDER / f"{preset}.yml").read_text(encoding="utf-8"), place)
    elif not config.is_file():
        raise InputError(f"{config}: there is no such file: write a matrix, or give --preset")
    else:
        content = read_yaml(config)
    if not isinstance(content, dict):
        raise InputError(f"{place}: it holds no table: give species, recipes and seeds")
    known = [one.name for one in fields(Matrix)]
    if unknown := [key for key in content if key not in known]:
        raise InputError(f"{place}: key {unknown[0]!r} is unknown: choose among {', '.join(known)}")
    try:
        return Matrix(**content)
    except InputError as error:
        raise InputError(f"{place}: {error}") from None


def matrix_file(preset: str, config: Path | None = None) -> str:
    """Where :func:`read_matrix` reads, for messages."""
    return str(config or f"zoo_configs/benchmark/{preset}.yml")


def matrix_names() -> list[str]:
    """The presets that are there."""
    return sorted(f.name.removesuffix(".yml") for f in FOLDER.iterdir() if f.name.endswith(".yml"))


def _listed(matrix: Matrix, key: str, kind: type, words: str) -> None:
    """Make a tuple of a list; refuse anything else, and what is in it twice."""
    value = getattr(matrix, key)
    if not isinstance(value, list | tuple) or not all(type(one) is kind for one in value):
        raise InputError(f"{key} is {value!r}: give a list of {words}")
    if twice := [one for one in value if list(value).count(one) > 1]:
        raise InputError(f"{key} names {twice[0]!r} twice: name it once")
    object.__setattr__(matrix, key, tuple(value))


def _positive(key: str, value: Any) -> None:
    if type(value) is not int or value < 1:
        raise InputError(f"{key} is {value!r}: give a whole number of at least 1")
