"""An odour fitted to recordings: chances of hits instead of a field of puffs.

:mod:`animarl_envs.fitting.odour` fits it; the search world draws each hit from it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numba as nb
import numpy as np
from numpy.typing import NDArray

from animarl_envs.worlds.plume.plume import HitTable, Plume

INPUTS = 9
LONGEST = 10.0  # since the last hit [s]


class OdourWeights(NamedTuple):
    """The weights of a :class:`FittedOdour`, and room for its inputs."""

    first: NDArray[np.float64]
    bias: NDArray[np.float64]
    last: NDArray[np.float64]
    offset: NDArray[np.float64]
    inputs: NDArray[np.float64]


@nb.njit(inline="always")
def write_inputs(x, y, cosine, sine, left, right, since, out):  # type: ignore[no-untyped-def]
    """The network's inputs: place [m], heading, hits of the step before, time since a hit [s]."""
    out[0] = min(5.0, max(-1.0, x / 0.1))
    out[1] = min(6.0, max(-6.0, y / 0.05))
    out[2] = min(5.0, math.sqrt(x * x + y * y) / 0.1)
    out[3] = min(7.5, max(-7.5, math.atan2(y, x) / 0.2))
    out[4] = cosine
    out[5] = sine
    out[6] = 1.0 if left else -1.0
    out[7] = 1.0 if right else -1.0
    out[8] = math.log(2.0 * min(since, LONGEST) + 1.0) - 0.5


def mirrored(inputs: NDArray[np.float64]) -> NDArray[np.float64]:
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

    first: NDArray[np.float64]
    bias: NDArray[np.float64]
    last: NDArray[np.float64]
    offset: NDArray[np.float64]
    num_patterns: int = 1

    def pattern_table(self, pattern: int, dt: float, antenna_radius: float) -> HitTable:
        return HitTable(np.zeros((1, 1, 1), np.uint8), 1, 1, 0, 0, 1e-3)

    def chances(self, inputs: NDArray[np.float64]) -> NDArray[np.float64]:
        """P(no hit, left, right, both), ``(n, 4)``, of inputs ``(n, INPUTS)``."""
        return softmax(np.tanh(inputs @ self.first + self.bias) @ self.last + self.offset)

    def field(self, pattern: int, time: float) -> tuple[NDArray[np.float32], tuple[float, ...]]:
        """To draw: the chance of a hit for a body that faces upwind and smelt nothing."""
        x, y = np.meshgrid(np.arange(-0.05, 0.45, 0.01), np.arange(-0.15, 0.155, 0.01))
        rows = np.empty((x.size, INPUTS))
        for place, row in zip(np.stack([x.ravel(), y.ravel()], axis=-1), rows, strict=True):
            write_inputs(place[0], place[1], -1.0, 0.0, False, False, LONGEST, row)
        hit = 1.0 - self.chances(rows)[:, 0]
        return hit.reshape(x.shape).astype(np.float32), (-0.055, 0.445, -0.155, 0.155)


def softmax(logits: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return probabilities of each row."""
    chance = np.exp(logits - logits.max(axis=1, keepdims=True))
    return np.asarray(chance / chance.sum(axis=1, keepdims=True))


def odour_weights(plume: Plume) -> OdourWeights:
    """Return what kernels draw hits from; empty for a plume that is a table."""
    if isinstance(plume, FittedOdour):
        return OdourWeights(plume.first, plume.bias, plume.last, plume.offset, np.zeros(INPUTS))
    return OdourWeights(np.zeros((0, 0)), np.zeros(0), np.zeros((0, 0)), np.zeros(0), np.zeros(0))
