"""A trained policy keeps its scales in a changed world: same places and velocities, same inputs."""

from dataclasses import replace
from typing import Any, get_args

import numpy as np
import pytest
from numpy.typing import NDArray
from refusals import refuses

from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.packaged import load_packaged
from animarl_envs.scenario import Scenario, make_scenario
from animarl_envs.species import SPECIES, Species, get_species
from animarl_envs.species.base import Reading
from animarl_envs.species.options import change_world, with_options
from animarl_envs.worlds import demonstration_observations, make_world, observation_components
from animarl_envs.worlds.base import World
from animarl_envs.worlds.chase.world import observe

Array = NDArray[Any]
CHASES = [name for name, species in SPECIES.items() if species.world == "chase"]
PURSUITS = [name for name in CHASES if "target" in SPECIES[name].roles]
OF_THE_FIELD = ("distance to the edge", "centre of the arena", "tanh of distance to the wall")
OF_THE_WALL = ("direction of the wall", "outwards", "along")


def trained(name: str) -> Species:
    """A species that senses all that there is."""
    more = {"senses_past": True, "senses_time": True, "senses_course": True, "senses_heading": True}
    return with_options(get_species(name), **(more if name in CHASES else {}))


def changes(species: Species) -> list[dict[str, Any]]:
    """Every kind of change of the world, each alone and all together."""
    last, first = species.individuals[-1], species.locomotion[0]
    each: list[dict[str, Any]] = [
        {"locomotion": {last: 1.3}}, {"locomotion": dict.fromkeys(species.individuals, 0.5)},
        {"locomotion": {last: {"damping": min(1.0, 2.0 * first.damping + 0.1)}}},
        {"arena": 1.5 * species.arena.size}, {"contact_radius": 2.0 * species.contact_radius},
        {"time_limit": 12},
    ]  # fmt: skip
    return [*each, {key: value for one in each for key, value in one.items()}]


def few(species: Species) -> Demonstrations:
    return load_packaged(species.name).select(episodes=np.arange(4))


def replayed(species: Species) -> Array:
    """What is observed in a world where everybody follows its recording, ``(steps, B, K, n)``."""
    demos = few(species)
    names = species.individuals
    scenario = Scenario(species=species, demos=demos, drivers=("replay",) * len(names))
    world = make_world(scenario, len(demos.lengths))
    world.reset(demo=np.arange(len(demos.lengths)))
    seen = [world.observation.copy()]
    for _ in range(min(15, int(demos.lengths.min()) - 1)):
        world.step(np.zeros((world.num_copies, len(names)), dtype=np.int64))
        seen.append(world.observation.copy())
    return np.stack(seen)


def names_of(species: Species) -> list[str]:
    return [one.name for one in observation_components(species)]


@pytest.mark.parametrize("name", SPECIES)
def test_the_same_places_and_velocities_give_the_same_inputs_in_every_changed_world(
    name: str,
) -> None:
    species = trained(name)
    before, recorded = replayed(species), demonstration_observations(species, few(species))
    for change in changes(species):
        changed = change_world(species, **change)
        of_edge = (*OF_THE_FIELD, *OF_THE_WALL) if "arena" in change else ()
        same = np.array([not any(part in one for part in of_edge) for one in names_of(species)])
        assert same.mean() > 0.7
        np.testing.assert_array_equal(replayed(changed)[..., same], before[..., same], str(change))
        again = demonstration_observations(changed, few(species))
        np.testing.assert_array_equal(again[..., same], recorded[..., same], str(change))
    mixed = with_options(species, **changes(species)[-1])  # what was done before
    assert (replayed(mixed) != before).any()


@pytest.mark.parametrize("name", SPECIES)
def test_an_unchanged_world_is_observed_as_without_scales(name: str) -> None:
    species = trained(name)
    np.testing.assert_array_equal(replayed(change_world(species)), replayed(species))
    np.testing.assert_array_equal(replayed(change_world(species, "knows")), replayed(species))


@pytest.mark.parametrize("name", PURSUITS)
def test_the_same_distance_to_the_wall_gives_the_same_inputs_in_every_arena(name: str) -> None:
    species = with_options(trained(name), rebound=True)
    wide = change_world(species, arena=2.0 * species.arena.size)
    names = names_of(species)
    walls = [c for c, one in enumerate(names) if "wall" in one or "edge" in one or "along" in one]
    rows = []
    for one in (species, wide):
        position = np.tile([one.arena.edge - 0.06, 0.0], (1, species.num_individuals, 1))
        position[0, 1:, 0] -= 0.1
        velocity = np.tile([0.02, 0.01], (1, species.num_individuals, 1))
        rows.append(observe(one, position, velocity)[0][0, 0, walls])
    assert len(walls) > 5
    np.testing.assert_allclose(rows[0], rows[1], atol=1e-5)


def placed(species: Species, position: Array, velocity: Array) -> World:
    world = make_world(make_scenario(species, demos=None))
    world.reset()
    state = world.get_state()
    state["position"][:], state["velocity"][:] = position, velocity
    world.set_state(state)
    world.step(np.full((1, len(position)), species.num_actions - 1))
    return world


@pytest.mark.parametrize("name", PURSUITS)
def test_more_others_change_no_input_about_oneself_and_the_nearer(name: str) -> None:
    species = with_options(get_species(name), num_pursuers=2)
    more = change_world(species, num_pursuers=5)
    assert more.scales.locomotion[:2] == species.locomotion[:2]
    assert more.scales.locomotion[-1] == species.locomotion[-1]
    rng, near = np.random.default_rng(0), 0.1 * species.arena.size
    position, velocity = rng.uniform(-near, near, (3, 2)), 0.01 * rng.normal(size=(3, 2))
    far = np.tile([[0.9 * species.arena.size, 0.0]], (3, 1))
    places = np.concatenate([position[:2], far, position[2:]])
    crowd = placed(more, places, np.concatenate([velocity[:2], np.zeros((3, 2)), velocity[2:]]))
    alone = placed(species, position, velocity)
    shared = [names_of(more).index(one) for one in names_of(species)]
    for i, k in ((0, 0), (1, 1), (2, 5)):
        np.testing.assert_array_equal(crowd.observation[0, k, shared], alone.observation[0, i])


@pytest.mark.parametrize("reading", get_args(Reading))
@pytest.mark.parametrize("name", SPECIES)
def test_a_full_thrust_is_perceived_as_one_in_every_body(name: str, reading: Reading) -> None:
    """A recorded animal acted with the body of the recordings, a simulated one with its own."""
    species = with_options(get_species(name), warmup=3)
    bodies = {one: {"thrust": 0.02, "damping": 0.3} for one in species.individuals}
    changed = change_world(species, reading, locomotion=bodies)
    names = names_of(changed)
    felt = [i for i, one in enumerate(names) if "acceleration" in one and "/ u" in one]
    world, usual = (
        make_world(make_scenario(one, demos=few(species))) for one in (changed, species)
    )
    assert len(felt) == 2
    for one in (world, usual):
        one.reset(demo=np.zeros(1, dtype=np.int64))
    for t in range(6):
        for one in (world, usual):
            one.step(np.zeros((1, species.num_individuals), dtype=np.int64))
        push = np.linalg.norm(world.observation[0][:, felt], axis=-1)
        if t >= species.warmup:
            np.testing.assert_allclose(push, species.locomotion[0].magnitudes[0], rtol=1e-4)
        elif reading == "habit":
            same = world.observation[0][:, felt] == usual.observation[0][:, felt]
            assert same.all()


@pytest.mark.parametrize("name", SPECIES)
def test_who_knows_its_body_perceives_its_motion_in_units_of_it(name: str) -> None:
    """Half the thrust and half the velocity look like before, and nothing else changes."""
    species, demos = trained(name), few(trained(name))
    changed = change_world(species, "knows", locomotion=dict.fromkeys(species.individuals, 0.5))
    names = names_of(species)
    own = [
        c for c, one in enumerate(names)
        if "own velocity" in one or "own speed" in one or "own acceleration" in one
        or "delays ago" in one
        or (name not in CHASES and ("velocity" in one or "speed" in one or "acceleration" in one))
    ]  # fmt: skip
    slower = {"positions": demos.positions / 2, "initial_velocity": demos.initial_velocity / 2}
    half = replace(demos, **slower)
    before = demonstration_observations(species, demos)[..., own]
    after = demonstration_observations(changed, half)[..., own]
    assert len(own) >= 9
    np.testing.assert_allclose(after, before, atol=1e-5)
    rest = [c for c, one in enumerate(names) if c not in own and "mean " not in one]
    same = [demonstration_observations(one, demos)[..., rest] for one in (changed, species)]
    np.testing.assert_array_equal(*same)


def test_scales_are_checked() -> None:
    agent = get_species("agent")
    other = get_species("silkmoth").scales
    refuses("give SenseScales of 3 individuals", with_options, agent, sense_scales=other)
    refuses("choose 'habit' or 'knows'", change_world, agent, "mixed")
    reading: Reading = "knows"
    assert change_world(agent, reading, arena=2.0).scales.arena_size == agent.arena.size
