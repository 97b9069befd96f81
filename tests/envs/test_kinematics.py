"""The parts of kernels that move bodies, called alone: the transition, and walls by hand."""

from __future__ import annotations

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


@pytest.mark.parametrize("shape", [SQUARE, DISC, OPEN])
def test_who_stands_inside_keeps_place_and_velocity(shape: int) -> None:
    position = [[[0.0, 0.0], [1.2, -1.3]], [[-1.99, 0.0], [0.0, 1.99]]]
    velocity = [[[3.0, -4.0], [1.0, -1.0]], [[-5.0, 0.5], [0.5, 5.0]]]
    places, speeds = held(shape, position, velocity)
    np.testing.assert_array_equal(places, position)
    np.testing.assert_array_equal(speeds, velocity)


def test_a_straight_wall_holds_each_axis_by_itself() -> None:
    position = [[[2.5, 1.0], [-2.5, -1.0], [0.3, 7.0], [-3.0, -3.0]]]
    velocity = [[[1.0, 0.5], [-1.0, 0.5], [-0.2, 0.4], [-1.0, -2.0]]]
    places, speeds = held(SQUARE, position, velocity)
    assert places.tolist() == [[[2.0, 1.0], [-2.0, -1.0], [0.3, 2.0], [-2.0, -2.0]]]
    assert speeds.tolist() == [[[0.0, 0.5], [0.0, 0.5], [-0.2, 0.0], [0.0, 0.0]]]


def test_slow_ones_are_judged_as_fast_ones_are() -> None:
    places, speeds = held(SQUARE, [[[2.1, -2.1], [2.1, -2.1]]], [[[0.1, -0.1], [-0.1, 0.1]]])
    assert places.tolist() == [[[2.0, -2.0], [2.0, -2.0]]]
    assert speeds.tolist() == [[[0.0, 0.0], [-0.1, 0.1]]]


def test_who_stands_on_a_round_wall_is_not_beyond_it() -> None:
    places, speeds = held(DISC, [[[2.0, 0.0], [0.0, -2.0]]], [[[1.0, 0.5], [0.5, -1.0]]])
    assert places.tolist() == [[[2.0, 0.0], [0.0, -2.0]]]
    assert speeds.tolist() == [[[1.0, 0.5], [0.5, -1.0]]]


def test_who_stands_on_a_straight_wall_is_not_beyond_it() -> None:
    """Nor is one who moves back inside robbed of the velocity."""
    places, speeds = held(SQUARE, [[[2.0, -2.0], [2.5, -2.5]]], [[[1.0, -1.0], [-0.7, 0.7]]])
    assert places.tolist() == [[[2.0, -2.0], [2.0, -2.0]]]
    assert speeds.tolist() == [[[1.0, -1.0], [-0.7, 0.7]]]


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


def test_an_open_field_holds_nobody() -> None:
    places, speeds = held(OPEN, [[[50.0, -50.0]]], [[[1.0, -1.0]]])
    assert places.tolist() == [[[50.0, -50.0]]] and speeds.tolist() == [[[1.0, -1.0]]]
