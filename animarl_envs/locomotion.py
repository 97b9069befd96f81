"""Locomotion: v' = (1 - d) v + u a dt, its actions, and the way back from tracks to actions.

One definition serves the simulators, the fits, the inverse dynamics and the figures:
:func:`next_velocity`, which :mod:`animarl_envs.kinematics` compiles for kernels.

Frames. Positions and velocities are in the arena frame. Each individual has an *egocentric frame*
towards its focus: x axis along the unit vector ``focus`` (towards the focus), y axis to its left.

Actions. With M thrust magnitudes there are ``12 M + 1``. Action ``k < 12 M`` accelerates with
magnitude ``k // 12`` (a multiple of the thrust u, the largest first) in direction ``k % 12``, at
``-30 deg * (k % 12)`` in the egocentric frame: 0 straight at the focus, 3 to the right, 6 away, 9
to the left. Action ``12 M`` is no acceleration ("coasting"). The paper has M = 1: 13 actions.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from typing import Any, ClassVar, TypeVar

import numpy as np
from numpy.typing import NDArray

from animarl_envs.array_types import Floats
from animarl_envs.errors import InputError
from animarl_envs.settings import Positive, Probability, check_fields, is_number, is_whole

NUM_DIRECTIONS = 12
NUM_ACTIONS = NUM_DIRECTIONS + 1
"""Actions of one thrust magnitude, as in the paper; a species has ``num_actions``."""
COAST = NUM_DIRECTIONS
"""No acceleration, where there is one thrust magnitude; else it is the last action."""
MOST_THRUSTS = 10
"""Thrust magnitudes at most: actions are stored as int8."""
MULTIPLES: dict[int, tuple[float, ...]] = {
    1: (1.0,),
    2: (1.45, 0.65),
    3: (1.75, 1.0, 0.5),
    8: (2.3, 1.7, 1.3, 1.0, 0.75, 0.5, 0.3, 0.15),
}
"""Measured best of fixed multiples of u, by the number of magnitudes."""
ACTION_ANGLES: Floats = -np.deg2rad(30.0) * np.arange(NUM_DIRECTIONS)
"""Angle of the directions in the egocentric frame, counter-clockwise [rad]."""

# Exact halves and zeros, so that a mirrored or rotated action is the mirrored or rotated vector.
_C, _S = math.sqrt(3.0) / 2.0, 0.5
ACTION_VECTORS: Floats = np.array(
    [
        (1.0, 0.0), (_C, -_S), (_S, -_C), (0.0, -1.0), (-_S, -_C), (-_C, -_S),
        (-1.0, 0.0), (-_C, _S), (-_S, _C), (0.0, 1.0), (_S, _C), (_C, _S),
        (0.0, 0.0),
    ]
)  # fmt: skip
"""Accelerations of the 13 actions of one magnitude in the egocentric frame, ``(13, 2)``, unit
vectors or zero."""

Value = TypeVar("Value", float, NDArray[Any])


def next_velocity(
    velocity: Value, acceleration: Value, damping: float, thrust: float, dt: float
) -> Value:
    """Return ``v' = (1 - d) v + u a dt`` (paper, eq. 1); the position follows: p' = p + v' dt.

    Works on scalars and arrays. ``acceleration`` is a multiple of the thrust.
    """
    return (1.0 - damping) * velocity + thrust * acceleration * dt


def residual(after: Value, before: Value, damping: float) -> Value:
    """Return ``v' - (1 - d) v``, the velocity that the thrust added in a step, ``u a dt``.

    Works on scalars and arrays. Adding the 0 of no thrust keeps the sign of zeros as in
    :func:`next_velocity`.
    """
    return after - ((1.0 - damping) * before + 0.0)


@dataclass(frozen=True)
class Locomotion:
    """Locomotion parameters of one individual, whose actions are pushes.

    :class:`animarl_envs.cells.CellLocomotion` is the other way to move.

    Parameters
    ----------
    damping
        ``d``, the share of the velocity lost in one step [1], in [0, 1].
    thrust
        ``u``, the amplitude of the acceleration [arena unit / s^2], positive.
    magnitudes
        Multiples of ``u`` that the individual chooses among, positive, the largest first.
    """

    damping: Probability
    thrust: Positive
    magnitudes: tuple[float, ...] = (1.0,)
    course_time: ClassVar[float | None] = None
    """Actions are in the frame of the course over so many seconds; None: in that of the focus."""

    def __post_init__(self) -> None:
        check_fields(self)
        object.__setattr__(self, "magnitudes", _checked_magnitudes(self.magnitudes))

    @property
    def thrusts(self) -> int:
        """The number of thrust magnitudes, M."""
        return len(self.magnitudes)

    @property
    def num_actions(self) -> int:
        """Number of actions, 12 M + 1."""
        return NUM_DIRECTIONS * self.thrusts + 1

    @property
    def action_vectors(self) -> Floats:
        """``(12 M + 1, 2)``, egocentric frame, in multiples of the thrust; read-only."""
        return action_vectors(self.magnitudes)

    @property
    def idle_action(self) -> int:
        """The action that changes least: no acceleration."""
        return self.num_actions - 1

    @property
    def smallest_thrust(self) -> float:
        """Acceleration of the weakest push [arena unit / s^2]."""
        return self.thrust * self.magnitudes[-1]

    def terminal_speed(self, dt: float) -> float:
        """Return the speed reached under the largest thrust, ``u m dt / d`` [arena unit / s]."""
        largest = self.thrust * self.magnitudes[0]
        return math.inf if self.damping == 0 else largest * dt / self.damping

    def top_speed(self, dt: float, steps: int, initial: float = 0.0) -> float:
        """Return a bound of the speed within ``steps``, from a speed of at most ``initial``."""
        reached = max(initial, self.terminal_speed(dt))
        return min(reached, initial + steps * self.thrust * self.magnitudes[0] * dt)

    def chosen_by_action(self, velocity: NDArray[Any], after: NDArray[Any], dt: float) -> Floats:
        """Return what the action of a step decides: the acceleration [arena unit / s^2].

        Velocities before and after the step, and the result, are ``(..., 2)`` in one frame.
        """
        return residual(after, velocity, self.damping) / dt

    def nearest_actions(self, chosen: Floats) -> NDArray[np.int8]:
        """Return the actions nearest to accelerations ``(..., 2)`` in the frame of actions."""
        error = np.linalg.norm(chosen[..., None, :] - self.thrust * self.action_vectors, axis=-1)
        return np.asarray(np.argmin(error, axis=-1), dtype=np.int8)

    def velocity_after(self, velocity: NDArray[Any], vectors: Floats, dt: float) -> Floats:
        """Return velocities after steps with ``vectors``, multiples of the thrust, in one frame."""
        return next_velocity(velocity, vectors, self.damping, self.thrust, dt)


def _checked_magnitudes(given: Sequence[float]) -> tuple[float, ...]:
    """Return positive numbers from the largest to the smallest; refuse others."""
    listed = isinstance(given, Sequence | np.ndarray) and not isinstance(given, str)
    if not listed or not 1 <= len(given) <= MOST_THRUSTS or not all(is_number(m) for m in given):
        raise InputError(
            f"magnitudes are {given!r}: give 1 to {MOST_THRUSTS} multiples of the thrust"
        )
    numbers = tuple(float(m) for m in given)
    falling = all(a > b for a, b in pairwise(numbers))
    if not falling or not 0.0 < numbers[-1] <= numbers[0] < math.inf:
        raise InputError(
            f"magnitudes are {numbers}: give positive multiples of the thrust, the largest first, "
            "each once"
        )
    return numbers


def check_thrusts(thrusts: Any) -> None:
    """Refuse a number of thrust magnitudes that is not allowed."""
    if not is_whole(thrusts) or not 1 <= thrusts <= MOST_THRUSTS:
        raise InputError(
            f"thrusts is {thrusts!r}: give a whole number of thrust magnitudes, 1 to {MOST_THRUSTS}"
        )


def fixed_multiples(thrusts: int) -> tuple[float, ...]:
    """Return multiples of u that need no fit, the largest first."""
    if thrusts in MULTIPLES:
        return MULTIPLES[thrusts]
    return tuple(float(m) for m in np.geomspace(2.3, 0.25, thrusts))


@lru_cache(maxsize=256)
def action_vectors(magnitudes: tuple[float, ...]) -> Floats:
    """Return accelerations of all actions in the egocentric frame, ``(12 M + 1, 2)``; read-only."""
    pushes = [magnitude * ACTION_VECTORS[:NUM_DIRECTIONS] for magnitude in magnitudes]
    vectors = np.concatenate([*pushes, ACTION_VECTORS[COAST:]])
    vectors.setflags(write=False)
    return vectors


def velocities(positions: NDArray[np.floating], initial: NDArray[np.floating], dt: float) -> Floats:
    """Return the velocity of the step that led to each position: ``v_t = (p_t - p_{t-1}) / dt``.

    Parameters
    ----------
    positions
        ``(frames, ..., 2)``, arena frame.
    initial
        ``(..., 2)``, velocity at the first frame [arena unit / s].
    dt
        Time between frames [s].

    Returns
    -------
    ``(frames, ..., 2)`` in arena unit / s.
    """
    out = np.empty(positions.shape, dtype=np.float64)
    out[0] = initial
    np.subtract(positions[1:], positions[:-1], out=out[1:])
    out[1:] /= dt
    return out


def infer_actions(
    velocity: NDArray[np.floating],
    next_velocity: NDArray[np.floating],
    focus: NDArray[np.floating],
    locomotion: Locomotion,
    dt: float,
) -> NDArray[np.int8]:
    """Return the action whose acceleration is nearest to the observed one (inverse dynamics).

    The observed acceleration is ``(v_{t+1} - (1 - d) v_t) / dt``; it is compared, in the egocentric
    frame, with the 12 M + 1 vectors ``u a``, zero included. Ties go to the lower action number.
    Of cells it is the cell that holds the next velocity, and ``focus`` is the course.

    Parameters
    ----------
    velocity, next_velocity
        ``(..., 2)``, arena frame [arena unit / s].
    focus
        ``(..., 2)``, unit vectors towards the focus before the step, arena frame.

    Returns
    -------
    ``(...,)`` int8, 0 to 12 M.
    """
    chosen = locomotion.chosen_by_action(velocity, next_velocity, dt)
    ahead = np.sum(chosen * focus, axis=-1)
    left = chosen[..., 1] * focus[..., 0] - chosen[..., 0] * focus[..., 1]
    return locomotion.nearest_actions(np.stack([ahead, left], axis=-1))


def apply_actions(
    velocity: NDArray[np.floating],
    actions: NDArray[np.integer],
    focus: NDArray[np.floating],
    locomotion: Locomotion,
    dt: float,
) -> Floats:
    """Return velocities ``(..., 2)`` one step after ``actions`` ``(...,)``.

    The other arrays are those of :func:`infer_actions`.
    """
    ahead, left = np.moveaxis(locomotion.action_vectors[actions], -1, 0)
    x, y = np.moveaxis(focus, -1, 0)
    vectors = np.stack([ahead * x - left * y, ahead * y + left * x], axis=-1)
    return locomotion.velocity_after(velocity, vectors, dt)


def shorter_turn(end: NDArray[Any], start: NDArray[Any]) -> Floats:
    """Return turns between angles [rad] by the shorter way, in [-pi, pi)."""
    return np.asarray((end - start + np.pi) % (2.0 * np.pi) - np.pi)
