"""The onset fit: u from speeds just after rest, d from their ratio to the top speed.

Paper, "Locomotion parameter estimation". With eps = th_acc dt, onsets are the steps at which the
speed crosses eps from below; |v|_on is the median speed just after them and |v|_max the median of
the speeds above their 99th percentile; then u = |v|_on / dt and d = |v|_on / |v|_max.

Only speeds made from two recorded frames count: a start from rest that is known but was not
measured (the stored initial velocity) is no onset.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from animarl_envs.compiling import jit
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.errors import InputError
from animarl_envs.locomotion import Locomotion

TOP_QUANTILE = 0.99


@dataclass(frozen=True)
class OnsetData:
    """Speeds of one individual, with the episode each belongs to.

    ``speed`` ``(n,)`` is in ascending order [arena unit / s]; ``onset_speed`` holds the speeds just
    after an onset, ascending as well.
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
    data = onset_data(demos, individual, onset_threshold=0.0)
    if len(data.speed) == 0:
        return 0.0
    top = np.empty(1)
    whole = np.ones((1, data.num_episodes), dtype=np.int64)
    _weighted_top_medians(data.speed, data.episode, whole, TOP_QUANTILE, top)
    return float(top[0])


def bootstrap_onset(data: OnsetData, weights: NDArray[np.float64]) -> NDArray[np.float64]:
    """Refit every resample: ``(resamples, 2)`` of d and u; NaN where a resample has no onset.

    ``weights`` ``(resamples, episodes)`` says how often each episode was drawn.
    """
    onset, top = np.empty(len(weights)), np.empty(len(weights))
    whole = weights.astype(np.int64)
    _weighted_medians(data.onset_speed, data.onset_episode, whole, onset)
    _weighted_top_medians(data.speed, data.episode, whole, TOP_QUANTILE, top)
    return np.column_stack([onset / top, onset / data.dt])


@jit
def _weighted_medians(value, episode, weights, out):  # type: ignore[no-untyped-def]
    """Median of ascending ``value`` with each entry repeated as often as its episode was drawn."""
    for b in range(weights.shape[0]):
        total = 0
        for i in range(value.shape[0]):
            total += weights[b, episode[i]]
        out[b] = np.nan if total == 0 else _repeated_median(value, episode, weights[b], 0, total)


@jit
def _repeated_median(value, episode, weight, first, total):  # type: ignore[no-untyped-def]
    """Median of ``value[first:]`` whose repeats add up to ``total``."""
    low, high = (total - 1) // 2, total // 2
    seen, lower = 0, np.nan
    for i in range(first, value.shape[0]):
        seen += weight[episode[i]]
        if np.isnan(lower) and seen > low:
            lower = value[i]
        if seen > high:
            return 0.5 * (lower + value[i])
    return np.nan


@jit
def _weighted_top_medians(value, episode, weights, quantile, out):  # type: ignore[no-untyped-def]
    """Median of the entries above the quantile (linear interpolation), per resample."""
    count = value.shape[0]
    for b in range(weights.shape[0]):
        total = 0
        for i in range(count):
            total += weights[b, episode[i]]
        if total == 0:
            out[b] = np.nan
            continue
        position = quantile * (total - 1)
        rank = int(position)
        above = total - 1 - rank  # repeats beyond that rank
        seen, upper, i = 0, value[count - 1], count - 1
        while i > 0:  # down to the entry that holds the rank
            weight = weights[b, episode[i]]
            if seen + weight > above:
                break
            if weight > 0:
                upper = value[i]
            seen += weight
            i -= 1
        if seen < above:
            upper = value[i]
        threshold = value[i] + (position - rank) * (upper - value[i])
        first, kept = count, 0
        while first > 0 and value[first - 1] > threshold:
            first -= 1
            kept += weights[b, episode[first]]
        if kept == 0:  # all of the top speeds are equal
            out[b] = value[count - 1]
        else:
            out[b] = _repeated_median(value, episode, weights[b], first, kept)
