"""Searches that start from recorded ones: their plume, their warm-up, their senses."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from refusals import refuses
from search_worlds import WIND, recorded, search_world

from animarl_envs.demos.packaged import load_packaged
from animarl_envs.locomotion import COAST, apply_actions
from animarl_envs.scenario import make_scenario
from animarl_envs.species import SILKMOTH
from animarl_envs.species.silkmoth import RECORDED_TURNING
from animarl_envs.worlds.search.layout import ALIKE, Seen
from animarl_envs.worlds.search.world import SearchWorld, demonstration_observations


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


def test_offline_observations_follow_the_recorded_condition() -> None:
    demos = recorded()
    seen = demonstration_observations(SILKMOTH, demos)
    assert seen.shape == (240, 1, ALIKE) and seen.dtype == np.float32
    reduced = np.repeat(demos.condition == 1, 40)
    assert not seen[reduced][..., Seen.FLOW : Seen.WIND_BACK + 1].any()
    assert (seen[~reduced][..., WIND].sum(axis=-1) == 1.0).all()
    hit = demos.signals["odour_left"]
    assert (seen[hit, 0, 3] == 1.0).all() and (seen[~hit, 0, 3] < 1.0).all()


def test_recorded_headings_are_the_body_s_where_it_turns_by_itself() -> None:
    """Wind, visual flow and body angle are then those of the recorded heading."""
    heading = wandering()
    demos = recorded(heading=heading)
    species = replace(SILKMOTH, turning=RECORDED_TURNING)
    seen = demonstration_observations(species, demos, condition=0)[:, 0]
    angle = (heading % (2 * np.pi)) - np.pi  # from upwind, to the left
    np.testing.assert_allclose(seen[:, Seen.BODY_ANGLE], angle, atol=1e-6)
    quarter = np.round(angle / (np.pi / 2)).astype(int) % 4  # faces upwind, left of it, ...
    sides = [Seen.WIND_FRONT, Seen.WIND_RIGHT, Seen.WIND_BACK, Seen.WIND_LEFT]
    assert (seen[np.arange(240), np.array(sides)[quarter]] == 1.0).all()
    later = np.arange(240) % 40 > 0
    turned = np.diff(heading, prepend=heading[0])
    turned = (turned + np.pi) % (2 * np.pi) - np.pi
    np.testing.assert_allclose(seen[later, Seen.YAW_RATE], turned[later] / 0.5, atol=1e-5)
    follows = demonstration_observations(SILKMOTH, demos, condition=0)[:, 0]
    assert np.abs(follows[:, Seen.BODY_ANGLE] - angle).mean() > 0.5


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
    scenario = make_scenario("silkmoth", split=None)
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
