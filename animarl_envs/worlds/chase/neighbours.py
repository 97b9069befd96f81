"""What one individual of a chase sees of the others, in order, as loops over copies.

The last individual comes first (unless it is the one that sees): the target, or the pursuer where
one pursues several. Then the many others by distance, ties by index. Few are sorted in all copies
at once, without branches; many in each copy by itself, from their order at the last step, which is
nearly right: the cost per neighbour stays the same. Free animals see their nearest few: nobody is
nearer in the plane than along x, so that of animals in the order of x only a strip is looked at,
as wide as those few are far that were seen at the last step.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from animarl_envs.array_types import Floats
from animarl_envs.compiling import inline_kernel, jit
from animarl_envs.species import ChaseSpecies

DX, DY, DVX, DVY, APART, INDEX = range(6)
FEW = 4  # up to so many are sorted in all copies at once
LINE = 8  # copies that lie in one cache line


class Neighbours(NamedTuple):
    """Scratch of the senses; nothing in it decides anything."""

    others: Floats  # (K - 1, 6, B), of the individual that is looking
    order: NDArray[np.int16] | None  # (K, B, n), the many by distance at the last step
    along: NDArray[np.int16]  # (B, 2, K) of free animals: by x, and at which place each one stands
    state: Floats  # (B, 4, K) for many: x, y and velocity, each copy's in one place
    distance: Floats  # (LINE, K), of each from the one that is looking


def neighbours_of(species: ChaseSpecies, num_copies: int) -> Neighbours:
    """Return scratch for the individuals of a species in so many copies."""
    K, B = species.num_individuals, num_copies
    if species.free:
        seen = species.num_seen
        order = np.zeros((K, B, seen), dtype=np.int16)
        for i in range(K):
            order[i] = [j for j in range(seen + 1) if j != i][:seen]
        sorted_copies = B if seen or species.shoaling_reward else 0
        along = np.broadcast_to(np.arange(K, dtype=np.int16), (sorted_copies, 2, K)).copy()
        state, distance = np.zeros((sorted_copies, 4, K)), np.zeros((LINE, seen))
        return Neighbours(np.zeros((max(1, seen), INDEX + 1, B)), order, along, state, distance)
    along = np.zeros((0, 2, K), dtype=np.int16)
    others = np.zeros((K - 1, INDEX + 1, B))
    if K - 1 <= FEW:
        return Neighbours(others, None, along, np.zeros((0, 4, K)), np.zeros((LINE, K)))
    order = np.zeros((K, B, K - 1), dtype=np.int16)
    for i in range(K):
        order[i, :, : K - 1 - (i < K - 1)] = [j for j in range(K - 1) if j != i]
    return Neighbours(others, order, along, np.zeros((B, 4, K)), np.zeros((LINE, K)))


@inline_kernel
def lay_out(position, velocity, observers, order, state):  # type: ignore[no-untyped-def]
    """Copy each copy's state to one place, where there are many individuals."""
    if order is None:
        return
    if order.shape[2] > 0 and observers.any():
        copy_states(position, velocity, state)


@jit
def copy_states(position, velocity, state):  # type: ignore[no-untyped-def]
    """Copy each copy's positions and velocities to one place."""
    K, _, B = position.shape
    for first in range(0, B, LINE):
        last = min(B, first + LINE)
        for j in range(K):
            for x in range(2):
                for b in range(first, last):
                    state[b, x, j] = position[j, x, b]
                    state[b, 2 + x, j] = velocity[j, x, b]


@inline_kernel
def find_focus(i, position, others):  # type: ignore[no-untyped-def]
    """Fill the first row of ``others``, without velocities: the focus of individual ``i``."""
    last, B = position.shape[0] - 1, position.shape[2]
    if i != last:
        _measure(i, last, DX, APART, position, others)
        return
    _measure(i, 0, DX, APART, position, others)
    for j in range(1, last):  # few arrays in a loop, or the compiler does not vectorise it
        _measure(i, j, DVX, INDEX, position, others)
        for x in range(2):
            for b in range(B):
                nearer = others[0, INDEX, b] < others[0, APART, b]
                kept = others[0, DX + x, b]
                others[0, DX + x, b] = others[0, DVX + x, b] if nearer else kept
        for b in range(B):
            others[0, APART, b] = min(others[0, APART, b], others[0, INDEX, b])


@inline_kernel
def _measure(i, j, offset, apart, position, others):  # type: ignore[no-untyped-def]
    """Write the offset and the distance from individual ``i`` to ``j`` to rows of the first."""
    for x in range(2):
        for b in range(position.shape[2]):
            others[0, offset + x, b] = position[j, x, b] - position[i, x, b]
    for b in range(position.shape[2]):
        dx, dy = others[0, offset, b], others[0, offset + 1, b]
        others[0, apart, b] = math.sqrt(dx * dx + dy * dy)


@inline_kernel
def look(i, position, velocity, order, neighbours):  # type: ignore[no-untyped-def]
    """Fill ``neighbours.others`` with what individual ``i`` sees; return their number."""
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
def line_up(state, along):  # type: ignore[no-untyped-def]
    """Sort the free animals of each copy by x, by insertion into the last order."""
    for b in range(state.shape[0]):
        x, line, places = state[b, 0], along[b, 0], along[b, 1]
        for place in range(1, len(line)):
            j, at = line[place], place
            while at > 0 and x[line[at - 1]] > x[j]:
                line[at] = line[at - 1]
                at -= 1
            line[at] = j
        for place in range(len(line)):
            places[line[place]] = place


@jit
def look_around(i, neighbours):  # type: ignore[no-untyped-def]
    """Fill ``neighbours.others`` with the nearest others, in order; return their number."""
    others, state, along = neighbours.others, neighbours.state, neighbours.along
    best, nearest, B = neighbours.distance, neighbours.order[i], state.shape[0]
    most = nearest.shape[1]
    for begin in range(0, B, LINE):  # each line of ``others`` is written at once
        end = min(B, begin + LINE)
        for b in range(begin, end):
            _select(i, state[b], along[b], best[b - begin], nearest[b])
        for rank in range(most):
            for row in range(4):  # place, then velocity
                for b in range(begin, end):
                    j = nearest[b, rank]
                    others[rank, row, b] = state[b, row, j] - state[b, row, i]
            for b in range(begin, end):
                others[rank, APART, b] = math.sqrt(best[b - begin, rank])
                others[rank, INDEX, b] = nearest[b, rank]
    return most


@inline_kernel
def _select(i, state, along, best, nearest):  # type: ignore[no-untyped-def]
    """Put the nearest others of ``i`` in one copy, in order, into ``who`` and ``best``, squared.

    ``who`` holds those of the last step, which bound how far it is to those of this one.
    """
    line, here, most = along[0], along[1, i], len(nearest)
    x, y = state[0, i], state[1, i]
    for rank in range(most):
        dx, dy = state[0, nearest[rank]] - x, state[1, nearest[rank]] - y
        _place(nearest[rank], dx * dx + dy * dy, rank, best, nearest)
    for side in (-1, 1):
        at = here + side
        while 0 <= at < len(line):
            j = line[at]
            dx, dy = state[0, j] - x, state[1, j] - y
            if dx * dx > best[most - 1]:
                break
            apart, known = dx * dx + dy * dy, False
            if apart <= best[most - 1]:
                for rank in range(most):
                    known |= nearest[rank] == j
                if not known and (apart < best[most - 1] or j < nearest[most - 1]):
                    _place(j, apart, most - 1, best, nearest)
            at += side


@inline_kernel
def _place(j, apart, rank, best, nearest):  # type: ignore[no-untyped-def]
    """Put animal ``j`` at ``rank`` or before, in the order of distance, ties by index."""
    at = rank
    while at > 0 and (best[at - 1] > apart or (best[at - 1] == apart and nearest[at - 1] > j)):
        best[at] = best[at - 1]
        nearest[at] = nearest[at - 1]
        at -= 1
    best[at] = apart
    nearest[at] = j


@inline_kernel
def _relate(i, j, rank, position, velocity, others):  # type: ignore[no-untyped-def]
    """Write position, velocity and distance of ``j`` relative to ``i``, arena frame."""
    for b in range(position.shape[2]):
        dx = position[j, 0, b] - position[i, 0, b]
        dy = position[j, 1, b] - position[i, 1, b]
        others[rank, DX, b] = dx
        others[rank, DY, b] = dy
        others[rank, DVX, b] = velocity[j, 0, b] - velocity[i, 0, b]
        others[rank, DVY, b] = velocity[j, 1, b] - velocity[i, 1, b]
        others[rank, APART, b] = math.sqrt(dx * dx + dy * dy)
        others[rank, INDEX, b] = j


@inline_kernel
def _exchange(rank, others):  # type: ignore[no-untyped-def]
    """Exchange this other individual and the next where this one is the farther."""
    for b in range(others.shape[2]):
        swap = others[rank, APART, b] > others[rank + 1, APART, b]
        for row in range(INDEX + 1):
            one = others[rank, row, b]
            two = others[rank + 1, row, b]
            others[rank, row, b] = two if swap else one
            others[rank + 1, row, b] = one if swap else two


@jit
def _in_each_copy(i, first, count, order, neighbours):  # type: ignore[no-untyped-def]
    """Sort the others of ``i`` from rank ``first`` on, a cache line of copies at a time."""
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
                others[first + rank, INDEX, b] = j


@inline_kernel
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
