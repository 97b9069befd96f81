"""Locomotion: v' = (1 - d) v + u a dt, its 13 actions, and the way back from tracks to actions.

One definition serves the simulators, the inverse dynamics and the figures; the kernels' form of the
equation is :mod:`animarl_envs.worlds.transition`.

Frames. Positions and velocities are in the arena frame. Each individual has an *egocentric frame*
towards its focus: x axis along the unit vector ``focus`` (towards the focus), y axis to its left.
Actions ``k = 0..11`` are unit accelerations at ``-30 deg * k`` in that frame (0 straight at the
focus, 3 to the right, 6 away, 9 to the left); action 12 is no acceleration ("coasting").
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from animarl_envs.errors import InputError

NUM_ACTIONS = 13
COAST = 12
ACTION_ANGLES: NDArray[np.float64] = -np.deg2rad(30.0) * np.arange(12)
"""Angle of actions 0..11 in the egocentric frame, counter-clockwise [rad]."""

# Exact halves and zeros, so that a mirrored or rotated action is the mirrored or rotated vector.
_C, _S = math.sqrt(3.0) / 2.0, 0.5
ACTION_VECTORS: NDArray[np.float64] = np.array(
    [
        (1.0, 0.0), (_C, -_S), (_S, -_C), (0.0, -1.0), (-_S, -_C), (-_C, -_S),
        (-1.0, 0.0), (-_C, _S), (-_S, _C), (0.0, 1.0), (_S, _C), (_C, _S),
        (0.0, 0.0),
    ]
)  # fmt: skip
"""Accelerations of the 13 actions in the egocentric frame, ``(13, 2)``, unit vectors or zero."""


@dataclass(frozen=True)
class Locomotion:
    """Locomotion parameters of one individual.

    Parameters
    ----------
    damping
        ``d``, the share of the velocity lost in one step [1], in [0, 1].
    thrust
        ``u``, the amplitude of the acceleration [arena unit / s^2], positive.
    """

    damping: float
    thrust: float

    def __post_init__(self) -> None:
        if not 0.0 <= self.damping <= 1.0:
            raise InputError(f"damping is {self.damping}: it must lie between 0 and 1")
        if not 0.0 < self.thrust < math.inf:
            raise InputError(f"thrust is {self.thrust}: it must be a positive number")

    def terminal_speed(self, dt: float) -> float:
        """Speed reached under constant thrust, ``u dt / d`` [arena unit / s]."""
        return math.inf if self.damping == 0 else self.thrust * dt / self.damping

    def top_speed(self, dt: float, steps: int, initial: float = 0.0) -> float:
        """Bound of the speed within ``steps``, from a speed of at most ``initial``."""
        reached = max(initial, self.terminal_speed(dt))
        return min(reached, initial + steps * self.thrust * dt)


def velocities(
    positions: NDArray[np.floating], initial: NDArray[np.floating], dt: float
) -> NDArray[np.float64]:
    """Velocity of the step that led to each position: ``v_t = (p_t - p_{t-1}) / dt``.

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
    """Inverse dynamics: the action whose acceleration is nearest to the one that was observed.

    The observed acceleration is ``(v_{t+1} - (1 - d) v_t) / dt``; it is compared, in the egocentric
    frame, with the 13 vectors ``u a``, zero included. Ties go to the lower action number.

    Parameters
    ----------
    velocity, next_velocity
        ``(..., 2)``, arena frame [arena unit / s].
    focus
        ``(..., 2)``, unit vectors towards the focus before the step, arena frame.

    Returns
    -------
    ``(...,)`` int8, 0 to 12.
    """
    acceleration = (next_velocity - (1.0 - locomotion.damping) * velocity) / dt
    ahead = np.sum(acceleration * focus, axis=-1)
    left = acceleration[..., 1] * focus[..., 0] - acceleration[..., 0] * focus[..., 1]
    egocentric = np.stack([ahead, left], axis=-1)
    error = np.linalg.norm(egocentric[..., None, :] - locomotion.thrust * ACTION_VECTORS, axis=-1)
    return np.asarray(np.argmin(error, axis=-1), dtype=np.int8)


def apply_actions(
    velocity: NDArray[np.floating],
    actions: NDArray[np.integer],
    focus: NDArray[np.floating],
    locomotion: Locomotion,
    dt: float,
) -> NDArray[np.float64]:
    """Velocities ``(..., 2)`` one step after ``actions`` ``(...,)``.

    The other arrays are those of :func:`infer_actions`.
    """
    acceleration = locomotion.thrust * action_directions(actions, focus)
    return (1.0 - locomotion.damping) * velocity + acceleration * dt


def action_directions(
    actions: NDArray[np.integer], focus: NDArray[np.floating]
) -> NDArray[np.float64]:
    """Where ``actions`` ``(...,)`` accelerate to: ``(..., 2)``, arena frame, of length 1 or 0.

    ``focus`` ``(..., 2)`` are unit vectors towards the focus, arena frame.
    """
    ahead, left = np.moveaxis(ACTION_VECTORS[actions], -1, 0)
    x, y = np.moveaxis(focus, -1, 0)
    return np.stack([ahead * x - left * y, ahead * y + left * x], axis=-1)
