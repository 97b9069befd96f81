"""What the individuals of a chase observe, as loops over copies.

Arrays as in :mod:`animarl_envs.worlds.chase.kernels`; ``others`` ``(K - 1, RELATIVE, B)`` holds
what one individual sees of the others, in order.
"""

from __future__ import annotations

import math

import numpy as np

from animarl_envs.compiling import jit, part
from animarl_envs.worlds.arctangent import angle_of

DX, DY, DVX, DVY, DISTANCE = 0, 1, 2, 3, 4
RELATIVE = 5
OWN_ENTRIES, OTHER_ENTRIES = 6, 6


@jit
def observe(position, velocity, towards, others, senses_centre, observation):  # type: ignore[no-untyped-def]
    """Focus directions and egocentric observations; ``others`` is scratch, ``(K - 1, 5, B)``.

    The others in order: target first, then pursuers by distance, ties by index. The first of them
    is the focus. At distance zero the old direction towards it is kept.
    """
    K, _, B = position.shape
    target = K - 1
    for i in range(K):
        ranks = 0
        if i != target:
            _relate(i, target, ranks, position, velocity, others)
            ranks = 1
        sorted_from = ranks
        for j in range(target):
            if j != i:
                _relate(i, j, ranks, position, velocity, others)
                ranks += 1
        for last in range(ranks - 1, sorted_from, -1):  # stable bubble sort, without branches
            for rank in range(sorted_from, last):
                _order(rank, others)
        _observe_own(i, position, velocity, others, towards, observation)
        for rank in range(ranks):
            _observe_other(i, rank, others, towards, observation)
        if senses_centre:
            entry = OWN_ENTRIES + OTHER_ENTRIES * ranks
            for b in range(B):
                x = position[i, 0, b]
                y = position[i, 1, b]
                observation[i, entry, b] = math.sqrt(x * x + y * y)


@part
def _relate(i, j, rank, position, velocity, others):  # type: ignore[no-untyped-def]
    """Position, velocity and distance of ``j`` relative to ``i``, arena frame."""
    for b in range(position.shape[2]):
        dx = position[j, 0, b] - position[i, 0, b]
        dy = position[j, 1, b] - position[i, 1, b]
        others[rank, DX, b] = dx
        others[rank, DY, b] = dy
        others[rank, DVX, b] = velocity[j, 0, b] - velocity[i, 0, b]
        others[rank, DVY, b] = velocity[j, 1, b] - velocity[i, 1, b]
        others[rank, DISTANCE, b] = math.sqrt(dx * dx + dy * dy)


@part
def _order(rank, others):  # type: ignore[no-untyped-def]
    """Exchange this other individual and the next where this one is the farther."""
    for b in range(others.shape[2]):
        swap = others[rank, DISTANCE, b] > others[rank + 1, DISTANCE, b]
        for row in range(RELATIVE):
            one = others[rank, row, b]
            two = others[rank + 1, row, b]
            others[rank, row, b] = two if swap else one
            others[rank + 1, row, b] = one if swap else two


@part
def _observe_own(i, position, velocity, others, towards, observation):  # type: ignore[no-untyped-def]
    """Own position, direction of the focus, and own velocity in the egocentric frame."""
    B = position.shape[2]
    for x in range(2):
        for b in range(B):
            distance = others[0, DISTANCE, b]
            e = others[0, DX + x, b] / distance if distance > 0.0 else towards[i, x, b]
            towards[i, x, b] = e
            observation[i, x, b] = position[i, x, b]
            observation[i, 4 + x, b] = e
    for b in range(B):
        ahead, left = _egocentric(velocity[i, 0, b], velocity[i, 1, b], i, b, towards)
        observation[i, 2, b] = ahead
        observation[i, 3, b] = left


@part
def _observe_other(i, rank, others, towards, observation):  # type: ignore[no-untyped-def]
    """Position and velocity in the egocentric frame, distance, bearing."""
    entry = OWN_ENTRIES + OTHER_ENTRIES * rank
    B = others.shape[2]
    for b in range(B):
        ahead, left = _egocentric(others[rank, DX, b], others[rank, DY, b], i, b, towards)
        if rank == 0:  # the focus lies straight ahead, by definition
            left = np.float32(0.0)
        observation[i, entry, b] = ahead
        observation[i, entry + 1, b] = left
        observation[i, entry + 4, b] = others[rank, DISTANCE, b]
        observation[i, entry + 5, b] = np.float32(0.0) if rank == 0 else angle_of(ahead, left)
    for b in range(B):
        ahead, left = _egocentric(others[rank, DVX, b], others[rank, DVY, b], i, b, towards)
        observation[i, entry + 2, b] = ahead
        observation[i, entry + 3, b] = left


@part
def _egocentric(x, y, i, b, towards):  # type: ignore[no-untyped-def]
    """A vector ahead and to the left of individual ``i``, float32."""
    ex = towards[i, 0, b]
    ey = towards[i, 1, b]
    return np.float32(x * ex + y * ey), np.float32(y * ex - x * ey)
