"""Dynamic time warping, row by row: what a learner is paid for staying close to a recorded path.

    W(0, 0) = c(0, 0)
    W(t, j) = c(t, j) + min(W(t-1, j), W(t, j-1), W(t-1, j-1))

with the Euclidean distance between simulated position t and recorded position j as local cost c.
Row t needs row t - 1 only, so a step costs O(m) for a recording of m frames. The open end
``min_j W(t, j)`` is the reward's distance, its ``argmin`` the aligned recorded step; the closed end
``W(T, m)`` is the DTW distance of evaluation. (Vintsyuk 1968; Sakoe and Chiba 1978.)

What a step is charged, ``penalty``, is one of

``"closeness"``
    ``-exp(-c / scale)`` while the recording lasts, c the step's increase of ``min_j W(t, j)`` with
    j kept within :data:`WINDOW` frames of t (Sakoe and Chiba's band). Afterwards it is 0, and
    ``refund``, which no weight multiplies, takes back what the world pays for lasting.
``"increment"``
    The step's increase of ``min_j W(t, j)``.
``"cumulative"``
    ``min_j W(t, j)`` itself, the paper's equation.

The last two are never negative: ending an episode escapes what is to come, so they pay for ending
early. And with an open end and free warping, standing where the recording starts is free of charge
for ever. Closeness pays between 0 and 1 a step, so that no end ever pays; the band keeps up the
pace, and nothing is paid beyond the recording (``benchmarks/returns.py`` prints the returns).
"""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from animarl_envs.array_types import Bools, Floats, Ints
from animarl_envs.compiling import jit
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.errors import InputError

WINDOW = 2
"""Frames by which a rollout may lead or lag the recording and still be close to it."""


@jit
def _extend_row(row, begin, end, x, y, path, first):  # type: ignore[no-untyped-def]
    """Replace row t - 1 by row t for the simulated position (x, y); return its minimum and argmin.

    Only recorded frames from ``begin`` to before ``end`` count; both may rise by one a row.
    """
    lowest = math.inf
    aligned = begin
    diagonal = math.inf  # W(t-1, j-1)
    if begin > 0:
        diagonal = row[begin - 1]
        row[begin - 1] = math.inf
    left = math.inf  # W(t, j-1)
    for j in range(begin, end):
        dx = x - path[j, 0]
        dy = y - path[j, 1]
        above = math.inf if first else row[j]  # W(t-1, j)
        best = min(above, min(left, diagonal))
        if first and j == 0:
            best = 0.0
        left = math.sqrt(dx * dx + dy * dy) + best
        diagonal = above
        row[j] = left
        if left < lowest:
            lowest = left
            aligned = j
    return lowest, aligned


def dtw_distance(x: NDArray[np.floating], y: NDArray[np.floating]) -> float:
    """Return the closed-end DTW distance of two paths, ``(T, 2)`` and ``(m, 2)``."""
    return dtw_alignment(x, y)[0]


@jit
def _aligned(x, y):  # type: ignore[no-untyped-def]
    """Return the closed-end distance and the pairs on its path, diagonal where steps tie."""
    total = np.empty(len(y))
    pairs = np.empty(len(y), dtype=np.int64)
    for t in range(len(x)):
        diagonal, steps = math.inf, 0  # of W(t-1, j-1)
        for j in range(len(y)):
            dx, dy = x[t, 0] - y[j, 0], x[t, 1] - y[j, 1]
            above = math.inf if t == 0 else total[j]
            before = 0 if t == 0 else pairs[j]
            best, count = diagonal, steps
            if above < best:
                best, count = above, before
            if j > 0 and total[j - 1] < best:
                best, count = total[j - 1], pairs[j - 1]
            if t == 0 and j == 0:
                best, count = 0.0, 0
            diagonal, steps = above, before
            total[j] = math.sqrt(dx * dx + dy * dy) + best
            pairs[j] = count + 1
    return total[-1], pairs[-1]


def dtw_alignment(x: NDArray[np.floating], y: NDArray[np.floating]) -> tuple[float, int]:
    """Return :func:`dtw_distance` and the number of frame pairs on its warping path.

    The distance grows with their number, so that a short path is close to anything; distance over
    pairs is the mean distance of aligned positions.
    """
    if x.ndim != 2 or y.ndim != 2 or x.shape[1] != 2 or y.shape[1] != 2 or not (len(x) and len(y)):
        raise InputError(f"paths have shapes {x.shape} and {y.shape}: give (frames, 2) of each")
    distance, pairs = _aligned(*(np.ascontiguousarray(path, np.float64) for path in (x, y)))
    return float(distance), int(pairs)


@jit
def _extend_rows(  # type: ignore[no-untyped-def]
    mask,
    first,
    position,
    demo,
    individuals,
    paths,
    start,
    step_count,
    window,
    rows,
    lowest,
    aligned,
):
    """Extend the rows of all copies in ``mask``; ``position`` is (B, K, 2), ``rows`` (B, F, m).

    With a ``window`` only frames t - window to t + window count, and the minimum is infinite where
    the recording is over; without (-1) all frames count.
    """
    for b in range(len(mask)):
        if not mask[b]:
            continue
        t = step_count[b]
        opening = start[demo[b]]
        m = start[demo[b] + 1] - opening
        begin, end = 0, m
        if window >= 0:
            begin, end = max(0, t - window), min(m, t + window + 1)
        for f in range(len(individuals)):
            i = individuals[f]
            if first and window >= 0:
                rows[b, f] = math.inf
            if window >= 0 and t >= m:
                lowest[b, f] = math.inf
            else:
                lowest[b, f], aligned[b, f] = _extend_row(
                    rows[b, f],
                    begin,
                    end,
                    position[b, i, 0],
                    position[b, i, 1],
                    paths[i, opening : opening + m],
                    first,
                )


class DTWTracker:
    """Follows the episodes of a world and keeps one DTW row per copy and individual.

    Put into ``world.trackers``: the world tells it when episodes start and when a step is done, so
    that a copy's rows are reset with that copy, whoever resets it. ``demos`` are what the world's
    episodes are paired with, ``individuals`` the indices of the ``F`` that are followed; at the
    cost ``scale``, the species' contact radius [arena unit], closeness falls to 1/e.

    Raises InputError if there are no demonstrations, or no such penalty.

    Attributes
    ----------
    penalty
        ``(B, F)``, what the last step is charged, before weighting.
    refund
        ``(B, F)``, what it is charged beside, without weighting; 0 but with ``"closeness"``.
    row_minimum, aligned
        ``(B, F)``: ``min_j W(t, j)`` [arena unit], and its ``argmin``, the recorded step aligned
        with the present one.
    final_minimum, final_aligned
        The two as they were after the last step, also where a copy has been reset since.
    """

    KINDS = ("closeness", "increment", "cumulative")

    def __init__(
        self,
        demos: Demonstrations | None,
        num_copies: int,
        individuals: Ints,
        scale: float,
        kind: str = "closeness",
    ) -> None:
        if kind not in self.KINDS:
            raise InputError(f"penalty is {kind!r}: choose {', '.join(self.KINDS)}")
        if demos is None:
            raise InputError(
                "the DTW reward compares with demonstrations, but episodes start without any: make "
                "the environment with start='demo', or give it demos="
            )
        self.kind, self.scale = kind, scale
        self.individuals = np.asarray(individuals, dtype=np.int64)
        self._paths = np.array(demos.positions.transpose(1, 0, 2), order="C")
        self._start = demos.offsets.astype(np.int64)
        shape = (num_copies, len(self.individuals))
        self.rows = np.full((*shape, int(demos.lengths.max())), np.inf)
        self.bands = np.full_like(self.rows, np.inf) if kind == "closeness" else np.zeros(0)
        self.penalty, self.refund = np.zeros(shape), np.zeros(shape)
        self.row_minimum = np.zeros(shape)
        self.band_minimum = np.zeros(shape)
        self.aligned = np.zeros(shape, dtype=np.int64)
        self._band_aligned = np.zeros(shape, dtype=np.int64)  # scratch
        self.final_minimum, self.final_aligned = self.row_minimum, self.aligned
        self._all = np.ones(num_copies, dtype=bool)

    def started(self, world: Any, mask: Bools) -> None:
        """Initialise row 0 of the copies in ``mask``; no penalty is charged for it."""
        self._extend(world, mask, first=True)

    def stepped(self, world: Any) -> None:
        """Extend the rows of all copies by row t, and compute the penalty."""
        before, band_before = self.row_minimum.copy(), self.band_minimum.copy()
        self._extend(world, self._all, first=False)
        self.final_minimum = self.row_minimum.copy()
        self.final_aligned = self.aligned.copy()
        if self.kind == "closeness":
            self._charge_closeness(world, band_before)
        elif self.kind == "increment":
            self.penalty = self.final_minimum - before
        else:
            self.penalty = self.final_minimum.copy()

    def _charge_closeness(self, world: Any, before: Floats) -> None:
        """Pay for closeness while the recording lasts; afterwards take back the reward for lasting.

        Otherwise a target that stands apart would earn more by outliving its recording than by
        following it.
        """
        over = np.isinf(self.band_minimum)
        increase = np.where(over, 0.0, self.band_minimum) - np.where(over, 0.0, before)
        self.penalty = np.where(over, 0.0, -np.exp(-increase / self.scale))
        if "elapsed" in world.reward_components:
            elapsed = world.reward_components.index("elapsed")
            self.refund = np.where(over, world.components[:, self.individuals, elapsed], 0.0)

    def _extend(self, world: Any, mask: Bools, *, first: bool) -> None:
        if (world.demo[mask] < 0).any():
            raise InputError(
                "the DTW reward needs episodes that start from a demonstration: use start='demo'"
            )
        inputs = (
            mask,
            first,
            world.position,
            world.demo,
            self.individuals,
            self._paths,
            self._start,
            world.step_count,
        )
        _extend_rows(*inputs, -1, self.rows, self.row_minimum, self.aligned)
        if self.kind == "closeness":
            _extend_rows(*inputs, WINDOW, self.bands, self.band_minimum, self._band_aligned)

    def get_state(self) -> dict[str, NDArray[Any]]:
        """Return copies of all arrays that decide the future."""
        return {f"dtw_{name}": getattr(self, name).copy() for name in self._STATE}

    def set_state(self, state: dict[str, NDArray[Any]]) -> None:
        """Continue from what :meth:`get_state` gave."""
        for name in self._STATE:
            getattr(self, name)[...] = state[f"dtw_{name}"]

    _STATE = ("rows", "bands", "row_minimum", "band_minimum", "aligned", "penalty")
