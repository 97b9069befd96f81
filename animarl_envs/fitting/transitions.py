"""One-step transitions of recorded individuals, the actions behind them, and the fit from onsets.

The onset fit (paper, "Locomotion parameter estimation"): with eps = th_acc dt, onsets are the steps
at which the speed crosses eps from below; |v|_on is the median speed just after them and |v|_max
the median of the speeds above their 99th percentile; then u = |v|_on / dt and d = |v|_on / |v|_max.

Only speeds made from two recorded frames count: a start from rest that is known but was not
measured (the stored initial velocity) is no onset.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from animarl_envs.array_types import Floats, Ints
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.errors import InputError
from animarl_envs.focus import focus_directions
from animarl_envs.locomotion import Locomotion, apply_actions, infer_actions


@dataclass(frozen=True)
class Transitions:
    """All one-step transitions of one individual.

    ``velocity`` and ``next_velocity`` are ``(steps, 2)`` in the arena frame [arena unit / s], each
    belonging to the position that it led to; ``focus`` ``(steps, 2)`` holds unit vectors towards
    the focus before the step; ``episode`` ``(steps,)`` counts from 0 to ``num_episodes - 1`` and
    never decreases.
    """

    velocity: Floats
    next_velocity: Floats
    focus: Floats
    episode: Ints
    num_episodes: int
    dt: float

    def __len__(self) -> int:
        """Return the number of steps."""
        return len(self.velocity)


def transitions(demos: Demonstrations, individual: int) -> Transitions:
    """Return the transitions of ``individual`` (an index), episodes end to end.

    Last steps that are shorter than the others are left out. Animals of a group that are alike
    have one locomotion, so these are the transitions of them all.
    """
    steps = whole_steps(demos)
    episode = np.searchsorted(demos.offsets, steps, side="right") - 1
    columns = slice(None) if demos.is_group else slice(individual, individual + 1)
    velocity, focus = demos.velocities()[:, columns], demos.focus()[:, columns]
    return Transitions(
        velocity=velocity[steps].reshape(-1, 2),
        next_velocity=velocity[steps + 1].reshape(-1, 2),
        focus=focus[steps].reshape(-1, 2),
        episode=np.repeat(episode, velocity.shape[1]),
        num_episodes=demos.num_episodes,
        dt=demos.dt,
    )


def step_frames(demos: Demonstrations) -> Ints:
    """Return the frames at which a decision was taken: all but the last of each episode."""
    last = np.zeros(len(demos.positions), dtype=bool)
    last[demos.offsets[1:] - 1] = True
    return np.flatnonzero(~last)


def whole_steps(demos: Demonstrations) -> Ints:
    """Return those of :func:`step_frames` whose step is not shorter than the others."""
    steps = step_frames(demos)
    return steps[demos.intervals()[steps + 1] > 0.999 * demos.dt]


def demonstrated_actions(
    demos: Demonstrations, locomotion: Sequence[Locomotion]
) -> NDArray[np.int8]:
    """Infer the actions of K individuals by inverse dynamics, with the ``locomotion`` of each.

    Returns ``(frames, K)`` int8: the action that led from each frame to the next, -1 at last
    frames.
    """
    if len(locomotion) != demos.num_individuals:
        raise InputError(
            f"{demos.name}: {len(locomotion)} sets of locomotion parameters for "
            f"{demos.num_individuals} individuals: give one each"
        )
    steps, velocity = step_frames(demos), demos.velocities()
    focus = action_frames(demos, locomotion[0].course_time)
    actions = np.full(velocity.shape[:2], -1, dtype=np.int8)
    for i, own in enumerate(locomotion):
        actions[steps, i] = infer_actions(
            velocity[steps, i], velocity[steps + 1, i], focus[steps, i], own, demos.dt
        )
    return actions


def action_frames(
    demos: Demonstrations,
    course_time: float | None,
    positions: Floats | None = None,
    velocities: Floats | None = None,
) -> Floats:
    """Return the x axes of the frames of actions, ``(frames, K, 2)`` unit vectors.

    Those towards the focus or, with a ``course_time`` [s], along the course of each. ``positions``
    and ``velocities`` are by default the recorded ones.
    """
    positions = demos.positions if positions is None else positions
    velocities = demos.velocities() if velocities is None else velocities
    if course_time is None:
        return focus_directions(positions, demos.roles, velocities, demos.steps(), demos.dt)
    everyone = ("pursuer",) * demos.num_individuals  # without a target each has its course
    return focus_directions(positions, everyone, velocities, demos.steps(), demos.dt, course_time)


def velocity_rmse(demos: Demonstrations, individual: int, locomotion: Locomotion) -> float:
    """Return the velocity RMSE of the paper's Table 1 of one individual [arena unit / s].

    The velocity rebuilt from the nearest of the actions is compared with the next observed one;
    the error is the Euclidean length of their difference, and its root mean square over all steps
    is returned.
    """
    data = transitions(demos, individual)
    actions = infer_actions(data.velocity, data.next_velocity, data.focus, locomotion, data.dt)
    rebuilt = apply_actions(data.velocity, actions, data.focus, locomotion, data.dt)
    return float(np.sqrt(np.mean(np.sum((rebuilt - data.next_velocity) ** 2, axis=1))))


TOP_QUANTILE = 0.99


class OnsetData(NamedTuple):
    """Speeds of one individual in ascending order, with the episode each belongs to.

    ``speed`` are all of them [arena unit / s], ``onset_speed`` those just after an onset.
    """

    speed: Floats
    episode: Ints
    onset_speed: Floats
    onset_episode: Ints
    num_episodes: int
    dt: float


def onset_data(demos: Demonstrations, individual: int, onset_threshold: float) -> OnsetData:
    """Collect speeds and onsets of ``individual``; ``onset_threshold`` is th_acc [unit / s^2]."""
    threshold = onset_threshold * demos.dt
    step = np.diff(demos.positions[:, individual], axis=0) / demos.dt
    speed = np.hypot(step[:, 0], step[:, 1])
    within = np.ones(len(speed), dtype=bool)  # both frames in one episode
    within[demos.offsets[1:-1] - 1] = False
    rises = (speed[:-1] < threshold) & (speed[1:] >= threshold) & within[:-1] & within[1:]
    onset = np.flatnonzero(rises) + 1
    episode = np.searchsorted(demos.offsets, np.arange(len(speed)), side="right") - 1
    kept = np.flatnonzero(within)
    order = kept[np.argsort(speed[kept], kind="stable")]
    onset = onset[np.argsort(speed[onset], kind="stable")]
    return OnsetData(
        speed[order], episode[order], speed[onset], episode[onset], demos.num_episodes, demos.dt
    )


def fit_onset(demos: Demonstrations, individual: int, onset_threshold: float) -> Locomotion:
    """Fit damping and thrust of one individual by the paper's rule.

    Raises InputError if there is no onset, or the individual is faster at onsets than at its top
    speed.
    """
    data = onset_data(demos, individual, onset_threshold)
    name = demos.individuals[individual]
    if len(data.onset_speed) == 0:
        threshold = onset_threshold * demos.dt
        fix = "lower" if data.speed.max(initial=0.0) < threshold else "raise"
        raise InputError(
            f"{demos.name}: {name} never crosses {threshold:.3g} from below, so "
            f"the onset fit has nothing to measure: {fix} onset_threshold or use method 'joint'"
        )
    damping, thrust = bootstrap_onset(data, np.ones((1, data.num_episodes)))[0]
    if not 0.0 <= damping <= 1.0:
        raise InputError(
            f"{demos.name}: {name} is faster just after rest than at its top speed (d = "
            f"{damping:.3g}), so the onset fit does not apply: use method 'joint'"
        )
    return Locomotion(float(damping), float(thrust))


def top_speed(demos: Demonstrations, individual: int) -> float:
    """Return |v|_max, the median of the speeds above their 99th percentile [arena unit / s]."""
    return _top_median(onset_data(demos, individual, onset_threshold=0.0).speed)


def bootstrap_onset(data: OnsetData, weights: Floats) -> Floats:
    """Refit every resample: ``(resamples, 2)`` of d and u; NaN where a resample has no onset.

    ``weights`` ``(resamples, episodes)`` says how often each episode was drawn.
    """
    refits = np.full((len(weights), 2), np.nan)
    for b, drawn in enumerate(weights.astype(np.int64)):
        onsets = np.repeat(data.onset_speed, drawn[data.onset_episode])
        if len(onsets):
            onset = float(np.median(onsets))
            top = _top_median(np.repeat(data.speed, drawn[data.episode]))
            refits[b] = onset / top, onset / data.dt
    return refits


def _top_median(speed: Floats) -> float:
    """Return the median of ascending speeds above their quantile; the top one if all are equal."""
    if len(speed) == 0:
        return 0.0
    position = TOP_QUANTILE * (len(speed) - 1)
    rank = int(position)
    above = speed[min(rank + 1, len(speed) - 1)]
    threshold = speed[rank] + (position - rank) * (above - speed[rank])
    beyond = speed[np.searchsorted(speed, threshold, side="right") :]
    return float(np.median(beyond) if len(beyond) else speed[-1])
