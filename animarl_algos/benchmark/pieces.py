"""The pieces of work of a benchmark, each in a folder that a hash of its settings names.

A finished piece is never made again; another setting, recording, version or kernel gives another
hash and so another folder. Worlds (the fitted locomotion of a species) come first, then cells (a
method with a seed: trained and rolled out), then scores (a method over its seeds, measured).
"""

from __future__ import annotations

import hashlib
import json
import shutil
import time
import traceback
import warnings
from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Mapping
from concurrent.futures.process import BrokenProcessPool
from dataclasses import asdict, dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import Any, ClassVar

import torch
from filelock import FileLock, Timeout
from joblib import Parallel, delayed, parallel_config
from threadpoolctl import threadpool_limits

from animarl_algos.benchmark import methods
from animarl_algos.benchmark.scores import Score, crossed_score, score
from animarl_algos.evaluation.collect import Cue, collect_rollouts
from animarl_algos.evaluation.own_measures import measure_source, register_measures
from animarl_algos.evaluation.rollouts import Rollouts
from animarl_algos.runs import pipeline
from animarl_algos.runs.run import Run
from animarl_algos.runs.run_files import versions, write_json
from animarl_algos.runs.run_settings import RunSettings
from animarl_envs.compiling import source_key
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.errors import InputError
from animarl_envs.worlds import make_world

COMMAND = "animarl benchmark"
ERROR, LOCK, COST = "error.json", ".piece.lock", "cost.json"
INTERRUPTED = "interrupted.json"
"""File of the processor seconds of attempts that did not end."""
BACKENDS = ("loky", "ray")
"""Of joblib: processes of this machine, or a Ray cluster."""
LOOK_AGAIN = 1.0  # [s] until a piece that another command works on is tried again


class Piece(ABC):
    """A piece of work; it may be sent to another process."""

    STAGE: ClassVar[str]
    RESULT: ClassVar[str] = COST

    @property
    @abstractmethod
    def name(self) -> str:
        """Name in errors and tables."""

    @property
    @abstractmethod
    def key(self) -> str:
        """A hash of everything that determines its result."""

    @abstractmethod
    def ready(self, out: Path) -> bool:
        """Return whether everything that it needs is finished."""

    @abstractmethod
    def perform(self, out: Path) -> None:
        """Make the result, going on from what an earlier attempt left."""

    def folder(self, out: Path) -> Path:
        """Return the folder of all its files."""
        return out / self.STAGE / f"{self.name.replace('/', '-')}-{self.key}"

    def finished(self, out: Path) -> bool:
        """Return whether its result exists."""
        return (self.folder(out) / self.RESULT).exists()

    def error(self, out: Path) -> str:
        """Return the error of the last attempt; empty if it did not fail."""
        file = self.folder(out) / ERROR
        return str(json.loads(file.read_text())["error"]) if file.exists() else ""


@dataclass(frozen=True, eq=False)
class FittedWorld(Piece):
    """The fitted world of one set of demonstrations, or of a fold of it, where everybody acts."""

    STAGE, RESULT = "worlds", "locomotion.json"
    data: str
    settings: RunSettings
    demos: Demonstrations
    fold: int | None = None

    @property
    def name(self) -> str:
        """Name in errors and tables."""
        return _world_name(self.data, self.fold)

    @cached_property
    def key(self) -> str:
        """A hash of settings and demonstrations."""
        return _hash_of(_resolve(self.settings) | {"demonstrations": self.demos.fingerprint()})

    def ready(self, out: Path) -> bool:
        """Return True: a world needs nothing."""
        return True

    def perform(self, out: Path) -> None:
        """Fit the locomotion."""
        pipeline.fit(pipeline.open_run(self.settings, self.folder(out), COMMAND, self.demos))


@dataclass(frozen=True, kw_only=True)
class Cell(Piece):
    """A method with a seed: trained if it learns, and rolled out from the test starts.

    ``world`` is the key of its fitted world. ``settings`` are those of a recipe; without them it is
    a reference, or, with a ``factory`` (``module:factory``), somebody's own method.
    """

    STAGE = "cells"
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
        """Name in errors and tables."""
        fold = "" if self.fold is None else f"/fold{self.fold}"
        return f"{self.data}/{self.method}/{self.seed}{fold}"

    @property
    def kind(self) -> str:
        """``recipe``, ``reference`` or ``method``."""
        if self.settings is not None:
            return "recipe"
        return "reference" if self.factory is None else "method"

    @cached_property
    def key(self) -> str:
        """A hash of settings, world and source of the method."""
        own: dict[str, Any] = {
            "method": self.method,
            "seed": self.seed,
            "repetitions": self.repetitions,
            "world": self.world,
            "factory": self.factory and methods.source_of(self.factory),
        }
        return _hash_of(own | (_resolve(self.settings) if self.settings else {}))

    def ready(self, out: Path) -> bool:
        """Return whether the world is fitted."""
        return (self.world_run(out).path / FittedWorld.RESULT).exists()

    def world_run(self, out: Path) -> Run:
        """Return the run of its fitted world."""
        name = _world_name(self.data, self.fold).replace("/", "-")
        return Run(out / FittedWorld.STAGE / f"{name}-{self.world}")

    def perform(self, out: Path) -> None:
        """Train if the method learns, and save its rollouts; interrupted attempts cost, too."""
        began, interrupted = time.process_time(), self.folder(out) / INTERRUPTED
        before = json.loads(interrupted.read_text()) if interrupted.exists() else 0.0
        try:
            rollouts, parameters = self._roll_out(out)
            rollouts.save(self.folder(out) / "rollouts.npz")
        except BaseException:
            write_json(interrupted, before + time.process_time() - began)
            raise
        seconds = before + time.process_time() - began
        spent = {"processor_seconds": seconds, "parameters": parameters}
        write_json(self.folder(out) / COST, spent)
        interrupted.unlink(missing_ok=True)

    def _roll_out(self, out: Path) -> tuple[Rollouts, int | None]:
        """Return rollouts, and the number of parameters of what acted."""
        world = self.world_run(out)
        shared: dict[str, Any] = {
            "method": self.method,
            "seed": self.seed,
            "repetitions": self.repetitions,
        }
        policy: Any
        if self.settings is not None:
            run = pipeline.open_run(self.settings, self.folder(out) / "run", COMMAND, world.demos)
            shutil.copyfile(world.path / FittedWorld.RESULT, run.path / FittedWorld.RESULT)
            policy = pipeline.learn(run, self.settings.algo, progress_bar=False)
            policy.policy.seed(self.seed)
            has_flag, scenario = policy.layout.condition_flag, run.scenario
            parameters = policy.policy.q_net.num_parameters
        elif self.factory is not None:
            setting = methods.MethodSetting.of(world, self.seed)
            factory = methods.load_factory(self.factory)
            with methods.errors_as_input_errors(f"method {self.method}: its factory raised"):
                made = factory(setting)
            policy = methods.CheckedPolicy(self.method, made, setting.species.num_actions)
            has_flag, scenario = bool(setting.environment().condition_flag), world.scenario
            parameters = methods.parameters_of(made)
        else:
            return methods.reference_rollouts(world, **shared, fold=self.fold is not None), None
        worlds = partial(make_world, scenario)
        cue: Cue | None = "actual" if has_flag else None
        return collect_rollouts(worlds, policy, **shared, cue=cue), parameters

    def rollouts(self, out: Path) -> Rollouts:
        """Return the rollouts of a finished cell."""
        return Rollouts.load(self.folder(out) / "rollouts.npz")

    def cost(self, out: Path) -> dict[str, Any]:
        """Return processor time and parameters; empty if it is not finished."""
        file = self.folder(out) / COST
        return json.loads(file.read_text()) if file.exists() else {}


@dataclass(frozen=True, kw_only=True)
class Scoring(Piece):
    """A method over all its seeds, measured against the recordings of the test split."""

    STAGE, RESULT = "scores", "score.json"
    cells: tuple[Cell, ...]
    resamples: int
    measures: tuple[str, ...] = ()

    @property
    def data(self) -> str:
        """Name of the demonstrations."""
        return self.cells[0].data

    @property
    def name(self) -> str:
        """Name in errors and tables."""
        return f"{self.data}/{self.cells[0].method}/score"

    @cached_property
    def key(self) -> str:
        """A hash of the cells, and of the files of measures."""
        own = {name: measure_source(name) for name in self.measures}
        measured = {"cells": [cell.key for cell in self.cells], "resamples": self.resamples}
        return _hash_of(measured | ({"measures": own} if own else {}))

    def ready(self, out: Path) -> bool:
        """Return whether all cells are finished."""
        return all(cell.finished(out) for cell in self.cells)

    def perform(self, out: Path) -> None:
        """Measure the rollouts of all cells together."""
        register_measures(self.measures)
        first = self.cells[0]
        made = [(cell.world_run(out).demos, cell.rollouts(out)) for cell in self.cells]
        joined = Rollouts.concatenate([rollouts for _, rollouts in made], first.method)
        result = (
            score(joined, made[0][0], resamples=self.resamples)
            if first.fold is None
            else crossed_score(made, first.method, resamples=self.resamples)
        )
        labels = {"data": self.data, "kind": first.kind}
        write_json(self.folder(out) / self.RESULT, result.to_json() | labels)

    def result(self, out: Path) -> Score:
        """Return the score of a finished method."""
        return Score.from_json(json.loads((self.folder(out) / self.RESULT).read_text()))


def _resolve(settings: RunSettings) -> dict[str, Any]:
    """Return a run's settings with everything that presets set, without where its file lies."""
    learner = settings.learner()
    own = {k: v for k, v in asdict(settings).items() if k not in ("file", "source", "config")}
    return {"settings": own, "learner": asdict(learner.settings), "environment": learner.env_kwargs}


def _hash_of(determining: Mapping[str, Any]) -> str:
    """Return 16 hexadecimal digits, of versions and kernels too."""
    code = {"versions": versions(), "kernels": source_key("animarl_algos")}
    text = json.dumps({**determining, **code}, sort_keys=True, default=str)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def _world_name(data: str, fold: int | None) -> str:
    return f"{data}/world" if fold is None else f"{data}/world/fold{fold}"


def attempt(piece: Piece, out: Path) -> str | None:
    """Do a piece of work in one thread, and return its error, empty if it succeeded.

    The error is recorded in the piece's folder, so that the rest goes on; warnings are kept there
    too. Return None if another command is working on the piece.
    """
    folder = piece.folder(out)
    torch.set_num_threads(1)
    folder.mkdir(parents=True, exist_ok=True)
    try:
        with FileLock(folder / LOCK, timeout=0):
            if piece.finished(out):  # by another command, before this one looked
                return ""
            (folder / ERROR).unlink(missing_ok=True)
            try:
                with threadpool_limits(1), warnings.catch_warnings(record=True) as warned:
                    piece.perform(out)
            except Exception as error:  # a failing cell is a row of the results, whatever failed
                kind = "" if isinstance(error, InputError) else f"{type(error).__name__}: "
                text = methods.one_line(f"{kind}{error}")
                where = traceback.format_exc()
                write_json(folder / ERROR, {"error": text, "traceback": where})
                return text
            if warned:
                write_json(folder / "warnings.json", [str(one.message) for one in warned])
            return ""
    except Timeout:
        return None


def perform_all(
    stages: Iterable[Iterable[Piece]], out: Path, processes: int = 1, backend: str = BACKENDS[0]
) -> Iterator[tuple[Piece, str]]:
    """Do all pieces that are not finished, and yield each with its error when it has ended.

    A stage begins when the one before has ended. Pieces that lack the result of an earlier one are
    left out. Errors are recorded, and the rest goes on. A Ray cluster hands over all pieces of a
    stage when the last has ended.

    Raises
    ------
    InputError
        If a process dies, such as for lack of memory. Whatever is finished is kept.
    """
    returned = "generator_unordered"
    if backend == "ray":
        from ray.util.joblib import register_ray

        register_ray()  # type: ignore[no-untyped-call]
        returned = "list"  # of joblib's ways the only one that Ray's backend has
    for stage in stages:
        left = [piece for piece in stage if not piece.finished(out) and piece.ready(out)]
        while left:
            busy = []
            try:
                with parallel_config(backend=backend):
                    ended = Parallel(processes, return_as=returned, batch_size=1)(
                        delayed(_attempt_numbered)(number, piece, out)
                        for number, piece in enumerate(left)
                    )
                for number, error in ended:
                    if error is None:
                        busy.append(left[number])
                    else:
                        yield left[number], error
            except BrokenProcessPool as error:
                raise InputError(
                    f"{out}: a process died, probably for lack of memory: give fewer --processes; "
                    "the same command goes on from what is finished"
                ) from error
            left = busy
            if left:
                time.sleep(LOOK_AGAIN)


def _attempt_numbered(number: int, piece: Piece, out: Path) -> tuple[int, str | None]:
    return number, attempt(piece, out)
