"""The replay memory's inner loops: adding steps, evicting episodes, choosing sequences.

Frames form a ring of rows, sequences a ring of slots. Sequences are numbered by a serial number
that never repeats; the slot is the serial number modulo the number of slots, so a number held from
an earlier draw still says whether its sequence has been evicted since.
"""

from __future__ import annotations

import numba as nb
import numpy as np

from animarl_algos.recurrent.gather import NO_LABEL, sort_by_length
from animarl_algos.recurrent.sum_tree import find_leaf, set_leaf
from animarl_envs.worlds.streams import next_uniform

# Entries of the cursor, the (5,) int64 array that says where the rings stand.
OLDEST, NEXT, NEXT_ROW, ROWS_USED, EPISODES = 0, 1, 2, 3, 4
BAD_ACTION, TOO_LONG = -1, -2  # what stage_steps refuses
PRIORITY_FLOOR = 1e-6  # keeps every sequence drawable (Schaul et al. 2016, the small epsilon)


@nb.njit(cache=True)
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


@nb.njit(cache=True)
def _evict_oldest(sequences, cursor, trees):  # type: ignore[no-untyped-def]
    """Forget the oldest episode with all its sequences."""
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


@nb.njit(cache=True)
def _has_trained_step(warmup, begin, end):  # type: ignore[no-untyped-def]
    return not warmup[begin:end].all()


@nb.njit(cache=True)
def _commit(  # type: ignore[no-untyped-def]
    staging, base, steps, terminated, condition, staged_state,
    ring, sequences, cursor, trees, max_priority, alpha, stride, burn_in, max_episodes,
):  # fmt: skip
    """Move a finished episode of ``steps`` steps from the staging rows to the ring.

    Its trained parts are [0, stride), [stride, 2 stride), ...; those of warm-up steps alone are
    left out, and so is an episode without any other.
    """
    wanted = 0
    for begin in range(0, steps, stride):
        if _has_trained_step(staging.warmup, base + begin, base + min(begin + stride, steps)):
            wanted += 1
    if wanted == 0:
        return
    rows, slots = len(ring.warmup), len(sequences.first)
    while (
        cursor[ROWS_USED] + steps + 1 > rows
        or cursor[NEXT] - cursor[OLDEST] + wanted > slots
        or cursor[EPISODES] >= max_episodes
    ):
        _evict_oldest(sequences, cursor, trees)
    first_row = cursor[NEXT_ROW]
    for t in range(steps + 1):
        _copy_frame(staging, base + t, ring, (first_row + t) % rows)
    cursor[NEXT_ROW] = (first_row + steps + 1) % rows
    cursor[ROWS_USED] += steps + 1
    cursor[EPISODES] += 1
    slot = 0
    for begin in range(0, steps, stride):
        end = min(begin + stride, steps)
        if not _has_trained_step(staging.warmup, base + begin, base + end):
            continue
        slot = cursor[NEXT] % slots
        prefix = min(burn_in, begin)
        sequences.first[slot] = (first_row + begin - prefix) % rows
        sequences.prefix[slot] = prefix
        sequences.trained[slot] = end - begin
        sequences.at_start[slot] = prefix == begin
        sequences.terminated[slot] = terminated and end == steps
        sequences.condition[slot] = condition
        sequences.frames[slot] = 0
        for k in range(staged_state.shape[1]):
            for i in range(staged_state.shape[2]):
                sequences.initial_state[slot, k, i] = staged_state[begin // stride, k, i]
        if trees.shape[1] > 0:
            for k in range(trees.shape[0]):
                set_leaf(trees, k, slot, max_priority[k] ** alpha)
        cursor[NEXT] += 1
    sequences.frames[slot] = steps + 1


@nb.njit(cache=True)
def stage_steps(  # type: ignore[no-untyped-def]
    staging, step_count, staged_state, stride, burn_in, num_actions,
    observations, actions, rewards, next_observations, terminated, truncated,
    penalties, labels, warmup, hidden,
):  # fmt: skip
    """Write one step of every copy into the staging rows; the number of episodes that ended.

    Nothing is written, and ``BAD_ACTION`` or ``TOO_LONG`` returned, if a step does not fit.
    """
    copies, individuals, size = observations.shape
    room = len(staging.warmup) // copies
    for c in range(copies):
        if step_count[c] + 1 >= room:
            return TOO_LONG
        for k in range(individuals):
            if not 0 <= actions[c, k] < num_actions:
                return BAD_ACTION
    ended = 0
    for c in range(copies):
        t = step_count[c]
        row = c * room + t
        done = terminated[c] or truncated[c]
        ended += done
        for k in range(individuals):
            for n in range(size):
                staging.observations[row, k, n] = observations[c, k, n]
            staging.actions[row, k] = actions[c, k]
            staging.rewards[row, k] = rewards[c, k]
            staging.penalties[row, k] = penalties[c, k]
            staging.labels[row, k] = labels[c, k]
            if done:
                for n in range(size):
                    staging.observations[row + 1, k, n] = next_observations[c, k, n]
                staging.actions[row + 1, k] = 0
                staging.rewards[row + 1, k] = 0.0
                staging.penalties[row + 1, k] = 0.0
                staging.labels[row + 1, k] = NO_LABEL
        staging.warmup[row] = warmup[c]
        staging.warmup[row + 1] = False
        if staged_state.shape[3] > 0:
            # Pieces whose first step, prefix included, is this one.
            begin, end = 0, burn_in // stride + 1
            if t > 0:
                begin, end = (t + burn_in) // stride, (t + burn_in) // stride + 1
                end = end if (t + burn_in) % stride == 0 else begin
            for piece in range(begin, min(end, staged_state.shape[1])):
                staged_state[c, piece] = hidden[c]
        step_count[c] = t + 1
    return ended


@nb.njit(cache=True)
def commit_ended(  # type: ignore[no-untyped-def]
    staging, step_count, staged_state,
    ring, sequences, cursor, trees, max_priority, alpha, stride, burn_in, max_episodes,
    terminated, truncated, condition,
):  # fmt: skip
    """Move the episodes that ended from staging to the ring, in the order of the copies."""
    copies = len(step_count)
    room = len(staging.warmup) // copies
    for c in range(copies):
        if terminated[c] or truncated[c]:
            _commit(
                staging, c * room, step_count[c], terminated[c], condition[c], staged_state[c],
                ring, sequences, cursor, trees, max_priority, alpha, stride, burn_in, max_episodes,
            )  # fmt: skip
            step_count[c] = 0


@nb.njit(cache=True)
def choose(  # type: ignore[no-untyped-def]
    trees, streams, cursor, sequences, beta, stratified, serials, slots, weights, order, raw
):
    """Draw B sequences for each of K individuals, sorted by decreasing length.

    Individual k draws from its own priorities with its own stream: P(i) = p_i / sum p, and
    w_i = (N P(i))^-beta, divided by the largest of its batch. Without trees: uniform, weights 1.
    ``serials``, ``slots``, ``weights`` are ``(K, B)``; ``order``, ``raw`` are work space ``(B,)``.
    """
    oldest, num = cursor[OLDEST], cursor[NEXT] - cursor[OLDEST]
    num_slots = len(sequences.first)
    columns = len(order)
    for k in range(len(streams)):
        for b in range(columns):
            share = next_uniform(streams, k)
            if stratified:
                share = (b + share) / columns
            if trees.shape[1] > 0:
                raw[b] = find_leaf(trees, k, share * trees[k, 1])
            else:
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


@nb.njit(cache=True)
def update_priorities(trees, cursor, num_slots, max_priority, alpha, serials, errors):  # type: ignore[no-untyped-def]
    """Set p_i = (|error_i| + floor)^alpha; sequences evicted since the draw are passed over."""
    for k in range(serials.shape[0]):
        for b in range(serials.shape[1]):
            if cursor[OLDEST] <= serials[k, b] < cursor[NEXT]:
                priority = abs(errors[k, b]) + PRIORITY_FLOOR
                max_priority[k] = max(max_priority[k], priority)
                set_leaf(trees, k, serials[k, b] % num_slots, priority**alpha)
