"""Boosted trees: those of an independent implementation, and what trees cannot or must find."""

import numpy as np
import pytest

from animarl_algos.evaluation import boosting
from animarl_algos.evaluation.boosting import LEVELS, BoostedTrees


def samples(number: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Levels of nine features, some of few levels, and a class that depends on three of them."""
    rng = np.random.default_rng(seed)
    most = np.array([2, 3, 8, 20, 40, LEVELS, LEVELS, LEVELS, LEVELS])
    levels = (rng.random((number, len(most))) * most).astype(np.uint8)
    odds = (levels[:, 5] / 20.0 - 1.5) * (levels[:, 0] - 0.5) + np.sin(levels[:, 7] / 6.0)
    return levels, rng.random(number) < 1.0 / (1.0 + np.exp(-odds))


@pytest.mark.parametrize("number", [60, 400, 3000])
def test_trees_are_those_of_scikit_learn(number: int) -> None:
    ensemble = pytest.importorskip("sklearn.ensemble", reason="scikit-learn is not installed")
    levels, positive = samples(number, 0)
    new, _ = samples(500, 1)
    theirs = ensemble.HistGradientBoostingClassifier(
        max_iter=boosting.TREES,
        learning_rate=boosting.LEARNING_RATE,
        max_leaf_nodes=boosting.LEAVES,
        min_samples_leaf=boosting.MIN_LEAF_SAMPLES,
        l2_regularization=boosting.L2_PENALTY,
        max_bins=LEVELS,
        early_stopping=False,
    )
    weight = np.where(positive, 0.5 / positive.mean(), 0.5 / (1 - positive.mean()))
    theirs.fit(levels, positive, sample_weight=weight)
    fitted = BoostedTrees.fit(levels, positive)
    for some in (levels, new):
        np.testing.assert_allclose(
            fitted.score(some), theirs.decision_function(some), atol=1e-5, rtol=1e-5
        )


def test_few_samples_are_not_split_and_classes_weigh_alike() -> None:
    levels, positive = samples(2 * boosting.MIN_LEAF_SAMPLES - 1, 0)
    assert np.ptp(BoostedTrees.fit(levels, positive).score(levels)) == 0
    rare = np.arange(1000) < 50
    same = np.zeros((1000, 3), dtype=np.uint8)
    assert np.abs(BoostedTrees.fit(same, rare).score(same)).max() < 1e-6
    levels = np.column_stack([rare, same]).astype(np.uint8)
    scores = BoostedTrees.fit(levels, rare).score(levels)
    assert scores[rare].min() > 2.0 and scores[~rare].max() < -2.0
