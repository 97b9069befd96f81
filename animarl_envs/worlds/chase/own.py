"""What individuals observe of themselves, see :mod:`animarl_envs.worlds.chase.senses`."""

from __future__ import annotations

import math

import numpy as np

from animarl_envs.compiling import part
from animarl_envs.worlds.chase import layout
from animarl_envs.worlds.exponential import log_of, tanh_of, tanh_tripled

ABSENT, REST, HARDEST, FAINT = layout.ABSENT, layout.REST, layout.HARDEST, layout.FAINT


@part
def observe_own(  # type: ignore[no-untyped-def]
    i, position, velocity, acceleration, past, steps, towards, first, stride, factor, limit,
    observation,
):  # fmt: skip
    """Own position, velocity on several scales, acceleration, and what a species senses beside.

    ``factor`` applies to the velocities that have no scale.
    """
    place, focus = first[0, layout.POSITION], first[0, layout.FOCUS]
    B = position.shape[2]
    if place != ABSENT:
        for x in range(2):
            for b in range(B):
                observation[i, place + x, b] = position[i, x, b]
                observation[i, focus + x, b] = towards[i, x, b]
    at = first[0, layout.VELOCITY]
    for b in range(B):
        vx, vy = factor * velocity[i, 0, b], factor * velocity[i, 1, b]
        ahead, left = egocentric(vx, vy, i, b, towards)
        observation[i, at, b] = ahead
        observation[i, at + 1, b] = left
    at = first[0, layout.PLANE_VELOCITY]
    if at != ABSENT:
        for b in range(B):
            observation[i, at, b] = factor * velocity[i, 0, b]
            observation[i, at + 1, b] = factor * velocity[i, 1, b]
    at = first[0, layout.ACCELERATION]
    if at != ABSENT:
        for b in range(B):
            ahead, left = egocentric(acceleration[i, 0, b], acceleration[i, 1, b], i, b, towards)
            observation[i, at, b] = min(HARDEST, max(-HARDEST, ahead))
            observation[i, at + 1, b] = min(HARDEST, max(-HARDEST, left))
    if first[0, layout.FINE] != ABSENT:
        _observe_scales(
            i, velocity, towards, first[0, layout.FINE], first[0, layout.COARSE],
            first[0, layout.LOG_SPEED], stride, observation,
        )  # fmt: skip
    if first[0, layout.COURSE] != ABSENT:
        course, push = first[0, layout.COURSE], first[0, layout.PUSH]
        _observe_direction(i, velocity, towards, course, FAINT * stride, observation)
        _observe_direction(i, acceleration, towards, push, FAINT, observation)
    if first[0, layout.TIME] != ABSENT:
        _observe_time(i, steps, first, limit, observation)
    for scale in range(past.shape[0]):
        at = 3 * scale
        _observe_scales(
            i, past[scale], towards, first[0, layout.FINE_PAST + at],
            first[0, layout.COARSE_PAST + at], first[0, layout.LOG_PAST + at], stride,
            observation,
        )  # fmt: skip


@part
def _observe_scales(i, velocity, towards, fine, coarse, log, stride, observation):  # type: ignore[no-untyped-def]
    """Own velocity where small differences show: recorded animals are slow most of the time."""
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
        observation[i, fine, b] = tanh_tripled(ahead)
        observation[i, fine + 1, b] = tanh_tripled(left)
    for b in range(velocity.shape[2]):
        vx = velocity[i, 0, b] * per_stride
        vy = velocity[i, 1, b] * per_stride
        observation[i, log, b] = log_of(np.float32(math.sqrt(vx * vx + vy * vy) + REST))


@part
def _observe_direction(i, vector, towards, at, faint, observation):  # type: ignore[no-untyped-def]
    """Whereto a vector points, by the second to fourth harmonic: powers of the unit vector."""
    for b in range(vector.shape[2]):
        ahead, left = egocentric(vector[i, 0, b], vector[i, 1, b], i, b, towards)
        length = math.sqrt(ahead * ahead + left * left)
        per_length = 1.0 / length if length > 0.0 else 0.0
        x = ahead * per_length
        y = left * per_length
        clear = length / (length + faint)
        x2 = x * x - y * y
        y2 = 2.0 * x * y
        observation[i, at, b] = clear * x2
        observation[i, at + 1, b] = clear * y2
        observation[i, at + 2, b] = clear * (x2 * x - y2 * y)
        observation[i, at + 3, b] = clear * (x2 * y + y2 * x)
        observation[i, at + 4, b] = clear * (x2 * x2 - y2 * y2)
        observation[i, at + 5, b] = clear * (2.0 * x2 * y2)


@part
def _observe_time(i, steps, first, limit, observation):  # type: ignore[no-untyped-def]
    """How long the episode has lasted; recordings may go on beyond the limit."""
    at = first[0, layout.TIME]
    for b in range(len(steps)):
        observation[i, at, b] = log_of(np.float32(1 + min(steps[b], limit)))


@part
def egocentric(x, y, i, b, towards):  # type: ignore[no-untyped-def]
    """A vector ahead and to the left of individual ``i``, float32."""
    ex = towards[i, 0, b]
    ey = towards[i, 1, b]
    return np.float32(x * ex + y * ey), np.float32(y * ex - x * ey)
