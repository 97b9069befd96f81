"""Damping and thrust of noisy tracks, against walks whose truth is known."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from commands import animarl
from moving_pairs import recorded_pairs
from recordings import write_tracks
from small_runs import few
from thrust_walks import walk
from typer.testing import CliRunner

from animarl_algos.cli.describing import hints
from animarl_algos.cli.main import app
from animarl_algos.runs import pipeline
from animarl_algos.runs.run_settings import RunSettings
from animarl_envs.demos.episode import TIME_OUT
from animarl_envs.demos.summary import persistence
from animarl_envs.fitting import fit_joint, fit_locomotion, transitions
from animarl_envs.fitting.noise import fit_with_noise
from animarl_envs.locomotion import Locomotion


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


def test_the_fit_of_all_individuals_says_the_noise() -> None:
    demos, noise = noisy(0.2, 0.1, episodes=12)
    fit = fit_locomotion(demos, "noise", split=None)
    assert fit.method == "noise"
    assert [one.tracking_noise for one in fit.individuals] == pytest.approx([noise] * 3, rel=0.2)


def test_animarl_fit_warns_of_noise_that_matters(tmp_path) -> None:  # type: ignore[no-untyped-def]
    for share, warned in ((0.14, True), (0.0, False)):
        demos, _ = noisy(0.2, share)
        real = replace(demos, provenance={**demos.provenance, "synthetic": False})
        file = real.save(tmp_path / f"{share}.npz")
        done = CliRunner().invoke(app, ["fit", str(file), "--bootstrap", "0"])
        assert done.exit_code == 0, done.output
        assert ("see --method noise" in done.output) == warned


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


def test_smoothed_tracks_are_not_advised_to_be_smoothed_so_again() -> None:
    rng = np.random.default_rng(0)
    demos = recorded_pairs()
    demos = replace(demos, positions=demos.positions + rng.normal(0, 0.1, demos.positions.shape))
    for cutoff, advised in ((None, True), (8.0, True), (2.0, False)):
        done = {"smoothing": {"cutoff_hz": cutoff}} if cutoff else {}
        told = {**demos.provenance, "synthetic": False, "cleaning": {"r": done}}
        found = hints(replace(demos, provenance=told))
        assert any("--smoothing 2" in hint for hint in found) == advised
