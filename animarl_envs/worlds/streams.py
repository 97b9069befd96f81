"""Random numbers inside kernels: one splitmix64 stream per copy of the world.

A copy's stream depends on its own seed alone, so a copy gives the same bytes alone, beside 1,023
others, or in another process. (Steele, Lea and Flood 2014, "Fast splittable pseudorandom number
generators".) For simulation, not for cryptography.
"""

from __future__ import annotations

import math

import numba as nb
import numpy as np
from numpy.typing import ArrayLike, NDArray

from animarl_envs.compiling import jit

_GOLDEN = np.uint64(0x9E3779B97F4A7C15)
_MIX_1 = np.uint64(0xBF58476D1CE4E5B9)
_MIX_2 = np.uint64(0x94D049BB133111EB)
_S30, _S27, _S31, _S11 = np.uint64(30), np.uint64(27), np.uint64(31), np.uint64(11)
_TO_UNIT = 1.0 / 9007199254740992.0  # 2^-53


@nb.njit(inline="always")
def mix(z):  # type: ignore[no-untyped-def]
    """The output function of splitmix64."""
    z = (z ^ (z >> _S30)) * _MIX_1
    z = (z ^ (z >> _S27)) * _MIX_2
    return z ^ (z >> _S31)


@nb.njit(inline="always")
def next_u64(state, b):  # type: ignore[no-untyped-def]
    """The next 64 random bits of stream ``b``."""
    state[b] += _GOLDEN
    return mix(state[b])


@nb.njit(inline="always")
def next_uniform(state, b):  # type: ignore[no-untyped-def]
    """A uniform number in [0, 1)."""
    return np.float64(next_u64(state, b) >> _S11) * _TO_UNIT


@nb.njit(inline="always")
def next_below(state, b, n):  # type: ignore[no-untyped-def]
    """A uniform integer in 0 .. n - 1."""
    return np.int64(next_uniform(state, b) * n)


@nb.njit(inline="always")
def next_normal(state, b):  # type: ignore[no-untyped-def]
    """A standard normal number (Box and Muller 1958; the second of the pair is not kept)."""
    radius = math.sqrt(-2.0 * math.log(1.0 - next_uniform(state, b)))
    return radius * math.cos(2.0 * math.pi * next_uniform(state, b))


@jit
def _scramble(seeds, state):  # type: ignore[no-untyped-def]
    for b in range(len(seeds)):
        state[b] = mix(seeds[b] + _GOLDEN)


def seed_streams(seeds: ArrayLike, state: NDArray[np.uint64]) -> None:
    """Start stream ``b`` of ``state`` from ``seeds[b]`` (any non-negative integers)."""
    _scramble(np.asarray(seeds, dtype=np.uint64), state)
