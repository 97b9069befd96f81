"""The replay memory's loops: sum trees, staging, moving episodes to the ring, drawing.

Sum trees are for proportional prioritised sampling (Schaul et al. 2016, appendix B.2.1): K trees
side by side, one per individual, in one array ``(K, 2 * leaves)``. The root is node 1, the children
of node i are 2 i and 2 i + 1, leaf ``j`` is node ``leaves + j``; ``leaves`` is a power of two. A
node is always the sum of its two children, computed afresh, so rounding never accumulates and a
tree rebuilt from its leaves is the same to the last bit.
"""

from __future__ import annotations

import numba as nb
import numpy as np
from numpy.typing import NDArray

from animarl_algos.replay.store import (
    EPISODES,
    NEXT,
    NEXT_ROW,
    NO_LABEL,
    OLDEST,
    ROWS_USED,
    sort_by_length,
)
from animarl_envs.compiling import jit
from animarl_envs.worlds.streams import next_uniform


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
def draw_leaves(trees, streams, k, stratified, out):  # type: ignore[no-untyped-def]
    """Fill ``out`` with leaves of tree ``k``, drawn in proportion to their priorities.

    Stratified: one draw from each of ``len(out)`` equal parts of the total priority; otherwise
    independent draws. Random numbers come from ``streams[k]``.
    """
    for b in range(len(out)):
        share = next_uniform(streams, k)
        if stratified:
            share = (b + share) / len(out)
        out[b] = find_leaf(trees, k, share * trees[k, 1])


class SumTrees:
    """K sum trees over ``capacity`` leaves each; ``nodes`` is the array that kernels work on.

    Priorities must be finite and not negative; a leaf of priority zero is never drawn.
    """

    def __init__(self, num_trees: int, capacity: int) -> None:
        self.capacity = capacity
        self.nodes: NDArray[np.float64] = np.zeros(
            (num_trees, self.num_nodes(capacity)), dtype=np.float64
        )

    @staticmethod
    def num_nodes(capacity: int) -> int:
        """Nodes of one tree: twice the next power of two; none for an empty one."""
        return 2 * max(2, 1 << (capacity - 1).bit_length()) if capacity else 0

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


BAD_ACTION, TOO_LONG = -1, -2  # what stage_steps refuses
PRIORITY_FLOOR = 1e-6  # keeps every sequence drawable (Schaul et al. 2016, the small epsilon)


@jit
def _copy_frame(source, i, target, j):  # type: ignore[no-untyped-def]
    _, individuals, size = source.observations.shape
    for k in range(individuals):
        for n in range(size):
            target.observations[j, k, n] = source.observations[i, k, n]
        target.actions[j, k] = source.actions[i, k]
        target.rewards[j, k] = source.rewards[i, k]
        target.penalties[j, k] = source.penalties[i, k]
        target.labels[j, k] = source.labels[i, k]
    target.warmup[j] = source.warmup[i]


@jit
def _evict_oldest(ring):  # type: ignore[no-untyped-def]
    """Forget the oldest episode with all its sequences."""
    sequences, cursor, trees = ring.sequences, ring.cursor, ring.trees
    frames = 0
    while frames == 0:
        slot = cursor[OLDEST] % len(sequences.first)
        if trees.shape[1] > 0:
            for k in range(trees.shape[0]):
                set_leaf(trees, k, slot, 0.0)
        frames = sequences.frames[slot]
        cursor[OLDEST] += 1
    cursor[ROWS_USED] -= frames
    cursor[EPISODES] -= 1


@jit
def _has_trained_step(warmup, begin, end):  # type: ignore[no-untyped-def]
    return not warmup[begin:end].all()


@jit
def _commit(staging, step, copy, ring, alpha, stride, burn_in, max_episodes):  # type: ignore[no-untyped-def]
    """Move the finished episode of a copy from the staging rows to the ring.

    Its trained parts are [0, stride), [stride, 2 stride), ...; those of warm-up steps alone are
    left out, and so is an episode without any other.
    """
    frames, sequences, cursor = ring.frames, ring.sequences, ring.cursor
    staged, steps = staging.frames, staging.step_count[copy]
    base = copy * (len(staged.warmup) // len(staging.step_count))
    wanted = 0
    for begin in range(0, steps, stride):
        if _has_trained_step(staged.warmup, base + begin, base + min(begin + stride, steps)):
            wanted += 1
    if wanted == 0:
        return
    rows, slots = len(frames.warmup), len(sequences.first)
    while (
        cursor[ROWS_USED] + steps + 1 > rows
        or cursor[NEXT] - cursor[OLDEST] + wanted > slots
        or cursor[EPISODES] >= max_episodes
    ):
        _evict_oldest(ring)
    first_row = cursor[NEXT_ROW]
    for t in range(steps + 1):
        _copy_frame(staged, base + t, frames, (first_row + t) % rows)
    cursor[NEXT_ROW] = (first_row + steps + 1) % rows
    cursor[ROWS_USED] += steps + 1
    cursor[EPISODES] += 1
    slot = 0
    for begin in range(0, steps, stride):
        end = min(begin + stride, steps)
        if not _has_trained_step(staged.warmup, base + begin, base + end):
            continue
        slot = cursor[NEXT] % slots
        prefix = min(burn_in, begin)
        sequences.first[slot] = (first_row + begin - prefix) % rows
        sequences.prefix[slot] = prefix
        sequences.trained[slot] = end - begin
        sequences.at_start[slot] = prefix == begin
        sequences.terminated[slot] = step.terminated[copy] and end == steps
        sequences.condition[slot] = step.condition[copy]
        sequences.frames[slot] = 0
        sequences.initial_state[slot] = staging.state[copy, begin // stride]
        if ring.trees.shape[1] > 0:
            for k in range(ring.trees.shape[0]):
                set_leaf(ring.trees, k, slot, ring.max_priority[k] ** alpha)
        cursor[NEXT] += 1
    sequences.frames[slot] = steps + 1


@jit
def stage_steps(staging, step, stride, burn_in, num_actions):  # type: ignore[no-untyped-def]
    """Write one step of every copy into the staging rows; the number of episodes that ended.

    Nothing is written, and ``BAD_ACTION`` or ``TOO_LONG`` returned, if a step does not fit.
    """
    frames = staging.frames
    copies, individuals, size = step.observations.shape
    room = len(frames.warmup) // copies
    for c in range(copies):
        if staging.step_count[c] + 1 >= room:
            return TOO_LONG
        for k in range(individuals):
            if not 0 <= step.actions[c, k] < num_actions:
                return BAD_ACTION
    ended = 0
    for c in range(copies):
        t = staging.step_count[c]
        row = c * room + t
        done = step.terminated[c] or step.truncated[c]
        ended += done
        for k in range(individuals):
            for n in range(size):
                frames.observations[row, k, n] = step.observations[c, k, n]
            frames.actions[row, k] = step.actions[c, k]
            frames.rewards[row, k] = step.rewards[c, k]
            frames.penalties[row, k] = step.penalties[c, k]
            frames.labels[row, k] = step.labels[c, k]
            if done:
                for n in range(size):
                    frames.observations[row + 1, k, n] = step.next_observations[c, k, n]
                frames.actions[row + 1, k] = 0
                frames.rewards[row + 1, k] = 0.0
                frames.penalties[row + 1, k] = 0.0
                frames.labels[row + 1, k] = NO_LABEL
        frames.warmup[row] = step.warmup[c]
        frames.warmup[row + 1] = False
        if staging.state.shape[3] > 0:
            # Pieces whose first step, prefix included, is this one.
            begin, end = 0, burn_in // stride + 1
            if t > 0:
                begin, end = (t + burn_in) // stride, (t + burn_in) // stride + 1
                end = end if (t + burn_in) % stride == 0 else begin
            for piece in range(begin, min(end, staging.state.shape[1])):
                staging.state[c, piece] = step.hidden[c]
        staging.step_count[c] = t + 1
    return ended


@jit
def commit_ended(staging, step, ring, alpha, stride, burn_in, max_episodes):  # type: ignore[no-untyped-def]
    """Move the episodes that ended from staging to the ring, in the order of the copies."""
    for c in range(len(staging.step_count)):
        if step.terminated[c] or step.truncated[c]:
            _commit(staging, step, c, ring, alpha, stride, burn_in, max_episodes)
            staging.step_count[c] = 0


@jit
def choose(ring, streams, beta, stratified, serials, slots, weights):  # type: ignore[no-untyped-def]
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
            draw_leaves(trees, streams, k, stratified, raw)
        else:
            for b in range(columns):
                share = next_uniform(streams, k)
                share = (b + share) / columns if stratified else share
                raw[b] = (oldest + min(np.int64(share * num), num - 1)) % num_slots
        sort_by_length(sequences, raw, order)
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
