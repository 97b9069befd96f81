"""What species are observed by: no dead component, honest ranges, a chase's mirror image."""

import itertools
import math
from dataclasses import replace
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from numpy.typing import NDArray
from recordings import dogs
from turned_bodies import recorded, species

from animarl_algos import SlotVecEnv
from animarl_envs import environment_id, parallel_env
from animarl_envs.arena import Arena
from animarl_envs.demos.packaged import load_packaged
from animarl_envs.scenario import make_scenario
from animarl_envs.species import CUSTOM, SPECIES
from animarl_envs.species.silkmoth import RECORDED_TURNING
from animarl_envs.worlds import (
    demonstration_observations,
    make_world,
    mirror,
    observation_components,
)
from animarl_envs.worlds.base import World

Array = NDArray[Any]
CHASES: list[tuple[str, dict[str, Any]]] = [
    ("agent", {}), ("fly", {}), ("newt", {}), ("fly", {"num_pursuers": 1}),
    ("agent", {"demos": None, "num_pursuers": 4}), ("agent", {"demos": None, "arena": "open"}),
    ("agent", {"demos": None, "num_targets": 3}), ("custom", {"demos": dogs(2)}),
    ("agent", {"demos": None, "arena": "ring=0.4", "rebound": True}),
    ("agent", {"demos": None, "arena": "rectangle=0.5", "rebound": True}),
    ("agent", {"demos": None, "arena": "open", "obstacles": ["0.4,0,0.2"]}),
    ("agent", {"demos": None, "arena": "open", "landmarks": {"stripe": "1,0", "lamp": "-.5,0"}}),
    ("newt", {"senses_past": True, "senses_time": True, "senses_course": True}),
]  # fmt: skip
MOTHS: list[tuple[str, dict[str, Any]]] = [
    ("silkmoth", {}),
    ("silkmoth", {"demos": None, "turning": RECORDED_TURNING}),
]
chases = pytest.mark.parametrize(("name", "options"), CHASES)


def walk(world: World, steps: int, seed: int = 0) -> Array:
    """Observations ``(steps, B, K, n)`` under random actions, ended episodes begun anew."""
    rng, rows = np.random.default_rng(seed), []
    world.seed(np.arange(world.num_copies) + 1000 * seed)
    world.reset()
    for _ in range(steps):
        world.step(rng.integers(world.num_actions, size=(world.num_copies, world.num_individuals)))
        rows.append(world.observation.copy())
        world.reset(world.terminated | world.truncated)
    return np.stack(rows)


@pytest.mark.parametrize(("name", "options"), [*CHASES, ("custom", {"demos": recorded()}), *MOTHS])
def test_no_component_is_constant_or_a_copy_of_another(name: str, options: Any) -> None:
    world = make_world(make_scenario(name, **options), 100)
    seen = walk(world, 100).astype(np.float64)  # 10,000 steps
    names = [c.name for c in world.observation_components]
    assert len(set(names)) == len(names) == seen.shape[-1]
    for i in range(world.num_individuals):
        rows = seen[:, :, i].reshape(-1, len(names))
        deviation = rows.std(axis=0)
        assert (deviation > 1e-6).all(), names[int(np.argmin(deviation))]
        alike = np.abs(np.corrcoef(rows.T)) - np.eye(len(names))
        worst = np.unravel_index(np.argmax(alike), alike.shape)
        assert alike.max() < 0.9999, [names[k] for k in worst]


def test_landmarks_are_perceived_by_direction_and_distance_until_they_are_removed() -> None:
    """By individual 0 above the middle, whose target is to the lower left of it."""
    marks = {"stripe": (0.0, 1.0), "lamp": (0.5, 0.5)}
    start = [[0.0, 0.5], [0.5, 0.0], [-0.5, 0.0]]
    scenario = make_scenario("agent", demos=None, start=start, landmarks=marks)
    removed = scenario.species.arena.without_landmark("stripe").landmarks
    for landmarks, stripe in (
        (marks, [-(0.5**0.5), -(0.5**0.5), math.tanh(0.5)]),
        (removed, [0, 0, 1]),
    ):
        made = make_world(make_scenario("agent", demos=None, start=start, landmarks=landmarks))
        made.reset()
        names = [one.name for one in made.observation_components][-6:]
        assert names[0] == "stripe bearing cosine" and names[5] == "lamp tanh of distance / size"
        assert made.observation_components[-4].description == "stripe is [nearer|farther]"
        lamp = [-(0.5**0.5), 0.5**0.5, math.tanh(0.5)]
        assert made.observation[0, 0, -6:] == pytest.approx([*stripe, *lamp], abs=1e-6)


def test_every_species_is_looked_at() -> None:
    assert {name for name, _ in CHASES} | {"silkmoth", "solo", "shoal"} == {*SPECIES, CUSTOM}


def test_a_searcher_s_documented_ranges_are_reached_by_random_steps() -> None:
    world = make_world(make_scenario("silkmoth", demos=None), 100)
    seen = walk(world, 100).reshape(-1, len(world.observation_components))  # 10,000 steps
    reached = np.ptp(seen, axis=0)
    for component, span in zip(world.observation_components, reached, strict=True):
        assert 0.5 * (component.high - component.low) <= span, component


def extremes(world: World) -> None:
    """Every copy in a state that an episode can reach: anywhere, as fast as bodies get."""
    species, rng = world.scenario.species, np.random.default_rng(3)
    shape = (world.num_copies, world.num_individuals)
    edge = species.arena.edge
    position = rng.uniform(-edge, edge, (*shape, 2))
    position[::2] = edge * np.sign(position[::2])  # half of them in the corners, to be far apart
    if species.arena.shape == "disc":
        position /= np.maximum(np.linalg.norm(position, axis=-1, keepdims=True) / edge, 1.0)
    close = slice(0, None, 5)
    position[close] = position[close, :1] + 1e-3 * rng.normal(size=position[close].shape)
    angle = rng.uniform(0, 2 * np.pi, shape)
    top = [m.top_speed(species.dt, species.time_limit) for m in species.locomotion]
    speed = np.array(top) * rng.choice([0.0, 0.95], shape)
    state = world.get_state()
    state["position"][:] = position
    state["velocity"][:] = speed[..., None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    world.set_state(state)


@pytest.mark.parametrize("kind", ["compact", "full", "paper"])
@pytest.mark.parametrize(
    ("name", "options"),
    [("agent", {}), ("agent", {"rebound": True}), ("fly", {}), ("newt", {}),
     ("newt", {"num_pursuers": 3}), ("fly", {"num_pursuers": 1, "rebound": False})],
)  # fmt: skip
def test_documented_ranges_hold_and_are_reached(name: str, options: Any, kind: str) -> None:
    world = make_world(make_scenario(name, demos=None, observation=kind, **options), 4000)
    world.reset()
    extremes(world)
    rng, slots = np.random.default_rng(4), (4000, world.num_individuals)
    world.step(rng.integers(world.num_actions, size=slots))
    seen = world.observation.reshape(-1, world.observation.shape[-1])
    for c, component in enumerate(world.observation_components):
        low, high = seen[:, c].min(), seen[:, c].max()
        spare = 1e-5 * (component.high - component.low)
        assert component.low - spare <= low and high <= component.high + spare, component
        if kind != "paper":
            assert high - low >= 0.5 * (component.high - component.low), component


@pytest.mark.parametrize("kind", ["compact", "full", "paper"])
@chases
def test_a_mirrored_world_is_seen_mirrored(name: str, options: Any, kind: str) -> None:
    scenario = make_scenario(name, observation=kind, warmup=0, **options)
    one, two = make_world(scenario, 20), make_world(scenario, 20)
    image = mirror(one.scenario.species)
    for world in (one, two):
        world.reset()
    state = one.get_state()
    for key in ("position", "velocity", "acceleration", "past", "towards"):
        state[key] = state[key] * [1.0, -1.0]
    two.set_state(state)
    rng = np.random.default_rng(0)
    for _ in range(30):
        actions = rng.integers(one.num_actions, size=(20, one.num_individuals))
        one.step(actions)
        two.step(image.actions[actions])
        assert two.observation == pytest.approx(image.observation(one.observation), abs=1e-4)
        assert np.array_equal(two.outcome, one.outcome)
        assert two.reward == pytest.approx(one.reward)


@pytest.mark.parametrize(
    ("name", "seen"),
    [*itertools.product(["agent", "fly", "newt"],
                        [{"observation": kind} for kind in ("compact", "full", "paper")]),
     ("newt", {"senses_past": True, "senses_time": True, "senses_course": True,
               "time_limit": 20}),
     (species(), {"demos": recorded()}), (species(), {"demos": dogs(2)})],
)  # fmt: skip
def test_recorded_frames_are_seen_as_the_world_sees_them(name: Any, seen: dict[str, Any]) -> None:
    demos = seen.get("demos") or load_packaged(name).select(split="test")
    drivers = dict.fromkeys(demos.individuals, "replay")
    options = {"demos": demos, "split": None, "drivers": drivers, **seen}
    scenario = make_scenario(name, contact_radius=1e-9, **options)
    world = make_world(scenario, len(demos))
    world.reset(demo=np.arange(len(demos)))
    recorded = demonstration_observations(scenario.species, demos)
    for t in range(int(demos.lengths.max())):
        lasting = demos.lengths > t
        frames = demos.offsets[:-1][lasting] + t
        assert world.observation[lasting] == pytest.approx(recorded[frames], abs=1e-6)
        world.step(np.zeros((len(demos), world.num_individuals), dtype=int))


def test_time_is_seen_from_the_start_by_each_copy_of_a_species_that_senses_it() -> None:
    names = [c.name for c in make_world(make_scenario("fly")).observation_components]
    assert not [name for name in names if "since the start" in name]
    world = make_world(make_scenario("fly", demos=None, senses_time=True, time_limit=8), 2)
    at = [k for k, c in enumerate(world.observation_components) if "since the start" in c.name]
    world.reset()
    for _ in range(3):
        world.step(np.zeros((2, 3), dtype=int))
    world.reset(np.array([True, False]))
    since = world.observation[:, :, at]
    assert not since[0].any()
    assert since[1] == pytest.approx(np.full((3, 1), math.log(4.0)), abs=1e-6)


def test_past_velocities_are_exponential_means_that_begin_anew_with_each_copy() -> None:
    world = make_world(make_scenario("newt", senses_past=True, warmup=0), 2)
    world.reset()
    start = world.velocity.copy()
    names = [c.name for c in world.observation_components]
    now, past = (
        [names.index(f"tanh of {what} / (3 u dt) {side}") for side in ("ahead", "left")]
        for what in ("own velocity", "mean velocity over 6 steps")
    )
    assert np.array_equal(world.observation[..., past], world.observation[..., now])
    held = [start]
    action = np.random.default_rng(1).integers(12, size=(5, 2, world.num_individuals))
    for t in range(5):
        world.step(action[t])
        held.append(world.velocity.copy())
    mean = start
    for velocity in held[:-1]:
        mean = mean + (velocity - mean) / 6
    x, y = np.moveaxis(world.towards, -1, 0)  # type: ignore[attr-defined]
    ahead = np.stack([mean[..., 0] * x + mean[..., 1] * y, mean[..., 1] * x - mean[..., 0] * y], -1)
    species = world.scenario.species
    stride = 3 * species.dt * np.array([m.thrust for m in species.locomotion])
    expected = np.tanh(ahead / stride[:, None])
    assert world.observation[..., past] == pytest.approx(expected, abs=1e-5)
    world.reset(np.array([True, False]))
    assert np.array_equal(world.observation[0][:, past], world.observation[0][:, now])
    assert world.observation[1][:, past] == pytest.approx(expected[1], abs=1e-5)


def test_own_speed_is_seen_at_the_scale_of_the_smallest_thrust() -> None:
    many = {"damping": 0.1, "thrust": 0.5, "magnitudes": (2.0, 1.0, 0.25)}
    locomotion = dict.fromkeys(SPECIES["fly"].individuals, many)
    world = make_world(make_scenario("fly", demos=None, locomotion=locomotion), 1)
    world.reset()
    smallest = world.num_actions - 2  # the last direction of the last magnitude
    world.step(np.full((1, 3), smallest))
    names = [c.name for c in world.observation_components]
    at = [names.index(f"tanh of own velocity / (u dt) {side}") for side in ("ahead", "left")]
    seen = np.linalg.norm(np.arctanh(world.observation[..., at]), axis=-1)
    assert seen == pytest.approx(1.0, abs=1e-3)


@pytest.mark.parametrize("vector", ["velocity", "acceleration"])
def test_harmonics_tell_a_direction_and_fade_with_its_vector(vector: str) -> None:
    scenario = make_scenario("agent", demos=None, senses_course=True)
    world = make_world(scenario, 300)
    walk(world, 20, seed=2)
    state = world.get_state()
    state["velocity"][:100] *= 1e-3
    state["velocity"][0] = 0.0
    world.set_state(state)
    world.step(np.full((300, world.num_individuals), 12))  # none: acceleration 0
    world.step(np.random.default_rng(3).integers(13, size=(300, world.num_individuals)))
    names = [c.name for c in world.observation_components]
    source = {"velocity": "own velocity", "acceleration": "own acceleration / u"}[vector]
    at = [names.index(f"{source} {side}") for side in ("ahead", "left")]
    ahead, left = np.moveaxis(world.observation[..., at].astype(np.float64), -1, 0)
    unit = [m.thrust * scenario.species.dt for m in scenario.species.locomotion]
    faint = 0.1 * (np.array(unit) if vector == "velocity" else 1.0)
    length, angle = np.hypot(ahead, left), np.arctan2(left, ahead)
    clear = length / (length + faint)
    assert (clear < 0.2).any() and (clear > 0.9).any()
    for k, (function, name) in itertools.product((2, 3, 4), [(np.cos, "cosine"), (np.sin, "sine")]):
        seen = world.observation[..., names.index(f"own {vector} harmonic {k} {name}")]
        assert seen == pytest.approx(clear * function(k * angle), abs=1e-4)


def accelerations(world: World) -> Array:
    """Own acceleration ahead and to the left, ``(B, K, 2)``."""
    names = [c.name for c in world.observation_components]
    at = [names.index(f"own acceleration / u {side}") for side in ("ahead", "left")]
    return world.observation[..., at]


def test_a_new_episode_starts_without_acceleration_and_leaves_others_alone() -> None:
    world = make_world(make_scenario("fly", warmup=3), 6)
    world.reset()
    for _ in range(2):  # replayed: recorded accelerations
        world.step(np.zeros((6, 3), dtype=int))
    seen = accelerations(world).copy()
    assert (np.abs(seen).max(axis=(1, 2)) > 0.01).all() and np.abs(seen).max() <= 4.0
    saved = world.get_state()
    anew = np.arange(6) < 2
    world.reset(anew)
    assert not accelerations(world)[:2].any()
    assert np.array_equal(accelerations(world)[2:], seen[2:])
    world.set_state(saved)
    world.reset(anew)  # observes all of them again, from the state
    assert np.array_equal(accelerations(world)[2:], seen[2:])


def test_a_push_beyond_four_thrusts_is_seen_as_four() -> None:
    world = make_world(make_scenario("agent", demos=None, rebound=True), 1)
    world.reset()
    state = world.get_state()
    thrust = world.scenario.species.locomotion[0].thrust
    state["position"][:] = [[[0.5, 0.0], [-0.5, 0.0], [1.0, 0.0]]]
    state["velocity"][0, 2] = [100.0 * thrust * world.scenario.species.dt, 0.0]  # into the wall
    world.set_state(state)
    world.step(np.full((1, 3), world.num_actions - 1))
    assert accelerations(world)[0, 2].tolist() == [4.0, 0.0]  # away from it, and so at its focus


@pytest.mark.parametrize(
    ("name", "options", "size"),
    [("agent", {}, 15), ("fly", {"num_pursuers": 1}, 10), ("newt", {"num_pursuers": 3}, 20),
     ("shoal", {"neighbours": 2}, 17), ("solo", {"arena": Arena("disc", 1.0, 1.1)}, 7)],
)  # fmt: skip
def test_compact_observations_are_part_of_the_full_ones(name: str, options: Any, size: int) -> None:
    seen, names = {}, {}
    for kind in ("compact", "full"):
        world = make_world(make_scenario(name, demos=None, observation=kind, **options), 5)
        seen[kind] = walk(world, 40)
        names[kind] = [c.name for c in world.observation_components]
    assert len(names["compact"]) == size
    part = [names["full"].index(one) for one in names["compact"]]
    assert np.array_equal(seen["compact"], seen["full"][..., part])


@pytest.mark.parametrize("name", SPECIES)
def test_a_world_observes_what_its_species_says_however_it_is_made(name: str) -> None:
    id_, spec = environment_id(name), SPECIES[name]
    shorter = replace(spec, observation="compact")
    for given in (name, spec, shorter):
        size = len(observation_components(shorter if given is shorter else spec))
        made: list[Any] = [
            gym.make(id_, species=given).unwrapped,
            gym.make_vec(id_, num_envs=2, species=given).unwrapped,
            parallel_env(given),
            SlotVecEnv(given, 1, demos=None),
        ]
        assert {env.world.observation.shape[-1] for env in made} == {size}


@pytest.mark.parametrize(("name", "options"), [*CHASES, *MOTHS])
def test_random_walks_stay_within_the_ranges(name: str, options: Any) -> None:
    world = make_world(make_scenario(name, **options), 50)
    seen = walk(world, 60, seed=1)
    low, high = (np.array([getattr(c, k) for c in world.observation_components], np.float32)
                 for k in ("low", "high"))  # fmt: skip
    assert (seen >= low).all() and (seen <= high).all()
