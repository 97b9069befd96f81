"""How bodies move, as kernels call it: the transition of the velocity, turning, and walls.

Fits and worlds use them alike. They stand apart from :mod:`animarl_envs.locomotion` so that
importing the package, which needs the parameters alone, leaves numba out.
"""

import math
from typing import Any

import numba as nb
import numpy as np

from animarl_envs import locomotion
from animarl_envs.arena import SHAPE_CODES
from animarl_envs.compiling import inline_kernel, jit

SQUARE, DISC = SHAPE_CODES["square"], SHAPE_CODES["disc"]
TOGETHER = 16  # copies of which none is at a wall cost no division
HALF_TURN = math.pi - 1e-6  # an exact about-face has no side, so it counts as no turn [rad]

next_velocity: Any = nb.njit(inline="always")(locomotion.next_velocity)
"""One component of ``v' = (1 - d) v + u a dt``."""

residual: Any = nb.njit(inline="always")(locomotion.residual)
"""One component of ``v' - (1 - d) v``, the way back."""


@nb.njit(inline="always")
def next_turn(  # type: ignore[no-untyped-def]
    turn, cosine, sine, velocity_x, velocity_y, persistence, gain, slip_cosine, slip_sine, fast
):
    """Return the turn of a step [rad], by the equation of :mod:`animarl_envs.species.turning`.

    ``cosine`` and ``sine`` are those of the heading before the step, ``fast`` is the speed about
    which walking turns the body in full.
    """
    speed = math.sqrt(velocity_x * velocity_x + velocity_y * velocity_y)
    turned = persistence * turn
    if speed > 0.0:
        x = velocity_x * slip_cosine - velocity_y * slip_sine
        y = velocity_x * slip_sine + velocity_y * slip_cosine
        off = (cosine * y - sine * x) / speed  # a sine
        turned += gain * math.tanh(speed / fast) * off
    return turned


@nb.njit(inline="always")
def wrapped(angle):  # type: ignore[no-untyped-def]
    """Return the same direction in [-pi, pi)."""
    return angle - 2.0 * math.pi * math.floor(0.5 + angle / (2.0 * math.pi))


@nb.njit(inline="always")
def turn_between(before, after):  # type: ignore[no-untyped-def]
    """Return the shorter way from one direction to another, both in [-pi, pi] [rad]."""
    turned = after - before
    if turned > math.pi:
        turned -= 2.0 * math.pi
    elif turned < -math.pi:
        turned += 2.0 * math.pi
    return 0.0 if abs(turned) > HALF_TURN else turned


@jit(forceinline=True)  # Python calls it, too
def rebound(field, position, velocity):  # type: ignore[no-untyped-def]
    """Hold individuals at the walls: the velocity into the wall is lost, that along it kept.

    Positions and velocities are ``(K, 2, B)``; ``field`` is that of an
    :class:`~animarl_envs.arena.Arena`. Who is pushed out of an obstacle into a wall or another
    obstacle is held three times in turn.
    """
    shape, size, _, holes = field
    K, _, B = position.shape
    for turn in range(K * (3 if len(holes) else 1)):
        i = turn % K
        for k in range(len(holes)):
            _hold(i, holes[k, 0], holes[k, 1], holes[k, 2], False, position, velocity)
        if shape == SQUARE:
            for x in range(2):
                for b in range(B):
                    p = position[i, x, b]
                    v = velocity[i, x, b]
                    held = min(size, max(-size, p))
                    into = (p != held) & (v * p > 0.0)
                    position[i, x, b] = held
                    velocity[i, x, b] = 0.0 if into else v
        elif shape == DISC:
            _hold(i, 0.0, 0.0, size, True, position, velocity)


@inline_kernel
def _hold(i, middle_x, middle_y, radius, within, position, velocity):  # type: ignore[no-untyped-def]
    """Hold individual ``i`` within a circle, or out of it."""
    B = position.shape[2]
    for begin in range(0, B, TOGETHER):
        end, farthest, nearest = min(B, begin + TOGETHER), 0.0, np.inf
        for b in range(begin, end):
            x = position[i, 0, b] - middle_x
            y = position[i, 1, b] - middle_y
            farthest = max(farthest, x * x + y * y)
            nearest = min(nearest, x * x + y * y)
        far = farthest > radius * radius * (1.0 - 1e-9)
        if not (far if within else nearest < radius * radius):
            continue
        for b in range(begin, end):  # without a branch, so that divisions are vectorised
            x = position[i, 0, b] - middle_x
            y = position[i, 1, b] - middle_y
            out = math.sqrt(x * x + y * y)
            held = out > radius if within else out < radius
            # a hair inside the field, so that rounding does not leave it outside
            whole = max(out, 1e-300) if held else 1.0
            back = radius / whole * (1.0 - 1e-12 if within else 1.0 + 1e-12)
            nx = (x if held else 0.0) / whole
            ny = (y if held else 0.0) / whole
            outwards = velocity[i, 0, b] * nx + velocity[i, 1, b] * ny
            into = max(0.0, outwards) if within else min(0.0, outwards)
            position[i, 0, b] = middle_x + back * x if held else position[i, 0, b]
            position[i, 1, b] = middle_y + back * y if held else position[i, 1, b]
            velocity[i, 0, b] -= into * nx
            velocity[i, 1, b] -= into * ny
