"""The pieces of work of a benchmark, each keyed by a hash of everything that determines it.

A piece has a folder of its own, named by its key: what is there is never made again, and a changed
setting, recording, version or kernel makes another key and so another folder. The order is worlds
(the fitted locomotion of a species), clones (an offline phase that several cells begin with), cells
(a method with a seed: trained, rolled out), scores (a method over its seeds, measured).
"""

from __future__ import annotations

import json
import time
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any

from animarl_algos.benchmark.clones import COMMAND, cloning, opened
from animarl_algos.benchmark.measured import Score
from animarl_algos.benchmark.methods import (
    Checked,
    MethodSetting,
    foreign,
    load_factory,
    parameters_of,
    source_of,
)
from animarl_algos.benchmark.pieces import code, cost, hashed, write_cost, write_json
from animarl_algos.benchmark.references import reference_rollouts
from animarl_algos.benchmark.scores import crossed_score, score
from animarl_algos.evaluation.collect import collect_rollouts
from animarl_algos.evaluation.rollouts import Rollouts
from animarl_algos.runs import pipeline
from animarl_algos.runs.run import Run
from animarl_algos.runs.run_settings import RunSettings
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.worlds import make_world


@dataclass(frozen=True, eq=False)
class World:
    """The fitted world of one set of demonstrations, or of a fold of it, where everybody acts."""

    data: str
    settings: RunSettings
    demos: Demonstrations
    fold: int | None = None

    @property
    def name(self) -> str:
        return _world_name(self.data, self.fold)

    @cached_property
    def key(self) -> str:
        fingerprint = self.demos.fingerprint()
        return hashed(_resolved(self.settings) | code() | {"demonstrations": fingerprint})

    def folder(self, out: Path) -> Path:
        return out / "worlds" / f"{self.data}-{self.key}"

    def finished(self, out: Path) -> bool:
        return (self.folder(out) / "locomotion.json").exists()

    @property
    def needs(self) -> tuple[str, ...]:
        return ()

    def lacks(self, out: Path) -> str:
        return ""

    def perform(self, out: Path) -> None:
        pipeline.fit(pipeline.open_run(self.settings, self.folder(out), COMMAND, self.demos))


@dataclass(frozen=True, kw_only=True)
class Cell:
    """A method with a seed: trained if it learns, and rolled out from the test starts.

    ``settings`` are those of a recipe; without them it is a reference, or, with a ``factory``
    (``module:factory``), somebody's own method.
    """

    data: str
    method: str
    seed: int
    repetitions: int
    world: str
    fold: int | None = None
    settings: RunSettings | None = None
    factory: str | None = None

    @property
    def name(self) -> str:
        fold = "" if self.fold is None else f"/fold{self.fold}"
        return f"{self.data}/{self.method}/{self.seed}{fold}"

    @property
    def kind(self) -> str:
        if self.settings is not None:
            return "recipe"
        return "reference" if self.factory is None else "method"

    @cached_property
    def key(self) -> str:
        own: dict[str, Any] = {
            "method": self.method, "seed": self.seed, "repetitions": self.repetitions,
            "world": self.world, "factory": self.factory and source_of(self.factory),
        }  # fmt: skip
        return hashed(own | (_resolved(self.settings) if self.settings else {}) | code())

    def folder(self, out: Path) -> Path:
        return out / "cells" / f"{self.name.replace('/', '-')}-{self.key}"

    def finished(self, out: Path) -> bool:
        return bool(self.cost(out))

    @property
    def world_name(self) -> str:
        return _world_name(self.data, self.fold)

    def world_folder(self, out: Path) -> Run:
        return Run(out / "worlds" / f"{self.data}-{self.world}")

    @cached_property
    def cloning(self) -> RunSettings | None:
        """The run that its training begins with, if it is one of soft-label cloning."""
        return None if self.settings is None else cloning(self.settings)

    @cached_property
    def clone(self) -> str | None:
        """The key of that: cells of the same may share it."""
        own = self.cloning
        return None if own is None else hashed(_resolved(own) | {"world": self.world} | code())

    @property
    def clone_name(self) -> str:
        return f"{self.data}/clone/{self.seed}-{self.clone}"

    def clone_folder(self, out: Path) -> Path:
        return out / "clones" / f"{self.data}-{self.seed}-{self.clone}"

    @property
    def needs(self) -> tuple[str, ...]:
        return (self.world_name, self.clone_name) if self.clone else (self.world_name,)

    def lacks(self, out: Path) -> str:
        there = (self.world_folder(out).path / "locomotion.json").exists()
        return "" if there else f"the world of {self.data} could not be fitted"

    def perform(self, out: Path) -> None:
        began, folder = time.process_time(), self.folder(out)
        clone = Run(self.clone_folder(out) / "run") if cost(self.clone_folder(out)) else None
        rollouts, parameters = self._rolled_out(folder, self.world_folder(out), clone)
        rollouts.save(folder / "rollouts.npz")
        write_cost(folder, began, parameters, self.clone_name if clone else None)

    def _rolled_out(
        self, folder: Path, world: Run, clone: Run | None
    ) -> tuple[Rollouts, int | None]:
        if self.settings is not None:
            return self._trained(folder, world, clone, self.settings)
        if self.factory is None:
            made = reference_rollouts(
                self.method, world, self.seed, self.repetitions, fold=self.fold is not None
            )
            return made, None
        setting = MethodSetting.of(world, self.seed)
        factory = load_factory(self.factory)
        with foreign(f"method {self.method}: its factory raised", "mend it"):
            policy = factory(setting)
        made = collect_rollouts(
            partial(make_world, world.scenario),
            Checked(self.method, policy, setting.species.num_actions),
            method=self.method, seed=self.seed, repetitions=self.repetitions,
            cue="actual" if setting.environment().condition_flag else None,
        )  # fmt: skip
        return made, parameters_of(policy)

    def _trained(
        self, folder: Path, world: Run, clone: Run | None, settings: RunSettings
    ) -> tuple[Rollouts, int]:
        run = opened(settings, folder, world)
        model = pipeline.learn(run, settings.algo, clone=clone, progress_bar=False)
        model.policy.seed(self.seed)
        made = collect_rollouts(
            partial(make_world, run.scenario),
            model,
            method=self.method,
            seed=self.seed,
            repetitions=self.repetitions,
            cue="actual" if model.layout.condition_flag else None,
        )
        return made, model.policy.q_net.num_parameters

    def rollouts(self, out: Path) -> Rollouts:
        return Rollouts.load(self.folder(out) / "rollouts.npz")

    def cost(self, out: Path) -> dict[str, Any]:
        return cost(self.folder(out))


@dataclass(frozen=True, kw_only=True)
class Scoring:
    """A method over all its seeds, measured against the recordings of the test split."""

    cells: tuple[Cell, ...]
    resamples: int

    @property
    def data(self) -> str:
        return self.cells[0].data

    @property
    def method(self) -> str:
        return self.cells[0].method

    @property
    def name(self) -> str:
        return f"{self.data}/{self.method}/score"

    @cached_property
    def key(self) -> str:
        own = {"cells": [cell.key for cell in self.cells], "resamples": self.resamples}
        return hashed(own | code())

    def folder(self, out: Path) -> Path:
        return out / "scores" / f"{self.data}-{self.method}-{self.key}"

    def finished(self, out: Path) -> bool:
        return (self.folder(out) / "score.json").exists()

    @property
    def needs(self) -> tuple[str, ...]:
        return tuple(cell.name for cell in self.cells)

    def lacks(self, out: Path) -> str:
        lacking = [cell.name for cell in self.cells if not cell.finished(out)]
        return f"{', '.join(lacking)} did not finish" if lacking else ""

    def perform(self, out: Path) -> None:
        first = self.cells[0]
        rollouts = [cell.rollouts(out) for cell in self.cells]
        if first.fold is None:
            demos = first.world_folder(out).demos
            joined = Rollouts.concatenate(rollouts, self.method)
            found = score(joined, demos, resamples=self.resamples)
        else:
            folds = {c.fold: c.world_folder(out).demos for c in self.cells}
            made = [(folds[cell.fold], own) for cell, own in zip(self.cells, rollouts)]
            found = crossed_score(made, self.method, resamples=self.resamples)
        found = replace(found, data=self.data, kind=first.kind)
        write_json(self.folder(out) / "score.json", found.to_json())

    def result(self, out: Path) -> Score:
        return Score.from_json(json.loads((self.folder(out) / "score.json").read_text()))


def _world_name(data: str, fold: int | None) -> str:
    return f"{data}/world" if fold is None else f"{data}/world/fold{fold}"


def _resolved(settings: RunSettings) -> dict[str, Any]:
    """A run's settings with everything that they leave to presets; where the file lies is not."""
    learner = settings.learner()
    own = {k: v for k, v in settings.model_dump().items() if k not in ("file", "source", "config")}
    return {"settings": own, "learner": learner.arguments, "environment": learner.env_kwargs}
