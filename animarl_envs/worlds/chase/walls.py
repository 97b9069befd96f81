"""What individuals observe of the nearest wall, see :mod:`animarl_envs.worlds.chase.senses`."""

from __future__ import annotations

import math

from animarl_envs.arena import SHAPE_CODES
from animarl_envs.compiling import part
from animarl_envs.worlds.chase import layout
from animarl_envs.worlds.exponential import tanh_of, tanh_tripled

SQUARE = SHAPE_CODES["square"]


@part
def observe_wall(  # type: ignore[no-untyped-def]
    i, position, velocity, towards, first, stride, scales, shape, edge, observation
):
    """The nearest wall: how far, in which direction, and the own velocity towards and along it.

    Who walks along a wall keeps a small distance that does not show among distances to the centre.
    From the middle of a disc it lies towards the focus.
    """
    at, by, where = first[0, layout.AT_WALL], first[0, layout.BY_WALL], first[0, layout.WALL_CIRCLE]
    fine, coarse = first[0, layout.FINE_WALL], first[0, layout.COARSE_WALL]
    per_stride = 1.0 / stride
    for b in range(position.shape[2]):
        x = position[i, 0, b]
        y = position[i, 1, b]
        ex = towards[i, 0, b]
        ey = towards[i, 1, b]
        if shape == SQUARE:
            sideways = abs(x) >= abs(y)
            out = abs(x) if sideways else abs(y)
            nx = math.copysign(1.0, x) if sideways else 0.0
            ny = 0.0 if sideways else math.copysign(1.0, y)
        else:
            out = math.sqrt(x * x + y * y)
            nx = x / out if out > 0.0 else ex
            ny = y / out if out > 0.0 else ey
        near = edge - out
        observation[i, at, b] = tanh_of(near / scales[0])
        observation[i, by, b] = tanh_of(near / scales[1])
        observation[i, where, b] = nx * ex + ny * ey
        observation[i, where + 1, b] = ny * ex - nx * ey
        vx = velocity[i, 0, b] * per_stride
        vy = velocity[i, 1, b] * per_stride
        outwards = tanh_of((vx * nx + vy * ny) / 3.0)
        along = tanh_of((vy * nx - vx * ny) / 3.0)
        observation[i, coarse, b] = outwards
        observation[i, coarse + 1, b] = along
        observation[i, fine, b] = tanh_tripled(outwards)
        observation[i, fine + 1, b] = tanh_tripled(along)
