"""How bodies move, as kernels call it: the transition of the velocity, and walls.

Fits and worlds use them alike. They stand apart from :mod:`animarl_envs.locomotion` so that
importing the package, which needs the parameters alone, leaves numba out.
"""

from __future__ import annotations

import math
from typing import Any

import numba as nb

from animarl_envs import locomotion
from animarl_envs.arena import SHAPE_CODES
from animarl_envs.compiling import part

SQUARE, DISC = SHAPE_CODES["square"], SHAPE_CODES["disc"]

next_velocity: Any = nb.njit(inline="always")(locomotion.next_velocity)
"""One component of ``v' = (1 - d) v + u a dt``."""


@part
def rebound(field, position, velocity):  # type: ignore[no-untyped-def]
    """Hold everybody at the walls: the velocity into the wall is lost, that along it kept.

    Positions and velocities are ``(K, 2, B)``; ``field`` is ``(shape code, size, boundary)``.
    """
    shape, size, _ = field
    K, _, B = position.shape
    for i in range(K):
        if shape == SQUARE:
            for x in range(2):
                for b in range(B):
                    p = position[i, x, b]
                    v = velocity[i, x, b]
                    held = min(size, max(-size, p))
                    into = p != held and v * p > 0.0
                    position[i, x, b] = held
                    velocity[i, x, b] = 0.0 if into else v
        elif shape == DISC:
            for b in range(B):
                x = position[i, 0, b]
                y = position[i, 1, b]
                radius = math.sqrt(x * x + y * y)
                beyond = radius > size
                # a hair inside, so that rounding does not leave it outside
                back = size / radius * (1.0 - 1e-12) if beyond else 1.0
                nx = x / radius if beyond else 0.0
                ny = y / radius if beyond else 0.0
                into = max(0.0, velocity[i, 0, b] * nx + velocity[i, 1, b] * ny)
                position[i, 0, b] = back * x
                position[i, 1, b] = back * y
                velocity[i, 0, b] -= into * nx
                velocity[i, 1, b] -= into * ny
