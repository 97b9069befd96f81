"""Dynamic time warping by its definition, cell by cell."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Path = NDArray[np.float64]


def textbook(x: Path, y: Path) -> NDArray[np.float64]:
    """The whole matrix W ``(len(x), len(y))``, open at the end, of two paths ``(., 2)``."""
    cost = np.linalg.norm(x[:, None] - y[None], axis=-1).tolist()
    total = [[0.0] + [np.inf] * len(y)]  # lists: cell by cell, arrays are slow
    for t in range(len(x)):
        row = [np.inf]
        for j in range(len(y)):
            row.append(cost[t][j] + min(total[t][j + 1], row[j], total[t][j]))
        total.append(row)
    return np.array(total)[1:, 1:]
