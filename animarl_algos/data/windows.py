"""Drawing pieces of recorded episodes independently of each other, every step as likely."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from animarl_algos.replay.rings import Sequences


class WindowDraws:
    """Windows of a given number of steps, of episodes that lie end to end.

    A window may hang over either end of its episode and is cut there, so that the first and the
    last steps are drawn as often as those between them.

    Parameters
    ----------
    first, steps
        ``(episodes,)``, row of each episode's first frame, and its steps.
    masked
        ``(episodes,)``, leading steps that enter no loss; every window holds a later one.
    terminated, condition
        ``(episodes,)``.
    """

    def __init__(
        self,
        first: NDArray[np.int64],
        steps: NDArray[np.int64],
        masked: NDArray[np.int64],
        terminated: NDArray[np.bool_],
        condition: NDArray[np.float32],
    ) -> None:
        self._first, self._steps, self._masked = first, steps, masked
        self._terminated, self._condition = terminated, condition

    def draw(
        self, generator: np.random.Generator, count: int, length: int, burn_in: int
    ) -> tuple[NDArray[np.int64], Sequences]:
        """``count`` windows of ``length`` steps, with up to ``burn_in`` steps before each.

        Returns
        -------
        episodes : ndarray (count,)
            Where each window lies.
        windows : Sequences
            In decreasing length.
        """
        places = np.where(self._steps > self._masked, self._steps - self._masked + length - 1, 0)
        ends = np.cumsum(places)
        drawn = generator.integers(ends[-1], size=count)
        episode = np.searchsorted(ends, drawn, side="right")
        begin = drawn - (ends - places)[episode] + self._masked[episode] - (length - 1)
        end = np.minimum(begin + length, self._steps[episode])
        begin = np.maximum(begin, 0)
        order = np.argsort(begin - end, kind="stable")
        episode, begin, end = episode[order], begin[order], end[order]
        prefix = np.minimum(burn_in, begin)
        return episode, Sequences(
            first=self._first[episode] + begin - prefix,
            prefix=prefix,
            trained=end - begin,
            at_start=begin == prefix,
            terminated=self._terminated[episode] & (end == self._steps[episode]),
            condition=self._condition[episode],
            frames=np.zeros(count, dtype=np.int64),
            initial_state=np.zeros((count, 1, 0), dtype=np.float32),
        )
