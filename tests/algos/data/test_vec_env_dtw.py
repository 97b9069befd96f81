"""Penalties and labels that the slots hand out, against a textbook DTW of whole rollouts."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from textbook_dtw import closeness, textbook

from animarl_algos.data.vec_env import SlotVecEnv
from animarl_envs.dtw import WINDOW
from animarl_envs.fitting.transitions import demonstrated_actions


@dataclass
class Rollout:
    """An episode of one copy: positions ``(K, 2)`` of each frame, and what came with each step."""

    demo: int
    positions: list[NDArray[np.float64]]
    penalties: list[NDArray[np.float32]] = field(default_factory=list)
    labels: list[NDArray[np.int64]] = field(default_factory=list)
    elapsed: list[NDArray[np.float64]] = field(default_factory=list)


class Paths:
    """Follows a world as a DTW tracker does, and keeps where everyone went."""

    def __init__(self, num_copies: int) -> None:
        self.running: list[Rollout | None] = [None] * num_copies

    def started(self, world: Any, mask: NDArray[np.bool_]) -> None:
        for b in np.flatnonzero(mask):
            self.running[b] = Rollout(int(world.demo[b]), [world.position[b].copy()])

    def stepped(self, world: Any) -> None:
        for b, rollout in enumerate(self.running):
            assert rollout is not None
            rollout.positions.append(world.position[b].copy())
            if "elapsed" in world.reward_components:
                lasting = world.reward_components.index("elapsed")
                rollout.elapsed.append(world.components[b, :, lasting].copy())


def random_rollouts(env: SlotVecEnv, steps: int) -> list[Rollout]:
    """Episodes that ended while ``steps`` random actions were taken in every slot."""
    paths, ended = Paths(env.num_copies), []
    env.world.trackers.append(paths)
    env.seed(4)
    env.reset()
    rng = np.random.default_rng(0)
    for _ in range(steps):
        acting = list(paths.running)
        _, _, dones, _ = env.step(rng.integers(13, size=env.num_envs))
        pair = (env.num_copies, len(env.individuals))
        penalties, labels = (env.extras[n].reshape(pair) for n in ("dtw_penalty", "aligned_action"))
        for b, rollout in enumerate(acting):
            rollout.penalties.append(penalties[b])
            rollout.labels.append(labels[b])
            if dones.reshape(pair)[b, 0]:
                ended.append(rollout)
    return ended


@pytest.mark.parametrize(
    ("species", "options", "steps", "least"),
    [
        ("agent", {}, 300, 30),
        ("agent", {"dtw": "increment"}, 300, 30),
        ("agent", {"dtw": "cumulative"}, 100, 10),
        ("agent", {"focal": "prey"}, 150, 15),
        ("fly", {"rebound": False}, 150, 20),
        ("silkmoth", {"condition_flag": True}, 610, 6),
    ],
)
def test_penalties_and_labels_equal_the_textbook(
    species: str, options: dict[str, Any], steps: int, least: int
) -> None:
    env = SlotVecEnv(species, 6, **options)
    demos = env.scenario.demos
    assert demos is not None
    everyone = env.scenario.names
    actions = demonstrated_actions(demos, env.scenario.species.locomotion)
    rollouts = random_rollouts(env, steps)
    assert len(rollouts) >= least
    for rollout in rollouts:
        frames = slice(*demos.offsets[rollout.demo : rollout.demo + 2])
        for s, name in enumerate(env.individuals):
            k = everyone.index(name)
            path = np.array(rollout.positions)[:, k]
            rows = textbook(path, demos.positions[frames, k])
            minimum = rows.min(axis=1)
            kind = options.get("dtw", "closeness")
            if kind == "closeness":
                scale = env.scenario.species.contact_radius
                expected = -closeness(path, demos.positions[frames, k], WINDOW, scale)
                beyond = len(demos.positions[frames]) - 1
                if rollout.elapsed:
                    expected[beyond:] = np.array(rollout.elapsed)[beyond:, k]
            else:
                expected = minimum[1:] if kind == "cumulative" else np.diff(minimum)
            np.testing.assert_allclose(
                np.array(rollout.penalties)[:, s],
                expected,
                atol=1e-4 if kind == "cumulative" else 1e-5,
            )
            aligned = actions[frames, k][rows[:-1].argmin(axis=1)]
            np.testing.assert_array_equal(np.array(rollout.labels)[:, s], aligned)
