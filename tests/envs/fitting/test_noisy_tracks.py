"""Noisy tracks: how noise is measured, and that a fit or an import that it misleads is doubted."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from commands import animarl
from moving_pairs import recorded_pairs
from recordings import write_tracks
from thrust_walks import walk

from animarl_algos.cli.describing import hints
from animarl_envs.demos.episode import TIME_OUT
from animarl_envs.demos.summary import persistence, tracking_noise
from animarl_envs.fitting.result import doubts, fit_locomotion
from animarl_envs.locomotion import Locomotion


def noisy(damping: float, share: float, seed: int = 1, episodes: int = 40):  # type: ignore[no-untyped-def]
    """Walks with thrust 3 whose noise is such a share of the median step, and the noise."""
    truth = (Locomotion(damping, 3.0),) * 3
    exact, _ = walk(truth, seed, episodes=episodes)
    step = float(np.median(np.linalg.norm(exact.velocities()[:, 0], axis=1))) * exact.dt
    return walk(truth, seed, episodes=episodes, noise=share * step)[0], share * step


@pytest.mark.parametrize(("damping", "share"), [(0.2, 0.2), (0.014, 0.14)])
def test_noise_that_misleads_the_joint_fit_is_measured_and_doubted(
    damping: float, share: float
) -> None:
    for given, doubted in ((share, True), (0.0, False)):
        demos, noise = noisy(damping, given)
        fit = fit_locomotion(demos, bootstrap=0)
        assert (fit.individuals[0].thrust > 1.4 * 3.0) == doubted
        found = tracking_noise(one.positions[:, :1] for one in demos)
        assert found == pytest.approx(noise, rel=0.1)
        real = replace(demos, provenance={**demos.provenance, "synthetic": False})
        said = [one for one in doubts(fit, real) if "accelerations oppose each other" in one]
        assert len(said) == doubted and ("a: " in "".join(said)) == doubted
        assert not any("oppose" in one for one in doubts(fit, demos))  # made, so without noise


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
