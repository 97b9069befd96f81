"""The parts of kernels that move bodies, called alone: the transition, and walls by hand."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import ArrayLike, NDArray

from animarl_envs.arena import SHAPE_CODES
from animarl_envs.kinematics import rebound

SQUARE, DISC, OPEN = (SHAPE_CODES[name] for name in ("square", "disc", "open"))
SIZE = 2.0


def held(
    shape: int, position: ArrayLike, velocity: ArrayLike
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """What walls make of positions and velocities ``(individuals, copies, 2)``."""
    given = (np.array(a, dtype=np.float64).transpose(0, 2, 1).copy() for a in (position, velocity))
    places, speeds = given
    rebound((shape, SIZE, 9.0), places, speeds)
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
        SQUARE,
        [[[2.5, 1.0], [-2.5, -1.0], [0.3, 7.0], [-3.0, -3.0]]],
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


def test_nobody_held_by_a_round_wall_counts_as_beyond_it() -> None:
    angle = np.linspace(0, 2 * np.pi, 500)
    outside = 2.0000001 * np.stack([np.cos(angle), np.sin(angle)], axis=-1)[None]
    places, _ = held(DISC, outside, np.zeros_like(outside))
    radius = np.hypot(places[..., 0], places[..., 1])
    assert (radius <= 2.0).all()
    np.testing.assert_allclose(radius, 2.0, rtol=1e-9)
