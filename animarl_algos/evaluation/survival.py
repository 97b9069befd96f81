"""Durations of which some are only known to be at least so long.

A recording that merely ends says that the animals went on for at least as long. Durations are then
compared as survival: by the log-rank scores of Mantel (1966) and Peto and Peto (1972), and told as
the mean time up to the longest one that both sides know (the area under the survival curve).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]


def log_rank_scores(duration: ArrayLike, ended: ArrayLike) -> Floats:
    """Return what each episode adds to the log-rank statistic, ``(episodes,)``.

    It is whether the episode ended, less the cumulative hazard (Nelson and Aalen) of all episodes
    up to its end: zero on average on both sides if both end at the same rate. The higher, the
    earlier an episode ended.

    Parameters
    ----------
    duration, ended
        ``(episodes,)`` of both sides; ``ended`` is false where the film merely stopped.
    """
    duration, ended = np.asarray(duration, np.float64), np.asarray(ended, bool)
    times, place = np.unique(duration, return_inverse=True)
    here = np.bincount(place, minlength=len(times))
    events = np.bincount(place, ended, minlength=len(times))
    at_risk = here[::-1].cumsum()[::-1]
    return np.asarray(ended - np.cumsum(events / at_risk)[place])


def mean_survival(duration: ArrayLike, ended: ArrayLike, limit: float) -> float:
    """Return the mean duration up to ``limit``, the area under the Kaplan-Meier curve."""
    from scipy.stats import CensoredData, ecdf

    duration, ended = np.asarray(duration, np.float64), np.asarray(ended, bool)
    if not ended.any():
        return limit
    curve = ecdf(CensoredData(uncensored=duration[ended], right=duration[~ended])).sf
    times = np.concatenate([[0.0], np.minimum(curve.quantiles, limit), [limit]])
    levels = np.concatenate([[1.0], curve.probabilities])
    return float((np.diff(times) * levels).sum())
