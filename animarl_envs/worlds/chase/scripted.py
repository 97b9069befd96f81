"""The rules of individuals that nobody controls: pursuers intercept, targets flee.

A pursuer predicts where its target, of several the nearest, will be at some later times if it keeps
its velocity and its last acceleration, and walls hold it. It accelerates towards the first of these
places that it can reach in time, to within contact, or else towards the last.

A target looks ahead along each of its actions. It takes the one that leaves it farthest from walls,
and from pursuers that accelerate straight at where it is now.

Copies are taken ``BLOCK`` at a time, so that the numbers of a loop stay in the first cache. Lengths
are float32 in sizes of the arena, so that a vector instruction takes eight copies. Only the choice
of the action depends on them.
"""

import math
from typing import Any

import numba as nb
import numpy as np

from animarl_envs.arena import SHAPE_CODES
from animarl_envs.compiling import inline_kernel, jit

SQUARE, DISC = SHAPE_CODES["square"], SHAPE_CODES["disc"]
LOOKS = 3  # a target looks ahead by thirds of the time in which its thrust carries it half a size
LEADS = 12  # places at which a pursuer predicts its target
HORIZON = 2.0  # time to the last of them, in those in which its thrust carries it half a size
WALL_WEIGHT = 10.0  # of the walls' cost, beside (size / distance)^2 of each pursuer
SOFTENING = 0.0025  # added to the squared distance in sizes, which may be zero
WALL_MARGIN = 0.25  # walls repel from this share of the arena's size inwards
BLOCK = 128  # copies that a rule decides for at a time
NO_WALL = -1  # in place of the code of a shape
FAR_AWAY = 1e9  # a pursuer there costs nothing; it makes their number even
_ZERO: Any = np.float32(0.0)
_ONE: Any = np.float32(1.0)
_TINY, _MOST = np.float32(1e-9), np.float32(np.finfo(np.float32).max)
_SOFT, _WEIGHT = np.float32(SOFTENING), np.float32(WALL_WEIGHT / WALL_MARGIN**2)
_INSIDE: Any = np.float32(1.0 - WALL_MARGIN)


@jit
def decide(  # type: ignore[no-untyped-def]
    i,
    position,
    velocity,
    acceleration,
    towards,
    damping,
    thrust,
    pushes,
    dt,
    shape,
    size,
    contact_radius,
    lone,
    actions,
):
    """Write the action of individual ``i``'s rule in each copy to ``actions[i]``, ``(B,)``.

    ``pushes`` ``(K, 2, A)`` are the actions' vectors in multiples of the thrust, ahead and left.
    ``lone``: the last individual pursues all others, else all others pursue it.
    """
    K, _, B = position.shape
    last, scale = K - 1, 1.0 / size
    flees = (i == last) != lone
    first, end = (0, last) if i == last else (last, K)
    pairs = (end - first + 1) // 2
    looks = LOOKS if flees else LEADS
    steps = np.ceil((1.0 if flees else HORIZON) * np.sqrt(size / thrust[i]) / dt)
    reach = np.empty((K, looks, 2), np.float32)
    for j in range(K):
        for look in range(looks):
            until = max(1.0, np.floor((look + 1) * steps / looks))
            carried, pushed = _reach(damping[j], thrust[j], dt, until)
            reach[j, look, 0], reach[j, look, 1] = carried, pushed * scale
    contact = np.float32(contact_radius * scale)
    contact = np.float32(contact_radius * scale)
    room = min(B, BLOCK)  # scratch of a block; the last block may leave some of it unused
    own, other = np.zeros((6, room), np.float32), np.zeros((7, room), np.float32)
    theirs = np.full((4 * LOOKS * pairs, room), FAR_AWAY, np.float32)
    lowest, best = np.empty(room, np.float32), np.empty(room, np.float32)
    for begin in range(0, B, BLOCK):
        count = min(B - begin, BLOCK)
        _stage(i, position, velocity, scale, begin, own)
        for x in range(2):
            for b in range(count):
                own[4 + x, b] = towards[i, x, begin + b]
        for j in range(first, end):
            if flees:
                pair, second = (j - first) // 2, (j - first) % 2
                _stage(j, position, velocity, scale, begin, other)
                _place_pursuer(4 * LOOKS * pair + 2 * second, reach[j], own, other, theirs)
            else:
                only = j == first
                _stage_target(j, only, position, velocity, acceleration, scale, begin, own, other)
        for b in range(room):
            lowest[b] = _MOST
            best[b] = _ZERO
        if flees:
            _flee(shape, reach[i], pushes[i], pairs, own, theirs, lowest, best)
        else:
            _intercept(shape, contact, reach[i], reach[first], pushes[i], own, other, lowest, best)
        for b in range(count):
            actions[i, begin + b] = np.int32(best[b])


@nb.njit(inline="always")
def _reach(damping, thrust, dt, steps):  # type: ignore[no-untyped-def]
    """Return how far velocity 1 and a held unit action carry in so many steps.

    The sums of v' = (1 - d) v + u a dt and p' = p + v' dt.
    """
    if damping < 1e-9:
        return steps * dt, thrust * dt * dt * steps * (steps + 1.0) / 2.0
    kept = 1.0 - damping
    carried = dt * kept * (1.0 - kept**steps) / damping
    return carried, thrust * dt * (steps * dt - carried) / damping


@inline_kernel
def _stage(i, position, velocity, scale, begin, out):  # type: ignore[no-untyped-def]
    """Write position and velocity of individual ``i`` in the copies from ``begin`` on."""
    for x in range(2):
        for b in range(min(position.shape[2] - begin, BLOCK)):
            out[x, b] = position[i, x, begin + b] * scale
            out[2 + x, b] = velocity[i, x, begin + b] * scale


@inline_kernel
def _stage_target(j, only, position, velocity, acceleration, scale, begin, own, target):  # type: ignore[no-untyped-def]
    """Write what is known of target ``j`` where it is nearer than the one in ``target``.

    Its rows are position, velocity, acceleration and squared distance.
    """
    for b in range(min(position.shape[2] - begin, BLOCK)):
        x = position[j, 0, begin + b] * scale
        y = position[j, 1, begin + b] * scale
        dx = x - own[0, b]
        dy = y - own[1, b]
        nearer = only or dx * dx + dy * dy < target[6, b]
        pushed_x = min(1.0, max(-1.0, acceleration[j, 0, begin + b]))
        pushed_y = min(1.0, max(-1.0, acceleration[j, 1, begin + b]))
        target[0, b] = x if nearer else target[0, b]
        target[1, b] = y if nearer else target[1, b]
        target[2, b] = velocity[j, 0, begin + b] * scale if nearer else target[2, b]
        target[3, b] = velocity[j, 1, begin + b] * scale if nearer else target[3, b]
        target[4, b] = pushed_x if nearer else target[4, b]
        target[5, b] = pushed_y if nearer else target[5, b]
        target[6, b] = dx * dx + dy * dy if nearer else target[6, b]


@jit
def _intercept(shape, contact, reach, their_reach, pushes, own, target, lowest, best):  # type: ignore[no-untyped-def]
    """Take the action nearest to the way to the place of interception."""
    aim = np.zeros_like(own[:2])
    for look in range(len(reach) - 1, -1, -1):
        carried, pushed = reach[look, 0], reach[look, 1] + contact
        their_carried, their_pushed = their_reach[look, 0], their_reach[look, 1]
        farthest = _MOST if look == len(reach) - 1 else pushed * pushed
        for b in range(aim.shape[1]):
            x = target[0, b] + their_carried * target[2, b] + their_pushed * target[4, b]
            y = target[1, b] + their_carried * target[3, b] + their_pushed * target[5, b]
            if shape == SQUARE:
                x = min(_ONE, max(-_ONE, x))
                y = min(_ONE, max(-_ONE, y))
            elif shape == DISC:
                within = _ONE / max(_ONE, math.sqrt(x * x + y * y))
                x *= within
                y *= within
            x -= own[0, b] + carried * own[2, b]
            y -= own[1, b] + carried * own[3, b]
            reached = x * x + y * y <= farthest
            aim[0, b] = x if reached else aim[0, b]
            aim[1, b] = y if reached else aim[1, b]
    for b in range(aim.shape[1]):
        x, y = aim[0, b], aim[1, b]
        aim[0, b] = x * own[4, b] + y * own[5, b]
        aim[1, b] = y * own[4, b] - x * own[5, b]
    for k in range(pushes.shape[1]):
        ahead, left, number = np.float32(pushes[0, k]), np.float32(pushes[1, k]), np.float32(k)
        for b in range(aim.shape[1]):
            cost = -(ahead * aim[0, b] + left * aim[1, b])
            better = cost < lowest[b]
            best[b] = number if better else best[b]
            lowest[b] = cost if better else lowest[b]


@inline_kernel
def _place_pursuer(row, reach, own, pursuer, theirs):  # type: ignore[no-untyped-def]
    """Write where a pursuer will be at each look if it accelerates straight at where ``own`` is.

    The first place goes to ``row`` of ``theirs`` and the next, the others four rows below.
    """
    for b in range(own.shape[1]):
        x = own[0, b] - pursuer[0, b]
        y = own[1, b] - pursuer[1, b]
        per_distance = _ONE / (math.sqrt(x * x + y * y) + _TINY)
        pursuer[4, b] = x * per_distance
        pursuer[5, b] = y * per_distance
    for look in range(LOOKS):
        carried, pushed = reach[look, 0], reach[look, 1]
        for x in range(2):
            for b in range(own.shape[1]):
                place = pursuer[x, b] + carried * pursuer[2 + x, b]
                theirs[row + 4 * look + x, b] = place + pushed * pursuer[4 + x, b]


@jit
def _flee(shape, reach, pushes, pairs, own, theirs, lowest, best):  # type: ignore[no-untyped-def]
    """Take the action of the least danger at the looks; pursuers are summed two at a time."""
    coasting, cost = np.empty((2 * LOOKS, len(best)), np.float32), np.zeros_like(best)
    for look in range(LOOKS):
        for x in range(2):
            for b in range(len(best)):
                coasting[2 * look + x, b] = own[x, b] + reach[look, 0] * own[2 + x, b]
    for k in range(pushes.shape[1]):
        ahead, left, number = np.float32(pushes[0, k]), np.float32(pushes[1, k]), np.float32(k)
        for pair in range(pairs):
            row, walls = 4 * LOOKS * pair, shape if pair == 0 else NO_WALL
            _add_danger(ahead, left, reach[:, 1], row, own, coasting, theirs, walls, cost)
        for b in range(len(best)):
            better = cost[b] < lowest[b]
            best[b] = number if better else best[b]
            lowest[b] = cost[b] if better else lowest[b]
            cost[b] = _ZERO


@jit
def _add_danger(ahead, left, pushed, row, own, coasting, theirs, walls, cost):  # type: ignore[no-untyped-def]
    """Add to ``cost`` what an action costs at the three looks, where two pursuers are near."""
    pushed_1, pushed_2, pushed_3 = pushed[0], pushed[1], pushed[2]
    for b in range(len(cost)):
        ax = ahead * own[4, b] - left * own[5, b]
        ay = ahead * own[5, b] + left * own[4, b]
        x1, y1 = coasting[0, b] + pushed_1 * ax, coasting[1, b] + pushed_1 * ay
        x2, y2 = coasting[2, b] + pushed_2 * ax, coasting[3, b] + pushed_2 * ay
        x3, y3 = coasting[4, b] + pushed_3 * ax, coasting[5, b] + pushed_3 * ay
        danger = _danger(x1, y1, row, b, theirs, walls) + _danger(x2, y2, row + 4, b, theirs, walls)
        cost[b] += danger + _danger(x3, y3, row + 8, b, theirs, walls)


@nb.njit(inline="always")
def _danger(x, y, row, b, theirs, walls):  # type: ignore[no-untyped-def]
    """Return the cost of being at ``(x, y)``: (1 / distance)^2 of two pursuers, and of the walls.

    ``row`` is the first of the pursuers' four in ``theirs``. The walls, of that shape, cost the
    squared depth in their margin.
    """
    dx = theirs[row, b] - x
    dy = theirs[row + 1, b] - y
    one = dx * dx + dy * dy + _SOFT
    dx = theirs[row + 2, b] - x
    dy = theirs[row + 3, b] - y
    two = dx * dx + dy * dy + _SOFT
    cost = (one + two) / (one * two)  # one division for both
    if walls == SQUARE:
        depth_x = x - min(_INSIDE, max(-_INSIDE, x))
        depth_y = y - min(_INSIDE, max(-_INSIDE, y))
        cost += _WEIGHT * (depth_x * depth_x + depth_y * depth_y)
    elif walls == DISC:
        depth = max(_ZERO, math.sqrt(x * x + y * y) - _INSIDE)
        cost += _WEIGHT * depth * depth
    return cost
