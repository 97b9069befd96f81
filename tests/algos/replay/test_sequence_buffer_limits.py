"""What a sequence replay takes of the memory, what it refuses, and how its state goes on."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from step_streams import STATE, Stream, fill, make_buffer

from animarl_algos.replay import sequence_buffer
from animarl_algos.replay.sequence_buffer import SequenceReplayBuffer
from animarl_algos.replay.store import SequenceBatch
from animarl_envs.errors import InputError


def test_memory_is_stated_and_only_its_used_part_is_saved() -> None:
    stream = Stream(4, 2, 3, 9, seed=11)
    buffer = fill(make_buffer(stream, 60_000), stream, 30)
    rows = buffer.ring.frames.observations.nbytes
    assert rows == 60_000 * 2 * 3 * 4 < buffer.nbytes
    assert sum(np.asarray(value).nbytes for value in buffer.state().values()) < 0.01 * rows


def test_more_memory_than_there_is_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sequence_buffer, "available_memory", lambda: 10 * 2**20)
    with pytest.raises(InputError, match=r"buffer_size 1000000 needs .* GiB .* available"):
        SequenceReplayBuffer(1_000_000, 18, 3, 13, 148)
    with pytest.raises(InputError, match="5000 copies"):
        SequenceReplayBuffer(1000, 18, 3, 13, 148, 5000)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"buffer_size": 9}, "buffer_size 9 cannot hold an episode of 9 steps"),
        ({"sequence_length": 4, "burn_in": 4}, "burn_in 4 does not fit"),
        ({"burn_in": 2}, "set sequence_length"),
        ({"state_mode": "zero", "sequence_length": 4, "burn_in": 1}, "set it to 0"),
        ({"state_mode": "kept", "sequence_length": 4}, "choose one of recompute, stored, zero"),
    ],
)
def test_bad_settings_are_refused(options: dict[str, Any], message: str) -> None:
    sizes = {
        "buffer_size": 100,
        "observation_dim": 3,
        "num_individuals": 2,
        "num_actions": 5,
        "max_episode_steps": 9,
    }
    with pytest.raises(InputError, match=message):
        SequenceReplayBuffer(**sizes | options)


def test_bad_steps_are_refused() -> None:
    stream = Stream(2, 2, 3, 4, seed=1, end_rate=0.0)
    step = next(stream.steps(1))
    buffer = make_buffer(stream, 50)
    with pytest.raises(ValueError, match="reshape"):
        buffer.add(**step | {"observations": np.zeros((2, 2, 4))})
    with pytest.raises(InputError, match=r"must lie in 0 \.\. 4"):
        buffer.add(**step | {"actions": np.full((2, 2), 5)})
    with pytest.raises(InputError, match="no finished episode"):
        buffer.sample(2)
    with pytest.raises(InputError, match="past 4 steps"):
        for _ in range(5):
            buffer.add(**step | {"truncated": np.zeros(2, dtype=bool)})
    with pytest.raises(InputError, match="finite"):
        buffer.update_priorities(np.zeros((2, 1), dtype=np.int64), np.full((2, 1), np.nan))


# -- its state ------------------------------------------------------------------------------------


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
