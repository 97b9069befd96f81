"""Sequences of steps in memory, recorded or experienced, and padded minibatches made of them.

Frames are rows, laid episode after episode; sequences (episodes or pieces of them) say where they
lie among the frames. The replay memory holds both in rings: sequences are numbered by a serial
number that never repeats, and the slot is the serial number modulo the number of slots, so that a
number held from an earlier draw still says whether its sequence has been evicted since.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray

from animarl_envs.compiling import jit

# Entries of a ring's cursor.
OLDEST, NEXT, NEXT_ROW, ROWS_USED, EPISODES = 0, 1, 2, 3, 4
NO_LABEL = -1


Layout = dict[str, tuple[Any, tuple[int, ...]]]
"""Type and shape of one row of each array."""


def frame_layout(num_individuals: int, observation_dim: int) -> Layout:
    """Return the layout of :class:`Frames`."""
    each = (num_individuals,)
    return {
        "observations": (np.float32, (*each, observation_dim)),
        "actions": (np.int16, each),
        "rewards": (np.float32, each),
        "penalties": (np.float32, each),
        "labels": (np.int16, each),
        "warmup": (np.bool_, ()),
    }


def sequence_layout(num_individuals: int, state_size: int) -> Layout:
    """Return the layout of :class:`Sequences`."""
    return {
        **dict.fromkeys(("first", "prefix", "trained"), (np.int64, ())),
        **dict.fromkeys(("at_start", "terminated"), (np.bool_, ())),
        "condition": (np.float32, ()),
        "frames": (np.int64, ()),
        "initial_state": (np.float32, (num_individuals, state_size)),
    }


def bytes_of_row(layout: Layout) -> int:
    """Return the bytes of one row of all arrays together."""
    return sum(np.dtype(dtype).itemsize * math.prod(shape) for dtype, shape in layout.values())


def zeros(layout: Layout, rows: int) -> dict[str, NDArray[Any]]:
    """Allocate so many rows of each array."""
    return {name: np.zeros((rows, *shape), dtype) for name, (dtype, shape) in layout.items()}


class Frames(NamedTuple):
    """Data of each frame, one row each; an episode of T steps fills T + 1 rows in order.

    Row t holds the observation at t and the step taken from it; the last row only an observation.
    """

    observations: NDArray[np.float32]  # (rows, K, n)
    actions: NDArray[np.int16]  # (rows, K)
    rewards: NDArray[np.float32]  # (rows, K)
    penalties: NDArray[np.float32]  # (rows, K)
    labels: NDArray[np.int16]  # (rows, K), NO_LABEL: none
    warmup: NDArray[np.bool_]  # (rows,), the step is replayed, not chosen

    @classmethod
    def allocate(cls, rows: int, num_individuals: int, observation_dim: int) -> Frames:
        """Return rows of zeros without labels."""
        frames = cls(**zeros(frame_layout(num_individuals, observation_dim), rows))
        frames.labels[:] = NO_LABEL
        return frames


class Sequences(NamedTuple):
    """Where each sequence (an episode or a piece of one) lies among the frames, one slot each."""

    first: NDArray[np.int64]  # (slots,), row of its first step, prefix included
    prefix: NDArray[np.int64]  # (slots,), burn-in steps
    trained: NDArray[np.int64]  # (slots,), steps after the prefix
    at_start: NDArray[np.bool_]  # (slots,), the first step is its episode's first
    terminated: NDArray[np.bool_]  # (slots,), the last step terminated the episode
    condition: NDArray[np.float32]  # (slots,)
    frames: NDArray[np.int64]  # (slots,), rows of the episode, at its last sequence; else 0
    initial_state: NDArray[np.float32]  # (slots, K, H), state before the first step; H may be 0


class Ring(NamedTuple):
    """Finished episodes."""

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


@dataclass
class SequenceBatch:
    """Sequences of K individuals, each with its own draw of B columns.

    Axes are named in this order: individual K, time T, batch B, feature. A *column* is one episode
    or one piece of it. The steps of column ``b`` lie at ``starts[k, b] <= t < lengths[k, b]``, its
    observations at ``starts[k, b] <= t <= lengths[k, b]``; everything else is padding (zeros,
    ``previous_actions`` ``num_actions``, ``labels`` -1). T is the largest length.

    Steps ``t < burn_in`` only rebuild the recurrent state, without gradient; those from ``burn_in``
    on are trained. A column whose prefix is shorter than ``burn_in`` (it lies near its episode's
    start) begins at ``starts[k, b] > 0``: before that its state is held at the initial one. For
    whole episodes ``burn_in`` and all ``starts`` are zero.

    Columns are sorted by decreasing length, individual by individual, so that at time t only the
    first ``active[t]`` columns need computing.

    Attributes
    ----------
    observations
        ``(K, T + 1, B, n)`` float32. The last one of a column is the true successor of its last
        step (the terminal observation where an episode ended).
    previous_actions
        ``(K, T + 1, B)`` int64, the action before each observation; ``num_actions`` (none) at an
        episode's start.
    actions
        ``(K, T, B)`` int64.
    rewards
        ``(K, T, B)`` float32, task reward.
    penalties
        ``(K, T, B)`` float32, DTW penalty, to be subtracted with a recipe's weight.
    terminated
        ``(K, T, B)`` float32, 1 where nothing follows. A time-out is not terminated: it bootstraps.
    mask
        ``(K, T, B)`` float32, 1 where the step enters a loss: neither padding, burn-in nor warm-up.
    weights
        ``(K, B)`` float32, importance weights, at most 1.
    starts, lengths
        ``(K, B)`` int64.
    indices
        ``(K, B)`` int64 NumPy array: which sequences these are, for
        ``SequenceReplayBuffer.update_priorities``.
    labels
        ``(K, T, B)`` int64, demonstrated action aligned with the step, -1 where there is none.
    condition
        ``(K, B)`` float32, experimental condition of the column's episode, 0 or 1.
    active
        ``(T + 1,)`` int64 NumPy array: the number of columns that still have an observation at t,
        the maximum over individuals.
    burn_in
        Leading steps whose states are recomputed without gradient.
    initial_state
        ``(K, B, H)`` float32, the recurrent state before the step at ``starts``; ``None``: zeros.
    action_penalties
        ``(K, T, B, num_actions)`` float32, penalty that each action would have earned; only from
        demonstrations.
    label_shares
        ``(K, T, B, num_actions)`` float32, soft labels: the probability of each action; only from
        demonstrations with soft labels.
    """

    observations: torch.Tensor
    previous_actions: torch.Tensor
    actions: torch.Tensor
    rewards: torch.Tensor
    penalties: torch.Tensor
    terminated: torch.Tensor
    mask: torch.Tensor
    weights: torch.Tensor
    starts: torch.Tensor
    lengths: torch.Tensor
    indices: NDArray[np.int64]
    labels: torch.Tensor
    condition: torch.Tensor
    active: NDArray[np.int64]
    burn_in: int = 0
    initial_state: torch.Tensor | None = None
    action_penalties: torch.Tensor | None = None
    label_shares: torch.Tensor | None = None

    @property
    def num_individuals(self) -> int:
        return self.actions.shape[0]

    @property
    def num_steps(self) -> int:
        """T, the padded length."""
        return self.actions.shape[1]

    @property
    def batch_size(self) -> int:
        return self.actions.shape[2]

    def to(self, device: torch.device | str) -> SequenceBatch:
        """Return the batch on ``device``; ``indices`` and ``active`` stay NumPy arrays."""
        return self._map(lambda tensor: tensor.to(device))

    def clone(self) -> SequenceBatch:
        """A copy that outlives the next ``sample`` of the buffer it came from."""
        copy = self._map(torch.clone)
        copy.indices, copy.active = self.indices.copy(), self.active.copy()
        return copy

    def _map(self, function: Callable[[torch.Tensor], torch.Tensor]) -> SequenceBatch:
        changed: dict[str, Any] = {
            field.name: function(value)
            for field in dataclasses.fields(self)
            if isinstance(value := getattr(self, field.name), torch.Tensor)
        }
        return dataclasses.replace(self, **changed)


class BatchArrays(NamedTuple):
    """The arrays of a :class:`SequenceBatch` that the gathering kernel fills."""

    observations: NDArray[np.float32]
    previous_actions: NDArray[np.int64]
    actions: NDArray[np.int64]
    rewards: NDArray[np.float32]
    penalties: NDArray[np.float32]
    terminated: NDArray[np.float32]
    mask: NDArray[np.float32]
    starts: NDArray[np.int64]
    lengths: NDArray[np.int64]
    labels: NDArray[np.int64]
    condition: NDArray[np.float32]
    initial_state: NDArray[np.float32]
    action_penalties: NDArray[np.float32]


@jit
def sort_by_length(sequences, slots, order):  # type: ignore[no-untyped-def]
    """Order of ``slots`` ``(B,)`` by decreasing trained length; equal ones keep their order."""
    for b in range(len(slots)):
        length = sequences.trained[slots[b]]
        place = b
        while place > 0 and sequences.trained[slots[order[place - 1]]] < length:
            order[place] = order[place - 1]
            place -= 1
        order[place] = b


@jit
def extent(sequences, slots):  # type: ignore[no-untyped-def]
    """Longest prefix and longest trained part among ``slots`` ``(K, B)``."""
    burn_in, trained = 0, 0
    for k in range(slots.shape[0]):
        for b in range(slots.shape[1]):
            burn_in = max(burn_in, sequences.prefix[slots[k, b]])
            trained = max(trained, sequences.trained[slots[k, b]])
    return burn_in, trained


@jit
def gather(frames, action_penalties, sequences, slots, burn_in, no_action, out, active):  # type: ignore[no-untyped-def]
    """Copy the sequences in ``slots`` ``(K, B)`` into ``out``, padded and aligned.

    Trained parts begin at time ``burn_in`` in all columns; shorter prefixes are padded before.
    """
    rows, _, size = frames.observations.shape
    individuals, steps, columns = out.actions.shape
    num_scored = action_penalties.shape[2]
    active[:] = 0
    for k in range(individuals):
        for b in range(columns):
            slot = slots[k, b]
            start = burn_in - sequences.prefix[slot]
            end = burn_in + sequences.trained[slot]
            out.starts[k, b] = start
            out.lengths[k, b] = end
            out.condition[k, b] = sequences.condition[slot]
            for i in range(sequences.initial_state.shape[2]):
                out.initial_state[k, b, i] = sequences.initial_state[slot, k, i]
            for t in range(end + 1):
                active[t] = max(active[t], b + 1)
            row = sequences.first[slot]
            previous = no_action
            if not sequences.at_start[slot]:
                previous = np.int64(frames.actions[row - 1 if row > 0 else rows - 1, k])
            for t in range(steps + 1):
                if t < start or t > end:
                    for i in range(size):
                        out.observations[k, t, b, i] = 0.0
                    out.previous_actions[k, t, b] = no_action
                else:
                    for i in range(size):
                        out.observations[k, t, b, i] = frames.observations[row, k, i]
                    out.previous_actions[k, t, b] = previous
                if t < start or (end <= t < steps):
                    out.actions[k, t, b] = 0
                    out.rewards[k, t, b] = 0.0
                    out.penalties[k, t, b] = 0.0
                    out.terminated[k, t, b] = 0.0
                    out.mask[k, t, b] = 0.0
                    out.labels[k, t, b] = NO_LABEL
                    for i in range(num_scored):
                        out.action_penalties[k, t, b, i] = 0.0
                elif t < end:
                    previous = np.int64(frames.actions[row, k])
                    out.actions[k, t, b] = previous
                    out.rewards[k, t, b] = frames.rewards[row, k]
                    out.penalties[k, t, b] = frames.penalties[row, k]
                    out.terminated[k, t, b] = t == end - 1 and sequences.terminated[slot]
                    out.mask[k, t, b] = t >= burn_in and not frames.warmup[row]
                    out.labels[k, t, b] = frames.labels[row, k]
                    for i in range(num_scored):
                        out.action_penalties[k, t, b, i] = action_penalties[row, k, i]
                    row = row + 1 if row + 1 < rows else 0


class BatchBuffers:
    """Memory for minibatches, allocated once and filled again by every draw.

    A batch made here is overwritten by the next one: ``clone`` it to keep it.
    """

    def __init__(
        self,
        num_individuals: int,
        observation_dim: int,
        num_actions: int,
        state_size: int,
        num_scored: int,
        *,
        pinned: bool,
    ) -> None:
        self._individuals = num_individuals
        self._dim = observation_dim
        self._num_actions = num_actions
        self._state_size = state_size
        self._num_scored = num_scored
        self._pinned = pinned
        self._memory: dict[str, torch.Tensor] = {}
        self._views: tuple[tuple[int, int], dict[str, torch.Tensor], BatchArrays] | None = None

    @property
    def nbytes(self) -> int:
        """Bytes allocated so far."""
        return sum(tensor.nbytes for tensor in self._memory.values())

    def fill(
        self,
        frames: Frames,
        action_penalties: NDArray[np.float32],
        sequences: Sequences,
        slots: NDArray[np.int64],
        indices: NDArray[np.int64],
        weights: NDArray[np.float32],
    ) -> SequenceBatch:
        """The batch of the sequences in ``slots`` ``(K, B)``, sorted by decreasing length."""
        burn_in, trained = extent(sequences, slots)
        steps = burn_in + trained
        named, arrays = self._shaped(steps, slots.shape[1])
        tensors = dict(named)
        active = np.empty(steps + 1, dtype=np.int64)
        gather(
            frames, action_penalties, sequences, slots, burn_in, self._num_actions, arrays, active
        )
        initial_state, scored = tensors.pop("initial_state"), tensors.pop("action_penalties")
        return SequenceBatch(
            **tensors,
            weights=torch.from_numpy(weights),
            indices=indices,
            active=active,
            burn_in=int(burn_in),
            initial_state=initial_state if self._state_size else None,
            action_penalties=scored if self._num_scored else None,
        )

    def _shaped(self, steps: int, columns: int) -> tuple[dict[str, torch.Tensor], BatchArrays]:
        """The memory as tensors of this size, and the same as arrays; kept for the next time."""
        if self._views is not None and self._views[0] == (steps, columns):
            return self._views[1:]
        k = self._individuals
        each, plus = (k, steps, columns), (k, steps + 1, columns)
        shapes: dict[str, tuple[tuple[int, ...], torch.dtype]] = {
            "observations": ((*plus, self._dim), torch.float32),
            "previous_actions": (plus, torch.int64),
            "actions": (each, torch.int64),
            "rewards": (each, torch.float32),
            "penalties": (each, torch.float32),
            "terminated": (each, torch.float32),
            "mask": (each, torch.float32),
            "starts": ((k, columns), torch.int64),
            "lengths": ((k, columns), torch.int64),
            "labels": (each, torch.int64),
            "condition": ((k, columns), torch.float32),
            "initial_state": ((k, columns, self._state_size), torch.float32),
            "action_penalties": ((*each, self._num_scored), torch.float32),
        }
        tensors = {name: self._tensor(name, *shape) for name, shape in shapes.items()}
        arrays = BatchArrays(**{name: tensor.numpy() for name, tensor in tensors.items()})
        self._views = ((steps, columns), tensors, arrays)
        return tensors, arrays

    def _tensor(self, name: str, shape: tuple[int, ...], dtype: torch.dtype) -> torch.Tensor:
        """A contiguous tensor at the front of the memory called ``name``, which grows if needed."""
        size = math.prod(shape)
        memory = self._memory.get(name)
        if memory is None or memory.numel() < size:
            memory = torch.empty(size, dtype=dtype, pin_memory=self._pinned)
            self._memory[name] = memory
        return memory[:size].view(shape)
