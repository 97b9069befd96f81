"""The packaged Silkmoth demonstrations, their plume, and searches that start from recorded ones."""

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from refusals import refuses
from search_worlds import WIND, recorded, search_world

import animarl_envs  # noqa: F401  (registers the ids)
from animarl_envs.demos.packaged import FOLDER, load_packaged
from animarl_envs.locomotion import COAST, apply_actions
from animarl_envs.scenario import make_scenario
from animarl_envs.species import SILKMOTH
from animarl_envs.species.silkmoth import RECORDED_TURNING
from animarl_envs.worlds.search.layout import ALIKE, SearchEntry
from animarl_envs.worlds.search.world import SearchWorld, demonstration_observations
from tools.packaged_data.moth_comparison import comparison, rates
from tools.packaged_data.moth_published import PUBLISHED
from tools.packaged_data.moth_searches import SPLIT_OF_PATTERN, generate, search
from tools.packaged_data.moth_statistics import (
    describe,
    of_demonstrations,
    recorded_moths,
    wasserstein,
)

PACKAGED = load_packaged("silkmoth")


def test_sixty_synthetic_episodes_are_small_and_no_split_shares_a_plume() -> None:
    assert (FOLDER / "silkmoth.npz").stat().st_size < 2e6
    assert PACKAGED.synthetic
    assert "programmed moths" in str(PACKAGED.provenance["source"])
    assert PACKAGED.individuals == ("moth",) and PACKAGED.roles == ("searcher",)
    assert PACKAGED.dt == SILKMOTH.dt
    assert np.bincount(PACKAGED.condition).tolist() == [30, 30]
    plume = PACKAGED.signals["plume"][PACKAGED.offsets[:-1]]
    plumes = {s: set(plume[PACKAGED.split == s].tolist()) for s in ("train", "val", "test")}
    assert plumes == {"train": {0, 1, 2}, "val": {3}, "test": {4}}
    assert plumes["train"] == set(SILKMOTH.train_plumes)
    sizes = [(PACKAGED.split == s).sum() for s in ("train", "val", "test")]
    assert sizes == [36, 12, 12]
    for number, split in enumerate(SPLIT_OF_PATTERN):
        of_one = plume == number
        assert of_one.sum() == 12 and PACKAGED.condition[of_one].sum() == 6
        assert set(PACKAGED.split[of_one]) == {split}
        assert len(set(PACKAGED.recording[of_one])) == 1


def test_statistics_lie_near_the_published_ones() -> None:
    full, reduced = (of_demonstrations(PACKAGED.select(condition=c)) for c in (0, 1))
    assert full.rate == pytest.approx(PUBLISHED.reached_full, abs=0.05)
    assert reduced.rate == pytest.approx(PUBLISHED.reached_reduced, abs=0.05)
    duration = np.concatenate([full.duration, reduced.duration])
    assert duration.sum() == pytest.approx(PUBLISHED.total, rel=0.2)
    assert duration.min() == pytest.approx(PUBLISHED.shortest, abs=10.0)
    assert reduced.path.mean() - full.path.mean() > 0.5


@pytest.mark.realdata
def test_statistics_lie_near_those_of_recorded_moths(data_dir: Path) -> None:
    recorded = of_demonstrations(recorded_moths(data_dir / "silkmoth_mothvr"))
    assert len(recorded.reached) == 24 and recorded.reached.sum() == 22
    full = of_demonstrations(PACKAGED.select(condition=0))
    assert wasserstein(full.speed, recorded.speed) < 0.001
    assert wasserstein(full.turning, recorded.turning) < 0.7
    assert np.median(full.speed) == pytest.approx(np.median(recorded.speed), rel=0.25)
    rows = comparison(PACKAGED, recorded)
    assert len({len(row) for row in rows}) == 1
    assert any(f"{recorded.rate:.3f}" in row for row in rows)


def test_table_of_rates_has_a_row_per_case() -> None:
    head, rows = rates(8, 0, None)
    assert len(rows) == 6 and {len(row) for row in [head, *rows]} == {5}
    assert " of 8 = " in rows[0][2]


def test_statistics_of_a_known_track() -> None:
    """A quarter circle of 90 steps of one degree, then a stop."""
    angle = np.deg2rad(np.arange(91.0))
    track = 0.3 * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    track = np.concatenate([track, np.repeat(track[-1:], 10, axis=0)])
    found = describe([track, track[:11]], np.array([True, False]), 0.5)
    chord = 2 * 0.3 * np.sin(np.deg2rad(0.5))
    np.testing.assert_allclose(found.duration, [50.0, 5.0])
    np.testing.assert_allclose(found.path, [90 * chord, 10 * chord])
    assert found.resting == pytest.approx(10 / 110)
    np.testing.assert_allclose(found.turning, np.deg2rad(1.0) / 0.5, rtol=1e-9)
    assert len(found.turning) == 89 + 9
    assert found.rate == 0.5
    assert wasserstein(np.array([1.0, 2.0]), np.array([1.5, 2.5])) == pytest.approx(0.5)


def test_the_packaged_file_is_what_the_command_makes() -> None:
    made = generate(int(PACKAGED.provenance["seed"]))
    np.testing.assert_array_equal(made.lengths, PACKAGED.lengths)
    np.testing.assert_array_equal(made.outcome, PACKAGED.outcome)
    np.testing.assert_allclose(made.positions, PACKAGED.positions, atol=1e-9)


def test_what_makes_no_searches_is_refused(tmp_path: Path) -> None:
    refuses(r"no raw/\*\.csv", recorded_moths, tmp_path)
    refuses("episodes is 0", search, SILKMOTH, 0, episodes=0, seed=0)
    own = {"train_plumes": (0,), "test_plumes": (4,)}
    refuses("pattern 1, .* or pass demos=None", gym.make, "AnimaRL/Silkmoth-v0", **own)
    env = gym.make("AnimaRL/Silkmoth-v0", train_plumes=(0,), demos=None)
    assert env.reset(seed=0)[1]["demo"] == -1


def test_training_and_held_out_episodes_have_their_own_plumes() -> None:
    world = search_world(400, demos=recorded())
    used = np.array(world.patterns)[world.pattern]
    held_out = world.demos.split[world.demo] != "train"  # type: ignore[union-attr]
    assert set(used[held_out]) == set(SILKMOTH.test_plumes)
    assert set(used[~held_out]) == set(SILKMOTH.train_plumes)
    assert len(np.unique(world.phase)) > 200


def test_known_plume_of_a_demonstration_is_used() -> None:
    patterns, steps = np.array([4, 2, 1, 0, 3, 2]), np.array([7, 8, 519, 0, 3, 100])
    demos = recorded(plume=np.repeat(patterns, 40), plume_step=np.repeat(steps, 40))
    world = search_world(60, demos=demos)
    assert np.array_equal(np.array(world.patterns)[world.pattern], patterns[world.demo])
    assert np.array_equal(world.phase, steps[world.demo])
    refuses("pattern 9", search_world, demos=recorded(plume=np.full(240, 9)))


def wandering() -> np.ndarray:
    """Headings of 240 frames that have nothing to do with the way the moth walks."""
    return np.asarray(np.cumsum(np.random.default_rng(1).normal(0.0, 0.6, 240)))


@pytest.mark.parametrize("turning", [None, RECORDED_TURNING])
@pytest.mark.parametrize("signals", [{}, {"heading": wandering()}])
def test_warm_up_replays_positions_and_recorded_odour(turning: Any, signals: Any) -> None:
    demos = recorded(**signals)
    world = search_world(6, demos=demos, condition=0, turning=turning)
    species = replace(SILKMOTH, turning=turning)
    offline = demonstration_observations(species, demos, condition=0)
    first = demos.offsets[world.demo]
    np.testing.assert_array_equal(world.observation, offline[first])
    for step in range(1, SILKMOTH.warmup + 1):
        assert world.warming.all()
        world.step(np.full((6, 1), 3))
        np.testing.assert_array_equal(world.position, demos.positions[first + step])
        np.testing.assert_array_equal(world.observation, offline[first + step])
    assert not world.warming.any()
    velocity = world.velocity[:, 0].copy()
    world.step(np.full((6, 1), 3))
    loco = SILKMOTH.locomotion[0]
    wanted = apply_actions(velocity, np.full(6, 3), np.array([-1.0, 0.0]), loco, 0.5)
    np.testing.assert_allclose(world.velocity[:, 0], wanted, atol=1e-15)


def test_recorded_headings_are_the_body_s_where_it_turns_by_itself() -> None:
    """Wind, visual flow and body angle are then those of the recorded heading."""
    heading = wandering()
    demos = recorded(heading=heading)
    species = replace(SILKMOTH, turning=RECORDED_TURNING)
    seen = demonstration_observations(species, demos, condition=0)[:, 0]
    angle = (heading % (2 * np.pi)) - np.pi  # from upwind, to the left
    np.testing.assert_allclose(seen[:, SearchEntry.BODY_ANGLE], angle, atol=1e-6)
    quarter = np.round(angle / (np.pi / 2)).astype(int) % 4  # faces upwind, left of it, ...
    sides = [
        SearchEntry.WIND_FRONT,
        SearchEntry.WIND_RIGHT,
        SearchEntry.WIND_BACK,
        SearchEntry.WIND_LEFT,
    ]
    assert (seen[np.arange(240), np.array(sides)[quarter]] == 1.0).all()
    later = np.arange(240) % 40 > 0
    turned = np.diff(heading, prepend=heading[0])
    turned = (turned + np.pi) % (2 * np.pi) - np.pi
    np.testing.assert_allclose(seen[later, SearchEntry.YAW_RATE], turned[later] / 0.5, atol=1e-5)
    follows = demonstration_observations(SILKMOTH, demos, condition=0)[:, 0]
    assert np.abs(follows[:, SearchEntry.BODY_ANGLE] - angle).mean() > 0.5


def test_after_the_warm_up_the_body_turns_on_from_its_recorded_heading() -> None:
    demos = recorded(heading=wandering())
    world = search_world(6, demos=demos, turning=RECORDED_TURNING)
    for _ in range(SILKMOTH.warmup):
        world.step(np.full((6, 1), COAST))
    frame = demos.offsets[world.demo] + SILKMOTH.warmup
    heading, turn = demos.signals["heading"][frame], world.turn.copy()
    world.step(np.full((6, 1), 4))
    wanted = RECORDED_TURNING.next_turn(turn, heading, world.velocity[:, 0])
    np.testing.assert_allclose(world.turn, wanted, atol=1e-12)
    np.testing.assert_allclose(world.heading[:, 0], np.cos(heading + wanted), atol=1e-12)


def test_initial_heading_at_rest_comes_from_the_recording() -> None:
    demos = recorded(heading=np.full(240, 2.0))
    still = replace(demos, initial_velocity=np.zeros((6, 1, 2)))
    world = search_world(5, demos=still)
    np.testing.assert_allclose(world.heading, np.tile([math.cos(2.0), math.sin(2.0)], (5, 1)))


def test_demonstrations_without_odour_are_refused_offline() -> None:
    demos = replace(recorded(), signals={})
    refuses("odour_left", demonstration_observations, SILKMOTH, demos)


def test_recorded_actions_repeat_packaged_searches_in_their_plumes() -> None:
    """Pattern, phase, warm-up and senses are those of the demonstration, to its last step."""
    demos = load_packaged("silkmoth")
    scenario = make_scenario("silkmoth", split=None, senses_past=True)
    world = SearchWorld(scenario, len(demos))
    world.reset(demo=np.arange(len(demos)))
    assert np.array_equal(
        np.array(world.patterns)[world.pattern], demos.signals["plume"][demos.offsets[:-1]]
    )
    seen = demonstration_observations(scenario.species, demos)
    steps, at = demos.lengths - 1, demos.offsets[:-1]
    for t in range(int(steps.max())):
        running = steps > t
        assert (world.warming == (t < SILKMOTH.warmup)).all()
        actions = np.full((len(demos), 1), COAST)
        actions[running] = demos.signals["actions"][at[running] + t]
        world.step(actions)
        frame = at[running] + t + 1
        np.testing.assert_allclose(world.position[running], demos.positions[frame], atol=1e-12)
        np.testing.assert_allclose(world.observation[running], seen[frame], atol=1e-6)
        ended = (world.terminated | world.truncated)[running]
        assert np.array_equal(ended, steps[running] == t + 1)


def test_offline_observations_follow_the_recorded_condition() -> None:
    demos = recorded()
    seen = demonstration_observations(SILKMOTH, demos)
    assert seen.shape == (240, 1, ALIKE) and seen.dtype == np.float32
    reduced = np.repeat(demos.condition == 1, 40)
    assert not seen[reduced][..., SearchEntry.FLOW : SearchEntry.WIND_BACK + 1].any()
    assert (seen[~reduced][..., WIND].sum(axis=-1) == 1.0).all()
    hit = demos.signals["odour_left"]
    assert (seen[hit, 0, 3] == 1.0).all() and (seen[~hit, 0, 3] < 1.0).all()
