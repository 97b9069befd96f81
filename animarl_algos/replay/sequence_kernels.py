"""The replay memory's arrays, and its compiled loops: sum trees and drawing from them.

Sum trees are for proportional prioritised sampling (Schaul et al. 2016, appendix B.2.1): K trees
side by side, one per individual, in one array ``(K, 2 * leaves)``. The root is node 1, the children
of node i are 2 i and 2 i + 1, leaf ``j`` is node ``leaves + j``; ``leaves`` is a power of two. A
node is always the sum of its two children, computed afresh, so rounding never accumulates and a
tree rebuilt from its leaves is the same to the last bit.
"""

from typing import NamedTuple

import numba as nb
import numpy as np
from numpy.typing import NDArray

from animarl_algos.replay.store import Frames, Sequences
from animarl_envs.compiling import jit
from animarl_envs.worlds.streams import next_uniform

# Entries of a ring's cursor.
OLDEST, NEXT, NEXT_ROW, ROWS_USED, EPISODES = 0, 1, 2, 3, 4
PRIORITY_FLOOR = 1e-6  # keeps every sequence drawable (Schaul et al. 2016, the small epsilon)


class Ring(NamedTuple):
    """Finished episodes.

    Sequences are numbered by a serial number that never repeats, and the slot is the serial number
    modulo the number of slots, so that a number held from an earlier draw still says whether its
    sequence has been evicted since.
    """

    frames: Frames
    sequences: Sequences
    cursor: NDArray[np.int64]  # (5,), serial numbers of the oldest and the next sequence, next row
    trees: NDArray[np.float64]  # (K, nodes), priorities as sum trees; no node: drawn uniformly
    max_priority: NDArray[np.float64]  # (K,), the largest so far, before the exponent

    @property
    def used_rows(self) -> NDArray[np.int64]:
        """Rows in use, from the oldest episode's first on."""
        used, end = self.cursor[ROWS_USED], self.cursor[NEXT_ROW]
        return np.asarray(np.arange(end - used, end) % len(self.frames.warmup))

    @property
    def used_slots(self) -> NDArray[np.int64]:
        """Slots in use, from the oldest sequence on."""
        slots = np.arange(self.cursor[OLDEST], self.cursor[NEXT]) % len(self.sequences.first)
        return np.asarray(slots)


class Staging(NamedTuple):
    """Running episodes, one per copy of the world, each with as many rows as the longest needs."""

    frames: Frames
    step_count: NDArray[np.int64]  # (copies,)
    state: NDArray[np.float32]  # (copies, pieces, K, H), recurrent state before each piece

    @property
    def first_rows(self) -> NDArray[np.int64]:
        """Row of the first step of each copy."""
        return np.arange(0, len(self.frames.warmup), len(self.frames.warmup) // len(self.state))

    @property
    def used_rows(self) -> NDArray[np.int64]:
        """Rows that hold steps of running episodes."""
        steps = zip(self.first_rows, self.step_count)
        return np.concatenate([first + np.arange(count) for first, count in steps])


@nb.njit(inline="always")
def set_leaf(trees, k, leaf, value):  # type: ignore[no-untyped-def]
    """Give leaf ``leaf`` of tree ``k`` the priority ``value``."""
    node = trees.shape[1] // 2 + leaf
    trees[k, node] = value
    while node > 1:
        node //= 2
        trees[k, node] = trees[k, 2 * node] + trees[k, 2 * node + 1]


@nb.njit(inline="always")
def find_leaf(trees, k, mass):  # type: ignore[no-untyped-def]
    """The leaf of tree ``k`` in whose share of the cumulative priority ``mass`` lies.

    A branch without priority is never entered, whatever the rounding of ``mass``.
    """
    leaves = trees.shape[1] // 2
    node = 1
    while node < leaves:
        node *= 2
        if mass >= trees[k, node] and trees[k, node + 1] > 0.0:
            mass -= trees[k, node]
            node += 1
    return node - leaves


@jit
def draw_leaves(trees, streams, k, out):  # type: ignore[no-untyped-def]
    """Fill ``out`` with leaves of tree ``k``, drawn in proportion to their priorities.

    One from each of ``len(out)`` equal parts of the total priority, by ``streams[k]``.
    """
    for b in range(len(out)):
        share = (b + next_uniform(streams, k)) / len(out)
        out[b] = find_leaf(trees, k, share * trees[k, 1])


class SumTrees:
    """K sum trees over ``capacity`` leaves each; ``nodes`` is the array that kernels work on.

    Priorities must be finite and not negative; a leaf of priority zero is never drawn.
    """

    def __init__(self, num_trees: int, capacity: int) -> None:
        self.capacity = capacity
        # Of one tree twice the next power of two, and none of an empty one.
        nodes = 2 * max(2, 1 << (capacity - 1).bit_length()) if capacity else 0
        self.nodes: NDArray[np.float64] = np.zeros((num_trees, nodes), dtype=np.float64)

    @property
    def priorities(self) -> NDArray[np.float64]:
        """Priorities of all leaves, ``(K, capacity)``, a view."""
        first = self.nodes.shape[1] // 2
        return self.nodes[:, first : first + self.capacity]

    def restore(self, leaves: NDArray[np.int64], priorities: NDArray[np.float64]) -> None:
        """Make all trees anew: ``leaves`` get ``priorities`` ``(K, len(leaves))``, others zero."""
        half = self.nodes.shape[1] // 2
        self.nodes[:] = 0.0
        self.nodes[:, half + leaves] = priorities
        while half > 1:
            half //= 2
            below = self.nodes[:, 2 * half : 4 * half]
            self.nodes[:, half : 2 * half] = below[:, 0::2] + below[:, 1::2]


@jit
def set_leaves(trees, leaves, values):  # type: ignore[no-untyped-def]
    """Give each of ``leaves`` of every tree k the priority ``values[k]``."""
    for k in range(len(trees)):
        for leaf in leaves:
            set_leaf(trees, k, leaf, values[k])


@jit
def _sort_by_length(sequences, slots, order):  # type: ignore[no-untyped-def]
    """Order of ``slots`` ``(B,)`` by decreasing trained length; equal ones keep their order."""
    for b in range(len(slots)):
        length = sequences.trained[slots[b]]
        place = b
        while place > 0 and sequences.trained[slots[order[place - 1]]] < length:
            order[place] = order[place - 1]
            place -= 1
        order[place] = b


@jit
def choose(ring, streams, beta, serials, slots, weights):  # type: ignore[no-untyped-def]
    """Draw B sequences for each of K individuals, sorted by decreasing length.

    Individual k draws from its own priorities with its own stream: P(i) = p_i / sum p, and
    w_i = (N P(i))^-beta, divided by the largest of its batch. Without trees: uniform, weights 1.
    Fills ``serials``, ``slots``, ``weights``, all ``(K, B)``.
    """
    trees, cursor, sequences = ring.trees, ring.cursor, ring.sequences
    oldest, num = cursor[OLDEST], cursor[NEXT] - cursor[OLDEST]
    num_slots = len(sequences.first)
    columns = serials.shape[1]
    order, raw = np.empty(columns, dtype=np.int64), np.empty(columns, dtype=np.int64)
    for k in range(len(streams)):
        if trees.shape[1] > 0:
            draw_leaves(trees, streams, k, raw)
        else:
            for b in range(columns):
                share = (b + next_uniform(streams, k)) / columns
                raw[b] = (oldest + min(np.int64(share * num), num - 1)) % num_slots
        _sort_by_length(sequences, raw, order)
        largest = 0.0
        for b in range(columns):
            slot = raw[order[b]]
            slots[k, b] = slot
            serials[k, b] = oldest + (slot - oldest) % num_slots
            weight = 1.0
            if trees.shape[1] > 0:
                priority = trees[k, trees.shape[1] // 2 + slot]
                weight = (num * priority / trees[k, 1]) ** -beta
            weights[k, b] = weight
            largest = max(largest, weight)
        for b in range(columns):
            weights[k, b] /= largest


@jit
def update_priorities(ring, alpha, serials, errors):  # type: ignore[no-untyped-def]
    """Set p_i = (|error_i| + floor)^alpha; sequences evicted since the draw are passed over."""
    cursor, num_slots = ring.cursor, len(ring.sequences.first)
    for k in range(serials.shape[0]):
        for b in range(serials.shape[1]):
            if cursor[OLDEST] <= serials[k, b] < cursor[NEXT]:
                priority = abs(errors[k, b]) + PRIORITY_FLOOR
                ring.max_priority[k] = max(ring.max_priority[k], priority)
                set_leaf(ring.trees, k, serials[k, b] % num_slots, priority**alpha)
