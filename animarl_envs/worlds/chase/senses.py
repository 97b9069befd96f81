"""What the individuals of a chase observe, as loops over copies.

Arrays as in :mod:`animarl_envs.worlds.chase.kernels`; ``others`` holds what one individual sees of
the others, in order (:mod:`animarl_envs.worlds.chase.neighbours`). What is written, and where, is
the table of :mod:`animarl_envs.worlds.chase.layout`: a group that is absent there is not computed.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from animarl_envs.arena import SHAPE_CODES
from animarl_envs.array_types import Bools, Floats, Ints
from animarl_envs.compiling import inline_kernel, inline_wrapper, jit
from animarl_envs.focus import COURSE, FALLBACK, averaged, direction_of
from animarl_envs.species import COMPACT, ChaseSpecies
from animarl_envs.worlds.chase.headings import observe_headings, set_facing
from animarl_envs.worlds.chase.layout import (
    ABSENT,
    BODY,
    DELAYS,
    FAINT,
    HARDEST,
    MEMORY,
    NEAR,
    REACH,
    RECALLED,
    REST,
    ChaseGroup,
    first_rows,
    past_scales,
    past_shares,
)
from animarl_envs.worlds.chase.neighbours import (
    APART,
    DVX,
    DX,
    DY,
    find_focus,
    lay_out,
    line_up,
    look,
    look_around,
)
from animarl_envs.worlds.streams import (
    ONE,
    TWO,
    ZERO,
    angle_of,
    bounded,
    log_of,
    tanh_of,
    tanh_tripled,
)

FINE, FINE_PAST, FINE_MEMORY = map(
    int, (ChaseGroup.FINE, ChaseGroup.FINE_SHORT, ChaseGroup.FINE_MEMORY)
)
ON_COURSE, SPANS = MEMORY.index(COURSE), len(MEMORY)
SQUARE = SHAPE_CODES["square"]
# What ends in float32 is computed in it: a vector instruction takes eight copies, of float64 four.
_THIRD: Any = np.float32(1.0 / 3.0)


class ChaseSenses(NamedTuple):
    """Numbers of the senses, as the kernels need them."""

    first: Ints  # of first_rows
    observers: Bools  # whose observations are made
    stride: Floats  # what its smallest thrust changes in a step [arena unit / s]
    damping: Floats  # share of the velocity lost in a step
    push: Floats  # u dt, the unit of accelerations in a step [arena unit / s]
    own_velocity: Floats  # factor on own velocities without a scale
    near: float  # added to distances before they are inverted [arena unit]
    scales: tuple[float, float]  # of the distance to a wall [arena unit]
    shape: int
    edge: float  # half side or radius [arena unit]
    holes: Floats  # (obstacles, 3): x, y and radius [arena unit]
    landmarks: Floats  # (landmarks, 2) [arena unit]
    size: float  # of the arena of training [arena unit]
    limit: int  # of an episode [steps]
    shares: Floats  # of a step in each average of the past
    dt: float  # [s]


def senses_of(species: ChaseSpecies, observers: Bools) -> ChaseSenses:
    """Return the senses of a species; ``observers`` ``(K,)`` marks whose observations are made."""
    arena, scales = species.arena, species.scales
    return ChaseSenses(
        first_rows(species),
        observers,
        np.array([m.smallest_thrust * scales.dt for m in scales.locomotion]),
        np.array([m.damping for m in scales.locomotion]),
        np.array([m.thrust * scales.dt for m in scales.locomotion]),
        np.array(scales.own_velocity),
        NEAR * scales.arena_size,
        (BODY * scales.arena_size, REACH * scales.arena_size),
        SHAPE_CODES[arena.shape],
        arena.edge,
        arena.holes,
        np.array([place for _, *place in arena.landmarks]).reshape(-1, 2),
        float(scales.arena_size),
        scales.time_limit,
        past_shares(species),
        species.dt,
    )


def branches_of(species: ChaseSpecies) -> tuple[bool | None, bool | None, bool | None]:
    """Return ``free``, ``headed`` and ``full`` of :func:`observe`; None is not compiled."""
    full = species.observation != COMPACT
    return species.free or None, species.has_headings or None, full or None


@inline_wrapper
def observe(  # type: ignore[no-untyped-def]
    position,
    velocity,
    acceleration,
    past,
    steps,
    towards,
    bodies,
    neighbours,
    senses,
    free,
    headed,
    full,
    observation,
):
    """Compute focus directions of all and the observers' observations.

    ``neighbours`` is scratch, and so is of ``bodies`` what is not a state.

    ``acceleration`` ``(K, 2, B)`` is that of the last step, in multiples of the thrust, ``past``
    ``(scales, K, 2, B)`` are mean velocities (:func:`remember`), none where they are not seen, and
    ``steps`` ``(B,)`` count from the start. The first of the others is the focus; see
    :data:`animarl_envs.focus.FALLBACK` for distance zero. ``free`` is None where there is a focus,
    so that each has its course for it and sees its nearest few; ``full`` where only the compact
    observation is wanted, ``headed`` where headings are no state.
    """
    first, observers, stride, own_velocity = (
        senses.first,
        senses.observers,
        senses.stride,
        senses.own_velocity,
    )
    near, scales, shape, edge = senses.near, senses.scales, senses.shape, senses.edge
    others = neighbours.others
    set_facing(bodies, headed)
    lay_out(position, velocity, observers, neighbours.order, neighbours.state)
    if free is not None and observers.any():
        line_up(neighbours.state, neighbours.along)
    for i in range(position.shape[0]):
        if free is None:
            faced = 1  # how many of the others lie straight ahead by definition
            if observers[i]:
                seen = look(i, position, velocity, neighbours.order, neighbours)
            else:
                find_focus(i, position, others)
                seen = 0
            _set_focus(i, others, towards)
        else:
            faced = 0
            _update_course(i, velocity, past, steps, senses, towards)
            seen = look_around(i, neighbours) if observers[i] else 0
        if not observers[i]:
            continue
        _observe_motion(i, velocity, acceleration, towards, first, own_velocity[i], observation)
        _observe_others(i, seen, faced, others, towards, first, observation)
        _observe_field(i, position, towards, first, shape, edge, observation)
        _observe_landmarks(i, position, towards, senses, observation)
        observe_headings(i, seen, towards, first, others, bodies, headed, observation)
        if full is not None:
            observe_own(
                i,
                position,
                velocity,
                acceleration,
                past,
                steps,
                towards,
                first,
                stride[i],
                own_velocity[i],
                senses.limit,
                bodies,
                observation,
            )
            _observe_more_of_others(
                i, seen, faced, position, velocity, others, towards, first, near, observation
            )
            if first[0, ChaseGroup.AT_WALL] != ABSENT:
                observe_wall(
                    i,
                    position,
                    velocity,
                    towards,
                    first,
                    stride[i],
                    scales,
                    shape,
                    edge,
                    senses.holes,
                    observation,
                )


@inline_kernel
def _set_focus(i, others, towards):  # type: ignore[no-untyped-def]
    """Set the unit vector towards the focus, which is the first of the others."""
    for x in range(2):
        for b in range(others.shape[2]):
            apart = others[0, APART, b]
            towards[i, x, b] = others[0, DX + x, b] / apart if apart > 0.0 else FALLBACK[x]


@inline_kernel
def _update_course(i, velocity, past, steps, senses, towards):  # type: ignore[no-untyped-def]
    """Set the focus direction of a free animal, by its mean velocity up to the present."""
    share = senses.shares[ON_COURSE]
    for b in range(velocity.shape[2]):
        mx, my = past[ON_COURSE, i, 0, b], past[ON_COURSE, i, 1, b]
        dx = averaged(mx, velocity[i, 0, b], share, steps[b])
        dy = averaged(my, velocity[i, 1, b], share, steps[b])
        towards[i, 0, b], towards[i, 1, b] = direction_of(dx, dy)


@inline_kernel
def egocentric(x, y, i, b, towards):  # type: ignore[no-untyped-def]
    """Return a vector as ahead and left of individual ``i``, float32."""
    ex = towards[i, 0, b]
    ey = towards[i, 1, b]
    return np.float32(x * ex + y * ey), np.float32(y * ex - x * ey)


@inline_kernel
def _put(i, at, source, j, k, factor, towards, observation):  # type: ignore[no-untyped-def]
    """Write ``factor`` times rows k and k + 1 of ``source[j]``, a vector, in the frame of ``i``."""
    if at == ABSENT:
        return
    for b in range(source.shape[2]):
        x, y = factor * source[j, k, b], factor * source[j, k + 1, b]
        ahead, left = egocentric(x, y, i, b, towards)
        observation[i, at, b] = ahead
        observation[i, at + 1, b] = left


@inline_kernel
def _put_plane(i, at, source, j, k, factor, observation):  # type: ignore[no-untyped-def]
    """Write such a vector in the arena frame."""
    if at == ABSENT:
        return
    for x in range(2):
        for b in range(source.shape[2]):
            observation[i, at + x, b] = factor * source[j, k + x, b]


# -- the others -----------------------------------------------------------------------------------


@inline_kernel
def _observe_others(i, seen, faced, others, towards, first, observation):  # type: ignore[no-untyped-def]
    """Observe the others from individual ``i``; ``faced`` of them lie straight ahead."""
    B = others.shape[2]
    for rank in range(seen):
        row = rank + 1
        for b in range(B):
            observation[i, first[row, ChaseGroup.DISTANCE], b] = others[rank, APART, b]
        _put(i, first[row, ChaseGroup.PLACE], others, rank, DX, 1.0, towards, observation)
        if rank < faced and first[row, ChaseGroup.PLACE] != ABSENT:
            for b in range(B):
                observation[i, first[row, ChaseGroup.PLACE] + 1, b] = 0.0
        _put(i, first[row, ChaseGroup.DRIFT], others, rank, DVX, 1.0, towards, observation)


@inline_kernel
def _observe_more_of_others(  # type: ignore[no-untyped-def]
    i, seen, faced, position, velocity, others, towards, first, near, observation
):
    """Observe of the others what the compact observation leaves out."""
    B = others.shape[2]
    for rank in range(seen):
        row = rank + 1
        bearing_at, inverse_at = first[row, ChaseGroup.BEARING], first[row, ChaseGroup.NEARNESS]
        place, going = first[row, ChaseGroup.OTHER_POSITION], first[row, ChaseGroup.OTHER_VELOCITY]
        if bearing_at != ABSENT:
            for b in range(B):
                ahead, left = egocentric(others[rank, DX, b], others[rank, DY, b], i, b, towards)
                observation[i, bearing_at, b] = ZERO if rank < faced else angle_of(ahead, left)
        if rank >= faced and first[row, ChaseGroup.BEARING_CIRCLE] != ABSENT:
            _observe_direction_of(i, rank, others, towards, first, observation)
        if inverse_at != ABSENT:
            for b in range(B):
                observation[i, inverse_at, b] = ONE / np.float32(others[rank, APART, b] + near)
        _put_plane(i, first[row, ChaseGroup.OFFSET], others, rank, DX, 1.0, observation)
        if place != ABSENT:
            for x in range(2):
                for b in range(B):
                    observation[i, place + x, b] = position[i, x, b] + others[rank, DX + x, b]
                    observation[i, going + x, b] = velocity[i, x, b] + others[rank, DVX + x, b]


@inline_kernel
def _observe_direction_of(i, rank, others, towards, first, observation):  # type: ignore[no-untyped-def]
    """Observe the unit vector towards another that is not the focus; at distance 0 the focus'."""
    circle, plane = (
        first[rank + 1, ChaseGroup.BEARING_CIRCLE],
        first[rank + 1, ChaseGroup.DIRECTION],
    )
    for b in range(others.shape[2]):
        apart = np.float32(others[rank, APART, b])
        ex = np.float32(towards[i, 0, b])
        ey = np.float32(towards[i, 1, b])
        ux = np.float32(others[rank, DX, b]) / apart if apart > ZERO else ex
        uy = np.float32(others[rank, DY, b]) / apart if apart > ZERO else ey
        if plane != ABSENT:
            observation[i, plane, b] = ux
            observation[i, plane + 1, b] = uy
        observation[i, circle, b] = bounded(ux * ex + uy * ey)
        observation[i, circle + 1, b] = bounded(uy * ex - ux * ey)


@inline_kernel
def _observe_field(i, position, towards, first, shape, edge, observation):  # type: ignore[no-untyped-def]
    """Observe the centre and the edge of the arena."""
    centre_at, edge_at = first[0, ChaseGroup.CENTRE_DISTANCE], first[0, ChaseGroup.EDGE]
    far = np.float32(edge)
    for b in range(position.shape[2]):
        x = np.float32(position[i, 0, b])
        y = np.float32(position[i, 1, b])
        radius = math.sqrt(x * x + y * y)
        if centre_at != ABSENT:
            observation[i, centre_at, b] = radius
        if edge_at != ABSENT:
            observation[i, edge_at, b] = far - (max(abs(x), abs(y)) if shape == SQUARE else radius)
    _put(i, first[0, ChaseGroup.CENTRE], position, i, 0, -1.0, towards, observation)


@inline_kernel
def _observe_landmarks(i, position, towards, senses, observation):  # type: ignore[no-untyped-def]
    """Observe direction and distance of landmarks; one infinitely far has no direction."""
    for k in range(len(senses.landmarks)):
        circle = senses.first[-1 - k, ChaseGroup.LANDMARK_CIRCLE]
        away = senses.first[-1 - k, ChaseGroup.LANDMARK_DISTANCE]
        for b in range(position.shape[2]):
            dx = senses.landmarks[k, 0] - position[i, 0, b]
            dy = senses.landmarks[k, 1] - position[i, 1, b]
            apart = math.sqrt(dx * dx + dy * dy)
            seen = 0.0 < apart < np.inf
            x, y = (dx / apart, dy / apart) if seen else (0.0, 0.0)
            ahead, left = egocentric(x, y, i, b, towards)
            observation[i, circle, b] = bounded(ahead)
            observation[i, circle + 1, b] = bounded(left)
            observation[i, away, b] = tanh_of(np.float32(apart / senses.size))


# -- oneself --------------------------------------------------------------------------------------


@inline_kernel
def _observe_motion(i, velocity, acceleration, towards, first, factor, observation):  # type: ignore[no-untyped-def]
    """Observe own velocity and acceleration; ``factor`` applies to velocities without a scale."""
    _put(i, first[0, ChaseGroup.VELOCITY], velocity, i, 0, factor, towards, observation)
    at = first[0, ChaseGroup.ACCELERATION]
    _put(i, at, acceleration, i, 0, 1.0, towards, observation)
    if at != ABSENT:
        for row in range(at, at + 2):
            for b in range(velocity.shape[2]):
                observation[i, row, b] = min(HARDEST, max(-HARDEST, observation[i, row, b]))


@inline_kernel
def observe_own(  # type: ignore[no-untyped-def]
    i,
    position,
    velocity,
    acceleration,
    past,
    steps,
    towards,
    first,
    stride,
    factor,
    limit,
    bodies,
    observation,
):
    """Observe own position, velocity on several scales, and the species' further senses.

    ``factor`` applies to the velocities that have no scale.
    """
    B = position.shape[2]
    _put_plane(i, first[0, ChaseGroup.POSITION], position, i, 0, 1.0, observation)
    _put_plane(i, first[0, ChaseGroup.FOCUS], towards, i, 0, 1.0, observation)
    _put_plane(i, first[0, ChaseGroup.PLANE_VELOCITY], velocity, i, 0, factor, observation)
    if first[0, FINE] != ABSENT:
        _observe_scales(i, velocity, towards, first, FINE, stride, observation)
    if first[0, ChaseGroup.COURSE] != ABSENT:
        course, push = first[0, ChaseGroup.COURSE], first[0, ChaseGroup.PUSH]
        _observe_direction(i, velocity, towards, course, np.float32(FAINT * stride), observation)
        _observe_direction(i, acceleration, towards, push, np.float32(FAINT), observation)
    at = first[0, ChaseGroup.TIME]
    if at != ABSENT:  # recordings may go on beyond the limit
        for b in range(B):
            observation[i, at, b] = log_of(np.float32(1 + min(steps[b], limit)))
    _recall(i, past, towards, first, stride, observation)
    at = first[0, ChaseGroup.OWN_TRAITS]
    if at != ABSENT:
        for x in range(2):
            for b in range(B):
                observation[i, at + x, b] = bodies.traits[x, i, b]


@inline_kernel
def _recall(i, past, towards, first, stride, observation):  # type: ignore[no-untyped-def]
    """Observe own velocity in the past, and of free animals their turning and speed."""
    if first[0, FINE_PAST] != ABSENT:
        for scale in range(past.shape[0]):
            at = FINE_PAST + 3 * scale
            _observe_scales(i, past[scale], towards, first, at, stride, observation)
    if first[0, FINE_MEMORY] != ABSENT:
        for scale in range(SPANS):
            at = FINE_MEMORY + RECALLED * scale
            _observe_scales(i, past[scale], towards, first, at, stride, observation)
            for b in range(past.shape[3]):
                turn, speed = past[SPANS + scale, i, 0, b], past[SPANS + scale, i, 1, b]
                observation[i, first[0, at + 3], b] = turn
                observation[i, first[0, at + 4], b] = log_of(np.float32(speed / stride + REST))
        at = first[0, ChaseGroup.DELAYED_SPEED]
        for k in range(DELAYS):
            for b in range(past.shape[3]):
                speed = past[2 * SPANS + k // 2, i, k % 2, b]
                observation[i, at + k, b] = log_of(np.float32(speed / stride + REST))


@inline_kernel
def _observe_scales(i, velocity, towards, first, at, stride, observation):  # type: ignore[no-untyped-def]
    """Observe own velocity on three scales, since recorded animals are slow most of the time.

    The first of the three groups, which follow each other, is ``at``.
    """
    fine, coarse, log = first[0, at], first[0, at + 1], first[0, at + 2]
    per_stride = np.float32(1.0 / stride)
    for b in range(velocity.shape[2]):
        vx = np.float32(velocity[i, 0, b]) * per_stride
        vy = np.float32(velocity[i, 1, b]) * per_stride
        ex = np.float32(towards[i, 0, b])
        ey = np.float32(towards[i, 1, b])
        ahead = tanh_of((vx * ex + vy * ey) * _THIRD)
        left = tanh_of((vy * ex - vx * ey) * _THIRD)
        observation[i, coarse, b] = ahead
        observation[i, coarse + 1, b] = left
        observation[i, fine, b] = tanh_tripled(ahead)
        observation[i, fine + 1, b] = tanh_tripled(left)
        observation[i, log, b] = log_of(math.sqrt(vx * vx + vy * vy) + np.float32(REST))


@inline_kernel
def _observe_direction(i, vector, towards, at, faint, observation):  # type: ignore[no-untyped-def]
    """Observe a direction by its second to fourth harmonic: powers of the unit vector."""
    for b in range(vector.shape[2]):
        ahead, left = egocentric(vector[i, 0, b], vector[i, 1, b], i, b, towards)
        length = math.sqrt(ahead * ahead + left * left)
        per_length = ONE / length if length > ZERO else ZERO
        x = ahead * per_length
        y = left * per_length
        clear = length / (length + faint)
        x2 = x * x - y * y
        y2 = TWO * x * y
        observation[i, at, b] = clear * bounded(x2)
        observation[i, at + 1, b] = clear * bounded(y2)
        observation[i, at + 2, b] = clear * bounded(x2 * x - y2 * y)
        observation[i, at + 3, b] = clear * bounded(x2 * y + y2 * x)
        observation[i, at + 4, b] = clear * bounded(x2 * x2 - y2 * y2)
        observation[i, at + 5, b] = clear * bounded(TWO * x2 * y2)


# -- walls ----------------------------------------------------------------------------------------


@inline_kernel
def observe_wall(  # type: ignore[no-untyped-def]
    i, position, velocity, towards, first, stride, scales, shape, edge, holes, observation
):
    """Observe distance and direction of the nearest wall, and own velocity towards and along it.

    The wall may be that of an obstacle. Animals that follow a wall keep a distance too small to see
    in the distance from the centre. From the middle of a disc it lies towards the focus.
    """
    at, by, where = (
        first[0, ChaseGroup.AT_WALL],
        first[0, ChaseGroup.BY_WALL],
        first[0, ChaseGroup.WALL_CIRCLE],
    )
    fine, coarse = first[0, ChaseGroup.FINE_WALL], first[0, ChaseGroup.COARSE_WALL]
    per_stride, far = np.float32(1.0 / stride), np.float32(edge)
    per_body, per_reach = np.float32(1.0 / scales[0]), np.float32(1.0 / scales[1])
    for b in range(position.shape[2]):
        x = np.float32(position[i, 0, b])
        y = np.float32(position[i, 1, b])
        ex = np.float32(towards[i, 0, b])
        ey = np.float32(towards[i, 1, b])
        if shape == SQUARE:
            sideways = abs(x) >= abs(y)
            out = abs(x) if sideways else abs(y)
            nx = math.copysign(ONE, x) if sideways else ZERO
            ny = ZERO if sideways else math.copysign(ONE, y)
        else:
            out = np.sqrt(x * x + y * y)
            nx = x / out if out > ZERO else ex
            ny = y / out if out > ZERO else ey
        observation[i, at, b], observation[i, where, b] = far - out, nx
        observation[i, where + 1, b] = ny
    for k in range(len(holes)):
        middle_x, middle_y = np.float32(holes[k, 0]), np.float32(holes[k, 1])
        radius = np.float32(holes[k, 2])
        # Squares of large radii cancel in float64: a straight wall is a large disc.
        power = np.float32(holes[k, 0] ** 2 + holes[k, 1] ** 2 - holes[k, 2] ** 2)
        for b in range(position.shape[2]):
            x = np.float32(position[i, 0, b])
            y = np.float32(position[i, 1, b])
            dx, dy = middle_x - x, middle_y - y
            away = np.sqrt(dx * dx + dy * dy)
            clear = (x * (x - TWO * middle_x) + y * (y - TWO * middle_y) + power) / (away + radius)
            nearer = clear < observation[i, at, b] and away > ZERO
            per_away = ONE / away if nearer else ONE
            observation[i, at, b] = clear if nearer else observation[i, at, b]
            nx, ny = observation[i, where, b], observation[i, where + 1, b]
            observation[i, where, b] = dx * per_away if nearer else nx
            observation[i, where + 1, b] = dy * per_away if nearer else ny
    for b in range(position.shape[2]):
        ex, ey = np.float32(towards[i, 0, b]), np.float32(towards[i, 1, b])
        near = observation[i, at, b]
        nx, ny = observation[i, where, b], observation[i, where + 1, b]
        observation[i, at, b] = tanh_of(near * per_body)
        observation[i, by, b] = tanh_of(near * per_reach)
        observation[i, where, b] = bounded(nx * ex + ny * ey)
        observation[i, where + 1, b] = bounded(ny * ex - nx * ey)
        vx = np.float32(velocity[i, 0, b]) * per_stride
        vy = np.float32(velocity[i, 1, b]) * per_stride
        outwards = tanh_of((vx * nx + vy * ny) * _THIRD)
        along = tanh_of((vy * nx - vx * ny) * _THIRD)
        observation[i, coarse, b] = outwards
        observation[i, coarse + 1, b] = along
        observation[i, fine, b] = tanh_tripled(outwards)
        observation[i, fine + 1, b] = tanh_tripled(along)


# -- the past -------------------------------------------------------------------------------------


@inline_kernel
def remember(velocity, steps, senses, free, past):  # type: ignore[no-untyped-def]
    """Update the averages with the present, before step number ``steps`` ``(B,)`` is taken."""
    if free is not None:
        for i in range(velocity.shape[0]):
            for b in range(velocity.shape[2]):
                _remember(i, b, b, velocity, steps[b] - 1, senses, past)
        return
    for scale in range(past.shape[0]):
        for i in range(velocity.shape[0]):
            for x in range(2):
                for b in range(velocity.shape[2]):
                    past[scale, i, x, b] = averaged(
                        past[scale, i, x, b], velocity[i, x, b], senses.shares[scale], np.inf
                    )


@inline_kernel
def _remember(i, at, to, velocity, steps, senses, past):  # type: ignore[no-untyped-def]
    """Update a free animal's averages in copy ``to`` from those of ``at`` and its motion."""
    vx, vy = velocity[i, 0, at], velocity[i, 1, at]
    mx, my = past[ON_COURSE, i, 0, at], past[ON_COURSE, i, 1, at]
    nx = averaged(mx, vx, senses.shares[ON_COURSE], steps)
    ny = averaged(my, vy, senses.shares[ON_COURSE], steps)
    turned = angle_of(np.float32(mx * nx + my * ny), np.float32(mx * ny - my * nx)) / senses.dt
    speed = math.sqrt(vx * vx + vy * vy)
    for scale in range(SPANS):
        share, more = senses.shares[scale], SPANS + scale
        past[scale, i, 0, to] = averaged(past[scale, i, 0, at], vx, share, steps)
        past[scale, i, 1, to] = averaged(past[scale, i, 1, at], vy, share, steps)
        past[more, i, 0, to] = averaged(past[more, i, 0, at], turned, share, steps)
        past[more, i, 1, to] = averaged(past[more, i, 1, at], speed, share, steps)
    for k in range(DELAYS):  # each follows what the one before was
        row, x = 2 * SPANS + k // 2, k % 2
        was = past[row, i, x, at]
        past[row, i, x, to] = was + senses.shares[SPANS] * (speed - was)
        speed = was


def first_past(velocity: Floats, mask: Bools, past: Floats) -> None:
    """Set the averages ``(scales, K, 2, B)`` where episodes begin: nothing was before."""
    now = velocity[..., mask]
    past[..., mask] = now
    if len(past) > 2 * SPANS:
        past[SPANS:, :, :, mask] = np.hypot(now[:, 0], now[:, 1])[:, None]
        past[SPANS : 2 * SPANS, :, 0, mask] = 0.0


def remembered(species: ChaseSpecies, velocity: Floats, steps: Ints) -> Floats:
    """Return averages ``(scales, K, 2, frames)`` of recorded velocities ``(K, 2, frames)``.

    ``steps`` ``(frames,)`` count from the start of each episode.
    """
    past = np.zeros((past_scales(species), *velocity.shape))
    if len(past):
        first_past(velocity, steps == 0, past)
        own = senses_of(species, np.zeros(0, dtype=bool))
        _remember_frames(velocity, steps, own, branches_of(species)[0], past)
    return past


@jit
def _remember_frames(velocity, steps, senses, free, past):  # type: ignore[no-untyped-def]
    for i in range(velocity.shape[0]):
        for t in range(1, velocity.shape[2]):
            if steps[t] == 0:
                continue
            if free is not None:
                _remember(i, t - 1, t, velocity, steps[t - 1], senses, past)
                continue
            for scale in range(past.shape[0]):
                for x in range(2):
                    past[scale, i, x, t] = averaged(
                        past[scale, i, x, t - 1],
                        velocity[i, x, t - 1],
                        senses.shares[scale],
                        np.inf,
                    )
