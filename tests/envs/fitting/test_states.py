"""States of locomotion and noisy tracks: a known law is found again, one state is not two."""

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from commands import animarl
from moving_pairs import recorded_pairs
from recordings import write_tracks
from refusals import refuses
from small_runs import few
from thrust_walks import DT, walk

from animarl_algos.cli.describing import hints
from animarl_algos.runs import pipeline
from animarl_algos.runs.run_settings import RunSettings
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.episode import TIME_OUT
from animarl_envs.demos.summary import persistence
from animarl_envs.fitting.joint import fit_joint
from animarl_envs.fitting.noise import fit_with_noise
from animarl_envs.fitting.result import fit_locomotion
from animarl_envs.fitting.states import compare_states
from animarl_envs.fitting.transitions import transitions
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
    assert float(rows[1]["floor"]) < 0.65 < 0.9 < float(rows[0]["floor"])
    assert float(said.partition("their floor is ")[2][:4]) > 0.8
    assert f"The lowest of this table is {float(rows[1]['floor']):.2f}, of 2 states with 1" in said
    said = " ".join(animarl("fit", file, "--states", "3", "--thrusts", "1").split())
    assert "a: 3 states with 1 thrust are not supported by these recordings" in said


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
    refuses("no val episodes", compare_states, two.select(split="train"), 0, (2,), (1,))


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


def noisy(damping: float, share: float, seed: int = 1, episodes: int = 40):  # type: ignore[no-untyped-def]
    """Walks with thrust 3 whose noise is such a share of the median step, and the noise."""
    truth = (Locomotion(damping, 3.0),) * 3
    exact, _ = walk(truth, seed, episodes=episodes)
    step = float(np.median(np.linalg.norm(exact.velocities()[:, 0], axis=1))) * exact.dt
    return walk(truth, seed, episodes=episodes, noise=share * step)[0], share * step


@pytest.mark.parametrize(("damping", "share"), [(0.2, 0.14), (0.014, 0.09)])
def test_noise_that_misleads_the_joint_fit_is_told_from_motion(
    damping: float, share: float
) -> None:
    demos, noise = noisy(damping, share)
    joint, found = fit_joint(transitions(demos, 0)), fit_with_noise(demos, 0)
    assert joint.thrust > 1.4 * 3.0  # what a fit that knows of no noise makes of it
    assert found.thrust == pytest.approx(3.0, rel=0.05)
    assert found.damping == pytest.approx(damping, rel=0.08)
    assert found.noise == pytest.approx(noise, rel=0.1)
    for interval, true in (
        (found.thrust_interval, 3.0),
        (found.damping_interval, damping),
        (found.noise_interval, noise),
    ):
        assert interval is not None and interval[0] < true < interval[1]


def test_exact_tracks_have_no_noise_and_the_joint_fit() -> None:
    demos, _ = noisy(0.2, 0.0, episodes=10)
    found = fit_with_noise(demos, 0)
    assert found.noise == 0.0 and found.thrust_interval is None
    assert (found.damping, found.thrust) == pytest.approx((0.2, 3.0), rel=1e-6)


def test_animarl_fit_warns_of_noise_that_matters(tmp_path) -> None:  # type: ignore[no-untyped-def]
    for share, warned in ((0.14, True), (0.0, False)):
        demos, _ = noisy(0.2, share)
        real = replace(demos, provenance={**demos.provenance, "synthetic": False})
        file = real.save(tmp_path / f"{share}.npz")
        assert ("see --method noise" in animarl("fit", file, "--bootstrap", 0)) == warned


def test_a_run_takes_it_with_one_thrust(tmp_path: Path) -> None:
    asked = RunSettings(
        file="few.npz", species="agent", algo="dqn", steps=20, copies=2, fit_method="noise"
    )
    fit = pipeline.fit(pipeline.open_run(asked, tmp_path / "run", "animarl train", few()))
    assert fit.method == "noise"
    assert all(one.tracking_noise is not None for one in fit.individuals)
    assert all(one.magnitudes == (1.0,) for one in fit.individuals)


def test_persistence_is_one_of_steady_motion_and_minus_one_half_of_noise() -> None:
    steady = np.linspace(0.0, 1.0, 2001)[:, None] * [0.3, -0.4]
    noise = np.random.default_rng(0).normal(0.0, 0.01, (2001, 2))
    still = np.zeros((2001, 2))
    demos = replace(
        recorded_pairs(), individuals=("steady", "noisy", "still"),
        roles=("pursuer", "pursuer", "target"),
        positions=np.stack([steady, noise, still], axis=1), lengths=np.array([2001]),
        initial_velocity=np.zeros((1, 3, 2)), condition=np.zeros(1), outcome=[TIME_OUT],
        split=np.array(["test"]), recording=np.array(["r"]),
    )  # fmt: skip
    assert persistence(demos) == pytest.approx([1.0, -0.5, np.nan], abs=0.05, nan_ok=True)


def test_an_import_of_jumping_tracks_hints_at_smoothing(tmp_path: Path) -> None:
    angle = np.linspace(0.0, 20.0, 1500)[:, None] + [0.0, 1.0]
    path = 400.0 + 150.0 * np.stack([np.cos(angle), np.sin(angle)], axis=2)
    jumping = path + np.random.default_rng(1).normal(0.0, 1.5, path.shape)  # a step is 2 px long
    pair = write_tracks(tmp_path / "pair.csv", jumping, ("male", "female"))
    words = ("import", pair, "--fps", 25, "--target", "female", "--dry-run")
    assert "consider --smoothing 2" in animarl(*words)
    assert "consider --smoothing" not in animarl(*words, "--smoothing", 2)
    rng = np.random.default_rng(0)
    demos = recorded_pairs()
    demos = replace(demos, positions=demos.positions + rng.normal(0, 0.1, demos.positions.shape))
    for cutoff, advised in ((None, True), (8.0, True), (2.0, False)):
        done = {"smoothing": {"cutoff_hz": cutoff}} if cutoff else {}
        told = {**demos.provenance, "synthetic": False, "cleaning": {"r": done}}
        found = hints(replace(demos, provenance=told))
        assert any("--smoothing 2" in hint for hint in found) == advised


def test_the_fit_of_all_individuals_says_the_noise() -> None:
    demos, noise = noisy(0.2, 0.1, episodes=12)
    fit = fit_locomotion(demos, "noise", split=None)
    assert fit.method == "noise"
    assert [one.tracking_noise for one in fit.individuals] == pytest.approx([noise] * 3, rel=0.2)
