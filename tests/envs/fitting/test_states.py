"""States of locomotion: a known law is found again, and one state is not taken for two."""

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from commands import animarl
from refusals import refuses
from thrust_walks import DT, walk

from animarl_envs.demos import Demonstrations
from animarl_envs.fitting.states import compare_states
from animarl_envs.locomotion import Locomotion

FAST = tuple(Locomotion(d, u) for d, u in ((0.2, 2.0), (0.25, 2.4), (0.3, 3.0)))
SLOW = tuple(Locomotion(0.6, 0.4) for _ in FAST)


@pytest.fixture(scope="module")
def two() -> Demonstrations:
    return walk(FAST, seed=0, slow=SLOW, steps=100)[0]


def test_two_states_are_recovered(two: Demonstrations) -> None:
    for i, (fast, slow) in enumerate(zip(FAST, SLOW, strict=True)):
        (fit,), _ = compare_states(two, i, (2,), (1,))
        np.testing.assert_allclose(fit.damping, [slow.damping, fast.damping], atol=0.03)
        np.testing.assert_allclose(fit.thrusts[:, 0], [slow.thrust, fast.thrust], rtol=0.05)
        np.testing.assert_allclose(fit.bout, 20 * DT, rtol=0.3)  # a chance of one in twenty
        np.testing.assert_allclose(fit.share, 0.5, atol=0.15)


def test_states_are_chosen_that_explain_held_out_steps(two: Demonstrations) -> None:
    fits, best = compare_states(two, 0, (1, 2, 3), (1, 2))
    assert fits[best].thrusts.shape == (2, 1)
    of_one = walk(FAST, seed=1)[0]
    fits, best = compare_states(of_one, 0, (1, 2), (1, 2))
    assert fits[best].thrusts.shape == (1, 1)


def test_states_look_at_no_test_episode(two: Demonstrations) -> None:
    spoilt = two.positions.copy()
    for episode in np.flatnonzero(two.split == "test"):
        spoilt[two.offsets[episode] : two.offsets[episode + 1]] = 0.0
    (without,), _ = compare_states(replace(two, positions=spoilt), 0, (2,), (1,))
    (whole,), _ = compare_states(two, 0, (2,), (1,))
    np.testing.assert_array_equal(without.held_out, whole.held_out)


def test_the_table_of_states_is_printed_and_saved(two: Demonstrations, tmp_path: Path) -> None:
    file, out = two.save(tmp_path / "two.npz"), tmp_path / "states.csv"
    said = animarl("fit", file, "--states", "1,2", "--thrusts", "1", "--out", out)
    assert "a: best explained by 2 states with 1 thrust" in said
    rows = list(csv.DictReader(out.read_text().splitlines()))
    assert [(row["individual"], row["states"], row["state"]) for row in rows] == [
        (name, *pair) for name in "abc" for pair in (("1", "1"), ("2", "1"), ("2", "2"))
    ]
    assert float(rows[1]["held_out"]) > float(rows[0]["held_out"]) + 0.1


def test_a_state_that_holds_hardly_a_step_is_said(two: Demonstrations, tmp_path: Path) -> None:
    said = animarl("fit", two.save(tmp_path / "two.npz"), "--states", "3", "--thrusts", "1")
    told = "a: 3 states with 1 thrust are not supported by these recordings"
    assert told in " ".join(said.split())


def test_who_never_moves_has_no_states_and_the_others_are_told(
    two: Demonstrations, tmp_path: Path
) -> None:
    still = two.positions.copy()
    still[:, 1] = 0.25
    file = replace(two, positions=still).save(tmp_path / "still.npz")
    given = ("fit", file, "--states", "1", "--thrusts", "1")
    output = animarl(*given)
    assert "b: never moves in train, so that it has no states" in output
    assert "a: best explained by 1 state with 1 thrust" in output
    still[:] = still[0]
    replace(two, positions=still).save(file)
    refuses("no individual ever moves in train: check the tracks", animarl, *given)


def test_states_of_an_episode_shorter_than_a_second(two: Demonstrations) -> None:
    short = np.concatenate([np.arange(first, first + 6) for first in two.offsets[:-1]])
    tiny = replace(two, positions=two.positions[short], lengths=np.full(len(two), 6))
    few = [int(np.flatnonzero(two.split == split)[0]) for split in ("train", "val")]
    (fit,), _ = compare_states(tiny.select(episodes=np.array(few)), 0, (2,), (1,))
    assert 6 * two.dt < 1.0 and np.isfinite(fit.held_out).all()


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        (("--states", "0"), "--states is '0': give whole numbers from 1 to 5"),
        (("--states", "2", "--method", "onset"), "--states goes with the joint fit"),
        (("--states", "2", "--split", "all"), "leave --split out"),
    ],
)
def test_bad_states_are_refused(options: tuple[str, ...], sentence: str) -> None:
    refuses(sentence, animarl, "fit", "fly", *options)


def test_states_need_episodes_to_validate_on(two: Demonstrations) -> None:
    refuses("no val episodes", compare_states, two.select(split="train"), 0, (2,), (1,))
