"""The kernels of the odour-search world: the scalar equations of one searcher, over all copies.

State arrays have the copy as their last axis: position and velocity ``(2, B)``, sensed ``(n, B)``,
the rest is a :class:`animarl_envs.worlds.search.senses.Body`; the plume's table is a
:class:`animarl_envs.worlds.plume.plume.HitTable`.
"""

from __future__ import annotations

from collections import namedtuple

from numba.core import types
from numba.experimental import structref

from animarl_envs.compiling import jit
from animarl_envs.demos.episode import TIME_OUT
from animarl_envs.kinematics import next_velocity, residual
from animarl_envs.scenario import ACTION, REPLAY
from animarl_envs.worlds.search.senses import orient, read, sense, smell, wake
from animarl_envs.worlds.streams import next_below, next_uniform

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
def refer(parts):  # type: ignore[no-untyped-def]
    """A reference to ``parts``, made by a kernel: what is made outside is not kept on disk."""
    return SearchReference(*parts)  # type: ignore[no-untyped-call]


@jit
def start(mask, state):  # type: ignore[no-untyped-def]
    """First states of new episodes: as recorded, or at rest where ``state.first`` says."""
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
def step(asked, state):  # type: ignore[no-untyped-def]
    """All of a step in one call; ``asked`` is ``(B, 1)``; of a :class:`SearchState`."""
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
            action = asked[b, 0] if driver == ACTION else len(pushes) - 1
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
    """Observations of recorded frames; ``body`` is scratch of one copy."""
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
                0, vx, vy, push_x, push_y, hits[frame, 0], hits[frame, 1], condition[e], senses,
                body, out, frame,
            )  # fmt: skip
