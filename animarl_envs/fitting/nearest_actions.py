"""Kernels of the joint fit: each step's nearest action, and the sums of its linear equations."""

from __future__ import annotations

import math

import numpy as np

from animarl_envs.compiling import jit
from animarl_envs.kinematics import next_velocity as after

_HALF_SQRT3 = math.sqrt(3.0) / 2.0


@jit
def assign(  # type: ignore[no-untyped-def]
    velocity, next_velocity, focus, damping, impulses, error, action, level
):
    """Nearest of the actions to each observed acceleration.

    ``impulses`` ``(M,)`` are the thrusts times dt. Writes the squared error ``(steps,)`` of the
    rebuilt velocity, the action's unit vector in the arena frame ``(steps, 2)``, zero for coasting,
    and which thrust it has ``(steps,)``. Directions are searched in one quadrant.
    """
    for t in range(velocity.shape[0]):
        # what the transition without acceleration leaves unexplained
        rest_x = next_velocity[t, 0] - after(velocity[t, 0], 0.0, damping, 0.0, 0.0)
        rest_y = next_velocity[t, 1] - after(velocity[t, 1], 0.0, damping, 0.0, 0.0)
        ahead = rest_x * focus[t, 0] + rest_y * focus[t, 1]
        left = rest_y * focus[t, 0] - rest_x * focus[t, 1]
        x, y = abs(ahead), abs(left)
        along, c, s = x, 1.0, 0.0
        if _HALF_SQRT3 * x + 0.5 * y > along:
            along, c, s = _HALF_SQRT3 * x + 0.5 * y, _HALF_SQRT3, 0.5
        if 0.5 * x + _HALF_SQRT3 * y > along:
            along, c, s = 0.5 * x + _HALF_SQRT3 * y, 0.5, _HALF_SQRT3
        if y > along:
            along, c, s = y, 0.0, 1.0
        square = x * x + y * y
        nearest, least = -1, 0.0
        for j in range(len(impulses)):
            gain = impulses[j] * (impulses[j] - 2.0 * along)
            if gain < least:
                nearest, least = j, gain
        level[t] = nearest
        if nearest >= 0:  # nearer to that direction than to zero
            c = c if ahead >= 0 else -c
            s = s if left >= 0 else -s
            action[t, 0] = c * focus[t, 0] - s * focus[t, 1]
            action[t, 1] = c * focus[t, 1] + s * focus[t, 0]
            impulse = impulses[nearest]
            error[t] = max(square - 2.0 * impulse * along + impulse * impulse, 0.0)
        else:
            action[t, 0] = 0.0
            action[t, 1] = 0.0
            error[t] = square


@jit
def sums(velocity, next_velocity, action, level, error, limit, dt, thrusts):  # type: ignore[no-untyped-def]
    """Inner products over the steps with ``error <= limit``, those with actions per thrust."""
    vv, vn = 0.0, 0.0
    va, aa, an = np.zeros(thrusts), np.zeros(thrusts), np.zeros(thrusts)
    for t in range(velocity.shape[0]):
        if error[t] > limit:
            continue
        j = level[t]
        for axis in range(2):
            v, n, a = velocity[t, axis], next_velocity[t, axis], dt * action[t, axis]
            vv += v * v
            vn += v * n
            if j >= 0:
                va[j] += v * a
                aa[j] += a * a
                an[j] += a * n
    return vv, vn, va, aa, an
