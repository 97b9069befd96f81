"""The grid on which recorded positions were stored: pixels, rounded decimals, fixed-point numbers.

Simulated positions are not on it. At rest, and in headings, a grid shows; so simulations are put on
the recordings' grid before the two are compared, and both are at the scale at which positions were
stored.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

FEWEST = 20  # distinct coordinates; fewer lie on a grid by chance
FINEST = 2.0**-24  # of their range: finer steps are what single precision rounds to
FINEST_SINGLE = 2.0**-20  # where coordinates are themselves rounded to single precision
SINGLE = 2.0**-23  # of the largest coordinate: two such roundings, of a coordinate and the lowest
OFF = 1e-3  # steps that a coordinate may lie beside the grid


@dataclass(frozen=True)
class Resolution:
    """How positions were stored: on a grid, or as numbers of single precision.

    The grid's points are whole multiples of ``step`` from ``origin``, its point next to zero; each
    ``(x, y)``, arena frame [arena unit]. A step of zero stands for single precision.
    """

    step: tuple[float, float]
    origin: tuple[float, float]

    @property
    def single(self) -> bool:
        """Whether positions were numbers of single precision, on no coarser grid."""
        return self.step == (0.0, 0.0)

    @property
    def reach(self) -> float:
        """How far rounding moves a position within the arena at most [arena unit]."""
        return math.hypot(*self.step) / 2 + SINGLE


SINGLE_PRECISION = Resolution((0.0, 0.0), (0.0, 0.0))


def rounded(positions: Floats, resolution: Resolution | None) -> Floats:
    """Positions ``(..., 2)`` as they would have been stored; unchanged without a resolution."""
    if resolution is None:
        return positions
    if resolution.single:
        return positions.astype(np.float32).astype(np.float64)
    step, origin = np.array(resolution.step), np.array(resolution.origin)
    return np.asarray(origin + np.round((positions - origin) / step) * step)


def find_resolution(positions: Floats) -> Resolution | None:
    """The coarsest grid on which all positions ``(..., 2)`` lie, if there is one on both axes.

    Else single precision, if all are such numbers, or None.
    """
    found = [_axis(positions[..., axis]) for axis in range(2)]
    if found[0] is None or found[1] is None:
        moved = len(np.unique(positions)) >= FEWEST
        single = moved and np.array_equal(positions, positions.astype(np.float32))
        return SINGLE_PRECISION if single else None
    (x_step, x_origin), (y_step, y_origin) = found[0], found[1]
    return Resolution((x_step, y_step), (x_origin, y_origin))


def _axis(coordinates: Floats) -> tuple[float, float] | None:
    """Step and origin on one axis, of coordinates kept in double precision, or else in single."""
    distinct = np.unique(coordinates)
    if len(distinct) < FEWEST:
        return None
    lowest, largest = float(distinct[0]), float(np.abs(distinct).max())
    for finest, rounding in ((FINEST, 0.0), (FINEST_SINGLE, SINGLE * largest)):
        step = _common_step(distinct, finest * float(distinct[-1] - lowest), rounding)
        if step is not None:
            return step, lowest - round(lowest / step) * step
    return None


def _common_step(distinct: Floats, finest: float, rounding: float) -> float | None:
    """The largest step that fits all distances, by Euclid's algorithm.

    A step that does not fit leaves remainders, of which the least is the next trial.
    """
    distance, gaps = distinct[1:] - distinct[0], np.diff(distinct)
    step = float(np.min(gaps, where=gaps > finest, initial=np.inf))  # less is rounding

    def remainders(trial: float) -> Floats:
        beside = np.abs(distance - np.round(distance / trial) * trial)
        return np.asarray(beside[beside > OFF * trial + rounding])

    while finest < step < np.inf:
        for trial in (_averaged(distinct, step), step):
            left = remainders(trial)
            if not len(left):
                return trial
        step = float(left.min())
    return None


def _averaged(distinct: Floats, step: float) -> float:
    """Return the step, estimated from ever longer distances, where rounding matters less."""
    lag = 1
    while lag < len(distinct):
        apart = distinct[lag:] - distinct[:-lag]
        step = float(apart.sum() / np.round(apart / step).sum())
        lag *= 2
    return step
