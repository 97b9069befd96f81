"""Sequences of steps in memory, recorded or experienced, and padded minibatches made of them.

Frames are rows, laid episode after episode; sequences (episodes or pieces of them) say where they
lie among the frames.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray

from animarl_envs.array_types import Bools, Ints
from animarl_envs.compiling import jit

NO_LABEL = -1


class Frames(NamedTuple):
    """Data of each frame, one row each; an episode of T steps fills T + 1 rows in order.

    Row t holds the observation at t and the step taken from it; the last row only an observation.
    """

    observations: NDArray[np.float32]  # (rows, K, n)
    actions: NDArray[np.int16]  # (rows, K)
    rewards: NDArray[np.float32]  # (rows, K)
    penalties: NDArray[np.float32]  # (rows, K)
    labels: NDArray[np.int16]  # (rows, K), NO_LABEL: none
    warmup: Bools  # (rows,), the step is replayed, not chosen
    # Of each action, (rows, K, actions); of experienced steps there are none: (rows, K, 0).
    action_penalties: NDArray[np.float32]
    label_shares: NDArray[np.float32]  # soft labels

    @classmethod
    def zeros(cls, rows: int, individuals: int, size: int) -> Frames:
        """Return frames of zeros, their memory still untouched."""
        each = (rows, individuals)
        return cls(
            *(np.zeros((*each, size), np.float32), np.zeros(each, np.int16)),
            *(np.zeros(each, np.float32), np.zeros(each, np.float32)),
            *(np.zeros(each, np.int16), np.zeros(rows, np.bool_)),
            *(np.zeros((*each, 0), np.float32), np.zeros((*each, 0), np.float32)),
        )

    def write(self, rows: Ints, step: Mapping[str, Any]) -> None:
        """Fill ``rows``; what ``step`` leaves out or has as None is zero, labels ``NO_LABEL``."""
        for name, array in self._asdict().items():
            value = step.get(name)
            if value is None:
                array[rows] = NO_LABEL if name == "labels" else 0
            else:
                array[rows] = np.reshape(value, (len(rows), *array.shape[1:]))


class Sequences(NamedTuple):
    """Where each sequence (an episode or a piece of one) lies among the frames, one slot each."""

    first: Ints  # (slots,), row of its first step, prefix included
    prefix: Ints  # (slots,), burn-in steps
    trained: Ints  # (slots,), steps after the prefix
    at_start: Bools  # (slots,), the first step is its episode's first
    terminated: Bools  # (slots,), the last step terminated the episode
    condition: NDArray[np.float32]  # (slots,)
    frames: Ints  # (slots,), rows of the episode, at its last sequence; else 0
    initial_state: NDArray[np.float32]  # (slots, K, H), state before the first step; H may be 0

    @classmethod
    def zeros(cls, slots: int, individuals: int, state_size: int) -> Sequences:
        """Return empty sequences."""
        first, prefix, trained, frames = (np.zeros(slots, np.int64) for _ in range(4))
        at_start, terminated = (np.zeros(slots, np.bool_) for _ in range(2))
        condition = np.zeros(slots, np.float32)
        state = np.zeros((slots, individuals, state_size), np.float32)
        return cls(first, prefix, trained, at_start, terminated, condition, frames, state)


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
    first few need computing (:class:`animarl_algos.networks.layers.Packing`).

    The true successor of a column's last step is its last observation (the terminal one where an
    episode ended). A time-out is not terminated: it bootstraps.
    """

    observations: torch.Tensor  # (K, T + 1, B, n) float32
    previous_actions: torch.Tensor  # (K, T + 1, B) int64, before each observation
    actions: torch.Tensor  # (K, T, B) int64
    rewards: torch.Tensor  # (K, T, B) float32, task reward
    penalties: torch.Tensor  # (K, T, B) float32, DTW penalty
    terminated: torch.Tensor  # (K, T, B) float32, 1 where nothing follows
    mask: torch.Tensor  # (K, T, B) float32, 1 where the step enters a loss; else padding, warm-up
    starts: torch.Tensor  # (K, B) int64
    lengths: torch.Tensor  # (K, B) int64
    indices: Ints  # (K, B), which sequences these are
    labels: torch.Tensor  # (K, T, B) int64, demonstrated action aligned with the step, or -1
    condition: torch.Tensor  # (K, B) float32, of the column's episode, 0 or 1
    weights: torch.Tensor | None = None  # (K, B) float32, importance, at most 1; None: all 1
    burn_in: int = 0
    initial_state: torch.Tensor | None = None  # (K, B, H), before the step at starts; None: zeros
    action_penalties: torch.Tensor | None = None  # (K, T, B, A), of each action; demonstrations'
    label_shares: torch.Tensor | None = None  # (K, T, B, A), soft labels; demonstrations'

    @property
    def num_individuals(self) -> int:
        """Number of individuals, K."""
        return self.actions.shape[0]

    @property
    def num_steps(self) -> int:
        """T, the padded length."""
        return self.actions.shape[1]

    @property
    def batch_size(self) -> int:
        """Number of sequences, B."""
        return self.actions.shape[2]

    def to(self, device: torch.device | str) -> SequenceBatch:
        """Return the batch on ``device``; ``indices`` stay a NumPy array."""
        tensors: dict[str, Any] = {
            name: value.to(device)
            for name, value in vars(self).items()
            if isinstance(value, torch.Tensor)
        }
        return replace(self, **tensors)


@jit
def _gather(frames, sequences, slots, no_action):  # type: ignore[no-untyped-def]
    """Copy the sequences in ``slots`` ``(K, B)`` into new arrays, padded and aligned.

    Trained parts begin at the same time in all columns; shorter prefixes are padded before.
    """
    rows, _, size = frames.observations.shape
    individuals, columns = slots.shape
    burn_in, trained = 0, 0
    for k in range(individuals):
        for b in range(columns):
            burn_in = max(burn_in, sequences.prefix[slots[k, b]])
            trained = max(trained, sequences.trained[slots[k, b]])
    units = sequences.initial_state.shape[2]
    each = (individuals, burn_in + trained, columns)
    states = (individuals, burn_in + trained + 1, columns)
    observations = np.zeros((*states, size), np.float32)
    previous_actions = np.full(states, no_action, np.int64)
    actions = np.zeros(each, np.int64)
    rewards, penalties = np.zeros(each, np.float32), np.zeros(each, np.float32)
    terminated, mask = np.zeros(each, np.float32), np.zeros(each, np.float32)
    labels = np.full(each, NO_LABEL, np.int64)
    scored = np.zeros((*each, frames.action_penalties.shape[2]), np.float32)
    shares = np.zeros((*each, frames.label_shares.shape[2]), np.float32)
    starts = np.empty((individuals, columns), np.int64)
    lengths = np.empty((individuals, columns), np.int64)
    condition = np.empty((individuals, columns), np.float32)
    initial_state = np.empty((individuals, columns, units), np.float32)
    for k in range(individuals):
        for b in range(columns):
            slot = slots[k, b]
            start = burn_in - sequences.prefix[slot]
            end = burn_in + sequences.trained[slot]
            starts[k, b], lengths[k, b] = start, end
            condition[k, b] = sequences.condition[slot]
            initial_state[k, b] = sequences.initial_state[slot, k]
            row = sequences.first[slot]
            previous = no_action
            if not sequences.at_start[slot]:
                previous = np.int64(frames.actions[row - 1 if row > 0 else rows - 1, k])
            for t in range(start, end + 1):
                for i in range(size):
                    observations[k, t, b, i] = frames.observations[row, k, i]
                previous_actions[k, t, b] = previous
                if t < end:
                    previous = np.int64(frames.actions[row, k])
                    actions[k, t, b] = previous
                    rewards[k, t, b] = frames.rewards[row, k]
                    penalties[k, t, b] = frames.penalties[row, k]
                    terminated[k, t, b] = t == end - 1 and sequences.terminated[slot]
                    mask[k, t, b] = t >= burn_in and not frames.warmup[row]
                    labels[k, t, b] = frames.labels[row, k]
                    for i in range(scored.shape[3]):
                        scored[k, t, b, i] = frames.action_penalties[row, k, i]
                    for i in range(shares.shape[3]):
                        shares[k, t, b, i] = frames.label_shares[row, k, i]
                    row = row + 1 if row + 1 < rows else 0
    arrays = (
        observations,
        previous_actions,
        actions,
        rewards,
        penalties,
        terminated,
        mask,
        starts,
        lengths,
        labels,
        condition,
        initial_state,
        scored,
        shares,
    )
    return arrays, burn_in


def gather(
    frames: Frames,
    sequences: Sequences,
    slots: Ints,
    *,
    indices: Ints,
    num_actions: int,
    weights: NDArray[np.float32] | None = None,
) -> SequenceBatch:
    """Return the batch of the sequences in ``slots`` ``(K, B)``, sorted by decreasing length."""
    arrays, burn_in = _gather(frames, sequences, slots, num_actions)
    tensors = dict(zip(GATHERED, map(torch.from_numpy, arrays), strict=True))
    for name in ("initial_state", "action_penalties", "label_shares"):
        if not tensors[name].shape[-1]:
            del tensors[name]
    return SequenceBatch(
        **tensors,
        weights=None if weights is None else torch.from_numpy(weights),
        indices=indices,
        burn_in=int(burn_in),
    )


GATHERED = (
    "observations",
    "previous_actions",
    "actions",
    "rewards",
    "penalties",
    "terminated",
    "mask",
    "starts",
    "lengths",
    "labels",
    "condition",
    "initial_state",
    "action_penalties",
    "label_shares",
)
"""Names of what :func:`_gather` returns, in its order."""
BY_STEP = tuple(
    one for one in GATHERED if one not in ("starts", "lengths", "condition", "initial_state")
)
"""Fields of a batch whose second axis is time."""
