"""The paper made anew: its learners, seeds and worlds as cells of the benchmark, and their records.

Cells are trained by the machinery of the benchmark. What the tables and figures need of a finished
cell is kept in a record of some kilobytes, from which alone the page is made. Records that are
committed stand for cells that are not in a folder of results.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd

from animarl_algos.benchmark.departures import (
    DEPARTED,
    DEPARTED_STEPS,
    DEPARTURES,
    PUBLISHED,
    TOGETHER,
    setting_of,
)
from animarl_algos.benchmark.matrix import Matrix, Plan, plan
from animarl_algos.benchmark.pieces import Cell
from animarl_algos.benchmark.scores import REALISM, score
from animarl_algos.evaluation.metrics import DTW, DURATION, PATH_LENGTH, measure
from animarl_algos.evaluation.rollouts import Rollouts
from animarl_algos.recipes.registry import named_recipe
from animarl_algos.runs.run import Run
from animarl_envs.array_types import Floats, Ints
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.errors import InputError
from animarl_envs.files import read_npz, write_then_rename
from animarl_envs.species import get_species, species_name

SPECIES = ("agent", "fly", "newt", "silkmoth")
LEARNERS = ("dqn", "bc", "dqaas", "dqdil-pt", "dqdil", "dqcil-pt", "dqcil")
COUNTERFACTUAL = ("dqdil-pt", "dqcil-pt", "dqdil", "dqcil")
ADAPTING = ("dqdil-pt", "dqcil-pt", "dqaas")
ADAPTED_STEPS = (5_000, 20_000, 100_000)
PAPER_STEPS = 1_005_000
ONSET: Final = "onset"
JOINT: Final = "joint"
ADAPTED: Final = "adapted"
SETTINGS = (ONSET, JOINT, ADAPTED, DEPARTED)
"""The paper's world (its onset rule fits the locomotion), the world of the joint fit, clones of the
default preset that adapt online, and departures from published settings in the joint world."""
SIMULATED = "dqdil-pt"
"""The learner of Figures 2 and 3, which departs from its published settings."""
ADAPTED_QUICK = (100,)
QUICK: dict[str, Any] = {
    "steps": 400,
    "repetitions": 2,
    "episodes": {"train": 60, "val": 4, "test": 8},
}
QUICK_CLONE = {"offline_epochs": 1, "offline_kwargs": {"updates_per_epoch": 10, "warm_up": 2}}
RECORD_VERSION = 1
COLUMNS = {"demo": np.int16, "repetition": np.int16, "condition": np.int8, "cue": np.int8}
VALUES = ("captured", DURATION.key, PATH_LENGTH.key, DTW.key)
SPEED_BINS = 40
SCORE_RESAMPLES = 1000


@dataclass(frozen=True, kw_only=True)
class Scope:
    """The part of the paper that is made.

    ``steps`` are those of the online phase in both worlds; ``quick`` takes few of everything.
    """

    species: tuple[str, ...] = SPECIES
    learners: tuple[str, ...] = LEARNERS
    seeds: tuple[int, ...] = (0, 1, 2)
    settings: tuple[str, ...] = SETTINGS
    steps: int | None = None
    quick: bool = False

    def __post_init__(self) -> None:
        object.__setattr__(self, "species", tuple(map(species_name, self.species)))
        for option, given, known in (
            ("--species", self.species, SPECIES),
            ("--only", self.learners, LEARNERS),
            ("--setting", self.settings, SETTINGS),
        ):
            if unknown := [one for one in given if one not in known]:
                raise InputError(
                    f"{option} {unknown[0]}: it is not in the paper: choose among "
                    f"{', '.join(known)}"
                )
        for name in self.species:
            if not self.learners_of(name):
                raise InputError(
                    f"--only {self.learners[0]}: {name} has one condition, and this learner needs "
                    "two: choose --species agent or silkmoth, or dqdil"
                )

    def learners_of(self, species: str) -> tuple[str, ...]:
        """Return the learners that are defined for a species, in the paper's order."""
        return tuple(
            name
            for name in LEARNERS
            if name in self.learners
            and (
                get_species(species).conditions
                or not named_recipe(name).algorithm.recipe.needs_condition
            )
        )

    @property
    def departed_steps(self) -> int:
        """Steps of the online phase of departures, and of the adapted clone beside them."""
        return ADAPTED_QUICK[0] if self.quick else DEPARTED_STEPS

    @cached_property
    def cells(self) -> tuple[PaperCell, ...]:
        """All cells, one species after another."""
        return tuple(cell for name in self.species for cell in self._cells_of(name))

    def _cells_of(self, species: str) -> Iterator[PaperCell]:
        for setting in self.settings:
            if setting == DEPARTED:
                if SIMULATED in self.learners:
                    yield from self._departed(species)
                continue
            if setting != ADAPTED:
                more = {} if setting == ONSET else {"fit_method": JOINT}
                learners = self.learners_of(species)
                planned = self._plan(species, learners, self.steps, preset="paper", **more)
                yield from (PaperCell(setting, cell, planned, self.quick) for cell in planned.cells)
                continue
            adapting = tuple(name for name in self.learners_of(species) if name in ADAPTING)
            levels = ADAPTED_QUICK if self.quick else ADAPTED_STEPS
            for learners, some in ((("soft-bc",), (0,)), (adapting, levels)):
                if not learners:
                    continue
                planned = self._plan(species, learners, None)
                for steps, cell in product(some, planned.cells):
                    assert cell.settings is not None
                    settings = cell.settings.changed(steps=steps or cell.settings.steps)
                    own = replace(cell, settings=settings)
                    yield PaperCell(f"{setting}-{steps}", own, planned, self.quick)

    def _departed(self, species: str) -> Iterator[PaperCell]:
        steps, around = self.departed_steps, {"preset": "paper", "fit_method": JOINT}
        planned = self._plan(species, (SIMULATED,), steps, **around)
        for name in (PUBLISHED, TOGETHER[-1]) if self.quick else DEPARTURES:
            for cell in planned.cells:
                assert cell.settings is not None
                own = replace(cell, settings=DEPARTURES[name].changed(cell.settings))
                yield PaperCell(setting_of(name), own, planned, self.quick)

    def _plan(
        self, species: str, learners: tuple[str, ...], steps: int | None, **more: Any
    ) -> Plan:
        if self.quick:
            pretrained = [one for one in learners if named_recipe(one).pretrained]
            clone = QUICK_CLONE if not more else {"offline_epochs": 1}
            more = QUICK | {"settings": dict.fromkeys(pretrained, clone)} | more
            more |= {} if more.get("preset") else {"acting": "boltzmann:1", "thrusts": "1"}
        more |= {} if steps is None else {"steps": steps}
        return plan(
            Matrix(species=(species,), recipes=learners, seeds=self.seeds, references=(), **more)
        )


@dataclass(frozen=True, eq=False)
class PaperCell:
    """A cell of the benchmark in one setting of the page, and where its record is."""

    setting: str
    cell: Cell
    plan: Plan
    quick: bool

    @property
    def name(self) -> str:
        """Name of the record."""
        cell = self.cell
        return f"{cell.data}-{cell.method}-{self.setting}-{cell.seed}"

    @property
    def steps(self) -> int:
        """Return the steps of the online phase, 0 for learners without one."""
        assert self.cell.settings is not None
        online = named_recipe(self.cell.method).algorithm.recipe.online
        return self.cell.settings.steps if online else 0

    @property
    def demos(self) -> Demonstrations:
        """Return all demonstrations of its species that are used."""
        return self.plan.worlds[0].demos

    def record_file(self, out: Path) -> Path:
        """Return where the record of this very cell lies, or would."""
        return out / "records" / f"{self.name}-{self.cell.key}.npz"

    def find_record(self, out: Path, kept: Path) -> tuple[Record | None, bool]:
        """Return the record of this very cell in ``out``, or a kept one, and whether it is kept.

        A kept record is of the same species, learner, setting, steps and seed, made by the commit
        that it names.
        """
        file, there = self.record_file(out), kept / f"{self.name}.npz"
        if not file.exists() and self.cell.finished(out):
            Record.of(self, out).save(file)
        if file.exists():
            return Record.load(file), False
        record = Record.load(there) if there.exists() and not self.quick else None
        of_steps = record is not None and record.about["steps"] == self.steps
        return record if of_steps else None, of_steps


@dataclass(frozen=True, eq=False)
class Record:
    """What tables and figures need of one cell.

    Parameters
    ----------
    about
        ``species``, ``learner``, ``setting``, ``seed``, ``steps``, ``commit``,
        ``processor_seconds``; of adapted clones also ``realism`` and ``verdict``.
    episodes
        One row per rollout: start, condition, cue and :data:`VALUES`.
    speeds
        ``(bins,)`` counts of the speeds of all individuals, as :func:`count_speeds`.
    paths
        ``(frames, individuals, 2)`` of one rollout per condition and cue, by ``"condition-cue"``,
        in the two worlds alone, whose paths are drawn.
    """

    about: dict[str, Any]
    episodes: pd.DataFrame
    speeds: Ints
    paths: Mapping[str, Floats]

    @classmethod
    def of(cls, one: PaperCell, out: Path) -> Record:
        """Return the record of a finished cell.

        In the two worlds, learners of Figure 5 are also simulated with the other cue.
        """
        cell, run = one.cell, Run(one.cell.folder(out) / "run")
        demos = one.demos
        test, factual = demos.select(split="test"), cell.rollouts(out)
        rollouts = [factual]
        drawn = one.setting in (ONSET, JOINT)
        if cell.method in COUNTERFACTUAL and run.species.conditions and drawn:
            rollouts.append(run.simulate(flag="flipped", repetitions=cell.repetitions))
        about = {
            "version": RECORD_VERSION,
            "species": cell.data,
            "learner": cell.method,
            "setting": one.setting,
            "seed": cell.seed,
            "steps": one.steps,
            "commit": run.record["machine"]["commit"],
            "processor_seconds": round(cell.cost(out)["processor_seconds"]),
        }
        if not drawn:
            scored = score(factual, demos, resamples=SCORE_RESAMPLES)
            about |= {"verdict": scored.words, "realism": scored.by_measure[REALISM]["value"]}
        paths = {}
        for made in rollouts if drawn else ():
            for condition, start in example_starts(test).items():
                example = int(np.flatnonzero((made.demo == start) & (made.repetition == 0))[0])
                paths[f"{condition}-{made.cue[example]}"] = made.path(example)
        table = pd.concat([measure(made, test) for made in rollouts], ignore_index=True)
        return cls(
            about,
            table[[*COLUMNS, *VALUES]].astype(COLUMNS | dict.fromkeys(VALUES, np.float32)),
            count_speeds(factual, test),
            paths,
        )

    def save(self, file: Path) -> None:
        """Write a file that holds no code."""
        arrays: dict[str, Any] = {name: self.episodes[name].to_numpy() for name in COLUMNS}
        arrays |= {name: self.episodes[name].to_numpy() for name in VALUES}
        arrays |= {f"path {name}": np.float32(path) for name, path in self.paths.items()}
        about = np.array(json.dumps(self.about))
        file.parent.mkdir(parents=True, exist_ok=True)
        with write_then_rename(file) as part:
            np.savez_compressed(part, about=about, speeds=self.speeds, **arrays)

    @classmethod
    def load(cls, file: Path) -> Record:
        """Read a record; InputError if it is damaged or of another version."""
        arrays = read_npz(file)
        try:
            about = json.loads(str(arrays["about"]))
            episodes = pd.DataFrame({name: arrays[name] for name in (*COLUMNS, *VALUES)})
            speeds = arrays["speeds"]
        except (KeyError, ValueError) as error:
            raise InputError(f"{file}: it is no record of a cell ({error}): remove it") from error
        if about["version"] != RECORD_VERSION:
            raise InputError(
                f"{file}: it is of version {about['version']}, this is {RECORD_VERSION}: remove it"
            )
        paths = {
            name.removeprefix("path "): path
            for name, path in arrays.items()
            if name.startswith("path ")
        }
        return cls(about, episodes, speeds, paths)


def example_starts(test: Demonstrations) -> dict[int, int]:
    """Return the test episode of median length of each condition, by condition."""
    starts = {}
    for condition in np.unique(test.condition).tolist():
        own = np.flatnonzero(test.condition == condition)
        starts[condition] = int(own[np.argsort(test.lengths[own], kind="stable")[len(own) // 2]])
    return starts


def speed_edges(test: Demonstrations) -> Floats:
    """Return the edges of bins up to a quarter beyond the top speed of the recordings."""
    top = Rollouts.from_demonstrations(test).speeds().max()
    return np.linspace(0.0, 1.25 * top, SPEED_BINS + 1)


def count_speeds(rollouts: Rollouts, test: Demonstrations) -> Ints:
    """Return how many speeds of all individuals lie in each bin; higher ones in the last."""
    edges = speed_edges(test)
    return np.histogram(np.minimum(rollouts.speeds(), edges[-1]), edges)[0]
