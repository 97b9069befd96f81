"""Dynamic time warping, row by row: what a learner is paid for staying close to a recorded path.

    W(0, 0) = c(0, 0)
    W(t, j) = c(t, j) + min(W(t-1, j), W(t, j-1), W(t-1, j-1))

with the Euclidean distance between simulated position t and recorded position j as local cost c.
Row t needs row t - 1 only, so a step costs O(m) for a recording of m frames. The open end
``min_j W(t, j)`` is the reward's distance, its ``argmin`` the aligned recorded step; the closed end
``W(T, m)`` is the DTW distance of evaluation. (Vintsyuk 1968; Sakoe and Chiba 1978.)
"""

from __future__ import annotations

import math
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from animarl_envs.compiling import jit
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.errors import InputError


@jit
def _extend_row(row, m, x, y, path, first):  # type: ignore[no-untyped-def]
    """Replace row t - 1 by row t for the simulated position (x, y); its minimum and argmin."""
    lowest = math.inf
    aligned = 0
    diagonal = math.inf  # W(t-1, j-1)
    left = math.inf  # W(t, j-1)
    for j in range(m):
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


@jit
def _closed_end(x, y):  # type: ignore[no-untyped-def]
    row = np.empty(len(y))
    for t in range(len(x)):
        _extend_row(row, len(y), x[t, 0], x[t, 1], y, t == 0)
    return row[-1]


def dtw_distance(x: NDArray[np.floating], y: NDArray[np.floating]) -> float:
    """Closed-end DTW distance of two paths ``(T, 2)`` and ``(m, 2)``, Euclidean, unnormalised."""
    if x.ndim != 2 or y.ndim != 2 or x.shape[1] != 2 or y.shape[1] != 2 or not (len(x) and len(y)):
        raise InputError(f"paths have shapes {x.shape} and {y.shape}: give (frames, 2) of each")
    return float(
        _closed_end(
            np.ascontiguousarray(x, dtype=np.float64), np.ascontiguousarray(y, dtype=np.float64)
        )
    )


@jit
def _extend_rows(mask, first, position, demo, individuals, paths, start, rows, lowest, aligned):  # type: ignore[no-untyped-def]
    """Extend the rows of all copies in ``mask``; ``position`` is (B, K, 2), ``rows`` (B, F, m)."""
    for b in range(len(mask)):
        if not mask[b] or demo[b] < 0:
            continue
        begin = start[demo[b]]
        m = start[demo[b] + 1] - begin
        for f in range(len(individuals)):
            i = individuals[f]
            path = paths[i, begin : begin + m]
            value, j = _extend_row(rows[b, f], m, position[b, i, 0], position[b, i, 1], path, first)
            lowest[b, f] = value
            aligned[b, f] = j


class _Followed(Protocol):
    """What a world shows of itself to a tracker."""

    num_copies: int
    position: NDArray[np.float64]
    demo: NDArray[np.int64]


class DTWTracker:
    """Follows the episodes of a world and keeps one DTW row per copy and individual.

    Put into ``world.trackers``: the world tells it when episodes start and when a step is done, so
    that a copy's rows are reset with that copy, whoever resets it.

    Attributes
    ----------
    penalty
        ``(B, F)``, what the last step cost, before weighting: the row minimum
        (``"cumulative"``) or its increase (``"increment"``) [arena unit].
    row_minimum
        ``(B, F)``, ``min_j W(t, j)`` [arena unit].
    aligned
        ``(B, F)``, the recorded step aligned with the present one, its ``argmin``.
    final_minimum, final_aligned
        The two as they were after the last step, also where a copy has been reset since.
    """

    KINDS = ("increment", "cumulative")

    def __init__(
        self,
        demos: Demonstrations | None,
        num_copies: int,
        individuals: NDArray[np.int64],
        kind: str = "increment",
    ) -> None:
        if kind not in self.KINDS:
            raise InputError(f"penalty is {kind!r}: choose {' or '.join(self.KINDS)}")
        if demos is None:
            raise InputError(
                "the DTW reward compares with demonstrations, but the environment has none: "
                "give it demos="
            )
        self.kind = kind
        self.individuals = np.asarray(individuals, dtype=np.int64)
        self._paths = np.ascontiguousarray(demos.positions.transpose(1, 0, 2))
        self._start = demos.offsets.astype(np.int64)
        shape = (num_copies, len(self.individuals))
        self.rows = np.full((*shape, int(demos.lengths.max())), np.inf)
        self.penalty = np.zeros(shape)
        self.row_minimum = np.zeros(shape)
        self.aligned = np.zeros(shape, dtype=np.int64)
        self.final_minimum, self.final_aligned = self.row_minimum, self.aligned
        self._all = np.ones(num_copies, dtype=bool)

    def started(self, world: _Followed, mask: NDArray[np.bool_]) -> None:
        """Row 0 of the copies in ``mask``: the start is compared with the recording, unpaid."""
        self._extend(world, mask, first=True)

    def stepped(self, world: _Followed) -> None:
        """Row t of all copies, and what it costs."""
        before = self.row_minimum.copy()
        self._extend(world, self._all, first=False)
        self.final_minimum = self.row_minimum.copy()
        self.final_aligned = self.aligned.copy()
        self.penalty = (
            self.final_minimum - before if self.kind == "increment" else (self.final_minimum.copy())
        )

    def _extend(self, world: _Followed, mask: NDArray[np.bool_], *, first: bool) -> None:
        if (world.demo[mask] < 0).any():
            raise InputError(
                "the DTW reward needs episodes that start from a demonstration: use start='demo'"
            )
        _extend_rows(
            mask, first, world.position, world.demo, self.individuals, self._paths, self._start,
            self.rows, self.row_minimum, self.aligned,
        )  # fmt: skip

    def get_state(self) -> dict[str, NDArray[Any]]:
        """Copies of what decides the future."""
        names = ("rows", "row_minimum", "aligned", "penalty")
        return {f"dtw_{name}": getattr(self, name).copy() for name in names}

    def set_state(self, state: dict[str, NDArray[Any]]) -> None:
        """Continue from what :meth:`get_state` gave."""
        for name in ("rows", "row_minimum", "aligned", "penalty"):
            getattr(self, name)[...] = state[f"dtw_{name}"]
