"""Demonstrations as the worlds' kernels read them, and how fast and how far out they go."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from animarl_envs.scenario import Scenario


class FlatDemos(NamedTuple):
    """Demonstrations as kernels read them; empty arrays where there are none."""

    position: NDArray[np.float64]  # (frames, K, 2)
    velocity: NDArray[np.float64]  # (frames, K, 2)
    start: NDArray[np.int64]  # (episodes + 1,)
    condition: NDArray[np.int8]  # (episodes,)


def recorded_speed(scenario: Scenario) -> float:
    """The highest speed in the scenario's demonstrations [arena unit / s], 0 without any."""
    if scenario.demos is None:
        return 0.0
    return float(np.linalg.norm(scenario.demos.velocities(), axis=-1).max())


def recorded_reach(scenario: Scenario) -> float:
    """How far out the scenario's demonstrations lie in x or y [arena unit], 0 without any."""
    return 0.0 if scenario.demos is None else float(np.abs(scenario.demos.positions).max())


def flat_demonstrations(scenario: Scenario) -> FlatDemos:
    demos = scenario.demos
    if demos is None:
        empty = np.zeros((0, scenario.species.num_individuals, 2))
        return FlatDemos(empty, empty, np.zeros(1, dtype=np.int64), np.zeros(0, dtype=np.int8))
    return FlatDemos(
        np.ascontiguousarray(demos.positions),
        demos.velocities(),
        demos.offsets.astype(np.int64),
        np.ascontiguousarray(demos.condition),
    )
