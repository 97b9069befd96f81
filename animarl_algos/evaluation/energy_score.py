"""Energy score of rollouts against the recording that they started from.

Gneiting and Raftery (2007, J. Am. Stat. Assoc. 102, 359): for forecasts X, X' drawn independently
and what came true, y, the score is E|X - y| - E|X - X'| / 2, smallest on average for the
distribution that y is drawn from. For numbers it is the continuous ranked probability score.
The first term alone, the mean error, is smallest for a simulator that always returns the median;
the second one gives back what an honest spread costs.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from animarl_algos.evaluation.statistics import Cells
from animarl_envs.errors import InputError

Floats = NDArray[np.float64]

FEW_ROLLOUTS = "fewer than two rollouts a start"


def energy_score(simulated: ArrayLike, recorded: ArrayLike) -> float:
    """The unbiased estimate for one start.

    Parameters
    ----------
    simulated
        ``(rollouts,)`` or ``(rollouts, d)``; ``d`` numbers are compared by Euclidean distance.
    recorded
        One number, or ``(d,)``.

    Returns
    -------
    In the values' unit. Unbiased, so a single one may be negative; NaN for fewer than two rollouts,
    which do not show a spread.

    Raises
    ------
    InputError
        If the shapes do not fit.
    """
    drawn, true = np.asarray(simulated, np.float64), np.asarray(recorded, np.float64)
    if drawn.ndim not in (1, 2) or drawn.shape[1:] != true.shape:
        raise InputError(
            f"simulated values have shape {drawn.shape} and the recorded one {true.shape}: "
            "give (rollouts,) and a number, or (rollouts, d) and (d,)"
        )
    drawn, true = drawn.reshape(len(drawn), -1), true.reshape(-1)
    number = len(drawn)
    if number < 2:
        return float("nan")
    error = np.linalg.norm(drawn - true, axis=1).mean()
    apart = np.linalg.norm(drawn[:, None] - drawn[None], axis=2).sum()
    return float(error - apart / (2 * number * (number - 1)))


def energy_scores(simulated: ArrayLike, demo: ArrayLike, recorded: ArrayLike) -> Floats:
    """The score at every start, ``(starts,)``.

    Parameters
    ----------
    simulated, demo
        ``(rollouts,)`` or ``(rollouts, d)``, and the start of each, counted in ``recorded``.
    recorded
        ``(starts,)`` or ``(starts, d)``.
    """
    drawn, start = np.asarray(simulated, np.float64), np.asarray(demo)
    true = np.asarray(recorded, np.float64)
    if len(drawn) != len(start) or (len(start) and start.max() >= len(true)):
        raise InputError(
            f"{len(drawn)} rollouts with {len(start)} starts do not fit {len(true)} recordings"
        )
    return np.array([energy_score(drawn[start == i], true[i]) for i in range(len(true))])


def energy_cells(
    simulated: ArrayLike, seed: ArrayLike, demo: ArrayLike, recorded: ArrayLike
) -> Cells:
    """The score of every training seed at every start, of numbers.

    Parameters
    ----------
    simulated, seed, demo
        ``(rollouts,)``: the value, the training seed and the start of each; NaN does not count.
    recorded
        ``(starts,)``, NaN where there is none.

    Returns
    -------
    Cells that hold one score where there are two rollouts of a seed at least, else none.
    """
    drawn, true = np.asarray(simulated, np.float64), np.asarray(recorded, np.float64)
    seeds, row = np.unique(np.asarray(seed), return_inverse=True)
    shape = (len(seeds), len(true))
    counted = np.isfinite(drawn)
    values, place = drawn[counted], (row.ravel() * len(true) + np.asarray(demo))[counted]
    order = np.lexsort((values, place))
    values, place = values[order], place[order]
    number = np.bincount(place, minlength=shape[0] * shape[1])
    rank = np.arange(len(place)) - (np.cumsum(number) - number)[place]
    # Of sorted values, the sum over pairs of their distances.
    apart = np.bincount(place, values * (2 * rank - number[place] + 1), minlength=len(number))
    error = np.bincount(place, np.abs(values - true[place % len(true)]), minlength=len(number))
    with np.errstate(invalid="ignore", divide="ignore"):
        score = (error / number - apart / (number * (number - 1))).reshape(shape)
    present = np.isfinite(score) & (number.reshape(shape) > 1)
    return Cells(np.where(present, score, 0.0), present.astype(np.float64))


def pooled_score(recorded: ArrayLike) -> float:
    """What the recordings of the *other* starts would score, drawn as if they were rollouts.

    A simulator of the right distribution that does not know its start scores this on average; one
    that knows it scores less.
    """
    true = np.asarray(recorded, np.float64)
    number = len(true)
    if number < 3:
        return float("nan")
    return float(np.mean([energy_score(np.delete(true, i, 0), true[i]) for i in range(number)]))
