"""Simple scripted rules, for individuals that no learner drives.

A pursuer accelerates straight at the target (of several, at the nearest). A target looks a few
steps ahead along each of its actions and takes the one that leaves it farthest from pursuers and
walls.
"""

from __future__ import annotations

import math

import numba as nb
import numpy as np

from animarl_envs.arena import SHAPE_CODES
from animarl_envs.compiling import jit
from animarl_envs.kinematics import next_velocity

_SQUARE, _DISC = SHAPE_CODES["square"], SHAPE_CODES["disc"]
LOOKAHEAD = 6  # [steps] that the target looks ahead, the action held
WALL_MARGIN = 0.25  # walls repel from this share of the arena's size inwards


@nb.njit(inline="always")
def wall_cost(x, y, shape, size):  # type: ignore[no-untyped-def]
    """Return the squared depth of ``(x, y)`` in the margin along the wall, in margins; 0 inside."""
    margin = WALL_MARGIN * size
    if shape == _SQUARE:
        depth_x = max(0.0, abs(x) - size + margin) / margin
        depth_y = max(0.0, abs(y) - size + margin) / margin
        return depth_x * depth_x + depth_y * depth_y
    if shape == _DISC:
        depth = max(0.0, math.sqrt(x * x + y * y) - size + margin) / margin
        return depth * depth
    return 0.0


@jit
def decide(  # type: ignore[no-untyped-def]
    i, position, velocity, towards, damping, thrust, pushes, dt, shape, size, lone, actions
):
    """Write the action of individual ``i``'s rule in each copy to ``actions[i]``, ``(B,)``.

    ``pushes`` ``(K, 2, A)`` are the actions' vectors in multiples of the thrust, ahead and left.
    ``lone``: the last individual pursues all others, else all others pursue it.
    """
    K, _, B = position.shape
    last = K - 1
    for b in range(B):
        actions[i, b] = 0
    if (i == last) == lone:
        return
    first_pursuer, end = (last, K) if lone else (0, last)
    px, py, cost, lowest = np.empty(B), np.empty(B), np.empty(B), np.full(B, math.inf)
    for k in range(pushes.shape[2]):
        ahead = pushes[i, 0, k]
        left = pushes[i, 1, k]
        for b in range(B):
            ax = ahead * towards[i, 0, b] - left * towards[i, 1, b]
            ay = ahead * towards[i, 1, b] + left * towards[i, 0, b]
            x = position[i, 0, b]
            y = position[i, 1, b]
            vx = velocity[i, 0, b]
            vy = velocity[i, 1, b]
            for _ in range(LOOKAHEAD):
                vx = next_velocity(vx, ax, damping, thrust, dt)
                vy = next_velocity(vy, ay, damping, thrust, dt)
                x += vx * dt
                y += vy * dt
            px[b] = x
            py[b] = y
            cost[b] = 10.0 * wall_cost(x, y, shape, size)
        for j in range(first_pursuer, end):
            for b in range(B):
                dx = position[j, 0, b] + velocity[j, 0, b] * LOOKAHEAD * dt * 0.5 - px[b]
                dy = position[j, 1, b] + velocity[j, 1, b] * LOOKAHEAD * dt * 0.5 - py[b]
                cost[b] += 1.0 / (math.sqrt(dx * dx + dy * dy) + 0.05 * size)
        for b in range(B):
            better = cost[b] < lowest[b]
            actions[i, b] = k if better else actions[i, b]
            lowest[b] = cost[b] if better else lowest[b]
