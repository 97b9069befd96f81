"""The sequence replay against a plain Python reference that keeps everything in lists."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from refusals import refuses
from scipy import stats

from animarl_algos.replay import sequence_buffer
from animarl_algos.replay.sequence_buffer import SequenceReplayBuffer
from animarl_algos.replay.store import SequenceBatch
from animarl_algos.replay.sum_trees import SumTrees, find_leaf
from animarl_envs.errors import InputError

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
                "observations": now, "actions": rng.integers(0, NUM_ACTIONS, pair),
                "rewards": rng.normal(size=pair).astype(np.float32), "next_observations": following,
                "terminated": terminated, "truncated": truncated,
                "penalties": rng.random(pair).astype(np.float32),
                "labels": rng.integers(-1, NUM_ACTIONS, pair), "warmup": age < self.warmup_steps,
                "hidden": rng.normal(size=(*pair, STATE)).astype(np.float32),
                "condition": condition.copy(),
            }  # fmt: skip
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
    seed=st.integers(0, 10_000), copies=st.integers(1, 4), individuals=st.integers(1, 3),
    max_steps=st.integers(1, 9), room=st.integers(0, 40), warmup_steps=st.integers(0, 3),
    piece=st.none() | st.tuples(st.integers(1, 4), st.integers(0, 4), st.booleans()),
    prioritized=st.booleans(),
)  # fmt: skip
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
    frames = whole.sequences.frames[: whole.num_sequences]
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


@settings(max_examples=50, deadline=None)
@given(st.lists(st.tuples(st.integers(0, 12), st.floats(0, 1e6)), min_size=1, max_size=40))
def test_the_sum_tree_keeps_its_sums(changes: list[tuple[int, float]]) -> None:
    trees, plain = SumTrees(1, 13), np.zeros(13)
    for leaf, value in changes:
        trees.set([leaf], value)
        plain[leaf] = value
    np.testing.assert_array_equal(trees.priorities[0], plain)
    np.testing.assert_allclose(trees.nodes[0, 1], plain.sum(), rtol=1e-12)
    again = SumTrees(1, 13)
    held = np.flatnonzero(plain)
    again.restore(held, plain[None, held])
    np.testing.assert_array_equal(again.nodes, trees.nodes)


def test_a_leaf_is_found_by_the_cumulative_priority() -> None:
    """By hand: shares end at 0.5, 0.5, 3.5 and 5; an end belongs to the next leaf that has any."""
    trees = SumTrees(2, 4)
    trees.set([[-1, -1, -1, -1], [0, 1, 2, 3]], [0.5, 0.0, 3.0, 1.5])
    found = {0.0: 0, 0.49: 0, 0.5: 2, 3.49: 2, 3.5: 3, 4.99: 3, 5.0: 3, 5.1: 3}
    assert {mass: find_leaf(trees.nodes, 1, mass) for mass in found} == found
    trees.set([[-1], [3]], 0.0)
    assert find_leaf(trees.nodes, 1, 3.6) == 2  # rounding never leads to a leaf without priority


def filled_with_priorities(
    alpha: float = 0.7, **options: Any
) -> tuple[SequenceReplayBuffer, np.ndarray]:
    """A buffer of at least 8 episodes whose errors are 1, 2, 3, ... by serial number."""
    stream = Stream(1, 1, 2, 4, seed=3)
    buffer = fill(make_buffer(stream, 2000, alpha=alpha, **options), stream, 40)
    serials = np.arange(buffer.num_sequences)[None]
    buffer.update_priorities(serials, serials + 1.0)
    return buffer, (serials[0] + 1.0 + 1e-6) ** alpha


def test_draws_follow_the_proportional_rule() -> None:
    buffer, priorities = filled_with_priorities()
    draws = np.concatenate([buffer.sample(8).indices[0] for _ in range(500)])
    counts = np.bincount(draws, minlength=len(priorities))
    expected = len(draws) * priorities / priorities.sum()
    assert stats.chisquare(counts, expected).pvalue > 0.001


def test_uniform_draws_are_uniform_and_unweighted() -> None:
    stream = Stream(1, 2, 2, 4, seed=3)
    buffer = fill(make_buffer(stream, 30, prioritized=False), stream, 80)
    batch = buffer.sample(3000)
    counts = np.unique(batch.indices[1], return_counts=True)[1]
    assert len(counts) == buffer.num_sequences > 3
    assert stats.chisquare(counts).pvalue > 0.001
    assert batch.weights is None


def test_errors_of_evicted_sequences_change_nothing() -> None:
    stream = Stream(1, 1, 2, 4, seed=3)
    buffer = make_buffer(stream, 12)
    steps = list(stream.steps(80))
    for step in steps[:20]:
        buffer.add(**step)
    old = buffer.sample(4).indices
    for step in steps[20:]:
        buffer.add(**step)
    before = buffer.trees.nodes.copy()
    buffer.update_priorities(old, np.full(old.shape, 50.0))
    np.testing.assert_array_equal(buffer.trees.nodes, before)
    assert buffer.max_priority.tolist() == [1.0]


def test_memory_is_stated_and_only_its_used_part_is_saved(monkeypatch: pytest.MonkeyPatch) -> None:
    stream = Stream(4, 2, 3, 9, seed=11)
    buffer = fill(make_buffer(stream, 60_000), stream, 30)
    rows = buffer.frames.observations.nbytes
    assert rows == 60_000 * 2 * 3 * 4 < buffer.nbytes
    assert sum(np.asarray(value).nbytes for value in buffer.state().values()) < 0.01 * rows
    monkeypatch.setattr(sequence_buffer, "available_memory", lambda: 10 * 2**20)
    needs = r"buffer_size 1000000 needs .* GiB .* available"
    refuses(needs, SequenceReplayBuffer, 1_000_000, 18, 3, 13, 148)
    refuses("5000 copies", SequenceReplayBuffer, 1000, 18, 3, 13, 148, 5000)


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
    sizes = {"observation_dim": 3, "num_individuals": 2, "num_actions": 5, "max_episode_steps": 9}
    refuses(message, SequenceReplayBuffer, **{"buffer_size": 100} | sizes | options)


def test_bad_steps_are_refused() -> None:
    stream = Stream(2, 2, 3, 4, seed=1, end_rate=0.0)
    step = next(stream.steps(1))
    buffer = make_buffer(stream, 50)
    with pytest.raises(ValueError, match="reshape"):
        buffer.add(**step | {"observations": np.zeros((2, 2, 4))})
    refuses(r"must lie in 0 \.\. 4", buffer.add, **step | {"actions": np.full((2, 2), 5)})
    refuses("no finished episode", buffer.sample, 2)
    with pytest.raises(InputError, match="past 4 steps"):
        for _ in range(5):
            buffer.add(**step | {"truncated": np.zeros(2, dtype=bool)})
    undefined = np.full((2, 1), np.nan)
    refuses("finite", buffer.update_priorities, np.zeros((2, 1), dtype=np.int64), undefined)


@pytest.mark.parametrize("kind", ["episodes", "pieces", "uniform"])
def test_a_restored_buffer_goes_on_identically(kind: str, tmp_path: Path) -> None:
    stream = Stream(3, 2, 3, 9, seed=11, warmup_steps=1)
    options: dict[str, Any] = {
        "episodes": {},
        "pieces": {"sequence_length": 5, "burn_in": 2, "state_mode": "stored", "state_size": STATE},
        "uniform": {"prioritized": False},
    }[kind]
    steps = list(stream.steps(120))
    one, other = (make_buffer(stream, 60, seed=seed, **options) for seed in (1, 2))

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
        names = ["observations", "previous_actions", "rewards", "mask", "labels"]
        for name in names + ["weights"] * (kind != "uniform"):
            assert torch.equal(getattr(left, name), getattr(right, name))
        if kind == "pieces":
            assert left.initial_state is not None and right.initial_state is not None
            assert torch.equal(left.initial_state, right.initial_state)
    for name, value in one.state().items():
        np.testing.assert_array_equal(value, other.state()[name])


def test_a_foreign_or_damaged_state_is_refused() -> None:
    stream = Stream(1, 1, 2, 4, seed=3)
    buffer = fill(make_buffer(stream, 50), stream, 30)
    refuses("buffer_size 60, this run has 50", buffer.restore, make_buffer(stream, 60).state())
    state = buffer.state()
    state["ring_rewards"] = state["ring_rewards"][:-1]
    refuses("damaged", buffer.restore, state)
