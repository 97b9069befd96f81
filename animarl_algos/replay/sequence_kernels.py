"""The replay memory's loops: sum trees, staging, moving episodes to the ring, drawing.

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

from animarl_algos.replay.store import NO_LABEL, Frames, Sequences
from animarl_envs.compiling import jit
from animarl_envs.worlds.streams import next_uniform

# Entries of a ring's cursor.
OLDEST, NEXT, NEXT_ROW, ROWS_USED, EPISODES = 0, 1, 2, 3, 4
BAD_ACTION, TOO_LONG = -1, -2  # what stage_steps refuses
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
    def used_rows(self) -> NDArray[np.int64]:
        """Rows that hold steps of running episodes."""
        room = len(self.frames.warmup) // len(self.step_count)
        used = [copy * room + np.arange(steps) for copy, steps in enumerate(self.step_count)]
        return np.concatenate(used)


class Step(NamedTuple):
    """One step of every copy."""

    observations: NDArray[np.float32]  # (copies, K, n)
    actions: NDArray[np.int64]  # (copies, K)
    rewards: NDArray[np.float32]  # (copies, K)
    next_observations: NDArray[np.float32]  # (copies, K, n)
    terminated: NDArray[np.bool_]  # (copies,)
    truncated: NDArray[np.bool_]  # (copies,)
    penalties: NDArray[np.float32]  # (copies, K)
    labels: NDArray[np.int64]  # (copies, K)
    warmup: NDArray[np.bool_]  # (copies,)
    hidden: NDArray[np.float32]  # (copies, K, H)
    condition: NDArray[np.float32]  # (copies,)


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
def _copy_frame(source, i, target, j):  # type: ignore[no-untyped-def]
    target.observations[j] = source.observations[i]
    target.actions[j] = source.actions[i]
    target.rewards[j] = source.rewards[i]
    target.penalties[j] = source.penalties[i]
    target.labels[j] = source.labels[i]
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
        if not staged.warmup[base + begin : base + min(begin + stride, steps)].all():
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
        if staged.warmup[base + begin : base + end].all():
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
    copies, individuals, _ = step.observations.shape
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
        _copy_frame(step, c, frames, row)
        if done:
            frames.observations[row + 1] = step.next_observations[c]
            frames.actions[row + 1] = 0
            frames.rewards[row + 1] = 0.0
            frames.penalties[row + 1] = 0.0
            frames.labels[row + 1] = NO_LABEL
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
