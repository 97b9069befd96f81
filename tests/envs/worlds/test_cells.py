"""Cells of recorded velocities: fits, actions, and worlds that draw from them."""

from dataclasses import replace
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from recordings import begun, group
from refusals import refuses
from thrust_walks import walk

from animarl_envs.cells import CellLocomotion, unwarped, warped
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.fitting.tracking import one_step_misses, track, tracking_errors
from animarl_envs.fitting.transitions import action_frames, demonstrated_actions, whole_steps
from animarl_envs.locomotion import Locomotion
from animarl_envs.scenario import make_scenario
from animarl_envs.worlds import make_world, mirror

CELLS = 16
MADE = {"alone": group(1), "pair": group(2), "group": group(5)}
MADE["chase"] = walk((Locomotion(0.2, 2.0), Locomotion(0.3, 1.0), Locomotion(0.25, 3.0)), 1)[0]


def cell_world(demos: Demonstrations, copies: int = 1, **options: Any) -> Any:
    """A world of cells that begins as recorded."""
    return begun(make_scenario("custom", demos=demos, cells=CELLS, **options), copies)


@pytest.mark.parametrize("name", MADE)
def test_cells_of_recordings_lead_back_to_them(name: str) -> None:
    demos = MADE[name]
    species = make_scenario("custom", demos=demos, cells=CELLS).species
    assert species.num_actions == CELLS
    steps, frames = whole_steps(demos), action_frames(demos, CellLocomotion.course_time)
    actions = demonstrated_actions(demos, species.locomotion)
    misses = one_step_misses(demos, species.locomotion)
    for i, own in enumerate(species.locomotion):
        assert isinstance(own, CellLocomotion)
        after, course = demos.velocities()[steps + 1, i], frames[steps, i]
        left = after[:, 1] * course[:, 0] - after[:, 0] * course[:, 1]
        wanted = np.stack([np.sum(after * course, axis=1), left], axis=1) / own.thrust
        taken = actions[steps, i]
        centres = warped(own.action_vectors, own.usual)
        apart = np.linalg.norm(warped(wanted, own.usual)[:, None] - centres, axis=2)
        np.testing.assert_allclose(apart[np.arange(len(taken)), taken], apart.min(axis=1))
        # What is drawn of a label lies in its cell, and misses by no more than the cell is wide.
        drawn = own.nearest_actions(own.thrust * own.drawn_steps)
        filled = np.isin(np.arange(CELLS), actions[steps, i])
        assert (drawn == np.arange(CELLS)[:, None])[filled].mean() > 0.95
        width = np.linalg.norm(own.drawn_steps - own.action_vectors[:, None], axis=2).max(axis=1)
        chosen = misses[steps, i, taken]
        assert (chosen <= own.thrust * width[taken] * demos.dt * 1.01 + 1e-9).mean() > 0.9
    followed = track(demos, species.locomotion, species.arena)
    usual = np.median(np.linalg.norm(demos.velocities(), axis=2)) * demos.dt
    assert (tracking_errors(demos, followed) < 5.0 * usual).all()


@pytest.mark.parametrize("name", MADE)
def test_cells_of_single_and_vector_environments_agree(name: str) -> None:
    demos, seeds = MADE[name], [3, 4]
    vector = gym.make_vec(
        "AnimaRL/Custom-v0", num_envs=2, demos=demos, cells=CELLS, others="replay"
    )
    first, _ = vector.reset(seed=seeds)
    singles = [
        gym.make("AnimaRL/Custom-v0", demos=demos, cells=CELLS, others="replay") for _ in seeds
    ]
    for env, seed, row in zip(singles, seeds, first, strict=True):
        np.testing.assert_array_equal(env.reset(seed=seed)[0], row)
    rng = np.random.default_rng(0)
    assert singles[0].action_space == gym.spaces.Discrete(CELLS)
    for _ in range(12):
        actions = rng.integers(CELLS, size=2)
        seen = vector.step(actions)[0]
        for env, action, row in zip(singles, actions, seen, strict=True):
            np.testing.assert_array_equal(env.step(action)[0], row)


def test_cells_replayed_are_the_recording_and_states_continue() -> None:
    demos = MADE["pair"]
    one, two = cell_world(demos, 3), cell_world(demos, 3)
    actions = np.random.default_rng(1).integers(CELLS, size=(10, 3, 2))
    for each in actions[:5]:
        one.step(each)
    two.set_state(one.get_state())
    for each in actions[5:]:
        one.step(each)
        two.step(each)
    np.testing.assert_array_equal(one.position, two.position)
    shown = cell_world(demos, drivers=dict.fromkeys(demos.individuals, "replay"))
    first = int(shown.demos.offsets[shown.demo[0]])
    shown.step(np.zeros((1, 2), dtype=np.int64))
    np.testing.assert_array_equal(shown.position[0], shown.demos.positions[first + 1])


def test_cells_draw_recorded_steps_scaled_by_the_thrust() -> None:
    species = make_scenario("custom", demos=MADE["alone"], cells=CELLS, arena="open").species
    own = species.locomotion[0]
    fast = replace(species, locomotion=(replace(own, thrust=1.5 * own.thrust),))
    actions = np.arange(CELLS)[:, None]
    speeds = []
    for each in (species, fast):
        world = make_world(make_scenario(each, demos=None, start=[[0.0, 0.0]]), CELLS)
        world.reset()
        world.step(actions)
        speeds.append(np.linalg.norm(world.velocity[:, 0], axis=1))
    np.testing.assert_allclose(speeds[1], 1.5 * speeds[0])
    recorded = own.thrust * np.linalg.norm(own.drawn_steps, axis=2)
    for cell, speed in enumerate(speeds[0]):
        assert np.isclose(recorded[cell], speed, atol=1e-9).any()
    image = mirror(species).actions
    np.testing.assert_array_equal(image, np.roll(np.arange(CELLS), CELLS // 2))


def test_cells_warp_and_back() -> None:
    points = np.random.default_rng(0).normal(size=(50, 2))
    np.testing.assert_allclose(unwarped(warped(points, 0.3), 0.3), points)


@pytest.mark.parametrize("number", [7, 6, 130, True, "many", 2.5])
def test_cells_refuse_other_numbers(number: Any) -> None:
    even = "give an even number of cells, 8 to 128"
    refuses(even, make_scenario, "custom", demos=MADE["alone"], cells=number)


def test_cells_refuse_searchers_strangers_and_the_unmoved() -> None:
    refuses("searches a source by pushes", make_scenario, "silkmoth", cells=CELLS)
    strangers = "made from recordings of the same individuals"
    refuses(strangers, make_scenario, "agent", demos=None, cells=CELLS)
    few = MADE["alone"].select(episodes=[0])
    refuses("too few for 128 cells", make_scenario, "custom", demos=few, cells=128)
    species = make_scenario("custom", demos=MADE["pair"], cells=CELLS).species
    own = species.locomotion[0]
    pushes = Locomotion(0.1, 1.0)
    refuses("same number of them", replace, species, locomotion=(own, pushes))
    refuses("no finite number", replace, own, centres=np.full((CELLS, 2), np.nan))
    refuses(r"give \(cells, 2\) and", replace, own, steps=np.zeros((8, 4, 2)))
