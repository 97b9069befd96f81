"""Numbers inside kernels: a random stream per copy of the world, and fast tanh, log and atan2.

A stream of splitmix64 depends on its copy's seed alone, so a copy gives the same bytes alone,
beside 1,023 others, or in another process. (Steele, Lea and Flood 2014, "Fast splittable
pseudorandom number generators".) For simulation, not for cryptography.

The functions compile to vector instructions, as those of libm do not; float32, of which a vector
instruction takes eight.
"""

import math
from typing import Any

import numba as nb
import numpy as np

from animarl_envs.compiling import jit

_GOLDEN = np.uint64(0x9E3779B97F4A7C15)
_MIX_1 = np.uint64(0xBF58476D1CE4E5B9)
_MIX_2 = np.uint64(0x94D049BB133111EB)
_S30, _S27, _S31, _S11 = np.uint64(30), np.uint64(27), np.uint64(31), np.uint64(11)
ZERO: Any = np.float32(0.0)
ONE: Any = np.float32(1.0)
TWO: Any = np.float32(2.0)
_TO_UNIT = 1.0 / 9007199254740992.0  # 2^-53


@nb.njit(inline="always")
def mix(z):  # type: ignore[no-untyped-def]
    """Apply the output function of splitmix64."""
    z = (z ^ (z >> _S30)) * _MIX_1
    z = (z ^ (z >> _S27)) * _MIX_2
    return z ^ (z >> _S31)


@nb.njit(inline="always")
def next_u64(state, b):  # type: ignore[no-untyped-def]
    """Return the next 64 random bits of stream ``b``."""
    state[b] += _GOLDEN
    return mix(state[b])


@nb.njit(inline="always")
def next_uniform(state, b):  # type: ignore[no-untyped-def]
    """Return a uniform number in [0, 1)."""
    return np.float64(next_u64(state, b) >> _S11) * _TO_UNIT


@nb.njit(inline="always")
def next_below(state, b, n):  # type: ignore[no-untyped-def]
    """Return a uniform integer in 0 .. n - 1."""
    return np.int64(next_uniform(state, b) * n)


@nb.njit(inline="always")
def next_normal(state, b):  # type: ignore[no-untyped-def]
    """Return a standard normal number (Box and Muller 1958; the second of the pair is not kept)."""
    radius = math.sqrt(-2.0 * math.log(1.0 - next_uniform(state, b)))
    return radius * math.cos(2.0 * math.pi * next_uniform(state, b))


@jit
def seed_streams(seeds, state):  # type: ignore[no-untyped-def]
    """Start stream ``b`` of ``state`` from ``seeds[b]``, both uint64."""
    for b in range(len(seeds)):
        state[b] = mix(seeds[b] + _GOLDEN)


@jit
def draw_uniforms(state, numbers):  # type: ignore[no-untyped-def]
    """Fill ``numbers`` ``(B, n)`` with uniform numbers in [0, 1), row ``b`` from stream ``b``."""
    for b in range(numbers.shape[0]):
        for i in range(numbers.shape[1]):
            numbers[b, i] = next_uniform(state, b)


_MOST: Any = np.float32(8.0)  # tanh beyond it is 1 in float32
# tanh(x) / x up to there as a rational function of x^2: relative errors are below 2e-8 before
# rounding (least squares, reweighted until all extrema were alike).
_T1, _T2, _T3, _T4, _T5 = map(
    np.float32, (0.129792169, 0.00298585487, 9.87859494e-06, -1.47040184e-08, 2.35080653e-11)
)
_U1, _U2, _U3 = map(np.float32, (0.463125318, 0.0240278952, 0.000237202257))
_ONE_BITS, _FRACTION, _SHIFT, _BIAS = (
    np.int32(0x3F800000),
    np.int32(0x007FFFFF),
    np.int32(23),
    np.int32(127),
)
_LN2 = np.float32(math.log(2.0))
_L3, _L5, _L7, _L9, _L11 = (np.float32(2.0 / k) for k in (3, 5, 7, 9, 11))
_THREE = np.float32(3.0)


@nb.njit(inline="always")
def bounded(x):  # type: ignore[no-untyped-def]
    """Return a float32 that rounding may have taken out of [-1, 1]."""
    return min(max(x, -ONE), ONE)


@nb.njit(inline="always")
def tanh_of(x):  # type: ignore[no-untyped-def]
    """Return ``tanh(x)`` of float32 within 4e-7; odd in ``x``, and 1 at most."""
    z = min(max(x, -_MOST), _MOST)
    s = z * z
    above = ONE + s * (_T1 + s * (_T2 + s * (_T3 + s * (_T4 + s * _T5))))
    return bounded(z * above / (ONE + s * (_U1 + s * (_U2 + s * _U3))))


@nb.njit(inline="always")
def tanh_tripled(t):  # type: ignore[no-untyped-def]
    """Return ``tanh(3 a)`` of ``t = tanh(a)``, float32."""
    return bounded(t * (_THREE + t * t) / (ONE + _THREE * t * t))


@nb.njit(inline="always")
def log_of(x):  # type: ignore[no-untyped-def]
    """Return ``log(x)`` of a positive, normal float32 within 2e-6: exponent and mantissa apart."""
    bits = np.float32(x).view(np.int32)
    exponent = np.float32((bits >> _SHIFT) - _BIAS)
    mantissa = np.int32((bits & _FRACTION) | _ONE_BITS).view(np.float32)
    s = (mantissa - ONE) / (mantissa + ONE)  # log m = 2 artanh s, s up to 1/3
    q = s * s
    return exponent * _LN2 + s * (TWO + q * (_L3 + q * (_L5 + q * (_L7 + q * (_L9 + q * _L11)))))


_HALF_PI, _PI = np.float32(math.pi / 2.0), np.float32(math.pi)
_TINY = np.float32(1e-30)


def _coefficients(terms: int) -> list[np.float32]:
    """Chebyshev fit of ``atan(z) / z`` as a polynomial in ``z^2`` over [0, 1]."""
    s = 0.5 * (1.0 + np.cos(np.pi * (np.arange(200) + 0.5) / 200))
    z = np.sqrt(s)
    fit = np.polynomial.Chebyshev.fit(s, np.arctan(z) / z, terms - 1, domain=[0, 1])
    return [np.float32(c) for c in fit.convert(kind=np.polynomial.Polynomial).coef]


_C0, _C1, _C2, _C3, _C4, _C5, _C6, _C7 = _coefficients(8)


@nb.njit(inline="always")
def angle_of(x, y):  # type: ignore[no-untyped-def]
    """Return ``atan2(y, x)`` in [-pi, pi], within 5e-7 rad; zero for zeros, odd in ``y``."""
    across = abs(x)
    up = abs(y)
    z = min(across, up) / (max(across, up) + _TINY)
    s = z * z
    high = _C4 + s * (_C5 + s * (_C6 + s * _C7))
    angle = z * (_C0 + s * (_C1 + s * (_C2 + s * (_C3 + s * high))))
    angle = _HALF_PI - angle if up > across else angle
    angle = _PI - angle if x < ZERO else angle
    return math.copysign(angle, y)
