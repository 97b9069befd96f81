"""What the individuals of a chase observe, as loops over copies.

Arrays as in :mod:`animarl_envs.worlds.chase.kernels`; ``others`` holds what one individual sees of
the others, in order (:mod:`animarl_envs.worlds.chase.neighbours`). What is written, and where, is
the table of :mod:`animarl_envs.worlds.chase.layout`: a group that is absent there is not computed.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from animarl_envs.arena import SHAPE_CODES
from animarl_envs.compiling import jit, part
from animarl_envs.focus import FALLBACK
from animarl_envs.species import ChaseSpecies
from animarl_envs.worlds.arctangent import angle_of
from animarl_envs.worlds.chase import layout
from animarl_envs.worlds.chase.headings import face, observe_headings
from animarl_envs.worlds.chase.neighbours import (
    APART,
    DVX,
    DVY,
    DX,
    DY,
    find_focus,
    lay_out,
    look,
)
from animarl_envs.worlds.chase.own import egocentric, observe_own
from animarl_envs.worlds.chase.walls import observe_wall

ABSENT = layout.ABSENT
SQUARE = SHAPE_CODES["square"]


class Senses(NamedTuple):
    """Numbers of the senses, as the kernels need them."""

    first: NDArray[np.int64]  # of layout.first_rows
    observers: NDArray[np.bool_]  # whose observations are made
    stride: NDArray[np.float64]  # what its smallest thrust changes in a step [arena unit / s]
    damping: NDArray[np.float64]  # share of the velocity lost in a step
    push: NDArray[np.float64]  # u dt, the unit of accelerations in a step [arena unit / s]
    own_velocity: NDArray[np.float64]  # factor on own velocities without a scale
    near: float  # added to distances before they are inverted [arena unit]
    scales: tuple[float, float]  # of the distance to a wall [arena unit]
    shape: int
    edge: float  # half side or radius [arena unit]
    limit: int  # of an episode [steps]


def senses_of(species: ChaseSpecies, observers: NDArray[np.bool_]) -> Senses:
    """The senses of a species; ``observers`` ``(K,)`` tells whose observations are made."""
    arena, scales = species.arena, species.scales
    return Senses(
        layout.first_rows(species),
        observers,
        np.array([m.smallest_thrust * scales.dt for m in scales.locomotion]),
        np.array([m.damping for m in scales.locomotion]),
        np.array([m.thrust * scales.dt for m in scales.locomotion]),
        np.array(scales.own_velocity),
        layout.NEAR * scales.arena_size,
        (layout.BODY * scales.arena_size, layout.REACH * scales.arena_size),
        SHAPE_CODES[arena.shape],
        arena.edge,
        scales.time_limit,
    )


@jit
def observe(  # type: ignore[no-untyped-def]
    position, velocity, acceleration, past, steps, towards, bodies, neighbours, senses, observation
):
    """Focus directions of all and the observers' observations; ``neighbours`` is scratch, and of
    ``bodies`` what is no state.

    ``acceleration`` ``(K, 2, B)`` is that of the last step, in multiples of the thrust, ``past``
    ``(scales, K, 2, B)`` are mean velocities (module ``past``), none where they are not seen, and
    ``steps`` ``(B,)`` count from the start. The first of the others is the focus; see
    :data:`animarl_envs.focus.FALLBACK` for distance zero.
    """
    first, observers, stride, _, _, own_velocity, near, scales, shape, edge, limit = senses
    others = neighbours.others
    turning = first[0, layout.HEADING] != ABSENT
    if turning:
        face(bodies)
    lay_out(position, velocity, observers, neighbours)
    for i in range(position.shape[0]):
        if not observers[i]:
            find_focus(i, position, others)
            _face(i, others, towards)
            continue
        seen = look(i, position, velocity, neighbours)
        _face(i, others, towards)
        observe_own(
            i, position, velocity, acceleration, past, steps, towards, first, stride[i],
            own_velocity[i], limit, observation,
        )  # fmt: skip
        _observe_others(i, seen, position, velocity, others, towards, first, near, observation)
        _observe_field(i, position, towards, first, shape, edge, observation)
        if first[0, layout.AT_WALL] != ABSENT:
            observe_wall(
                i, position, velocity, towards, first, stride[i], scales, shape, edge, observation
            )
        if turning:
            observe_headings(i, position, towards, first, neighbours.order, bodies, observation)


@part
def _face(i, others, towards):  # type: ignore[no-untyped-def]
    """The unit vector towards the focus, which is the first of the others."""
    for x in range(2):
        for b in range(others.shape[2]):
            apart = others[0, APART, b]
            towards[i, x, b] = others[0, DX + x, b] / apart if apart > 0.0 else FALLBACK[x]


@part
def _observe_others(i, seen, position, velocity, others, towards, first, near, observation):  # type: ignore[no-untyped-def]
    """The others, seen from individual ``i``; each part is a loop over all of them."""
    _observe_places(i, seen, others, towards, first, observation)
    _observe_drifts(i, seen, others, towards, first, observation)
    if seen > 1 and first[2, layout.BEARING_CIRCLE] != ABSENT:
        _observe_directions(i, seen, others, towards, first, observation)
    if first[1, layout.NEARNESS] != ABSENT:
        _observe_in_arena(i, seen, position, velocity, others, first, near, observation)


@part
def _observe_places(i, seen, others, towards, first, observation):  # type: ignore[no-untyped-def]
    """How far each other is, and where; the focus lies straight ahead, by definition."""
    for rank in range(seen):
        who = rank + 1
        apart_at, at = first[who, layout.DISTANCE], first[who, layout.PLACE]
        bearing_at = first[who, layout.BEARING]
        for b in range(others.shape[2]):
            observation[i, apart_at, b] = others[rank, APART, b]
        if at != ABSENT:
            for b in range(others.shape[2]):
                ahead, left = egocentric(others[rank, DX, b], others[rank, DY, b], i, b, towards)
                observation[i, at, b] = ahead
                observation[i, at + 1, b] = np.float32(0.0) if rank == 0 else left
        if bearing_at != ABSENT:
            for b in range(others.shape[2]):
                ahead, left = egocentric(others[rank, DX, b], others[rank, DY, b], i, b, towards)
                bearing = np.float32(0.0) if rank == 0 else angle_of(ahead, left)
                observation[i, bearing_at, b] = bearing


@part
def _observe_drifts(i, seen, others, towards, first, observation):  # type: ignore[no-untyped-def]
    """The velocity of each other, relative to the own."""
    for rank in range(seen):
        at = first[rank + 1, layout.DRIFT]
        for b in range(others.shape[2]):
            ahead, left = egocentric(others[rank, DVX, b], others[rank, DVY, b], i, b, towards)
            observation[i, at, b] = ahead
            observation[i, at + 1, b] = left


@part
def _observe_directions(i, seen, others, towards, first, observation):  # type: ignore[no-untyped-def]
    """Unit vectors towards others who are not the focus; of one at the same place, the focus'."""
    for rank in range(1, seen):
        circle, plane = first[rank + 1, layout.BEARING_CIRCLE], first[rank + 1, layout.DIRECTION]
        for b in range(others.shape[2]):
            apart = others[rank, APART, b]
            ex = towards[i, 0, b]
            ey = towards[i, 1, b]
            ux = others[rank, DX, b] / apart if apart > 0.0 else ex
            uy = others[rank, DY, b] / apart if apart > 0.0 else ey
            if plane != ABSENT:
                observation[i, plane, b] = ux
                observation[i, plane + 1, b] = uy
            observation[i, circle, b] = ux * ex + uy * ey
            observation[i, circle + 1, b] = uy * ex - ux * ey


@part
def _observe_in_arena(i, seen, position, velocity, others, first, near, observation):  # type: ignore[no-untyped-def]
    """How near each other is, and where it is and goes in the arena frame."""
    for rank in range(seen):
        who = rank + 1
        inverse = first[who, layout.NEARNESS]
        place, going = first[who, layout.OTHER_POSITION], first[who, layout.OTHER_VELOCITY]
        offset = first[who, layout.OFFSET]
        for b in range(others.shape[2]):
            observation[i, inverse, b] = 1.0 / (others[rank, APART, b] + near)
        if place == ABSENT:
            continue
        for x in range(2):
            for b in range(others.shape[2]):
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
        ahead, left = egocentric(-position[i, 0, b], -position[i, 1, b], i, b, towards)
        observation[i, at, b] = ahead
        observation[i, at + 1, b] = left
