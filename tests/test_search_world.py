"""The odour-search world: senses, ends, symmetry, and agreement with a plain NumPy reference."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from animarl_envs.arena import Arena
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.packaged import load_packaged
from animarl_envs.errors import InputError
from animarl_envs.locomotion import COAST, apply_actions
from animarl_envs.scenario import Scenario, make_scenario
from animarl_envs.species import SILKMOTH, SearchSpecies
from animarl_envs.worlds.plume import ModelPlume, hit_table
from animarl_envs.worlds.search import SearchWorld, antennae_at, demonstration_observations

ODOUR, FLOW, WIND = slice(3, 5), 5, slice(6, 10)
FRONT, RIGHT, LEFT, BACK = range(6, 10)
STRAIGHT_UPWIND, DOWNWIND = 0, 6


def make_world(copies: int = 1, *, start: Any = "uniform", **options: Any) -> SearchWorld:
    condition = options.pop("condition", 0)
    demos = options.pop("demos", None)
    species = replace(SILKMOTH, **options)
    scenario = Scenario(
        species=species, start="demo" if demos else start, condition=condition, demos=demos,
        drivers=("action",),
    )  # fmt: skip
    world = SearchWorld(scenario, copies)
    world.reset()
    return world


def rollout(world: SearchWorld, actions: NDArray[np.integer]) -> NDArray[np.float32]:
    """Observations ``(steps + 1, copies, n)`` under actions ``(steps, copies)``."""
    seen = [world.observation[:, 0].copy()]
    for row in actions:
        world.step(row[:, None])
        seen.append(world.observation[:, 0].copy())
    return np.stack(seen)


def random_actions(steps: int, copies: int, seed: int = 0) -> NDArray[np.int64]:
    """Runs of equal actions, so that speed builds up."""
    rng = np.random.default_rng(seed)
    return np.repeat(rng.integers(13, size=(steps // 4 + 1, copies)), 4, axis=0)[:steps]


def recorded(frames: int = 40, episodes: int = 3, seed: int = 0, **signals: Any) -> Demonstrations:
    rng = np.random.default_rng(seed)
    steps = 0.01 * rng.standard_normal((episodes, frames, 1, 2)) + [-0.002, 0.0]
    positions = np.array([0.3, 0.0]) + np.cumsum(steps, axis=1)
    total = frames * episodes
    return Demonstrations(
        species="silkmoth", individuals=("moth",), roles=("searcher",), dt=0.5,
        arena=Arena("open", size=0.35), positions=positions.reshape(total, 1, 2),
        lengths=np.full(episodes, frames), initial_velocity=steps[:, 0] / 0.5,
        condition=np.arange(episodes) % 2, outcome=np.zeros(episodes),
        split=np.array(["train", "test", "train"][:episodes]),
        recording=np.array([f"r{e}" for e in range(episodes)]),
        signals={"odour_left": rng.random(total) < 0.3, "odour_right": rng.random(total) < 0.3}
        | signals,
        provenance={"source": "made by the test", "licence": "none", "synthetic": True},
    )  # fmt: skip


# -- the plain reference --------------------------------------------------------------------------


def reference(
    species: SearchSpecies, world: SearchWorld, actions: NDArray[np.integer], condition: int
) -> NDArray[np.float64]:
    """Observations of copy 0 by NumPy and the documented formulas, one step at a time."""
    plume, pattern, phase = world.plume, world.patterns[world.pattern[0]], int(world.phase[0])
    table = hit_table(plume, (pattern,), species.dt, species.antenna_radius)
    position, velocity = world.position[0, 0].copy(), world.velocity[0, 0].copy()
    heading, odour = np.array([-1.0, 0.0]), np.full(2, species.odour_baseline)
    loco, upwind = species.locomotion[0], np.array([-1.0, 0.0])
    angle = 0.0
    rows = []
    for step in range(len(actions) + 1):
        old = angle
        if step > 0:
            action = np.asarray(actions[step - 1, 0])
            velocity = apply_actions(velocity, action, upwind, loco, species.dt)
            position = position + velocity * species.dt
        if np.linalg.norm(velocity) > species.rest_speed:
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
        turned = math.remainder(angle - old, 2 * math.pi)
        about_face = abs(turned) > math.pi - 1e-6  # has no side
        yaw_rate = 0.0 if about_face else turned / species.dt
        flow = 0.0 if abs(yaw_rate) < species.flow_threshold else -yaw_rate
        flow = float(np.clip(flow, -species.flow_limit, species.flow_limit))
        air_from = math.degrees(-angle)  # upwind, seen from the body, to the left
        sector = np.array(
            [
                abs(air_from) <= 45,
                -135 < air_from < -45,
                45 < air_from < 135,
                abs(air_from) >= 135,
            ]
        )
        open_senses = float(condition == 0)
        rows.append(
            [-velocity[0], -velocity[1], angle, *odour, open_senses * flow, *(open_senses * sector)]
        )
    return np.array(rows)


@pytest.mark.parametrize("condition", [0, 1])
@pytest.mark.parametrize("seed", range(4))
def test_kernel_agrees_with_the_reference(condition: int, seed: int) -> None:
    world = make_world(condition=condition)
    world.seed([seed])
    world.reset()
    actions = random_actions(120, 1, seed)
    actions[::3] = STRAIGHT_UPWIND if seed % 2 else COAST
    wanted = reference(SILKMOTH, world, actions, condition)
    seen = rollout(world, actions)[:, 0]
    np.testing.assert_allclose(seen, wanted, atol=1e-5)


# -- odour ----------------------------------------------------------------------------------------


def test_plume_off_leaves_odour_at_baseline_for_ever() -> None:
    world = make_world(8, plume="off")
    seen = rollout(world, random_actions(300, 8))
    assert (seen[..., ODOUR] == np.float32(SILKMOTH.odour_baseline)).all()


def test_straight_upwind_of_a_continuous_plume_both_antennae_fire() -> None:
    world = make_world(plume="continuous")
    seen = rollout(world, np.zeros((10, 1), dtype=int))
    assert (seen[:, 0, ODOUR] == 1.0).all()


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_the_antenna_on_the_plume_s_side_fires_first(side: float) -> None:
    """Walking upwind just beside the plume; side 1: the plume is on the moth's left, at -y."""
    entry = 0.02 + 0.0025 + 0.013 * math.sin(math.radians(19))  # half width, radius, antenna
    world = make_world(plume="continuous", start=[[0.3, side * (entry + 0.004)]])
    towards = 11 if side > 0 else 1  # 30 deg to the left or to the right of upwind
    seen = rollout(world, np.full((12, 1), towards))[:, 0, ODOUR]
    first = [int(np.flatnonzero(seen[:, antenna] == 1.0)[0]) for antenna in range(2)]
    near, far = (0, 1) if side > 0 else (1, 0)
    assert first[near] < first[far]


def test_odour_decays_with_its_time_constant_after_the_last_hit() -> None:
    world = make_world(plume="off")
    state = world.get_state()
    state["odour"][:] = 1.0
    world.set_state(state)
    seen = rollout(world, np.full((4, 1), COAST))[1:, 0, 3]
    after = np.arange(1, 5) * 0.5
    np.testing.assert_allclose(seen, 0.07 + 0.93 * np.exp(-after / 1.96), rtol=1e-6)


def test_training_and_held_out_episodes_have_their_own_plumes() -> None:
    world = make_world(400, demos=recorded())
    used = np.array(world.patterns)[world.pattern]
    held_out = world.demos.split[world.demo] == "test"  # type: ignore[union-attr]
    assert set(used[held_out]) == set(SILKMOTH.test_plumes)
    assert set(used[~held_out]) == set(SILKMOTH.train_plumes)
    assert len(np.unique(world.phase)) > 200


def test_known_plume_of_a_demonstration_is_used() -> None:
    demos = recorded(plume=np.repeat([4, 2, 1], 40), plume_step=np.repeat([7, 8, 519], 40))
    world = make_world(60, demos=demos)
    assert np.array_equal(np.array(world.patterns)[world.pattern], np.array([4, 2, 1])[world.demo])
    assert np.array_equal(world.phase, np.array([7, 8, 519])[world.demo])
    with pytest.raises(InputError, match="pattern 9"):
        make_world(demos=recorded(plume=np.full(120, 9)))


# -- wind, vision, condition ----------------------------------------------------------------------


def test_wind_sectors_are_disjoint_cover_all_and_name_the_side() -> None:
    for degrees in np.arange(-180.0, 180.0, 7.5):
        direction = np.deg2rad(degrees)  # of the walk from upwind, to the left
        speed = 0.02 * np.array([[[-math.cos(direction), -math.sin(direction)]]])
        world = make_world(plume="off")
        state = world.get_state()
        state["velocity"][:] = speed
        world.set_state(state)
        world.step(np.array([[COAST]]))
        seen = world.observation[0, 0]
        assert seen[WIND].sum() == 1.0
        assert seen[2] == pytest.approx(direction, abs=1e-6) or abs(degrees) == 180.0
        inner = (abs(degrees) - 45.0) % 90.0
        if inner > 1.0:  # away from the borders between sectors
            side = [FRONT, RIGHT, BACK, LEFT][round(degrees / 90.0) % 4]
            assert seen[side] == 1.0


def test_visual_flow_is_minus_the_yaw_rate_with_threshold_and_limit() -> None:
    turns = np.deg2rad([0.0, 2.0, -2.0, 10.0, -10.0, 30.0, -30.0, 80.0])
    world = make_world(len(turns), plume="off")
    state = world.get_state()
    angle = np.zeros(len(turns))
    state["velocity"][:, 0] = -0.02 * np.stack([np.cos(angle + turns), np.sin(angle + turns)], 1)
    world.set_state(state)
    world.step(np.full((len(turns), 1), COAST))
    rate = turns / 0.5
    wanted = np.clip(np.where(np.abs(rate) < 0.1, 0.0, -rate), -1.2, 1.2)
    np.testing.assert_allclose(world.observation[:, 0, FLOW], wanted, atol=1e-6)


def test_reduced_senses_lose_wind_and_vision_and_nothing_else() -> None:
    actions = random_actions(100, 4)
    full, reduced = (rollout(make_world(4, condition=c), actions) for c in (0, 1))
    assert np.abs(full[..., FLOW]).max() > 0 and full[..., WIND].any()
    assert (reduced[..., FLOW] == 0).all() and not reduced[..., WIND].any()
    np.testing.assert_array_equal(full[..., :5], reduced[..., :5])


def test_a_body_at_rest_keeps_its_heading() -> None:
    world = make_world(plume="off", rest_speed=0.01)
    rollout(world, np.full((6, 1), 9))  # to the left
    assert world.body_angle[0] == pytest.approx(math.pi / 2)
    rollout(world, np.full((30, 1), COAST))
    assert np.linalg.norm(world.velocity) < 0.01
    assert world.body_angle[0] == pytest.approx(math.pi / 2)


# -- symmetry, ends, determinism ------------------------------------------------------------------


def test_time_limit_truncates_and_never_terminates() -> None:
    world = make_world(3, time_limit=20)
    for step in range(1, 21):
        world.step(np.full((3, 1), DOWNWIND))
        assert not world.terminated.any()
        assert world.truncated.all() == (step == 20)
    assert (world.outcome == 0).all() and (world.reward == 0).all()


def test_reaching_the_source_terminates_with_reward_one() -> None:
    world = make_world(plume="off")
    total = 0.0
    while not world.terminated[0]:
        world.step(np.array([[STRAIGHT_UPWIND]]))
        total += world.reward[0, 0]
        assert world.components[0, 0].sum() == world.reward[0, 0]
        assert world.step_count[0] < 40
    assert np.linalg.norm(world.position[0, 0]) < 0.05
    assert total == 1.0 and world.outcome[0] == 1 and not world.truncated[0]


def test_a_copy_does_not_depend_on_its_neighbours() -> None:
    actions = random_actions(80, 5)
    many = make_world(5)
    many.seed(np.arange(5) + 10)
    many.reset()
    alone = make_world(1)
    alone.seed([13])
    alone.reset()
    np.testing.assert_array_equal(
        rollout(many, actions)[:, 3], rollout(alone, actions[:, 3:4])[:, 0]
    )


def test_saved_state_goes_on_alike() -> None:
    world, other = make_world(3), make_world(3)
    rollout(world, random_actions(30, 3))
    other.set_state(world.get_state())
    actions = random_actions(50, 3, seed=9)
    np.testing.assert_array_equal(rollout(world, actions), rollout(other, actions))


def test_position_is_not_observed() -> None:
    names = [c.name for c in make_world().observation_components]
    assert len(names) == make_world().observation.shape[-1] == 10
    assert not any("position" in name or "distance" in name for name in names)


# -- demonstrations -------------------------------------------------------------------------------


def test_warm_up_replays_positions_and_recorded_odour() -> None:
    demos = recorded()
    world = make_world(6, demos=demos, condition=0)
    offline = demonstration_observations(SILKMOTH, demos, condition=0)
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
    assert seen.shape == (120, 1, 10) and seen.dtype == np.float32
    reduced = np.repeat(demos.condition == 1, 40)
    assert not seen[reduced][..., 5:].any()
    assert (seen[~reduced][..., WIND].sum(axis=-1) == 1.0).all()
    hit = demos.signals["odour_left"]
    assert (seen[hit, 0, 3] == 1.0).all() and (seen[~hit, 0, 3] < 1.0).all()


def test_initial_heading_at_rest_comes_from_the_recording() -> None:
    demos = recorded(heading=np.full(120, 2.0))
    still = replace(demos, initial_velocity=np.zeros((3, 1, 2)))
    world = make_world(5, demos=still)
    np.testing.assert_allclose(world.heading, np.tile([math.cos(2.0), math.sin(2.0)], (5, 1)))


def test_demonstrations_without_odour_are_refused_offline() -> None:
    demos = replace(recorded(), signals={})
    with pytest.raises(InputError, match="odour_left"):
        demonstration_observations(SILKMOTH, demos)


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"plume": "gone"}, "'model', 'off', 'continuous'"),
        ({"odour_baseline": 1.0}, "odour_baseline"),
        ({"odour_decay": 0.0}, "odour_decay"),
        ({"antenna_angle": 120.0}, "antenna_angle"),
        ({"antenna_radius": -1.0}, "antenna_radius"),
        ({"train_plumes": ()}, "train_plumes"),
    ],
)
def test_bad_options_are_refused(options: dict[str, Any], says: str) -> None:
    with pytest.raises(InputError, match=says):
        make_world(**options)


def test_unknown_pattern_and_scripted_moth_are_refused() -> None:
    with pytest.raises(InputError, match="pattern 7 does not exist"):
        make_world(train_plumes=(7,))
    scenario = Scenario(species=SILKMOTH, start="uniform", drivers=("scripted",))
    with pytest.raises(InputError, match="no scripted rule"):
        SearchWorld(scenario, 1)


def test_scene_details_show_the_present_plume() -> None:
    world = make_world(2)
    rollout(world, np.zeros((3, 2), dtype=int))
    details = world.scene_details(1)
    assert details["plume"].values.shape == ModelPlume.fitted().model.grid[:2]
    np.testing.assert_allclose(
        details["antennae"].mean(axis=0) - world.position[1, 0],
        [-0.013 * math.cos(math.radians(19)), 0.0],
        atol=1e-12,
    )


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
