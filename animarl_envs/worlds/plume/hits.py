"""Where an antenna would be hit: a table of one bit per step and grid cell, and how it is filled.

Frame: the source lies at the origin, the air flows towards +x, y is up [m].
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from typing import NamedTuple

import numba as nb
import numpy as np
from numpy.typing import NDArray

from animarl_envs.compiling import jit
from animarl_envs.worlds.plume.filaments import paint


class HitTable(NamedTuple):
    """Where an antenna is hit. Row 0 lies at the lowest y, column 0 at the lowest x."""

    bits: NDArray[np.uint8]  # (patterns, steps, bytes): one bit per cell, row by row
    rows: int
    columns: int
    source_row: int
    source_column: int
    cell: float  # side of a cell [m]

    def unpack(self, pattern: int, step: int) -> NDArray[np.bool_]:
        """Hits of one step, ``(rows, columns)``."""
        flat = np.unpackbits(self.bits[pattern, step], bitorder="little")
        return flat[: self.rows * self.columns].reshape(self.rows, self.columns).astype(bool)

    @property
    def extent(self) -> tuple[float, float, float, float]:
        """Outer edges ``(x_low, x_high, y_low, y_high)`` [m]."""
        left = -(self.source_column + 0.5) * self.cell
        low = -(self.source_row + 0.5) * self.cell
        return left, left + self.columns * self.cell, low, low + self.rows * self.cell


@nb.njit(inline="always")
def is_hit(bits, rows, columns, source_row, source_column, cell, pattern, step, x, y):  # type: ignore[no-untyped-def]
    """Whether an antenna at ``(x, y)`` is hit; the middle of two cells belongs to the outer one."""
    column = source_column + int(math.copysign(math.floor(abs(x) / cell + 0.5), x))
    row = source_row + int(math.copysign(math.floor(abs(y) / cell + 0.5), y))
    if column < 0 or column >= columns or row < 0 or row >= rows:
        return False
    index = row * columns + column
    return (bits[pattern, step, index >> 3] >> (index & 7)) & 1 == 1


def stencil_of(radius: float, cell: float) -> NDArray[np.int64]:
    """Offsets ``(n, 2)`` in cells (row, column) within ``radius`` of a cell's centre."""
    reach = math.floor(radius / cell + 1e-9)
    offsets = np.arange(-reach, reach + 1)
    rows, columns = np.meshgrid(offsets, offsets, indexing="ij")
    inside = np.hypot(rows, columns) * cell <= radius + 1e-9
    return np.stack([rows[inside], columns[inside]], axis=-1)


def over_steps(frames: Iterable[NDArray[np.bool_]], per_step: float) -> Iterator[NDArray[np.bool_]]:
    """The union of the frames of each whole step; a frame longer than a step is repeated."""
    union: NDArray[np.bool_] | None = None
    done = 0
    for count, frame in enumerate(frames, start=1):
        seen = frame if union is None else union | frame
        union = seen
        while (done + 1) * per_step <= count + 1e-9:
            yield seen
            done += 1
            seen, union = frame, None
    if done == 0 and union is not None:  # shorter than one step
        yield union


@jit
def spread(hits, bottom, top, left, right, stencil, packed):  # type: ignore[no-untyped-def]
    """Set the bits of cells within the stencil's reach of a hit; clear the hits on the way."""
    rows, columns = hits.shape
    for row in range(bottom, top):
        for column in range(left, right):
            if hits[row, column]:
                hits[row, column] = False
                for k in range(stencil.shape[0]):
                    r = row + stencil[k, 0]
                    c = column + stencil[k, 1]
                    if 0 <= r < rows and 0 <= c < columns:
                        index = r * columns + c
                        packed[index >> 3] |= np.uint8(1 << (index & 7))


@jit
def fill_from_model(filaments, constants, threshold, frame_time, dt, stencil, rows, columns, bits):  # type: ignore[no-untyped-def]
    """Fill ``bits`` (steps, bytes): frames of a step united, spread over the antenna, packed."""
    field = np.zeros((rows, columns), dtype=np.float32)
    hits = np.zeros((rows, columns), dtype=np.bool_)
    for step in range(bits.shape[0]):
        first = math.floor(step * dt / frame_time + 1e-9)
        last = math.floor((step + 1) * dt / frame_time + 1e-9)
        lowest, highest, leftmost, rightmost = rows, 0, columns, 0
        for frame in range(first, max(first + 1, last)):
            bottom, top, left, right = paint(field, frame * frame_time, filaments, *constants)
            for row in range(bottom, top):
                for column in range(left, right):
                    hits[row, column] |= field[row, column] > threshold
                    field[row, column] = 0.0
            lowest = min(lowest, bottom)
            highest = max(highest, top)
            leftmost = min(leftmost, left)
            rightmost = max(rightmost, right)
        spread(hits, lowest, highest, leftmost, rightmost, stencil, bits[step])
