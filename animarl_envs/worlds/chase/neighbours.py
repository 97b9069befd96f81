"""What one individual of a chase sees of the others, in order, as loops over copies.

The target comes first (unless it is the one that sees), then the pursuers by distance, ties by
index. Few are sorted in all copies at once, without branches; many in each copy by itself, from
their order at the last step, which is nearly right: the cost per neighbour stays the same.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from animarl_envs.compiling import jit, part

DX, DY, DVX, DVY, APART = 0, 1, 2, 3, 4
RELATIVE = 5
FEW = 4  # pursuers: up to so many are sorted in all copies at once


class Neighbours(NamedTuple):
    """Scratch of the senses; nothing in it decides anything."""

    others: NDArray[np.float64]  # (K - 1, RELATIVE, B), of the individual that is looking
    order: NDArray[np.int16]  # (K, B, n), pursuers by distance at the last step; n = 0 for few
    distance: NDArray[np.float64]  # (K,)


def neighbours_of(num_individuals: int, num_copies: int) -> Neighbours:
    """Scratch for so many individuals and copies."""
    K, B = num_individuals, num_copies
    many = K - 1 if K - 1 > FEW else 0
    order = np.zeros((K, B, many), dtype=np.int16)
    for i in range(K if many else 0):
        pursuers = [j for j in range(K - 1) if j != i]
        order[i, :, : len(pursuers)] = pursuers
    return Neighbours(np.zeros((K - 1, RELATIVE, B)), order, np.zeros(K))


@part
def look(i, position, velocity, neighbours):  # type: ignore[no-untyped-def]
    """Fill ``neighbours.others`` with what individual ``i`` sees; how many these are."""
    others = neighbours.others
    target = position.shape[0] - 1
    seen = 0
    if i != target:
        _relate(i, target, seen, position, velocity, others)
        seen = 1
    if neighbours.order.shape[2] > 0:
        pursuers = target if i == target else target - 1
        _in_each_copy(i, seen, pursuers, position, velocity, neighbours)
        return seen + pursuers
    sorted_from = seen
    for j in range(target):
        if j != i:
            _relate(i, j, seen, position, velocity, others)
            seen += 1
    for last in range(seen - 1, sorted_from, -1):  # stable bubble sort
        for rank in range(sorted_from, last):
            _exchange(rank, others)
    return seen


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
        others[rank, APART, b] = math.sqrt(dx * dx + dy * dy)


@part
def _exchange(rank, others):  # type: ignore[no-untyped-def]
    """Exchange this other individual and the next where this one is the farther."""
    for b in range(others.shape[2]):
        swap = others[rank, APART, b] > others[rank + 1, APART, b]
        for row in range(RELATIVE):
            one = others[rank, row, b]
            two = others[rank + 1, row, b]
            others[rank, row, b] = two if swap else one
            others[rank + 1, row, b] = one if swap else two


@jit
def _in_each_copy(i, first, pursuers, position, velocity, neighbours):  # type: ignore[no-untyped-def]
    """The pursuers seen by ``i``, from rank ``first``, by insertion into their last order."""
    others, distance = neighbours.others, neighbours.distance
    for b in range(position.shape[2]):
        order = neighbours.order[i, b]
        x, y = position[i, 0, b], position[i, 1, b]
        for j in range(position.shape[0]):
            dx, dy = position[j, 0, b] - x, position[j, 1, b] - y
            distance[j] = math.sqrt(dx * dx + dy * dy)
        for rank in range(1, pursuers):
            j = order[rank]
            at = rank
            while at > 0 and (
                distance[order[at - 1]] > distance[j]
                or (distance[order[at - 1]] == distance[j] and order[at - 1] > j)
            ):
                order[at] = order[at - 1]
                at -= 1
            order[at] = j
        for rank in range(pursuers):
            j = order[rank]
            others[first + rank, DX, b] = position[j, 0, b] - x
            others[first + rank, DY, b] = position[j, 1, b] - y
            others[first + rank, DVX, b] = velocity[j, 0, b] - velocity[i, 0, b]
            others[first + rank, DVY, b] = velocity[j, 1, b] - velocity[i, 1, b]
            others[first + rank, APART, b] = distance[j]
