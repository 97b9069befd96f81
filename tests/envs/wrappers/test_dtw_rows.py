"""DTW rows, and the tracker that keeps them, against a textbook DTW and an independent library."""

from dataclasses import dataclass, field
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from refusals import refuses
from textbook_dtw import closeness, textbook

from animarl_envs.dtw import DTWTracker, dtw_alignment, dtw_distance


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 30), st.integers(1, 30))
def test_closed_end_equals_the_textbook(seed: int, n: int, m: int) -> None:
    rng = np.random.default_rng(seed)
    x, y = rng.normal(size=(n, 2)), rng.normal(size=(m, 2))
    assert dtw_distance(x, y) == pytest.approx(textbook(x, y)[-1, -1], abs=1e-9)


@pytest.mark.parametrize(
    ("x", "y"),
    [
        ((3, 3), (3, 2)), ((3, 2), (3, 3)), ((3, 1), (3, 2)), ((3, 2), (3, 1)), ((0, 2), (3, 2)),
        ((3, 2), (0, 2)), ((3,), (3, 2)), ((3, 2), (3,)), ((3, 2, 1), (3, 2)), ((3, 2), (3, 2, 1)),
    ],
)  # fmt: skip
def test_misshapen_paths_are_refused(x: tuple[int, ...], y: tuple[int, ...]) -> None:
    refuses("shapes", dtw_distance, np.zeros(x), np.zeros(y))


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
    # Equal paths frame by frame, and one frame with all.
    path = np.random.default_rng(1).normal(size=(9, 2))
    assert dtw_alignment(path, path) == (0.0, 9)
    still = np.zeros((9, 2))
    assert dtw_alignment(still, still) == (0.0, 9)
    assert dtw_alignment(path[:1], path)[1] == 9
    refuses("frames, 2", dtw_alignment, path, path[:, :1])


COPIES, FOLLOWED = 5, (0, 2)


@dataclass
class Walk:
    """Three individuals walk at random beside recordings of 4, 9, 1 and 6 frames."""

    reward_components: tuple[str, ...] = ("contact", "elapsed", "boundary")
    num_copies: int = COPIES
    rng: np.random.Generator = field(default_factory=lambda: np.random.default_rng(0))

    def __post_init__(self) -> None:
        lengths = np.array([4, 9, 1, 6])
        offsets = np.concatenate([[0], lengths.cumsum()])
        steps = self.rng.normal(size=(offsets[-1], 3, 2))
        self.demos = SimpleNamespace(
            positions=steps.cumsum(axis=0), offsets=offsets, lengths=lengths
        )
        self.position = np.zeros((COPIES, 3, 2))
        self.components = np.zeros((COPIES, 3, 3))
        self.demo = np.full(COPIES, -1, dtype=np.int64)
        self.step_count = np.zeros(COPIES, dtype=np.int64)
        self.paths: list[list[NDArray[np.float64]]] = [[] for _ in range(COPIES)]

    def recorded(self, copy: int) -> NDArray[np.float64]:
        begin, end = self.demos.offsets[self.demo[copy] :][:2]
        return np.asarray(self.demos.positions[begin:end])

    def start(self, copies: NDArray[np.bool_]) -> None:
        for b in np.flatnonzero(copies):
            self.demo[b] = self.rng.integers(4)
            self.step_count[b] = 0
            self.position[b] = self.recorded(b)[0] + 0.1 * self.rng.normal(size=(3, 2))
            self.paths[b] = [self.position[b].copy()]

    def step(self) -> None:
        self.position += 0.7 * self.rng.normal(size=self.position.shape)
        self.components = self.rng.normal(size=self.components.shape)
        self.step_count += 1
        for b in range(COPIES):
            self.paths[b].append(self.position[b].copy())

    def rows(self, copy: int, who: int) -> NDArray[np.float64]:
        return textbook(np.array(self.paths[copy])[:, who], self.recorded(copy)[:, who])


def tracker(world: Walk, kind: str = "closeness") -> DTWTracker:
    return DTWTracker(world.demos, COPIES, np.array(FOLLOWED), 0.8, kind)  # type: ignore[arg-type]


def expected_penalty(world: Walk, copy: int, who: int, kind: str) -> float:
    minimum = world.rows(copy, who).min(axis=1)
    if kind == "cumulative":
        return float(minimum[-1])
    if kind == "increment":
        return float(minimum[-1] - minimum[-2])
    recorded = world.recorded(copy)[:, who]
    if world.step_count[copy] < len(recorded):
        return -float(closeness(np.array(world.paths[copy])[:, who], recorded, 2, 0.8)[-1])
    return 0.0


def expected_refund(world: Walk, copy: int, who: int, kind: str) -> float:
    """Of what is paid for lasting, after the recording."""
    over = world.step_count[copy] >= len(world.recorded(copy))
    named = "elapsed" in world.reward_components and kind == "closeness"
    return float(world.components[copy, who, 1]) if over and named else 0.0


@pytest.mark.parametrize(
    ("kind", "named"),
    [("closeness", True), ("closeness", False), ("increment", True), ("cumulative", True)],
)
def test_each_copy_and_individual_has_its_own_rows(kind: str, named: bool) -> None:
    world = Walk() if named else Walk(reward_components=("contact", "boundary"))
    follows = tracker(world, kind)
    everybody = np.ones(COPIES, dtype=bool)
    world.start(everybody)
    follows.started(world, everybody)
    assert (follows.penalty == 0.0).all()
    for _ in range(40):
        world.step()
        follows.stepped(world)
        for b in range(COPIES):
            for f, who in enumerate(FOLLOWED):
                row = world.rows(b, who)[-1]
                assert follows.row_minimum[b, f] == pytest.approx(row.min())
                assert follows.aligned[b, f] == row.argmin()
                assert follows.penalty[b, f] == pytest.approx(expected_penalty(world, b, who, kind))
                assert follows.refund[b, f] == expected_refund(world, b, who, kind)
        minimum, aligned = follows.row_minimum.copy(), follows.aligned.copy()
        again = world.rng.random(COPIES) < 0.1
        world.start(again)
        follows.started(world, again)
        # Of the step that ended the episode, not of the start that followed.
        np.testing.assert_array_equal(follows.final_minimum, minimum)
        np.testing.assert_array_equal(follows.final_aligned, aligned)
        for b in np.flatnonzero(again):
            assert follows.row_minimum[b, 1] == pytest.approx(world.rows(b, FOLLOWED[1]).min())


@pytest.mark.parametrize("kind", DTWTracker.KINDS)
def test_a_tracker_continues_from_its_state(kind: str) -> None:
    world = Walk()
    first, second = tracker(world, kind), tracker(world, kind)
    everybody = np.ones(COPIES, dtype=bool)
    world.start(everybody)
    first.started(world, everybody)
    for _ in range(2):
        world.step()
        first.stepped(world)
    second.set_state(first.get_state())
    np.testing.assert_array_equal(second.penalty, first.penalty)
    world.step()
    for follows in (first, second):
        follows.stepped(world)
    np.testing.assert_array_equal(second.penalty, first.penalty)
    np.testing.assert_array_equal(second.aligned, first.aligned)


def test_a_band_reaches_two_frames_either_way() -> None:
    """Who follows two frames early is paid in full, three frames early less."""
    world = Walk()
    recorded = np.zeros((9, 3, 2))
    recorded[:, :, 0] = np.arange(9.0)[:, None]
    world.demos.positions[4:13] = recorded
    paid = {}
    for early in (2, 3):
        follows = tracker(world)
        world.demo[:], world.step_count[:] = 1, 0
        world.position = np.tile(recorded[0], (COPIES, 1, 1))
        follows.started(world, np.ones(COPIES, dtype=bool))
        for frame in range(1, 6):
            world.step_count += 1
            world.position = np.tile(recorded[min(frame + early, 8)], (COPIES, 1, 1))
            follows.stepped(world)
        paid[early] = follows.penalty[0, 0]
    assert paid[2] == -1.0 and paid[3] > -1.0


def test_a_tracker_needs_demonstrations_and_episodes_that_start_from_them() -> None:
    world = Walk()
    refuses("choose closeness, increment, cumulative", tracker, world, "near")
    refuses("start without any", DTWTracker, None, COPIES, np.array(FOLLOWED), 0.8)
    follows = tracker(world)
    world.start(np.arange(COPIES) < 3)
    follows.started(world, np.arange(COPIES) < 3)  # the others are not asked for
    for copies in (np.ones(COPIES, dtype=bool), np.arange(COPIES) == 4):
        refuses("start='demo'", follows.started, world, copies)
    assert DTWTracker(world.demos, 1, np.array([0]), 1.0).kind == "closeness"  # type: ignore[arg-type]
