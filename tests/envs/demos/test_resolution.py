"""The grid of recorded positions is found, and rollouts and tracking are put on it."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from animarl_algos.evaluation.classifier import Windows, classify, window_features
from animarl_algos.evaluation.collect import RandomPolicy, collect_rollouts
from animarl_algos.evaluation.rollouts import Rollouts
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.episode import SINGLE_PRECISION, Resolution, find_resolution, rounded
from animarl_envs.demos.packaged import load_packaged
from animarl_envs.fitting.tracking import track
from animarl_envs.scenario import make_scenario
from animarl_envs.species import FLY
from animarl_envs.worlds.chase.world import ChaseWorld

SOMEWHERE = np.random.default_rng(0).uniform(-1.0, 1.0, (500, 3, 2))


@pytest.mark.parametrize("name", ["fly", "newt"])
def test_packaged_recordings_lie_on_multiples_of_two_to_the_minus_17(name: str) -> None:
    demos = load_packaged(name)
    assert demos.resolution() == Resolution((2.0**-17, 2.0**-17), (0.0, 0.0))
    assert demos.select(split="test").resolution() == demos.resolution()
    assert np.array_equal(rounded(demos.positions, demos.resolution()), demos.positions)


@pytest.mark.parametrize("kind", [np.float32, np.float64])
@pytest.mark.parametrize("step", [0.01, 1.0 / 1024.0, 1e-4])
def test_rounded_positions_tell_what_they_were_rounded_to(step: float, kind: type) -> None:
    stored = (np.round(SOMEWHERE / step) * step).astype(kind).astype(np.float64)
    found = find_resolution(stored)
    assert found is not None
    assert found.step == pytest.approx((step, step), rel=1e-6)
    assert rounded(stored, found) == pytest.approx(stored, abs=1e-3 * step)
    assert np.abs(rounded(SOMEWHERE, found) - SOMEWHERE).max() < 0.502 * step


def test_pixels_of_a_camera_are_found_after_shift_and_scale() -> None:
    pixels = np.round(320.0 + 300.0 * SOMEWHERE)
    found = find_resolution((pixels - [311.37, 250.11]) * [0.00413, 0.00399])
    assert found is not None
    assert found.step == pytest.approx((0.00413, 0.00399))
    back = np.array(found.origin) / found.step + [311.37, 250.11]
    assert back == pytest.approx(np.round(back), abs=1e-6)


def test_few_places_far_apart_still_tell_the_step_that_they_have_in_common() -> None:
    places = np.arange(50)[:, None] * np.array([6.0, 10.0])
    places[-1] += [9.0, 15.0]  # no two are one step of 3, or of 5, apart
    found = find_resolution(places)
    assert found is not None and found.step == pytest.approx((3.0, 5.0))


def test_unrounded_positions_have_no_grid_and_single_precision_is_known() -> None:
    assert find_resolution(SOMEWHERE) is None
    assert find_resolution(np.round(SOMEWHERE[:2], 2)) is None  # six places: by chance
    assert find_resolution(np.ones((100, 3, 2))) is None
    assert rounded(SOMEWHERE, None) is SOMEWHERE
    exact = np.random.default_rng(0).normal(size=(500, 2, 2))
    stored = exact.astype(np.float32).astype(np.float64)
    assert find_resolution(stored) == SINGLE_PRECISION
    assert find_resolution(exact) is None
    np.testing.assert_array_equal(rounded(exact, SINGLE_PRECISION), stored)


def test_rollouts_are_rounded_as_the_recordings_are_and_simulated_as_ever() -> None:
    demos = load_packaged("fly").select(split="val")
    scenario = make_scenario("fly", demos=demos, split=None)
    make = partial(ChaseWorld, scenario)
    stored, exact = (
        collect_rollouts(make, RandomPolicy(0), method="x", seed=0, repetitions=1, **options)
        for options in ({}, {"resolution": None})
    )
    assert np.array_equal(stored.positions, rounded(exact.positions, demos.resolution()))
    assert not np.array_equal(stored.positions, exact.positions)
    assert np.abs(stored.positions - exact.positions).max() <= 2.0**-18
    assert np.array_equal(stored.lengths, exact.lengths)
    coarse = Resolution((0.1, 0.1), (0.05, 0.0))
    given = collect_rollouts(
        make, RandomPolicy(0), method="x", seed=0, repetitions=1, resolution=coarse
    )
    assert np.array_equal(given.positions, rounded(exact.positions, coarse))


def _told_from(demos: Demonstrations, positions: np.ndarray) -> float:
    def windows(positions: np.ndarray) -> Windows:
        rollouts = replace(Rollouts.from_demonstrations(demos), positions=positions)
        return window_features(rollouts, demos.arena)

    rng = np.random.default_rng(0)
    return classify(windows(demos.positions), windows(positions), rng).auc.estimate


@pytest.mark.parametrize("scale", [1.0, 1.033])
def test_perfect_tracking_is_told_from_recordings_only_by_the_grid(scale: float) -> None:
    """Packaged flies are simulated with the actions of their locomotion, then rounded.

    At another scale: as tracks of three decimals that an import has scaled.
    """
    demos = load_packaged("fly").select(split="train")
    exact = track(demos, FLY.locomotion).positions
    demos = replace(demos, positions=exact.round(3) / scale)
    assert _told_from(demos, exact / scale) > 0.8
    assert abs(_told_from(demos, rounded(exact / scale, demos.resolution())) - 0.5) < 0.1


def test_rounding_errors_of_an_import_tell_nobody() -> None:
    """Stored in single precision and then scaled, tracks lie on no grid that could be found."""
    demos = load_packaged("fly").select(split="train")
    exact = track(demos, FLY.locomotion).positions
    demos = replace(demos, positions=exact.astype(np.float32).astype(np.float64) / 1.0871)
    assert demos.resolution() is None
    assert abs(_told_from(demos, exact / 1.0871) - 0.5) < 0.1


@pytest.mark.parametrize("scale", [1.033, 0.37])
def test_seven_decimals_are_found_after_scaling(scale: float) -> None:
    found = find_resolution(SOMEWHERE.round(7) / scale)
    assert found is not None
    assert found.step == pytest.approx((1e-7 / scale,) * 2, rel=1e-6)


def test_recordings_with_grids_of_their_own_have_one_of_the_median_step() -> None:
    demos = load_packaged("fly").select(split="train")
    names, recording = np.unique(demos.recording, return_inverse=True)
    factor = 1.0 / (1.0 + 0.001 * np.pi * np.arange(len(names)))
    each = np.repeat(factor[recording], demos.lengths)[:, None, None]
    scaled = replace(demos, positions=demos.positions * each)
    found = scaled.resolution()
    assert find_resolution(scaled.positions) is None and found is not None
    assert found.step == pytest.approx((np.median(factor) * 2.0**-17,) * 2, rel=0.02)
    assert replace(demos, positions=np.sin(demos.positions)).resolution() is None
