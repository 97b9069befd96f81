"""Dynamic time warping by its definition, cell by cell, and what closeness by it is worth."""

import numpy as np
from numpy.typing import NDArray

Path = NDArray[np.float64]


def textbook(x: Path, y: Path, window: float = np.inf) -> NDArray[np.float64]:
    """The whole matrix W ``(len(x), len(y))``, open at the end, of two paths ``(., 2)``.

    Cells farther than ``window`` from the diagonal are infinite.
    """
    apart = np.abs(np.arange(len(x))[:, None] - np.arange(len(y))[None])
    distance = np.linalg.norm(x[:, None] - y[None], axis=-1)
    cost = np.where(apart <= window, distance, np.inf).tolist()
    total = [[0.0] + [np.inf] * len(y)]  # lists: cell by cell, arrays are slow
    for t in range(len(x)):
        row = [np.inf]
        for j in range(len(y)):
            row.append(cost[t][j] + min(total[t][j + 1], row[j], total[t][j]))
        total.append(row)
    return np.array(total)[1:, 1:]


def closeness(x: Path, y: Path, window: int, scale: float) -> NDArray[np.float64]:
    """What each step of ``x`` is paid, ``(len(x) - 1,)``: nothing once ``y`` is over."""
    minimum = textbook(x[: len(y)], y, window).min(axis=1)
    paid = np.zeros(len(x) - 1)
    paid[: len(minimum) - 1] = np.exp(-np.diff(minimum) / scale)
    return paid
