"""Simple scripted rules, for individuals that no learner drives.

A pursuer accelerates straight at the target. The target looks a few steps ahead along
each of its 13 actions and takes the one that leaves it farthest from pursuers and walls.
"""

from __future__ import annotations

import math
from typing import Any

import numba as nb
import numpy as np
from numpy.typing import NDArray

from animarl_envs.arena import SHAPE_CODES
from animarl_envs.locomotion import ACTION_VECTORS, NUM_ACTIONS

_SQUARE, _DISC = SHAPE_CODES["square"], SHAPE_CODES["disc"]
LOOKAHEAD = 6  # [steps] for which the action is held in the mind's eye
WALL_MARGIN = 0.25  # walls repel from this share of the arena's size inwards


@nb.njit(inline="always")
def wall_cost(x, y, shape, size):  # type: ignore[no-untyped-def]
    """How far ``(x, y)`` lies in the margin along the wall, squared and in margins; 0 inside it."""
    margin = WALL_MARGIN * size
    if shape == _SQUARE:
        depth_x = max(0.0, abs(x) - size + margin) / margin
        depth_y = max(0.0, abs(y) - size + margin) / margin
        return depth_x * depth_x + depth_y * depth_y
    if shape == _DISC:
        depth = max(0.0, math.sqrt(x * x + y * y) - size + margin) / margin
        return depth * depth
    return 0.0


@nb.njit(cache=True)
def scripted_action(b, i, position, velocity, towards, damping, thrust, dt, shape, size):  # type: ignore[no-untyped-def]
    """The action of individual ``i`` in copy ``b`` by the rule of its role."""
    target = len(position) - 1
    if i != target:
        return 0
    ex = towards[i, 0, b]
    ey = towards[i, 1, b]
    best = 0
    lowest = math.inf
    for k in range(NUM_ACTIONS):
        ahead = ACTION_VECTORS[k, 0]
        left = ACTION_VECTORS[k, 1]
        ax = ahead * ex - left * ey
        ay = ahead * ey + left * ex
        px = position[i, 0, b]
        py = position[i, 1, b]
        vx = velocity[i, 0, b]
        vy = velocity[i, 1, b]
        for _ in range(LOOKAHEAD):
            vx = (1.0 - damping) * vx + thrust * ax * dt
            vy = (1.0 - damping) * vy + thrust * ay * dt
            px += vx * dt
            py += vy * dt
        cost = 10.0 * wall_cost(px, py, shape, size)
        for j in range(target):
            dx = position[j, 0, b] + velocity[j, 0, b] * LOOKAHEAD * dt * 0.5 - px
            dy = position[j, 1, b] + velocity[j, 1, b] * LOOKAHEAD * dt * 0.5 - py
            cost += 1.0 / (math.sqrt(dx * dx + dy * dy) + 0.05 * size)
        if cost < lowest:
            lowest = cost
            best = k
    return best


@nb.njit(cache=True)
def _decide_all(position, velocity, towards, damping, thrust, dt, shape, size, actions):  # type: ignore[no-untyped-def]
    for b in range(actions.shape[0]):
        for i in range(actions.shape[1]):
            actions[b, i] = scripted_action(
                b, i, position, velocity, towards, damping[i], thrust[i], dt, shape, size
            )


def scripted_actions(world: Any) -> NDArray[np.int64]:
    """What the rules would do in every copy of a chase world, ``(B, K)``."""
    actions = np.zeros((world.num_copies, world.num_individuals), dtype=np.int64)
    species = world.scenario.species
    _decide_all(
        world._position, world._velocity, world._towards,
        np.array([m.damping for m in species.locomotion]),
        np.array([m.thrust for m in species.locomotion]),
        species.dt, SHAPE_CODES[species.arena.shape], species.arena.size, actions,
    )  # fmt: skip
    return actions
