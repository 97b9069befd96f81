"""The penalty of every action in every recorded state."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.errors import InputError
from animarl_envs.locomotion import Locomotion, apply_actions


def dynamics_scored_penalties(
    demos: Demonstrations,
    velocities: NDArray[np.floating],
    locomotion: Sequence[Locomotion],
    focus: NDArray[np.floating],
    dt: float,
) -> NDArray[np.float32]:
    """How far each action would have led from where the animal went next.

    The fitted dynamics predicts the next position for all 12 M + 1 actions from each demonstrated
    state, ``p + v' dt`` with ``v' = (1 - d) v + u a dt``; the penalty is the Euclidean distance to
    the next demonstrated position. The smallest is that of the action that inverse dynamics infers,
    for both compare the same vectors, here times dt^2.

    Parameters
    ----------
    demos
        The demonstrations.
    velocities
        ``(frames, K, 2)``, arena frame [arena unit / s].
    locomotion
        Parameters of each of the K individuals.
    focus
        ``(frames, K, 2)``, unit vectors towards the focus at each frame, arena frame.
    dt
        Time between frames [s].

    Returns
    -------
    ``(frames, K, 12 M + 1)`` float32 [arena unit]; zero at each episode's last frame.
    """
    positions = demos.positions
    if not velocities.shape == focus.shape == positions.shape or len(locomotion) != len(
        demos.individuals
    ):
        raise InputError(
            f"{demos.name}: positions {positions.shape}, velocities {velocities.shape}, focus "
            f"{focus.shape} and {len(locomotion)} locomotion models do not belong together: "
            "make them from the same demonstrations"
        )
    following = np.concatenate([positions[1:], positions[-1:]])
    num_actions = locomotion[0].num_actions
    penalties = np.empty((*positions.shape[:2], num_actions), dtype=np.float32)
    for k, fitted in enumerate(locomotion):
        for action in range(num_actions):
            velocity = apply_actions(
                velocities[:, k], np.full(len(positions), action), focus[:, k], fitted, dt
            )
            error = positions[:, k] + velocity * dt - following[:, k]
            penalties[:, k, action] = np.hypot(error[:, 0], error[:, 1])
    penalties[demos.offsets[1:] - 1] = 0.0
    return penalties
