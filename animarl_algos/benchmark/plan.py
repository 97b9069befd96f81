"""Everything that a matrix asks for, as pieces of work; refused as a whole before anything runs."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from functools import cached_property
from itertools import chain
from pathlib import Path
from typing import Any

from animarl_algos.benchmark.matrix import Matrix
from animarl_algos.benchmark.pieces import Cell, Clone, Piece, Scoring, World, write_json
from animarl_algos.evaluation.teams import teams_of
from animarl_algos.recipes.registry import RECIPES
from animarl_algos.runs.pipeline import rehearse
from animarl_algos.runs.run_files import versions
from animarl_envs.errors import InputError
from animarl_envs.files import is_part

FORMAT_VERSION = 1
MARK = "benchmark.json"
"""Marks a folder of results."""


@dataclass(frozen=True, eq=False)
class Plan:
    """Worlds first, then clones, cells, scores; within these any order gives the same."""

    matrix: Matrix
    worlds: tuple[World, ...]
    cells: tuple[Cell, ...]
    scorings: tuple[Scoring, ...]

    @property
    def stages(self) -> tuple[tuple[Piece, ...], ...]:
        return self.worlds, self.clones, self.cells, self.scorings

    @property
    def pieces(self) -> Iterator[Piece]:
        return chain.from_iterable(self.stages)

    @cached_property
    def clones(self) -> tuple[Clone, ...]:
        """One for every two cells or more that begin with the same offline phase."""
        alike: dict[str, list[Cell]] = {}
        for cell in self.cells:
            if cell.clone is not None:
                alike.setdefault(cell.clone.key, []).append(cell)
        return tuple(
            replace(clone, cells=tuple(some))
            for some in alike.values()
            if len(some) > 1 and (clone := some[0].clone)
        )

    def only(self, patterns: Sequence[str]) -> Plan:
        """Return the rows that match a pattern, ``species/method`` or ``species/method/seed``.

        Raises
        ------
        InputError
            If a pattern matches nothing.
        """
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
            tuple(one for one in self.scorings if chosen.issuperset(one.needs)),
        )

    def resolved(self) -> dict[str, Any]:
        """Return the matrix, and the key of every cell."""
        return {
            "settings": self.matrix.model_dump(),
            "demonstrations": {one.name: one.demos.fingerprint() for one in self.worlds},
            "cells": {cell.name: cell.key for cell in self.cells},
        }


def plan(matrix: Matrix, methods: Mapping[str, str] | None = None, place: str = "") -> Plan:
    """Return what there is to do.

    Parameters
    ----------
    methods
        Others' methods: ``module:factory`` by name.
    place
        The file that the matrix stands in, for messages.

    Raises
    ------
    InputError
        If a recipe cannot learn from a set of demonstrations, a method has the name of a row, or
        there is nothing to do.
    """
    methods = methods or {}
    for name in methods:
        if name in (*RECIPES, *matrix.references):
            raise InputError(f"--method {name}: there is a row of that name: choose another")
    worlds: list[World] = []
    cells: list[Cell] = []
    with _naming(place):
        for data, folds in matrix.recorded().items():
            for number, demos in enumerate(folds):
                fold = number if len(folds) > 1 else None
                world = World(data, matrix.world_settings(data, demos), demos, fold)
                worlds.append(world)
                cells += _cells_in(world, matrix, methods)
        if not cells:
            raise InputError("there is nothing to do: name recipes or references")
    rows: dict[tuple[str, str], list[Cell]] = {}
    for cell in cells:
        rows.setdefault((cell.data, cell.method), []).append(cell)
    scorings = [Scoring(cells=tuple(row), resamples=matrix.resamples) for row in rows.values()]
    return Plan(matrix, tuple(worlds), tuple(cells), tuple(scorings))


def _cells_in(world: World, matrix: Matrix, methods: Mapping[str, str]) -> Iterator[Cell]:
    demos = world.demos
    shared: dict[str, Any] = {
        "data": world.data, "repetitions": matrix.repetitions, "world": world.key,
        "fold": world.fold,
    }  # fmt: skip
    for algo in matrix.recipes:
        settings = [matrix.run_settings(world.data, demos, algo, seed) for seed in matrix.seeds]
        rehearse(settings[0], demos)
        yield from (Cell(**shared, method=algo, seed=s.seed, settings=s) for s in settings)
    for name, factory in methods.items():
        yield from (Cell(**shared, method=name, seed=s, factory=factory) for s in matrix.seeds)
    for name in matrix.references:
        if name != "experts" or teams_of(demos) is not None:
            yield Cell(**shared, method=name, seed=matrix.seeds[0])


def claim_folder(out: Path) -> None:
    """Mark a folder as one of results of this version, or make sure that it is.

    Raises
    ------
    InputError
        As :func:`refuse_other_results` does.
    """
    refuse_other_results(out)
    if not (out / MARK).exists():
        write_json(out / MARK, _own_mark())


def refuse_other_results(out: Path) -> None:
    """Make sure that results may lie in a folder; nothing is written.

    Raises
    ------
    InputError
        If it holds the results of another version, or something else.
    """
    file, own = out / MARK, _own_mark()
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


def _own_mark() -> dict[str, Any]:
    return {"format": FORMAT_VERSION, "animarl": versions()["animarl"]}


@contextmanager
def _naming(place: str) -> Iterator[None]:
    """What is refused meanwhile names the file that it stands in."""
    try:
        yield
    except InputError as error:
        raise InputError(f"{place}: {error}" if place else str(error)) from error


def _matches(cell: Cell, pattern: str) -> bool:
    row = f"{cell.data}/{cell.method}"
    return any(fnmatchcase(name, pattern) for name in (cell.name, f"{row}/{cell.seed}", row))
