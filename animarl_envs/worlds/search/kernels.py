"""The odour-search world, scalar by scalar: a body, what it senses, and a step of all copies.

State arrays have the copy as their last axis: position and velocity ``(2, B)``, sensed ``(n, B)``,
the rest is a :class:`Body`; the plume's table is a
:class:`animarl_envs.worlds.plume.plume.HitTable`.
"""

from __future__ import annotations

import math
from collections import namedtuple
from typing import NamedTuple

import numpy as np
from numba.core import types
from numba.experimental import structref

from animarl_envs.array_types import Floats
from animarl_envs.compiling import inline_kernel, jit
from animarl_envs.demos.episode import TIME_OUT
from animarl_envs.kinematics import next_turn, next_velocity, residual, turn_between, wrapped
from animarl_envs.scenario import ACTION, REPLAY
from animarl_envs.species import SearchSpecies
from animarl_envs.worlds.plume.plume import LONGEST, draw_hits, is_hit
from animarl_envs.worlds.search.layout import (
    ALIKE,
    HARDEST,
    ODOUR,
    PAPER,
    PAST,
    REMEMBERING,
    REST,
    SMALL,
    SearchEntry,
)
from animarl_envs.worlds.streams import next_below, next_uniform


class SearchSenses(NamedTuple):
    """Numbers of the body and its senses, as the kernels need them."""

    dt: float
    rest_speed: float
    ahead: float  # of the antennae [arena unit]
    beside: float
    remains: float  # share of the odour signal above baseline after a step without a hit
    baseline: float
    trace_remains: float  # share of the slow trace
    flow_threshold: float
    flow_limit: float
    damping: float
    stride: float  # u dt [arena unit / s]
    own_velocity: float  # factor on velocities without a scale
    turns: bool  # by the four numbers below; otherwise the body points where it walks
    persistence: float
    gain: float
    slip_cosine: float
    slip_sine: float
    turning_speed: float


class Body(NamedTuple):
    """State of the bodies beside position and velocity; ``B`` copies."""

    heading: Floats  # (2, B), unit vector, arena frame
    angle: Floats  # (B,), of the heading from upwind, to the left [rad]
    turn: Floats  # (B,), of the last step, to the left [rad]
    odour: Floats  # (2, B), signal of the left and right antenna
    trace: Floats  # (2, B), the same, decaying slowly to zero
    traits: Floats  # (2, B), of the individual [sd]
    past: Floats  # (8, B), means of the past: see SearchEntry and PAST

    @classmethod
    def of(cls, copies: int, baseline: float = 0.0) -> Body:
        """Return bodies that face upwind and smell nothing."""
        heading = np.zeros((2, copies))
        heading[0] = -1.0
        odour = np.full((2, copies), baseline)
        trace, traits = np.zeros((2, 2, copies))
        past = np.zeros((len(PAST), copies))
        return cls(heading, np.zeros(copies), np.zeros(copies), odour, trace, traits, past)


def senses_of(species: SearchSpecies) -> SearchSenses:
    """Return the senses of a species."""
    angle, dt, turning = math.radians(species.antenna_angle), species.dt, species.turning
    own, scales = (0.0, 0.0, 1.0, 0.0, 1.0), species.scales
    if turning is not None:
        slip = math.cos(turning.slip), math.sin(turning.slip)
        own = (turning.persistence, turning.gain, *slip, turning.speed)
    return SearchSenses(
        dt,
        species.rest_speed,
        species.antenna_length * math.cos(angle),
        species.antenna_length * math.sin(angle),
        math.exp(-dt / species.odour_decay),
        species.odour_baseline,
        math.exp(-dt / species.trace_decay),
        species.flow_threshold,
        species.flow_limit,
        scales.locomotion[0].damping,
        scales.locomotion[0].thrust * scales.dt,
        scales.own_velocity[0],
        turning is not None,
        *own,
    )


# -- the body ---------------------------------------------------------------------------------


@inline_kernel
def _set_heading(b, cosine, sine, angle, body):  # type: ignore[no-untyped-def]
    """Point the body at ``angle`` from upwind, its unit vector given; note how far it turned."""
    body.heading[0, b] = cosine
    body.heading[1, b] = sine
    body.turn[b] = turn_between(body.angle[b], angle)
    body.angle[b] = angle


@inline_kernel
def set_direction(b, direction, body):  # type: ignore[no-untyped-def]
    """Point the body in a direction of the arena frame [rad]."""
    cosine = math.cos(direction)
    sine = math.sin(direction)
    _set_heading(b, cosine, sine, math.atan2(-sine, -cosine), body)


@inline_kernel
def follow(b, velocity_x, velocity_y, rest_speed, body):  # type: ignore[no-untyped-def]
    """Point the body along the velocity; at rest it stays as it is."""
    speed = math.sqrt(velocity_x * velocity_x + velocity_y * velocity_y)
    body.turn[b] = 0.0
    if speed > rest_speed:
        angle = math.atan2(-velocity_y, -velocity_x)
        _set_heading(b, velocity_x / speed, velocity_y / speed, angle, body)


@inline_kernel
def _swing(b, velocity_x, velocity_y, senses, body):  # type: ignore[no-untyped-def]
    """Turn by the equation of :mod:`animarl_envs.species.turning`."""
    turn = next_turn(
        body.turn[b],
        body.heading[0, b],
        body.heading[1, b],
        velocity_x,
        velocity_y,
        senses.persistence,
        senses.gain,
        senses.slip_cosine,
        senses.slip_sine,
        senses.turning_speed,
    )
    angle = wrapped(body.angle[b] + turn)
    body.heading[0, b] = -math.cos(angle)
    body.heading[1, b] = -math.sin(angle)
    body.angle[b] = angle
    body.turn[b] = turn


@inline_kernel
def orient(b, velocity_x, velocity_y, recorded, frame, demo_heading, senses, body):  # type: ignore[no-untyped-def]
    """Turn the body: as ``recorded`` in ``frame``, by its own turning, or as it walks."""
    if not senses.turns:
        follow(b, velocity_x, velocity_y, senses.rest_speed, body)
    elif recorded and len(demo_heading) > 0:
        set_direction(b, demo_heading[frame], body)
    else:
        _swing(b, velocity_x, velocity_y, senses, body)


@inline_kernel
def wake(b, velocity_x, velocity_y, recorded, frame, demo_heading, senses, body):  # type: ignore[no-untyped-def]
    """Set the first heading of an episode: as recorded, else as it walks, or upwind at rest."""
    known = recorded and len(demo_heading) > 0
    if known:
        set_direction(b, demo_heading[frame], body)
    else:
        _set_heading(b, -1.0, 0.0, -0.0, body)
    if not (senses.turns and known):
        follow(b, velocity_x, velocity_y, senses.rest_speed, body)
    body.turn[b] = 0.0
    for side in range(2):
        body.odour[side, b] = senses.baseline
        body.trace[side, b] = 0.0
    for k in range(len(PAST)):
        body.past[k, b] = 0.0


# -- the senses -------------------------------------------------------------------------------


@inline_kernel
def read(b, position, body, senses, table, pattern, step):  # type: ignore[no-untyped-def]
    """Return hits of the left and right antenna."""
    heading = body.heading
    front_x = position[0, b] + senses.ahead * heading[0, b]
    front_y = position[1, b] + senses.ahead * heading[1, b]
    side_x = -senses.beside * heading[1, b]
    side_y = senses.beside * heading[0, b]
    step = step % table.bits.shape[1]
    left = is_hit(table, pattern, step, front_x + side_x, front_y + side_y)
    right = is_hit(table, pattern, step, front_x - side_x, front_y - side_y)
    return left, right


@inline_kernel
def _since_hit(b, senses, body):  # type: ignore[no-untyped-def]
    """Return the time since the last hit, by the age of its trace, at most ``LONGEST`` [s]."""
    trace = max(body.trace[0, b], body.trace[1, b])
    if trace <= 0.0:
        return LONGEST
    return min(LONGEST, senses.dt * math.log(trace) / math.log(senses.trace_remains))


@inline_kernel
def smell(b, position, body, senses, odour, random):  # type: ignore[no-untyped-def]
    """Draw hits from a fitted odour; signals hold the last hits, and the trace their age."""
    return draw_hits(
        position[0, b],
        position[1, b],
        body.heading[0, b],
        body.heading[1, b],
        body.odour[0, b] == 1.0,
        body.odour[1, b] == 1.0,
        _since_hit(b, senses, body),
        odour,
        next_uniform(random, b),
    )


@inline_kernel
def sense(  # type: ignore[no-untyped-def]
    b,
    velocity_x,
    velocity_y,
    push_x,
    push_y,
    hit_left,
    hit_right,
    condition,
    senses,
    body,
    out,
    column,
):
    """Update the odour signals and write the observation into ``out[:, column]``.

    ``push_x`` and ``push_y`` led here, in multiples of the thrust; zero in a first frame.

    Arrays of ``body`` have no names of their own here, and past and traits are written in loops,
    not under a condition: numba would count references to the arrays in every copy, which takes as
    long as the rest of a step.
    """
    base = senses.baseline
    body.odour[0, b] = 1.0 if hit_left else base + (body.odour[0, b] - base) * senses.remains
    body.odour[1, b] = 1.0 if hit_right else base + (body.odour[1, b] - base) * senses.remains
    body.trace[0, b] = 1.0 if hit_left else body.trace[0, b] * senses.trace_remains
    body.trace[1, b] = 1.0 if hit_right else body.trace[1, b] * senses.trace_remains
    if out.shape[0] == ODOUR:
        out[0, column] = 1.0 if hit_left else 0.0
        out[1, column] = 1.0 if hit_right else 0.0
    else:
        out[SearchEntry.VELOCITY_AHEAD, column] = -velocity_x * senses.own_velocity
        out[SearchEntry.VELOCITY_LEFT, column] = -velocity_y * senses.own_velocity
        out[SearchEntry.BODY_ANGLE, column] = body.angle[b]
        out[SearchEntry.ODOUR_LEFT, column] = body.odour[0, b]
        out[SearchEntry.ODOUR_RIGHT, column] = body.odour[1, b]
        _sense_air(b, condition, senses, body, out, column)
    if out.shape[0] > PAPER:
        out[SearchEntry.HIT_LEFT, column] = 1.0 if hit_left else 0.0
        out[SearchEntry.HIT_RIGHT, column] = 1.0 if hit_right else 0.0
    if out.shape[0] > SMALL:
        _sense_more(b, velocity_x, velocity_y, senses, body, out, column)
        out[SearchEntry.ACCELERATION_AHEAD, column] = min(HARDEST, max(-HARDEST, -push_x))
        out[SearchEntry.ACCELERATION_LEFT, column] = min(HARDEST, max(-HARDEST, -push_y))
    traits = REMEMBERING if out.shape[0] >= REMEMBERING else ALIKE  # the first row of traits
    for k in range(ALIKE, traits - 1):
        now = math.hypot(velocity_x, velocity_y) / senses.stride
        if k <= SearchEntry.TURN_10:
            now = body.turn[b] / senses.dt
        elif k <= SearchEntry.WAY_LEFT_10:
            now = -velocity_y / senses.stride
        elif k <= SearchEntry.WAY_AHEAD_10:
            now = -velocity_x / senses.stride
        before = body.past[k - ALIKE, b]
        mean = before + (now - before) * (1.0 - math.exp(-senses.dt / PAST[k - ALIKE]))
        body.past[k - ALIKE, b] = mean
        out[k, column] = mean
    for k in range(max(ALIKE, traits - 1), traits):
        out[k, column] = math.log(2.0 * _since_hit(b, senses, body) + 1.0)
    for k in range(traits, out.shape[0]):
        out[k, column] = body.traits[k - traits, b]


@inline_kernel
def _sense_air(b, condition, senses, body, out, column):  # type: ignore[no-untyped-def]
    """Sense visual flow and the side the wind comes from; neither in condition 1."""
    for row in range(SearchEntry.FLOW, SearchEntry.WIND_BACK + 1):
        out[row, column] = 0.0
    if condition != 0:
        return
    flow = -body.turn[b] / senses.dt
    if abs(flow) < senses.flow_threshold:
        flow = 0.0
    out[SearchEntry.FLOW, column] = min(senses.flow_limit, max(-senses.flow_limit, flow))
    ahead = -body.heading[0, b]  # cosine and sine of the body angle
    left = -body.heading[1, b]
    if ahead >= abs(left):
        out[SearchEntry.WIND_FRONT, column] = 1.0
    elif -ahead >= abs(left):
        out[SearchEntry.WIND_BACK, column] = 1.0
    elif left > 0.0:  # facing left of upwind, the air comes from the right
        out[SearchEntry.WIND_RIGHT, column] = 1.0
    else:
        out[SearchEntry.WIND_LEFT, column] = 1.0


@inline_kernel
def _sense_more(b, velocity_x, velocity_y, senses, body, out, column):  # type: ignore[no-untyped-def]
    """Sense the same quantities on scales that networks can use, and a longer memory of hits."""
    out[SearchEntry.ODOUR_DIFFERENCE, column] = body.odour[0, b] - body.odour[1, b]
    out[SearchEntry.ODOUR_SUM, column] = body.odour[0, b] + body.odour[1, b]
    out[SearchEntry.TRACE_LEFT, column] = body.trace[0, b]
    out[SearchEntry.TRACE_RIGHT, column] = body.trace[1, b]
    out[SearchEntry.ANGLE_COSINE, column] = -body.heading[0, b]
    out[SearchEntry.ANGLE_SINE, column] = -body.heading[1, b]
    ahead = -velocity_x / senses.stride
    left = -velocity_y / senses.stride
    out[SearchEntry.FINE_AHEAD, column] = math.tanh(ahead)
    out[SearchEntry.FINE_LEFT, column] = math.tanh(left)
    out[SearchEntry.COARSE_AHEAD, column] = math.tanh(ahead / 3.0)
    out[SearchEntry.COARSE_LEFT, column] = math.tanh(left / 3.0)
    out[SearchEntry.LOG_SPEED, column] = math.log(math.sqrt(ahead * ahead + left * left) + REST)
    out[SearchEntry.YAW_RATE, column] = body.turn[b] / senses.dt


REACHED = 1  # outcome: the searcher (individual 0) reached the source

SearchState = namedtuple(
    "SearchState",
    "demos demo contact_radius time_limit warmup random terminated truncated outcome step_count "
    "warming driver recorded first traits step_cost table odour senses damping thrust pushes "
    "condition pattern phase position velocity body components reward sensed",
)
"""What a step reads and writes; see :class:`animarl_envs.worlds.search.world.SearchWorld`, where
they are made. ``first`` ``(2, 2)`` are the lowest and highest x and y of starts without a
recording; ``pushes`` ``(A, 2)`` are actions in multiples of the thrust, ahead and left;
``traits`` ``(n, 2)`` are those of training animals;
``odour`` is an :class:`animarl_envs.worlds.plume.plume.OdourWeights`, empty where the table
holds."""


@structref.register
class _SearchReferenceType(types.StructRef):  # type: ignore[misc]
    """Numba's type of :class:`SearchReference`."""


class SearchReference(structref.StructRefProxy):  # type: ignore[misc]
    """The arrays of a :class:`SearchState` in one object."""


structref.define_proxy(SearchReference, _SearchReferenceType, SearchState._fields)  # type: ignore[no-untyped-call]


@jit
def make_reference(parts):  # type: ignore[no-untyped-def]
    """Return a reference to ``parts``. Made in a kernel, since only then numba caches its users."""
    return SearchReference(*parts)  # type: ignore[no-untyped-call]


@jit
def start(mask, state):  # type: ignore[no-untyped-def]
    """Set first states of new episodes: as recorded, or at rest where ``state.first`` says."""
    demos, recorded, senses, table = state.demos, state.recorded, state.senses, state.table
    position, velocity, body, random = state.position, state.velocity, state.body, state.random
    pattern, phase, sensed = state.pattern, state.phase, state.sensed
    for b in range(len(mask)):
        if not mask[b]:
            continue
        d = state.demo[b]
        frame = demos.start[d] if d >= 0 else 0
        for x in range(2):
            position[x, b] = demos.position[frame, 0, x] if d >= 0 else state.first[0, x]
            velocity[x, b] = demos.velocity[frame, 0, x] if d >= 0 else 0.0
        drawing = d < 0 and state.first[1, 0] > state.first[0, 0]
        while drawing:  # until it is well away from the source
            for x in range(2):
                width = state.first[1, x] - state.first[0, x]
                position[x, b] = state.first[0, x] + width * next_uniform(random, b)
            px = position[0, b]
            py = position[1, b]
            drawing = px * px + py * py < 4.0 * state.contact_radius * state.contact_radius
        vx = velocity[0, b]
        vy = velocity[1, b]
        wake(b, vx, vy, d >= 0, frame, recorded.heading, senses, body)

        if len(state.traits):  # those of some training animal; of a replayed one its own
            drawn = next_below(random, b, len(state.traits))
            own = d >= 0 and state.driver == REPLAY
            for x in range(2):
                body.traits[x, b] = recorded.traits[d, x] if own else state.traits[drawn, x]

        group = recorded.group[d] if d >= 0 else 0
        pattern[b] = recorded.candidates[
            group, next_below(random, b, recorded.num_candidates[group])
        ]
        phase[b] = next_below(random, b, table.bits.shape[1])
        if d >= 0 and recorded.pattern[d] >= 0:
            pattern[b] = recorded.pattern[d]
        if d >= 0 and recorded.phase[d] >= 0:
            phase[b] = recorded.phase[d]

        if d >= 0 and len(recorded.hits):
            left = recorded.hits[frame, 0]
            right = recorded.hits[frame, 1]
        else:
            left, right = read(b, position, body, senses, table, pattern[b], phase[b])
        condition = state.condition[b]
        sense(b, vx, vy, 0.0, 0.0, left, right, condition, senses, body, sensed, b)


@jit
def step(wanted, state):  # type: ignore[no-untyped-def]
    """Advance a :class:`SearchState` by one step in one call; ``wanted`` is ``(B, 1)``."""
    damping, thrust, pushes = state.damping, state.thrust, state.pushes
    contact_radius, time_limit, warmup = state.contact_radius, state.time_limit, state.warmup
    driver, senses, table, demo = state.driver, state.senses, state.table, state.demo
    odour = state.odour
    hits, headings = state.recorded.hits, state.recorded.heading
    demo_position, demo_velocity = state.demos.position, state.demos.velocity
    demo_start, condition, pattern = state.demos.start, state.condition, state.pattern
    phase, position, velocity = state.phase, state.position, state.velocity
    body, sensed, components, reward = state.body, state.sensed, state.components, state.reward
    outcome, terminated, truncated = state.outcome, state.terminated, state.truncated
    step_count, warming = state.step_count, state.warming
    dt = senses.dt
    for b in range(len(step_count)):
        step_count[b] += 1
        t = step_count[b]

        # v' = (1 - d) v + u a dt and p' = p + v' dt, or the demonstration's next frame.
        left_over = 0
        frame = 0
        if demo[b] >= 0:
            frame = demo_start[demo[b]] + t
            left_over = demo_start[demo[b] + 1] - frame  # recorded frames, this one included
        before_x = velocity[0, b]
        before_y = velocity[1, b]
        replay = left_over > 0 and (t <= warmup or driver == REPLAY)
        if replay:
            for x in range(2):
                velocity[x, b] = demo_velocity[frame, 0, x]
                position[x, b] = demo_position[frame, 0, x]
        else:
            action = wanted[b, 0] if driver == ACTION else len(pushes) - 1
            for x in range(2):  # the focus is (-1, 0), left of it is (0, -1)
                velocity[x, b] = next_velocity(
                    velocity[x, b], -pushes[action, x], damping, thrust, dt
                )
                position[x, b] += velocity[x, b] * dt

        px = position[0, b]
        py = position[1, b]
        reached = px * px + py * py < contact_radius * contact_radius
        components[0, b] = 1.0 if reached else 0.0
        components[1, b] = 0.0 - state.step_cost
        reward[b] = components[0, b] + components[1, b]
        outcome[b] = REACHED if reached else TIME_OUT
        terminated[b] = reached
        truncated[b] = t >= time_limit and not reached
        warming[b] = t < warmup and left_over > 1

        vx = velocity[0, b]
        vy = velocity[1, b]
        orient(b, vx, vy, replay, frame, headings, senses, body)
        if replay and len(hits):
            left = hits[frame, 0]
            right = hits[frame, 1]
        elif len(odour.bias):
            left, right = smell(b, position, body, senses, odour, state.random)
        else:
            left, right = read(b, position, body, senses, table, pattern[b], phase[b] + t)
        own_damping = senses.damping if replay else damping
        own_push = senses.stride if replay else thrust * dt
        push_x = residual(vx, before_x, own_damping) / own_push
        push_y = residual(vy, before_y, own_damping) / own_push
        sense(b, vx, vy, push_x, push_y, left, right, condition[b], senses, body, sensed, b)


@jit
def sense_recorded(velocity, start, condition, hits, headings, traits, senses, body, out):  # type: ignore[no-untyped-def]
    """Write observations of recorded frames; ``body`` is scratch of one copy."""
    for e in range(len(start) - 1):
        body.traits[:, 0] = traits[e]
        for frame in range(start[e], start[e + 1]):
            vx = velocity[frame, 0, 0]
            vy = velocity[frame, 0, 1]
            push_x, push_y = 0.0, 0.0
            if frame == start[e]:
                wake(0, vx, vy, True, frame, headings, senses, body)
            else:
                orient(0, vx, vy, True, frame, headings, senses, body)
                before_x = velocity[frame - 1, 0, 0]
                before_y = velocity[frame - 1, 0, 1]
                push_x = residual(vx, before_x, senses.damping) / senses.stride
                push_y = residual(vy, before_y, senses.damping) / senses.stride
            sense(
                0,
                vx,
                vy,
                push_x,
                push_y,
                hits[frame, 0],
                hits[frame, 1],
                condition[e],
                senses,
                body,
                out,
                frame,
            )
