"""Several thrust magnitudes: fitted to tracks, and followed in closed loop."""

import csv
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import animarl
from numpy.typing import NDArray
from refusals import refuses
from thrust_walks import DT, ROLES, TRUTH, walk

import benchmarks.paper_readers  # noqa: F401  (registers the readers of published sets)
from animarl_algos.cli.fit import parse_numbers
from animarl_algos.evaluation.thrust_choice import MIN_IMPROVEMENT, choose_thrusts, tracking_floor
from animarl_envs.arena import Arena
from animarl_envs.demos.packaged import load_packaged
from animarl_envs.fitting.joint import fast_speed, fit_joint, joint_locomotion
from animarl_envs.fitting.result import fit_locomotion
from animarl_envs.fitting.tracking import one_step_misses, speed_distances, track, tracking_errors
from animarl_envs.fitting.transitions import transitions
from animarl_envs.focus import focus_directions
from animarl_envs.importing.readers import default_recipe, follow, get_reader
from animarl_envs.locomotion import MOST_THRUSTS, Locomotion, apply_actions, infer_actions
from animarl_envs.species import FLY


@pytest.mark.parametrize(
    ("seed", "episodes", "noise", "damping", "thrust"),
    [(4, 60, 0.0, 1e-6, 1e-5), (5, 100, 5e-4, 0.02, 0.05)],
    ids=["exact", "noisy"],
)
def test_several_magnitudes_are_found(
    seed: int, episodes: int, noise: float, damping: float, thrust: float
) -> None:
    demos, _ = walk(TRUTH, seed, episodes=episodes, noise=noise)
    for found, truth in zip(joint_locomotion(demos, 3), TRUTH, strict=True):
        assert found.damping == pytest.approx(truth.damping, abs=damping)
        pushes = (own.thrust * np.array(own.magnitudes) for own in (found, truth))
        np.testing.assert_allclose(*pushes, rtol=thrust)


def test_the_floor_needs_two_episodes_to_tell_apart() -> None:
    demos, _ = walk(TRUTH, 7, episodes=2)
    assert np.isnan(tracking_floor(demos.select(episodes=[0]), TRUTH).estimate)


def test_the_terminal_speed_reaches_the_fast_steps() -> None:
    """Noise biases d upwards (docs/data/fitting.md) until the animal could not go so fast."""
    truth = (Locomotion(0.05, 1.0),) * 3
    demos, _ = walk(truth, 8, noise=0.02)
    data = transitions(demos, 0)
    free, fast = fit_joint(data), fast_speed(data)
    assert free.terminal_speed(DT) < 0.9 * fast
    held = fit_joint(data, least_speed=fast)
    assert held.terminal_speed(DT) == pytest.approx(fast, rel=1e-9)

    # The best of all fits with that terminal speed.
    def miss(thrust: float) -> float:
        own = Locomotion(thrust * DT / fast, thrust)
        actions = infer_actions(data.velocity, data.next_velocity, data.focus, own, DT)
        rebuilt = apply_actions(data.velocity, actions, data.focus, own, DT)
        return float(np.sum((rebuilt - data.next_velocity) ** 2))

    assert miss(held.thrust) <= min(miss(0.98 * held.thrust), miss(1.02 * held.thrust))
    for thrusts in (1, 2, 3):
        for own in joint_locomotion(demos, thrusts):
            assert own.terminal_speed(DT) >= fast_speed(data) * 0.9
    fit = fit_locomotion(demos, bootstrap=50)
    for one in fit.individuals:
        low, high = one.damping_interval or (np.nan, np.nan)
        assert low < one.damping < high


@pytest.mark.parametrize("thrusts", [0, MOST_THRUSTS + 1, 1.5, "2"])
def test_impossible_numbers_of_magnitudes_are_refused(thrusts: Any) -> None:
    demos, _ = walk(TRUTH, 9, episodes=10)
    refuses("thrusts is", fit_locomotion, demos, thrusts=thrusts)
    refuses("onset rule fits one thrust", fit_locomotion, demos, "onset", thrusts=2, bootstrap=0)


def test_exact_tracks_are_followed_exactly() -> None:
    demos, actions = walk(TRUTH, 10)
    tracking = track(demos, TRUTH)
    np.testing.assert_array_equal(tracking.actions, actions)
    np.testing.assert_allclose(tracking.positions, demos.positions, atol=1e-12)
    np.testing.assert_allclose(tracking.velocities, demos.velocities(), atol=1e-11)
    assert speed_distances(demos, tracking).max() < 1e-10


@pytest.mark.parametrize("horizon", [1.0, 3.0])
def test_each_step_is_the_best_from_where_the_simulation_is(horizon: float) -> None:
    """Against all actions of one step in NumPy, focus from the simulated positions."""
    demos, _ = walk(TRUTH, 11, episodes=5, noise=0.01)
    poorer = tuple(Locomotion(m.damping, m.thrust, (1.2, 0.5)) for m in TRUTH)
    tracking, velocity = track(demos, poorer, horizon=horizon), demos.velocities()
    focus = focus_directions(tracking.positions, ROLES)
    misses = one_step_misses(demos, poorer, tracking)
    for frame in np.flatnonzero(tracking.actions[:, 0] >= 0):
        for i, own in enumerate(poorer):
            taken = tracking.actions[frame, i]
            v = np.stack([
                apply_actions(tracking.velocities[frame, i], np.array(k), focus[frame, i], own, DT)
                for k in range(25)
            ])  # fmt: skip
            p = tracking.positions[frame, i] + v * DT
            ahead = np.sum((p - demos.positions[frame + 1, i]) ** 2, axis=1) / DT**2
            faster = np.sum((v - velocity[frame + 1, i]) ** 2, axis=1)
            cost = ahead / horizon**2 + faster
            assert cost[taken] == pytest.approx(cost.min(), rel=1e-9)
            np.testing.assert_allclose(p[taken], tracking.positions[frame + 1, i], atol=1e-12)
            np.testing.assert_allclose(
                misses[frame, i], DT * np.sqrt((ahead + faster) / 2), atol=1e-12
            )
    last = demos.offsets[1:] - 1
    assert (tracking.actions[last] == -1).all() and not misses[last].any()


def test_a_longer_horizon_mends_less_in_haste() -> None:
    """On circles: a push that mends a miss is soon undone by another one."""
    demos, _ = walk(TRUTH, 14, episodes=6)
    time = np.concatenate([np.arange(steps) for steps in demos.lengths]) * DT
    turned = (1 + np.arange(3)) * 0.6 * time[:, None] + np.repeat(np.arange(6), 51)[:, None]
    circles = 0.4 * np.stack([np.cos(turned), np.sin(turned)], axis=-1)
    demos = replace(demos, positions=circles + np.array([[0.0, 0.1], [0.3, 0.0], [-0.3, 0.0]]))
    near, calm = track(demos, TRUTH), track(demos, TRUTH, horizon=3)
    inside = np.isin(np.arange(len(time)), demos.offsets[1:, None] - np.arange(1, 4), invert=True)

    def jerk(velocities: NDArray[np.float64]) -> float:
        change = np.diff(velocities, n=2, axis=0)[inside[:-2]]
        return float(np.hypot(change[..., 0], change[..., 1]).mean())

    assert jerk(calm.velocities) < 0.95 * jerk(near.velocities)
    assert tracking_errors(demos, calm).max() < 0.04  # a tenth of a radius
    refuses(r"horizon is 0\.5: give 1 step or more", track, demos, TRUTH, horizon=0.5)


def test_tracking_stays_within_walls() -> None:
    demos, _ = walk(TRUTH, 13, episodes=10)
    walls = Arena("disc", size=0.5, boundary=0.5, rebound=True)
    assert np.linalg.norm(demos.positions, axis=2).max() > 1.0
    held = track(demos, TRUTH, walls).positions
    started = np.delete(np.arange(len(held)), demos.offsets[:-1])
    assert np.linalg.norm(held[started], axis=2).max() <= 0.5
    free = track(demos, TRUTH, replace(walls, rebound=False)).positions
    assert np.linalg.norm(free, axis=2).max() > 1.0
    refuses("thrust magnitudes", track, demos, (TRUTH[0], TRUTH[1], Locomotion(0.3, 3.0)))
    refuses("3 individuals", track, demos, TRUTH[:2])


def test_packaged_flies_are_followed_to_a_thousandth() -> None:
    demos = load_packaged("fly").select(split="val")
    tracking = track(demos, FLY.locomotion)
    assert np.hypot(*(tracking.positions - demos.positions).T).max() < 5e-3
    assert tracking_errors(demos, tracking).max() < 1e-4


def test_the_command_compares_numbers_of_magnitudes(tmp_path: Path) -> None:
    demos, _ = walk(TRUTH, 15, episodes=20)
    file, out = demos.save(tmp_path / "walk.npz"), tmp_path / "rows.csv"
    said = animarl("fit", file, "--thrusts", "1,3", "--out", out)
    rows = list(csv.DictReader(out.read_text().splitlines()))
    assert [row["thrusts"] for row in rows] == ["1"] * 3 + ["3"] * 3
    for row, truth in zip(rows[3:], TRUTH, strict=True):
        found = float(row["thrust"]) * np.array(row["magnitudes"].split(), dtype=float)
        np.testing.assert_allclose(found, truth.thrust * np.array(truth.magnitudes), rtol=1e-4)
        assert float(row["tracking_error"]) < 1e-3 < float(rows[0]["tracking_error"])
        assert float(row["floor"]) < float(rows[0]["floor"]) - MIN_IMPROVEMENT
    assert "Chosen on training episodes: 3, the fewest whose floor (" in said


def test_numbers_of_magnitudes_are_read() -> None:
    assert parse_numbers("--thrusts", "1,2, 5", 10) == (1, 2, 5)
    assert parse_numbers("--thrusts", "5,2,1,1", 10) == (1, 2, 5)
    for bad in ("0", "1,,2", "two", "11", "-1"):
        refuses("--thrusts", parse_numbers, "--thrusts", bad, 10)
    words = ("fit", "fly", "--thrusts", "1,2", "--method", "onset")
    refuses("leave --method onset out", animarl, *words)


@pytest.mark.realdata
def test_recorded_moths_are_followed_more_closely_with_three(data_dir: Path) -> None:
    files = sorted((data_dir / "silkmoth_mothvr" / "raw").glob("*.csv"))
    demos = follow(default_recipe(get_reader("mothvr")), files).select(split="train")
    one, many = (track(demos, joint_locomotion(demos, m)) for m in (1, 3))
    assert (tracking_errors(demos, many) < 0.7 * tracking_errors(demos, one)).all()
    assert (speed_distances(demos, many) < 0.5 * speed_distances(demos, one)).all()


@pytest.mark.parametrize("truth", [tuple(Locomotion(0.25, u) for u in (2.4, 2.4, 3.0)), TRUTH])
def test_as_many_magnitudes_are_chosen_as_there_are(truth: tuple[Locomotion, ...]) -> None:
    demos, _ = walk(truth, 7)
    assert choose_thrusts(demos)[0] == truth[0].thrusts
