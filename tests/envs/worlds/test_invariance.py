"""What must not change: turned, mirrored, relabelled and later worlds do the same.

Property-based: starts, velocities, actions, numbers of pursuers and arenas are drawn.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from recordings import begun

from animarl_envs.demos.episode import TIME_OUT
from animarl_envs.locomotion import ACTION_VECTORS, COAST
from animarl_envs.scenario import make_scenario
from animarl_envs.species import SILKMOTH, SPECIES
from animarl_envs.species.silkmoth import RECORDED_TURNING
from animarl_envs.species.turning import Turning
from animarl_envs.worlds import make_world
from animarl_envs.worlds.base import World
from animarl_envs.worlds.plume.plume import Plume
from animarl_envs.worlds.search.layout import observation_components
from animarl_envs.worlds.search.world import SearchWorld

Array = NDArray[Any]
STEPS = 25
ACTIONS = len(ACTION_VECTORS)
MIRRORED = np.array([*((12 - k) % 12 for k in range(12)), COAST])

seeds = st.integers(0, 2**32 - 1)
pursuers = st.integers(1, 4)
often = settings(max_examples=25, deadline=None)


@dataclass(frozen=True)
class Chase:
    """Where a chase starts, and what everybody does: the same numbers in every world."""

    position: Array  # (K, 2)
    velocity: Array  # (K, 2)
    actions: Array  # (STEPS, K)

    @classmethod
    def drawn(cls, seed: int, count: int) -> Chase:
        rng = np.random.default_rng(seed)
        individuals = count + 1
        actions = rng.integers(ACTIONS, size=(STEPS, individuals))
        return cls(
            rng.uniform(-0.5, 0.5, (individuals, 2)), rng.uniform(-1, 1, (individuals, 2)), actions
        )

    def changed(self, turn: Array, actions: Array | None = None) -> Chase:
        moved = self.actions if actions is None else actions
        return Chase(self.position @ turn.T, self.velocity @ turn.T, moved)

    def relabelled(self, order: list[int]) -> Chase:
        return Chase(self.position[order], self.velocity[order], self.actions[:, order])


@dataclass(frozen=True)
class Course:
    """What came of it, to the end of the episode; the first axis is time."""

    position: Array
    velocity: Array
    observation: Array
    reward: Array
    ends: list[tuple[bool, bool, int]]
    world: World


def follow(name: str, chase: Chase, *, at: int = 0, **options: Any) -> Course:
    """One copy, its clock at step ``at`` when it starts."""
    count = len(chase.position) - 1
    if not options.get("lone_pursuer"):
        options["num_pursuers"] = count
    else:
        options["individuals"] = (*(f"sheep_{i}" for i in range(count)), "dog")
    scenario = make_scenario(name, demos=None, start=chase.position, condition=0, **options)
    world = make_world(scenario, 1)
    world.reset()
    state = world.get_state()
    state["velocity"][0], state["step_count"][0] = chase.velocity, at
    world.set_state(state)
    rows = []
    for actions in chase.actions:
        world.step(actions[None])
        rows.append(
            (world.position[0].copy(), world.velocity[0].copy(), world.observation[0].copy(),
             world.reward[0].copy(),
             (bool(world.terminated[0]), bool(world.truncated[0]), int(world.outcome[0])))
        )  # fmt: skip
        if rows[-1][-1][0] or rows[-1][-1][1]:
            break
    position, velocity, observation, reward, ends = zip(*rows, strict=True)
    return Course(*map(np.stack, (position, velocity, observation, reward)), list(ends), world)


def assert_seen_alike(one: Course, two: Course, sign: Array, kept: Array) -> None:
    """Observations agree in ``kept`` components, up to ``sign``; bearings as angles."""
    difference = np.abs(two.observation - one.observation * sign)
    angular = np.array([c.unit == "rad" for c in one.world.observation_components])
    turns = difference[..., angular] % (2 * math.pi)
    difference[..., angular] = np.minimum(turns, 2 * math.pi - turns)
    assert difference[..., kept & ~angular].max() < 1e-4
    assert difference[..., kept & angular].max(initial=0.0) < 1e-2  # of somebody very near


def frames(course: Course) -> list[str]:
    return [c.frame for c in course.world.observation_components]


@often
@given(seeds, pursuers, st.floats(-3.0, 3.0), st.sampled_from(["disc", "open"]),
       st.booleans(), st.sampled_from(["agent", "fly", "newt"]),
       st.sampled_from(["compact", "full", "paper"]), st.booleans())  # fmt: skip
def test_invariance_rotation_turns_the_paths(
    seed: int, count: int, angle: float, shape: str, rebound: bool, name: str, kind: str,
    lone: bool,
) -> None:  # fmt: skip
    """Turned starts give turned paths, the same rewards and ends, and the same egocentric view."""
    chase = Chase.drawn(seed, count)
    turn = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])
    options: dict[str, Any] = {"arena": shape} | ({"rebound": rebound} if shape == "disc" else {})
    options |= {"observation": kind, "lone_pursuer": lone}
    one, two = follow(name, chase, **options), follow(name, chase.changed(turn), **options)
    assert two.position == pytest.approx(one.position @ turn.T, abs=1e-6)
    assert two.velocity == pytest.approx(one.velocity @ turn.T, abs=1e-5)
    assert two.reward == pytest.approx(one.reward)
    assert two.ends == one.ends
    ones = np.ones(one.observation.shape[-1])
    no_north = kind == "full" and not one.world.scenario.species.senses_compass
    assert_seen_alike(one, two, ones, np.array([no_north or f != "arena" for f in frames(one)]))


@often
@given(seeds, st.integers(2, 4), st.randoms(use_true_random=False),
       st.sampled_from(["agent", "fly", "newt"]), st.booleans())  # fmt: skip
def test_invariance_relabelling_the_pursuers_permutes_theirs(
    seed: int, count: int, random: Any, name: str, lone: bool
) -> None:
    chase = Chase.drawn(seed, count)
    order = [*random.sample(range(count), count), count]
    same = {"locomotion": SPECIES[name].locomotion[0], "lone_pursuer": lone}
    one, two = follow(name, chase, **same), follow(name, chase.relabelled(order), **same)
    assert two.position == pytest.approx(one.position[:, order], abs=1e-12)
    assert two.reward == pytest.approx(one.reward[:, order], abs=1e-12)
    assert np.array_equal(two.observation, one.observation[:, order])
    for (over, cut, outcome), (same_over, same_cut, told) in zip(one.ends, two.ends, strict=True):
        assert (over, cut) == (same_over, same_cut)
        assert told == (order.index(outcome - 1) + 1 if outcome > 0 else outcome)


@often
@given(seeds, pursuers, st.integers(0, 140), st.sampled_from(["agent", "fly", "newt"]))
def test_invariance_a_later_start_is_the_same_until_the_limit(
    seed: int, count: int, later: int, name: str
) -> None:
    chase = Chase.drawn(seed, count)
    one = follow(name, chase, time_limit=148)
    two = follow(name, chase, time_limit=148, at=later)
    common = len(two.ends)
    assert common == min(len(one.ends), 148 - later)
    for field in ("position", "velocity", "observation", "reward"):
        assert np.array_equal(getattr(two, field), getattr(one, field)[:common])
    reached = later + common == 148 and not one.ends[common - 1][0]
    assert two.ends[-1] == ((False, True, TIME_OUT) if reached else one.ends[common - 1])


@cache
def plumes() -> tuple[Plume, ...]:
    """A repeating movie of 12 steps, and the same beginning five steps later."""
    frames = np.random.default_rng(0).random((12, 41, 330)) < 0.1
    movies = (frames, np.roll(frames, -5, axis=0), frames[:, ::-1])
    return tuple(
        Plume.from_array(movie, mm_per_pixel=1.0, source_pixel=(20, 0), frame_rate=2.0)
        for movie in movies
    )


def search(plume: Any, actions: Array, phase: int, *, at: int = 0, **options: Any) -> list[Any]:
    """What one moth does and senses, the plume's clock at ``phase`` when it starts."""
    world = make_world(make_scenario("silkmoth", demos=None, plume=plume, **options), 1)
    assert isinstance(world, SearchWorld)
    world.reset()
    state = world.get_state()
    state["phase"][:], state["step_count"][:] = phase - at, at
    world.set_state(state)
    rows = []
    for action in actions:
        world.step(np.array([[action]]))
        rows.append((world.position[0, 0].copy(), world.observation[0, 0].copy(),
                     float(world.reward[0, 0]), bool(world.terminated[0]),
                     bool(world.truncated[0])))  # fmt: skip
        if rows[-1][3] or rows[-1][4]:
            break
    return rows


def runs_of_actions(seed: int, steps: int = 60) -> Array:
    """Mostly upwind, each action kept for four steps so that speed builds up."""
    rng = np.random.default_rng(seed)
    chosen = rng.choice([0, 0, 1, 11, 3, 9, COAST], size=steps // 4)
    return np.repeat(chosen, 4)


def assert_same_search(one: list[Any], two: list[Any], odour: list[int] | None = None) -> None:
    for (p, seen, reward, over, cut), (q, other, paid, ended, late) in zip(one, two, strict=True):
        assert np.array_equal(p, q)
        assert np.array_equal(seen, other)
        assert (reward, over, cut) == (paid, ended, late)


@often
@given(seeds, st.integers(0, 100))
def test_invariance_a_moth_starting_later_meets_the_same_plume(seed: int, later: int) -> None:
    """The state moved in time with the plume's phase, as the world counts it or in the movie."""
    actions, (movie, moved, _) = runs_of_actions(seed), plumes()
    one = search(movie, actions, 5)
    assert any((row[1][3:5] == 1.0).any() for row in one)
    assert_same_search(one, search(movie, actions, 5 + 12 * 3))  # a whole number of its periods
    assert_same_search(one, search(moved, actions, 0))
    shifted = search(movie, actions, 5, at=later, time_limit=40 + later)
    assert_same_search(one[: len(shifted) - 1], shifted[:-1])
    assert len(shifted) == min(40, len(one))
    assert shifted[-1][3] != shifted[-1][4]  # at the source or at the limit, never both


@often
@given(seeds, st.integers(0, 11), st.sampled_from([None, RECORDED_TURNING]))
def test_invariance_a_mirrored_moth_walks_the_mirrored_path(
    seed: int, phase: int, turning: Turning | None
) -> None:
    """Antennae and wind sides change places, and a body that slips to one side slips to the
    other."""
    actions, (movie, _, flipped) = runs_of_actions(seed), plumes()
    other_way = None if turning is None else replace(turning, slip=-turning.slip)
    one = search(movie, actions, phase, turning=turning)
    two = search(flipped, MIRRORED[actions], phase, turning=other_way)
    components = observation_components(SILKMOTH)
    names = [c.name for c in components]
    swap = [names.index(c.mirror or c.name) for c in components]
    sign = np.array([c.sign for c in components])
    for (p, seen, *end), (q, other, *ends) in zip(one, two, strict=True):
        assert q == pytest.approx(p * [1.0, -1.0], abs=1e-12)
        around = np.isclose(np.abs(seen[2]), math.pi, atol=1e-5)  # straight downwind has no side
        assert other == pytest.approx(seen[swap] * sign, abs=1e-5) or around
        assert end == ends


@often
@given(seeds, st.sampled_from(list(SPECIES)), st.integers(1, 60), st.sampled_from([0, 1]))
def test_invariance_the_limit_truncates_and_components_sum(
    seed: int, name: str, limit: int, condition: int
) -> None:
    condition = condition if SPECIES[name].conditions else 0
    options: dict[str, Any] = {"warmup": 0, "time_limit": limit, "condition": condition}
    copies = 32
    world = begun(make_scenario(name, demos=None, **options), copies, seed % 1000)
    rng = np.random.default_rng(seed)
    running = np.ones(copies, dtype=bool)
    for t in range(1, limit + 1):
        world.step(rng.integers(ACTIONS, size=(copies, world.num_individuals)))
        assert not (world.terminated & world.truncated).any()
        assert np.array_equal(world.components.sum(axis=2), world.reward)
        assert np.array_equal(world.truncated[running], (t == limit) & ~world.terminated[running])
        assert (world.outcome[world.truncated] == TIME_OUT).all()
        assert ((world.outcome != TIME_OUT) == world.terminated).all()
        running &= ~world.terminated
    assert (world.terminated | world.truncated)[running].all()
