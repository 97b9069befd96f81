"""Intervals of fits by resampling whole episodes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from animarl_envs.errors import InputError

Interval = tuple[float, float]
CONFIDENCE = 0.95


def resampling_weights(episodes: int, resamples: int, seed: int) -> NDArray[np.float64] | None:
    """How often each resample draws each episode, ``(resamples, episodes)``."""
    if resamples < 0:
        raise InputError(f"bootstrap is {resamples}: it must be 0 or a number of resamples")
    if resamples == 0 or episodes < 2:
        return None
    drawn = np.random.default_rng(seed).integers(episodes, size=(resamples, episodes))
    flat = drawn + episodes * np.arange(resamples)[:, None]
    counts = np.bincount(flat.ravel(), minlength=resamples * episodes)
    return counts.reshape(resamples, episodes).astype(np.float64)


def percentiles(
    samples: NDArray[np.float64] | None,
) -> tuple[Interval | None, Interval | None]:
    """Of resampled damping and thrust, ``(resamples, 2)``."""
    if samples is None or not len(samples):
        return None, None
    tail = (1 - CONFIDENCE) / 2
    (d_low, u_low), (d_high, u_high) = np.quantile(samples, [tail, 1 - tail], axis=0).tolist()
    return (d_low, d_high), (u_low, u_high)
