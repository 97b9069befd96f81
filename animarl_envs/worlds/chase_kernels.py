"""The equations of the chase world, as loops over copies.

Arrays have the copy last: positions ``(K, 2, B)``, observations ``(K, n, B)``. Each innermost loop
runs over the copies, has no branch and writes one row, so that it compiles to vector instructions.
``field`` is ``(shape code, size, boundary)``.
"""

from __future__ import annotations

import math

import numba as nb

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
        ahead = ACTION_VECTORS[action[b], 0]
        left = ACTION_VECTORS[action[b], 1]
        a = ahead * towards[0, b] - left * towards[1, b]
        velocity[0, b] = next_velocity(velocity[0, b], a, damping, thrust, dt)
    for b in range(B):
        ahead = ACTION_VECTORS[action[b], 0]
        left = ACTION_VECTORS[action[b], 1]
        a = ahead * towards[1, b] + left * towards[0, b]
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
    position, condition, field, contact_radius, dt, penalty, nearest, components, reward, outcome
):
    """Contact, then boundary, then rewards. ``nearest`` is scratch, ``(B,)``."""
    K, _, B = position.shape
    target = K - 1
    nearest[:] = contact_radius * contact_radius
    outcome[:] = TIME_OUT
    for i in range(target):
        _touch(i, position[i], position[target], contact_radius, nearest, components[i], outcome)
    for i in range(target):
        touch = components[i, TOUCH]
        for b in range(B):  # shared reward: a capture is everybody's
            touch[b] = 1.0 if condition[b] == 1 and outcome[b] > 0 else touch[b]
    for i in range(target, -1, -1):  # the target first: its leaving is named before the others'
        _leave(position[i], field, penalty, components[i])
        out = components[i, BOUNDARY]
        code = TARGET_OUT if i == target else PURSUER_OUT
        for b in range(B):
            outcome[b] = code if out[b] != 0.0 and outcome[b] == TIME_OUT else outcome[b]
    elapsed = components[target, ELAPSED]
    for b in range(B):  # the target is paid for every step that it lasts
        elapsed[b] = 0.0 if outcome[b] > 0 or outcome[b] == TARGET_OUT else dt
    for i in range(K):
        _sum(components[i], reward[i])


@jit
def _touch(i, pursuer, target, contact_radius, nearest, components, outcome):  # type: ignore[no-untyped-def]
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
        outcome[b] = i + 1 if squared[b] < nearest[b] else outcome[b]
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
