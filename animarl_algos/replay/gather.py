"""From sequences laid end to end in memory to one padded, time-major minibatch."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray

from animarl_algos.replay.batch import SequenceBatch
from animarl_algos.replay.rings import NO_LABEL, Frames, Sequences
from animarl_envs.compiling import jit


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
