"""The distance of contact, where nobody states it but recordings end by it.

Some are stopped, by hand or by the program, as soon as the target is reached. Then there is a
distance within which nearly nobody comes before the last frame, and within which most recordings
end. Chance leaves no such distance: the last frame of a recording is the nearest one rarely.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

FEWEST = 5  # recordings that say something
MOST_END = 0.5  # at least this share of recordings ends within the distance
AT_LAST = 0.95  # at least this share of those that come within it do so in their last frame
SLACK = 1e-6  # relative, beyond the farthest contact


def found_contact(nearest: Sequence[NDArray[np.float64]]) -> float | None:
    """The largest distance that ends recordings.

    Parameters
    ----------
    nearest
        Of each recording ``(frames,)``, how far the nearest pursuer is from the target.

    Returns
    -------
    The distance, a trifle beyond the farthest contact; ``None`` where there is none.
    """
    known = [one for one in nearest if len(one) > 1 and np.isfinite(one).all()]
    if len(known) < FEWEST:
        return None
    last = np.array([one[-1] for one in known])
    before = np.array([one[:-1].min() for one in known])  # until the last frame
    for limit in sorted(set(last.tolist()), reverse=True):
        ends, came = last <= limit, before <= limit
        if ends.mean() < MOST_END:
            return None
        if (ends & ~came).sum() >= AT_LAST * (ends | came).sum():
            return float(limit) * (1 + SLACK)
    return None
