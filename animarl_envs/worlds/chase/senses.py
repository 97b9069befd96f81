"""What the individuals of a chase observe, as loops over copies.

Arrays as in :mod:`animarl_envs.worlds.chase.kernels`; ``others`` ``(K - 1, RELATIVE, B)`` holds
what one individual sees of the others, in order. What is written, and where, is the table of
:mod:`animarl_envs.worlds.chase.layout`: a group that is absent there is not computed.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from animarl_envs.arena import SHAPE_CODES
from animarl_envs.compiling import jit, part
from animarl_envs.species import ChaseSpecies
from animarl_envs.worlds.arctangent import angle_of
from animarl_envs.worlds.chase import layout
from animarl_envs.worlds.exponential import log_of, tanh_of

DX, DY, DVX, DVY, APART = 0, 1, 2, 3, 4
RELATIVE = 5
ABSENT, REST, HARDEST = layout.ABSENT, layout.REST, layout.HARDEST
SQUARE = SHAPE_CODES["square"]


class Senses(NamedTuple):
    """Numbers of the senses, as the kernels need them."""

    first: NDArray[np.int64]  # of layout.first_rows
    stride: NDArray[np.float64]  # u dt of each individual [arena unit / s]
    near: float  # added to distances before they are inverted [arena unit]
    shape: int
    edge: float  # half side or radius [arena unit]


def senses_of(species: ChaseSpecies) -> Senses:
    """The senses of a species."""
    arena = species.arena
    return Senses(
        layout.first_rows(species),
        np.array([m.thrust * species.dt for m in species.locomotion]),
        layout.NEAR * arena.size,
        SHAPE_CODES[arena.shape],
        arena.edge,
    )


@jit
def observe(position, velocity, acceleration, towards, others, senses, observation):  # type: ignore[no-untyped-def]
    """Focus directions and observations; ``others`` is scratch, ``(K - 1, 5, B)``.

    ``acceleration`` ``(K, 2, B)`` is that of the last step, in multiples of the thrust.

    The others in order: target first, then pursuers by distance, ties by index. The first of them
    is the focus. At distance zero the old direction towards it is kept.
    """
    K = position.shape[0]
    target = K - 1
    first, stride, near, shape, edge = senses
    for i in range(K):
        ranks = 0
        if i != target:
            _relate(i, target, ranks, position, velocity, others)
            ranks = 1
        sorted_from = ranks
        for j in range(target):
            if j != i:
                _relate(i, j, ranks, position, velocity, others)
                ranks += 1
        for last in range(ranks - 1, sorted_from, -1):  # stable bubble sort, without branches
            for rank in range(sorted_from, last):
                _order(rank, others)
        _observe_own(
            i, position, velocity, acceleration, others, towards, first, stride[i], observation
        )
        for rank in range(ranks):
            _observe_other(i, rank, position, velocity, others, towards, first, near, observation)
        _observe_field(i, position, towards, first, shape, edge, observation)


@part
def _relate(i, j, rank, position, velocity, others):  # type: ignore[no-untyped-def]
    """Position, velocity and distance of ``j`` relative to ``i``, arena frame."""
    for b in range(position.shape[2]):
        dx = position[j, 0, b] - position[i, 0, b]
        dy = position[j, 1, b] - position[i, 1, b]
        others[rank, DX, b] = dx
        others[rank, DY, b] = dy
        others[rank, DVX, b] = velocity[j, 0, b] - velocity[i, 0, b]
        others[rank, DVY, b] = velocity[j, 1, b] - velocity[i, 1, b]
        others[rank, APART, b] = math.sqrt(dx * dx + dy * dy)


@part
def _order(rank, others):  # type: ignore[no-untyped-def]
    """Exchange this other individual and the next where this one is the farther."""
    for b in range(others.shape[2]):
        swap = others[rank, APART, b] > others[rank + 1, APART, b]
        for row in range(RELATIVE):
            one = others[rank, row, b]
            two = others[rank + 1, row, b]
            others[rank, row, b] = two if swap else one
            others[rank + 1, row, b] = one if swap else two


@part
def _observe_own(  # type: ignore[no-untyped-def]
    i, position, velocity, acceleration, others, towards, first, stride, observation
):
    """Own position, direction of the focus, own acceleration, and velocity on several scales."""
    place, focus = first[0, layout.POSITION], first[0, layout.FOCUS]
    B = position.shape[2]
    for x in range(2):
        for b in range(B):
            apart = others[0, APART, b]
            e = others[0, DX + x, b] / apart if apart > 0.0 else towards[i, x, b]
            towards[i, x, b] = e
            observation[i, place + x, b] = position[i, x, b]
            observation[i, focus + x, b] = e
    at = first[0, layout.VELOCITY]
    for b in range(B):
        ahead, left = _egocentric(velocity[i, 0, b], velocity[i, 1, b], i, b, towards)
        observation[i, at, b] = ahead
        observation[i, at + 1, b] = left
    at = first[0, layout.PLANE_VELOCITY]
    if at != ABSENT:
        for b in range(B):
            observation[i, at, b] = velocity[i, 0, b]
            observation[i, at + 1, b] = velocity[i, 1, b]
    at = first[0, layout.ACCELERATION]
    if at != ABSENT:
        for b in range(B):
            ahead, left = _egocentric(acceleration[i, 0, b], acceleration[i, 1, b], i, b, towards)
            observation[i, at, b] = min(HARDEST, max(-HARDEST, ahead))
            observation[i, at + 1, b] = min(HARDEST, max(-HARDEST, left))
    if first[0, layout.FINE] != ABSENT:
        _observe_scales(i, velocity, towards, first, stride, observation)


@part
def _observe_scales(i, velocity, towards, first, stride, observation):  # type: ignore[no-untyped-def]
    """Own velocity where small differences show: recorded animals are slow most of the time."""
    fine, coarse = first[0, layout.FINE], first[0, layout.COARSE]
    at = first[0, layout.LOG_SPEED]
    per_stride = 1.0 / stride
    for b in range(velocity.shape[2]):
        vx = velocity[i, 0, b] * per_stride
        vy = velocity[i, 1, b] * per_stride
        ex = towards[i, 0, b]
        ey = towards[i, 1, b]
        ahead = tanh_of((vx * ex + vy * ey) / 3.0)
        left = tanh_of((vy * ex - vx * ey) / 3.0)
        observation[i, coarse, b] = ahead
        observation[i, coarse + 1, b] = left
        observation[i, fine, b] = _tripled(ahead)
        observation[i, fine + 1, b] = _tripled(left)
    for b in range(velocity.shape[2]):
        vx = velocity[i, 0, b] * per_stride
        vy = velocity[i, 1, b] * per_stride
        observation[i, at, b] = log_of(np.float32(math.sqrt(vx * vx + vy * vy) + REST))


@part
def _tripled(t):  # type: ignore[no-untyped-def]
    """``tanh(3 a)`` of ``t = tanh(a)``."""
    return t * (3.0 + t * t) / (1.0 + 3.0 * t * t)


@part
def _observe_other(i, rank, position, velocity, others, towards, first, near, observation):  # type: ignore[no-untyped-def]
    """One of the others, seen from individual ``i``."""
    who = rank + 1
    at, apart_at = first[who, layout.PLACE], first[who, layout.DISTANCE]
    bearing_at, circle = first[who, layout.BEARING], first[who, layout.BEARING_CIRCLE]
    B = others.shape[2]
    for b in range(B):
        observation[i, apart_at, b] = others[rank, APART, b]
    if at != ABSENT:
        for b in range(B):
            ahead, left = _egocentric(others[rank, DX, b], others[rank, DY, b], i, b, towards)
            observation[i, at, b] = ahead
            # the focus lies straight ahead, by definition
            observation[i, at + 1, b] = np.float32(0.0) if rank == 0 else left
    if bearing_at != ABSENT:
        for b in range(B):
            ahead, left = _egocentric(others[rank, DX, b], others[rank, DY, b], i, b, towards)
            observation[i, bearing_at, b] = np.float32(0.0) if rank == 0 else angle_of(ahead, left)
    at = first[who, layout.DRIFT]
    for b in range(B):
        ahead, left = _egocentric(others[rank, DVX, b], others[rank, DVY, b], i, b, towards)
        observation[i, at, b] = ahead
        observation[i, at + 1, b] = left
    if circle != ABSENT:
        _observe_directions(
            i, rank, circle, first[rank + 1, layout.DIRECTION], others, towards, observation
        )
    if first[who, layout.NEARNESS] != ABSENT:
        _observe_in_arena(i, rank, position, velocity, others, first, near, observation)


@part
def _observe_directions(i, rank, circle, plane, others, towards, observation):  # type: ignore[no-untyped-def]
    """Unit vectors towards another who is not the focus; of one at the same place, the focus'."""
    for b in range(others.shape[2]):
        apart = others[rank, APART, b]
        ex = towards[i, 0, b]
        ey = towards[i, 1, b]
        ux = others[rank, DX, b] / apart if apart > 0.0 else ex
        uy = others[rank, DY, b] / apart if apart > 0.0 else ey
        observation[i, plane, b] = ux
        observation[i, plane + 1, b] = uy
        observation[i, circle, b] = ux * ex + uy * ey
        observation[i, circle + 1, b] = uy * ex - ux * ey


@part
def _observe_in_arena(i, rank, position, velocity, others, first, near, observation):  # type: ignore[no-untyped-def]
    """How near another is, and where it is and goes in the arena frame."""
    who = rank + 1
    inverse = first[who, layout.NEARNESS]
    place, going = first[who, layout.OTHER_POSITION], first[who, layout.OTHER_VELOCITY]
    offset = first[who, layout.OFFSET]
    B = others.shape[2]
    for b in range(B):
        observation[i, inverse, b] = 1.0 / (others[rank, APART, b] + near)
    for x in range(2):
        for b in range(B):
            observation[i, offset + x, b] = others[rank, DX + x, b]
            observation[i, place + x, b] = position[i, x, b] + others[rank, DX + x, b]
            observation[i, going + x, b] = velocity[i, x, b] + others[rank, DVX + x, b]


@part
def _observe_field(i, position, towards, first, shape, edge, observation):  # type: ignore[no-untyped-def]
    """The centre and the edge of the arena."""
    B = position.shape[2]
    at = first[0, layout.CENTRE_DISTANCE]
    if at != ABSENT:
        for b in range(B):
            x = position[i, 0, b]
            y = position[i, 1, b]
            observation[i, at, b] = math.sqrt(x * x + y * y)
    at = first[0, layout.EDGE]
    if at == ABSENT:
        return
    for b in range(B):
        x = position[i, 0, b]
        y = position[i, 1, b]
        out = max(abs(x), abs(y)) if shape == SQUARE else math.sqrt(x * x + y * y)
        observation[i, at, b] = edge - out
    at = first[0, layout.CENTRE]
    for b in range(B):
        ahead, left = _egocentric(-position[i, 0, b], -position[i, 1, b], i, b, towards)
        observation[i, at, b] = ahead
        observation[i, at + 1, b] = left


@part
def _egocentric(x, y, i, b, towards):  # type: ignore[no-untyped-def]
    """A vector ahead and to the left of individual ``i``, float32."""
    ex = towards[i, 0, b]
    ey = towards[i, 1, b]
    return np.float32(x * ex + y * ey), np.float32(y * ex - x * ey)
