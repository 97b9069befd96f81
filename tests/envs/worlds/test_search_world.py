"""The odour-search world: a plain NumPy reference, senses, ends, refusals, traits of animals."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from refusals import refuses
from search_worlds import ODOUR, STRAIGHT_UPWIND, random_actions, rollout, search_world

from animarl_envs.demos.packaged import load_packaged
from animarl_envs.fitting.custom_species import species_of
from animarl_envs.locomotion import COAST, apply_actions
from animarl_envs.scenario import Scenario
from animarl_envs.species import SILKMOTH, SearchSpecies
from animarl_envs.species.silkmoth import RECORDED_TURNING
from animarl_envs.species.traits import LARGEST, Floats, Traits, episode_traits, fit_traits
from animarl_envs.species.turning import Turning
from animarl_envs.worlds import demonstration_observations
from animarl_envs.worlds.plume.plume import hit_table
from animarl_envs.worlds.search.layout import ALIKE, PAPER, PAST, REMEMBERING, SearchEntry
from animarl_envs.worlds.search.world import SearchWorld, antennae_at


def reference(
    species: SearchSpecies, world: SearchWorld, actions: NDArray[np.integer], condition: int
) -> NDArray[np.float64]:
    """Observations of copy 0 by NumPy and the documented formulas, one step at a time."""
    plume, pattern, phase = world.plume, world.patterns[world.pattern[0]], int(world.phase[0])
    table = hit_table(plume, (pattern,), species.dt, species.antenna_radius)
    position, velocity = world.position[0, 0].copy(), world.velocity[0, 0].copy()
    heading, odour = np.array([-1.0, 0.0]), np.full(2, species.odour_baseline)
    loco, upwind = species.locomotion[0], np.array([-1.0, 0.0])
    trace, turned = np.zeros(2), 0.0
    push = np.zeros(2)  # ahead and to the left, in multiples of the thrust
    angle = 0.0
    rows = []
    for step in range(len(actions) + 1):
        old = angle
        if step > 0:
            action = np.asarray(actions[step - 1, 0])
            push = loco.action_vectors[action]
            velocity = apply_actions(velocity, action, upwind, loco, species.dt)
            position = position + velocity * species.dt
        if species.turning is not None and step > 0:
            direction = math.atan2(heading[1], heading[0])
            direction += float(species.turning.next_turn(turned, direction, velocity))
            heading = np.array([math.cos(direction), math.sin(direction)])
        elif species.turning is None and np.linalg.norm(velocity) > species.rest_speed:
            heading = velocity / np.linalg.norm(velocity)
        angle = math.atan2(-heading[1], -heading[0])  # from upwind, to the left
        field = table.unpack(0, (phase + step) % table.bits.shape[1])
        since_hit = []
        for antenna in antennae_at(species, position, heading):
            column, row = np.rint(antenna / table.cell).astype(int)
            column, row = column + table.source_column, row + table.source_row
            inside = 0 <= row < table.rows and 0 <= column < table.columns
            since_hit.append(bool(inside and field[row, column]))
        decayed = species.odour_baseline + (odour - species.odour_baseline) * math.exp(
            -species.dt / species.odour_decay
        )
        odour = np.where(since_hit, 1.0, decayed)
        trace = np.where(since_hit, 1.0, trace * math.exp(-species.dt / species.trace_decay))
        turned = math.remainder(angle - old, 2 * math.pi)
        about_face = abs(turned) > math.pi - 1e-6  # has no side
        turned = 0.0 if about_face else turned
        yaw_rate = turned / species.dt
        flow = 0.0 if abs(yaw_rate) < species.flow_threshold else -yaw_rate
        flow = float(np.clip(flow, -species.flow_limit, species.flow_limit))
        air_from = math.degrees(-angle)  # upwind, seen from the body, to the left
        sector = np.array(
            [abs(air_from) <= 45, -135 < air_from < -45, 45 < air_from < 135, abs(air_from) >= 135]
        )
        open_senses = float(condition == 0)
        strides = -velocity / (loco.thrust * species.dt)
        rows.append(
            [
                *(-velocity), angle, *odour, open_senses * flow, *(open_senses * sector),
                *since_hit, odour[0] - odour[1], odour.sum(), *trace, math.cos(angle),
                math.sin(angle), *np.tanh(strides), *np.tanh(strides / 3),
                math.log(np.linalg.norm(strides) + 0.3), *push, yaw_rate,
            ]
        )  # fmt: skip
    return np.array(rows)


@pytest.mark.parametrize("turning", [None, RECORDED_TURNING])
@pytest.mark.parametrize("condition", [0, 1])
@pytest.mark.parametrize("seed", range(4))
def test_kernel_agrees_with_the_reference(
    turning: Turning | None, condition: int, seed: int
) -> None:
    changed: dict[str, Any] = {"turning": turning, "rest_speed": 0.005}  # often reached
    world = search_world(condition=condition, **changed)
    world.seed([seed])
    world.reset()
    actions = random_actions(120, 1, seed)
    actions[::3] = STRAIGHT_UPWIND if seed % 2 else COAST
    wanted = reference(replace(SILKMOTH, **changed), world, actions, condition)
    seen = rollout(world, actions)[:, 0]
    np.testing.assert_allclose(seen, wanted, atol=1e-5)


@pytest.mark.parametrize(("observation", "size"), [("paper", PAPER), ("compact", 12)])
def test_smaller_observations_are_the_beginning_of_the_full_one(
    observation: str, size: int
) -> None:
    actions = random_actions(80, 3)
    full, small = (rollout(search_world(3, observation=o), actions) for o in ("full", observation))
    assert small.shape[-1] == size and full.shape[-1] == ALIKE
    np.testing.assert_array_equal(full[..., :size], small)


def test_the_past_is_averaged_from_the_start_of_the_episode_on() -> None:
    world = search_world(4, senses_past=True, plume="continuous", turning=RECORDED_TURNING)
    names = [one.name for one in world.observation_components]
    assert len(names) == REMEMBERING
    stride = world.scenario.species.locomotion[0].thrust * world.scenario.species.dt
    for _ in range(2):  # nothing of the first episode is left in the second
        world.reset()
        seen = rollout(world, random_actions(60, 4)).astype(np.float64)
        velocity = seen[..., :2] / stride
        now = {
            "turning": seen[..., SearchEntry.YAW_RATE], "way left": velocity[..., 1],
            "way ahead": velocity[..., 0], "own speed": np.linalg.norm(velocity, axis=-1),
        }  # fmt: skip
        for row, seconds in enumerate(PAST, start=ALIKE):
            values, mean = now[names[row].partition(",")[0]], np.zeros(4)
            for t, value in enumerate(values):
                mean += (value - mean) * (1 - math.exp(-world.scenario.species.dt / seconds))
                np.testing.assert_allclose(seen[t, :, row], mean, atol=1e-4)
        hit, since = (
            (seen[..., SearchEntry.HIT_LEFT : SearchEntry.HIT_RIGHT + 1] > 0).any(-1),
            np.full(4, 10.0),
        )
        for t, hits in enumerate(hit):
            since = np.where(hits, 0.0, np.minimum(10.0, since + world.scenario.species.dt))
            np.testing.assert_allclose(
                seen[t, :, SearchEntry.SINCE_HIT], np.log1p(2 * since), atol=1e-4
            )
        assert 0 < hit.mean() < 1


def test_scene_details_say_where_the_antennae_are() -> None:
    world = search_world(2)
    rollout(world, np.zeros((3, 2), dtype=int))
    details = world.scene_details(1)
    middle = details["antennae"].mean(axis=0) - world.position[1, 0]
    expected = [-0.013 * math.cos(math.radians(19)), 0.0]
    np.testing.assert_allclose(middle, expected, atol=1e-12)


def test_a_scripted_moth_is_refused() -> None:
    scenario = Scenario(species=SILKMOTH, start="uniform", drivers=("scripted",))
    refuses("no scripted rule", SearchWorld, scenario, 1)


FRONT, RIGHT, LEFT, BACK = range(6, 10)


def test_plume_off_leaves_odour_at_baseline_for_ever() -> None:
    world = search_world(8, plume="off")
    seen = rollout(world, random_actions(300, 8))
    assert (seen[..., ODOUR] == np.float32(SILKMOTH.odour_baseline)).all()


def test_straight_upwind_of_a_continuous_plume_both_antennae_fire() -> None:
    world = search_world(plume="continuous")
    seen = rollout(world, np.zeros((10, 1), dtype=int))
    assert (seen[:, 0, ODOUR] == 1.0).all()


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_the_antenna_on_the_plume_s_side_fires_first(side: float) -> None:
    """Walking upwind just beside the plume; side 1: the plume is on the moth's left, at -y."""
    entry = 0.02 + 0.0025 + 0.013 * math.sin(math.radians(19))  # half width, radius, antenna
    world = search_world(plume="continuous", start=[[0.3, side * (entry + 0.004)]])
    towards = 11 if side > 0 else 1  # 30 deg to the left or to the right of upwind
    seen = rollout(world, np.full((12, 1), towards))[:, 0, ODOUR]
    first = [int(np.flatnonzero(seen[:, antenna] == 1.0)[0]) for antenna in range(2)]
    near, far = (0, 1) if side > 0 else (1, 0)
    assert first[near] < first[far]


DT = 0.5
TABLE = np.array([[[-1.0, 0.5]], [[1.0, -0.5]], [[2.0, 0.0]]])
THREE = Traits(np.zeros((2, 1, 2)), np.ones((1, 2)), TABLE)


def walks(speeds: Floats, steps: int = 80) -> tuple[Floats, np.ndarray]:
    """One walk of each mean speed [arena unit / s]; speeds and courses vary from step to step."""
    draw = np.random.default_rng(1)
    paths = []
    for mean in speeds:
        speed = mean * draw.uniform(0.5, 1.5, steps)
        course = np.cumsum(draw.normal(0.0, 0.3, steps))
        step = DT * speed[:, None] * np.stack([np.cos(course), np.sin(course)], axis=1)
        paths.append(np.concatenate([np.zeros((1, 2)), np.cumsum(step, axis=0)]))
    return np.concatenate(paths)[:, None], np.full(len(speeds), steps + 1)


def test_traits_of_a_circle_are_its_speed_and_its_turning() -> None:
    angle = 0.2 * np.arange(51)
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=1)[:, None]
    both = np.concatenate([circle, 2.0 * circle])
    (slow, wide), chord = episode_traits(both, np.array([51, 51]), DT)[:, 0], 2 * np.sin(0.1)
    np.testing.assert_allclose(slow, [chord / DT, 0.2 / DT])
    np.testing.assert_allclose(wide, [2 * chord / DT, 0.2 / DT])


def test_animals_that_differ_are_found_and_equal_ones_are_not() -> None:
    pytest.importorskip("scipy")
    differing = np.random.default_rng(0).uniform(0.5, 1.5, 20)
    none, each = np.zeros(20, dtype=int), np.arange(20)
    found = fit_traits(*walks(differing), DT, none, each)
    assert found is not None
    assert np.corrcoef(found.table[:, 0, 0], differing)[0, 1] > 0.98
    assert found.table[:, 0, 0].std() == pytest.approx(1.0, abs=1e-6)
    assert not found.table[:, 0, 1].any()  # all turn alike
    assert found == fit_traits(*walks(differing), DT, none, each)
    assert found != fit_traits(*walks(differing[::-1]), DT, none, each) and found != "traits"
    assert fit_traits(*walks(np.ones(20)), DT, none, each) is None
    assert fit_traits(*walks(differing[:5]), DT, none[:5], each[:5]) is None  # so few cannot say


def test_all_episodes_of_an_animal_say_what_it_is_like() -> None:
    pytest.importorskip("scipy")
    speeds, none = np.random.default_rng(0).uniform(0.5, 1.5, 24), np.zeros(24, dtype=int)
    animal = np.arange(24) // 4
    positions, lengths = walks(speeds)
    assert fit_traits(positions, lengths, DT, none, animal) is None  # episodes differ, not animals
    positions, lengths = walks(np.sort(speeds))
    found = fit_traits(positions, lengths, DT, none, animal)
    assert found is not None and found.table.shape == (6, 1, 2)
    mean = np.sort(speeds).reshape(6, 4).mean(axis=1)
    assert np.corrcoef(found.table[:, 0, 0], mean)[0, 1] > 0.99
    cut = lengths.copy()
    cut[::4] = 5  # too short for quarters: left out, the others are enough
    kept = np.concatenate([walk[:n] for walk, n in zip(np.split(positions, 24), cut, strict=True)])
    again = fit_traits(kept, cut, DT, none, animal)
    assert again is not None and again.table.shape == (6, 1, 2)


def test_what_a_condition_does_is_no_trait() -> None:
    pytest.importorskip("scipy")
    condition = np.arange(20) % 2
    assert fit_traits(*walks(1.0 + condition), DT, condition, np.arange(20)) is None
    own = np.random.default_rng(0).uniform(0.5, 1.5, 20)
    found = fit_traits(*walks(own + condition), DT, condition, np.arange(20))
    assert found is not None
    for one in (0, 1):
        assert found.table[condition == one, 0, 0].mean() == pytest.approx(0.0, abs=1e-9)


def test_a_simulated_searcher_keeps_the_traits_of_a_training_animal() -> None:
    world = search_world(300, traits=THREE)
    drawn = world.traits.copy()
    seen = rollout(world, random_actions(20, 300))
    assert [c.name for c in world.observation_components[-2:]] == ["own speed", "own turning"]
    np.testing.assert_array_equal(seen[..., -2:], np.broadcast_to(drawn, (21, 300, 2)))
    place = (drawn[:, None] == TABLE[:, 0]).all(axis=2)
    assert (place.sum(axis=1) == 1).all()
    assert (np.abs(place.mean(axis=0) - 1 / 3) < 0.1).all()  # each as often
    again, state = search_world(300, traits=THREE), world.get_state()
    np.testing.assert_array_equal(again.traits, drawn)
    again.reset()
    assert (again.traits != drawn).any()
    again.set_state(state)
    np.testing.assert_array_equal(again.traits, drawn)


def test_recordings_are_told_their_own_traits_and_starts_from_them_others() -> None:
    demos = load_packaged("silkmoth").select(split="train")
    demos = replace(demos, recording=np.array([str(i) for i in range(len(demos))]))
    values = episode_traits(demos.positions, demos.lengths, demos.dt)
    traits = Traits(np.stack([values.mean(0)] * 2), values.std(0), TABLE)
    species = replace(SILKMOTH, traits=traits)
    seen = demonstration_observations(species, demos)[:, 0, -2:]
    own = np.clip((values - values.mean(0)) / values.std(0), -LARGEST, LARGEST)[:, 0]
    np.testing.assert_allclose(seen, np.repeat(own, demos.lengths, axis=0), rtol=1e-5)
    plain = demonstration_observations(SILKMOTH, demos)
    assert plain.shape[-1] == demonstration_observations(species, demos).shape[-1] - 2
    world = search_world(50, traits=traits, demos=demos)
    assert (world.traits[:, None] == TABLE[:, 0]).all(axis=2).any(axis=1).all()


def test_closed_loop_spread_comes_from_traits() -> None:
    """Who pushes as its trait says differs from the others for the whole episode."""
    speeds = []
    for traits in (THREE, Traits(THREE.centre, THREE.scale, np.zeros((3, 1, 2)))):
        world, draw = search_world(200, traits=traits), np.random.default_rng(0)
        paths = [world.position[:, 0].copy()]
        for _ in range(60):
            eager = draw.random(200) < 0.5 + 0.2 * world.observation[:, 0, -2]
            world.step(np.where(eager, draw.integers(12, size=200), 12)[:, None])
            paths.append(world.position[:, 0].copy())
        moved = np.linalg.norm(np.diff(paths, axis=0), axis=-1)
        speeds.append(moved.mean(axis=0).std())
    assert speeds[0] > 2 * speeds[1]


def test_own_recordings_get_traits_and_synthetic_ones_do_not() -> None:
    pytest.importorskip("scipy")
    demos = load_packaged("silkmoth")  # its five plumes make programmed moths differ
    assert species_of(demos).traits is None
    heading = np.zeros(len(demos.positions))
    own = {**demos.provenance, "synthetic": False}
    recorded = replace(
        demos,
        signals={**demos.signals, "heading": heading},
        provenance=own,
        recording=np.arange(len(demos)).astype(str),  # each of a moth of its own
    )
    found = species_of(recorded).traits
    assert found is not None and len(found.table) == (demos.split == "train").sum()
    assert species_of(recorded).observation == "full"
    refuses("traits is 3: give Traits or None", replace, SILKMOTH, traits=3)
