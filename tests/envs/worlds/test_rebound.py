"""Worlds with walls: who walks into one is held, loses the velocity into it, and slides along."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from recordings import dogs

from animarl_envs.arena import Arena
from animarl_envs.locomotion import COAST
from animarl_envs.scenario import make_scenario
from animarl_envs.worlds.chase.world import ChaseWorld

FAR = [[-0.5, 0.0], [-0.5, 0.4]]


def world(copies: int = 1, **options: Any) -> ChaseWorld:
    made = ChaseWorld(make_scenario("agent", demos=None, rebound=True, **options), copies)
    made.reset()
    return made


def put(made: ChaseWorld, who: int, position: Any, velocity: Any) -> None:
    state = made.get_state()
    state["position"][0, who], state["velocity"][0, who] = position, velocity
    made.set_state(state)


def test_a_straight_wall_takes_the_velocity_into_it_and_leaves_the_rest() -> None:
    made = world(start=[*FAR, [0.9, 0.0]])
    put(made, 2, [0.97, 0.0], [1.0, 0.6])
    made.step(np.full((1, 3), COAST))
    assert made.position[0, 2] == pytest.approx([1.0, 0.6 * 0.75 * 0.1])
    assert made.velocity[0, 2] == pytest.approx([0.0, 0.6 * 0.75])
    made.step(np.full((1, 3), COAST))
    assert made.position[0, 2] == pytest.approx([1.0, 0.6 * (0.75 + 0.75**2) * 0.1])
    assert made.reward[0, 2] == 0.1 and not made.terminated[0]


@pytest.mark.parametrize("shape", ["square", "disc"])
def test_nobody_leaves_a_field_with_walls(shape: str) -> None:
    made = world(50, arena=shape)
    rng = np.random.default_rng(0)
    touched = 0
    for _ in range(120):
        made.step(rng.choice([0, 6, 6, 6, 3], size=(50, 3)))
        out = np.abs(made.position).max(axis=2)
        if shape == "disc":
            out = np.linalg.norm(made.position, axis=2)
        assert out.max() <= 1.0
        touched += int((out > 1.0 - 1e-9).sum())
        assert (made.outcome >= 0).all() and (made.components[..., 2] == 0.0).all()
        made.reset(made.terminated | made.truncated)
    assert touched > 100


def test_who_is_replayed_keeps_to_the_recording_beyond_a_wall() -> None:
    demos = dogs(2)
    drivers = dict.fromkeys(demos.individuals, "replay")
    small = replace(demos, arena=Arena("disc", 0.9 * np.abs(demos.positions).max(), 9.0))
    made = ChaseWorld(make_scenario("custom", demos=small, split=None, drivers=drivers), len(demos))
    made.reset(demo=np.arange(len(demos)))
    for t in range(1, int(demos.lengths.min())):
        made.step(np.zeros((len(demos), 3), dtype=int))
        assert np.array_equal(made.position, demos.positions[demos.offsets[:-1] + t])
        assert not made.terminated.any()
