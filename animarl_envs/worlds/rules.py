"""Simple scripted rules, for individuals that no learner drives.

A pursuer accelerates straight at the target (of several, at the nearest). A target looks ahead
along each of its actions and takes the one that leaves it farthest from walls, and from pursuers
who accelerate straight at where it is now.
"""

from __future__ import annotations

import math

import numba as nb
import numpy as np

from animarl_envs.arena import SHAPE_CODES
from animarl_envs.compiling import jit

_SQUARE, _DISC = SHAPE_CODES["square"], SHAPE_CODES["disc"]
LOOKS = 3  # a target looks ahead by thirds of the time in which its thrust carries it half a size
WALL_WEIGHT = 10.0  # of the walls' cost, beside (size / distance)^2 of each pursuer
SOFTENING = 0.0025  # added to the squared distance in sizes, which may be zero
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


@nb.njit(inline="always")
def _reach(damping, thrust, dt, steps):  # type: ignore[no-untyped-def]
    """How far velocity 1 carries in so many steps, and how far a unit action that is held.

    The sums of v' = (1 - d) v + u a dt and p' = p + v' dt.
    """
    if damping < 1e-9:
        return steps * dt, thrust * dt * dt * steps * (steps + 1.0) / 2.0
    kept = 1.0 - damping
    carried = dt * kept * (1.0 - kept**steps) / damping
    return carried, thrust * dt * (steps * dt - carried) / damping


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
    square = size * size
    steps = np.ceil(np.sqrt(size / thrust[i]) / dt)
    cost, lowest = np.empty(B), np.empty(B)
    for b in range(B):
        lowest[b] = math.inf
    own = np.empty((LOOKS, 2))  # written number by number: rows take numba seconds to compile
    theirs = np.empty((LOOKS, end - first_pursuer, 2, B))  # where each pursuer will be
    for look in range(LOOKS):
        until = max(1.0, np.floor((look + 1) * steps / LOOKS))
        own[look, 0], own[look, 1] = _reach(damping[i], thrust[i], dt, until)
        for j in range(first_pursuer, end):
            carried, pushed = _reach(damping[j], thrust[j], dt, until)
            for b in range(B):
                to_x = position[i, 0, b] - position[j, 0, b]
                to_y = position[i, 1, b] - position[j, 1, b]
                chase = pushed / (math.sqrt(to_x * to_x + to_y * to_y) + 1e-9)
                x = position[j, 0, b] + carried * velocity[j, 0, b] + chase * to_x
                y = position[j, 1, b] + carried * velocity[j, 1, b] + chase * to_y
                theirs[look, j - first_pursuer, 0, b] = x
                theirs[look, j - first_pursuer, 1, b] = y
    for k in range(pushes.shape[2]):
        ahead = pushes[i, 0, k]
        left = pushes[i, 1, k]
        for b in range(B):
            cost[b] = 0.0
        for look in range(LOOKS):
            carried, pushed = own[look, 0], own[look, 1]
            for b in range(B):
                x = position[i, 0, b] + carried * velocity[i, 0, b]
                y = position[i, 1, b] + carried * velocity[i, 1, b]
                x += pushed * (ahead * towards[i, 0, b] - left * towards[i, 1, b])
                y += pushed * (ahead * towards[i, 1, b] + left * towards[i, 0, b])
                cost[b] += WALL_WEIGHT * wall_cost(x, y, shape, size)
                for j in range(end - first_pursuer):
                    dx = theirs[look, j, 0, b] - x
                    dy = theirs[look, j, 1, b] - y
                    cost[b] += square / (dx * dx + dy * dy + SOFTENING * square)
        for b in range(B):
            better = cost[b] < lowest[b]
            actions[i, b] = k if better else actions[i, b]
            lowest[b] = cost[b] if better else lowest[b]
