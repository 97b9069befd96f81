"""A minibatch of sequences: what the memory hands to the learner."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray


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
        """The same batch on ``device``; ``indices`` and ``active`` stay NumPy arrays."""
        return self._map(lambda tensor: tensor.to(device))

    def clone(self) -> SequenceBatch:
        """A copy that outlives the next ``sample`` of the buffer it came from."""
        copy = self._map(torch.clone)
        copy.indices, copy.active = self.indices.copy(), self.active.copy()
        return copy

    def individual(self, k: int) -> SequenceBatch:
        """Individual ``k`` alone, as a batch with K = 1 (a view, padded as the whole)."""
        alone = self._map(lambda tensor: tensor[k : k + 1])
        alone.indices = self.indices[k : k + 1]
        return alone

    def _map(self, function: Callable[[torch.Tensor], torch.Tensor]) -> SequenceBatch:
        changed: dict[str, Any] = {
            field.name: function(value)
            for field in dataclasses.fields(self)
            if isinstance(value := getattr(self, field.name), torch.Tensor)
        }
        return dataclasses.replace(self, **changed)
