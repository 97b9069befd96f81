"""Walks made by species of several thrust magnitudes: the actions behind them are known."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from recordings import episodes_along

from animarl_envs.arena import Arena
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.splits import assign_splits
from animarl_envs.focus import focus_directions
from animarl_envs.locomotion import Locomotion, apply_actions
from animarl_envs.species import Species

MULTIPLES = (1.75, 1.0, 0.5)
DT = 0.1
ROLES = ("pursuer", "pursuer", "target")


def three(species: Species) -> Species:
    """The species with three magnitudes."""
    return replace(
        species, locomotion=tuple(replace(m, magnitudes=MULTIPLES) for m in species.locomotion)
    )


def walk(
    truth: tuple[Locomotion, ...],
    seed: int,
    *,
    episodes: int = 40,
    steps: int = 50,
    noise: float = 0.0,
    jumps: float = 0.0,
) -> tuple[Demonstrations, NDArray[np.int64]]:
    """Sticky random actions of three individuals in the open, and the actions.

    ``noise`` and a share of ``jumps`` are errors of the tracking.
    """
    rng = np.random.default_rng(seed)
    count = truth[0].num_actions
    position = rng.uniform(-0.5, 0.5, (episodes, 3, 2))
    velocity = np.zeros((episodes, 3, 2))
    action = rng.integers(count, size=(episodes, 3))
    path, taken = [position], []
    for _ in range(steps):
        action = np.where(
            rng.random(action.shape) < 0.3, rng.integers(count, size=action.shape), action
        )
        focus = focus_directions(position, ROLES)
        velocity = np.stack(
            [
                apply_actions(velocity[:, i], action[:, i], focus[:, i], own, DT)
                for i, own in enumerate(truth)
            ],
            axis=1,
        )
        position = position + velocity * DT
        path.append(position)
        taken.append(action)
    frames = np.stack(path, axis=1).reshape(-1, 3, 2)
    frames = frames + noise * rng.standard_normal(frames.shape)
    jumping = rng.random(frames.shape[:2]) < jumps
    frames[jumping] += rng.uniform(-0.5, 0.5, (int(jumping.sum()), 2))
    actions = np.stack([*taken, np.full((episodes, 3), -1)], axis=1).reshape(-1, 3)
    recording = np.array([f"r{i:03d}" for i in range(episodes)])
    split = {"recording": recording, "split": assign_splits(recording, 0)}
    paths = np.split(frames, episodes)
    names = ("a", "b", "c")
    demos = episodes_along(paths, species="custom", individuals=names, arena=Arena("open"), **split)
    return demos, actions


TRUTH = tuple(Locomotion(d, u, (1.6, 0.9, 0.4)) for d, u in ((0.2, 2.0), (0.25, 2.4), (0.3, 3.0)))
