"""What the replay memory is made of: rows of frames, slots of sequences, and where both stand.

Frames form a ring of rows, sequences a ring of slots. Sequences are numbered by a serial number
that never repeats; the slot is the serial number modulo the number of slots, so a number held from
an earlier draw still says whether its sequence has been evicted since.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

# Entries of a ring's cursor.
OLDEST, NEXT, NEXT_ROW, ROWS_USED, EPISODES = 0, 1, 2, 3, 4
NO_LABEL = -1


class Frames(NamedTuple):
    """What is known per frame, one row each; an episode of T steps fills T + 1 rows in order.

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
        """Rows of zeros."""
        flat = (rows, num_individuals)
        return cls(
            observations=np.zeros((*flat, observation_dim), dtype=np.float32),
            actions=np.zeros(flat, dtype=np.int16),
            rewards=np.zeros(flat, dtype=np.float32),
            penalties=np.zeros(flat, dtype=np.float32),
            labels=np.full(flat, NO_LABEL, dtype=np.int16),
            warmup=np.zeros(rows, dtype=np.bool_),
        )

    @staticmethod
    def bytes_per_row(num_individuals: int, observation_dim: int) -> int:
        return num_individuals * (4 * observation_dim + 12) + 1


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

    @classmethod
    def allocate(cls, slots: int, num_individuals: int, state_size: int) -> Sequences:
        """Empty slots."""
        return cls(
            first=np.zeros(slots, dtype=np.int64),
            prefix=np.zeros(slots, dtype=np.int64),
            trained=np.zeros(slots, dtype=np.int64),
            at_start=np.zeros(slots, dtype=np.bool_),
            terminated=np.zeros(slots, dtype=np.bool_),
            condition=np.zeros(slots, dtype=np.float32),
            frames=np.zeros(slots, dtype=np.int64),
            initial_state=np.zeros((slots, num_individuals, state_size), dtype=np.float32),
        )

    @staticmethod
    def bytes_per_slot(num_individuals: int, state_size: int) -> int:
        return 38 + 4 * num_individuals * state_size


class Ring(NamedTuple):
    """Finished episodes."""

    frames: Frames
    sequences: Sequences
    cursor: NDArray[np.int64]  # (5,), serial numbers of the oldest and the next sequence, next row
    trees: NDArray[np.float64]  # (K, nodes), priorities as sum trees; no node: drawn uniformly
    max_priority: NDArray[np.float64]  # (K,), the largest so far, before the exponent

    @classmethod
    def allocate(
        cls,
        rows: int,
        slots: int,
        num_individuals: int,
        observation_dim: int,
        state_size: int,
        trees: NDArray[np.float64],
    ) -> Ring:
        """Without an episode."""
        return cls(
            frames=Frames.allocate(rows, num_individuals, observation_dim),
            sequences=Sequences.allocate(slots, num_individuals, state_size),
            cursor=np.zeros(5, dtype=np.int64),
            trees=trees,
            max_priority=np.ones(num_individuals),
        )

    @property
    def used_rows(self) -> NDArray[np.int64]:
        """From the oldest episode's first row on."""
        used, end = self.cursor[ROWS_USED], self.cursor[NEXT_ROW]
        return np.asarray(np.arange(end - used, end) % len(self.frames.warmup))

    @property
    def used_slots(self) -> NDArray[np.int64]:
        """From the oldest sequence on."""
        slots = np.arange(self.cursor[OLDEST], self.cursor[NEXT]) % len(self.sequences.first)
        return np.asarray(slots)


class Staging(NamedTuple):
    """Running episodes, one per copy of the world, each with as many rows as the longest needs."""

    frames: Frames
    step_count: NDArray[np.int64]  # (copies,)
    state: NDArray[np.float32]  # (copies, pieces, K, H), recurrent state before each piece

    @classmethod
    def allocate(
        cls,
        copies: int,
        rows: int,
        pieces: int,
        num_individuals: int,
        observation_dim: int,
        state_size: int,
    ) -> Staging:
        """``rows`` for each copy, none used."""
        return cls(
            frames=Frames.allocate(copies * rows, num_individuals, observation_dim),
            step_count=np.zeros(copies, dtype=np.int64),
            state=np.zeros((copies, pieces, num_individuals, state_size), dtype=np.float32),
        )

    @property
    def used_rows(self) -> NDArray[np.int64]:
        """Those that hold steps of running episodes."""
        room = len(self.frames.warmup) // len(self.step_count)
        used = [copy * room + np.arange(steps) for copy, steps in enumerate(self.step_count)]
        return np.concatenate(used)
