"""The rules of individuals that nobody controls: pursuers intercept, targets flee.

A pursuer predicts where its target, of several the nearest, will be at some later times if it keeps
its velocity and its last acceleration, and walls hold it. It accelerates towards the first of these
places that it can reach in time, to within contact, or else towards the last.

A target looks ahead along each of its actions. It takes the one that leaves it farthest from
pursuers that accelerate straight at where it is now, and at the last look from walls.

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
from animarl_envs.locomotion import ACTION_VECTORS, NUM_DIRECTIONS
from animarl_envs.worlds.streams import ONE, TWO, ZERO

SQUARE, DISC, OPEN = SHAPE_CODES["square"], SHAPE_CODES["disc"], SHAPE_CODES["open"]
OBSTACLE = len(SHAPE_CODES)
LOOKS = 3  # a target looks ahead by thirds of the time in which its thrust carries it half a size
LEADS = 8  # places at which a pursuer predicts its target
HORIZON = 2.0  # time to the last of them, in those in which its thrust carries it half a size
WALL_WEIGHT = 15.0  # of the walls' cost, beside (size / distance)^2 of each pursuer
SOFTENING = 0.0025  # added to the squared distance in sizes, which may be zero
WALL_MARGIN = 0.25  # walls repel from this share of the arena's size inwards
FAR_AWAY = 1e18  # squared distance of no pursuer; it makes their number even
# Scratch is one array with rows of BLOCK copies, so that the compiler sees which rows are apart.
BLOCK = 64
OWN, FOCUS = 0, 4 * BLOCK  # place and velocity; direction of the focus
LOWEST, BEST = 6 * BLOCK, 7 * BLOCK  # the least cost and its action
OTHER = 8 * BLOCK  # place, velocity, and acceleration or the way to the target
RIVAL, AIM = 14 * BLOCK, 20 * BLOCK  # another target; the way to the place of interception
COST = 22 * BLOCK  # of the pushes and of none
PURSUERS, PURSUER = COST + (NUM_DIRECTIONS + 1) * BLOCK, 3 * LOOKS * BLOCK
_C: Any = np.float32(ACTION_VECTORS[1, 0])
_S: Any = np.float32(0.5)
_TINY, _MOST = np.float32(1e-9), np.float32(np.finfo(np.float32).max)
_SOFT: Any = np.float32(SOFTENING)
_STEEP: Any = np.float32(math.sqrt(WALL_WEIGHT) / WALL_MARGIN)  # (_STEEP * depth)^2 is the cost
_INSIDE: Any = np.float32(_STEEP * (1.0 - WALL_MARGIN))


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
    field,
    contact_radius,
    lone,
    actions,
):
    """Write the action of individual ``i``'s rule in each copy to ``actions[i]``, ``(B,)``.

    ``pushes`` ``(K, 2, A)`` are the actions' vectors in multiples of the thrust, ahead and left.
    ``lone``: the last individual pursues all others, else all others pursue it.
    """
    K, _, B = position.shape
    shape, size, _, holes = field
    last, scale = K - 1, 1.0 / size
    flees = (i == last) != lone
    first, end = (0, last) if i == last else (last, K)
    looks = LOOKS if flees else LEADS
    steps = np.ceil((1.0 if flees else HORIZON) * np.sqrt(size / thrust[i]) / dt)
    reach = np.empty((K, looks, 2), np.float32)
    for j in range(K):
        for look in range(looks):
            until = max(1.0, np.floor((look + 1) * steps / looks))
            carried, pushed = _reach(damping[j], thrust[j], dt, until)
            reach[j, look, 0], reach[j, look, 1] = carried, pushed * scale
    contact = np.float32(contact_radius * scale)
    pairs = (end - first + 1) // 2
    scratch = np.zeros(PURSUERS + (end - first + 1) * PURSUER, np.float32)
    for look in range(LOOKS):  # behind the last pursuer, for a pair
        row = PURSUERS + ((end - first) * LOOKS + look) * 3 * BLOCK
        scratch[row : row + BLOCK] = FAR_AWAY
    for begin in range(0, B, BLOCK):
        count = min(B - begin, BLOCK)
        _stage(i, position, scale, begin, count, scratch, OWN)
        _stage(i, velocity, scale, begin, count, scratch, OWN + 2 * BLOCK)
        _stage(i, towards, 1.0, begin, count, scratch, FOCUS)
        for b in range(count):
            scratch[LOWEST + b] = _MOST
        for j in range(first, end):
            to = OTHER if flees or j == first else RIVAL
            _stage(j, position, scale, begin, count, scratch, to)
            _stage(j, velocity, scale, begin, count, scratch, to + 2 * BLOCK)
            if flees:
                row = PURSUERS + (j - first) * PURSUER
                _place_pursuer(reach[j], reach[i], count, scratch, scratch[row:])
            else:
                _stage(j, acceleration, 1.0, begin, count, scratch, to + 4 * BLOCK)
                if j > first:
                    _keep_nearer(count, scratch)
        if flees:
            _flee(shape, holes, scale, reach[i], pushes[i], pairs, count, scratch)
        else:
            _intercept(shape, contact, reach[i], reach[first], pushes[i], count, scratch)
        for b in range(count):
            actions[i, begin + b] = np.int32(scratch[BEST + b])


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
def _stage(i, vectors, scale, begin, count, scratch, row):  # type: ignore[no-untyped-def]
    """Write scaled vectors of individual ``i`` in the copies from ``begin`` on."""
    out = scratch[row:]
    for x in range(2):
        source, to = vectors[i, x, begin:], out[x * BLOCK :]
        for b in range(count):
            to[b] = source[b] * scale


@inline_kernel
def _keep_nearer(count, scratch):  # type: ignore[no-untyped-def]
    """Keep of two staged targets the nearer one."""
    other, rival, own = scratch[OTHER:], scratch[RIVAL:], scratch[OWN:]
    for b in range(count):
        x, y = rival[b] - own[b], rival[BLOCK + b] - own[BLOCK + b]
        there_x, there_y = other[b] - own[b], other[BLOCK + b] - own[BLOCK + b]
        nearer = x * x + y * y < there_x * there_x + there_y * there_y
        for row in range(0, 6 * BLOCK, BLOCK):
            other[row + b] = rival[row + b] if nearer else other[row + b]


@jit
def _intercept(shape, contact, reach, their_reach, pushes, count, scratch):  # type: ignore[no-untyped-def]
    """Take the action nearest to the way to the place of interception."""
    for look in range(LEADS - 1, -1, -1):
        far = _MOST if look == LEADS - 1 else (reach[look, 1] + contact) ** 2
        if shape == SQUARE:  # compiled for each shape, so that its loop has no branch
            _aim(SQUARE, far, reach[look, 0], their_reach[look], count, scratch)
        elif shape == DISC:
            _aim(DISC, far, reach[look, 0], their_reach[look], count, scratch)
        else:
            _aim(OPEN, far, reach[look, 0], their_reach[look], count, scratch)
    for k in range(0, pushes.shape[1] - 1, NUM_DIRECTIONS):
        magnitude = np.float32(pushes[0, k])
        for b in range(count):
            x, y = magnitude * scratch[AIM + b], magnitude * scratch[AIM + BLOCK + b]
            ex, ey = scratch[FOCUS + b], scratch[FOCUS + BLOCK + b]
            a0, a1, a2, a3, a4, a5 = _along(x * ex + y * ey, y * ex - x * ey)
            _put(0, -a0, a0, scratch, b)
            _put(1, -a1, a1, scratch, b)
            _put(2, -a2, a2, scratch, b)
            _put(3, -a3, a3, scratch, b)
            _put(4, -a4, a4, scratch, b)
            _put(5, -a5, a5, scratch, b)
        _take_best(k, count, scratch)


@nb.njit(inline="always")
def _aim(shape, farthest, carried, their_reach, count, scratch):  # type: ignore[no-untyped-def]
    """Aim at the predicted place of the target where it can be reached."""
    their_carried, their_pushed = their_reach[0], their_reach[1]
    for b in range(count):
        x = scratch[OTHER + b] + their_carried * scratch[OTHER + 2 * BLOCK + b]
        y = scratch[OTHER + BLOCK + b] + their_carried * scratch[OTHER + 3 * BLOCK + b]
        x += their_pushed * min(ONE, max(-ONE, scratch[OTHER + 4 * BLOCK + b]))
        y += their_pushed * min(ONE, max(-ONE, scratch[OTHER + 5 * BLOCK + b]))
        if shape == SQUARE:
            x = min(ONE, max(-ONE, x))
            y = min(ONE, max(-ONE, y))
        elif shape == DISC:
            within = ONE / max(ONE, math.sqrt(x * x + y * y))
            x *= within
            y *= within
        x -= scratch[OWN + b] + carried * scratch[OWN + 2 * BLOCK + b]
        y -= scratch[OWN + BLOCK + b] + carried * scratch[OWN + 3 * BLOCK + b]
        reached = x * x + y * y <= farthest
        scratch[AIM + b] = x if reached else scratch[AIM + b]
        scratch[AIM + BLOCK + b] = y if reached else scratch[AIM + BLOCK + b]


@nb.njit(inline="always")
def _along(ahead, left):  # type: ignore[no-untyped-def]
    """Return the products of a vector with the first six directions; the others are opposite."""
    one, two, three, four = _C * ahead, _S * left, _S * ahead, _C * left
    return ahead, one - two, three - four, -left, -three - four, -one - two


@nb.njit(inline="always")
def _put(k, cost, opposite, scratch, b):  # type: ignore[no-untyped-def]
    """Write the costs of direction ``k`` and of its opposite."""
    scratch[COST + k * BLOCK + b] = cost
    scratch[COST + (k + 6) * BLOCK + b] = opposite


@inline_kernel
def _take_best(first, count, scratch):  # type: ignore[no-untyped-def]
    """Compare the costs of the directions, whose first is that action, with the lowest so far."""
    for row in range(0, NUM_DIRECTIONS, 4):
        cost, number = scratch[COST + row * BLOCK :], np.float32(first + row)
        for b in range(count):
            best, lowest = scratch[BEST + b], scratch[LOWEST + b]
            for k in range(4):
                better = cost[k * BLOCK + b] < lowest
                best = number + np.float32(k) if better else best
                lowest = cost[k * BLOCK + b] if better else lowest
            scratch[BEST + b], scratch[LOWEST + b] = best, lowest


@inline_kernel
def _place_pursuer(reach, own_reach, count, scratch, out):  # type: ignore[no-untyped-def]
    """Write three rows for each look at a pursuer that accelerates straight at its target.

    With its offset ``o`` from the coasting target these are ``o^2``, and twice the target's reach
    times ``o`` ahead and left, so that the squared distance after a push ``a`` is their sum with
    factors of ``a`` and a constant.
    """
    for b in range(count):
        x = scratch[OWN + b] - scratch[OTHER + b]
        y = scratch[OWN + BLOCK + b] - scratch[OTHER + BLOCK + b]
        per_distance = ONE / (math.sqrt(x * x + y * y) + _TINY)
        scratch[OTHER + 4 * BLOCK + b] = x * per_distance
        scratch[OTHER + 5 * BLOCK + b] = y * per_distance
    for look in range(LOOKS):
        carried, pushed = reach[look, 0], reach[look, 1]
        own_carried, twice = own_reach[look, 0], TWO * own_reach[look, 1]
        at = out[3 * look * BLOCK :]
        for b in range(count):
            x = scratch[OWN + b] + own_carried * scratch[OWN + 2 * BLOCK + b]
            y = scratch[OWN + BLOCK + b] + own_carried * scratch[OWN + 3 * BLOCK + b]
            x -= scratch[OTHER + b] + carried * scratch[OTHER + 2 * BLOCK + b]
            y -= scratch[OTHER + BLOCK + b] + carried * scratch[OTHER + 3 * BLOCK + b]
            x -= pushed * scratch[OTHER + 4 * BLOCK + b]
            y -= pushed * scratch[OTHER + 5 * BLOCK + b]
            ex, ey = twice * scratch[FOCUS + b], twice * scratch[FOCUS + BLOCK + b]
            at[b] = x * x + y * y + _SOFT
            at[BLOCK + b] = x * ex + y * ey
            at[2 * BLOCK + b] = y * ex - x * ey


@jit
def _flee(shape, holes, scale, reach, pushes, pairs, count, scratch):  # type: ignore[no-untyped-def]
    """Take the action of the least danger at the looks; pursuers are summed two at a time.

    Obstacles repel as steeply as walls.
    """
    for k in range(0, pushes.shape[1] - 1, NUM_DIRECTIONS):
        magnitude = np.float32(pushes[0, k])
        carried, pushed = reach[LOOKS - 1, 0], magnitude * reach[LOOKS - 1, 1]
        scratch[COST:PURSUERS] = ZERO
        if shape == SQUARE:  # compiled for each shape, so that its loop has no branch
            _cost_walls(SQUARE, ZERO, ZERO, ZERO, carried, pushed, count, scratch)
        elif shape == DISC:
            _cost_walls(DISC, ZERO, ZERO, ZERO, carried, pushed, count, scratch)
        for hole in range(len(holes)):
            x, y = np.float32(holes[hole, 0] * scale), np.float32(holes[hole, 1] * scale)
            rim = np.float32(_STEEP * (holes[hole, 2] * scale + WALL_MARGIN))
            _cost_walls(OBSTACLE, x, y, rim, carried, pushed, count, scratch)
        for pair in range(pairs):
            for look in range(LOOKS):
                row = PURSUERS + (2 * pair * LOOKS + look) * 3 * BLOCK
                _add_danger(magnitude, reach[look, 1], count, scratch, scratch[row:])
        _take_best(k, count, scratch)
    coast = np.float32(pushes.shape[1] - 1)
    for b in range(count):
        better = scratch[COST + NUM_DIRECTIONS * BLOCK + b] < scratch[LOWEST + b]
        scratch[BEST + b] = coast if better else scratch[BEST + b]


@nb.njit(inline="always")
def _cost_walls(shape, middle_x, middle_y, rim, carried, pushed, count, scratch):  # type: ignore[no-untyped-def]
    """Add what walls about a middle cost where each push leads, and without a push."""
    for b in range(count):
        x = _STEEP * (scratch[OWN + b] + carried * scratch[OWN + 2 * BLOCK + b] - middle_x)
        y = _STEEP * (scratch[OWN + BLOCK + b] + carried * scratch[OWN + 3 * BLOCK + b] - middle_y)
        ex, ey = pushed * scratch[FOCUS + b], pushed * scratch[FOCUS + BLOCK + b]
        ex *= _STEEP
        ey *= _STEEP
        x0, x1, x2, x3, x4, x5 = _along(ex, -ey)
        y0, y1, y2, y3, y4, y5 = _along(ey, ex)
        _raise(0, shape, rim, x, y, x0, y0, scratch, b)
        _raise(1, shape, rim, x, y, x1, y1, scratch, b)
        _raise(2, shape, rim, x, y, x2, y2, scratch, b)
        _raise(3, shape, rim, x, y, x3, y3, scratch, b)
        _raise(4, shape, rim, x, y, x4, y4, scratch, b)
        _raise(5, shape, rim, x, y, x5, y5, scratch, b)
        scratch[COST + NUM_DIRECTIONS * BLOCK + b] += _depth(shape, rim, x, y)


@nb.njit(inline="always")
def _raise(k, shape, rim, x, y, ex, ey, scratch, b):  # type: ignore[no-untyped-def]
    """Raise the costs of direction ``k`` and of its opposite by how deep they lead into walls."""
    scratch[COST + k * BLOCK + b] += _depth(shape, rim, x + ex, y + ey)
    scratch[COST + (k + 6) * BLOCK + b] += _depth(shape, rim, x - ex, y - ey)


@nb.njit(inline="always")
def _depth(shape, rim, x, y):  # type: ignore[no-untyped-def]
    """Return the squared depth of a place in the margin of the walls."""
    depth = ZERO
    if shape == SQUARE:
        depth_x = x - min(_INSIDE, max(-_INSIDE, x))
        depth_y = y - min(_INSIDE, max(-_INSIDE, y))
        depth = depth_x * depth_x + depth_y * depth_y
    elif shape == DISC:
        out = math.sqrt(x * x + y * y)
        depth = max(ZERO, out - _INSIDE)
        depth *= depth
    else:
        depth = max(ZERO, rim - math.sqrt(x * x + y * y))
        depth *= depth
    return depth


@inline_kernel
def _add_danger(magnitude, pushed, count, scratch, pair):  # type: ignore[no-untyped-def]
    """Add (1 / distance)^2 of two pursuers at one look to the costs of all directions."""
    own = (magnitude * pushed) * (magnitude * pushed)
    second = pair[PURSUER:]
    for b in range(count):
        d, e = pair[b], second[b]
        p0, p1, p2, p3, p4, p5 = _along(
            magnitude * pair[BLOCK + b], magnitude * pair[2 * BLOCK + b]
        )
        q0, q1, q2, q3, q4, q5 = _along(
            magnitude * second[BLOCK + b], magnitude * second[2 * BLOCK + b]
        )
        scratch[COST + NUM_DIRECTIONS * BLOCK + b] += (d + e) / (d * e)
        d += own
        e += own
        _add(0, d, e, p0, q0, scratch, b)
        _add(1, d, e, p1, q1, scratch, b)
        _add(2, d, e, p2, q2, scratch, b)
        _add(3, d, e, p3, q3, scratch, b)
        _add(4, d, e, p4, q4, scratch, b)
        _add(5, d, e, p5, q5, scratch, b)


@nb.njit(inline="always")
def _add(k, first, second, along_first, along_second, scratch, b):  # type: ignore[no-untyped-def]
    """Add to the costs of direction ``k`` and of its opposite; one division for both pursuers."""
    one, two = first + along_first, second + along_second
    scratch[COST + k * BLOCK + b] += (one + two) / (one * two)
    one, two = first - along_first, second - along_second
    scratch[COST + (k + 6) * BLOCK + b] += (one + two) / (one * two)
