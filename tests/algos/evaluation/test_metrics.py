"""Metrics of episodes and their counterfactual table: known answers on paths drawn by hand."""

import numpy as np
import pytest
from moving_pairs import demonstrations_of, rollouts_along
from numpy.typing import NDArray

from animarl_algos.evaluation.metrics import measure, measure_recordings
from animarl_algos.evaluation.prepared import dtw_alignments, path_lengths
from animarl_algos.evaluation.rollouts import Rollouts
from animarl_envs.arena import Arena
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.errors import InputError


def line(frames: int, step: tuple[float, float], start: tuple[float, float]) -> NDArray[np.float64]:
    return np.asarray(start) + np.arange(frames)[:, None] * np.asarray(step)


def chase(frames: int, speed: float) -> NDArray[np.float64]:
    """Two pursuers, of step ``speed`` and twice that, and a target at rest."""
    return np.stack(
        [
            line(frames, (speed, 0.0), (-0.5, 0.0)),
            line(frames, (0.0, 2 * speed), (0.0, -0.5)),
            line(frames, (0.0, 0.0), (0.3, 0.3)),
        ],
        axis=1,
    )


@pytest.fixture
def demos() -> Demonstrations:
    paths = [chase(11, 0.02), chase(6, 0.01), chase(21, 0.03)]
    return demonstrations_of(paths, condition=[0, 1, 1], outcome=[1, 0, 2])


def rollouts(demos: Demonstrations, demo: list[int], paths: list[NDArray[np.float64]]) -> Rollouts:
    return rollouts_along(paths, demos, demo, outcome=[1, 0, -1, 2][: len(demo)])


def test_path_length_is_that_of_each_episode_alone(demos: Demonstrations) -> None:
    made = rollouts(demos, [0, 1], [chase(4, 0.1), chase(3, 0.2)])
    assert path_lengths(made) == pytest.approx(np.array([[0.3, 0.6, 0.0], [0.4, 0.8, 0.0]]))


def test_measures_of_the_recordings(demos: Demonstrations) -> None:
    table = measure_recordings(demos)
    assert table["method"].unique().tolist() == ["recorded"]
    assert table["reached"].tolist() == [1.0, 0.0, 1.0]
    assert table["duration"].to_numpy() == pytest.approx([1.0, 0.5, 2.0])
    assert table["path_length"].to_numpy() == pytest.approx([0.3, 0.075, 0.9])  # pursuers only
    assert (table["dtw"] == 0.0).all() and (table["dtw_per_step"] == 0.0).all()


def test_reached_counts_captures_by_a_pursuer_only(demos: Demonstrations) -> None:
    """Contact counts; a target that leaves, a pursuer that leaves and a time-out do not."""
    table = measure(rollouts(demos, [0, 0, 0, 0], [chase(3, 0.1)] * 4), demos)
    assert table["reached"].tolist() == [1.0, 0.0, 0.0, 1.0]
    assert table["captured"].tolist() == [True, False, False, True]


def test_dtw_known_answers(demos: Demonstrations) -> None:
    shifted = demos.episode(0).positions + [0.0, 0.25]
    slower = np.repeat(demos.episode(0).positions, 2, axis=0)  # the same path at half the speed
    made = rollouts(demos, [0, 0, 0], [demos.episode(0).positions, slower, shifted])
    distances, pairs = dtw_alignments(made, demos)
    assert distances[0] == pytest.approx(0.0) and distances[1] == pytest.approx(0.0)
    assert distances[2, [0, 2]] == pytest.approx(11 * 0.25)  # crosswise to the path, or at rest
    table = measure(made, demos)
    assert table["dtw"][2] == pytest.approx(distances[2, :2].mean())
    # The second pursuer moves along the shift: its path is aligned in 17 pairs, not 11.
    assert pairs[2].tolist() == [11, 17, 11]
    per_step = (distances[2, 0] / 11 + distances[2, 1] / 17) / 2
    assert table["dtw_per_step"][2] == pytest.approx(per_step)


def test_dtw_equals_a_textbook_recursion(demos: Demonstrations) -> None:
    rng = np.random.default_rng(0)
    path = rng.uniform(-1, 1, (9, 3, 2))
    made = rollouts(demos, [2], [path])
    for k in range(3):
        x, y = path[:, k], demos.episode(2).positions[:, k]
        cost = np.linalg.norm(x[:, None] - y[None], axis=-1)
        total = np.full((len(x) + 1, len(y) + 1), np.inf)
        total[0, 0] = 0.0
        for t in range(len(x)):
            for j in range(len(y)):
                before = min(total[t, j], total[t, j + 1], total[t + 1, j])
                total[t + 1, j + 1] = cost[t, j] + before
        assert dtw_alignments(made, demos)[0][0, k] == pytest.approx(total[-1, -1], abs=1e-9)


def test_a_lone_searcher_is_measured_itself() -> None:
    path = line(5, (0.1, 0.0), (0.0, 0.0))[:, None]
    demos = demonstrations_of(
        [path], species="silkmoth", individuals=("moth",), roles=("searcher",), dt=0.5,
        arena=Arena("open", size=1.0), outcome=[1],
    )  # fmt: skip
    table = measure_recordings(demos)
    assert table["path_length"][0] == pytest.approx(0.4)
    assert table["duration"][0] == 2.0 and table["reached"][0] == 1.0


def test_foreign_rollouts_are_refused(demos: Demonstrations) -> None:
    made = rollouts(demos, [2], [chase(3, 0.1)])
    with pytest.raises(InputError, match="were not made from"):
        measure(made, demos.select(episodes=[0, 1]))
