"""Odour plumes as a searcher reads them: where an antenna would be hit, step by step.

A plume is turned once into a :class:`HitTable`, the maximum over the frames of each decision
step and over the antenna's radius, one bit per grid cell, so that a reading is one look-up. A table
is made when it is first needed, in about a tenth of a second per pattern, and kept for the process:
1 MB per pattern of 260 s at 0.5 s a step. It repeats when the pattern ends.

An odour fitted to recordings (:func:`animarl_envs.fitting.odour.fit_odour`) has chances of
hits instead of a field of puffs; the search world draws each hit from it.

Frame: the source lies at the origin, the air flows towards +x, y is up [m].
"""

from __future__ import annotations

import functools
import math
from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numba as nb
import numpy as np
from numpy.typing import ArrayLike, NDArray

from animarl_envs.array_types import Bools, Floats, Ints
from animarl_envs.compiling import jit
from animarl_envs.errors import InputError, require_extra
from animarl_envs.settings import Positive, check_fields
from animarl_envs.worlds.plume.filaments import FilamentModel, paint

NUM_PATTERNS = 5


class HitTable(NamedTuple):
    """Where an antenna is hit. Row 0 lies at the lowest y, column 0 at the lowest x."""

    bits: NDArray[np.uint8]  # (patterns, steps, bytes): one bit per cell, row by row
    rows: int
    columns: int
    source_row: int
    source_column: int
    cell: float  # side of a cell [m]

    def unpack(self, pattern: int, step: int) -> Bools:
        """Return hits of one step, ``(rows, columns)``."""
        flat = np.unpackbits(self.bits[pattern, step], bitorder="little")
        return flat[: self.rows * self.columns].reshape(self.rows, self.columns).astype(bool)

    @property
    def extent(self) -> tuple[float, float, float, float]:
        """Outer edges ``(x_low, x_high, y_low, y_high)`` [m]."""
        left = -(self.source_column + 0.5) * self.cell
        low = -(self.source_row + 0.5) * self.cell
        return left, left + self.columns * self.cell, low, low + self.rows * self.cell


@jit(forceinline=True)  # Python calls it, too
def is_hit(table, pattern, step, x, y):  # type: ignore[no-untyped-def]
    """Return whether an antenna at ``(x, y)`` is hit; a tie of two cells goes to the outer one."""
    column = table.source_column + int(math.copysign(math.floor(abs(x) / table.cell + 0.5), x))
    row = table.source_row + int(math.copysign(math.floor(abs(y) / table.cell + 0.5), y))
    if column < 0 or column >= table.columns or row < 0 or row >= table.rows:
        return False
    index = row * table.columns + column
    return (table.bits[pattern, step, index >> 3] >> (index & 7)) & 1 == 1


def stencil_of(radius: float, cell: float) -> Ints:
    """Return offsets ``(n, 2)`` in cells (row, column) within ``radius`` of a cell's centre."""
    reach = math.floor(radius / cell + 1e-9)
    offsets = np.arange(-reach, reach + 1)
    rows, columns = np.meshgrid(offsets, offsets, indexing="ij")
    inside = np.hypot(rows, columns) * cell <= radius + 1e-9
    return np.stack([rows[inside], columns[inside]], axis=-1)


def over_steps(frames: Iterable[Bools], per_step: float) -> Iterator[Bools]:
    """Yield the union of the frames of each whole step; a frame longer than a step is repeated."""
    union: Bools | None = None
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


class PlumeField(NamedTuple):
    """A concentration field: ``values`` ``(rows, columns)`` in [0, 1], row 0 at ``y_low``.

    ``extent`` is ``(x_low, x_high, y_low, y_high)``, outer edges in the arena frame [arena unit].
    """

    values: NDArray[np.floating]
    extent: tuple[float, float, float, float]


class Plume(ABC):
    """A source of odour with one or more fixed patterns.

    Make one with :meth:`from_array`, :meth:`from_movie`, :meth:`off` or :meth:`continuous`, or use
    :class:`ModelPlume`, the default.
    """

    num_patterns: int

    @abstractmethod
    def pattern_table(self, pattern: int, dt: float, antenna_radius: float) -> HitTable:
        """Return the table of one pattern for steps of ``dt`` [s] and a sensing radius [m]."""

    @abstractmethod
    def field(self, pattern: int, time: float) -> tuple[NDArray[np.float32], tuple[float, ...]]:
        """Return values in [0, 1] to draw, lowest y first, and their extent."""

    @staticmethod
    def from_array(
        frames: ArrayLike,
        *,
        mm_per_pixel: float,
        source_pixel: tuple[int, int],
        frame_rate: float,
        threshold: float | None = None,
    ) -> MoviePlume:
        """Make a plume from a movie in memory.

        Parameters
        ----------
        frames
            ``(frames, height, width)``, bool or grey values; the air flows to the right, row 0 is
            the top. Mirror it first if it flows to the left.
        mm_per_pixel
            Size of a pixel [mm].
        source_pixel
            ``(row, column)`` of the source, in the image or outside it.
        frame_rate
            [Hz]
        threshold
            A grey value above it is a hit; by default half of the greatest value.

        Raises
        ------
        InputError
            If the array has another shape, is empty, or holds NaN; or a number is out of range.
        """
        array = np.asarray(frames)
        if array.ndim != 3 or array.size == 0:
            raise InputError(
                f"the plume movie has shape {array.shape}: give grey frames as "
                "(frames, height, width)"
            )
        if not (array.dtype == bool or np.issubdtype(array.dtype, np.number)):
            raise InputError(f"the plume movie holds {array.dtype}: give grey values or booleans")
        if np.issubdtype(array.dtype, np.floating) and not np.isfinite(array).all():
            raise InputError("the plume movie holds NaN or infinity: replace them by zero")
        if threshold is None:
            threshold = 0.5 * float(array.max())
        return MoviePlume(array, None, mm_per_pixel, tuple(source_pixel), frame_rate, threshold)

    @staticmethod
    def from_movie(
        path: str | Path,
        *,
        mm_per_pixel: float,
        source_pixel: tuple[int, int],
        frame_rate: float,
        threshold: float = 127.5,
    ) -> MoviePlume:
        """Make a plume from a movie file or an ``.npy`` array, read when first needed.

        The parameters are those of :meth:`from_array`; colours are averaged.
        """
        path = Path(path)
        if not path.is_file():
            raise InputError(f"plume movie {path}: there is no such file: check the path")
        return MoviePlume(None, path, mm_per_pixel, tuple(source_pixel), frame_rate, threshold)

    @staticmethod
    def off() -> MoviePlume:
        """Make a plume without odour."""
        frames = np.zeros((1, 1, 1), dtype=bool)
        return MoviePlume(frames, None, 1.0, (0, 0), 1.0, 0.5)

    @staticmethod
    def continuous(half_width: float = 0.02, length: float = 0.5) -> MoviePlume:
        """Make a steady ribbon of odour straight downwind of the source, for checks [m]."""
        rows = 2 * round(half_width * 1000) + 1
        frames = np.ones((1, rows, round(length * 1000) + 1), dtype=bool)
        return MoviePlume(frames, None, 1.0, (rows // 2, 0), 1.0, 0.5)


@dataclass(frozen=True)
class ModelPlume(Plume):
    """Five fixed patterns of the filament model; see :mod:`animarl_envs.worlds.plume.filaments`."""

    model: FilamentModel
    num_patterns: int = NUM_PATTERNS

    @classmethod
    def fitted(cls) -> ModelPlume:
        """Return the plume of the fitted filament model."""
        return cls(FilamentModel.fitted())

    def pattern_table(self, pattern: int, dt: float, antenna_radius: float) -> HitTable:
        """Return the table of one pattern, see :meth:`Plume.pattern_table`."""
        model = self.model
        rows, columns, x0, y0 = model.grid
        steps = max(1, round(model.period / dt))
        bits = np.zeros((steps, (rows * columns + 7) // 8), dtype=np.uint8)
        fill_from_model(
            model.release(pattern),
            model.kernel_constants(),
            model.threshold,
            1.0 / model.frame_rate,
            dt,
            stencil_of(antenna_radius, model.cell),
            rows,
            columns,
            bits,
        )
        return HitTable(
            bits[None], rows, columns, round(-y0 / model.cell), round(-x0 / model.cell), model.cell
        )

    def field(self, pattern: int, time: float) -> tuple[NDArray[np.float32], tuple[float, ...]]:
        """Return values and extent to draw, see :meth:`Plume.field`."""
        rows, columns, x0, y0 = self.model.grid
        half = 0.5 * self.model.cell
        concentration = self.model.concentration(pattern, time)
        values = concentration / (concentration + np.float32(self.model.threshold))
        right, top = x0 + columns * 2 * half - half, y0 + rows * 2 * half - half
        return values, (x0 - half, right, y0 - half, top)


@dataclass(frozen=True, eq=False)
class MoviePlume(Plume):
    """A recorded plume: frames in memory or in a file. One pattern."""

    frames: NDArray[Any] | None
    path: Path | None
    mm_per_pixel: Positive
    source_pixel: tuple[int, ...]
    frame_rate: Positive
    threshold: float
    num_patterns: int = 1

    def __post_init__(self) -> None:
        check_fields(self, "the plume movie's ")
        whole = all(isinstance(v, int | np.integer) for v in self.source_pixel)
        if len(self.source_pixel) != 2 or not whole:
            raise InputError(
                f"the plume movie's source_pixel is {self.source_pixel}: give (row, column) as "
                "whole numbers"
            )

    def pattern_table(self, pattern: int, dt: float, antenna_radius: float) -> HitTable:
        """Return the table of one pattern, see :meth:`Plume.pattern_table`."""
        cell = self.mm_per_pixel * 1e-3
        stencil = stencil_of(antenna_radius, cell)
        margin = int(np.abs(stencil).max())  # the antenna may lie outside the picture
        per_step = dt * self.frame_rate
        packed: list[NDArray[np.uint8]] = []
        height = width = 0
        for hits in over_steps(self._hits(), per_step):
            height, width = hits.shape
            padded = np.pad(hits[::-1], margin)
            packed.append(np.zeros((padded.size + 7) // 8, dtype=np.uint8))
            spread(padded, 0, padded.shape[0], 0, padded.shape[1], stencil, packed[-1])
        row, column = self.source_pixel
        return HitTable(
            np.stack(packed)[None],
            height + 2 * margin,
            width + 2 * margin,
            height - 1 - row + margin,
            column + margin,
            cell,
        )

    def field(self, pattern: int, time: float) -> tuple[NDArray[np.float32], tuple[float, ...]]:
        """Return values and extent to draw, see :meth:`Plume.field`."""
        table = hit_table(self, (0,), 1.0 / self.frame_rate, 0.0)
        step = int(time * self.frame_rate) % table.bits.shape[1]
        return table.unpack(0, step).astype(np.float32), table.extent

    def _hits(self) -> Iterator[Bools]:
        frames = self.frames if self.frames is not None else _read_movie(self.path)
        for frame in frames:
            yield frame > self.threshold if frame.dtype != bool else frame


def as_plume(choice: Any) -> Plume:
    """Return the plume of an option: ``"model"``, ``"off"``, ``"continuous"``, or itself."""
    if isinstance(choice, Plume):
        return choice
    named = {"model": ModelPlume.fitted, "off": Plume.off, "continuous": Plume.continuous}
    if isinstance(choice, str) and choice in named:
        return named[choice]()
    raise InputError(
        f"plume is {choice!r}: choose {', '.join(repr(n) for n in named)}, or give "
        "Plume.from_array(...) or Plume.from_movie(...)"
    )


@functools.lru_cache(maxsize=32)
def _cached_table(plume: Plume, pattern: int, dt: float, antenna_radius: float) -> HitTable:
    return plume.pattern_table(pattern, dt, antenna_radius)


@functools.lru_cache(maxsize=8)
def hit_table(
    plume: Plume, patterns: tuple[int, ...], dt: float, antenna_radius: float
) -> HitTable:
    """Return the tables of several patterns as one; built on first use and kept."""
    for pattern in patterns:
        if not 0 <= pattern < plume.num_patterns:
            raise InputError(
                f"plume pattern {pattern} does not exist: choose 0 to {plume.num_patterns - 1}"
            )
    tables = [_cached_table(plume, p, dt, antenna_radius) for p in patterns]
    return tables[0]._replace(bits=np.concatenate([t.bits for t in tables]))


def _read_movie(path: Path | None) -> Iterator[NDArray[Any]]:
    """Yield grey frames of a file, one by one."""
    assert path is not None
    if path.suffix == ".npy":
        try:
            array = np.load(path, mmap_mode="r", allow_pickle=False)
        except ValueError as error:
            raise InputError(f"plume movie {path}: it is no plain array ({error})") from None
        if array.ndim != 3 or array.size == 0:
            raise InputError(
                f"plume movie {path} has shape {array.shape}: give (frames, height, width)"
            )
        yield from array
        return
    with require_extra("reading a plume movie", "render"):
        import imageio.v3 as imageio
    try:
        for frame in imageio.imiter(path):
            yield frame if frame.ndim == 2 else frame[..., :3].mean(axis=-1)
    except (OSError, ValueError, RuntimeError) as error:
        raise InputError(f"plume movie {path}: it cannot be read ({error}): convert it") from None


# -- kernels ----------------------------------------------------------------------------------


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


INPUTS = 9
LONGEST = 10.0  # since the last hit [s]


class OdourWeights(NamedTuple):
    """The weights of a :class:`FittedOdour`, and room for its inputs."""

    first: Floats
    bias: Floats
    last: Floats
    offset: Floats
    inputs: Floats


@nb.njit(inline="always")
def write_inputs(x, y, cosine, sine, left, right, since, out):  # type: ignore[no-untyped-def]
    """Write the network's inputs: place [m], heading, last hits, time since a hit [s]."""
    out[0] = min(5.0, max(-1.0, x / 0.1))
    out[1] = min(6.0, max(-6.0, y / 0.05))
    out[2] = min(5.0, math.sqrt(x * x + y * y) / 0.1)
    out[3] = min(7.5, max(-7.5, math.atan2(y, x) / 0.2))
    out[4] = cosine
    out[5] = sine
    out[6] = 1.0 if left else -1.0
    out[7] = 1.0 if right else -1.0
    out[8] = math.log(2.0 * min(since, LONGEST) + 1.0) - 0.5


def mirrored(inputs: Floats) -> Floats:
    """Return the inputs ``(n, INPUTS)`` of the mirror image."""
    return np.multiply(inputs[:, [0, 1, 2, 3, 4, 5, 7, 6, 8]], [1, -1, 1, -1, 1, -1, 1, 1, 1])


@nb.njit(inline="always")
def draw_hits(x, y, cosine, sine, left, right, since, odour, uniform):  # type: ignore[no-untyped-def]
    """Draw whether the left and the right antenna are hit, by a uniform number in [0, 1)."""
    first, bias, last, offset, inputs = odour
    write_inputs(x, y, cosine, sine, left, right, since, inputs)
    none = offset[0]
    one = offset[1]
    other = offset[2]
    both = offset[3]
    for unit in range(len(bias)):
        total = bias[unit]
        for i in range(len(inputs)):
            total += inputs[i] * first[i, unit]
        total = math.tanh(total)
        none += total * last[unit, 0]
        one += total * last[unit, 1]
        other += total * last[unit, 2]
        both += total * last[unit, 3]
    top = max(max(none, one), max(other, both))
    none = math.exp(none - top)
    one = math.exp(one - top)
    other = math.exp(other - top)
    both = math.exp(both - top)
    drawn = uniform * (none + one + other + both) - none
    return 0.0 <= drawn < one or drawn >= one + other, drawn >= one


@dataclass(frozen=True, eq=False)
class FittedOdour(Plume):
    """Weights of the network ``(INPUTS, n)``, ``(n,)``, ``(n, 4)``, ``(4,)``. One pattern."""

    first: Floats
    bias: Floats
    last: Floats
    offset: Floats
    num_patterns: int = 1

    def pattern_table(self, pattern: int, dt: float, antenna_radius: float) -> HitTable:
        """Return the table of one pattern, see :meth:`Plume.pattern_table`."""
        return HitTable(np.zeros((1, 1, 1), np.uint8), 1, 1, 0, 0, 1e-3)

    def chances(self, inputs: Floats) -> Floats:
        """Return P(no hit, left, right, both), ``(n, 4)``, of inputs ``(n, INPUTS)``."""
        return softmax(np.tanh(inputs @ self.first + self.bias) @ self.last + self.offset)

    def field(self, pattern: int, time: float) -> tuple[NDArray[np.float32], tuple[float, ...]]:
        """Return the chance of a hit for a body that faces upwind and smelt nothing, to draw."""
        x, y = np.meshgrid(np.arange(-0.05, 0.45, 0.01), np.arange(-0.15, 0.155, 0.01))
        rows = np.empty((x.size, INPUTS))
        for place, row in zip(np.stack([x.ravel(), y.ravel()], axis=-1), rows, strict=True):
            write_inputs(place[0], place[1], -1.0, 0.0, False, False, LONGEST, row)
        hit = 1.0 - self.chances(rows)[:, 0]
        return hit.reshape(x.shape).astype(np.float32), (-0.055, 0.445, -0.155, 0.155)


def softmax(logits: Floats) -> Floats:
    """Return probabilities of each row."""
    chance = np.exp(logits - logits.max(axis=1, keepdims=True))
    return np.asarray(chance / chance.sum(axis=1, keepdims=True))


def odour_weights(plume: Plume) -> OdourWeights:
    """Return what kernels draw hits from; empty for a plume that is a table."""
    if isinstance(plume, FittedOdour):
        return OdourWeights(plume.first, plume.bias, plume.last, plume.offset, np.zeros(INPUTS))
    return OdourWeights(np.zeros((0, 0)), np.zeros(0), np.zeros((0, 0)), np.zeros(0), np.zeros(0))
