"""Prioritised replay: the sum tree, the proportional rule, and the importance weights."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats
from step_streams import Stream, fill, make_buffer

from animarl_algos.replay.sequence_buffer import SequenceReplayBuffer
from animarl_algos.replay.sequence_kernels import SumTrees, find_leaf, set_leaf


def set_leaves(trees: SumTrees, k: int, leaves: Any, values: Any) -> None:
    for leaf, value in zip(leaves, values, strict=True):
        set_leaf(trees.nodes, k, leaf, value)


@settings(max_examples=50, deadline=None)
@given(st.lists(st.tuples(st.integers(0, 12), st.floats(0, 1e6)), min_size=1, max_size=40))
def test_the_sum_tree_keeps_its_sums(changes: list[tuple[int, float]]) -> None:
    trees, plain = SumTrees(1, 13), np.zeros(13)
    for leaf, value in changes:
        set_leaves(trees, 0, [leaf], [value])
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
    set_leaves(trees, 1, [0, 1, 2, 3], [0.5, 0.0, 3.0, 1.5])
    found = {0.0: 0, 0.49: 0, 0.5: 2, 3.49: 2, 3.5: 3, 4.99: 3, 5.0: 3, 5.1: 3}
    assert {mass: find_leaf(trees.nodes, 1, mass) for mass in found} == found
    set_leaves(trees, 1, [3], [0.0])
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


@pytest.mark.parametrize("stratified", [True, False])
def test_draws_follow_the_proportional_rule(stratified: bool) -> None:
    buffer, priorities = filled_with_priorities(stratified=stratified)
    size = 8 if stratified else 4000
    draws = np.concatenate([buffer.sample(size).indices[0] for _ in range(4000 // size)])
    counts = np.bincount(draws, minlength=len(priorities))
    expected = len(draws) * priorities / priorities.sum()
    assert stats.chisquare(counts, expected).pvalue > 0.001


def test_uniform_draws_are_uniform_and_unweighted() -> None:
    stream = Stream(1, 2, 2, 4, seed=3)
    buffer = fill(make_buffer(stream, 30, prioritized=False, stratified=False), stream, 80)
    batch = buffer.sample(3000)
    counts = np.unique(batch.indices[1], return_counts=True)[1]
    assert len(counts) == buffer.num_sequences > 3
    assert stats.chisquare(counts).pvalue > 0.001
    assert (batch.weights == 1).all()


def test_importance_weights_by_formula() -> None:
    buffer, priorities = filled_with_priorities(beta_start=0.4, beta_end=1.0)
    for progress, beta in ((0.0, 0.4), (0.5, 0.7), (1.0, 1.0), (2.0, 1.0)):
        batch = buffer.sample(16, progress)
        probability = priorities[batch.indices[0]] / priorities.sum()
        weights = (len(priorities) * probability) ** -beta
        np.testing.assert_allclose(batch.weights[0], weights / weights.max(), rtol=1e-5)


def test_new_sequences_get_the_largest_priority_seen() -> None:
    buffer, _ = filled_with_priorities(alpha=1.0)
    count = buffer.num_sequences
    # The episode with the largest error loses it; a new one still enters with that error.
    buffer.update_priorities(np.array([[count - 1]]), np.array([[0.5]]))
    for step in Stream(1, 1, 2, 4, seed=9, end_rate=2.0).steps(1):
        buffer.add(**step)
    assert buffer.num_sequences == count + 1
    held = buffer.trees.priorities[0, : count + 1]
    assert held[count - 1] == pytest.approx(0.5, abs=1e-5)
    assert held[count] == pytest.approx(count, abs=1e-5)


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
    assert buffer.ring.max_priority.tolist() == [1.0]
