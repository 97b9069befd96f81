"""How a body turns: the law, its fit to recorded headings, and the species made of it."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from recordings import recordings_of
from refusals import refuses

from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.packaged import load_packaged
from animarl_envs.fitting.custom_species import species_of
from animarl_envs.fitting.turning import along_travel, fit_turning, free_running, heading_misses
from animarl_envs.species.silkmoth import RECORDED_TURNING
from animarl_envs.species.turning import Turning
from tools.packaged_data.moth_statistics import recorded_moths
from tools.packaged_data.moth_turning import held_out_errors

PLANTED = Turning(persistence=0.4, gain=0.6, slip=-0.5, speed=0.009)
EPISODES, FRAMES, DT = 8, 200, 0.5


def planted(noise: float, turning: Turning = PLANTED, seed: int = 0) -> Demonstrations:
    """Wandering walks of median speed ``turning.speed``; the bodies turn by the law and noise."""
    rng = np.random.default_rng(seed)
    velocity = np.zeros((EPISODES, FRAMES, 2))
    for t in range(1, FRAMES):
        velocity[:, t] = 0.85 * velocity[:, t - 1] + rng.normal(0.0, 1.0, (EPISODES, 2))
    speeds = np.hypot(velocity[..., 0], velocity[..., 1])
    velocity *= turning.speed / np.median(speeds[speeds > 0])
    heading = np.zeros((EPISODES, FRAMES))
    heading[:, 0] = rng.uniform(-np.pi, np.pi, EPISODES)
    turn = np.zeros(EPISODES)
    for t in range(1, FRAMES):
        turn = turning.next_turn(turn, heading[:, t - 1], velocity[:, t])
        turn = turn + noise * rng.standard_normal(EPISODES)
        heading[:, t] = heading[:, t - 1] + turn
    walks = recordings_of("silkmoth")
    return replace(
        walks, positions=np.cumsum(velocity * DT, axis=1).reshape(-1, 1, 2),
        lengths=np.full(EPISODES, FRAMES), initial_velocity=velocity[:, :1],
        condition=np.zeros(EPISODES), outcome=np.zeros(EPISODES),
        split=np.resize(["train", "train", "val", "test"], EPISODES),
        recording=np.array([f"run {e}" for e in range(EPISODES)]),
        signals={"heading": heading.ravel() % (2 * np.pi)},
    )  # fmt: skip


def moved(demos: Demonstrations, matrix: Any, heading: Any) -> Demonstrations:
    """The same walks in the plane, turned or mirrored."""
    return replace(
        demos,
        positions=demos.positions @ matrix.T,
        initial_velocity=demos.initial_velocity @ matrix.T,
        signals={"heading": heading},
    )


def numbers(turning: Turning | None) -> list[float]:
    assert turning is not None
    return [turning.persistence, turning.gain, turning.slip, turning.speed]


def test_without_noise_the_law_foretells_all_headings() -> None:
    demos = planted(0.0)
    free = free_running(demos, PLANTED)
    assert np.exp(1j * free) == pytest.approx(np.exp(1j * demos.signals["heading"]), abs=1e-9)
    assert (np.median(heading_misses(demos, PLANTED), axis=1) < 1e-9).all()


@pytest.mark.parametrize("angle", [0.3, 2.0, -3.0])
def test_turned_tracks_turn_alike(angle: float) -> None:
    demos = planted(0.1)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    other = fit_turning(moved(demos, turn, demos.signals["heading"] + angle))
    assert numbers(other) == pytest.approx(numbers(fit_turning(demos)), abs=1e-5)


def test_mirrored_tracks_slip_to_the_other_side() -> None:
    demos = planted(0.1)
    other = numbers(fit_turning(moved(demos, np.diag([1.0, -1.0]), -demos.signals["heading"])))
    assert other * np.array([1, 1, -1, 1]) == pytest.approx(numbers(fit_turning(demos)), abs=1e-5)


def test_a_body_that_points_where_it_walks_needs_no_turning() -> None:
    demos = planted(0.0)
    along = replace(demos, signals={"heading": along_travel(demos)})
    assert fit_turning(along) is None
    assert fit_turning(replace(demos, signals={})) is None
    assert fit_turning(replace(demos, positions=np.zeros_like(demos.positions),
                               initial_velocity=np.zeros((EPISODES, 1, 2)))) is None  # fmt: skip
    assert fit_turning(load_packaged("silkmoth")) is None  # the programmed moth


def test_a_body_at_rest_keeps_the_direction_it_walked_in() -> None:
    demos = planted(0.0)
    positions = demos.positions.copy()
    positions[50:60] = positions[49]
    positions[:5] = positions[0]
    still = replace(demos, positions=positions, initial_velocity=np.zeros((EPISODES, 1, 2)))
    along = along_travel(still)
    assert (along[50:60] == along[49]).all()
    assert (along[:5] == demos.signals["heading"][0]).all()


def test_a_species_of_recorded_headings_turns_as_its_training_episodes_do() -> None:
    demos = planted(0.15)
    species = species_of(demos)
    assert species.turning == fit_turning(demos.select(split="train"))  # type: ignore[attr-defined]
    assert species.turning != fit_turning(demos)  # type: ignore[attr-defined]
    assert species_of(replace(demos, signals={})).turning is None  # type: ignore[attr-defined]


def test_headings_of_several_are_refused() -> None:
    demos = planted(0.0)
    two = np.stack([demos.signals["heading"]] * 2, axis=1)
    refuses("2 columns", fit_turning, replace(demos, signals={"heading": two}))


@pytest.mark.realdata
def test_fitted_turning_beats_both_simple_rules_on_recorded_moths(data_dir: Path) -> None:
    """Held-out runs: the next heading, the heading from the start on, and the wind's side."""
    demos = recorded_moths(data_dir / "silkmoth_mothvr")
    errors = held_out_errors(demos)
    own, travel, held = (errors[name] for name in ("fitted turning", "along travel", "held"))
    assert (own[:2] < [0.6, 0.8] * np.minimum(travel, held)[:2]).all()
    assert own[2] > 0.05 + max(travel[2], held[2])
    assert numbers(fit_turning(demos)) == pytest.approx(numbers(RECORDED_TURNING), rel=5e-3)
