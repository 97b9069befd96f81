"""The simple law that a simulator should beat: what it recovers, and what it does not know."""

from dataclasses import replace

import numpy as np
import pytest

from animarl_algos.evaluation.headline import compare_with_law
from animarl_algos.evaluation.laws import EACH, LAW, Law
from animarl_algos.evaluation.prepared import Prepared
from animarl_algos.evaluation.verdict import verdict
from animarl_envs.demos.packaged import load_packaged
from benchmarks.known_worlds import WORLDS


def test_a_law_recovers_the_numbers_that_it_was_simulated_with() -> None:
    recorded = WORLDS["free pair"].recordings(30, np.random.default_rng(0))
    prepared = Prepared(recorded)
    law = Law(
        speed=np.array([[0.3, 0.05, 0.8], [0.2, 0.03, 0.5]]),
        turn=np.array([[0.0, 0.2, 0.4], [0.05, 0.1, 0.0]]),
        edges=np.array([[0.5, 1.0]] * 2),
        gains=np.array([[-0.2, 0.0, 0.2], [0.0, 0.0, 0.0]]),
        navigation=np.zeros(2),
    )
    again = Law.fit(law.rollouts(prepared, np.random.default_rng(1)))
    assert again.speed == pytest.approx(law.speed, abs=0.03)
    assert again.turn == pytest.approx(law.turn, abs=0.05)
    assert again.gains[0, 0] < -0.02 and again.gains[0, 2] > 0.1  # other zones
    assert np.abs(again.gains[1]).max() < 0.05


def test_a_law_of_a_chase_recovers_proportional_navigation() -> None:
    prepared = Prepared(WORLDS["chase"].recordings(30, np.random.default_rng(0)))
    fitted = Law.fit(prepared.recorded)
    law = replace(fitted, gains=0 * fitted.gains, navigation=np.array([2.0, 0.0]))
    again = Law.fit(law.rollouts(prepared, np.random.default_rng(1)))
    assert again.navigation == pytest.approx(law.navigation, abs=0.3)
    assert np.abs(again.gains).max() < 0.1


def test_a_law_pursues_the_target_and_keeps_animals_of_a_shoal_apart() -> None:
    chase = WORLDS["chase"].recordings(30, np.random.default_rng(0))
    assert (Law.fit(Prepared(chase).recorded).gains[0] > 0.05).all()
    shoal = load_packaged("shoal").select(split="test")
    gains = Law.fit(Prepared(shoal).recorded).gains[0]
    assert gains[0] < 0 < gains[-1]  # repulsion when near, attraction when far


def test_a_law_starts_where_recordings_do_and_stays_within_walls() -> None:
    solo = load_packaged("shoal").select(split="test")
    prepared = Prepared(solo)
    made = Law.fit(prepared.recorded).rollouts(prepared, np.random.default_rng(0))
    assert made.method == LAW and len(made) == EACH * len(solo)
    assert (made.lengths == np.repeat(solo.lengths, EACH)).all()
    for i in range(len(made)):
        assert np.array_equal(made.path(i)[0], prepared.recorded.path(i // EACH)[0])
    assert solo.arena.contains(made.positions, margin=1e-9).all()


@pytest.mark.slow
def test_a_law_stands_beside_the_rows_and_is_beaten_by_a_perfect_simulator() -> None:
    world, rng = WORLDS["free pair"], np.random.default_rng(0)
    recorded = world.recordings(12, rng)
    found = verdict(recorded, world.rollouts(recorded, 2, rng), seed=0)
    assert np.isfinite(found.row("mean_speed")["law"])
    assert compare_with_law(found.rows()).startswith("The simulator beats a simple law in ")
    order = found.row("order in time")
    assert abs(order["value"]) < abs(order["law"] - order["recorded"])
