"""The kernels of the odour-search world: the scalar equations of one searcher, over all copies.

State arrays have the copy as their last axis: position, velocity and heading ``(2, B)``, odour
``(2, B)``, sensed ``(n, B)``; the plume's table is a
:class:`animarl_envs.worlds.plume.plume.HitTable`.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numba as nb
import numpy as np
from numba.core import types
from numba.experimental import structref

from animarl_envs.compiling import jit
from animarl_envs.demos.episode import TIME_OUT
from animarl_envs.locomotion import ACTION_VECTORS, COAST
from animarl_envs.scenario import ACTION, REPLAY
from animarl_envs.worlds.plume.plume import is_hit
from animarl_envs.worlds.streams import next_below
from animarl_envs.worlds.transition import next_velocity

HALF_TURN = math.pi - 1e-6  # an exact about-face has no side, so it counts as no turn [rad]
REACHED = 1  # outcome: the searcher (individual 0) reached the source


class Senses(NamedTuple):
    """Numbers of the senses, as the kernels need them."""

    dt: float
    rest_speed: float
    ahead: float  # of the antennae [arena unit]
    beside: float
    remains: float  # share of the odour signal above baseline after a step without a hit
    baseline: float
    flow_threshold: float
    flow_limit: float


@nb.njit(inline="always")
def _turn(b, velocity_x, velocity_y, rest_speed, heading, body_angle):  # type: ignore[no-untyped-def]
    """Point the body along the velocity; returns the angle turned, counter-clockwise [rad]."""
    speed = math.sqrt(velocity_x * velocity_x + velocity_y * velocity_y)
    if speed <= rest_speed:
        return 0.0
    heading[0, b] = velocity_x / speed
    heading[1, b] = velocity_y / speed
    angle = math.atan2(-velocity_y, -velocity_x)
    turned = angle - body_angle[b]
    body_angle[b] = angle
    if turned > math.pi:
        turned -= 2.0 * math.pi
    elif turned < -math.pi:
        turned += 2.0 * math.pi
    return 0.0 if abs(turned) > HALF_TURN else turned


@nb.njit(inline="always")
def _sense(  # type: ignore[no-untyped-def]
    b, velocity_x, velocity_y, turned, hit_left, hit_right, condition, senses, heading, body_angle,
    odour, out, column,
):  # fmt: skip
    """Update the odour signals and write the observation into ``out[:, column]``."""
    base = senses.baseline
    odour[0, b] = 1.0 if hit_left else base + (odour[0, b] - base) * senses.remains
    odour[1, b] = 1.0 if hit_right else base + (odour[1, b] - base) * senses.remains
    flow = -turned / senses.dt
    if abs(flow) < senses.flow_threshold:
        flow = 0.0
    flow = min(senses.flow_limit, max(-senses.flow_limit, flow))
    ahead = -heading[0, b]  # cosine and sine of the body angle
    left = -heading[1, b]
    front = ahead >= abs(left)
    back = -ahead >= abs(left) and not front
    out[0, column] = -velocity_x
    out[1, column] = -velocity_y
    out[2, column] = body_angle[b]
    out[3, column] = odour[0, b]
    out[4, column] = odour[1, b]
    for c in range(5, 10):
        out[c, column] = 0.0
    if condition == 0:
        out[5, column] = flow
        if front:
            out[6, column] = 1.0
        elif back:
            out[9, column] = 1.0
        elif left > 0.0:  # facing left of upwind, the air comes from the right
            out[7, column] = 1.0
        else:
            out[8, column] = 1.0


@nb.njit(inline="always")
def _read(b, position, heading, senses, table, pattern, step):  # type: ignore[no-untyped-def]
    """Hits of the left and right antenna."""
    bits, rows, columns, source_row, source_column, cell = table
    front_x = position[0, b] + senses.ahead * heading[0, b]
    front_y = position[1, b] + senses.ahead * heading[1, b]
    side_x = -senses.beside * heading[1, b]
    side_y = senses.beside * heading[0, b]
    step = step % bits.shape[1]
    left = is_hit(
        bits, rows, columns, source_row, source_column, cell, pattern, step,
        front_x + side_x, front_y + side_y,
    )  # fmt: skip
    right = is_hit(
        bits, rows, columns, source_row, source_column, cell, pattern, step,
        front_x - side_x, front_y - side_y,
    )  # fmt: skip
    return left, right


@jit
def start(  # type: ignore[no-untyped-def]
    mask, demo_position, demo_velocity, demo_start, demo_hits, demo_heading, candidates,
    num_candidates, demo_group, demo_pattern, demo_phase, first, table, senses, random, demo,
    condition, position, velocity, heading, body_angle, odour, pattern, phase, sensed,
):  # fmt: skip
    for b in range(len(mask)):
        if not mask[b]:
            continue
        d = demo[b]
        frame = demo_start[d] if d >= 0 else 0
        heading[0, b] = -1.0
        heading[1, b] = 0.0
        if d >= 0:
            for x in range(2):
                position[x, b] = demo_position[frame, 0, x]
                velocity[x, b] = demo_velocity[frame, 0, x]
            if len(demo_heading):
                heading[0, b] = math.cos(demo_heading[frame])
                heading[1, b] = math.sin(demo_heading[frame])
        else:
            for x in range(2):
                position[x, b] = first[x]
                velocity[x, b] = 0.0
        body_angle[b] = math.atan2(-heading[1, b], -heading[0, b])
        _turn(b, velocity[0, b], velocity[1, b], senses.rest_speed, heading, body_angle)

        group = demo_group[d] if d >= 0 else 0
        pattern[b] = candidates[group, next_below(random, b, num_candidates[group])]
        phase[b] = next_below(random, b, table.bits.shape[1])
        if d >= 0 and demo_pattern[d] >= 0:
            pattern[b] = demo_pattern[d]
        if d >= 0 and demo_phase[d] >= 0:
            phase[b] = demo_phase[d]

        odour[0, b] = senses.baseline
        odour[1, b] = senses.baseline
        if d >= 0 and len(demo_hits):
            left = demo_hits[frame, 0]
            right = demo_hits[frame, 1]
        else:
            left, right = _read(b, position, heading, senses, table, pattern[b], phase[b])
        _sense(
            b, velocity[0, b], velocity[1, b], 0.0, left, right, condition[b], senses,
            heading, body_angle, odour, sensed, b,
        )  # fmt: skip


@structref.register
class _SearchStateType(types.StructRef):  # type: ignore[misc]
    """Numba's type of :class:`SearchState`."""


class SearchState(structref.StructRefProxy):  # type: ignore[misc]
    """What a step reads and writes, in one object: handing arrays to a kernel one by one would
    take longer than the step of a single copy."""


structref.define_proxy(  # type: ignore[no-untyped-call]
    SearchState,
    _SearchStateType,
    [
        "driver", "demos", "demo_hits", "table", "senses", "numbers", "demo", "condition",
        "pattern", "phase", "position", "velocity", "heading", "body_angle", "odour", "components",
        "reward", "terminated", "truncated", "outcome", "step_count", "warming", "sensed",
    ],
)  # fmt: skip


@jit
def bundle(  # type: ignore[no-untyped-def]
    driver, demos, demo_hits, table, senses, numbers, demo, condition, pattern, phase, position,
    velocity, heading, body_angle, odour, components, reward, terminated, truncated, outcome,
    step_count, warming, sensed,
):  # fmt: skip
    """A :class:`SearchState`; made here, since what is made outside is not kept on disk."""
    return SearchState(  # type: ignore[no-untyped-call]
        driver, demos, demo_hits, table, senses, numbers, demo, condition, pattern, phase, position,
        velocity, heading, body_angle, odour, components, reward, terminated, truncated, outcome,
        step_count, warming, sensed,
    )  # fmt: skip


@jit
def step(asked, state):  # type: ignore[no-untyped-def]
    """All of a step in one call; ``asked`` is ``(B, 1)``."""
    damping, thrust, contact_radius, time_limit, warmup = state.numbers
    driver, senses, table = state.driver, state.senses, state.table
    demo, demo_hits, demo_start = state.demo, state.demo_hits, state.demos.start
    demo_position, demo_velocity = state.demos.position, state.demos.velocity
    condition, pattern, phase = state.condition, state.pattern, state.phase
    position, velocity, heading = state.position, state.velocity, state.heading
    body_angle, odour, sensed = state.body_angle, state.odour, state.sensed
    components, reward, outcome = state.components, state.reward, state.outcome
    terminated, truncated = state.terminated, state.truncated
    step_count, warming = state.step_count, state.warming
    dt = senses.dt
    for b in range(len(step_count)):
        step_count[b] += 1
        t = step_count[b]

        # v' = (1 - d) v + u a dt and p' = p + v' dt, or the demonstration's next frame.
        recorded = 0
        frame = 0
        if demo[b] >= 0:
            frame = demo_start[demo[b]] + t
            recorded = demo_start[demo[b] + 1] - frame  # frames left, this one included
        replay = recorded > 0 and (t <= warmup or driver == REPLAY)
        if replay:
            for x in range(2):
                velocity[x, b] = demo_velocity[frame, 0, x]
                position[x, b] = demo_position[frame, 0, x]
        else:
            action = asked[b, 0] if driver == ACTION else COAST
            for x in range(2):  # the focus is (-1, 0), left of it is (0, -1)
                velocity[x, b] = next_velocity(
                    velocity[x, b], -ACTION_VECTORS[action, x], damping, thrust, dt
                )
                position[x, b] += velocity[x, b] * dt

        px = position[0, b]
        py = position[1, b]
        reached = px * px + py * py < contact_radius * contact_radius
        components[b] = 1.0 if reached else 0.0
        reward[b] = components[b]
        outcome[b] = REACHED if reached else TIME_OUT
        terminated[b] = reached
        truncated[b] = t >= time_limit and not reached
        warming[b] = t < warmup and recorded > 1

        vx = velocity[0, b]
        vy = velocity[1, b]
        turned = _turn(b, vx, vy, senses.rest_speed, heading, body_angle)
        if replay and len(demo_hits):
            left = demo_hits[frame, 0]
            right = demo_hits[frame, 1]
        else:
            left, right = _read(b, position, heading, senses, table, pattern[b], phase[b] + t)
        _sense(
            b, vx, vy, turned, left, right, condition[b], senses, heading, body_angle, odour,
            sensed, b,
        )  # fmt: skip


@jit
def sense_recorded(velocity, start, condition, hits, demo_heading, senses, out):  # type: ignore[no-untyped-def]
    heading = np.empty((2, 1))
    body_angle = np.empty(1)
    odour = np.empty((2, 1))
    for e in range(len(start) - 1):
        for frame in range(start[e], start[e + 1]):
            vx = velocity[frame, 0, 0]
            vy = velocity[frame, 0, 1]
            fresh = frame == start[e]
            if fresh:
                heading[0, 0] = math.cos(demo_heading[frame]) if len(demo_heading) else -1.0
                heading[1, 0] = math.sin(demo_heading[frame]) if len(demo_heading) else 0.0
                body_angle[0] = math.atan2(-heading[1, 0], -heading[0, 0])
                odour[:] = senses.baseline
            turned = _turn(0, vx, vy, senses.rest_speed, heading, body_angle)
            if fresh:
                turned = 0.0
            _sense(
                0, vx, vy, turned, hits[frame, 0], hits[frame, 1], condition[e], senses, heading,
                body_angle, odour, out, frame,
            )  # fmt: skip
