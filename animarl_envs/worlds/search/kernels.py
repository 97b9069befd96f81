"""The kernels of the odour-search world: the scalar equations of one searcher, over all copies.

State arrays have the copy as their last axis: position and velocity ``(2, B)``, sensed ``(n, B)``,
the rest is a :class:`animarl_envs.worlds.search.senses.Body`; the plume's table is a
:class:`animarl_envs.worlds.plume.hits.HitTable`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba.core import types
from numba.experimental import structref
from numpy.typing import NDArray

from animarl_envs.compiling import jit
from animarl_envs.demos.episode import TIME_OUT
from animarl_envs.kinematics import next_velocity
from animarl_envs.scenario import ACTION, REPLAY
from animarl_envs.worlds.flat_demos import FlatDemos
from animarl_envs.worlds.plume.hits import HitTable
from animarl_envs.worlds.search.senses import Body, Senses, orient, push_of, read, sense, wake
from animarl_envs.worlds.streams import next_below

REACHED = 1  # outcome: the searcher (individual 0) reached the source


@jit
def start(  # type: ignore[no-untyped-def]
    mask, demo_position, demo_velocity, demo_start, demo_hits, demo_heading, candidates,
    num_candidates, demo_group, demo_pattern, demo_phase, first, table, senses, random, demo,
    condition, position, velocity, body, pattern, phase, sensed,
):  # fmt: skip
    for b in range(len(mask)):
        if not mask[b]:
            continue
        d = demo[b]
        frame = demo_start[d] if d >= 0 else 0
        for x in range(2):
            position[x, b] = demo_position[frame, 0, x] if d >= 0 else first[x]
            velocity[x, b] = demo_velocity[frame, 0, x] if d >= 0 else 0.0
        wake(b, velocity[0, b], velocity[1, b], d >= 0, frame, demo_heading, senses, body)

        group = demo_group[d] if d >= 0 else 0
        pattern[b] = candidates[group, next_below(random, b, num_candidates[group])]
        phase[b] = next_below(random, b, table.bits.shape[1])
        if d >= 0 and demo_pattern[d] >= 0:
            pattern[b] = demo_pattern[d]
        if d >= 0 and demo_phase[d] >= 0:
            phase[b] = demo_phase[d]

        if d >= 0 and len(demo_hits):
            left = demo_hits[frame, 0]
            right = demo_hits[frame, 1]
        else:
            left, right = read(b, position, body, senses, table, pattern[b], phase[b])
        sense(
            b, velocity[0, b], velocity[1, b], 0.0, 0.0, left, right, condition[b], senses, body,
            sensed, b,
        )  # fmt: skip


class SearchState(NamedTuple):
    """What a step reads and writes; see :class:`animarl_envs.worlds.search.world.SearchWorld`."""

    driver: int
    demos: FlatDemos
    demo_hits: NDArray[np.bool_]  # (frames, 2), or empty
    demo_heading: NDArray[np.float64]  # (frames,) [rad], or empty
    table: HitTable
    senses: Senses
    damping: float
    thrust: float
    pushes: NDArray[np.float64]  # (A, 2): actions in multiples of the thrust, ahead and left
    contact_radius: float
    time_limit: int
    warmup: int
    demo: NDArray[np.int64]
    condition: NDArray[np.int8]
    pattern: NDArray[np.int64]
    phase: NDArray[np.int64]
    position: NDArray[np.float64]
    velocity: NDArray[np.float64]
    body: Body
    components: NDArray[np.float64]
    reward: NDArray[np.float64]
    terminated: NDArray[np.bool_]
    truncated: NDArray[np.bool_]
    outcome: NDArray[np.int8]
    step_count: NDArray[np.int64]
    warming: NDArray[np.bool_]
    sensed: NDArray[np.float32]


@structref.register
class _SearchReferenceType(types.StructRef):  # type: ignore[misc]
    """Numba's type of :class:`SearchReference`."""


class SearchReference(structref.StructRefProxy):  # type: ignore[misc]
    """The arrays of a :class:`SearchState` in one object."""


structref.define_proxy(SearchReference, _SearchReferenceType, SearchState._fields)  # type: ignore[no-untyped-call]


@jit
def refer(parts):  # type: ignore[no-untyped-def]
    """A reference to ``parts``, made by a kernel: what is made outside is not kept on disk."""
    return SearchReference(*parts)  # type: ignore[no-untyped-call]


@jit
def step(asked, state):  # type: ignore[no-untyped-def]
    """All of a step in one call; ``asked`` is ``(B, 1)``; of a :class:`SearchState`."""
    damping, thrust, pushes = state.damping, state.thrust, state.pushes
    contact_radius, time_limit, warmup = state.contact_radius, state.time_limit, state.warmup
    driver, senses, table = state.driver, state.senses, state.table
    demo, demo_hits, demo_start = state.demo, state.demo_hits, state.demos.start
    demo_heading = state.demo_heading
    demo_position, demo_velocity = state.demos.position, state.demos.velocity
    condition, pattern, phase = state.condition, state.pattern, state.phase
    position, velocity, body, sensed = state.position, state.velocity, state.body, state.sensed
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
        before_x = velocity[0, b]
        before_y = velocity[1, b]
        replay = recorded > 0 and (t <= warmup or driver == REPLAY)
        if replay:
            for x in range(2):
                velocity[x, b] = demo_velocity[frame, 0, x]
                position[x, b] = demo_position[frame, 0, x]
        else:
            action = asked[b, 0] if driver == ACTION else len(pushes) - 1
            for x in range(2):  # the focus is (-1, 0), left of it is (0, -1)
                velocity[x, b] = next_velocity(
                    velocity[x, b], -pushes[action, x], damping, thrust, dt
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
        orient(b, vx, vy, replay, frame, demo_heading, senses, body)
        if replay and len(demo_hits):
            left = demo_hits[frame, 0]
            right = demo_hits[frame, 1]
        else:
            left, right = read(b, position, body, senses, table, pattern[b], phase[b] + t)
        push_x = push_of(before_x, vx, senses)
        push_y = push_of(before_y, vy, senses)
        sense(b, vx, vy, push_x, push_y, left, right, condition[b], senses, body, sensed, b)


@jit
def sense_recorded(velocity, start, condition, hits, demo_heading, senses, body, out):  # type: ignore[no-untyped-def]
    """Observations of recorded frames; ``body`` is scratch of one copy."""
    for e in range(len(start) - 1):
        for frame in range(start[e], start[e + 1]):
            vx = velocity[frame, 0, 0]
            vy = velocity[frame, 0, 1]
            push_x, push_y = 0.0, 0.0
            if frame == start[e]:
                wake(0, vx, vy, True, frame, demo_heading, senses, body)
            else:
                orient(0, vx, vy, True, frame, demo_heading, senses, body)
                push_x = push_of(velocity[frame - 1, 0, 0], vx, senses)
                push_y = push_of(velocity[frame - 1, 0, 1], vy, senses)
            sense(
                0, vx, vy, push_x, push_y, hits[frame, 0], hits[frame, 1], condition[e], senses,
                body, out, frame,
            )  # fmt: skip
