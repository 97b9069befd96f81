"""Cells of recorded velocities (:mod:`animarl_envs.cells`): k-means in the frame of the course.

Left and right have the same cells, mirrored, so that a mirrored recording has mirrored actions.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from animarl_envs.array_types import Floats
from animarl_envs.cells import (
    COURSE_TIME,
    CellLocomotion,
    check_number_of_cells,
    nearest_cells,
    unwarped,
    warped,
)
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.errors import InputError
from animarl_envs.fitting.custom_species import fitted_once
from animarl_envs.fitting.transitions import action_frames, whole_steps
from animarl_envs.locomotion import Locomotion
from animarl_envs.species import ChaseSpecies, Species

SAMPLES = 64  # recorded velocities that are kept of each cell
MOST_STEPS = 30_000  # that the centres are found by
ITERATIONS = 15
DIGITS = 6  # of what is kept


@dataclass(frozen=True)
class RecordedCells:
    """Cells of one individual, or of all animals of a group, as a file holds them.

    ``centres`` ``(cells, 2)`` and ``steps`` ``(cells, samples, 2)`` are velocities ahead and left
    [arena unit / s], and so is the ``usual`` speed.
    """

    centres: list[Any]
    steps: list[Any]
    usual: float


def cells_of_recordings(demos: Demonstrations, number: int) -> tuple[RecordedCells, ...]:
    """Return so many cells of each individual by the training episodes; of a group, those of all.

    Raises InputError if the number is not allowed, or an individual moves too seldom to fill half
    as many cells.
    """
    check_number_of_cells(number)
    cells: tuple[RecordedCells, ...] = fitted_once(fit_each, demos, number)
    return cells


def with_cells(
    locomotion: Sequence[Locomotion], cells: Sequence[RecordedCells]
) -> tuple[CellLocomotion, ...]:
    """Return the locomotion of individuals with cells for actions, which are one for all or each's.

    ``locomotion`` are the pushes of each.
    """
    many = len(locomotion) if len(cells) == 1 else 1
    return tuple(
        CellLocomotion(
            own.damping,
            own.thrust,
            own.magnitudes,
            np.asarray(each.centres) / own.thrust,
            np.asarray(each.steps) / own.thrust,
            each.usual / own.thrust,
        )
        for own, each in zip(locomotion, many * tuple(cells), strict=True)
    )


def fit_each(training: Demonstrations, number: int) -> tuple[RecordedCells, ...]:
    """Return the cells of each individual; all animals of a group have those of them together."""
    velocity, steps = training.velocities(), whole_steps(training)
    frames = action_frames(training, COURSE_TIME)
    after, course = velocity[steps + 1], frames[steps]
    if training.is_group:
        after, course = after.reshape(-1, 1, 2), course.reshape(-1, 1, 2)
    ahead = np.sum(after * course, axis=-1)
    left = after[..., 1] * course[..., 0] - after[..., 0] * course[..., 1]
    seen = np.stack([ahead, left], axis=-1)
    return tuple(
        fit_cells(seen[:, i], number, training.individuals[i]) for i in range(seen.shape[1])
    )


def fit_cells(velocity: Floats, number: int, name: str) -> RecordedCells:
    """Return cells of the velocities ``(steps, 2)`` of ``name``, ahead and left."""
    rng = np.random.default_rng(0)
    folded = velocity * np.where(velocity[:, 1:] < 0.0, [[1.0, -1.0]], 1.0)  # all to the left
    speed = np.linalg.norm(folded, axis=1)
    half = number // 2
    if len(np.unique(folded[speed > 0.0], axis=0)) < half:
        raise InputError(
            f"{name} has fewer than {half} different recorded steps: too few for {number} cells; "
            "give fewer, or record more"
        )
    usual = float(np.median(speed[speed > 0.0]))
    some = folded[rng.permutation(len(folded))[:MOST_STEPS]]
    points = warped(some, usual)
    places = points[rng.choice(len(points), half, replace=False)]
    for _ in range(ITERATIONS):
        cell = nearest_cells(some, unwarped(places, usual), usual)
        count = np.bincount(cell, minlength=half)
        for axis in range(2):
            total = np.bincount(cell, points[:, axis], minlength=half)
            places[:, axis] = np.where(count > 0, total / np.maximum(count, 1), places[:, axis])
        empty = np.flatnonzero(count == 0)
        places[empty] = points[rng.choice(len(points), len(empty), replace=False)]
    centres = unwarped(places, usual)
    cell = nearest_cells(folded, centres, usual)
    steps = np.repeat(centres[:, None], SAMPLES, axis=1)
    for j in range(half):
        inside = folded[cell == j]
        if len(inside):
            order = rng.permutation(len(inside))
            steps[j] = inside[np.resize(order, SAMPLES)]
    mirrored = np.array([1.0, -1.0])
    return RecordedCells(
        _rounded(np.concatenate([centres, centres * mirrored])),
        _rounded(np.concatenate([steps, steps * mirrored])),
        float(f"{usual:.{DIGITS}g}"),
    )


def species_with_cells(species: Species, demos: Demonstrations | None, number: int) -> Species:
    """Return the species with so many cells of the recordings for its actions.

    Raises InputError without recordings of these individuals, and for a searcher.
    """
    if not isinstance(species, ChaseSpecies):
        raise InputError(
            f"cells is {number!r}: {species.name} searches a source by pushes; drop it"
        )
    if demos is None or demos.num_individuals != species.num_individuals:
        raise InputError(
            f"cells is {number!r}: cells are made from recordings of the same individuals: give "
            "demos= of them"
        )
    cells = cells_of_recordings(demos, number)
    return replace(species, locomotion=with_cells(species.locomotion, cells))


def _rounded(values: Floats) -> list[Any]:
    """Return values as lists, with so many digits that files of them stay small."""
    short = [float(f"{value:.{DIGITS}g}") for value in values.ravel()]
    rounded: list[Any] = np.array(short).reshape(values.shape).tolist()
    return rounded
