"""Cells: the locomotion of living animals, whose next velocity is one that was recorded.

An action is a cell of the next velocity in the frame of the animal's course, which is its velocity
averaged over ``COURSE_TIME``. The world then draws one of the recorded velocities of that cell. So
speeds and turns lie on no lattice, and what an action leaves open varies as it did in recordings.

Cells are Voronoi cells of their centres after a warp that resolves slow and fast motion alike.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from animarl_envs.array_types import Floats
from animarl_envs.errors import InputError
from animarl_envs.locomotion import Locomotion
from animarl_envs.settings import Positive, is_whole

FEWEST_CELLS, MOST_CELLS = 8, 128
"""Of one individual; actions are stored as int8."""
COURSE_TIME = 0.5
"""Time over which the course is averaged, exponentially [s]."""
LINEAR_BELOW = 0.15
"""Speeds in usual ones, below about which cells are of equal size, not of equal proportion."""
AT_ONCE = 20_000  # velocities whose cells are looked up together


@dataclass(frozen=True)
class CellLocomotion(Locomotion):
    """Cells of the next velocity of one individual, in the frame of its course.

    Vectors are velocities (ahead, left) in multiples of the thrust u [s]: with u times 1.2 the
    animal moves 1.2 times as far in each step. Damping and magnitudes give the observations their
    scales, and move an individual that no policy drives.

    Parameters
    ----------
    centres
        ``(cells, 2)``.
    steps
        ``(cells, samples, 2)``, recorded velocities of each cell.
    usual
        Usual speed, with which the warp begins.

    Raises
    ------
    InputError
        If there are too few or too many cells, or centres and steps do not fit together.
    """

    centres: Any = ()
    steps: Any = ()
    usual: Positive = 1.0
    course_time = COURSE_TIME

    def __post_init__(self) -> None:
        super().__post_init__()
        centres, steps = (np.array(each, dtype=float) for each in (self.centres, self.steps))
        check_number_of_cells(len(centres))
        if centres.shape != (len(centres), 2) or steps.shape[::2] != centres.shape:
            raise InputError(
                f"cells have centres {centres.shape} and steps {steps.shape}: give (cells, 2) and "
                "(cells, samples, 2)"
            )
        if not (np.isfinite(centres).all() and np.isfinite(steps).all()):
            raise InputError("a centre or step of the cells is no finite number: fit them again")
        object.__setattr__(self, "centres", _as_tuples(centres.tolist()))
        object.__setattr__(self, "steps", _as_tuples(steps.tolist()))

    @property
    def num_actions(self) -> int:
        """Number of actions: one for each cell."""
        return len(self.centres)

    @cached_property
    def action_vectors(self) -> Floats:  # type: ignore[override]
        """Centres of the cells, ``(cells, 2)``; read-only."""
        centres = np.array(self.centres)
        centres.setflags(write=False)
        return centres

    @cached_property
    def drawn_steps(self) -> Floats:
        """Velocities that are drawn from, ``(cells, samples, 2)``."""
        return np.array(self.steps)

    @property
    def idle_action(self) -> int:
        """The cell nearest to no motion."""
        return int(np.argmin(np.linalg.norm(self.action_vectors, axis=1)))

    def top_speed(self, dt: float, steps: int, initial: float = 0.0) -> float:
        """Return a bound of the speed: that of the fastest recorded step, or ``initial``."""
        fastest = self.thrust * float(np.linalg.norm(self.drawn_steps, axis=2).max())
        return max(initial, fastest, super().top_speed(dt, steps, initial))

    def chosen_by_action(self, velocity: NDArray[Any], after: NDArray[Any], dt: float) -> Floats:
        """Return what the action of a step decides: the next velocity [arena unit / s]."""
        return after

    def nearest_actions(self, chosen: Floats) -> NDArray[np.int8]:
        """Return the cells of velocities ``(..., 2)`` in the frame of the course."""
        return nearest_cells(chosen / self.thrust, self.action_vectors, self.usual)

    def velocity_after(self, velocity: NDArray[Any], vectors: Floats, dt: float) -> Floats:
        """Return velocities after steps with ``vectors``, multiples of the thrust."""
        return self.thrust * vectors


def check_number_of_cells(number: Any) -> None:
    """Refuse a number of cells that is not allowed."""
    if not is_whole(number) or not FEWEST_CELLS <= number <= MOST_CELLS or number % 2:
        raise InputError(
            f"cells is {number!r}: give an even number of cells, {FEWEST_CELLS} to {MOST_CELLS}"
        )


def warped(vectors: Floats, usual: float) -> Floats:
    """Return velocities ``(..., 2)`` whose length is about its root, in ``usual`` ones."""
    relative = vectors / usual
    length = np.linalg.norm(relative, axis=-1, keepdims=True)
    return np.asarray(relative / np.sqrt(LINEAR_BELOW + length))


def unwarped(vectors: Floats, usual: float) -> Floats:
    """Return the velocities of which these are :func:`warped`."""
    square = np.sum(vectors**2, axis=-1, keepdims=True)
    length = 0.5 * (square + np.sqrt(square * (square + 4.0 * LINEAR_BELOW)))
    return np.asarray(usual * vectors * np.sqrt(LINEAR_BELOW + length))


def nearest_cells(vectors: Floats, centres: Floats, usual: float) -> NDArray[np.int8]:
    """Return the number of the nearest centre of each velocity ``(..., 2)``, warped."""
    points, places = warped(vectors, usual).reshape(-1, 2), warped(centres, usual)
    nearest = np.empty(len(points), dtype=np.int8)
    for begin in range(0, len(points), AT_ONCE):
        some = points[begin : begin + AT_ONCE]
        nearest[begin : begin + AT_ONCE] = np.argmin(
            (places**2).sum(axis=1) - 2.0 * some @ places.T, axis=1
        )
    return nearest.reshape(vectors.shape[:-1])


def _as_tuples(value: Any) -> Any:
    return tuple(map(_as_tuples, value)) if isinstance(value, list) else value
