"""Fits of locomotion: known parameters come back, as the paper's rule has them; doubts are said."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from moving_pairs import implausible, recorded_pairs, simulated_pairs
from numpy.typing import NDArray
from recordings import episodes_along
from refusals import refuses
from thrust_walks import DT, ROLES, walk

from animarl_algos.evaluation.verdict import verdict
from animarl_envs.arena import Arena
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.fitting.joint import bootstrap_joint, fit_joint
from animarl_envs.fitting.result import LocomotionFit, doubts, fit_locomotion
from animarl_envs.fitting.transitions import (
    Transitions,
    bootstrap_onset,
    demonstrated_actions,
    onset_data,
    transitions,
    velocity_rmse,
)
from animarl_envs.focus import focus_directions
from animarl_envs.importing.readers import read
from animarl_envs.locomotion import ACTION_VECTORS, COAST, Locomotion

TRUTH = (Locomotion(0.3, 2.0), Locomotion(0.15, 1.2), Locomotion(0.25, 3.0))


def simulate(
    seed: int, episodes: int = 60, steps: int = 40, **errors: float
) -> tuple[Demonstrations, NDArray[np.int64]]:
    """Walks under the true parameters, with tracking errors added, and the actions."""
    return walk(TRUTH, seed, episodes=episodes, steps=steps, **errors)


def test_the_joint_fit_withstands_noise_and_tracking_jumps() -> None:
    demos, _ = simulate(2, episodes=120, noise=5e-4, jumps=0.002)
    for found, truth in zip(fit_locomotion(demos).individuals, TRUTH, strict=True):
        assert found.damping == pytest.approx(truth.damping, abs=0.01)
        assert found.thrust == pytest.approx(truth.thrust, rel=0.01)


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


def test_onset_fit_without_an_onset_says_so_and_a_single_episode_has_no_interval() -> None:
    demos, _ = simulate(10, episodes=5)
    for threshold, fix in ((1e-6, "raise"), (1e6, "lower")):
        words = rf"never crosses .*: {fix} onset_threshold or use method 'joint'"
        refuses(words, fit_locomotion, demos, "onset", onset_threshold=threshold, split=None)
    demos, _ = simulate(12, episodes=1, steps=200)
    fit = fit_locomotion(demos, split=None)
    assert fit.validated_on == "all"
    assert all(one.damping_interval is None for one in fit.individuals)
    refuses("holds no episode", fit_locomotion, demos)


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
    refuses("b has .* steps, 0 of them in motion", fit_joint, transitions(stuck, 1), "b")
    still[:] = still[0]
    nobody = Demonstrations(**{**vars(demos), "positions": still})
    refuses("no individual ever moves: check", fit_locomotion, nobody, split=None)


def test_fits_survive_json_and_intervals_their_seed(tmp_path: Path) -> None:
    demos, _ = simulate(13, episodes=12)
    fit = fit_locomotion(demos, thrusts=2, bootstrap=50)
    assert {own.thrusts for own in fit.locomotion} == {2}
    assert LocomotionFit.load(fit.save(tmp_path / "fit.json")) == fit
    (tmp_path / "other.json").write_text(json.dumps({"a": 1}))
    refuses("not a locomotion fit", LocomotionFit.load, tmp_path / "other.json")
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


def test_no_onset_is_taken_across_the_border_of_two_episodes() -> None:
    """Both end at rest or start in motion; between them the animal is somewhere else."""
    dt, crossing = 0.1, 0.05
    still = np.zeros((4, 2))
    moving = np.column_stack([5.0 + 0.1 * np.arange(4), np.zeros(4)])
    starting = np.column_stack([[9.0, 9.0, 9.02, 9.05], np.zeros(4)])
    paths = [path[:, None] for path in (still, moving, starting)]
    alone = {"individuals": ("a",), "roles": ("pursuer",), "arena": Arena("open")}
    demos = episodes_along(paths, **alone, species="custom", split=np.full(3, "train"))
    data = onset_data(demos, 0, crossing / dt)
    assert data.onset_speed.tolist() == pytest.approx([0.2])
    assert data.onset_episode.tolist() == [2]
    assert len(data.speed) == 9 and data.speed.max() == pytest.approx(1.0)
    assert np.bincount(data.episode).tolist() == [3, 3, 3]


def test_the_bootstrap_of_the_joint_fit_leaves_tracking_jumps_out() -> None:
    """With some steps thrown far, intervals are those of the same tracks without these steps."""
    rng = np.random.default_rng(0)
    episodes, steps, dt = 30, 40, 0.1
    count = episodes * steps
    velocity = rng.normal(0.0, 0.5, (count, 2))
    action = ACTION_VECTORS[rng.integers(13, size=count)]
    focus = np.tile([1.0, 0.0], (count, 1))
    after = 0.7 * velocity + 2.0 * dt * action + rng.normal(0.0, 0.004, (count, 2))
    episode = np.repeat(np.arange(episodes), steps)
    jumps = np.zeros(count, dtype=bool)
    jumps[7::60] = True
    after[jumps] += rng.choice([-30.0, 30.0], (int(jumps.sum()), 2))
    with_jumps = Transitions(velocity, after, focus, episode, episodes, dt)
    kept = ~jumps
    without = Transitions(velocity[kept], after[kept], focus[kept], episode[kept], episodes, dt)
    weights = rng.multinomial(episodes, np.full(episodes, 1 / episodes), 300).astype(float)
    spread = [
        bootstrap_joint(data, fit_joint(data), weights).std(axis=0)
        for data in (with_jumps, without)
    ]
    assert spread[0] == pytest.approx(spread[1], rel=0.1)


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


def test_a_fit_that_hangs_on_the_left_out_steps_is_told_both_ways() -> None:
    demos, _ = simulate(2, episodes=60, noise=5e-4, jumps=0.002)
    fit = fit_locomotion(demos, bootstrap=200)
    (found,) = [sentence for sentence in doubts(fit, demos) if "tracking jumps" in sentence]
    for one in fit.individuals:
        assert f"{one.name}: d is {one.damping:.3g} and u {one.thrust:.3g} without" in found
    good, _ = simulate(2, episodes=120, noise=5e-4)
    assert doubts(fit_locomotion(good, bootstrap=200), good) == []


def changed(fit: LocomotionFit, **fields: object) -> LocomotionFit:
    first = replace(fit.individuals[0], **fields)  # type: ignore[arg-type]
    return replace(fit, individuals=(first, *fit.individuals[1:]))


def test_terminal_speeds_and_intervals_are_doubted_beyond_their_limits() -> None:
    demos, _ = simulate(1)
    fit = fit_locomotion(demos, bootstrap=0)
    top = fit.individuals[0].top_speed
    assert not any("top speed" in s for s in doubts(changed(fit, terminal_speed=1.9 * top), demos))
    (fast,) = doubts(changed(fit, terminal_speed=2.5 * top), demos)
    assert fast.startswith("With the thrust held a would") and "2.5 times the top speed" in fast
    low, high = 0.9 * fit.individuals[0].damping, 1.1 * fit.individuals[0].damping
    assert doubts(changed(fit, damping_interval=(low, high)), demos) == []
    (zero,) = doubts(changed(fit, damping_interval=(0.0, high)), demos)
    assert "The interval of d reaches 0 for a," in zero
    every = [replace(one, damping_interval=(0.0, 1.0)) for one in fit.individuals]
    (zero,) = doubts(replace(fit, individuals=tuple(every)), demos)
    assert f"for {', '.join(one.name for one in every)}, so" in zero


@pytest.mark.parametrize(
    ("kind", "words"),
    [("true", []), ("slow", ["Median speed"]), ("dead", ["Duration"]), ("still", ["Median speed"])],
)
def test_what_is_off_by_more_than_half_is_said(kind: str, words: list[str]) -> None:
    demos = recorded_pairs()
    found = implausible(verdict(demos, simulated_pairs(demos, kind), seed=0, references=demos))
    assert all("off by more than half" in sentence for sentence in found)
    for word in words:
        assert any(sentence.startswith(word) for sentence in found)
    if not words:
        assert found == []


def test_a_network_that_training_made_worse_is_said_first() -> None:
    demos = recorded_pairs()
    dead, true = simulated_pairs(demos, "dead"), simulated_pairs(demos, "true")
    worse = verdict(demos, dead, seed=0, baselines={"untrained": true}, references=demos)
    assert implausible(worse)[0].startswith("An untrained network comes nearer")


@pytest.mark.slow
def test_a_share_that_was_never_recorded_is_off_only_where_it_is_common() -> None:
    demos = recorded_pairs()
    never = replace(demos, outcome=np.zeros(len(demos)))
    simulated = simulated_pairs(demos, "true")
    outcome = np.zeros(len(simulated))
    outcome[: len(outcome) // 20] = 1
    rare = replace(simulated, outcome=outcome)
    often = replace(simulated, outcome=np.ones(len(simulated)))
    said = [
        [s for s in implausible(verdict(never, one, seed=0, references=never)) if "reached" in s]
        for one in (rare, often)
    ]
    assert said == [[], ["Target reached is off by more than half: 100 % simulated, 0 % recorded."]]
