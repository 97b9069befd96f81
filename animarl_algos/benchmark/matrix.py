"""What a benchmark compares: species times recipes times seeds, read from one YAML file."""

from __future__ import annotations

from collections.abc import Iterable
from importlib import resources
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, field_validator, model_validator

from animarl_algos.checked import Checked
from animarl_algos.evaluation.statistics import RESAMPLES
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
Names = Annotated[tuple[str, ...], Field(strict=False)]
Count = Annotated[int, Field(ge=1)]


class Matrix(Checked):
    """Species times methods times seeds, and how each is trained and rolled out.

    Raises
    ------
    InputError
        If a value is wrong, or does not go with another.
    """

    species: Names = ()
    """Names of packaged species."""
    files: dict[str, str] = Field(default_factory=dict)
    """Further demonstrations: path by name of the row; no name of a packaged species."""
    recipes: Names = ()
    """The learners."""
    seeds: Annotated[tuple[Annotated[int, Field(ge=0)], ...], Field(strict=False)] = (0,)
    """Of each learner."""
    references: Names = REFERENCES
    """The rows beside them."""
    preset: Literal["default", "paper"] = "default"
    """Of ``zoo_configs``, for all recipes."""
    steps: Count | None = None
    """World steps of recipes that learn online; by default their preset's."""
    acting: str | None = None
    """How trained policies act, as ``animarl run --acting``; by default the preset's."""
    fit_method: str | None = None
    """As ``animarl run --fit-method``; by default the preset's."""
    thrusts: str | None = None
    """As ``animarl run --thrusts``; by default the preset's."""
    settings: dict[str, dict[str, Any]] = Field(default_factory=dict)
    """Settings of single recipes of the matrix, over those of the preset."""
    episodes: dict[str, Count] = Field(default_factory=dict)
    """At most so many of each split, drawn once; by default all."""
    folds: dict[str, int] = Field(default_factory=dict)
    """Into how many folds a set of ``species`` or ``files`` is cross-validated, by its name: every
    episode is tested once, by what was trained without its recording. By default its own split is
    taken."""
    repetitions: Count = 5
    """Rollouts from each test start."""
    resamples: Count = RESAMPLES
    """Of the intervals."""

    @field_validator("thrusts", mode="before")
    @classmethod
    def _as_text(cls, thrusts: Any) -> Any:
        return str(thrusts) if type(thrusts) is int else thrusts

    @model_validator(mode="after")
    def _check_names(self) -> Matrix:
        there = (*self.species, *self.files)
        if not there:
            raise InputError("species is empty: name one at least")
        for key in ("species", "recipes", "references", "seeds"):
            listed = list(getattr(self, key))
            if twice := [one for one in listed if listed.count(one) > 1]:
                raise InputError(f"{key} names {twice[0]!r} twice: name it once")
        if not self.seeds:
            raise InputError("seeds is empty: give one at least")
        _refuse_unknown("species", self.species, packaged_names())
        _refuse_unknown("references", self.references, REFERENCES)
        _refuse_unknown("episodes", self.episodes, SPLITS)
        _refuse_unknown("folds", self.folds, there)
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
        if self.folds and self.episodes:
            raise InputError("folds and episodes are both given: folds need all episodes")
        return self

    def recorded(self) -> dict[str, tuple[Demonstrations, ...]]:
        """Return the demonstrations of every row group, by name, as many as are asked for.

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
        """Return the settings of one training."""
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
        """Return those of the world that all share, and that those without training act in."""
        asked = self.run_settings(name, demos, WORLD_ALGO, 0)
        seen = {"env_kwargs": {"observation": "full"}}
        return asked.changed(overrides=seen, copies=WORLD_COPIES)


def _refuse_unknown(key: str, names: Iterable[str], known: Iterable[str]) -> None:
    if unknown := [name for name in names if name not in known]:
        raise InputError(f"{key} names {unknown[0]!r}: choose among {', '.join(known)}")


def read_matrix(preset: str, config: Path | None = None) -> Matrix:
    """Read a preset of ``zoo_configs/benchmark``, or the file ``config``.

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
    try:
        return Matrix(**content)
    except InputError as error:
        raise InputError(f"{place}: {error}") from None


def matrix_file(preset: str, config: Path | None = None) -> str:
    """Where :func:`read_matrix` reads, for messages."""
    return str(config or f"zoo_configs/benchmark/{preset}.yml")


def matrix_names() -> list[str]:
    """Return the presets that are there."""
    return sorted(f.name.removesuffix(".yml") for f in FOLDER.iterdir() if f.name.endswith(".yml"))
