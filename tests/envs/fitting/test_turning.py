"""How a body turns, and the odour it meets: laws, their fits to recordings, and the species."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from recordings import begun, recordings_of
from refusals import refuses

from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.packaged import load_packaged
from animarl_envs.fitting.custom_species import species_of
from animarl_envs.fitting.odour import fit_odour, odour_steps
from animarl_envs.fitting.turning import along_travel, fit_turning, free_running, heading_misses
from animarl_envs.scenario import make_scenario
from animarl_envs.species.silkmoth import RECORDED_TURNING
from animarl_envs.species.turning import Turning
from animarl_envs.worlds.plume.plume import INPUTS, FittedOdour, mirrored, write_inputs
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
        demos, positions=demos.positions @ matrix.T,
        initial_velocity=demos.initial_velocity @ matrix.T, signals={"heading": heading},
    )  # fmt: skip


def numbers(turning: Turning | None) -> list[float]:
    assert turning is not None
    return [turning.persistence, turning.gain, turning.slip, turning.speed]


def test_without_noise_the_law_foretells_all_headings() -> None:
    demos = planted(0.0)
    free = free_running(demos, PLANTED)
    assert np.exp(1j * free) == pytest.approx(np.exp(1j * demos.signals["heading"]), abs=1e-9)
    assert (np.median(heading_misses(demos, PLANTED), axis=1) < 1e-9).all()


def test_turned_tracks_turn_alike_and_mirrored_ones_slip_to_the_other_side() -> None:
    demos = planted(0.1)
    fitted = numbers(fit_turning(demos))
    for angle in (0.3, 2.0, -3.0):
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        other = fit_turning(moved(demos, turn, demos.signals["heading"] + angle))
        assert numbers(other) == pytest.approx(fitted, abs=1e-5)
    image = numbers(fit_turning(moved(demos, np.diag([1.0, -1.0]), -demos.signals["heading"])))
    assert image * np.array([1, 1, -1, 1]) == pytest.approx(fitted, abs=1e-5)


def test_a_body_that_points_where_it_walks_needs_no_turning() -> None:
    demos = planted(0.0)
    along = replace(demos, signals={"heading": along_travel(demos)})
    assert fit_turning(along) is None
    assert fit_turning(replace(demos, signals={})) is None
    assert fit_turning(replace(demos, positions=np.zeros_like(demos.positions),
                               initial_velocity=np.zeros((EPISODES, 1, 2)))) is None  # fmt: skip
    assert fit_turning(load_packaged("silkmoth")) is None  # the programmed moth
    two = np.stack([demos.signals["heading"]] * 2, axis=1)
    refuses("2 columns", fit_turning, replace(demos, signals={"heading": two}))


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


@pytest.mark.realdata
def test_fitted_turning_beats_both_simple_rules_on_recorded_moths(data_dir: Path) -> None:
    """Held-out runs: the next heading, the heading from the start on, and the wind's side."""
    demos = recorded_moths(data_dir / "silkmoth_mothvr")
    errors = held_out_errors(demos)
    own, travel, held = (errors[name] for name in ("fitted turning", "along travel", "held"))
    assert (own[:2] < [0.6, 0.8] * np.minimum(travel, held)[:2]).all()
    assert own[2] > 0.05 + max(travel[2], held[2])
    assert numbers(fit_turning(demos)) == pytest.approx(numbers(RECORDED_TURNING), rel=5e-3)


@pytest.fixture(scope="module")
def recorded() -> Demonstrations:
    """Searches with hits by a known law: hits of both antennae last with .9 and begin with .1."""
    demos, draw = load_packaged("silkmoth"), np.random.default_rng(0)
    left = np.zeros(len(demos.positions), dtype=bool)
    for frame in range(1, len(left)):
        left[frame] = draw.random() < (0.9 if left[frame - 1] else 0.1)
    heading = draw.uniform(-np.pi, np.pi, len(left))
    signals = {"odour_left": left * 1.0, "odour_right": left * 1.0, "heading": heading}
    own = {**demos.provenance, "synthetic": False}
    return replace(demos, signals=signals, provenance=own)


@pytest.mark.slow
def test_a_law_of_hits_is_found_and_drawn_in_the_world(recorded: Demonstrations) -> None:
    species = species_of(recorded)
    odour = species.plume
    assert isinstance(odour, FittedOdour)
    lasting, beginning = (-p * np.log(p) - (1 - p) * np.log(1 - p) for p in (0.9, 0.1))
    inputs, hits = odour_steps(recorded)
    surprise = -np.log(odour.chances(inputs)[np.arange(len(hits)), hits]).mean()
    assert surprise < 0.5 * (lasting + beginning) + 0.08  # persistence untold: 0.69
    world = begun(make_scenario(species, demos=None), 200)
    drawn_hits, draw = [], np.random.default_rng(0)
    for _ in range(100):  # they wander over the places that were recorded
        world.step(draw.integers(species.num_actions, size=(200, 1)))
        drawn_hits.append(world.odour == 1.0)
    drawn = np.array(drawn_hits)
    before, after = drawn[20:-1, :, 0], drawn[21:, :, 0]
    assert after[before].mean() == pytest.approx(0.9, abs=0.05)
    assert after[~before].mean() == pytest.approx(0.1, abs=0.05)
    assert (drawn[..., 0] != drawn[..., 1])[20:].mean() < 0.05


def test_nobody_smells_where_nobody_was_recorded(recorded: Demonstrations) -> None:
    odour = species_of(recorded).plume
    assert isinstance(odour, FittedOdour)
    places = recorded.positions[::50, 0]
    chances = []
    for places_ in (places, places - [0.8, 0.0]):  # the second upwind of the source
        rows = np.empty((len(places_), INPUTS))
        for (x, y), row in zip(places_, rows, strict=True):
            write_inputs(x, y, -1.0, 0.0, True, True, 0.0, row)
        chances.append(1.0 - odour.chances(rows)[:, 0])
    assert np.median(chances[0]) > 0.8 and np.median(chances[1]) < 0.1


def test_a_copy_smells_the_same_alone_and_beside_others(recorded: Demonstrations) -> None:
    species = species_of(recorded)
    smelt: list[list[Any]] = [[], []]
    for own, copies in zip(smelt, (1, 3), strict=True):
        world = begun(make_scenario(species, demos=None), copies)
        for _ in range(20):
            world.step(np.zeros((copies, 1), dtype=np.int64))
            own.append(world.odour[0].copy())
    assert np.array_equal(*smelt)


def test_inputs_have_their_mirror_image(recorded: Demonstrations) -> None:
    part = recorded.select(episodes=np.arange(2))
    left, right = part.signals["odour_left"], part.signals["odour_right"]
    turned = {"odour_left": right, "odour_right": left, "heading": -part.signals["heading"]}
    reflected = replace(part, positions=part.positions * [1, -1], signals=turned)
    inputs, _ = odour_steps(part)
    assert inputs.shape[1] == INPUTS
    assert odour_steps(reflected)[0] == pytest.approx(mirrored(inputs))


def test_test_episodes_and_synthetic_sets_do_not_change_the_odour(recorded: Demonstrations) -> None:
    train = recorded.select(split="train")
    assert np.array_equal(fit_odour(train).first, species_of(recorded).plume.first)
    synthetic = replace(recorded, provenance={**recorded.provenance, "synthetic": True})
    assert species_of(synthetic).plume == "model"
