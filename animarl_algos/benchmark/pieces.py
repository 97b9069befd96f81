"""The pieces of work of a benchmark, each keyed by a hash of everything that determines it.

A piece has a folder of its own, named by its key: what is there is never made again, and a changed
setting, recording, version or kernel makes another key and so another folder. The order is worlds
(the fitted locomotion of a species), clones (an offline phase that several cells begin with), cells
(a method with a seed: trained, rolled out), scores (a method over its seeds, measured).
"""

from __future__ import annotations

import hashlib
import json
import multiprocessing
import os
import shutil
import signal
import sys
import threading
import time
import traceback
import warnings
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import Any, ClassVar, Self

import torch
from filelock import FileLock, Timeout
from threadpoolctl import threadpool_limits

from animarl_algos.benchmark import methods
from animarl_algos.benchmark.scores import Score, crossed_score, score
from animarl_algos.evaluation.collect import Cue, collect_rollouts
from animarl_algos.evaluation.rollouts import Rollouts
from animarl_algos.learner.presets import constructed
from animarl_algos.recipes.registry import SoftBC, named_recipe
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
DETERMINING = (
    "policy", "policy_kwargs", "offline_epochs", "offline_patience", "offline_learning_rate",
    "offline_batch_size", "offline_max_grad_norm", "offline_kwargs",
)  # fmt: skip
"""Settings of a learner that cloning hangs on; weights of other loss terms are none of them."""
ONLINE_ONLY = ("dtw",)
"""Options of its environment that nothing offline reads."""


class Piece(ABC):
    """A piece of work; it may be sent to another process."""

    STAGE: ClassVar[str]
    RESULT: ClassVar[str] = COST

    @property
    @abstractmethod
    def name(self) -> str:
        """What the progress and errors call it."""

    @property
    @abstractmethod
    def key(self) -> str:
        """A hash of everything that determines its result."""

    @property
    def needs(self) -> tuple[str, ...]:
        """Names of the pieces that come first."""
        return ()

    def folder(self, out: Path) -> Path:
        """Return where everything of it lies."""
        return out / self.STAGE / f"{self.name.replace('/', '-')}-{self.key}"

    def finished(self, out: Path) -> bool:
        """Whether its result is there."""
        return (self.folder(out) / self.RESULT).exists()

    @abstractmethod
    def perform(self, out: Path) -> None:
        """Make the result, going on from what an earlier attempt left."""

    def error(self, out: Path) -> str:
        """Return what the last attempt failed with; empty if it did not."""
        file = self.folder(out) / ERROR
        return str(json.loads(file.read_text())["error"]) if file.exists() else ""

    def record_error(self, out: Path, said: str, where: str = "") -> None:
        write_json(self.folder(out) / ERROR, {"error": said, "traceback": where})

    def cost(self, out: Path) -> dict[str, Any]:
        """Return what it cost: processor time, parameters, its clone; empty if not finished."""
        file = self.folder(out) / COST
        return json.loads(file.read_text()) if file.exists() else {}

    def _write_cost(
        self, out: Path, began: float, parameters: int | None, clone: str | None = None
    ) -> None:
        spent = {"clone": clone, "processor_seconds": time.process_time() - began}
        write_json(self.folder(out) / COST, spent | {"parameters": parameters})


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
        return _world_name(self.data, self.fold)

    @cached_property
    def key(self) -> str:
        return _hashed(_resolved(self.settings) | {"demonstrations": self.demos.fingerprint()})

    def perform(self, out: Path) -> None:
        pipeline.fit(pipeline.open_run(self.settings, self.folder(out), COMMAND, self.demos))


@dataclass(frozen=True, kw_only=True)
class InWorld(Piece):
    """What is done in a world that is fitted, whose key ``world`` is."""

    data: str
    seed: int
    world: str
    fold: int | None = None

    def world_run(self, out: Path) -> Run:
        """Return the fitted world; raise InputError if it is not there."""
        name = _world_name(self.data, self.fold).replace("/", "-")
        run = Run(out / "worlds" / f"{name}-{self.world}")
        if not (run.path / FittedWorld.RESULT).exists():
            raise InputError(f"the world of {self.data} could not be fitted")
        return run

    @property
    def needs(self) -> tuple[str, ...]:
        return (_world_name(self.data, self.fold),)

    def _opened(self, settings: RunSettings, out: Path) -> Run:
        world = self.world_run(out)
        run = pipeline.open_run(settings, self.folder(out) / "run", COMMAND, world.demos)
        shutil.copyfile(world.path / FittedWorld.RESULT, run.path / FittedWorld.RESULT)
        return run


@dataclass(frozen=True, kw_only=True)
class Clone(InWorld):
    """The offline phase that several cells begin with, done once.

    Recipes that clone soft labels differ in what follows: where the settings that cloning hangs on
    are the same, so are networks, labels and draws, and the phase gives the same weights to the
    bit. A cell that finds its clone unfinished trains by itself, to the same bytes.
    """

    STAGE = "clones"
    method = kind = "clone"
    settings: RunSettings
    cells: tuple[Cell, ...] = ()

    @property
    def name(self) -> str:
        return f"{self.data}/clone/{self.seed}-{self.key}"

    @cached_property
    def key(self) -> str:
        return _hashed(_resolved(self.settings) | {"world": self.world})

    def finished(self, out: Path) -> bool:
        """Also where no cell is left that would begin with it."""
        return super().finished(out) or all(cell.finished(out) for cell in self.cells)

    def perform(self, out: Path) -> None:
        began, run = time.process_time(), self._opened(self.settings, out)
        model = pipeline.learn(run, self.settings.algo, progress_bar=False)
        self._write_cost(out, began, model.policy.q_net.num_parameters)


@dataclass(frozen=True, kw_only=True)
class Cell(InWorld):
    """A method with a seed: trained if it learns, and rolled out from the test starts.

    ``settings`` are those of a recipe; without them it is a reference, or, with a ``factory``
    (``module:factory``), somebody's own method.
    """

    STAGE = "cells"
    method: str
    repetitions: int
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
            "world": self.world, "factory": self.factory and methods.source_of(self.factory),
        }  # fmt: skip
        return _hashed(own | (_resolved(self.settings) if self.settings else {}))

    @cached_property
    def clone(self) -> Clone | None:
        """What its training begins with, if that is soft-label cloning; others may share it."""
        own = None if self.settings is None else cloning(self.settings)
        if own is None:
            return None
        return Clone(data=self.data, seed=self.seed, world=self.world, fold=self.fold, settings=own)

    @property
    def needs(self) -> tuple[str, ...]:
        return (*super().needs, *([self.clone.name] if self.clone else []))

    def perform(self, out: Path) -> None:
        began = time.process_time()
        begun = self.clone if self.clone is not None and self.clone.cost(out) else None
        rollouts, parameters = self._rolled_out(out, begun)
        rollouts.save(self.folder(out) / "rollouts.npz")
        self._write_cost(out, began, parameters, begun.name if begun else None)

    def _rolled_out(self, out: Path, begun: Clone | None) -> tuple[Rollouts, int | None]:
        world, parameters = self.world_run(out), None
        policy: Any
        shared: dict[str, Any] = {
            "method": self.method, "seed": self.seed, "repetitions": self.repetitions
        }  # fmt: skip
        if self.settings is not None:
            run = self._opened(self.settings, out)
            clone = None if begun is None else Run(begun.folder(out) / "run")
            policy = pipeline.learn(run, self.settings.algo, clone=clone, progress_bar=False)
            policy.policy.seed(self.seed)
            told, scenario = policy.layout.condition_flag, run.scenario
            parameters = policy.policy.q_net.num_parameters
        elif self.factory is not None:
            setting, factory = (
                methods.MethodSetting.of(world, self.seed),
                methods.load_factory(self.factory),
            )
            with methods.foreign(f"method {self.method}: its factory raised", "fix it"):
                made = factory(setting)
            policy = methods.CheckedPolicy(self.method, made, setting.species.num_actions)
            told, scenario = bool(setting.environment().condition_flag), world.scenario
            parameters = methods.parameters_of(made)
        else:
            return methods.reference_rollouts(world, **shared, fold=self.fold is not None), None
        worlds = partial(make_world, scenario)
        cue: Cue | None = "actual" if told else None
        return collect_rollouts(worlds, policy, **shared, cue=cue), parameters

    def rollouts(self, out: Path) -> Rollouts:
        return Rollouts.load(self.folder(out) / "rollouts.npz")


@dataclass(frozen=True, kw_only=True)
class Scoring(Piece):
    """A method over all its seeds, measured against the recordings of the test split."""

    STAGE, RESULT = "scores", "score.json"
    cells: tuple[Cell, ...]
    resamples: int

    @property
    def data(self) -> str:
        return self.cells[0].data

    @property
    def name(self) -> str:
        return f"{self.data}/{self.cells[0].method}/score"

    @cached_property
    def key(self) -> str:
        return _hashed({"cells": [cell.key for cell in self.cells], "resamples": self.resamples})

    @property
    def needs(self) -> tuple[str, ...]:
        return tuple(cell.name for cell in self.cells)

    def perform(self, out: Path) -> None:
        if lacking := [cell.name for cell in self.cells if not cell.finished(out)]:
            raise InputError(f"{', '.join(lacking)} did not finish")
        first = self.cells[0]
        made = [(cell.world_run(out).demos, cell.rollouts(out)) for cell in self.cells]
        joined = Rollouts.concatenate([rollouts for _, rollouts in made], first.method)
        found = (
            score(joined, made[0][0], resamples=self.resamples)
            if first.fold is None
            else crossed_score(made, first.method, resamples=self.resamples)
        )
        labels = {"data": self.data, "kind": first.kind}
        write_json(self.folder(out) / self.RESULT, found.to_json() | labels)

    def result(self, out: Path) -> Score:
        return Score.from_json(json.loads((self.folder(out) / self.RESULT).read_text()))


def cloning(settings: RunSettings) -> RunSettings | None:
    """Return the run of soft-label cloning alone that a training begins with.

    Two trainings begin alike if these are equal and the world is; None: it begins otherwise.
    """
    algorithm = named_recipe(settings.algo).algorithm
    own, determining = algorithm.recipe, _determining(settings)
    if settings.learner().arguments.get("offline_loss") == "cloning":
        own = own.cloning()
    alike = own.offline == SoftBC.recipe.offline and own.selection is SoftBC.recipe.selection
    if not (alike and determining["offline_epochs"]):
        return None
    alone = settings.changed(
        algo="qr-soft-bc" if algorithm.quantiles else "soft-bc", preset="default",
        config=None, overrides=determining, steps=1, copies=1, repetitions=1, acting="greedy",
    )  # fmt: skip
    return alone if _determining(alone) == determining else None


def _determining(settings: RunSettings) -> dict[str, Any]:
    asked = settings.learner()
    whole = constructed(asked.arguments)
    seen = {key: value for key, value in asked.env_kwargs.items() if key not in ONLINE_ONLY}
    return {key: whole[key] for key in DETERMINING} | {"env_kwargs": seen}


def _resolved(settings: RunSettings) -> dict[str, Any]:
    """A run's settings with everything that they leave to presets; where the file lies is not."""
    learner = settings.learner()
    own = {k: v for k, v in settings.model_dump().items() if k not in ("file", "source", "config")}
    return {"settings": own, "learner": learner.arguments, "environment": learner.env_kwargs}


def _hashed(determining: Mapping[str, Any]) -> str:
    """A key of 16 hexadecimal digits, of the versions and the kernels' sources too."""
    code = {"versions": versions(), "kernels": source_key("animarl_algos")}
    text = json.dumps({**determining, **code}, sort_keys=True, default=str)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def _world_name(data: str, fold: int | None) -> str:
    return f"{data}/world" if fold is None else f"{data}/world/fold{fold}"


def attempt(piece: Piece, out: Path) -> str | None:
    """Do a piece of work in one thread, and return its error, empty if it succeeded.

    The error is recorded in its folder, and the rest goes on.
    Warnings are kept there too: dozens of them would hide the table of what runs.
    Several commands may be at work in the same results: each piece is done by one of them, and the
    others get None. Ctrl-C and a signal to end go through.
    """
    folder = piece.folder(out)
    torch.set_num_threads(1)
    folder.mkdir(parents=True, exist_ok=True)
    try:
        with FileLock(folder / LOCK, timeout=0):
            if piece.finished(out):  # by another command, before this one looked
                return ""
            said = ""
            (folder / ERROR).unlink(missing_ok=True)
            try:
                with threadpool_limits(1), warnings.catch_warnings(record=True) as warned:
                    piece.perform(out)
            except Exception as error:  # a failing cell is one line of the results, whatever failed
                kind = "" if isinstance(error, InputError) else f"{type(error).__name__}: "
                said = methods.one_line(f"{kind}{error}")
                piece.record_error(out, said, traceback.format_exc())
            else:
                if warned:
                    write_json(folder / "warnings.json", [str(one.message) for one in warned])
            return said
    except Timeout:
        return None


PATIENCE = 5.0  # [s] until a worker is told to end again
ATTEMPTS = 2  # of a piece whose process died
LOOK_AGAIN = 1.0  # [s] until a piece that another command is at is asked for again


class _Workers:
    """This process, or several that last over all pieces; new ones only after one of them died."""

    def __init__(self, processes: int) -> None:
        self.number = processes  # side by side
        self._pool: ProcessPoolExecutor | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if self._pool is None:
            return
        self._pool.shutdown(wait=kind is None, cancel_futures=True)
        if kind is not None:  # Ctrl-C and signals: the workers end as this process does
            for child in multiprocessing.active_children():
                child.terminate()

    def submit(self, piece: Piece, out: Path) -> Future[str | None]:
        """Promise the result of an attempt."""
        if self.number == 1:
            kept: Future[str | None] = Future()
            kept.set_result(attempt(piece, out))
            return kept
        try:
            return self._started().submit(_attempt_or_end, piece, out)
        except BrokenProcessPool:
            self._started().shutdown()
            self._pool = None
            return self._started().submit(_attempt_or_end, piece, out)

    def _started(self) -> ProcessPoolExecutor:
        if self._pool is None:
            spawning = multiprocessing.get_context("spawn")
            self._pool = ProcessPoolExecutor(self.number, spawning, initializer=_end_politely)
        return self._pool


def perform_all(
    pieces: Iterable[Piece], out: Path, processes: int = 1
) -> Iterator[tuple[Piece, str | None]]:
    """Do whatever is not finished; errors are recorded, and the rest goes on.

    A piece is yielded as it begins, with None, and as it ends, with its error or an empty one. It
    begins after what it needs has ended, well or badly: it looks what is there. One that another
    command is at begins again after ``LOOK_AGAIN`` seconds.
    """
    later = [piece for piece in pieces if not piece.finished(out)]
    left = {piece.name for piece in later}
    deaths: Counter[str] = Counter()
    not_before: dict[str, float] = {}
    running: dict[Future[str | None], Piece] = {}
    with _Workers(processes) as workers:
        while later or running:
            now = time.monotonic()
            ready = [
                piece
                for piece in later
                if left.isdisjoint(piece.needs) and not_before.get(piece.name, now) <= now
            ]
            for piece in ready[: processes - len(running)]:
                later = [other for other in later if other is not piece]
                yield piece, None
                running[workers.submit(piece, out)] = piece
            if not running:
                time.sleep(LOOK_AGAIN)
            for future in wait(running, LOOK_AGAIN, FIRST_COMPLETED).done:
                piece = running.pop(future)
                try:
                    error = future.result()
                except BrokenProcessPool:
                    deaths[piece.name] += 1
                    if deaths[piece.name] < ATTEMPTS:
                        later.append(piece)
                        continue
                    error = f"its process died {ATTEMPTS} times (see to the memory)"
                if error is None:
                    not_before[piece.name] = time.monotonic() + LOOK_AGAIN
                    later.append(piece)
                    continue
                if error != piece.error(out):  # of a process that could not write it
                    piece.record_error(out, error)
                left.remove(piece.name)
                yield piece, error


def _attempt_or_end(piece: Piece, out: Path) -> str | None:
    """A worker that is told to end within a piece ends: the pool would give it the next one."""
    try:
        return attempt(piece, out)
    except (SystemExit, KeyboardInterrupt):
        os._exit(methods.TERMINATED)


def _end_politely() -> None:
    """A worker that is told to end leaves no half-written file behind, and none outlives us."""
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(methods.TERMINATED))
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    """Told to end within a callback that swallows it, a worker goes on: so it is told again."""
    parent = multiprocessing.parent_process()
    assert parent is not None
    parent.join()
    while True:
        os.kill(os.getpid(), signal.SIGTERM)
        time.sleep(PATIENCE)
