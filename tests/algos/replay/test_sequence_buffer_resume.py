"""The state of a sequence replay: a restored one goes on as if it had never been saved."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from step_streams import STATE, Stream, fill, make_buffer

from animarl_algos.replay.sequence_buffer import SequenceReplayBuffer
from animarl_algos.replay.store import SequenceBatch
from animarl_envs.errors import InputError


@pytest.mark.parametrize("kind", ["episodes", "pieces", "uniform"])
def test_a_restored_buffer_goes_on_identically(kind: str, tmp_path: Path) -> None:
    stream = Stream(3, 2, 3, 9, seed=11, warmup_steps=1)
    options: dict[str, Any] = {
        "episodes": {},
        "pieces": {
            "sequence_length": 5,
            "burn_in": 2,
            "state_mode": "stored",
            "state_size": STATE,
        },
        "uniform": {"prioritized": False},
    }[kind]
    steps = list(stream.steps(120))
    one, other = (
        make_buffer(stream, 60, seed=1, **options),
        make_buffer(stream, 60, seed=2, **options),
    )

    def go(buffer: SequenceReplayBuffer, part: list[dict[str, Any]]) -> list[SequenceBatch]:
        batches = []
        for step in part:
            buffer.add(**step)
            if buffer.num_sequences:
                batches.append(buffer.sample(4, 0.3))
                errors = np.cos(batches[-1].indices) + 1.5
                buffer.update_priorities(batches[-1].indices, errors)
        return batches

    go(one, steps[:71])
    go(other, steps[50:60])  # what it held is replaced
    np.savez(tmp_path / "replay.npz", **one.state())
    with np.load(tmp_path / "replay.npz", allow_pickle=False) as stored:
        other.restore(stored)
    for left, right in zip(go(one, steps[71:]), go(other, steps[71:]), strict=True):
        np.testing.assert_array_equal(left.indices, right.indices)
        for name in ("observations", "previous_actions", "rewards", "mask", "weights", "labels"):
            assert torch.equal(getattr(left, name), getattr(right, name))
        if kind == "pieces":
            assert left.initial_state is not None and right.initial_state is not None
            assert torch.equal(left.initial_state, right.initial_state)
    for name, value in one.state().items():
        np.testing.assert_array_equal(value, other.state()[name])


def test_a_foreign_or_damaged_state_is_refused() -> None:
    stream = Stream(1, 1, 2, 4, seed=3)
    buffer = fill(make_buffer(stream, 50), stream, 30)
    with pytest.raises(InputError, match="buffer_size 60, this run has 50"):
        buffer.restore(make_buffer(stream, 60).state())
    state = buffer.state()
    state["ring_rewards"] = state["ring_rewards"][:-1]
    with pytest.raises(InputError, match="damaged"):
        buffer.restore(state)
