"""An arctangent that compiles to vector instructions: libm's does not."""

from __future__ import annotations

import math

import numba as nb
import numpy as np

_HALF_PI, _PI = np.float32(math.pi / 2.0), np.float32(math.pi)
_TINY, _ZERO = np.float32(1e-30), np.float32(0.0)


def _coefficients(terms: int) -> list[np.float32]:
    """Chebyshev fit of ``atan(z) / z`` as a polynomial in ``z^2`` over [0, 1]."""
    s = 0.5 * (1.0 + np.cos(np.pi * (np.arange(200) + 0.5) / 200))
    z = np.sqrt(s)
    fit = np.polynomial.Chebyshev.fit(s, np.arctan(z) / z, terms - 1, domain=[0, 1])
    return [np.float32(c) for c in fit.convert(kind=np.polynomial.Polynomial).coef]


_C0, _C1, _C2, _C3, _C4, _C5, _C6, _C7 = _coefficients(8)


@nb.njit(inline="always")
def angle_of(x, y):  # type: ignore[no-untyped-def]
    """``atan2(y, x)`` of float32 in [-pi, pi], within 5e-7 rad; zero for zeros, odd in ``y``."""
    across = abs(x)
    up = abs(y)
    z = min(across, up) / (max(across, up) + _TINY)
    s = z * z
    p = _C7
    p = p * s + _C6
    p = p * s + _C5
    p = p * s + _C4
    p = p * s + _C3
    p = p * s + _C2
    p = p * s + _C1
    p = p * s + _C0
    angle = z * p
    angle = _HALF_PI - angle if up > across else angle
    angle = _PI - angle if x < _ZERO else angle
    return math.copysign(angle, y)
