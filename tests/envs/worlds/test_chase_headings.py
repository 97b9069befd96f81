"""Headings of a chase: a state that turns, is replayed, seen, mirrored and kept per copy."""

import math
import pickle
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from recordings import dogs, flock
from slow import slowly
from turned_bodies import SIDEWAYS, SLOW, recorded, species

from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.drawing.scene import SceneRecorder
from animarl_envs.fitting.custom_species import species_of
from animarl_envs.scenario import make_scenario
from animarl_envs.species.options import with_options
from animarl_envs.worlds import mirror
from animarl_envs.worlds.chase.world import ChaseWorld

Array = NDArray[Any]


def world_of(copies: int, demos: Demonstrations | None = None, **more: Any) -> ChaseWorld:
    return ChaseWorld(make_scenario(species(), demos=demos, split=None, **more), copies)


def columns(world: ChaseWorld, whose: str) -> list[int]:
    """Where cosine and sine of a heading stand in an observation."""
    names = [c.name for c in world.observation_components]
    return [names.index(f"{whose} {part}") for part in ("cosine", "sine")]


def test_bodies_turn_by_the_law_of_their_species() -> None:
    world, rng = world_of(20), np.random.default_rng(0)
    world.reset()
    heading, turn = world.heading.copy(), np.zeros((20, 3))
    for _ in range(30):
        world.step(rng.integers(12, size=(20, 3)))  # who coasts at rest has no direction of travel
        for i, rule in enumerate((SIDEWAYS, None, SLOW)):
            velocity = world.velocity[:, i]
            if rule is None:
                along = np.arctan2(velocity[:, 1], velocity[:, 0])
                assert np.exp(1j * world.heading[:, i]) == pytest.approx(np.exp(1j * along))
                continue
            turn[:, i] = rule.next_turn(turn[:, i], heading[:, i], velocity)
            heading[:, i] += turn[:, i]
            assert np.exp(1j * world.heading[:, i]) == pytest.approx(np.exp(1j * heading[:, i]))
            assert world.turn[:, i] == pytest.approx(turn[:, i])
    assert (np.abs(world.heading) <= math.pi).all()


def test_without_recording_bodies_at_rest_begin_towards_their_focus() -> None:
    world = world_of(5)
    world.reset()
    towards = world.position[:, -1:] - world.position[:, :-1]
    assert np.tan(world.heading[:, :-1]) == pytest.approx(towards[..., 1] / towards[..., 0])
    assert (np.cos(world.heading[:, :-1]) * towards[..., 0] > 0).all()
    own = world.observation[..., columns(world, "own heading")]
    assert own == pytest.approx(np.broadcast_to([1.0, 0.0], own.shape), abs=1e-6)
    coast = np.full((5, 3), 12)
    before = world.heading.copy()
    world.step(coast)
    assert np.array_equal(world.heading, before)


def test_warm_up_follows_recorded_headings_and_turns_on_from_there() -> None:
    demos = recorded()
    world = world_of(8, demos, warmup=4)
    world.reset(demo=np.arange(8))
    start = demos.offsets[:-1]
    heading = demos.signals["heading"]
    for t in range(5):
        shown = heading[start + t][:, [0, 2]]
        assert np.exp(1j * world.heading[:, [0, 2]]) == pytest.approx(np.exp(1j * shown))
        turn = world.turn.copy()
        world.step(np.zeros((8, 3), dtype=int))
    wanted = SIDEWAYS.next_turn(turn[:, 0], heading[start + 4, 0], world.velocity[:, 0])
    assert world.turn[:, 0] == pytest.approx(wanted)


def test_copies_begin_anew_by_themselves_and_a_saved_world_goes_on_alike() -> None:
    world, twin, rng = world_of(6, recorded()), world_of(6, recorded()), np.random.default_rng(2)
    world.reset()
    for _ in range(5):
        world.step(rng.integers(13, size=(6, 3)))
    heading, turn = world.heading.copy(), world.turn.copy()
    anew = np.arange(6) < 2
    world.reset(anew, demo=np.zeros(6, dtype=int))
    assert np.array_equal(world.heading[2:], heading[2:])
    assert np.array_equal(world.turn[2:], turn[2:]) and not world.turn[:2].any()
    first = recorded().signals["heading"][0, 0]
    assert np.exp(1j * world.heading[:2, 0]) == pytest.approx(np.exp([1j * first] * 2))
    twin.set_state(world.get_state())
    third = pickle.loads(pickle.dumps(world))
    actions = rng.integers(13, size=(6, 3))
    for each in (world, twin, third):
        each.step(actions)
    assert np.array_equal(twin.heading, world.heading)
    assert np.array_equal(third.observation, world.observation)


def test_worlds_without_headings_hold_none_and_can_be_set_as_before() -> None:
    scenario = make_scenario(species_of(dogs(2)), demos=dogs(2))
    world = ChaseWorld(scenario, 3)
    assert world.heading.shape == world.turn.shape == (3, 0)
    assert not {"heading", "turn"} & set(world.get_state())
    assert not [c for c in world.observation_components if "heading" in c.name]


def test_pictures_show_the_headings() -> None:
    world = world_of(2, recorded())
    world.reset()
    recorder = SceneRecorder(world, copy=1)
    recorder.start()
    for _ in range(3):
        world.step(np.zeros((2, 3), dtype=int))
        recorder.follow()
    scene = recorder.scene()
    assert np.array_equal(scene.headings, world.heading[1])
    world.step(np.zeros((2, 3), dtype=int))
    assert not np.array_equal(scene.headings, world.heading[1])


@pytest.mark.parametrize("many", [2, *slowly(6)])
def test_headings_of_all_are_seen_from_each_in_the_order_of_the_others(many: int) -> None:
    """As said by hand: few are sorted otherwise than many."""
    spec = with_options(
        species_of(flock(2)), num_targets=many, senses_heading=True, turning={"dog": SLOW}
    )
    world, rng = ChaseWorld(make_scenario(spec, demos=None), 5), np.random.default_rng(1)
    world.reset()
    for _ in range(4):
        world.step(rng.integers(13, size=(5, many + 1)))
    for b in range(5):
        for i in range(many + 1):
            away = np.linalg.norm(world.position[b] - world.position[b, i], axis=1)
            others = sorted((j for j in range(many) if j != i), key=lambda j: away[j])
            others = others if i == many else [many, *others]
            x, y = world.towards[b, i]
            places = ["own heading", *(f"other {r} heading" for r in range(1, many + 1))]
            for place, who in zip(places, [i, *others], strict=True):
                angle = world.heading[b, who] - math.atan2(y, x)
                seen = world.observation[b, i, columns(world, place)]
                assert seen == pytest.approx([math.cos(angle), math.sin(angle)], abs=1e-5)


def moved(world: ChaseWorld, turn: Array, heading: Array) -> ChaseWorld:
    """A copy of the world in which all is turned or mirrored by a matrix."""
    state = world.get_state()
    for key in ("position", "velocity", "acceleration", "past", "towards"):
        state[key] = state[key] @ turn.T
    other = ChaseWorld(world.scenario, world.num_copies)
    other.set_state(state | {"heading": heading})
    return other


def test_a_turned_world_is_seen_alike() -> None:
    world, rng, angle = world_of(10), np.random.default_rng(0), 0.7
    world.reset()
    world.step(rng.integers(13, size=(10, 3)))
    cosine, sine = math.cos(angle), math.sin(angle)
    turn = np.array([[cosine, -sine], [sine, cosine]])
    other = moved(world, turn, world.heading + angle)
    frames = [c.frame.startswith("egocentric") for c in world.observation_components]
    for _ in range(10):
        actions = rng.integers(13, size=(10, 3))
        world.step(actions)
        other.step(actions)
        seen = world.observation[..., frames]
        assert other.observation[..., frames] == pytest.approx(seen, abs=1e-4)
        assert np.exp(1j * (other.heading - world.heading - angle)) == pytest.approx(1.0)


def test_a_mirrored_world_with_mirrored_slips_is_seen_mirrored() -> None:
    world, rng = world_of(10), np.random.default_rng(0)
    opposite = [
        None if own is None else replace(own, slip=-own.slip) for own in (SIDEWAYS, None, SLOW)
    ]
    spec = with_options(species(), turning=opposite)
    image = mirror(spec)
    world.reset()
    world.step(rng.integers(13, size=(10, 3)))
    other = ChaseWorld(make_scenario(spec, demos=None), 10)
    state = world.get_state()
    for key in ("position", "velocity", "acceleration", "past", "towards"):
        state[key] = state[key] * [1.0, -1.0]
    other.set_state(state | {"heading": -state["heading"], "turn": -state["turn"]})
    for _ in range(20):
        actions = rng.integers(13, size=(10, 3))
        world.step(actions)
        other.step(image.actions[actions])
        assert other.observation == pytest.approx(image.observation(world.observation), abs=1e-4)
