"""The order in which a chaser sees the others: by distance, ties by index, few or many of them."""

import pickle

import numpy as np
import pytest

from animarl_envs.focus import focus_directions
from animarl_envs.scenario import make_scenario
from animarl_envs.worlds import make_world
from animarl_envs.worlds.chase.neighbours import FEW
from animarl_envs.worlds.chase.world import ChaseWorld, observe


def world_of(pursuers: int, copies: int = 3) -> ChaseWorld:
    scenario = make_scenario("agent", demos=None, num_pursuers=pursuers)
    world = make_world(scenario, copies)
    assert isinstance(world, ChaseWorld)
    return world


def columns(world: ChaseWorld, name: str) -> list[int]:
    names = [component.name for component in world.observation_components]
    return [at for at, each in enumerate(names) if each.endswith(name)]


@pytest.mark.parametrize("pursuers", [2, FEW, FEW + 1, FEW + 2, 20])
def test_others_come_by_distance_whatever_came_before(pursuers: int) -> None:
    world = world_of(pursuers)
    apart = columns(world, " distance")
    rng = np.random.default_rng(pursuers)
    for _ in range(4):
        world.step(rng.integers(13, size=(3, pursuers + 1)))
        at = world.position
        for i in range(pursuers + 1):
            others = [j for j in range(pursuers) if j != i]
            expected = np.sort(np.linalg.norm(at[:, others] - at[:, i, None], axis=2), axis=1)
            if i < pursuers:
                to_target = np.linalg.norm(at[:, -1] - at[:, i], axis=1)
                expected = np.concatenate([to_target[:, None], expected], axis=1)
            seen = world.sensed[:, i][:, apart][:, : expected.shape[1]]
            np.testing.assert_allclose(seen, expected, rtol=1e-6)


@pytest.mark.parametrize("pursuers", [3, 12])
def test_equal_distances_are_ordered_by_index(pursuers: int) -> None:
    """On a circle around the target all are as far: it sees them in the order of their indices."""
    species = world_of(pursuers).scenario.species
    angle = 2 * np.pi * np.arange(pursuers) / pursuers
    position = np.zeros((1, pursuers + 1, 2))
    position[0, :-1, 0] = np.sign(np.cos(angle)) * 0.5  # only two places: distances tie exactly
    velocity = np.zeros_like(position)
    velocity[0, :-1, 1] = np.arange(pursuers)  # tells them apart
    seen, _ = observe(species, position, velocity)  # type: ignore[arg-type]
    world = world_of(pursuers)
    names = [component.name for component in world.observation_components]
    going = [
        at for at, name in enumerate(names) if name.startswith("other") and "velocity y" in name
    ]
    np.testing.assert_allclose(seen[0, -1, going][:pursuers], np.arange(pursuers))


@pytest.mark.parametrize("pursuers", [1, 2, FEW + 3])
@pytest.mark.parametrize("target", [False, True])
def test_nothing_but_observations_depends_on_who_observes(pursuers: int, target: bool) -> None:
    scenario = make_scenario("agent", demos=None, num_pursuers=pursuers, observation_noise=0.01)
    one = pursuers if target else 0
    all_, few = make_world(scenario, 9), make_world(scenario, 9, [one])
    rng = np.random.default_rng(pursuers)
    for world in (all_, few):
        world.reset()
    for t in range(12):
        actions = rng.integers(13, size=(9, pursuers + 1))
        for world in (all_, few):
            world.step(actions)
            world.reset(world.terminated | world.truncated)
        full, asked = all_.get_state(), few.get_state()
        for name in full.keys() - {"sensed", "observation", "history"}:
            np.testing.assert_array_equal(asked[name], full[name], err_msg=f"{name}, step {t}")
        assert np.array_equal(few.observation[:, one], all_.observation[:, one])
        others = np.arange(pursuers + 1) != one
        assert not few.sensed[:, others].any()
        few = pickle.loads(pickle.dumps(few))


def test_the_focus_at_distance_zero_is_the_same_in_worlds_and_in_recordings() -> None:
    species = world_of(2).scenario.species
    position = np.array(
        [[[0.1, 0.2], [0.5, 0.5], [0.1, 0.2]], [[0.3, 0.1], [0.3, 0.1], [0.3, 0.1]]]
    )
    _, towards = observe(species, position, np.zeros_like(position))  # type: ignore[arg-type]
    np.testing.assert_allclose(towards, focus_directions(position, species.roles))
    world = world_of(2, 1)
    world._position[...] = np.array([[0.0, 0.3], [0.5, 0.0], [0.2, 0.1]])[:, :, None]
    world.reset(np.zeros(1, dtype=bool))  # observes again
    world._position[0] = world._position[2]
    world.reset(np.zeros(1, dtype=bool))  # observes again
    np.testing.assert_allclose(world.towards, focus_directions(world.position, species.roles))
