"""Locomotion fits: known parameters come back, the paper's rule gives the published numbers."""

import json
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from refusals import refuses
from thrust_walks import DT, ROLES, walk

from animarl_envs.demos import Demonstrations
from animarl_envs.fitting import (
    LocomotionFit,
    demonstrated_actions,
    fit_joint,
    fit_locomotion,
    transitions,
    velocity_rmse,
)
from animarl_envs.fitting.joint import bootstrap_joint
from animarl_envs.fitting.result import doubts
from animarl_envs.fitting.transitions import bootstrap_onset, onset_data
from animarl_envs.focus import focus_directions
from animarl_envs.importing.readers import read
from animarl_envs.locomotion import COAST, Locomotion

TRUTH = (Locomotion(0.3, 2.0), Locomotion(0.15, 1.2), Locomotion(0.25, 3.0))


def simulate(
    seed: int, episodes: int = 60, steps: int = 40, **errors: float
) -> tuple[Demonstrations, NDArray[np.int64]]:
    """Walks under the true parameters, with tracking errors added, and the actions."""
    return walk(TRUTH, seed, episodes=episodes, steps=steps, **errors)


def test_the_joint_fit_returns_the_true_parameters_of_exact_tracks() -> None:
    demos, _ = simulate(1)
    for found, truth in zip(fit_locomotion(demos).individuals, TRUTH, strict=True):
        assert found.damping == pytest.approx(truth.damping, abs=1e-9)
        assert found.thrust == pytest.approx(truth.thrust, abs=1e-8)
        assert found.velocity_rmse < 1e-9


def test_the_joint_fit_withstands_noise_and_tracking_jumps() -> None:
    demos, _ = simulate(2, episodes=120, noise=5e-4, jumps=0.002)
    for found, truth in zip(fit_locomotion(demos).individuals, TRUTH, strict=True):
        assert found.damping == pytest.approx(truth.damping, abs=0.01)
        assert found.thrust == pytest.approx(truth.thrust, rel=0.01)


def test_inverse_dynamics_returns_the_actions_taken() -> None:
    demos, actions = simulate(3)
    inferred = demonstrated_actions(demos, TRUTH)
    np.testing.assert_array_equal(inferred, actions)
    last = demos.offsets[1:] - 1
    assert (inferred[last] == -1).all() and (np.delete(inferred, last, axis=0) >= 0).all()


def test_the_rmse_of_exact_parameters_is_zero_and_of_wrong_ones_is_not() -> None:
    demos, _ = simulate(4)
    assert velocity_rmse(demos, 0, TRUTH[0]) < 1e-12
    # With d wrong by 0.01 the nearest action does not change, so the miss is exactly 0.01 |v|.
    speed = np.linalg.norm(transitions(demos, 0).velocity, axis=1)
    wrong = Locomotion(TRUTH[0].damping + 0.01, TRUTH[0].thrust)
    expected = 0.01 * np.sqrt(np.mean(speed**2))
    assert velocity_rmse(demos, 0, wrong) == pytest.approx(expected, rel=1e-9)


def test_the_joint_fit_is_a_minimum_of_the_squared_error() -> None:
    demos, _ = simulate(5, noise=2e-3)
    data = transitions(demos, 0)
    found = fit_joint(data)

    def loss(damping: float, thrust: float) -> float:
        rest = data.next_velocity - (1 - damping) * data.velocity
        forward = np.arctan2(data.focus[:, 1], data.focus[:, 0])
        angle = forward[:, None] + np.deg2rad(30) * np.arange(12)
        points = thrust * DT * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
        error = np.linalg.norm(rest[:, None] - points, axis=-1).min(axis=1)
        return float(np.mean(np.minimum(error, np.linalg.norm(rest, axis=1)) ** 2))

    best = loss(found.damping, found.thrust)
    for damping in np.linspace(0.0, 0.9, 10):
        for thrust in np.linspace(0.3, 4.0, 15):
            assert best <= loss(damping, thrust)
    for shift in ((1e-3, 0), (-1e-3, 0), (0, 1e-2), (0, -1e-2)):
        assert best <= loss(found.damping + shift[0], found.thrust + shift[1]) + 1e-12


def test_joint_bootstrap_spreads_like_refitting_each_resample() -> None:
    demos, _ = simulate(6, episodes=40, steps=30, noise=1e-3)
    data = transitions(demos, 1)
    fitted = fit_joint(data)
    rng = np.random.default_rng(7)
    weights = np.stack(
        [np.bincount(rng.integers(40, size=40), minlength=40) for _ in range(60)]
    ).astype(float)
    quick = bootstrap_joint(data, fitted, weights)
    slow = []
    for row in weights.astype(int):
        drawn = fit_joint(transitions(demos.select(episodes=np.repeat(np.arange(40), row)), 1))
        slow.append((drawn.damping, drawn.thrust))
    ratio = quick.std(axis=0) / np.array(slow).std(axis=0)
    assert (ratio > 0.7).all() and (ratio < 1.4).all()


def test_joint_intervals_cover_the_truth() -> None:
    """Nominal 95 %; percentile intervals of 25 episodes fall a little short of it."""
    covered = 0
    for seed in range(32):
        demos, _ = simulate(100 + seed, episodes=25, steps=20, noise=2e-5)
        data = transitions(demos, 0)
        drawn = np.random.default_rng(seed).integers(25, size=(200, 25))
        weights = np.stack([np.bincount(row, minlength=25) for row in drawn]).astype(float)
        low, high = np.quantile(
            bootstrap_joint(data, fit_joint(data), weights), [0.025, 0.975], axis=0
        )
        truth = np.array([TRUTH[0].damping, TRUTH[0].thrust])
        covered += int(np.sum((low <= truth) & (truth <= high)))
    assert covered >= 52


def test_onset_bootstrap_equals_numpy_on_each_resample() -> None:
    demos, _ = simulate(8, episodes=12)
    data = onset_data(demos, 0, onset_threshold=1.5)
    rng = np.random.default_rng(9)
    draws = [rng.integers(12, size=12) for _ in range(20)]
    weights = np.stack([np.bincount(d, minlength=12) for d in draws]).astype(float)
    for row, found in zip(weights.astype(int), bootstrap_onset(data, weights), strict=True):
        speed = np.repeat(data.speed, row[data.episode])
        onset = np.median(np.repeat(data.onset_speed, row[data.onset_episode]))
        top = np.median(speed[speed > np.quantile(speed, 0.99)])
        np.testing.assert_allclose(found, [onset / top, onset / DT], rtol=1e-12)


def test_onset_fit_without_an_onset_says_so() -> None:
    demos, _ = simulate(10, episodes=5)
    for threshold, fix in ((1e-6, "raise"), (1e6, "lower")):
        words = rf"never crosses .*: {fix} onset_threshold or use method 'joint'"
        refuses(words, fit_locomotion, demos, "onset", onset_threshold=threshold, split=None)


@pytest.mark.parametrize("thrusts", (1, 3))
def test_an_individual_that_never_moves_is_said_and_stands_still(thrusts: int) -> None:
    demos, _ = simulate(11, episodes=5)
    still = demos.positions.copy()
    still[:, 1] = 0.25
    stuck = Demonstrations(**{**vars(demos), "positions": still})
    fit = fit_locomotion(stuck, split=None, thrusts=thrusts)
    assert fit.individuals[0] == fit_locomotion(demos, split=None, thrusts=thrusts).individuals[0]
    own = fit.individuals[1]
    assert (own.damping, own.damping_interval, own.velocity_rmse) == (1.0, None, 0.0)
    actions = demonstrated_actions(stuck, fit.locomotion)[:, 1]
    assert set(actions.tolist()) == {-1, 12 * thrusts}  # none where an episode ends, and rest
    said = doubts(fit, stuck)
    assert said[0].startswith("b never moves in all: nothing is learned of how it moves")
    refuses("b has .* steps, 0 of them in motion", fit_locomotion, stuck, "noise", split=None)
    still[:] = still[0]
    nobody = Demonstrations(**{**vars(demos), "positions": still})
    refuses("no individual ever moves: check", fit_locomotion, nobody, split=None)


def test_a_single_episode_has_no_interval() -> None:
    demos, _ = simulate(12, episodes=1, steps=200)
    fit = fit_locomotion(demos, split=None)
    assert fit.validated_on == "all"
    assert all(one.damping_interval is None for one in fit.individuals)
    refuses("holds no episode", fit_locomotion, demos)


def test_fits_survive_json(tmp_path: Path) -> None:
    demos, _ = simulate(13, episodes=12)
    fit = fit_locomotion(demos, thrusts=2, bootstrap=50)
    assert {own.thrusts for own in fit.locomotion} == {2}
    assert LocomotionFit.load(fit.save(tmp_path / "fit.json")) == fit
    (tmp_path / "other.json").write_text(json.dumps({"a": 1}))
    refuses("not a locomotion fit", LocomotionFit.load, tmp_path / "other.json")


def test_same_seed_same_intervals() -> None:
    demos, _ = simulate(14, episodes=12, noise=1e-3)
    assert fit_locomotion(demos, seed=3) == fit_locomotion(demos, seed=3)
    assert fit_locomotion(demos, seed=3).individuals != fit_locomotion(demos, seed=4).individuals


def test_focus_directions() -> None:
    positions = np.array([[0.0, 0.0], [2.0, 0.0], [1.0, 1.0]])
    focus = focus_directions(positions, ROLES)
    half = np.sqrt(0.5)
    np.testing.assert_allclose(focus[0], [half, half])
    np.testing.assert_allclose(focus[1], [-half, half])
    np.testing.assert_allclose(focus[2], [-half, -half])  # both equally near: the lower index
    positions[1] = [1.0, 0.9]
    np.testing.assert_allclose(focus_directions(positions, ROLES)[2], [0.0, -1.0], atol=1e-12)
    same = np.zeros((3, 2))
    np.testing.assert_array_equal(focus_directions(same, ROLES), [[1.0, 0.0]] * 3)
    searcher = focus_directions(np.random.default_rng(0).normal(size=(5, 1, 2)), ("searcher",))
    np.testing.assert_array_equal(searcher, np.broadcast_to([-1.0, 0.0], (5, 1, 2)))


# -- the recorded agents -------------------------------------------------------------------------


@pytest.fixture(scope="module", params=["indiv", "share"])
def agents(request: pytest.FixtureRequest, data_dir: Path) -> Demonstrations:
    name = f"episodes_c2ae_{request.param}_slow2.4.npz"
    return read(data_dir / "agents_collab_hunting" / name)


@pytest.mark.realdata
def test_joint_fit_of_the_agents_is_the_truth(agents: Demonstrations) -> None:
    for one, thrust in zip(fit_locomotion(agents).individuals, (2.4, 2.4, 3.0), strict=True):
        assert one.damping == pytest.approx(0.25, abs=1e-6)
        assert one.thrust == pytest.approx(thrust, abs=1e-6)
        assert one.velocity_rmse < 1e-6


@pytest.mark.realdata
def test_onset_fit_of_the_agents_is_the_published_rule(data_dir: Path) -> None:
    path = data_dir / "agents_collab_hunting" / "episodes_c2ae_share_slow2.4.npz"
    fit = fit_locomotion(read(path), "onset", split=None, bootstrap=100)
    assert [round(one.damping, 3) for one in fit.individuals] == [0.250, 0.260, 0.273]
    assert [round(one.thrust, 3) for one in fit.individuals] == [2.316, 2.394, 3.000]
    assert min(one.onsets or 0 for one in fit.individuals) == 6


@pytest.mark.realdata
def test_actions_of_the_agents_are_those_recorded(agents: Demonstrations) -> None:
    """All of them: the share is 1, also where the recorded action is no acceleration."""
    truth = (Locomotion(0.25, 2.4), Locomotion(0.25, 2.4), Locomotion(0.25, 3.0))
    inferred, recorded = demonstrated_actions(agents, truth), agents.signals["actions"]
    accelerating = (recorded != COAST) & (recorded >= 0)
    assert np.mean(inferred[accelerating] == recorded[accelerating]) == 1.0
    assert np.mean(inferred == recorded) == 1.0
    assert np.isfinite(agents.focus()).all()
