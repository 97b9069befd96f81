"""The chase world against a plain reference and recorded episodes, its walls and scripted rules."""

import math
import os
import pickle
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from pages import python
from recordings import dogs

import benchmarks.paper_readers  # noqa: F401  (registers the readers of published sets)
from animarl_envs.arena import SHAPE_CODES, Arena
from animarl_envs.demos.episode import PURSUER_OUT
from animarl_envs.demos.packaged import load_packaged
from animarl_envs.errors import InputError
from animarl_envs.focus import focus_directions
from animarl_envs.importing.readers import read
from animarl_envs.locomotion import COAST, Locomotion, apply_actions
from animarl_envs.scenario import make_scenario
from animarl_envs.species import AGENT
from animarl_envs.worlds import make_world
from animarl_envs.worlds.chase.neighbours import FEW
from animarl_envs.worlds.chase.scripted import HORIZON, LEADS, LOOKS, SOFTENING, WALL_WEIGHT, decide
from animarl_envs.worlds.chase.world import ChaseWorld, observe

Array = NDArray[Any]


def world(copies: int = 1, start: Any = None, **options: Any) -> ChaseWorld:
    made = ChaseWorld(make_scenario("agent", demos=None, start=start, **options), copies)
    made.reset()
    return made


def reference_focus(position: Array) -> Array:
    """Unit vectors towards each individual's focus."""
    target = len(position) - 1
    out = np.zeros_like(position)
    for i in range(len(position)):
        if i == target:
            aims = [float(np.linalg.norm(position[j] - position[i])) for j in range(target)]
            j = int(np.argmin(aims))
        else:
            j = target
        out[i] = (position[j] - position[i]) / np.linalg.norm(position[j] - position[i])
    return out


def reference_step(position: Array, velocity: Array, actions: Array) -> tuple[Array, Array]:
    """v' = (1 - d) v + u a dt, p' = p + v' dt for the Agent's numbers."""
    focus = reference_focus(position)
    after = np.zeros_like(velocity)
    for i, k in enumerate(actions):
        direction = math.atan2(focus[i, 1], focus[i, 0]) - math.radians(30 * k)
        unit = (math.cos(direction), math.sin(direction)) if k < COAST else (0.0, 0.0)
        after[i] = 0.75 * velocity[i] + 3.0 * 0.1 * np.array(unit)
    return position + after * 0.1, after


def reference_others(position: Array, i: int) -> list[int]:
    """Target first, then pursuers by distance."""
    target = len(position) - 1
    others = [j for j in range(target) if j != i]
    others.sort(key=lambda j: float(np.linalg.norm(position[j] - position[i])))
    return others if i == target else [target, *others]


def reference_full(position: Array, velocity: Array, before: Array, i: int) -> list[float]:
    """The documented components of observation "full" in an open arena of size 1."""
    focus = reference_focus(position)[i]
    turn = np.array([[focus[0], focus[1]], [-focus[1], focus[0]]])
    own, stride = turn @ velocity[i], 3.0 * 0.1
    entries = [*position[i], *own, *velocity[i], *np.tanh(own / stride), *np.tanh(own / 3 / stride)]
    pushed = turn @ (velocity[i] - 0.75 * before[i]) / stride
    entries += [math.log(np.linalg.norm(own) / stride + 0.3), *pushed, *focus]
    for rank, j in enumerate(reference_others(position, i)):
        offset = position[j] - position[i]
        apart, drift = turn @ offset, turn @ (velocity[j] - velocity[i])
        distance = float(np.linalg.norm(offset))
        bearing = math.atan2(apart[1], apart[0])
        if rank > 0:
            entries += [*apart]
        entries += [*drift, distance, 1.0 / (distance + 0.1)]
        if rank > 0:
            entries += [math.cos(bearing), math.sin(bearing)]
        entries += [*position[j], *velocity[j], *offset]
        if rank > 0:
            entries += [*(offset / distance)]
    return [float(e) for e in entries]


def reference_paper(position: Array, velocity: Array, before: Array, i: int) -> list[float]:
    """The documented components of observation "paper" of individual i, in order."""
    focus = reference_focus(position)[i]
    turn = np.array([[focus[0], focus[1]], [-focus[1], focus[0]]])
    others = reference_others(position, i)
    entries = [*position[i], *(turn @ velocity[i]), *focus]
    for j in others:
        apart = turn @ (position[j] - position[i])
        drift = turn @ (velocity[j] - velocity[i])
        entries += [*apart, *drift, float(np.linalg.norm(apart)), math.atan2(apart[1], apart[0])]
    return [float(e) for e in entries]


@pytest.mark.parametrize("kind", ["full", "paper"])
@pytest.mark.parametrize("pursuers", [1, 2, 3, FEW, FEW + 1, FEW + 2, 12])
def test_kernels_agree_with_the_scalar_reference(pursuers: int, kind: str) -> None:
    reference = {"full": reference_full, "paper": reference_paper}[kind]
    rng = np.random.default_rng(pursuers)
    copies, K = 10, pursuers + 1
    made = world(copies, num_pursuers=pursuers, arena="open", contact_radius=1e-9, observation=kind)
    position, velocity = made.position.copy(), made.velocity.copy()
    for _ in range(8):
        actions = rng.integers(13, size=(copies, K))
        made.step(actions)
        for b in range(copies):
            before = velocity[b].copy()
            position[b], velocity[b] = reference_step(position[b], velocity[b], actions[b])
            assert made.position[b] == pytest.approx(position[b], abs=1e-12)
            assert made.velocity[b] == pytest.approx(velocity[b], abs=1e-12)
            for i in range(K):
                expected = reference(position[b], velocity[b], before, i)
                assert made.observation[b, i] == pytest.approx(expected, abs=2e-6)


@pytest.mark.realdata
@pytest.mark.parametrize("condition", ["share", "indiv"])
def test_recorded_actions_reproduce_recorded_episodes(data_dir: Path, condition: str) -> None:
    file = data_dir / "agents_collab_hunting" / f"episodes_c2ae_{condition}_slow2.4.npz"
    demos = read(file)
    assert len(demos) == 500
    slow = {name: {"thrust": 2.4} for name in ("predator_0", "predator_1")}
    scenario = make_scenario(
        AGENT, demos=demos, split=None, locomotion=slow, contact_radius=0.1, time_limit=301,
        arena=Arena("square", size=1.0, boundary=1.0),
    )  # fmt: skip
    made = ChaseWorld(scenario, len(demos))
    made.reset(demo=np.arange(len(demos)))
    steps = demos.lengths - 1
    worst = 0.0
    for t in range(int(steps.max())):
        running = steps > t
        frame = demos.offsets[:-1] + t
        actions = np.full((len(demos), 3), COAST)
        actions[running] = demos.signals["actions"][frame[running]]
        made.step(actions)
        error = made.position[running] - demos.positions[frame[running] + 1]
        worst = max(worst, float(np.abs(error).max()))
        over = made.terminated | made.truncated
        ends = steps == t + 1
        assert np.array_equal(over[running], ends[running])
        assert np.array_equal(made.outcome[ends], demos.outcome[ends])
    assert worst < 1e-5


APART = [[-0.5, 0.0], [-0.5, 0.4], [0.5, 0.0]]


def test_contact_is_judged_before_the_boundary() -> None:
    made = world(start=[[1.05, 0.0], [0.0, 0.5], [1.09, 0.0]])
    made.step(np.array([[0, COAST, 6]]))  # the prey leaves, but within the predator's reach
    assert made.position[0, 2, 0] > 1.1
    assert made.outcome[0] == 1


def test_a_replayed_path_is_followed_and_then_coasts() -> None:
    demos = load_packaged("agent")
    drivers = {"predator_1": "replay", "prey": "replay"}
    scenario = make_scenario("agent", demos=demos, split=None, drivers=drivers, contact_radius=1e-9)
    made = ChaseWorld(scenario, 1)
    short = int(np.argmin(demos.lengths))
    episode = demos.episode(short)
    made.reset(demo=np.array([short]))
    for t in range(1, episode.num_steps + 1):
        made.step(np.array([[COAST, 0, 0]]))
        assert made.position[0, 1:] == pytest.approx(episode.positions[t, 1:], abs=1e-12)
    before = made.velocity[0, 1:].copy()
    made.step(np.array([[COAST, 0, 0]]))
    assert made.velocity[0, 1:] == pytest.approx(0.75 * before, abs=1e-12)


def test_a_late_observation_is_that_of_steps_ago_and_noise_has_the_stated_deviation() -> None:
    now, late = world(start=APART), world(start=APART, observation_delay=3)
    seen = [now.observation.copy()]
    for t in range(10):
        for made in (now, late):
            made.step(np.zeros((1, 3), dtype=int))
        seen.append(now.observation.copy())
        assert np.array_equal(late.observation, seen[max(0, t + 1 - 3)])
    clear, noisy = world(2000, start=APART), world(2000, start=APART, observation_noise=0.1)
    error = noisy.observation - clear.observation
    assert error.std() == pytest.approx(0.1, rel=0.02)
    assert abs(error.mean()) < 0.002


@pytest.mark.parametrize("pursuers", [3, 12])
def test_equal_distances_are_ordered_by_index(pursuers: int) -> None:
    """On a circle around the target all are as far: it sees them in the order of their indices."""
    made = world(num_pursuers=pursuers)
    angle = 2 * np.pi * np.arange(pursuers) / pursuers
    position = np.zeros((1, pursuers + 1, 2))
    position[0, :-1, 0] = np.sign(np.cos(angle)) * 0.5  # only two places: distances tie exactly
    velocity = np.zeros_like(position)
    velocity[0, :-1, 1] = np.arange(pursuers)  # tells them apart
    seen, _ = observe(made.scenario.species, position, velocity)  # type: ignore[arg-type]
    names = [component.name for component in made.observation_components]
    going = [at for at, one in enumerate(names) if one[:5] == "other" and "velocity y" in one]
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
    made = world(num_pursuers=2)
    species = made.scenario.species
    position = np.array([[[0.1, 0.2], [0.5, 0.5], [0.1, 0.2]], [[0.3, 0.1]] * 3])
    _, towards = observe(species, position, np.zeros_like(position))  # type: ignore[arg-type]
    np.testing.assert_allclose(towards, focus_directions(position, species.roles))
    made._position[...] = np.array([[0.2, 0.1], [0.5, 0.0], [0.2, 0.1]])[:, :, None]
    made.reset(np.zeros(1, dtype=bool))  # observes again
    np.testing.assert_allclose(made.towards, focus_directions(made.position, species.roles))


def test_so_many_pursuers_that_hardly_ever_all_are_apart_start_without_contact() -> None:
    scenario = make_scenario("agent", num_pursuers=1000, start="uniform")
    world = make_world(scenario, 2, observers=[])
    world.reset()
    apart = np.linalg.norm(world.position[:, :-1] - world.position[:, -1:], axis=-1)
    assert apart.min() >= scenario.species.contact_radius
    assert np.abs(world.position).max() <= scenario.species.start_half_side
    assert world.position[:, :-1].std() > 0.5 * scenario.species.start_half_side / np.sqrt(3.0)


@pytest.mark.parametrize(
    "options", [{"locomotion": {"prey": {"thrust": 1e-30}}}, {"arena": 1e20}, {"dt": 1e-9}]
)
def test_odd_options_keep_observations_finite(options: dict[str, Any]) -> None:
    world = make_world(make_scenario("agent", demos=None, **options))
    world.reset()
    for action in range(13):
        world.step(np.full((1, 3), action))
        assert np.isfinite(world.observation).all()


@pytest.mark.parametrize("shape", ["square", "disc", "ring=0.6"])
def test_nobody_leaves_a_field_with_walls(shape: str) -> None:
    made = world(50, arena=shape, rebound=True)
    rng = np.random.default_rng(0)
    touched = 0
    for _ in range(120):
        made.step(rng.choice([0, 6, 6, 6, 3], size=(50, 3)))
        out = np.abs(made.position).max(axis=2)
        if shape != "square":
            out = np.linalg.norm(made.position, axis=2)
        assert out.max() <= 1.0 and out.min() >= 0.6 * (shape == "ring=0.6")
        touched += int((out > 1.0 - 1e-9).sum())
        assert (made.outcome >= 0).all() and (made.components[..., 2] == 0.0).all()
        made.reset(made.terminated | made.truncated)
    assert touched > 100


TRIANGLE = "polygon=-1,-1;1,-1;0,1"


@pytest.mark.parametrize("shape", ["rectangle=0.5", "rectangle=2", TRIANGLE])
def test_nobody_leaves_a_polygon(shape: str) -> None:
    made = world(50, arena=shape, rebound=True)
    bend, rng, touched = 1e-3, np.random.default_rng(0), 0
    for _ in range(120):
        made.step(rng.choice([0, 6, 6, 6, 3], size=(50, 3)))
        x, y = np.moveaxis(made.position, 2, 0)
        over = {
            "rectangle=0.5": np.maximum(np.abs(x) - 1.0, np.abs(y) - 0.5),
            "rectangle=2": np.maximum(np.abs(y) - 1.0, np.abs(x) - 0.5),
            TRIANGLE: np.maximum((2.0 * np.abs(x) + y - 1.0) / np.sqrt(5.0), -1.0 - y),
        }[shape]
        assert over.max() < bend
        touched += int((over > -bend).sum())
        assert (made.outcome >= 0).all() and np.isfinite(made.observation).all()
        made.reset(made.terminated | made.truncated)
    assert touched > 100


@pytest.mark.parametrize("shape", ["square", "ring=0.4", "rectangle=0.5", TRIANGLE])
def test_states_of_any_arena_are_observed_as_in_simulation(shape: str) -> None:
    made = world(4, arena=shape, rebound=True)
    made.step(np.full((4, 3), 6))
    species: Any = made.scenario.species
    states = made.position, made.velocity, made.acceleration, made.step_count
    np.testing.assert_array_equal(observe(species, *states)[0], made.observation)


def test_the_long_wall_of_a_rectangle_is_perceived() -> None:
    made = world(1, [[0.5, 0.45], [0.5, 0.0], [0.5, -0.5]], arena="rectangle=0.5", rebound=True)
    seen = {
        one.name: value for one, value in zip(made.observation_components, made.observation[0, 0])
    }
    distance = seen["tanh of distance to the wall / (0.1 size)"]
    assert distance == pytest.approx(np.tanh(0.05 / 0.1), abs=2e-3)
    assert seen["direction of the wall cosine"] == pytest.approx(-1.0, abs=1e-3)  # focus: below


def test_without_walls_an_episode_ends_as_far_beyond_a_rectangle_as_beyond_its_square() -> None:
    made = world(1, [[0.0, -0.4], [-0.7, 0.0], [0.7, 0.0]], arena="rectangle=0.5")
    while not made.terminated[0]:
        assert made.position[0, 0, 1] > -0.6
        made.step(np.array([[3, COAST, COAST]]))
    assert made.outcome[0] == PURSUER_OUT and made.position[0, 0, 1] < -0.6


@pytest.mark.parametrize(
    ("shape", "sentence"),
    [
        ("rectangle=0", "rectangle=0.5"),
        ("rectangle=1,2", "rectangle=0.5"),
        ("ring=1", "ring=0.6"),
        ("polygon=0,1;1,0", "by its corners"),
        ("polygon=a,b;c,d;e,f", "by its corners"),
        ("polygon=-1,-1;1,-1;0,-0.5", "which lies inside"),
        ("polygon=-1,-1;1,-1;0,0.2;1,1;-1,1", "points inwards"),
        ("polygon=-1,-1;1,-1;0,1.1", "between -1 and 1"),
        ("polygon=nan,0;1,-1;0,1", "give them in turn"),
    ],
)
def test_what_is_no_polygon_is_refused(shape: str, sentence: str) -> None:
    with pytest.raises(InputError, match=sentence):
        world(1, arena=shape)


SHELTERS = [(0.3, 0.1, 0.2), (-0.9, 0.0, 0.3)]  # the second one sticks out of a disc


@pytest.mark.parametrize("shape", ["square", "disc", "open"])
def test_nobody_enters_an_obstacle(shape: str) -> None:
    made = world(
        50, arena=shape, obstacles=SHELTERS, **{"rebound": True} if shape != "open" else {}
    )
    rng, met = np.random.default_rng(0), 0
    for _ in range(120):
        made.step(rng.choice([0, 6, 6, 6, 3], size=(50, 3)))
        for x, y, radius in SHELTERS:
            clear = np.hypot(made.position[..., 0] - x, made.position[..., 1] - y) - radius
            assert clear.min() > (-0.005 if x < 0 else 0.0)  # between two walls only nearly
            met += int((clear < 1e-9).sum())
        assert (made.outcome >= 0).all() and np.isfinite(made.observation).all()
        made.reset(made.terminated | made.truncated)
    assert met > 20


def test_an_obstacle_takes_the_velocity_into_it_alone() -> None:
    made = world(1, [[0.55, 0.1], [-0.7, 0.0], [-0.5, 0.5]], arena="open", obstacles=SHELTERS[:1])
    made.velocity[0, 0] = -1.5, 0.3
    made.step(np.array([[COAST] * 3]))
    away = made.position[0, 0] - [0.3, 0.1]
    assert np.linalg.norm(away) == pytest.approx(0.2)
    assert made.velocity[0, 0] @ away == pytest.approx(0.0, abs=1e-9)
    assert made.velocity[0, 0, 1] > 0.2


def test_a_removed_obstacle_is_nowhere() -> None:
    places = [[0.55, 0.1], [-0.7, 0.0], [-0.5, 0.5]]
    plain = world(1, places, arena="square", rebound=True)
    arena = Arena("square", 1.0, rebound=True, obstacles=((0.3, 0.1, 0.2),))
    gone = world(1, places, arena=arena.without_obstacle(arena.obstacles[0]))
    for made in (plain, gone):
        made.step(np.array([[0, 0, 3]]))
    np.testing.assert_array_equal(plain.observation, gone.observation)
    np.testing.assert_array_equal(plain.position, gone.position)
    assert [one.name for one in gone.observation_components] == [
        one.name for one in plain.observation_components
    ]


def test_the_wall_of_an_obstacle_is_perceived_in_an_open_field() -> None:
    made = world(1, [[0.55, 0.1], [-0.7, 0.0], [0.55, 0.5]], arena="open", obstacles=SHELTERS[:1])
    seen = {
        one.name: value for one, value in zip(made.observation_components, made.observation[0, 0])
    }
    distance = seen["tanh of distance to the wall / (0.1 size)"]
    assert distance == pytest.approx(np.tanh(0.05 / 0.1), abs=1e-6)
    assert seen["direction of the wall cosine"] == pytest.approx(0.0, abs=1e-6)  # focus: upwards
    assert seen["direction of the wall sine"] == pytest.approx(1.0)


def test_starts_are_drawn_outside_obstacles() -> None:
    made = world(300, arena="square", rebound=True, obstacles=[(0.0, 0.0, 0.6)])
    assert np.linalg.norm(made.position, axis=2).min() >= 0.6
    with pytest.raises(InputError, match="lies within obstacles"):
        world(1, arena="disc", rebound=True, obstacles=[(0.0, 0.0, 0.9)])


@pytest.mark.parametrize(
    "obstacles, sentence",
    [
        (["0.3,0"], "give x, y and a positive radius"),
        ([(0, 0, -1)], "give x, y and a positive radius"),
        ([(0.1, 0, 5)], "fills the whole disc"),
    ],
)
def test_an_obstacle_is_three_numbers(obstacles: Any, sentence: str) -> None:
    with pytest.raises(InputError, match=sentence):
        world(1, arena="disc", rebound=True, obstacles=obstacles)


def test_without_walls_an_episode_ends_in_the_hole_of_a_ring() -> None:
    places = [[0.7, 0.0], [-0.7, 0.0], [0.0, 0.7]]
    made = world(1, places, arena="ring=0.6")
    while not made.terminated[0]:
        assert np.linalg.norm(made.position, axis=2).min() >= 0.6 / 1.1
        made.step(np.array([[0, 0, COAST]]))  # through the middle, where the target is not
    assert made.outcome[0] == PURSUER_OUT
    assert np.linalg.norm(made.position, axis=2).min() < 0.6 / 1.1


def test_the_nearest_wall_of_a_ring_may_be_its_hole() -> None:
    """Of individual 0 above the middle, the target to the lower left of it."""
    for shape, y, wall in (("ring=0.6", 0.65, -1.0), ("ring=0.6", 0.95, 1.0), ("disc", 0.1, 1.0)):
        made = world(1, [[0.0, y], [0.9, 0.0], [-0.9, 0.0]], arena=shape, rebound=True)
        seen = {
            one.name: value
            for one, value in zip(made.observation_components, made.observation[0, 0])
        }
        distance = 0.05 if shape == "ring=0.6" else 0.9
        assert seen["tanh of distance to the wall / (0.1 size)"] == pytest.approx(
            np.tanh(distance / 0.1)
        )
        towards = np.array([-0.9, -y]) / np.hypot(0.9, y)
        assert seen["direction of the wall cosine"] == pytest.approx(wall * towards[1])
        assert seen["direction of the wall sine"] == pytest.approx(wall * towards[0])


def test_who_is_replayed_keeps_to_the_recording_beyond_a_wall() -> None:
    demos = dogs(2)
    drivers = dict.fromkeys(demos.individuals, "replay")
    small = replace(demos, arena=Arena("disc", 0.9 * np.abs(demos.positions).max(), 9.0))
    made = ChaseWorld(make_scenario("custom", demos=small, split=None, drivers=drivers), len(demos))
    made.reset(demo=np.arange(len(demos)))
    for t in range(1, int(demos.lengths.min())):
        made.step(np.zeros((len(demos), 3), dtype=int))
        assert np.array_equal(made.position, demos.positions[demos.offsets[:-1] + t])
        assert not made.terminated.any()


PROGRAM = """
import numpy as np
from animarl_envs.scenario import make_scenario
from animarl_envs.worlds import make_world
options = {"agent": {}, "newt": {"senses_heading": True}, "silkmoth": {"plume": "off"}}
for name in options:
    world = make_world(make_scenario(name, **options[name]), 2)
    world.reset()
    for action in range(13):
        world.step(np.full((2, world.num_individuals), action))
        print(*np.float64(world.observation).ravel())
"""


@pytest.mark.slow
def test_kernels_run_as_they_are_written_where_numba_is_off() -> None:
    """So that ``make mutants`` sees them."""
    printed = []
    for off in ("1", "0"):
        told = {"NUMBA_DISABLE_JIT": off, "PYTHONWARNINGS": "ignore"}
        done = python(PROGRAM, env=os.environ | told)
        printed.append(np.array(done.stdout.split(), dtype=float))
    assert len(printed[0]) > 1000
    np.testing.assert_allclose(printed[0], printed[1], atol=1e-5)


DT, CONTACT = 0.1, 0.1
OWN = Locomotion(0.2, 3.0, (1.0, 0.4))
SQUARE, DISC, OPEN = (SHAPE_CODES[name] for name in ("square", "disc", "open"))


def unit(angle: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.stack([np.cos(angle), np.sin(angle)], axis=-1)


def moves(
    own: Locomotion, who: int, given: tuple[NDArray[np.float64], ...], shape: int, size: float,
    lone: bool = False, hole: float = 0.0,
) -> NDArray[np.uint64]:  # fmt: skip
    """Actions for positions, velocities, focus directions and accelerations ``(B, K, 2)``."""
    still = (*given, np.zeros_like(given[0]))[:4]
    position, velocity, towards, push = (np.ascontiguousarray(a.transpose(1, 2, 0)) for a in still)
    individuals, _, copies = position.shape
    actions = np.full((individuals, copies), 77, dtype=np.uint64)
    holes = np.array([[0.0, 0.0, hole]] if hole else np.zeros((0, 3)))
    pushes = np.stack([np.ascontiguousarray(own.action_vectors.T)] * individuals)
    decide(
        who, position, velocity, push, towards, np.full(individuals, own.damping),
        np.full(individuals, own.thrust), pushes, DT, (shape, size, size, holes), CONTACT, lone,
        actions,
    )  # fmt: skip
    others = np.delete(actions, who, axis=0)
    assert (others == 77).all()  # a rule speaks for its own individual alone
    return actions[who]


def scene(
    individuals: int, copies: int, size: float, seed: int
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    rng = np.random.default_rng(seed)
    return (
        rng.uniform(-size, size, (copies, individuals, 2)),
        rng.normal(0, 0.5, (copies, individuals, 2)),
        unit(rng.uniform(0, 2 * np.pi, (copies, individuals))),
    )


@pytest.mark.parametrize("individuals", [2, 3])
@pytest.mark.parametrize("shape, hole", [(SQUARE, 0.0), (DISC, 0.0), (DISC, 0.6), (OPEN, 0.0)])
def test_the_target_takes_the_action_of_the_lowest_cost(
    individuals: int, shape: int, hole: float
) -> None:
    size, copies, target = 1.5, 80, individuals - 1
    position, velocity, towards = scene(individuals, copies, size, seed=3)
    if shape == SQUARE:
        position[:40, target, 0] *= 0.1  # some near one wall alone
        position[:40, target, 1] = 1.3
    chosen = moves(OWN, target, (position, velocity, towards), shape, size, hole=hole)
    margin, steps = 0.25 * size, math.ceil(math.sqrt(size / OWN.thrust) / DT)
    focus = position[:, target, None] - position[:, :target]
    focus /= np.linalg.norm(focus, axis=-1, keepdims=True)
    ahead = np.zeros(copies, dtype=int)
    costs = np.zeros((OWN.num_actions, copies))
    for k in range(OWN.num_actions):
        place, speed = position[:, target], velocity[:, target]
        chaser, pace = position[:, :target], velocity[:, :target]
        for t in range(1, steps + 1):
            speed = apply_actions(speed, np.full(copies, k), towards[:, target], OWN, DT)
            place = place + speed * DT
            pace = np.stack(
                [apply_actions(pace[:, j], ahead, focus[:, j], OWN, DT) for j in range(target)], 1
            )
            chaser = chaser + pace * DT
            if t not in [(look + 1) * steps // LOOKS for look in range(LOOKS)]:
                continue
            square = shape == SQUARE
            reach = np.abs(place) if square else np.linalg.norm(place, axis=1, keepdims=True)
            depth = np.maximum(reach - (size - margin), (hole + margin - reach) * (hole > 0.0))
            depth = np.maximum(depth, 0.0) / margin * (shape != OPEN)
            gap = np.linalg.norm(chaser - place[:, None], axis=-1) / size
            costs[k] += WALL_WEIGHT * (depth**2).sum(axis=1) * (t == steps)
            costs[k] += (1.0 / (gap**2 + SOFTENING)).sum(axis=1)
    lowest, taken = costs.min(axis=0), costs[chosen.astype(int), np.arange(copies)]
    np.testing.assert_allclose(taken, lowest, rtol=1e-4)  # the rule is float32
    assert (chosen == costs.argmin(axis=0)).mean() > 0.95
    assert len(set(chosen.tolist())) > 5


@pytest.mark.parametrize("shape", [SQUARE, DISC, OPEN])
def test_pursuers_accelerate_to_where_they_meet_the_target(shape: int) -> None:
    """Towards the first place that a held push reaches in time, if the target holds its own."""
    size, copies = 1.5, 200
    position, velocity, towards = scene(3, copies, size, seed=2)
    push = np.random.default_rng(5).normal(0, 0.7, position.shape)  # beyond 1 is a wall's
    chosen = moves(OWN, 1, (position, velocity, towards, push), shape, size)
    steps = math.ceil(HORIZON * math.sqrt(size / OWN.thrust) / DT)
    looks = [max(1, (look + 1) * steps // LEADS) for look in range(LEADS)]
    target, pace, own, speed = position[:, 2], velocity[:, 2], position[:, 1], velocity[:, 1]
    reached, swift, aim = np.zeros(copies), np.zeros(copies), np.full((copies, 2), np.nan)
    for t in range(1, steps + 1):
        pace = 0.8 * pace + OWN.thrust * DT * np.clip(push[:, 2], -1, 1)
        speed, swift = 0.8 * speed, 0.8 * swift + OWN.thrust * DT
        target, own, reached = target + pace * DT, own + speed * DT, reached + swift * DT
        held = target
        if shape == SQUARE:
            held = np.clip(target, -size, size)
        elif shape == DISC:
            held = target / np.maximum(1, np.linalg.norm(target, axis=1, keepdims=True) / size)
        within = np.linalg.norm(held - own, axis=1) <= reached + CONTACT
        due = np.isnan(aim[:, 0]) & (within | (t == looks[-1])) & (t in looks)
        aim[due] = (held - own)[due]
    still, actions = np.zeros((copies, 2)), [np.full(copies, k) for k in range(OWN.num_actions)]
    pushed = np.stack([apply_actions(still, each, towards[:, 1], OWN, DT) for each in actions])
    best = np.einsum("kbx,bx->kb", pushed, aim).argmax(axis=0)
    assert (chosen == best).mean() > 0.98
    assert len(set(chosen.tolist())) > 8


def test_of_equal_actions_the_first_is_taken() -> None:
    still = Locomotion(0.2, 1e-300)  # so weak that no action moves anybody
    assert (moves(still, 2, scene(3, 20, 1.0, seed=1), SQUARE, 1.0) == 0).all()


def test_each_target_of_a_lone_pursuer_runs_from_it_alone() -> None:
    """As if there were the two of them; the pursuer meets the nearest one."""
    position, velocity, towards = scene(4, 60, 1.5, seed=4)
    for who in range(3):
        pair = tuple(each[:, [3, who]] for each in (position, velocity, towards))
        chosen = moves(OWN, who, (position, velocity, towards), DISC, 1.5, lone=True)
        np.testing.assert_array_equal(chosen, moves(OWN, 1, pair, DISC, 1.5))
    nearest = np.linalg.norm(position[:, :3] - position[:, 3:], axis=2).argmin(axis=1)
    chosen = moves(OWN, 3, (position, velocity, towards), DISC, 1.5, lone=True)
    for who in range(3):
        pair = tuple(each[:, [who, 3]] for each in (position, velocity, towards))
        alone = moves(OWN, 1, pair, DISC, 1.5, lone=True)
        np.testing.assert_array_equal(chosen[nearest == who], alone[nearest == who])


def test_the_corners_of_a_polygon_are_those_that_were_given() -> None:
    square = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    for shape, corners in (
        ("square", square),
        ("rectangle=0.5", square * [1.0, 0.5]),
        ("rectangle=2", square * [0.5, 1.0]),
        (TRIANGLE, np.array([[-1, -1], [1, -1], [0, 1]])),
    ):
        drawn = world(1, arena=shape, rebound=True).scenario.species.arena.corners
        for corner in corners:
            assert np.linalg.norm(drawn - corner, axis=1).min() < 2e-3, shape
        assert all(np.linalg.norm(corners - one, axis=1).min() < 2e-3 for one in drawn)
