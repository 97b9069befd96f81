"""A hyperbolic tangent and a logarithm that compile to vector instructions: libm's do not."""

from __future__ import annotations

import math

import numba as nb
import numpy as np

_MOST = 9.0  # tanh beyond it is 1 in float32
_SQUARINGS = 6  # exp(z) = exp(z / 64)^64, and exp(z / 64) is a short series
_ONE_BITS, _FRACTION, _SHIFT, _BIAS = (
    np.int32(0x3F800000), np.int32(0x007FFFFF), np.int32(23), np.int32(127),
)  # fmt: skip
_LN2, _ONE = np.float32(math.log(2.0)), np.float32(1.0)
_L3, _L5, _L7, _L9, _L11 = (np.float32(2.0 / k) for k in (3, 5, 7, 9, 11))
_TWO = np.float32(2.0)


@nb.njit(inline="always")
def tanh_of(x):  # type: ignore[no-untyped-def]
    """``tanh(x)`` of float64 within 1e-7; odd in ``x``."""
    z = -2.0 / 2.0**_SQUARINGS * min(abs(x), _MOST)
    power = 1.0 + z * (1.0 + z / 2.0 * (1.0 + z / 3.0 * (1.0 + z / 4.0 * (1.0 + z / 5.0))))
    for _ in range(_SQUARINGS):
        power = power * power
    return math.copysign((1.0 - power) / (1.0 + power), x)


@nb.njit(inline="always")
def tanh_tripled(t):  # type: ignore[no-untyped-def]
    """``tanh(3 a)`` of ``t = tanh(a)``."""
    return t * (3.0 + t * t) / (1.0 + 3.0 * t * t)


@nb.njit(inline="always")
def log_of(x):  # type: ignore[no-untyped-def]
    """``log(x)`` of a positive, normal float32 within 2e-6: exponent and mantissa apart."""
    bits = np.float32(x).view(np.int32)
    exponent = np.float32((bits >> _SHIFT) - _BIAS)
    mantissa = np.int32((bits & _FRACTION) | _ONE_BITS).view(np.float32)
    s = (mantissa - _ONE) / (mantissa + _ONE)  # log m = 2 artanh s, s up to 1/3
    q = s * s
    return exponent * _LN2 + s * (_TWO + q * (_L3 + q * (_L5 + q * (_L7 + q * (_L9 + q * _L11)))))
