"""Cells of recorded velocities, as the chase world moves by them: see :mod:`animarl_envs.cells`."""

from typing import NamedTuple

import numpy as np

from animarl_envs.array_types import Floats
from animarl_envs.cells import COURSE_TIME, CellLocomotion
from animarl_envs.compiling import inline_kernel, inline_wrapper
from animarl_envs.focus import averaged, direction_of, share_of
from animarl_envs.species import ChaseSpecies
from animarl_envs.worlds.streams import next_below


class CellState(NamedTuple):
    """Cells of the individuals, and where each has been going."""

    steps: Floats  # (K, cells, samples, 2), velocities ahead and left in multiples of the thrust
    course: Floats  # (K, 2, B), mean velocity up to the present
    share: float  # of a step in a course


def cells_of(species: ChaseSpecies, num_copies: int) -> CellState | None:
    """Return the cells of the individuals; None if their actions are pushes."""
    cells = [own.drawn_steps for own in species.locomotion if isinstance(own, CellLocomotion)]
    if not cells:
        return None
    course = np.zeros((species.num_individuals, 2, num_copies))
    return CellState(np.stack(cells), course, share_of(COURSE_TIME, species.dt))


@inline_kernel
def draw_step(i, actions, random, cells, thrust, dt, position, velocity, before):  # type: ignore[no-untyped-def]
    """Move individual ``i`` by a velocity drawn from its cell; ``before`` gets the old one."""
    for b in range(position.shape[2]):
        drawn = next_below(random, b, cells.steps.shape[2])
        ahead = thrust * cells.steps[i, actions[i, b], drawn, 0]
        left = thrust * cells.steps[i, actions[i, b], drawn, 1]
        x, y = direction_of(cells.course[i, 0, b], cells.course[i, 1, b])
        before[i, 0, b] = velocity[i, 0, b]
        before[i, 1, b] = velocity[i, 1, b]
        velocity[i, 0, b] = ahead * x - left * y
        velocity[i, 1, b] = ahead * y + left * x
        position[i, 0, b] += velocity[i, 0, b] * dt
        position[i, 1, b] += velocity[i, 1, b] * dt


@inline_wrapper
def follow_course(cells, velocity, step_count):  # type: ignore[no-untyped-def]
    """Add the last velocities to the courses, where there are cells."""
    if cells is not None:
        _average_course(cells, velocity, step_count)


@inline_kernel
def _average_course(cells, velocity, step_count):  # type: ignore[no-untyped-def]
    K, _, B = velocity.shape
    for i in range(K):
        for x in range(2):
            for b in range(B):
                cells.course[i, x, b] = averaged(
                    cells.course[i, x, b], velocity[i, x, b], cells.share, step_count[b]
                )
