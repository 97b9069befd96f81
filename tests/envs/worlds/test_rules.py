"""The scripted rules, as arrays: what walls cost, where the target flees to, and that pursuers push
straight on."""

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from animarl_envs.arena import SHAPE_CODES
from animarl_envs.locomotion import Locomotion, apply_actions
from animarl_envs.worlds.chase.kernels import LOOKS, SOFTENING, WALL_WEIGHT, decide

DT = 0.1
OWN = Locomotion(0.2, 3.0, (1.0, 0.4))
SQUARE, DISC, OPEN = (SHAPE_CODES[name] for name in ("square", "disc", "open"))


def unit(angle: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.stack([np.cos(angle), np.sin(angle)], axis=-1)


def moves(
    own: Locomotion, who: int, given: tuple[NDArray[np.float64], ...], shape: int, size: float,
    lone: bool = False,
) -> NDArray[np.uint64]:  # fmt: skip
    """What ``decide`` says of positions, velocities and focus directions ``(B, K, 2)``."""
    position, velocity, towards = (np.ascontiguousarray(a.transpose(1, 2, 0)) for a in given)
    individuals, _, copies = position.shape
    actions = np.full((individuals, copies), 77, dtype=np.uint64)
    pushes = np.stack([np.ascontiguousarray(own.action_vectors.T)] * individuals)
    decide(
        who, position, velocity, towards, np.full(individuals, own.damping),
        np.full(individuals, own.thrust), pushes, DT, shape, size, lone, actions,
    )  # fmt: skip
    others = np.delete(actions, who, axis=0)
    assert (others == 77).all()  # a rule speaks for its own individual alone
    return actions[who]


def scene(
    individuals: int, copies: int, size: float, seed: int
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    rng = np.random.default_rng(seed)
    return (
        rng.uniform(-size, size, (copies, individuals, 2)),
        rng.normal(0, 0.5, (copies, individuals, 2)),
        unit(rng.uniform(0, 2 * np.pi, (copies, individuals))),
    )


@pytest.mark.parametrize("individuals", [2, 3])
@pytest.mark.parametrize("shape", [SQUARE, DISC, OPEN])
def test_the_target_takes_the_action_of_the_lowest_cost(individuals: int, shape: int) -> None:
    size, copies, target = 1.5, 80, individuals - 1
    position, velocity, towards = scene(individuals, copies, size, seed=3)
    if shape == SQUARE:
        position[:40, target, 0] *= 0.1  # some near one wall alone
        position[:40, target, 1] = 1.3
    chosen = moves(OWN, target, (position, velocity, towards), shape, size)
    margin, steps = 0.25 * size, math.ceil(math.sqrt(size / OWN.thrust) / DT)
    focus = position[:, target, None] - position[:, :target]
    focus /= np.linalg.norm(focus, axis=-1, keepdims=True)
    ahead = np.zeros(copies, dtype=int)
    costs = np.zeros((OWN.num_actions, copies))
    for k in range(OWN.num_actions):
        place, speed = position[:, target], velocity[:, target]
        chaser, pace = position[:, :target], velocity[:, :target]
        for t in range(1, steps + 1):
            speed = apply_actions(speed, np.full(copies, k), towards[:, target], OWN, DT)
            place = place + speed * DT
            pace = np.stack(
                [apply_actions(pace[:, j], ahead, focus[:, j], OWN, DT) for j in range(target)], 1
            )
            chaser = chaser + pace * DT
            if t not in [(look + 1) * steps // LOOKS for look in range(LOOKS)]:
                continue
            square = shape == SQUARE
            reach = np.abs(place) if square else np.linalg.norm(place, axis=1, keepdims=True)
            depth = np.maximum(reach - (size - margin), 0.0) / margin * (shape != OPEN)
            gap = np.linalg.norm(chaser - place[:, None], axis=-1) / size
            costs[k] += WALL_WEIGHT * (depth**2).sum(axis=1)
            costs[k] += (1.0 / (gap**2 + SOFTENING)).sum(axis=1)
    np.testing.assert_array_equal(chosen, costs.argmin(axis=0))
    assert len(set(chosen.tolist())) > 5


def test_pursuers_accelerate_straight_at_the_target() -> None:
    for who in (0, 1):
        assert (moves(OWN, who, scene(3, 20, 1.0, seed=2), SQUARE, 1.0) == 0).all()


def test_of_equal_actions_the_first_is_taken() -> None:
    still = Locomotion(0.2, 1e-300)  # so weak that no action moves anybody
    assert (moves(still, 2, scene(3, 20, 1.0, seed=1), SQUARE, 1.0) == 0).all()


def test_each_target_of_a_lone_pursuer_runs_from_it_alone() -> None:
    """As if there were the two of them; the pursuer accelerates straight at its focus."""
    position, velocity, towards = scene(4, 60, 1.5, seed=4)
    for who in range(3):
        pair = tuple(each[:, [3, who]] for each in (position, velocity, towards))
        chosen = moves(OWN, who, (position, velocity, towards), DISC, 1.5, lone=True)
        np.testing.assert_array_equal(chosen, moves(OWN, 1, pair, DISC, 1.5))
    assert (moves(OWN, 3, (position, velocity, towards), DISC, 1.5, lone=True) == 0).all()
