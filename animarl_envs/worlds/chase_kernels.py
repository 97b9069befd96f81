"""The equations of the chase world, as loops over copies.

Arrays have the copy last: positions ``(K, 2, B)``, observations ``(K, n, B)``. Each innermost loop
runs over the copies, has no branch and writes one row, so that it compiles to vector instructions.
``field`` is ``(shape code, size, boundary)``.
"""

from __future__ import annotations

import math

import numba as nb
import numpy as np

from animarl_envs.arena import SHAPE_CODES
from animarl_envs.demos.demonstrations import PURSUER_OUT, TARGET_OUT, TIME_OUT
from animarl_envs.locomotion import ACTION_VECTORS, COAST, next_velocity
from animarl_envs.scenario import COASTING, REPLAY, SCRIPTED
from animarl_envs.worlds.arctangent import angle_of
from animarl_envs.worlds.rules import scripted_action
from animarl_envs.worlds.streams import next_uniform

SQUARE, DISC, OPEN = SHAPE_CODES["square"], SHAPE_CODES["disc"], SHAPE_CODES["open"]
TOUCH, ELAPSED, BOUNDARY = 0, 1, 2
DX, DY, DVX, DVY, DISTANCE = 0, 1, 2, 3, 4
RELATIVE = 5
OWN_ENTRIES, OTHER_ENTRIES = 6, 6

AHEAD = np.ascontiguousarray(ACTION_VECTORS[:, 0])
LEFT = np.ascontiguousarray(ACTION_VECTORS[:, 1])

jit = nb.njit(cache=True, error_model="numpy")


# -- starting -------------------------------------------------------------------------------------


@jit
def start(mask, demos, demo, fixed, half_side, contact_radius, random, position, velocity):  # type: ignore[no-untyped-def]
    """First states: recorded, given, or uniform in a square without contact; at rest but for the
    first."""
    K, _, B = position.shape
    target = K - 1
    for b in range(B):
        if not mask[b]:
            continue
        if demo[b] >= 0:
            frame = demos.start[demo[b]]
            for i in range(K):
                for x in range(2):
                    position[i, x, b] = demos.position[frame, i, x]
                    velocity[i, x, b] = demos.velocity[frame, i, x]
            continue
        for i in range(K):
            velocity[i, 0, b] = 0.0
            velocity[i, 1, b] = 0.0
        if len(fixed):
            for i in range(K):
                position[i, 0, b] = fixed[i, 0]
                position[i, 1, b] = fixed[i, 1]
            continue
        touching = True
        while touching:
            for i in range(K):
                for x in range(2):
                    position[i, x, b] = half_side * (2.0 * next_uniform(random, b) - 1.0)
            touching = False
            for i in range(target):
                dx = position[target, 0, b] - position[i, 0, b]
                dy = position[target, 1, b] - position[i, 1, b]
                touching |= dx * dx + dy * dy < contact_radius * contact_radius


# -- a whole step ---------------------------------------------------------------------------------


@jit
def advance(  # type: ignore[no-untyped-def]
    asked, actions, drivers, driven, demos, demo, condition, damping, thrust, numbers, position,
    velocity, towards, others, nearest, code, components, reward, outcome, terminated, truncated,
    step_count, warming, observation,
):  # fmt: skip
    """All of a step in one call. ``asked`` is (B, K); ``actions``, ``others``, ``nearest`` and
    ``code`` are scratch; ``driven`` tells whether anybody does not follow ``asked``."""
    (
        dt, contact_radius, penalty, time_limit, warmup, field, rebounds, senses_centre,
    ) = numbers  # fmt: skip
    B = len(step_count)
    for i in range(len(actions)):
        for b in range(B):
            actions[i, b] = asked[b, i]
    step_count += 1
    if driven:
        drive(drivers, actions, position, velocity, towards, damping, thrust, dt, field)
    move(actions, towards, damping, thrust, dt, position, velocity)
    if driven or warmup > 0:
        replay(drivers, warmup, demos, demo, step_count, position, velocity, warming)
    if rebounds:
        rebound(field, position, velocity)
    judge(
        position, condition, field, contact_radius, dt, penalty, nearest, code, components, reward
    )
    for b in range(B):
        outcome[b] = code[b]
        terminated[b] = code[b] != TIME_OUT
        truncated[b] = step_count[b] >= time_limit and code[b] == TIME_OUT
    observe(position, velocity, towards, others, senses_centre, observation)


# -- moving ---------------------------------------------------------------------------------------


@jit
def drive(drivers, actions, position, velocity, towards, damping, thrust, dt, field):  # type: ignore[no-untyped-def]
    """Put the actions of those whom the caller does not drive into ``actions`` ``(K, B)``."""
    for i in range(len(drivers)):
        if drivers[i] == COASTING or drivers[i] == REPLAY:
            actions[i] = COAST
        elif drivers[i] == SCRIPTED:
            for b in range(actions.shape[1]):
                actions[i, b] = scripted_action(
                    b, i, position, velocity, towards, damping[i], thrust[i], dt, field[0], field[1]
                )


@jit
def move(actions, towards, damping, thrust, dt, position, velocity):  # type: ignore[no-untyped-def]
    """v' = (1 - d) v + u a dt, then p' = p + v' dt, for all individuals."""
    for i in range(len(actions)):
        _move_one(actions[i], towards[i], damping[i], thrust[i], dt, position[i], velocity[i])


@jit
def _move_one(action, towards, damping, thrust, dt, position, velocity):  # type: ignore[no-untyped-def]
    B = len(action)
    for b in range(B):
        a = AHEAD[action[b]] * towards[0, b] - LEFT[action[b]] * towards[1, b]
        velocity[0, b] = next_velocity(velocity[0, b], a, damping, thrust, dt)
    for b in range(B):
        a = AHEAD[action[b]] * towards[1, b] + LEFT[action[b]] * towards[0, b]
        velocity[1, b] = next_velocity(velocity[1, b], a, damping, thrust, dt)
    for x in range(2):
        for b in range(B):
            position[x, b] += velocity[x, b] * dt


@jit
def replay(drivers, warmup, demos, demo, step_count, position, velocity, warming):  # type: ignore[no-untyped-def]
    """Set what follows its demonstration: all during warm-up, the replaying ones always.

    When a replayed path ends before the episode does, that individual coasts.
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
        warming[b] = step_count[b] < warmup and left > 1


@jit
def rebound(field, position, velocity):  # type: ignore[no-untyped-def]
    """Back onto the boundary; the outward velocity is reversed and halved."""
    shape, _, boundary = field
    K, _, B = position.shape
    for i in range(K):
        for b in range(B):
            if shape == SQUARE:
                for x in range(2):
                    if abs(position[i, x, b]) > boundary:
                        position[i, x, b] = math.copysign(boundary, position[i, x, b])
                        if velocity[i, x, b] * position[i, x, b] > 0.0:
                            velocity[i, x, b] *= -0.5
            elif shape == DISC:
                radius = math.sqrt(position[i, 0, b] ** 2 + position[i, 1, b] ** 2)
                if radius > boundary:
                    nx = position[i, 0, b] / radius
                    ny = position[i, 1, b] / radius
                    # a hair inside, so that rounding does not leave it outside
                    position[i, 0, b] = boundary * nx * (1.0 - 1e-12)
                    position[i, 1, b] = boundary * ny * (1.0 - 1e-12)
                    outward = velocity[i, 0, b] * nx + velocity[i, 1, b] * ny
                    if outward > 0.0:
                        velocity[i, 0, b] -= 1.5 * outward * nx
                        velocity[i, 1, b] -= 1.5 * outward * ny


# -- ends and rewards -----------------------------------------------------------------------------


@jit
def judge(  # type: ignore[no-untyped-def]
    position, condition, field, contact_radius, dt, penalty, nearest, code, components, reward
):
    """Contact, then boundary, then rewards.

    ``code`` ``(B,)`` int64 becomes the outcome; ``nearest`` is scratch, ``(B,)``.
    """
    K, _, B = position.shape
    target = K - 1
    nearest[:] = contact_radius * contact_radius
    code[:] = TIME_OUT
    for i in range(target):
        _touch(i, position[i], position[target], contact_radius, nearest, components[i], code)
    for i in range(target):
        touch = components[i, TOUCH]
        for b in range(B):  # shared reward: a capture is everybody's
            touch[b] = 1.0 if condition[b] == 1 and code[b] > 0 else touch[b]
    for i in range(target, -1, -1):  # the target first: its leaving is named before the others'
        _leave(position[i], field, penalty, components[i])
        out = components[i, BOUNDARY]
        left = TARGET_OUT if i == target else PURSUER_OUT
        for b in range(B):
            code[b] = left if out[b] != 0.0 and code[b] == TIME_OUT else code[b]
    elapsed = components[target, ELAPSED]
    for b in range(B):  # the target is paid for every step that it lasts
        elapsed[b] = 0.0 if code[b] > 0 or code[b] == TARGET_OUT else dt
    for i in range(K):
        _sum(components[i], reward[i])


@jit
def _touch(i, pursuer, target, contact_radius, nearest, components, code):  # type: ignore[no-untyped-def]
    """Who touches the target; the nearest of them is the outcome (ties: the lower index)."""
    B = len(nearest)
    squared = components[ELAPSED]  # free until rewards are summed
    for b in range(B):
        dx = target[0, b] - pursuer[0, b]
        dy = target[1, b] - pursuer[1, b]
        squared[b] = dx * dx + dy * dy
    touch = components[TOUCH]
    for b in range(B):
        touch[b] = 1.0 if squared[b] < contact_radius * contact_radius else 0.0
    for b in range(B):
        code[b] = i + 1 if squared[b] < nearest[b] else code[b]
    for b in range(B):
        nearest[b] = min(nearest[b], squared[b])
    squared[:] = 0.0


@jit
def _leave(position, field, penalty, components):  # type: ignore[no-untyped-def]
    """The penalty for being out of bounds."""
    shape, _, boundary = field
    B = position.shape[1]
    out = components[BOUNDARY]
    if shape == SQUARE:
        for b in range(B):
            out[b] = penalty if max(abs(position[0, b]), abs(position[1, b])) > boundary else 0.0
    elif shape == DISC:
        for b in range(B):
            squared = position[0, b] * position[0, b] + position[1, b] * position[1, b]
            out[b] = penalty if squared > boundary * boundary else 0.0


@jit
def _sum(components, reward):  # type: ignore[no-untyped-def]
    for b in range(len(reward)):
        reward[b] = components[TOUCH, b] + components[ELAPSED, b] + components[BOUNDARY, b]


# -- sensing --------------------------------------------------------------------------------------


@jit
def observe(position, velocity, towards, others, senses_centre, observation):  # type: ignore[no-untyped-def]
    """Focus directions and egocentric observations; ``others`` is scratch, ``(K - 1, 5, B)``.

    The others in order: target first, then pursuers by distance, ties by index. The first of them
    is the focus. At distance zero the old direction towards it is kept.
    """
    K, _, B = position.shape
    target = K - 1
    for i in range(K):
        ranks = 0
        if i != target:
            _relative(position[i], velocity[i], position[target], velocity[target], others[0])
            ranks = 1
        sorted_from = ranks
        for j in range(target):
            if j != i:
                _relative(position[i], velocity[i], position[j], velocity[j], others[ranks])
                ranks += 1
        for last in range(ranks - 1, sorted_from, -1):  # stable bubble sort, without branches
            for rank in range(sorted_from, last):
                _exchange(others[rank], others[rank + 1])
        _observe_own(position[i], velocity[i], others[0], towards[i], observation[i])
        for rank in range(ranks):
            entry = OWN_ENTRIES + OTHER_ENTRIES * rank
            _observe_other(others[rank], towards[i], observation[i, entry : entry + OTHER_ENTRIES])
            if rank == 0:  # straight ahead, by definition
                observation[i, entry + 1] = 0.0
                observation[i, entry + 5] = 0.0
        if senses_centre:
            centre = observation[i, OWN_ENTRIES + OTHER_ENTRIES * ranks]
            for b in range(B):
                centre[b] = math.sqrt(position[i, 0, b] ** 2 + position[i, 1, b] ** 2)


@jit
def _relative(own_position, own_velocity, its_position, its_velocity, other):  # type: ignore[no-untyped-def]
    """Relative position, velocity and distance of one other individual, arena frame."""
    B = other.shape[1]
    for x in range(2):
        for b in range(B):
            other[DX + x, b] = its_position[x, b] - own_position[x, b]
        for b in range(B):
            other[DVX + x, b] = its_velocity[x, b] - own_velocity[x, b]
    for b in range(B):
        other[DISTANCE, b] = math.sqrt(other[DX, b] * other[DX, b] + other[DY, b] * other[DY, b])


@jit
def _exchange(first, second):  # type: ignore[no-untyped-def]
    """Exchange two others where the first is the farther one."""
    B = first.shape[1]
    for row in range(DISTANCE):
        for b in range(B):
            swap = first[DISTANCE, b] > second[DISTANCE, b]
            one = first[row, b]
            two = second[row, b]
            first[row, b] = two if swap else one
            second[row, b] = one if swap else two
    for b in range(B):
        one = first[DISTANCE, b]
        two = second[DISTANCE, b]
        first[DISTANCE, b] = min(one, two)
        second[DISTANCE, b] = max(one, two)


@jit
def _observe_own(position, velocity, focus, towards, observation):  # type: ignore[no-untyped-def]
    B = position.shape[1]
    for x in range(2):
        for b in range(B):
            far = focus[DISTANCE, b] > 0.0
            towards[x, b] = focus[x, b] / focus[DISTANCE, b] if far else towards[x, b]
        for b in range(B):
            observation[x, b] = position[x, b]
        for b in range(B):
            observation[4 + x, b] = towards[x, b]
    for b in range(B):
        observation[2, b] = velocity[0, b] * towards[0, b] + velocity[1, b] * towards[1, b]
    for b in range(B):
        observation[3, b] = velocity[1, b] * towards[0, b] - velocity[0, b] * towards[1, b]


@jit
def _observe_other(other, towards, observation):  # type: ignore[no-untyped-def]
    """Position and velocity turned into the egocentric frame, distance, bearing."""
    B = towards.shape[1]
    for row in range(0, 4, 2):
        for b in range(B):
            observation[row, b] = other[row, b] * towards[0, b] + other[row + 1, b] * towards[1, b]
        for b in range(B):
            observation[row + 1, b] = (
                other[row + 1, b] * towards[0, b] - other[row, b] * towards[1, b]
            )
    for b in range(B):
        observation[4, b] = other[DISTANCE, b]
    for b in range(B):
        observation[5, b] = angle_of(observation[0, b], observation[1, b])
