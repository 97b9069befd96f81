"""What a searcher senses: odour at two antennae, wind from four sides, its own turning."""

import math

import numpy as np
import pytest
from search_worlds import FLOW, ODOUR, WIND, random_actions, rollout, search_world

from animarl_envs.locomotion import COAST
from animarl_envs.species import SILKMOTH
from animarl_envs.worlds.search.layout import Seen

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


def test_odour_decays_with_its_time_constant_after_the_last_hit() -> None:
    world = search_world(plume="off")
    state = world.get_state()
    state["odour"][:] = 1.0
    world.set_state(state)
    seen = rollout(world, np.full((4, 1), COAST))[1:, 0, 3]
    after = np.arange(1, 5) * 0.5
    np.testing.assert_allclose(seen, 0.07 + 0.93 * np.exp(-after / 1.96), rtol=1e-6)


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


def test_visual_flow_is_minus_the_yaw_rate_with_threshold_and_limit() -> None:
    turns = np.deg2rad([0.0, 2.0, -2.0, 10.0, -10.0, 30.0, -30.0, 80.0])
    world = search_world(len(turns), plume="off")
    state = world.get_state()
    state["velocity"][:, 0] = -0.02 * np.stack([np.cos(turns), np.sin(turns)], axis=1)
    world.set_state(state)
    world.step(np.full((len(turns), 1), COAST))
    rate = turns / 0.5
    wanted = np.clip(np.where(np.abs(rate) < 0.1, 0.0, -rate), -1.2, 1.2)
    np.testing.assert_allclose(world.observation[:, 0, FLOW], wanted, atol=1e-6)


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


def test_hits_and_the_slow_trace_tell_when_the_last_hit_was() -> None:
    world = search_world(plume="off")
    state = world.get_state()
    state["trace"][:] = [1.0, 0.5]
    world.set_state(state)
    seen = rollout(world, np.full((4, 1), COAST))[1:, 0]
    after = np.arange(1, 5)[:, None] * 0.5
    traces = seen[:, [Seen.TRACE_LEFT, Seen.TRACE_RIGHT]]
    np.testing.assert_allclose(traces, [1.0, 0.5] * np.exp(-after / 10.0), rtol=1e-6)
    assert not seen[:, [Seen.HIT_LEFT, Seen.HIT_RIGHT]].any()
    smelling = rollout(search_world(plume="continuous"), np.zeros((10, 1), dtype=int))[:, 0]
    assert (smelling[:, [Seen.HIT_LEFT, Seen.TRACE_RIGHT]] == 1.0).all()
