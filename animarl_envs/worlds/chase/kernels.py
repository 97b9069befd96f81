"""The equations of the chase world, as loops over copies.

What is observed follows in :mod:`animarl_envs.worlds.chase.senses`.

Arrays have the copy last: positions ``(K, 2, B)``, observations ``(K, n, B)``. Each innermost loop
runs over all copies and has no branch, so that it compiles to vector instructions. Rows are chosen
by index, not cut out as views, which would cost more than the row when there is one copy only.
``field`` is that of an :class:`~animarl_envs.arena.Arena`.

Individuals without a learner follow a rule of :mod:`animarl_envs.worlds.chase.scripted`.
"""

import math
from collections import namedtuple

from numba.core import types
from numba.experimental import structref

from animarl_envs.arena import SHAPE_CODES
from animarl_envs.compiling import inline_kernel, inline_wrapper, jit
from animarl_envs.demos.episode import PURSUER_OUT, TARGET_OUT, TIME_OUT
from animarl_envs.kinematics import next_velocity, rebound, residual
from animarl_envs.scenario import ACTION, COASTING, REPLAY, SCRIPTED
from animarl_envs.worlds.chase.cells import draw_step, follow_course
from animarl_envs.worlds.chase.headings import turn_bodies
from animarl_envs.worlds.chase.neighbours import copy_states, line_up
from animarl_envs.worlds.chase.scripted import decide
from animarl_envs.worlds.chase.senses import observe, remember
from animarl_envs.worlds.streams import next_below, next_uniform

SQUARE, DISC = SHAPE_CODES["square"], SHAPE_CODES["disc"]
TOUCH, ELAPSED, BOUNDARY = 0, 1, 2
PAIRED = 64  # free animals of which all pairs are compared; of more, those in reach along x
WHOLE_DRAWS = 100  # of the first places of all, before only those in contact are moved

# -- starting --------------------------------------------------------------------------------------


@jit
def start(mask, state):  # type: ignore[no-untyped-def]
    """Set first states: recorded, given, or uniform in a square without contact.

    Only recorded ones have a velocity. No step has led to them, so acceleration is 0.
    """
    position, velocity, demos, demo = state.position, state.velocity, state.demos, state.demo
    fixed, random, contact_radius = state.fixed, state.random, state.contact_radius
    K, _, B = position.shape
    holes = state.field[3]
    for b in range(B):
        if not mask[b]:
            continue
        frame = demos.start[demo[b]] if demo[b] >= 0 else 0
        for i in range(K):
            for x in range(2):
                state.acceleration[i, x, b] = 0.0
                velocity[i, x, b] = demos.velocity[frame, i, x] if demo[b] >= 0 else 0.0
                if demo[b] >= 0:
                    position[i, x, b] = demos.position[frame, i, x]
                elif len(fixed):
                    position[i, x, b] = fixed[i, x]
        drawn = 0
        for i in range(K if len(state.traits) else 0):  # those of some training animal, or its own
            if i == 0 or state.traits.shape[1] == 1:  # others were recorded together
                drawn = next_below(random, b, len(state.traits))
            own = demo[b] >= 0 and state.drivers[i] == REPLAY
            for x in range(2):
                of_another = state.traits[drawn, i % state.traits.shape[1], x]
                trait = state.own_traits[demo[b], i, x] if own else of_another
                state.bodies.traits[x, i, b] = trait
        drawing, draws = demo[b] < 0 and len(fixed) == 0, 0
        while drawing:
            for i in range(K):
                # Many are hardly ever all apart: after these draws only those in contact are moved.
                if draws < WHOLE_DRAWS or _is_misplaced(i, b, position, contact_radius, holes):
                    for x in range(2):
                        place = state.half_side * (2.0 * next_uniform(random, b) - 1.0)
                        position[i, x, b] = place
            draws += 1
            drawing = False
            for i in range(K):
                drawing |= _is_misplaced(i, b, position, contact_radius, holes)


@inline_kernel
def _is_misplaced(i, b, position, contact_radius, holes):  # type: ignore[no-untyped-def]
    """Return whether individual ``i`` is in contact with the last one, or in an obstacle."""
    last = position.shape[0] - 1
    x, y = position[i, 0, b], position[i, 1, b]
    dx, dy = position[last, 0, b] - x, position[last, 1, b] - y
    misplaced = i < last and dx * dx + dy * dy < contact_radius * contact_radius
    for k in range(len(holes)):
        misplaced |= _is_within(x, y, holes[k])
    return misplaced


@inline_kernel
def _is_within(x, y, hole):  # type: ignore[no-untyped-def]
    """Return whether a place is in an obstacle."""
    dx, dy = x - hole[0], y - hole[1]
    return dx * dx + dy * dy < hole[2] * hole[2]


# -- a whole step ---------------------------------------------------------------------------------


ChaseState = namedtuple(
    "ChaseState",
    "demos demo contact_radius time_limit warmup random terminated truncated outcome step_count "
    "warming actions drivers driven fixed half_side sharing damping thrust pushes dt penalty "
    "step_cost field walled lone free shoaling position velocity acceleration past towards bodies "
    "traits own_traits neighbours nearest code components reward observation senses "
    "headed full cells",
)
"""What a step reads and writes; see :class:`animarl_envs.worlds.chase.world.ChaseWorld`, where they
are made. ``actions`` ``(K, B)``, ``nearest`` and ``code`` ``(B,)`` and ``neighbours`` are scratch;
``driven``: some individual ignores the caller; ``sharing`` is the condition if condition 1 shares
the reward, else zeros; ``pushes`` ``(K, 2, A)`` are actions in multiples of the thrust, ahead and
left; ``traits`` are those of training animals, ``own_traits`` those of the recorded episodes.
``free``, ``headed`` (headings are a state), ``full`` (more is observed than the compact
observation) and ``cells`` (:mod:`animarl_envs.worlds.chase.cells`) are None where a species has no
such thing; what they need is then not compiled.
"""


@structref.register
class _ChaseReferenceType(types.StructRef):  # type: ignore[misc]
    """Numba's type of :class:`ChaseReference`."""


class ChaseReference(structref.StructRefProxy):  # type: ignore[misc]
    """The arrays of a :class:`ChaseState` in one object."""


structref.define_proxy(ChaseReference, _ChaseReferenceType, ChaseState._fields)  # type: ignore[no-untyped-call]


@jit
def make_reference(parts):  # type: ignore[no-untyped-def]
    """Return a reference to ``parts``. Made in a kernel, since only then numba caches its users."""
    return ChaseReference(*parts)  # type: ignore[no-untyped-call]


@jit
def advance(wanted, moving, observing, state):  # type: ignore[no-untyped-def]
    """Move one step if ``moving`` and observe if ``observing``; ``wanted`` is ``(B, K)``."""
    dt, field, warmup, lone = state.dt, state.field, state.warmup, state.lone
    limit = state.time_limit
    damping, thrust, pushes, drivers = state.damping, state.thrust, state.pushes, state.drivers
    actions, position, velocity = state.actions, state.position, state.velocity
    acceleration, towards, demos, demo = state.acceleration, state.towards, state.demos, state.demo
    step_count, code, warming = state.step_count, state.code, state.warming
    outcome, terminated, truncated = state.outcome, state.terminated, state.truncated
    K, _, B = position.shape
    if moving:
        for i in range(K):
            for b in range(B):
                actions[i, b] = wanted[b, i]
        for b in range(B):
            step_count[b] += 1
        if state.driven:
            drive(
                drivers,
                actions,
                position,
                velocity,
                acceleration,
                towards,
                damping,
                thrust,
                pushes,
                dt,
                field,
                state.contact_radius,
                lone,
                state.free,
            )
        remember(velocity, step_count, state.senses, state.free, state.past)
        _move(state.cells, state)
        if state.walled:
            rebound(field, position, velocity)
        accelerate(velocity, damping, thrust, dt, acceleration)
        recorded = warmup > 0
        for i in range(K):
            recorded |= drivers[i] == REPLAY
        if recorded:  # recorded positions stay where they are, walls or not
            replay(
                drivers,
                warmup,
                demos,
                demo,
                step_count,
                state.senses,
                position,
                velocity,
                acceleration,
                warming,
            )
        turn_bodies(drivers, warmup, demos, demo, step_count, velocity, state.bodies, state.headed)
        follow_course(state.cells, velocity, step_count)
        _end(state.free, state)
        for b in range(B):  # few arrays in a loop, or the compiler does not vectorise it
            outcome[b] = code[b]
        for b in range(B):
            terminated[b] = code[b] != TIME_OUT
        for b in range(B):
            truncated[b] = (step_count[b] >= limit) & (code[b] == TIME_OUT)
    if observing:
        observe(
            position,
            velocity,
            acceleration,
            state.past,
            step_count,
            towards,
            state.bodies,
            state.neighbours,
            state.senses,
            state.free,
            state.headed,
            state.full,
            state.observation,
        )


# -- moving ---------------------------------------------------------------------------------------


@inline_wrapper
def drive(  # type: ignore[no-untyped-def]
    drivers,
    actions,
    position,
    velocity,
    acceleration,
    towards,
    damping,
    thrust,
    pushes,
    dt,
    field,
    contact_radius,
    lone,
    free,
):
    """Write actions of the individuals that the caller does not drive, ``(K, B)``.

    Of free animals none pursues: their script is to accelerate along their course.
    """
    coast = pushes.shape[2] - 1
    for i in range(len(drivers)):
        if drivers[i] == COASTING or drivers[i] == REPLAY:
            for b in range(actions.shape[1]):
                actions[i, b] = coast
        elif drivers[i] == SCRIPTED:
            if free is None:
                decide(
                    i,
                    position,
                    velocity,
                    acceleration,
                    towards,
                    damping,
                    thrust,
                    pushes,
                    dt,
                    field,
                    contact_radius,
                    lone,
                    actions,
                )
            else:
                for b in range(actions.shape[1]):
                    actions[i, b] = 0


@inline_wrapper
def _move(cells, state):  # type: ignore[no-untyped-def]
    if cells is None:
        move(
            state.actions,
            state.towards,
            state.damping,
            state.thrust,
            state.pushes,
            state.dt,
            state.position,
            state.velocity,
            state.acceleration,
        )
    else:
        move_by_cells(cells, state)


@inline_kernel
def move(actions, towards, damping, thrust, pushes, dt, position, velocity, before):  # type: ignore[no-untyped-def]
    """Move all by v' = (1 - d) v + u a dt, then p' = p + v' dt; ``before`` gets the old v."""
    for i in range(position.shape[0]):
        _push(i, actions, towards, damping, thrust, pushes, dt, position, velocity, before)


@inline_kernel
def _push(i, actions, towards, damping, thrust, pushes, dt, position, velocity, before):  # type: ignore[no-untyped-def]
    B = position.shape[2]
    for b in range(B):
        before[i, 0, b] = pushes[i, 0, actions[i, b]]
        before[i, 1, b] = pushes[i, 1, actions[i, b]]
    for b in range(B):
        ahead, left = before[i, 0, b], before[i, 1, b]
        before[i, 0, b] = ahead * towards[i, 0, b] - left * towards[i, 1, b]
        before[i, 1, b] = ahead * towards[i, 1, b] + left * towards[i, 0, b]
    for x in range(2):
        for b in range(B):
            now = velocity[i, x, b]
            after = next_velocity(now, before[i, x, b], damping[i], thrust[i], dt)
            before[i, x, b] = now
            velocity[i, x, b] = after
            position[i, x, b] += after * dt


@inline_wrapper
def move_by_cells(cells, state):  # type: ignore[no-untyped-def]
    """Move individuals that the caller drives by velocities drawn from cells, others by pushes."""
    for i in range(len(state.drivers)):
        if state.drivers[i] == ACTION:
            draw_step(
                i,
                state.actions,
                state.random,
                cells,
                state.thrust[i],
                state.dt,
                state.position,
                state.velocity,
                state.acceleration,
            )
        else:
            _push(
                i,
                state.actions,
                state.towards,
                state.damping,
                state.thrust,
                state.pushes,
                state.dt,
                state.position,
                state.velocity,
                state.acceleration,
            )


@inline_kernel
def accelerate(velocity, damping, thrust, dt, acceleration):  # type: ignore[no-untyped-def]
    """Turn the velocities before the step into accelerations in multiples of thrust, in place."""
    K, _, B = velocity.shape
    for i in range(K):
        push = thrust[i] * dt
        for x in range(2):
            for b in range(B):
                added = residual(velocity[i, x, b], acceleration[i, x, b], damping[i])
                acceleration[i, x, b] = added / push


@inline_kernel
def replay(  # type: ignore[no-untyped-def]
    drivers, warmup, demos, demo, step_count, senses, position, velocity, acceleration, warming
):
    """Set recorded states: of all individuals during warm-up, of replaying ones always.

    When a replayed path ends before the episode does, that individual coasts. Recorded animals had
    the body of the senses' scales, in a changed world too.
    """
    K, _, B = position.shape
    for b in range(B):
        warming[b] = False
        if demo[b] < 0:
            continue
        frame = demos.start[demo[b]] + step_count[b]
        left = demos.start[demo[b] + 1] - frame  # recorded frames, this one included
        if left <= 0:
            continue
        for i in range(K):
            if drivers[i] == REPLAY or step_count[b] <= warmup:
                for x in range(2):
                    position[i, x, b] = demos.position[frame, i, x]
                    velocity[i, x, b] = demos.velocity[frame, i, x]
                    before = demos.velocity[frame - 1, i, x]
                    added = residual(velocity[i, x, b], before, senses.damping[i])
                    acceleration[i, x, b] = added / senses.push[i]
        warming[b] = step_count[b] < warmup and left > 1


# -- ending and paying ----------------------------------------------------------------------------


@inline_wrapper
def _end(free, state):  # type: ignore[no-untyped-def]
    if free is None:
        judge(
            state.position,
            state.sharing,
            state.field,
            state.walled,
            state.lone,
            state.contact_radius,
            state.dt,
            state.penalty,
            state.step_cost,
            state.nearest,
            state.code,
            state.components,
            state.reward,
        )
    else:
        judge_free(
            state.position,
            state.field,
            state.walled,
            state.shoaling,
            state.velocity,
            state.neighbours,
            state.contact_radius,
            state.dt,
            state.penalty,
            state.code,
            state.components,
            state.reward,
        )


@inline_kernel
def judge(  # type: ignore[no-untyped-def]
    position,
    sharing,
    field,
    walled,
    lone,
    contact_radius,
    dt,
    penalty,
    step_cost,
    nearest,
    code,
    components,
    reward,
):
    """Judge contact, then boundary (where there are no walls), then rewards.

    ``code`` ``(B,)`` int64 becomes the outcome; ``nearest`` is scratch, ``(B,)``. ``lone``: the
    last individual is no target but the pursuer of all others.
    """
    K, _, B = position.shape
    last = K - 1
    touching = contact_radius * contact_radius
    for b in range(B):
        nearest[b] = touching
        code[b] = TIME_OUT
    for i in range(last):  # the nearest of those in contact is the outcome (ties: lower index)
        for b in range(B):
            dx = position[last, 0, b] - position[i, 0, b]
            dy = position[last, 1, b] - position[i, 1, b]
            squared = dx * dx + dy * dy
            components[i, TOUCH, b] = 1.0 if squared < touching else 0.0
            code[b] = i + 1 if squared < nearest[b] else code[b]
            nearest[b] = min(nearest[b], squared)
    for i in range(last):
        for b in range(B):  # shared reward: a capture is everybody's
            shared = sharing[b] == 1 and code[b] > 0
            components[i, TOUCH, b] = 1.0 if shared else components[i, TOUCH, b]
    shape, _, boundary, holes = field
    if not walled:
        for j in range(K):  # targets first: their leaving is named before a pursuer's
            i = j if lone else last - j
            left = TARGET_OUT if (i == last) != lone else PURSUER_OUT
            for b in range(B):
                x = position[i, 0, b]
                y = position[i, 1, b]
                if shape == SQUARE:
                    out = max(abs(x), abs(y)) > boundary
                else:
                    out = x * x + y * y > boundary * boundary and shape == DISC
                components[i, BOUNDARY, b] = penalty if out else 0.0
                code[b] = left if out and code[b] == TIME_OUT else code[b]
            for k in range(len(holes)):
                for b in range(B):
                    out = _is_within(position[i, 0, b], position[i, 1, b], holes[k])
                    components[i, BOUNDARY, b] = penalty if out else components[i, BOUNDARY, b]
                    code[b] = left if out and code[b] == TIME_OUT else code[b]
    if lone:  # a touch is the pursuer's
        for b in range(B):
            components[last, TOUCH, b] = 1.0 if code[b] > 0 else 0.0
            components[last, ELAPSED, b] = 0.0 - step_cost
        for i in range(last):
            for b in range(B):
                lost = components[i, TOUCH, b] != 0.0 or components[i, BOUNDARY, b] != 0.0
                components[i, ELAPSED, b] = 0.0 if lost else dt
                components[i, TOUCH, b] = 0.0
    else:
        for b in range(B):  # the target is paid for every step that it lasts
            lost = code[b] > 0 or code[b] == TARGET_OUT
            components[last, ELAPSED, b] = 0.0 if lost else dt
        for i in range(last):
            for b in range(B):
                components[i, ELAPSED, b] = 0.0 - step_cost
    for i in range(K):
        for b in range(B):
            reward[i, b] = (
                components[i, TOUCH, b] + components[i, ELAPSED, b] + components[i, BOUNDARY, b]
            )


@inline_kernel
def judge_free(  # type: ignore[no-untyped-def]
    position,
    field,
    walled,
    shoaling,
    velocity,
    neighbours,
    contact_radius,
    dt,
    penalty,
    code,
    components,
    reward,
):
    """Judge free animals: leaving ends the episode and costs; time near another may pay."""
    K, _, B = position.shape
    shape, _, boundary, holes = field
    for b in range(B):
        code[b] = TIME_OUT
    pairs = shoaling and K <= PAIRED  # else those within reach along x are looked at
    if shoaling and not pairs:
        components[:, ELAPSED] = 0.0
        copy_states(position, velocity, neighbours.state)
        line_up(neighbours.state, neighbours.along)
        _pay_near(neighbours.state, neighbours.along, contact_radius, dt, components)
    for i in range(K):
        for b in range(B):
            x = position[i, 0, b]
            y = position[i, 1, b]
            far = max(abs(x), abs(y)) if shape == SQUARE else math.sqrt(x * x + y * y)
            out = not walled and shape in (SQUARE, DISC) and far > boundary
            for k in range(0 if walled else len(holes)):
                out |= _is_within(x, y, holes[k])
            near = shoaling and not pairs and components[i, ELAPSED, b] > 0.0
            for j in range(K if pairs else 0):
                dx = position[j, 0, b] - x
                dy = position[j, 1, b] - y
                near |= j != i and dx * dx + dy * dy < contact_radius * contact_radius
            components[i, ELAPSED, b] = dt if near else 0.0
            components[i, BOUNDARY, b] = penalty if out else 0.0
            code[b] = PURSUER_OUT if out else code[b]
            reward[i, b] = components[i, ELAPSED, b] + components[i, BOUNDARY, b]


@jit
def _pay_near(state, along, reach, dt, components):  # type: ignore[no-untyped-def]
    """Pay every free animal within ``reach`` of another; ``along`` has each copy's order by x."""
    for b in range(state.shape[0]):
        x, y, line = state[b, 0], state[b, 1], along[b, 0]
        for place in range(len(line)):
            i, at = line[place], place + 1
            while at < len(line) and x[line[at]] - x[i] < reach:
                j = line[at]
                dx, dy = x[j] - x[i], y[j] - y[i]
                if dx * dx + dy * dy < reach * reach:
                    components[i, ELAPSED, b] = dt
                    components[j, ELAPSED, b] = dt
                at += 1
