"""The exact rank of recordings among their rollouts."""

import numpy as np
import pytest
from moving_pairs import recorded_pairs, simulated_pairs

from animarl_algos.evaluation.ranks import Ranks, exact_ranks, rank_recordings
from animarl_algos.evaluation.verdict import compare

STARTS, EACH, MEASURES = 20, 5, 3


def ranks_of(rng: np.random.Generator, spread: float, shift: float = 0.0) -> Ranks:
    """Ranks among rollouts that are so much narrower, and higher, than recordings."""
    centre = rng.normal(size=(STARTS, MEASURES))
    demo = np.repeat(np.arange(STARTS), EACH)
    recorded = centre + rng.normal(size=centre.shape)
    simulated = centre[demo] + shift + spread * rng.normal(size=(len(demo), MEASURES))
    return exact_ranks(recorded, simulated, demo, np.arange(STARTS), ("a", "b", "c"), rng)


def test_ranks_of_a_perfect_simulator_are_uniform() -> None:
    rng = np.random.default_rng(0)
    found = [ranks_of(rng, 1.0) for _ in range(60)]
    assert np.mean([one.p <= 0.05 for one in found]) <= 0.15
    every = np.concatenate([one.values.ravel() for one in found])
    shares = np.unique(every, return_counts=True)[1] / len(every)
    assert shares == pytest.approx(np.full(EACH + 1, 1 / (EACH + 1)), abs=0.03)


@pytest.mark.parametrize(("spread", "shift"), [(0.2, 0.0), (1.0, 1.5)])
def test_ranks_of_rollouts_that_are_too_much_alike_or_too_high(spread: float, shift: float) -> None:
    rng = np.random.default_rng(1)
    found = [ranks_of(rng, spread, shift) for _ in range(20)]
    assert np.mean([one.p <= 0.05 for one in found]) >= 0.7


def test_ranks_count_a_recording_once_and_leave_out_what_is_undefined() -> None:
    rng = np.random.default_rng(2)
    recorded = np.array([[1.0, np.nan], [5.0, 5.0], [2.5, 2.0]])
    demo = np.repeat(np.arange(3), 3)
    simulated = np.tile([[1.5, 1.0], [2.0, np.nan], [3.0, 3.0]], (3, 1))
    found = exact_ranks(recorded, simulated, demo, np.array([0, 0, 1]), ("a", "b"), rng)
    assert found.values[:, 0] == pytest.approx([0.5 / 4, 2.5 / 4])
    assert np.isnan(found.values[0, 1]) and found.values[1, 1] == pytest.approx(1.5 / 3)


def test_ranks_stand_in_the_comparison() -> None:
    demos = recorded_pairs()
    rng = np.random.default_rng(0)
    true, still = (
        rank_recordings(compare(demos, simulated_pairs(demos, kind), 0)[0], rng)
        for kind in ("true", "still")
    )
    assert {"Mean speed", "Realism"} <= set(true.measures)
    assert len(true.values) == len(demos)
    assert true.p > 0.05 >= still.p
