"""What one individual of a chase sees of the others, in order, as loops over copies.

The last individual comes first (unless it is the one that sees): the target, or the pursuer where
one pursues several. Then the many others by distance, ties by index. Few are sorted in all copies
at once, without branches; many in each copy by itself, from their order at the last step, which is
nearly right: the cost per neighbour stays the same. Free animals see their nearest few, who are
selected in one pass over all.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from animarl_envs.compiling import jit, part
from animarl_envs.species import ChaseSpecies

DX, DY, DVX, DVY, APART, WHO = range(6)
FEW = 4  # up to so many are sorted in all copies at once
LINE = 8  # copies that lie in one cache line


class Neighbours(NamedTuple):
    """Scratch of the senses; nothing in it decides anything."""

    others: NDArray[np.float64]  # (K - 1, 6, B), of the individual that is looking
    order: NDArray[np.int16] | None  # (K, B, n), the many by distance at the last step
    state: NDArray[np.float64]  # (B, 4, K) for many: x, y and velocity, each copy's in one place
    distance: NDArray[np.float64]  # (LINE, K), of each from the one that is looking


def neighbours_of(species: ChaseSpecies, num_copies: int) -> Neighbours:
    """Scratch for the individuals of a species in so many copies."""
    K, B = species.num_individuals, num_copies
    if species.free:
        seen = species.num_seen
        order = np.zeros((1, LINE, seen), dtype=np.int16)
        state, distance = np.zeros((B if seen else 0, 4, K)), np.zeros((LINE, seen))
        return Neighbours(np.zeros((max(1, seen), WHO + 1, B)), order, state, distance)
    others = np.zeros((K - 1, WHO + 1, B))
    if K - 1 <= FEW:
        return Neighbours(others, None, np.zeros((0, 4, K)), np.zeros((LINE, K)))
    order = np.zeros((K, B, K - 1), dtype=np.int16)
    for i in range(K):
        order[i, :, : K - 1 - (i < K - 1)] = [j for j in range(K - 1) if j != i]
    return Neighbours(others, order, np.zeros((B, 4, K)), np.zeros((LINE, K)))


@part
def lay_out(position, velocity, observers, order, state):  # type: ignore[no-untyped-def]
    """Before anybody looks: where there are many, each copy's state is copied to one place."""
    if order is None:
        return
    if order.shape[2] > 0 and observers.any():
        _lay_out(position, velocity, state)


@jit
def _lay_out(position, velocity, state):  # type: ignore[no-untyped-def]
    K, _, B = position.shape
    for first in range(0, B, LINE):
        last = min(B, first + LINE)
        for j in range(K):
            for x in range(2):
                for b in range(first, last):
                    state[b, x, j] = position[j, x, b]
                    state[b, 2 + x, j] = velocity[j, x, b]


@part
def find_focus(i, position, others):  # type: ignore[no-untyped-def]
    """Of ``others``, the first alone and no velocity: what individual ``i`` turns to."""
    last = position.shape[0] - 1
    if i != last:
        for b in range(position.shape[2]):
            dx = position[last, 0, b] - position[i, 0, b]
            dy = position[last, 1, b] - position[i, 1, b]
            others[0, DX, b] = dx
            others[0, DY, b] = dy
            others[0, APART, b] = math.sqrt(dx * dx + dy * dy)
        return
    for b in range(position.shape[2]):
        others[0, APART, b] = np.inf
    for j in range(last):
        for b in range(position.shape[2]):
            dx = position[j, 0, b] - position[i, 0, b]
            dy = position[j, 1, b] - position[i, 1, b]
            apart = math.sqrt(dx * dx + dy * dy)
            nearer = apart < others[0, APART, b]
            others[0, DX, b] = dx if nearer else others[0, DX, b]
            others[0, DY, b] = dy if nearer else others[0, DY, b]
            others[0, APART, b] = apart if nearer else others[0, APART, b]


@part
def look(i, position, velocity, order, neighbours):  # type: ignore[no-untyped-def]
    """Fill ``neighbours.others`` with what individual ``i`` sees; how many these are."""
    others = neighbours.others
    K = position.shape[0]
    first = 0 if i == K - 1 else 1  # the first rank of those in order of distance
    if order is not None:
        if first == 1:
            _relate(i, K - 1, 0, position, velocity, others)
        _in_each_copy(i, first, K - 1 - first, order, neighbours)
    else:
        own = (i + 1) % K  # the last one comes first
        for k in range(K):
            if k != own:
                _relate(i, (k + K - 1) % K, k - 1 if k > own else k, position, velocity, others)
        for end in range(K - 2, first, -1):  # stable bubble sort
            for rank in range(first, end):
                _exchange(rank, others)
    return K - 1


@jit
def look_around(i, order, neighbours):  # type: ignore[no-untyped-def]
    """Fill ``neighbours.others`` with the nearest of all others, in order; how many these are."""
    others, state = neighbours.others, neighbours.state
    best, who, B = neighbours.distance, order[0], state.shape[0]
    most = who.shape[1]
    for begin in range(0, B, LINE):  # each line of ``others`` is written at once
        end = min(B, begin + LINE)
        for b in range(begin, end):
            _select(i, state[b], best[b - begin], who[b - begin])
        for rank in range(most):
            for row in range(4):  # place, then velocity
                for b in range(begin, end):
                    j = who[b - begin, rank]
                    others[rank, row, b] = state[b, row, j] - state[b, row, i]
            for b in range(begin, end):
                others[rank, APART, b] = math.sqrt(best[b - begin, rank])
                others[rank, WHO, b] = who[b - begin, rank]
    return most


@part
def _select(i, state, best, who):  # type: ignore[no-untyped-def]
    """Put the nearest others of ``i`` in one copy, in order, into ``who`` and ``best``, squared."""
    most, count = len(who), 0
    for j in range(state.shape[1]):
        dx, dy = state[0, j] - state[0, i], state[1, j] - state[1, i]
        apart = dx * dx + dy * dy
        if j == i or (count == most and not apart < best[most - 1]):
            continue
        at = min(count, most - 1)
        while at > 0 and best[at - 1] > apart:
            best[at] = best[at - 1]
            who[at] = who[at - 1]
            at -= 1
        best[at] = apart
        who[at] = j
        count = min(count + 1, most)


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
        others[rank, WHO, b] = j


@part
def _exchange(rank, others):  # type: ignore[no-untyped-def]
    """Exchange this other individual and the next where this one is the farther."""
    for b in range(others.shape[2]):
        swap = others[rank, APART, b] > others[rank + 1, APART, b]
        for row in range(WHO + 1):
            one = others[rank, row, b]
            two = others[rank + 1, row, b]
            others[rank, row, b] = two if swap else one
            others[rank + 1, row, b] = one if swap else two


@jit
def _in_each_copy(i, first, count, order, neighbours):  # type: ignore[no-untyped-def]
    """The many seen by ``i``, from rank ``first``; a cache line of copies at a time."""
    others, state, distance = neighbours.others, neighbours.state, neighbours.distance
    for begin in range(0, others.shape[2], LINE):
        end = min(others.shape[2], begin + LINE)
        for b in range(begin, end):
            for j in range(state.shape[2]):
                dx, dy = state[b, 0, j] - state[b, 0, i], state[b, 1, j] - state[b, 1, i]
                distance[b - begin, j] = math.sqrt(dx * dx + dy * dy)
            _insert(order[i, b], count, distance[b - begin])
        for rank in range(count):
            for b in range(begin, end):
                j = order[i, b, rank]
                others[first + rank, DX, b] = state[b, 0, j] - state[b, 0, i]
                others[first + rank, DY, b] = state[b, 1, j] - state[b, 1, i]
                others[first + rank, DVX, b] = state[b, 2, j] - state[b, 2, i]
                others[first + rank, DVY, b] = state[b, 3, j] - state[b, 3, i]
                others[first + rank, APART, b] = distance[b - begin, j]
                others[first + rank, WHO, b] = j


@part
def _insert(order, count, distance):  # type: ignore[no-untyped-def]
    """Sort by distance, ties by index, by insertion into the last order."""
    for rank in range(1, count):
        j = order[rank]
        own, at = distance[j], rank
        while at > 0:
            before = order[at - 1]
            if not (distance[before] > own or (distance[before] == own and before > j)):
                break
            order[at] = before
            at -= 1
        order[at] = j
