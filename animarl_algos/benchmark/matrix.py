"""What a benchmark compares: species times recipes times seeds, read from one YAML file.

All that a matrix asks for becomes pieces of work, refused as a whole before anything runs.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from animarl_algos.benchmark.pieces import Cell, FittedWorld, Piece, Scoring
from animarl_algos.evaluation.own_measures import register_measures
from animarl_algos.evaluation.statistics import RESAMPLES
from animarl_algos.evaluation.teams import teams_of
from animarl_algos.recipes.registry import RECIPES, named_recipe
from animarl_algos.runs.pipeline import check_run, with_recipe
from animarl_algos.runs.run_files import versions, write_json
from animarl_algos.runs.run_settings import Preset, RunSettings, pipeline_settings
from animarl_envs import environment_id
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.episode import SPLITS
from animarl_envs.demos.packaged import load_packaged, packaged_names
from animarl_envs.demos.splits import cross_validated
from animarl_envs.errors import InputError
from animarl_envs.files import is_part, read_yaml
from animarl_envs.importing.readers import read
from animarl_envs.settings import Checked, Count, CountOrZero
from animarl_envs.species import CUSTOM, SPECIES

FOLDER = resources.files("zoo_configs") / "benchmark"
REFERENCES = (
    "recordings",
    "tracking",
    "experts",
    "nearest",
    "scripted",
    "constant-velocity",
    "still",
    "random",
)
AROUND = ("acting", "fit_method", "thrusts")
WORLD_ALGO = "bc"  # any: the world of those who learned nothing is that of its preset
WORLD_COPIES = 16  # side by side, of the environment that others' methods train in
Names = tuple[str, ...]


@dataclass(frozen=True, kw_only=True)
class Matrix(Checked):
    """Species times methods times seeds, and how each is trained and rolled out."""

    species: Names = ()
    """Names of packaged species."""
    files: dict[str, str] = field(default_factory=dict)
    """Further demonstrations: path by name of the row; no name of a packaged species."""
    recipes: Names = ()
    """The learners."""
    seeds: tuple[CountOrZero, ...] = (0,)
    """Of each learner."""
    references: Names = REFERENCES
    """The rows beside them."""
    preset: Preset = "default"
    """Of ``zoo_configs``, for all recipes."""
    steps: Count | None = None
    """World steps of recipes that learn online; by default their preset's."""
    acting: str | None = None
    """How trained policies act, as ``animarl run --acting``; by default the preset's."""
    fit_method: str | None = None
    """As ``animarl run --fit-method``; by default the preset's."""
    thrusts: str | None = None
    """As ``animarl run --thrusts``; by default the preset's."""
    settings: dict[str, dict[str, Any]] = field(default_factory=dict)
    """Settings of single recipes of the matrix, over those of the preset."""
    episodes: dict[str, Count] = field(default_factory=dict)
    """At most so many of each split, drawn once; by default all."""
    folds: dict[str, int] = field(default_factory=dict)
    """Into how many folds a set of ``species`` or ``files`` is cross-validated, by its name: every
    episode is tested once, by what was trained without its recording. By default its own split is
    taken."""
    repetitions: Count = 5
    """Rollouts from each test start."""
    resamples: Count = RESAMPLES
    """Of the intervals."""
    measures: Names = ()
    """Of your own, FILE.py:FUNCTION, beside the others; their files are run."""

    def __post_init__(self) -> None:
        super().__post_init__()
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

    def recorded(self) -> dict[str, tuple[Demonstrations, ...]]:
        """Return the demonstrations of every row group, by name, as many as are asked for.

        Split as they are, or as often as there are folds.
        """
        sets = {name: load_packaged(name) for name in self.species}
        sets |= {name: read(Path(file), None) for name, file in self.files.items()}
        dealt = {
            name: tuple(cross_validated(demos, self.folds[name]))
            if name in self.folds
            else (self._fewer(demos),)
            for name, demos in sets.items()
        }
        for name, (demos, *_) in dealt.items():
            for split in SPLITS:
                if not (demos.split == split).any():
                    raise InputError(f"{name}: no episode is in its {split} split: deal it again")
        return dealt

    def _fewer(self, demos: Demonstrations) -> Demonstrations:
        """Return at most as many episodes of each split as are asked for, always the same ones."""
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
        wanted = RunSettings(
            file=name,
            species=species,
            algo=algo,
            steps=1,
            seed=seed,
            repetitions=self.repetitions,
            baselines=False,
            overrides=dict(self.settings.get(algo, {})),
            **around,
        )
        learner = wanted.learner()
        online = bool(named_recipe(algo).algorithm.recipe.online)
        steps = self.steps if self.steps is not None and online else learner.n_timesteps
        return with_recipe(wanted.changed(steps=steps, copies=learner.n_envs), demos)[0]

    def world_settings(self, name: str, demos: Demonstrations) -> RunSettings:
        """Return those of the world that all share, and that those without training act in."""
        of_world = self.run_settings(name, demos, WORLD_ALGO, 0)
        seen = {"env_kwargs": {"observation": "full"}}
        return of_world.changed(overrides=seen, copies=WORLD_COPIES)


def _refuse_unknown(key: str, names: Iterable[str], known: Iterable[str]) -> None:
    if unknown := [name for name in names if name not in known]:
        raise InputError(f"{key} names {unknown[0]!r}: choose among {', '.join(known)}")


def read_matrix(preset: str, config: Path | None = None) -> Matrix:
    """Read a preset of ``zoo_configs/benchmark``, or the file ``config``; a refusal names it."""
    place = matrix_file(preset, config)
    if config is None and preset not in matrix_names():
        raise InputError(f"preset {preset!r} is unknown: choose {', '.join(matrix_names())}")
    content = read_yaml(config or Path(str(FOLDER / f"{preset}.yml")))
    if not isinstance(content, dict):
        raise InputError(f"{place}: it holds no table: give species, recipes and seeds")
    if type(content.get("thrusts")) is int:
        content["thrusts"] = str(content["thrusts"])
    return Matrix.of(content, f"{place}: ")


def matrix_file(preset: str, config: Path | None = None) -> str:
    """Where :func:`read_matrix` reads, for messages."""
    return str(config or f"zoo_configs/benchmark/{preset}.yml")


def matrix_names() -> list[str]:
    """Return the presets that are there."""
    return sorted(f.name.removesuffix(".yml") for f in FOLDER.iterdir() if f.name.endswith(".yml"))


FORMAT_VERSION = 1
MARK = "benchmark.json"
"""Marks a folder of results."""


@dataclass(frozen=True, eq=False)
class Plan:
    """Worlds first, then cells, then scores; within these any order gives the same."""

    matrix: Matrix
    worlds: tuple[FittedWorld, ...]
    cells: tuple[Cell, ...]
    scorings: tuple[Scoring, ...]

    @property
    def stages(self) -> tuple[tuple[Piece, ...], ...]:
        """Worlds, cells and scores."""
        return self.worlds, self.cells, self.scorings

    def only(self, patterns: Sequence[str]) -> Plan:
        """Return the rows that match a pattern, ``species/method`` or ``species/method/seed``."""
        if not patterns:
            return self
        for pattern in patterns:
            if not any(_matches(cell, pattern) for cell in self.cells):
                some = ", ".join(cell.name for cell in self.cells[:3])
                raise InputError(f"--only {pattern}: no cell is called so: write as in {some}")
        kept = tuple(c for c in self.cells if any(_matches(c, p) for p in patterns))
        needed, chosen = {cell.data for cell in kept}, {cell.name for cell in kept}
        return Plan(
            self.matrix,
            tuple(world for world in self.worlds if world.data in needed),
            kept,
            tuple(one for one in self.scorings if chosen.issuperset(c.name for c in one.cells)),
        )


def plan(matrix: Matrix, methods: Mapping[str, str] | None = None, place: str = "") -> Plan:
    """Return what there is to do.

    ``methods`` are others' methods, ``module:factory`` by name; ``place`` is the file that the
    matrix stands in, for messages. Refused is a recipe that cannot learn from a set of
    demonstrations, a method with the name of a row, and nothing to do.
    """
    methods = methods or {}
    register_measures(matrix.measures)
    for name in methods:
        if name in (*RECIPES, *matrix.references):
            raise InputError(f"--method {name}: there is a row of that name: choose another")
    try:
        worlds = [
            FittedWorld(data, matrix.world_settings(data, demos), demos, fold)
            for data, folds in matrix.recorded().items()
            for fold, demos in (enumerate(folds) if len(folds) > 1 else [(None, folds[0])])
        ]
        cells = [cell for world in worlds for cell in _cells_in(world, matrix, methods)]
        if not cells:
            raise InputError("there is nothing to do: name recipes or references")
    except InputError as error:
        raise InputError(f"{place}: {error}" if place else str(error)) from error
    rows: dict[tuple[str, str], list[Cell]] = {}
    for cell in cells:
        rows.setdefault((cell.data, cell.method), []).append(cell)
    scorings = [
        Scoring(cells=tuple(row), resamples=matrix.resamples, measures=matrix.measures)
        for row in rows.values()
    ]
    return Plan(matrix, tuple(worlds), tuple(cells), tuple(scorings))


def _cells_in(world: FittedWorld, matrix: Matrix, methods: Mapping[str, str]) -> Iterator[Cell]:
    demos = world.demos
    shared: dict[str, Any] = {
        "data": world.data,
        "repetitions": matrix.repetitions,
        "world": world.key,
        "fold": world.fold,
    }
    for algo in matrix.recipes:
        settings = [matrix.run_settings(world.data, demos, algo, seed) for seed in matrix.seeds]
        check_run(settings[0], demos)
        yield from (Cell(**shared, method=algo, seed=s.seed, settings=s) for s in settings)
    for name, factory in methods.items():
        yield from (Cell(**shared, method=name, seed=s, factory=factory) for s in matrix.seeds)
    for name in matrix.references:
        if name != "experts" or teams_of(demos) is not None:
            yield Cell(**shared, method=name, seed=matrix.seeds[0])


def claim_folder(out: Path, mark: bool = True) -> None:
    """Mark a folder as one of results of this version; refuse one that holds something else."""
    file, own = out / MARK, {"format": FORMAT_VERSION, "animarl": versions()["animarl"]}
    others = out.is_dir() and any(not is_part(inside) for inside in out.iterdir())
    if file.exists():  # asked last: another command may be about to mark it
        try:
            there = dict(json.loads(file.read_text()))
        except (ValueError, TypeError) as error:
            raise InputError(f"{file}: it is damaged ({error}): name another --out") from None
        if there != own:
            raise InputError(
                f"{out}: its results are of animarl {there.get('animarl')} (format "
                f"{there.get('format')}), this is {own['animarl']} (format {FORMAT_VERSION}): "
                "name another --out"
            )
    elif others:
        raise InputError(f"{out}: it holds something that is no benchmark: name another --out")
    elif mark:
        write_json(file, own)


def _matches(cell: Cell, pattern: str) -> bool:
    row = f"{cell.data}/{cell.method}"
    return any(fnmatchcase(name, pattern) for name in (cell.name, f"{row}/{cell.seed}", row))
