"""The equation of motion, its inverse, and walls, by known answers."""

import dataclasses
import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import ArrayLike, NDArray
from refusals import refuses

from animarl_envs.arena import SHAPE_CODES
from animarl_envs.kinematics import rebound
from animarl_envs.locomotion import (
    ACTION_ANGLES,
    ACTION_VECTORS,
    COAST,
    NUM_ACTIONS,
    Locomotion,
    apply_actions,
    infer_actions,
    velocities,
)

DT = 0.1
OWN = Locomotion(0.25, 3.0)


def test_actions_turn_right_in_steps_of_thirty_degrees_and_the_last_is_none() -> None:
    assert (NUM_ACTIONS, COAST) == (13, 12)
    assert ACTION_VECTORS.shape == (NUM_ACTIONS, 2)
    for k in range(12):
        angle = math.radians(-30 * k)
        assert ACTION_ANGLES[k] == pytest.approx(angle)
        assert ACTION_VECTORS[k] == pytest.approx([math.cos(angle), math.sin(angle)], abs=1e-15)
    assert ACTION_ANGLES.shape == (12,)
    assert ACTION_VECTORS[COAST].tolist() == [0.0, 0.0]


def test_one_step_by_hand() -> None:
    """v' = (1 - 0.25) (2, -4) + 3 a 0.1, with the focus straight up."""
    velocity, focus = np.array([2.0, -4.0]), np.array([0.0, 1.0])
    for action, push in ((0, (0, 1)), (3, (1, 0)), (6, (0, -1)), (9, (-1, 0)), (COAST, (0, 0))):
        after = apply_actions(velocity, np.array(action), focus, OWN, DT)
        assert after == pytest.approx([1.5 + 0.3 * push[0], -3.0 + 0.3 * push[1]])


def test_the_action_taken_is_found_again() -> None:
    rng = np.random.default_rng(0)
    velocity = rng.normal(size=(26, 3, 2))
    angle = rng.uniform(0, 2 * np.pi, (26, 3))
    focus = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    actions = np.broadcast_to(np.arange(26)[:, None] % 13, (26, 3))
    after = apply_actions(velocity, actions, focus, OWN, DT)
    found = infer_actions(velocity, after, focus, OWN, DT)
    assert found.dtype == np.int8 and found.shape == (26, 3)
    np.testing.assert_array_equal(found, actions)
    # The nearest of the 13: less than half a push is none, a little more is one.
    for share, nearest in ((0.49, COAST), (0.51, 0), (1.8, 0)):
        pushed = 0.75 * velocity + share * 0.3 * focus
        assert (infer_actions(velocity, pushed, focus, OWN, DT) == nearest).all()


def test_velocities_belong_to_the_positions_they_led_to() -> None:
    positions = np.array([[[1.0, 2.0]], [[1.5, 2.0]], [[1.5, 1.0]]])
    found = velocities(positions, np.array([[7.0, 8.0]]), 0.5)
    assert found.tolist() == [[[7.0, 8.0]], [[1.0, 0.0]], [[0.0, -2.0]]]


def test_speeds_under_constant_thrust() -> None:
    assert OWN.terminal_speed(DT) == pytest.approx(3.0 * 0.1 / 0.25)
    assert Locomotion(0.0, 3.0).terminal_speed(DT) == math.inf
    assert OWN.top_speed(DT, 2) == pytest.approx(0.6)
    assert OWN.top_speed(DT, 2, initial=0.1) == pytest.approx(0.7)
    assert OWN.top_speed(DT, 100) == pytest.approx(1.2)
    assert OWN.top_speed(DT, 1, initial=5.0) == pytest.approx(5.0)  # it can only slow down
    assert Locomotion(1.0, 0.1).terminal_speed(1.0) == pytest.approx(0.1)


@pytest.mark.parametrize(
    ("numbers", "said"),
    [
        ((-0.01, 1.0), "damping is -0.01"),
        ((1.01, 1.0), "damping is 1.01"),
        ((math.nan, 1.0), "damping is nan"),
        ((0.5, 0.0), "thrust is 0.0"),
        ((0.5, math.inf), "thrust is inf"),
        ((0.5, math.nan), "thrust is nan"),
        *(
            ((0.5, 1.0, magnitudes), "give 1 to 10")
            for magnitudes in ((), tuple(range(11, 0, -1)), "21", 2.0, (2.0, "1"))
        ),
        *(
            ((0.5, 1.0, magnitudes), "the largest first")
            for magnitudes in ((2.0, 2.0), (1.0, 2.0), (1.0, 0.0), (1.0, -0.5), (math.inf, 1.0))
        ),
        ((0.5, 1.0, (math.nan,)), "give 1 to 10|the largest first"),
    ],
)
def test_impossible_numbers_are_refused(numbers: tuple[Any, ...], said: str) -> None:
    refuses(said, Locomotion, *numbers)
    assert Locomotion(0.0, 1e-9) != Locomotion(1.0, 1e-9)


def test_several_magnitudes_have_twelve_actions_each_and_one_to_coast() -> None:
    """By hand, the focus straight up: action 15 is the second magnitude, to the right."""
    own = Locomotion(0.25, 3.0, (2, 0.5))
    assert (own.thrusts, own.num_actions, own.magnitudes) == (2, 25, (2.0, 0.5))
    expected = np.concatenate([2.0 * ACTION_VECTORS[:12], 0.5 * ACTION_VECTORS])
    expected[-1] = 0.0
    np.testing.assert_array_equal(own.action_vectors, expected)
    focus = np.array([0.0, 1.0])
    for action, push in ((0, (0, 2)), (15, (0.5, 0)), (18, (0, -0.5)), (24, (0, 0))):
        after = apply_actions(np.zeros(2), np.array(action), focus, own, DT)
        assert after == pytest.approx([0.3 * push[0], 0.3 * push[1]])
        assert infer_actions(np.zeros(2), after, focus, own, DT) == action
    assert own.terminal_speed(DT) == pytest.approx(2 * 3.0 * 0.1 / 0.25)
    assert own.top_speed(DT, 2) == pytest.approx(1.2)


def test_parameters_and_action_vectors_cannot_be_changed() -> None:
    own = Locomotion(0.25, 3.0)
    with pytest.raises(dataclasses.FrozenInstanceError):
        own.damping = 0.5  # type: ignore[misc]
    with pytest.raises(ValueError, match="read-only"):
        OWN.action_vectors[0] = 0.0


def test_magnitudes_may_be_ten_and_an_array() -> None:
    ten = Locomotion(0.5, 1.0, np.arange(10, 0, -1))  # type: ignore[arg-type]
    assert ten.magnitudes == tuple(range(10, 0, -1)) and ten.num_actions == 121


SQUARE, DISC, OPEN = (SHAPE_CODES[name] for name in ("square", "disc", "open"))
SIZE = 2.0


def held(
    shape: int, position: ArrayLike, velocity: ArrayLike, hole: float = 0.0
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """What walls make of positions and velocities ``(individuals, copies, 2)``."""
    given = (np.array(a, dtype=np.float64).transpose(0, 2, 1).copy() for a in (position, velocity))
    places, speeds = given
    holes = np.array([[0.0, 0.0, hole]] if hole else np.zeros((0, 3)))
    rebound((shape, SIZE, 9.0, holes), places, speeds)
    return places.transpose(0, 2, 1), speeds.transpose(0, 2, 1)


INSIDE = [[[0.0, 0.0], [1.2, -1.3]], [[-1.99, 0.0], [0.0, 1.99]]]
MOVING = [[[3.0, -4.0], [1.0, -1.0]], [[-5.0, 0.5], [0.5, 5.0]]]
FAR, ON_DISC = [[[50.0, -50.0]]], [[[2.0, 0.0], [0.0, -2.0]]]
SLOW, OUT = [[[0.1, -0.1], [-0.1, 0.1]]], [[[1.0, 0.5], [0.5, -1.0]]]
CORNERS, BACK = [[[2.0, -2.0], [2.0, -2.0]]], [[[1.0, -1.0], [-0.7, 0.7]]]
BY_HAND: dict[str, tuple[Any, ...]] = {
    "in a square": (SQUARE, INSIDE, MOVING, INSIDE, MOVING),
    "in a disc": (DISC, INSIDE, MOVING, INSIDE, MOVING),
    "in the open": (OPEN, INSIDE, MOVING, INSIDE, MOVING),
    "far in the open": (OPEN, FAR, [[[1.0, -1.0]]], FAR, [[[1.0, -1.0]]]),
    "a straight wall holds each axis by itself": (
        SQUARE, [[[2.5, 1.0], [-2.5, -1.0], [0.3, 7.0], [-3.0, -3.0]]],
        [[[1.0, 0.5], [-1.0, 0.5], [-0.2, 0.4], [-1.0, -2.0]]],
        [[[2.0, 1.0], [-2.0, -1.0], [0.3, 2.0], [-2.0, -2.0]]],
        [[[0.0, 0.5], [0.0, 0.5], [-0.2, 0.0], [0.0, 0.0]]],
    ),
    "slow ones are judged as fast ones are": (
        SQUARE, [[[2.1, -2.1], [2.1, -2.1]]], SLOW, CORNERS, [[[0.0, 0.0], [-0.1, 0.1]]],
    ),
    "on a round wall is not beyond it": (DISC, ON_DISC, OUT, ON_DISC, OUT),
    "on a straight wall neither, and who moves back inside keeps the velocity": (
        SQUARE, [[[2.0, -2.0], [2.5, -2.5]]], BACK, CORNERS, BACK,
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", BY_HAND)
def test_walls_hold_by_hand(case: str) -> None:
    shape, position, velocity, places, speeds = BY_HAND[case]
    found = held(shape, position, velocity)
    assert (found[0].tolist(), found[1].tolist()) == (places, speeds)


def test_a_round_wall_takes_the_outward_velocity_alone() -> None:
    """Beyond the wall in the direction (0.6, 0.8), whose tangent is (-0.8, 0.6)."""
    out, along = np.array([0.6, 0.8]), np.array([-0.8, 0.6])
    velocity = [[3.0 * out + 2.0 * along, -3.0 * out + 2.0 * along, -1.0 * along]]
    places, speeds = held(DISC, [[2.5 * out, 2.5 * out, 4.0 * out]], velocity)
    np.testing.assert_allclose(places[0], [2.0 * out] * 3, rtol=1e-9)
    np.testing.assert_allclose(
        speeds[0], [2.0 * along, -3.0 * out + 2.0 * along, -1.0 * along], atol=1e-12
    )


def test_the_hole_of_a_ring_takes_the_inward_velocity_alone() -> None:
    """Of three, the first two in the hole (radius 1) and the last one between the walls."""
    out, along = np.array([0.6, 0.8]), np.array([-0.8, 0.6])
    velocity = [[-3.0 * out + 2.0 * along, 3.0 * out + 2.0 * along, -1.0 * out]]
    places, speeds = held(DISC, [[0.5 * out, 0.1 * out, 1.5 * out]], velocity, hole=1.0)
    np.testing.assert_allclose(places[0], [out, out, 1.5 * out], rtol=1e-9)
    np.testing.assert_allclose(
        speeds[0], [2.0 * along, 3.0 * out + 2.0 * along, -1.0 * out], atol=1e-12
    )
    middle = held(DISC, [[[0.0, 0.0]]], [[[1.0, 0.0]]], hole=1.0)  # it has no way out to take
    assert np.isfinite(middle).all()


@pytest.mark.parametrize("at, hole", [(2.0000001, 0.0), (0.9999999, 1.0)])
def test_nobody_held_by_a_round_wall_counts_as_beyond_it(at: float, hole: float) -> None:
    angle = np.linspace(0, 2 * np.pi, 500)
    outside = at * np.stack([np.cos(angle), np.sin(angle)], axis=-1)[None]
    places, _ = held(DISC, outside, np.zeros_like(outside), hole)
    radius = np.hypot(places[..., 0], places[..., 1])
    assert (radius <= 2.0).all() and (radius >= hole).all()
    np.testing.assert_allclose(radius, hole or 2.0, rtol=1e-9)
