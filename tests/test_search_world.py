"""The odour-search world: agreement with a plain NumPy reference, ends, copies, refusals."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from search_worlds import DOWNWIND, STRAIGHT_UPWIND, random_actions, rollout, search_world

from animarl_envs.errors import InputError
from animarl_envs.locomotion import COAST, apply_actions
from animarl_envs.scenario import Scenario
from animarl_envs.species import SILKMOTH, SearchSpecies
from animarl_envs.worlds.plume.plume import ModelPlume, hit_table
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
    world = search_world(condition=condition)
    world.seed([seed])
    world.reset()
    actions = random_actions(120, 1, seed)
    actions[::3] = STRAIGHT_UPWIND if seed % 2 else COAST
    wanted = reference(SILKMOTH, world, actions, condition)
    seen = rollout(world, actions)[:, 0]
    np.testing.assert_allclose(seen, wanted, atol=1e-5)


def test_time_limit_truncates_and_never_terminates() -> None:
    world = search_world(3, time_limit=20)
    for step in range(1, 21):
        world.step(np.full((3, 1), DOWNWIND))
        assert not world.terminated.any()
        assert world.truncated.all() == (step == 20)
    assert (world.outcome == 0).all() and (world.reward == 0).all()


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


def test_a_copy_does_not_depend_on_its_neighbours() -> None:
    actions = random_actions(80, 5)
    many = search_world(5)
    many.seed(np.arange(5) + 10)
    many.reset()
    alone = search_world(1)
    alone.seed([13])
    alone.reset()
    np.testing.assert_array_equal(
        rollout(many, actions)[:, 3], rollout(alone, actions[:, 3:4])[:, 0]
    )


def test_saved_state_goes_on_alike() -> None:
    world, other = search_world(3), search_world(3)
    rollout(world, random_actions(30, 3))
    other.set_state(world.get_state())
    actions = random_actions(50, 3, seed=9)
    np.testing.assert_array_equal(rollout(world, actions), rollout(other, actions))


def test_position_is_not_observed() -> None:
    names = [c.name for c in search_world().observation_components]
    assert len(names) == search_world().observation.shape[-1] == 10
    assert not any("position" in name or "distance" in name for name in names)


def test_scene_details_show_the_present_plume() -> None:
    world = search_world(2)
    rollout(world, np.zeros((3, 2), dtype=int))
    details = world.scene_details(1)
    assert details["plume"].values.shape == ModelPlume.fitted().model.grid[:2]
    np.testing.assert_allclose(
        details["antennae"].mean(axis=0) - world.position[1, 0],
        [-0.013 * math.cos(math.radians(19)), 0.0],
        atol=1e-12,
    )


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
        search_world(**options)


def test_unknown_pattern_and_scripted_moth_are_refused() -> None:
    with pytest.raises(InputError, match="pattern 7 does not exist"):
        search_world(train_plumes=(7,))
    scenario = Scenario(species=SILKMOTH, start="uniform", drivers=("scripted",))
    with pytest.raises(InputError, match="no scripted rule"):
        SearchWorld(scenario, 1)
