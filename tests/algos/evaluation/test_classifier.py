"""The classifier: chance where nothing differs, certainty where everything does, no leaks."""

from dataclasses import replace

import numpy as np
import pytest
from moving_pairs import ARENA, recorded_pairs, rollouts_along, simulated_pairs
from refusals import refuses

from animarl_algos.evaluation.classifier import (
    DEALS,
    Windows,
    among_themselves,
    classify,
    widen_for_folds,
    window_features,
)
from animarl_algos.evaluation.prepared import smoothed, suggested_smoothing
from animarl_algos.evaluation.rollouts import Rollouts
from animarl_algos.evaluation.statistics import Interval
from animarl_envs.demos.summary import tracking_noise


def normal_windows(
    rng: np.random.Generator, centre: np.ndarray, groups: np.ndarray, each: int
) -> Windows:
    """Six windows an episode, which share what their start and what their episode is like."""
    group = np.repeat(groups, 6 * each)
    episode = np.repeat(rng.normal(0, 0.5, (len(groups) * each, centre.shape[1])), 6, axis=0)
    values = centre[group] + episode + rng.normal(size=(len(group), centre.shape[1]))
    return Windows(values, group, np.array(["speed"] * centre.shape[1]))


def half_within(experiments: int, starts: int, *, paired: bool, deals: int) -> float:
    """In how many experiments on two halves of one sample 0.5 lies within the interval."""
    inside = 0
    for seed in range(experiments):
        rng = np.random.default_rng([seed, starts])
        centre = rng.normal(size=(2 * starts, 8))
        here, there = np.arange(starts), np.arange(starts) + (0 if paired else starts)
        first = normal_windows(rng, centre, here, 1)
        second = normal_windows(rng, centre, there, 3 if paired else 1)
        auc = classify(first, second, rng, deals=deals).auc
        inside += auc.low <= 0.5 <= auc.high
    return inside / experiments


@pytest.mark.parametrize("paired", [False, True])
def test_two_halves_of_one_sample_are_not_told_apart(paired: bool) -> None:
    assert half_within(6, 15, paired=paired, deals=1) >= 5 / 6


@pytest.mark.slow
@pytest.mark.parametrize("paired", [False, True])
@pytest.mark.parametrize("starts", [20, 50])
def test_the_interval_holds_one_half_in_nearly_all_experiments(starts: int, paired: bool) -> None:
    assert half_within(200, starts, paired=paired, deals=DEALS) >= 0.93


@pytest.mark.slow
def test_how_few_demonstrations_are_dealt_hardly_matters() -> None:
    rng = np.random.default_rng(3)
    centre = rng.normal(size=(10, 8))
    sides = [normal_windows(rng, centre, np.arange(10), each) for each in (1, 3)]

    def spread(deals: int | None) -> float:
        areas = [
            classify(*sides, np.random.default_rng(seed), deals=deals).auc.estimate
            for seed in range(6)
        ]
        return float(np.std(areas))

    assert spread(None) < 0.6 * spread(1)


def test_copies_of_the_recordings_are_ranked_by_chance_exactly() -> None:
    recorded = window_features(Rollouts.from_demonstrations(recorded_pairs()), ARENA)
    assert classify(recorded, recorded, np.random.default_rng(0)).auc.estimate == 0.5


def test_the_interval_is_widened_for_what_folds_share() -> None:
    """Nadeau and Bengio (2003): the variance times 1 + folds n_test / n_train."""
    for folds, factor in ((2, np.sqrt(3.0)), (5, 1.5), (3, np.sqrt(2.5))):
        wide = widen_for_folds(Interval(0.6, 0.55, 0.64), folds)
        assert (wide.estimate, wide.low) == (0.6, pytest.approx(0.6 - factor * 0.05))
        assert wide.high == pytest.approx(0.6 + factor * 0.04)
    assert widen_for_folds(Interval(0.9, 0.1, 0.99), 2) == Interval(0.9, 0.0, 1.0)


def test_importance_names_what_differs() -> None:
    rng = np.random.default_rng(3)
    kinds = np.array(["speed"] * 3 + ["turning"] * 3)
    group = np.repeat(np.arange(20), 8)
    first, second = rng.normal(size=(2, 160, 6))
    second[:, 4] += 2.0
    told = classify(
        Windows(first, group, kinds), Windows(second, group, kinds), rng, importance=True
    )
    assert told.importance["turning"] > 0.2 > 0.05 > abs(told.importance["speed"])


def test_recordings_among_themselves_and_one_demonstration_alone() -> None:
    recorded = window_features(Rollouts.from_demonstrations(recorded_pairs()), ARENA)
    among = among_themselves(recorded, np.random.default_rng(0))
    assert among.low < 0.5 < among.high
    alone = recorded.of(np.array([0]))
    assert np.isnan(classify(alone, alone, np.random.default_rng(0)).auc.estimate)


def test_both_sides_are_cut_alike_and_short_episodes_count() -> None:
    demos = recorded_pairs()
    recorded = Rollouts.from_demonstrations(demos)
    windows = window_features(recorded, ARENA)
    steps = demos.lengths - 1
    wanted = np.maximum(steps // 20 + (steps % 20 >= 10), 1)
    assert np.array_equal(np.bincount(windows.group), wanted)
    dead = window_features(simulated_pairs(demos, "dead"), ARENA)
    assert len(dead) == 2 * demos.num_episodes
    assert np.isfinite(dead.values[:, 0]).all()
    parts = window_features(recorded, ARENA, block=1)
    assert len(np.unique(parts.group)) == len(parts)


def test_who_moves_less_than_a_resting_animal_is_at_rest() -> None:
    recorded = Rollouts.from_demonstrations(recorded_pairs())
    rng = np.random.default_rng(0)
    place = np.repeat(rng.uniform(-0.5, 0.5, (len(recorded), 2, 2)), recorded.lengths, axis=0)
    noise = rng.uniform(-1e-3, 1e-3, place.shape)
    rest, restless = (replace(recorded, positions=p) for p in (place, place + noise))
    limit = np.array([1e-2, 1e-2])
    first, second = (window_features(r, ARENA, still=limit) for r in (rest, restless))
    motion = np.isin(first.kinds, ("speed", "acceleration", "turning", "bearings"))
    assert np.array_equal(first.values[:, motion], second.values[:, motion], equal_nan=True)
    assert (window_features(restless, ARENA).values[:, 0] > 0).all()
    every, moving = (
        window_features(recorded, ARENA, still=s).values[:, 0] for s in (None, limit)
    )  # mean speeds: nothing but steps below the limit is left out
    assert (every >= moving).all() and (every - moving < limit[0] / recorded.dt).all()
    assert (every == moving).any()


def test_the_same_seed_gives_the_same_answer() -> None:
    demos = recorded_pairs()
    sides = [
        window_features(r, ARENA)
        for r in (Rollouts.from_demonstrations(demos), simulated_pairs(demos, "true"))
    ]
    twice = [classify(*sides, np.random.default_rng(5), importance=True) for _ in range(2)]
    assert twice[0] == twice[1]


def test_episodes_of_a_recording_are_kept_together_where_there_are_enough() -> None:
    demos = recorded_pairs()
    windows = window_features(Rollouts.from_demonstrations(demos), ARENA)
    of_six = replace(demos, recording=np.array([f"r{i % 6}" for i in range(len(demos))]))
    assert np.array_equal(windows.by_recording(of_six).group, windows.group % 6)
    of_four = replace(demos, recording=np.array([f"r{i % 4}" for i in range(len(demos))]))
    assert np.array_equal(windows.by_recording(of_four).group, windows.group)


def test_features_do_not_depend_on_the_names_of_demonstrations_or_on_rotation() -> None:
    demos = recorded_pairs()
    recorded = Rollouts.from_demonstrations(demos)
    turned = replace(recorded, positions=recorded.positions @ np.array([[0.0, 1.0], [-1.0, 0.0]]))
    first, second = window_features(recorded, ARENA), window_features(turned, ARENA)
    assert np.allclose(first.values, second.values, equal_nan=True, atol=1e-9)


def test_the_filter_keeps_straight_lines_and_never_mixes_episodes() -> None:
    line = np.arange(12.0)[:, None, None] * np.ones((12, 1, 2))
    lengths = np.array([5, 7])
    assert np.allclose(smoothed(line, lengths, 3)[1:4], line[1:4])
    jump = line + np.where(np.arange(12) < 5, 0.0, 1e6)[:, None, None]
    assert np.allclose(smoothed(jump, lengths, 5)[:5], smoothed(line, lengths, 5)[:5])
    refuses("odd number", smoothed, line, lengths, 2)


def pixel_walks(rng: np.random.Generator, episodes: int) -> list[np.ndarray]:
    """Paths on a pixel grid, of a pair that mostly rests, away from the origin."""
    paths = []
    for frames in rng.integers(22, 60, episodes).tolist():
        moves = rng.random((frames, 1, 1)) < 0.3
        steps = np.cumsum(rng.normal(0, 0.004, (frames, 2, 2)), axis=0) * moves
        place = rng.uniform(0.3, 0.7, (2, 2)) + np.cumsum(steps, axis=0)
        paths.append(np.round(place / 0.01) * 0.01)
    return paths


def test_a_redeal_of_recordings_on_a_pixel_grid_is_ranked_by_chance() -> None:
    areas = []
    for seed in range(4):
        rng = np.random.default_rng(seed)
        paths = pixel_walks(rng, 330)
        demos = recorded_pairs()
        sides = [
            rollouts_along(some, demos, np.arange(len(some)) % 30)
            for some in (paths[:30], paths[30:])
        ]
        sides = [replace(r, positions=smoothed(r.positions, r.lengths, 3)) for r in sides]
        sides = [window_features(each, ARENA) for each in sides]
        areas.append(classify(*sides, rng, deals=1).auc.estimate)
    assert np.mean(areas) == pytest.approx(0.5, abs=0.03)


def test_smoothing_an_episode_does_not_depend_on_those_before_it() -> None:
    paths = pixel_walks(np.random.default_rng(0), 200)
    lengths = np.array([len(path) for path in paths])
    last = smoothed(np.concatenate(paths), lengths, 3)[-lengths[-1] :]
    assert np.array_equal(last, smoothed(paths[-1], lengths[-1:], 3))


def test_the_tracking_noise_is_found_and_a_filter_suggested() -> None:
    recorded = Rollouts.from_demonstrations(recorded_pairs())
    assert suggested_smoothing(recorded) == 1
    rng = np.random.default_rng(0)
    noisy = replace(
        recorded, positions=recorded.positions + rng.normal(0, 0.02, recorded.positions.shape)
    )
    paths = [noisy.path(index) for index in range(len(noisy))]
    assert tracking_noise(paths) == pytest.approx(0.02, rel=0.2)
    assert suggested_smoothing(noisy) in (3, 5)
