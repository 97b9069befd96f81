"""The sequence replay against a plain Python reference that keeps everything in lists."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from step_streams import NUM_ACTIONS, STATE, Stream, fill, make_buffer

from animarl_algos.replay.sequence_buffer import SequenceReplayBuffer
from animarl_algos.replay.store import SequenceBatch


@dataclass
class Reference:
    """Episodes as lists of steps; pieces cut from them by the definition."""

    capacity: int
    stride: int
    burn_in: int
    running: dict[int, list[dict[str, Any]]] = field(default_factory=dict)
    episodes: list[list[dict[str, Any]]] = field(default_factory=list)
    evicted: int = 0

    def add(self, step: dict[str, Any]) -> None:
        for c in range(len(step["terminated"])):
            mine = {name: value[c] for name, value in step.items()}
            self.running.setdefault(c, []).append(mine)
            if mine["terminated"] or mine["truncated"]:
                episode = self.running.pop(c)
                if any(not s["warmup"] for s in episode):
                    self.episodes.append(episode)
                while sum(len(e) + 1 for e in self.episodes[self.evicted :]) > self.capacity:
                    self.evicted += 1

    def sequences(self) -> dict[int, tuple[list[dict[str, Any]], int, int]]:
        """Serial number -> (episode, begin of the trained part, its end), of those still held."""
        out, serial = {}, 0
        for number, episode in enumerate(self.episodes):
            for begin in range(0, len(episode), self.stride):
                end = min(begin + self.stride, len(episode))
                if all(s["warmup"] for s in episode[begin:end]):
                    continue
                if number >= self.evicted:
                    out[serial] = (episode, begin, end)
                serial += 1
        return out


def check_column(
    batch: SequenceBatch, k: int, b: int, reference: Reference, stored_state: bool
) -> None:
    """Every entry of one column equals the reference's, padding included."""
    episode, begin, end = reference.sequences()[int(batch.indices[k, b])]
    prefix = min(reference.burn_in, begin)
    start, length = int(batch.starts[k, b]), int(batch.lengths[k, b])
    assert start == batch.burn_in - prefix
    assert length == batch.burn_in + end - begin
    last = episode[-1]
    assert batch.condition[k, b] == last["condition"]
    if stored_state:
        assert batch.initial_state is not None
        np.testing.assert_array_equal(
            batch.initial_state[k, b], episode[begin - prefix]["hidden"][k]
        )
    for t in range(batch.num_steps + 1):
        i = begin + t - batch.burn_in  # step of the episode
        if start <= t <= length:
            wanted = (
                episode[i]["observations"] if i < len(episode) else last["next_observations"]
            )[k]
            before = NUM_ACTIONS if i == 0 else episode[i - 1]["actions"][k]
        else:
            wanted, before = np.zeros(batch.observations.shape[3]), NUM_ACTIONS
        np.testing.assert_array_equal(batch.observations[k, t, b], wanted)
        assert batch.previous_actions[k, t, b] == before
        if t == batch.num_steps:
            break
        if start <= t < length:
            step = episode[i]
            assert batch.actions[k, t, b] == step["actions"][k]
            assert batch.rewards[k, t, b] == step["rewards"][k]
            assert batch.penalties[k, t, b] == step["penalties"][k]
            assert batch.labels[k, t, b] == step["labels"][k]
            assert batch.terminated[k, t, b] == float(step["terminated"])
            assert batch.mask[k, t, b] == float(t >= batch.burn_in and not step["warmup"])
        else:
            for name in ("actions", "rewards", "penalties", "terminated", "mask"):
                assert getattr(batch, name)[k, t, b] == 0
            assert batch.labels[k, t, b] == -1


@settings(max_examples=40, deadline=None)
@given(
    seed=st.integers(0, 10_000),
    copies=st.integers(1, 4),
    individuals=st.integers(1, 3),
    max_steps=st.integers(1, 9),
    room=st.integers(0, 40),
    warmup_steps=st.integers(0, 3),
    piece=st.none() | st.tuples(st.integers(1, 4), st.integers(0, 4), st.booleans()),
    prioritized=st.booleans(),
)
def test_content_equals_a_plain_reference(
    seed: int,
    copies: int,
    individuals: int,
    max_steps: int,
    room: int,
    warmup_steps: int,
    piece: tuple[int, int, bool] | None,
    prioritized: bool,
) -> None:
    """Ring, eviction, pieces, padding, masks, time-outs: over random streams of episodes."""
    stream = Stream(copies, individuals, 3, max_steps, seed, warmup_steps=warmup_steps)
    stride, burn_in, stored = piece or (max_steps, 0, False)
    options: dict[str, Any] = {"prioritized": prioritized, "seed": seed}
    if piece:
        options |= {"sequence_length": stride + burn_in, "burn_in": burn_in}
    if stored:
        options |= {"state_mode": "stored", "state_size": STATE}
    buffer = make_buffer(stream, max_steps + 1 + room, **options)
    reference = Reference(max_steps + 1 + room, stride, burn_in)
    for number, step in enumerate(stream.steps(30)):
        buffer.add(**step)
        reference.add(step)
        held = reference.sequences()
        assert buffer.num_sequences == len(held)
        if number % 6 or not held:
            continue
        assert buffer.num_episodes == len(reference.episodes) - reference.evicted
        batch = buffer.sample(4)
        assert batch.num_steps == int(batch.lengths.max())
        for k in range(individuals):
            lengths = batch.lengths[k].tolist()
            assert lengths == sorted(lengths, reverse=True)
            for b in range(4):
                check_column(batch, k, b, reference, stored)
        observed = batch.lengths.numpy()[:, None, :] >= np.arange(batch.num_steps + 1)[:, None]
        np.testing.assert_array_equal(batch.active, observed.sum(axis=2).max(axis=0))


def test_a_time_out_bootstraps_and_a_contact_does_not() -> None:
    buffer = SequenceReplayBuffer(100, 1, 1, NUM_ACTIONS, 3, seed=1)
    for episode, terminates in enumerate((False, True)):
        for t in range(3):
            value = np.full((1, 1, 1), 10.0 * episode + t)
            done = np.array([t == 2])
            buffer.add(
                observations=value, actions=[[t]], next_observations=value + 0.5,
                terminated=done & terminates, truncated=done & (not terminates),
            )  # fmt: skip
    batch = buffer.sample(8)
    kinds = set()
    for b in range(8):
        first = float(batch.observations[0, 0, b, 0])
        kinds.add(first)
        assert batch.terminated[0, :, b].tolist() == [0.0, 0.0, float(first == 10.0)]
        assert float(batch.observations[0, 3, b, 0]) == first + 2.5  # the terminal observation
        assert batch.previous_actions[0, :, b].tolist() == [NUM_ACTIONS, 0, 1, 2]
    assert kinds == {0.0, 10.0}


@pytest.mark.parametrize(("dropped_at", "steps_kept"), [(3, 3), (8, 6)])
def test_dropping_running_episodes_keeps_the_finished(dropped_at: int, steps_kept: int) -> None:
    """Both copies end an episode at the sixth step, and begin another that is not finished."""
    stream = Stream(2, 1, 2, 6, seed=5, end_rate=0.0)
    buffer = make_buffer(stream, 100)
    for number, step in enumerate(stream.steps(10)):
        if number == dropped_at:
            buffer.drop_running()
        buffer.add(**step)
    assert (buffer.num_episodes, buffer.num_steps) == (2, 2 * steps_kept)


def test_no_more_episodes_are_kept_than_asked_for() -> None:
    """The oldest goes, as if the rows were full, and what is left is what is drawn."""
    stream = Stream(2, 1, 2, 6, seed=5)
    capped = fill(make_buffer(stream, 200, max_episodes=3, seed=1), stream)
    whole = fill(make_buffer(stream, 200, seed=1), stream)
    assert whole.num_episodes > capped.num_episodes == 3
    frames = whole.ring.sequences.frames[: whole.num_sequences]
    assert capped.num_steps == int(frames[-3:].sum()) - 3
    assert capped.sample(50).lengths.max() <= frames[-3:].max() - 1


def test_individuals_together_draw_what_each_would_alone() -> None:
    stream = Stream(3, 3, 2, 8, seed=2)
    names = ("male_0", "male_1", "female")
    together = fill(make_buffer(stream, 90, seed=7, names=names), stream)
    alone = [
        SequenceReplayBuffer(90, 2, 1, NUM_ACTIONS, 8, 3, seed=7, names=(name,)) for name in names
    ]
    for k, buffer in enumerate(alone):
        for step in stream.steps(60):
            mine = {n: v[:, k : k + 1] if v.ndim > 1 else v for n, v in step.items()}
            buffer.add(**mine)
    for progress in (0.0, 0.5, 1.0):
        batch = together.sample(6, progress)
        assert set(batch.indices[0]) != set(batch.indices[1])
        errors = np.abs(np.sin(batch.indices + np.arange(3)[:, None])) * 3
        together.update_priorities(batch.indices, errors)
        for k, buffer in enumerate(alone):
            single = buffer.sample(6, progress)
            np.testing.assert_array_equal(single.indices[0], batch.indices[k])
            np.testing.assert_array_equal(single.weights[0], batch.weights[k])
            steps = single.num_steps
            np.testing.assert_array_equal(
                single.observations[0], batch.observations[k, : steps + 1]
            )
            assert not batch.mask[k, steps:].any()
            buffer.update_priorities(single.indices, errors[k : k + 1])


@pytest.mark.cuda
def test_batches_reach_the_gpu_unchanged() -> None:
    stream = Stream(2, 2, 2, 8, seed=2)
    there, here = (fill(make_buffer(stream, 200, device=d), stream) for d in ("cuda", "cpu"))
    for _ in range(3):
        sent, kept = there.sample(6), here.sample(6)
        assert sent.observations.is_cuda and sent.weights.is_cuda
        np.testing.assert_array_equal(sent.indices, kept.indices)
        assert torch.equal(sent.observations.cpu(), kept.observations)
        assert torch.equal(sent.mask.cpu(), kept.mask)


def test_moments_are_those_of_the_episodes_that_are_held() -> None:
    buffer = SequenceReplayBuffer(12, 2, 1, 2, 4)
    rng, kept = np.random.default_rng(0), []
    for _ in range(5):  # of 5 rows each: two fit
        episode = rng.normal(size=(5, 1, 2)).astype(np.float32)
        kept.append(episode)
        for t in range(4):
            last = np.array([t == 3])
            buffer.add(
                observations=episode[None, t], actions=[[0]],
                next_observations=episode[None, t + 1], terminated=last,
            )  # fmt: skip
    mean, sd = buffer.moments()
    held = np.concatenate(kept[-2:])
    np.testing.assert_allclose(mean, held.mean(0), atol=1e-6)
    np.testing.assert_allclose(sd, held.std(0), atol=1e-6)
