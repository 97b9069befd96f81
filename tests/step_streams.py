"""Streams of random steps, and sequence replays filled from them."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from animarl_algos.replay.sequence_buffer import SequenceReplayBuffer

NUM_ACTIONS = 5
STATE = 2


@dataclass
class Stream:
    """Random steps of ``copies`` worlds; every number in it is drawn once and so recognisable."""

    copies: int
    individuals: int
    dim: int
    max_steps: int
    seed: int
    end_rate: float = 0.2
    warmup_steps: int = 0

    def steps(self, count: int) -> Iterator[dict[str, Any]]:
        """``count`` steps as the arguments of :meth:`SequenceReplayBuffer.add`."""
        rng = np.random.default_rng(self.seed)
        each, pair = (self.copies,), (self.copies, self.individuals)
        now = rng.normal(size=(*pair, self.dim)).astype(np.float32)
        age = np.zeros(self.copies, dtype=int)
        condition = rng.integers(0, 2, each)
        for _ in range(count):
            following = rng.normal(size=(*pair, self.dim)).astype(np.float32)
            terminated = rng.random(self.copies) < self.end_rate / 2
            truncated = (rng.random(self.copies) < self.end_rate / 2) | (age + 1 == self.max_steps)
            truncated &= ~terminated
            yield {
                "observations": now,
                "actions": rng.integers(0, NUM_ACTIONS, pair),
                "rewards": rng.normal(size=pair).astype(np.float32),
                "next_observations": following,
                "terminated": terminated,
                "truncated": truncated,
                "penalties": rng.random(pair).astype(np.float32),
                "labels": rng.integers(-1, NUM_ACTIONS, pair),
                "warmup": age < self.warmup_steps,
                "hidden": rng.normal(size=(*pair, STATE)).astype(np.float32),
                "condition": condition.copy(),
            }
            done = terminated | truncated
            age = np.where(done, 0, age + 1)
            now = np.where(done[:, None, None], rng.normal(size=now.shape), following)
            now = now.astype(np.float32)
            condition[done] = rng.integers(0, 2, done.sum())


def make_buffer(stream: Stream, capacity: int, **options: Any) -> SequenceReplayBuffer:
    sizes = (capacity, stream.dim, stream.individuals, NUM_ACTIONS, stream.max_steps)
    return SequenceReplayBuffer(*sizes, stream.copies, **options)


def fill(buffer: SequenceReplayBuffer, stream: Stream, count: int = 60) -> SequenceReplayBuffer:
    for step in stream.steps(count):
        buffer.add(**step)
    return buffer
