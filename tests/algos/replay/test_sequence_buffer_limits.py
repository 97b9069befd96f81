"""What a sequence replay takes of the memory, and what it refuses."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from step_streams import Stream, fill, make_buffer

from animarl_algos.replay import sequence_buffer
from animarl_algos.replay.sequence_buffer import SequenceReplayBuffer
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
