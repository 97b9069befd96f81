"""The odour-search world: agreement with a plain NumPy reference, senses, ends, refusals."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from refusals import refuses
from search_worlds import FLOW, ODOUR, STRAIGHT_UPWIND, WIND, random_actions, rollout, search_world

from animarl_envs.locomotion import COAST, apply_actions
from animarl_envs.scenario import Scenario
from animarl_envs.species import SILKMOTH, SearchSpecies
from animarl_envs.species.silkmoth import RECORDED_TURNING
from animarl_envs.species.turning import Turning
from animarl_envs.worlds.plume.plume import hit_table
from animarl_envs.worlds.search.layout import ALIKE, PAPER
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
    world = search_world(condition=condition, turning=turning)
    world.seed([seed])
    world.reset()
    actions = random_actions(120, 1, seed)
    actions[::3] = STRAIGHT_UPWIND if seed % 2 else COAST
    wanted = reference(replace(SILKMOTH, turning=turning), world, actions, condition)
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


def test_no_component_of_the_full_observation_is_dead() -> None:
    world = search_world(64, turning=RECORDED_TURNING)
    seen = rollout(world, random_actions(120, 64))
    assert (seen.std(axis=(0, 1)) > 1e-3).all()
    low, high = (
        np.array([getattr(c, edge) for c in world.observation_components], dtype=np.float32)
        for edge in ("low", "high")
    )
    assert (seen >= low).all() and (seen <= high).all()


def test_reaching_the_source_terminates_with_reward_one() -> None:
    world = search_world(plume="off")
    total = 0.0
    while not world.terminated[0]:
        world.step(np.array([[STRAIGHT_UPWIND]]))
        total += world.reward[0, 0]
        assert world.components[0, 0].sum() == world.reward[0, 0]
        assert world.step_count[0] < 40
    assert np.linalg.norm(world.position[0, 0]) < 0.05
    assert total == 1.0 and world.outcome[0] == 1 and not world.truncated[0]


def test_position_is_not_observed() -> None:
    names = [c.name for c in search_world().observation_components]
    assert len(names) == search_world().observation.shape[-1] == ALIKE
    assert not any("position" in name or "distance" in name for name in names)


def test_scene_details_say_where_the_antennae_are() -> None:
    world = search_world(2)
    rollout(world, np.zeros((3, 2), dtype=int))
    details = world.scene_details(1)
    middle = details["antennae"].mean(axis=0) - world.position[1, 0]
    expected = [-0.013 * math.cos(math.radians(19)), 0.0]
    np.testing.assert_allclose(middle, expected, atol=1e-12)


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"odour_decay": 0.0}, "odour_decay"),
        ({"antenna_angle": 120.0}, "antenna_angle"),
        ({"train_plumes": ()}, "train_plumes"),
        ({"observation": "most"}, "'full', 'paper'"),
        ({"trace_decay": 0.0}, "trace_decay"),
        ({"turning": 0.3}, "give a Turning"),
        ({"turning": {"gain": 1.0}}, "persistence, gain, slip and speed"),
        ({"turning": {"persistence": 1.0, "gain": 1.0, "slip": 0.0, "speed": 0.1}}, "below 1"),
    ],
)
def test_bad_options_are_refused(options: dict[str, Any], says: str) -> None:
    refuses(says, search_world, **options)


def test_unknown_pattern_and_scripted_moth_are_refused() -> None:
    refuses("pattern 7 does not exist", search_world, train_plumes=(7,))
    scenario = Scenario(species=SILKMOTH, start="uniform", drivers=("scripted",))
    refuses("no scripted rule", SearchWorld, scenario, 1)


# -- the senses -----------------------------------------------------------------------------------


FRONT, RIGHT, LEFT, BACK = range(6, 10)


# -- odour ----------------------------------------------------------------------------------------


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


# -- wind, vision, condition ----------------------------------------------------------------------


def test_wind_sectors_are_disjoint_cover_all_and_name_the_side() -> None:
    for degrees in np.arange(-180.0, 180.0, 7.5):
        direction = np.deg2rad(degrees)  # of the walk from upwind, to the left
        speed = 0.02 * np.array([[[-math.cos(direction), -math.sin(direction)]]])
        world = search_world(plume="off")
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


def test_reduced_senses_lose_wind_and_vision_and_nothing_else() -> None:
    actions = random_actions(100, 4)
    full, reduced = (rollout(search_world(4, condition=c), actions) for c in (0, 1))
    assert np.abs(full[..., FLOW]).max() > 0 and full[..., WIND].any()
    assert (reduced[..., FLOW] == 0).all() and not reduced[..., WIND].any()
    lost = np.r_[FLOW, WIND]
    np.testing.assert_array_equal(np.delete(full, lost, -1), np.delete(reduced, lost, -1))


def test_a_body_at_rest_keeps_its_heading() -> None:
    world = search_world(plume="off", rest_speed=0.01)
    rollout(world, np.full((6, 1), 9))  # to the left
    assert world.body_angle[0] == pytest.approx(math.pi / 2)
    rollout(world, np.full((30, 1), COAST))
    assert np.linalg.norm(world.velocity) < 0.01
    assert world.body_angle[0] == pytest.approx(math.pi / 2)
