"""Boosted trees for two classes on features of few levels, in one compiled kernel.

Gradient boosting of the logistic loss (Friedman 2001, Ann. Stat. 29, 1189) with histograms, each
tree grown at its best leaf first (Ke et al. 2017, NeurIPS). The trees are those of scikit-learn's
``HistGradientBoostingClassifier``, which on a thousand windows takes ten times as long.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from animarl_envs.array_types import Bools, Floats, Ints
from animarl_envs.compiling import jit

LEVELS = 64  # of a feature
TREES = 50
LEARNING_RATE = 0.1  # of what a leaf says, how much is added
LEAVES = 8
MIN_LEAF_SAMPLES = 10
L2_PENALTY = 1.0
MIN_LEAF_CURVATURE = 1e-3  # of the loss in a leaf
COUNT, SLOPE, CURVATURE = 0, 1, 2

Levels = NDArray[np.uint8]


@dataclass(frozen=True)
class BoostedTrees:
    """Fitted trees, all arrays ``(TREES, nodes)``.

    ``feature`` is -1 in a leaf, which has a ``value``. In other nodes samples whose level of that
    feature is at most ``threshold`` go to the node ``child``, all others to the next one.
    """

    feature: Ints
    threshold: Floats
    child: Ints
    value: Floats

    @classmethod
    def fit(cls, levels: Levels, positive: Bools) -> BoostedTrees:
        """Fit trees to samples, ``levels`` ``(samples, features)``; both classes weigh alike."""
        weight = np.where(positive, 0.5 / positive.mean(), 0.5 / (1.0 - positive.mean()))
        return cls(*_fit(np.ascontiguousarray(levels.T), positive, weight))

    def score(self, levels: Levels) -> Floats:
        """Return the log odds of the positive class, ``(samples,)``."""
        columns = np.ascontiguousarray(levels.T)
        scores: Floats = _score(columns, self.feature, self.threshold, self.child, self.value)
        return scores


@jit
def _fit(levels, positive, weight):  # type: ignore[no-untyped-def]
    """Return the arrays of :class:`BoostedTrees`; ``levels`` is ``(features, samples)``."""
    features, samples = levels.shape
    nodes = 2 * LEAVES - 1
    feature = np.full((TREES, nodes), -1)
    threshold, value = np.zeros((TREES, nodes)), np.zeros((TREES, nodes))
    child = np.zeros((TREES, nodes), dtype=np.int64)
    following = _following_levels(levels)
    score, slope, curvature = np.zeros(samples), np.zeros(samples), np.zeros(samples)
    sums = np.zeros((nodes, features, LEVELS, 3))  # of each node, feature and level
    total, best_left = np.zeros((nodes, 3)), np.zeros((nodes, 3))
    gain = np.zeros(nodes)
    best = np.zeros((nodes, 2), dtype=np.int64)  # feature and level
    begin, end = np.zeros(nodes, dtype=np.int64), np.zeros(nodes, dtype=np.int64)
    aside = np.zeros(samples, dtype=np.int64)
    for tree in range(TREES):
        rows = np.arange(samples)
        gain[:] = 0.0
        total[0] = 0.0
        for i in range(samples):
            share = 1.0 / (1.0 + np.exp(-score[i]))
            slope[i] = np.float32((share - positive[i]) * weight[i])
            curvature[i] = np.float32(share * (1.0 - share) * weight[i])
            total[0, SLOPE] += slope[i]
            total[0, CURVATURE] += curvature[i]
        total[0, COUNT], begin[0], end[0] = samples, 0, samples
        if samples >= 2 * MIN_LEAF_SAMPLES:
            _add_up(levels, rows, slope, curvature, sums[0])
            gain[0] = _find_split(sums[0], total[0], best[0], best_left[0])
        number, leaves = 1, 1
        while leaves < LEAVES:
            node = np.argmax(gain)
            if gain[node] <= 0.0:
                break
            which, level = best[node]
            first, second = number, number + 1
            gain[node] = 0.0
            feature[tree, node], child[tree, node] = which, first
            threshold[tree, node] = (level + following[which, level]) / 2
            middle, right = begin[node], 0
            for i in range(begin[node], end[node]):
                if levels[which, rows[i]] <= level:
                    rows[middle] = rows[i]
                    middle += 1
                else:
                    aside[right] = rows[i]
                    right += 1
            rows[middle : end[node]] = aside[:right]
            begin[first], end[first] = begin[node], middle
            begin[second], end[second] = middle, end[node]
            total[first] = best_left[node]
            total[second] = total[node] - best_left[node]
            number, leaves = number + 2, leaves + 1
            if leaves == LEAVES:
                break
            if 2 * (middle - begin[node]) < end[node] - begin[node]:
                small, large = first, second
            else:
                small, large = second, first
            _add_up(levels, rows[begin[small] : end[small]], slope, curvature, sums[small])
            sums[large] = sums[node] - sums[small]
            for one in (first, second):
                if total[one, COUNT] >= 2 * MIN_LEAF_SAMPLES:
                    gain[one] = _find_split(sums[one], total[one], best[one], best_left[one])
        for leaf in range(number):
            if feature[tree, leaf] < 0:
                value[tree, leaf] = (
                    -LEARNING_RATE * total[leaf, SLOPE] / (total[leaf, CURVATURE] + L2_PENALTY)
                )
                for i in range(begin[leaf], end[leaf]):
                    score[rows[i]] += value[tree, leaf]
    return feature, threshold, child, value


@jit
def _following_levels(levels):  # type: ignore[no-untyped-def]
    """Return the next level that samples have above each level, ``(features, LEVELS)``."""
    features, samples = levels.shape
    there = np.zeros((features, LEVELS), dtype=np.bool_)
    for column in range(features):
        for i in range(samples):
            there[column, levels[column, i]] = True
    following = np.zeros((features, LEVELS))
    for column in range(features):
        above = LEVELS - 1
        for level in range(LEVELS - 1, -1, -1):
            following[column, level] = above
            if there[column, level]:
                above = level
    return following


@jit
def _add_up(levels, rows, slope, curvature, sums):  # type: ignore[no-untyped-def]
    """Sum up samples of a node by feature and level, into ``sums`` ``(features, LEVELS, 3)``."""
    sums[:] = 0.0
    for column in range(levels.shape[0]):
        for row in rows:
            level = levels[column, row]
            sums[column, level, COUNT] += 1.0
            sums[column, level, SLOPE] += slope[row]
            sums[column, level, CURVATURE] += curvature[row]


@jit
def _find_split(sums, total, best, best_left):  # type: ignore[no-untyped-def]
    """Return the gain of the best split of a node, and write where it is and what lies left."""
    before = total[SLOPE] ** 2 / (total[CURVATURE] + L2_PENALTY)
    most = 0.0
    for column in range(sums.shape[0]):
        count = slope = curvature = 0.0
        for level in range(LEVELS - 1):
            if sums[column, level, COUNT] == 0.0:
                continue
            count += sums[column, level, COUNT]
            slope += sums[column, level, SLOPE]
            curvature += sums[column, level, CURVATURE]
            if (
                total[COUNT] - count < MIN_LEAF_SAMPLES
                or total[CURVATURE] - curvature < MIN_LEAF_CURVATURE
            ):
                break
            if count < MIN_LEAF_SAMPLES or curvature < MIN_LEAF_CURVATURE:
                continue
            gain = slope**2 / (curvature + L2_PENALTY) - before
            gain += (total[SLOPE] - slope) ** 2 / (total[CURVATURE] - curvature + L2_PENALTY)
            if gain > most:
                most = gain
                best[0], best[1] = column, level
                best_left[COUNT], best_left[SLOPE], best_left[CURVATURE] = count, slope, curvature
    return most


@jit
def _score(levels, feature, threshold, child, value):  # type: ignore[no-untyped-def]
    """Return the sum of the leaves of all trees that each sample falls into."""
    scores = np.zeros(levels.shape[1])
    for i in range(len(scores)):
        for tree in range(len(feature)):
            node = 0
            while feature[tree, node] >= 0:
                beyond = levels[feature[tree, node], i] > threshold[tree, node]
                node = child[tree, node] + beyond
            scores[i] += value[tree, node]
    return scores
