"""One-step transitions of recorded individuals, the actions behind them, and the velocity RMSE."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.errors import InputError
from animarl_envs.locomotion import Locomotion, apply_actions, infer_actions


@dataclass(frozen=True)
class Transitions:
    """All one-step transitions of one individual.

    ``velocity`` and ``next_velocity`` are ``(steps, 2)`` in the arena frame [arena unit / s], each
    belonging to the position that it led to; ``focus`` ``(steps, 2)`` holds unit vectors towards
    the focus before the step; ``episode`` ``(steps,)`` counts from 0 to ``num_episodes - 1`` and
    never decreases.
    """

    velocity: NDArray[np.float64]
    next_velocity: NDArray[np.float64]
    focus: NDArray[np.float64]
    episode: NDArray[np.int64]
    num_episodes: int
    dt: float

    def __len__(self) -> int:
        return len(self.velocity)


def transitions(demos: Demonstrations, individual: int) -> Transitions:
    """The transitions of ``individual`` (an index), episodes end to end.

    Last steps that are shorter than the others are left out. Animals of a group that are alike
    have one locomotion, so these are the transitions of them all.
    """
    steps, episode = step_frames(demos), np.repeat(np.arange(demos.num_episodes), demos.lengths - 1)
    whole = demos.intervals()[steps + 1] > 0.999 * demos.dt
    steps, episode = steps[whole], episode[whole]
    who = slice(None) if demos.is_group else slice(individual, individual + 1)
    velocity, focus = demos.velocities()[:, who], demos.focus()[:, who]
    return Transitions(
        velocity=velocity[steps].reshape(-1, 2),
        next_velocity=velocity[steps + 1].reshape(-1, 2),
        focus=focus[steps].reshape(-1, 2),
        episode=np.repeat(episode, velocity.shape[1]),
        num_episodes=demos.num_episodes,
        dt=demos.dt,
    )


def step_frames(demos: Demonstrations) -> NDArray[np.int64]:
    """Frames at which a decision was taken: all but the last of each episode."""
    last = np.zeros(len(demos.positions), dtype=bool)
    last[demos.offsets[1:] - 1] = True
    return np.flatnonzero(~last)


def demonstrated_actions(
    demos: Demonstrations, locomotion: Sequence[Locomotion]
) -> NDArray[np.int8]:
    """Actions inferred from the tracks by inverse dynamics.

    Parameters
    ----------
    demos
        Recorded episodes of K individuals.
    locomotion
        Fitted parameters, one per individual.

    Returns
    -------
    ``(frames, K)`` int8: the action that led from each frame to the next, -1 at last frames.
    """
    if len(locomotion) != demos.num_individuals:
        raise InputError(
            f"{demos.name}: {len(locomotion)} sets of locomotion parameters for "
            f"{demos.num_individuals} individuals: give one each"
        )
    steps, velocity, focus = step_frames(demos), demos.velocities(), demos.focus()
    actions = np.full(velocity.shape[:2], -1, dtype=np.int8)
    for i, own in enumerate(locomotion):
        actions[steps, i] = infer_actions(
            velocity[steps, i], velocity[steps + 1, i], focus[steps, i], own, demos.dt
        )
    return actions


def velocity_rmse(demos: Demonstrations, individual: int, locomotion: Locomotion) -> float:
    """Velocity RMSE of the paper's Table 1, for one individual [arena unit / s].

    The velocity rebuilt from the nearest of the actions is compared with the next observed one;
    the error is the Euclidean length of their difference, and its root mean square over all steps
    is returned.
    """
    data = transitions(demos, individual)
    actions = infer_actions(data.velocity, data.next_velocity, data.focus, locomotion, data.dt)
    rebuilt = apply_actions(data.velocity, actions, data.focus, locomotion, data.dt)
    return float(np.sqrt(np.mean(np.sum((rebuilt - data.next_velocity) ** 2, axis=1))))
