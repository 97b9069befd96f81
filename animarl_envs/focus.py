"""What each recorded individual is heading for: the x axis of its egocentric frame.

The focus of a pursuer is the target; the focus of the target is its nearest pursuer, chosen anew at
each frame (ties: the lower index). Where one pursues several, the focus of each target is the
pursuer, that of the pursuer its nearest target. A searcher must not be told where the source is:
its focus is the fixed upwind direction. Where nobody is pursued each animal has its own course:
where it has been going over the last second (:data:`COURSE`).
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from animarl_envs.array_types import Bools, Floats
from animarl_envs.compiling import inline_kernel, jit

UPWIND = (-1.0, 0.0)
"""Where the wind comes from, arena frame: the source is the origin, the moth starts at +x."""

FALLBACK = (1.0, 0.0)
"""Focus direction at zero distance, and of an animal that has not moved yet."""

COURSE = 1.0
"""Time over which a course is averaged, exponentially [s]. With that of the last step alone, speeds
would lie on a lattice: all thrusts would be along or across the velocity."""


def is_free(roles: Sequence[str]) -> bool:
    """Return whether there is neither a target nor a source: one animal, or a group."""
    return "target" not in roles and "searcher" not in roles


def share_of(seconds: float, dt: float) -> float:
    """Return the share of a step of ``dt`` [s] in an exponential mean over so many seconds."""
    return min(1.0, dt / seconds)


@inline_kernel
def averaged(mean, value, share, steps):  # type: ignore[no-untyped-def]
    """Return an exponential mean, ``steps`` after its first value, with one more value.

    The first few count alike, until one of them is a ``share`` of all.
    """
    return mean + max(share, 1.0 / (1.0 + steps)) * (value - mean)


@inline_kernel
def direction_of(x, y):  # type: ignore[no-untyped-def]
    """Return the unit vector along ``(x, y)``; ``FALLBACK`` at zero length."""
    length = math.sqrt(x * x + y * y)
    if length > 0.0:
        return x / length, y / length
    return FALLBACK[0], FALLBACK[1]


class FocusTable(NamedTuple):
    """What each individual's focus is, as kernels read it: see :func:`focus_table`."""

    others: Bools  # (K, K), whose nearest it is
    otherwise: Floats  # (K, 2), the direction without any, or at distance zero
    free: bool  # then the focus of each is its course
    share: float  # of a step in a course


def focus_table(roles: Sequence[str], dt: float = 1.0, course_time: float = COURSE) -> FocusTable:
    """Return the focus table of individuals with ``roles``."""
    others, free = np.zeros((len(roles), len(roles)), dtype=bool), is_free(roles)
    if "target" in roles:
        others[:-1, -1] = others[-1, :-1] = True
    otherwise = np.tile(UPWIND if "searcher" in roles else FALLBACK, (len(roles), 1))
    return FocusTable(others, otherwise, free, share_of(course_time, dt))


@inline_kernel
def focus_direction(i, b, own, position, course_x, course_y):  # type: ignore[no-untyped-def]
    """Return the unit vector towards the focus of individual ``i``, by the :class:`FocusTable`."""
    if own.free:
        return direction_of(course_x, course_y)
    nearest, x, y = np.inf, own.otherwise[i, 0], own.otherwise[i, 1]
    for j in range(position.shape[0]):
        dx, dy = position[j, 0, b] - position[i, 0, b], position[j, 1, b] - position[i, 1, b]
        apart = np.hypot(dx, dy)
        if own.others[i, j] and apart < nearest:  # the first of equals
            nearest = apart
            x = dx / apart if apart > 0.0 else own.otherwise[i, 0]
            y = dy / apart if apart > 0.0 else own.otherwise[i, 1]
    return x, y


@jit
def _focus_frames(own, position, course, steps, towards):  # type: ignore[no-untyped-def]
    """Write focus directions ``(K, 2, frames)``; ``course`` has velocities, and gets their mean."""
    for i in range(position.shape[0]):
        for t in range(position.shape[2]):
            for x in range(2):
                if steps[t] > 0:
                    before, now = course[i, x, t - 1], course[i, x, t]
                    course[i, x, t] = averaged(before, now, own.share, steps[t])
            towards[i, 0, t], towards[i, 1, t] = focus_direction(
                i, t, own, position, course[i, 0, t], course[i, 1, t]
            )


def focus_directions(
    positions: NDArray[np.floating],
    roles: Sequence[str],
    velocities: NDArray[np.floating] | None = None,
    steps: NDArray[np.integer] | None = None,
    dt: float = 1.0,
    course_time: float = COURSE,
) -> Floats:
    """Return unit vectors to each individual's focus, ``(..., individuals, 2)``, arena frame.

    ``positions`` are ``(..., individuals, 2)`` [arena unit]; of ``roles`` the target comes last, or
    a pursuer of several targets (:func:`lone_pursuer`). The course of a free animal follows
    from its ``velocities``, the ``steps`` since the start and their duration ``dt`` [s], averaged
    over ``course_time`` [s]; without them it has not moved yet. Where the distance is zero the
    direction is ``FALLBACK``.
    """
    points: Floats = np.asarray(positions, dtype=np.float64)
    frames = points.reshape(-1, *points.shape[-2:])
    if velocities is None or steps is None:
        velocities, steps = np.zeros_like(frames), np.zeros(len(frames), dtype=np.int64)
    place, course = (
        np.array(one.transpose(1, 2, 0), dtype=np.float64, order="C")
        for one in (frames, velocities)
    )
    towards = np.empty_like(place)
    own, since = focus_table(roles, dt, course_time), np.asarray(steps, dtype=np.int64)
    _focus_frames(own, place, course, since, towards)
    return np.ascontiguousarray(towards.transpose(2, 0, 1)).reshape(points.shape)


def first_pursuer(roles: Sequence[str]) -> int:
    """Return the first individual that is no target."""
    return next(i for i, role in enumerate(roles) if role != "target")


def lone_pursuer(roles: Sequence[str]) -> bool:
    """Return whether the last individual pursues all others."""
    *many, last = roles
    return last == "pursuer" and set(many) == {"target"}


def distances_to_target(positions: Floats, roles: Sequence[str]) -> Floats:
    """Return distances to the target ``(frames, pursuers)``; of a searcher to the source.

    Of a lone pursuer they are those to each target, ``(frames, targets)``.
    """
    if "target" in roles:
        return np.asarray(np.linalg.norm(positions[:, :-1] - positions[:, -1:], axis=2))
    if "searcher" in roles:
        return np.asarray(np.linalg.norm(positions, axis=2))
    return np.full((len(positions), 1), np.inf)


def nearest_other(position: Floats) -> Floats:
    """Return the vector from each individual to its nearest other, as ``(..., individuals, 2)``.

    Takes memory in proportion to the number of individuals. NaN where a position is.
    """
    nearest = np.empty_like(position)
    for i in range(position.shape[-2]):
        apart = position - position[..., i : i + 1, :]
        distance = np.nan_to_num(np.linalg.norm(apart, axis=-1), nan=np.inf)
        distance[..., i] = np.inf
        place = distance.argmin(axis=-1)[..., None, None]
        nearest[..., i, :] = np.take_along_axis(apart, place, axis=-2)[..., 0, :]
    return nearest
