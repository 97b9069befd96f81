"""How many pairs of frames a warping path aligns, against a path traced back by hand."""

from __future__ import annotations

import numpy as np
import pytest

from animarl_envs.dtw import dtw_alignment, dtw_distance
from animarl_envs.errors import InputError


def traced(x: np.ndarray, y: np.ndarray) -> tuple[float, int]:
    """The whole table of distances, then back from its end along the smallest predecessors."""
    cost = np.linalg.norm(x[:, None] - y[None], axis=-1)
    total = np.full((len(x) + 1, len(y) + 1), np.inf)
    total[0, 0] = 0.0
    for t in range(len(x)):
        for j in range(len(y)):
            before = min(total[t, j], total[t, j + 1], total[t + 1, j])
            total[t + 1, j + 1] = cost[t, j] + before
    t, j, pairs = len(x), len(y), 1
    while (t, j) != (1, 1):
        steps = [(t - 1, j - 1), (t - 1, j), (t, j - 1)]
        t, j = min(steps, key=lambda step: total[step])
        pairs += 1
    return float(total[-1, -1]), pairs


def test_alignment_equals_a_path_traced_back() -> None:
    rng = np.random.default_rng(0)
    for _ in range(20):
        x, y = (rng.normal(size=(int(rng.integers(1, 15)), 2)) for _ in range(2))
        distance, pairs = dtw_alignment(x, y)
        assert (distance, pairs) == pytest.approx(traced(x, y))
        assert distance == dtw_distance(x, y)
        assert max(len(x), len(y)) <= pairs < len(x) + len(y)


def test_equal_paths_align_frame_by_frame_and_one_frame_with_all() -> None:
    path = np.random.default_rng(1).normal(size=(9, 2))
    assert dtw_alignment(path, path) == (0.0, 9)
    still = np.zeros((9, 2))
    assert dtw_alignment(still, still) == (0.0, 9)
    assert dtw_alignment(path[:1], path)[1] == 9
    with pytest.raises(InputError, match="frames, 2"):
        dtw_alignment(path, path[:, :1])
