"""The onset fit: u from speeds just after rest, d from their ratio to the top speed.

Paper, "Locomotion parameter estimation". With eps = th_acc dt, onsets are the steps at which the
speed crosses eps from below; |v|_on is the median speed just after them and |v|_max the median of
the speeds above their 99th percentile; then u = |v|_on / dt and d = |v|_on / |v|_max.

Only speeds made from two recorded frames count: a start from rest that is known but was not
measured (the stored initial velocity) is no onset.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.errors import InputError
from animarl_envs.locomotion import Locomotion

TOP_QUANTILE = 0.99


class OnsetData(NamedTuple):
    """Speeds of one individual in ascending order, with the episode each belongs to.

    ``speed`` are all of them [arena unit / s], ``onset_speed`` those just after an onset.
    """

    speed: NDArray[np.float64]
    episode: NDArray[np.int64]
    onset_speed: NDArray[np.float64]
    onset_episode: NDArray[np.int64]
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
    """Damping and thrust of one individual by the paper's rule.

    Raises
    ------
    InputError
        If there is no onset, or the individual is faster at onsets than at its top speed.
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
    """|v|_max: median of the speeds above their 99th percentile [arena unit / s]."""
    return _top_median(onset_data(demos, individual, onset_threshold=0.0).speed)


def bootstrap_onset(data: OnsetData, weights: NDArray[np.float64]) -> NDArray[np.float64]:
    """Refit every resample: ``(resamples, 2)`` of d and u; NaN where a resample has no onset.

    ``weights`` ``(resamples, episodes)`` says how often each episode was drawn.
    """
    found = np.full((len(weights), 2), np.nan)
    for b, drawn in enumerate(weights.astype(np.int64)):
        onsets = np.repeat(data.onset_speed, drawn[data.onset_episode])
        if len(onsets):
            onset = float(np.median(onsets))
            top = _top_median(np.repeat(data.speed, drawn[data.episode]))
            found[b] = onset / top, onset / data.dt
    return found


def _top_median(speed: NDArray[np.float64]) -> float:
    """Median of the ascending speeds above their quantile; the top one where these are equal."""
    if len(speed) == 0:
        return 0.0
    position = TOP_QUANTILE * (len(speed) - 1)
    rank = int(position)
    above = speed[min(rank + 1, len(speed) - 1)]
    threshold = speed[rank] + (position - rank) * (above - speed[rank])
    beyond = speed[np.searchsorted(speed, threshold, side="right") :]
    return float(np.median(beyond) if len(beyond) else speed[-1])
