"""What each recorded individual is heading for: the x axis of its egocentric frame.

The focus of a pursuer is the target; the focus of the target is its nearest pursuer, chosen anew at
each frame (ties: the lower index). Where one pursues several, the focus of each target is the
pursuer, that of the pursuer its nearest target. A searcher must not be told where the source is:
its focus is the fixed upwind direction. Where nobody is pursued each animal has its own course:
where it has been going over the last second (:data:`COURSE`), or another rule that is named
(:func:`animarl_envs.checks.focus_rule`).
"""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from animarl_envs.checks import ALONG, TO_NEAREST, TO_POINT, focus_rule
from animarl_envs.compiling import jit, part

UPWIND = (-1.0, 0.0)
"""Where the wind comes from, arena frame: the source is the origin, the moth starts at +x."""

FALLBACK = (1.0, 0.0)
"""Focus direction at zero distance, and of an animal that has not moved yet."""

COURSE = 1.0
"""Time over which a course is averaged, exponentially [s]. With that of the last step alone, speeds
would lie on a lattice: all thrusts would be along or across the velocity."""


def is_free(roles: Sequence[str]) -> bool:
    """Whether nobody pursues and nobody searches: one animal, or a group without a target."""
    return "target" not in roles and "searcher" not in roles


def share_of(seconds: float, dt: float) -> float:
    """The share of a step of ``dt`` [s] in an exponential mean over so many seconds."""
    return min(1.0, dt / seconds)


@part
def averaged(mean, value, share, steps):  # type: ignore[no-untyped-def]
    """An exponential mean, ``steps`` after its first value, with one more: the first few count
    alike, until one of them is a ``share`` of all."""
    return mean + max(share, 1.0 / (1.0 + steps)) * (value - mean)


@part
def aim(i, b, rule, position, course_x, course_y):  # type: ignore[no-untyped-def]
    """The unit vector towards the focus of free animal ``i``; ``position`` is ``(K, 2, B)``."""
    x, y, own_x, own_y = course_x, course_y, position[i, 0, b], position[i, 1, b]
    if rule.kind == ALONG:
        x, y = rule.x, rule.y
    elif rule.kind == TO_POINT:
        x, y = rule.x - own_x, rule.y - own_y
    elif rule.kind == TO_NEAREST:
        x, y, last, who = 0.0, 0.0, -1.0, -1
        for _ in range(min(rule.nearest, position.shape[0] - 1)):
            best, found = np.inf, -1
            for j in range(position.shape[0]):
                dx, dy = position[j, 0, b] - own_x, position[j, 1, b] - own_y
                apart = dx * dx + dy * dy
                farther = apart > last or (apart == last and j > who)
                if j != i and farther and apart < best:
                    best, found = apart, j
            last, who = best, found
            x += position[found, 0, b] - own_x
            y += position[found, 1, b] - own_y
    length = math.sqrt(x * x + y * y)
    if length > 0.0:
        return x / length, y / length
    return FALLBACK[0], FALLBACK[1]


@jit
def _aim_frames(rule, position, course, steps, share, towards):  # type: ignore[no-untyped-def]
    """Focus of free animals in frames ``(K, 2, frames)``; ``course`` has their velocities."""
    for i in range(position.shape[0]):
        for t in range(position.shape[2]):
            for x in range(2):
                if steps[t] > 0:
                    before, now = course[i, x, t - 1], course[i, x, t]
                    course[i, x, t] = averaged(before, now, share, steps[t])
            towards[i, 0, t], towards[i, 1, t] = aim(
                i, t, rule, position, course[i, 0, t], course[i, 1, t]
            )


def focus_directions(
    positions: NDArray[np.floating],
    roles: Sequence[str],
    velocities: NDArray[np.floating] | None = None,
    steps: NDArray[np.integer] | None = None,
    dt: float = 1.0,
    rule: str = "course",
) -> NDArray[np.float64]:
    """Unit vectors towards the focus of each individual, ``(..., individuals, 2)``, arena frame.

    ``positions`` are ``(..., individuals, 2)`` [arena unit]; of ``roles`` the target comes last, or
    a pursuer of several targets (:func:`lone_pursuer`). The focus of a free animal follows a
    ``rule`` (:func:`animarl_envs.checks.focus_rule`). Its course is told from its ``velocities``,
    the ``steps`` since the start and their duration ``dt`` [s]; without them it has not moved yet.
    Where the distance is zero the direction is ``FALLBACK``.
    """
    points: NDArray[np.float64] = np.asarray(positions, dtype=np.float64)
    out = np.empty_like(points)
    if is_free(roles):
        frames, since = points.reshape(-1, *points.shape[-2:]), steps
        if velocities is None or since is None:
            velocities, since = np.zeros_like(frames), np.zeros(len(frames), dtype=np.int64)
        place, course = (
            np.array(one.transpose(1, 2, 0), dtype=np.float64, order="C")
            for one in (frames, velocities)
        )
        towards, since = np.empty_like(place), np.asarray(since, dtype=np.int64)
        _aim_frames(focus_rule(rule), place, course, since, share_of(COURSE, dt), towards)
        return np.ascontiguousarray(towards.transpose(2, 0, 1)).reshape(points.shape)
    for i, candidates in enumerate(foci(roles)):
        if not candidates:
            out[..., i, :] = UPWIND if candidates is None else FALLBACK
            continue
        offset = points[..., candidates, :] - points[..., i, None, :]
        distance = np.hypot(offset[..., 0], offset[..., 1])
        nearest = np.argmin(distance, axis=-1)[..., None]  # the first of equals
        apart = np.take_along_axis(distance, nearest, axis=-1)
        towards = np.take_along_axis(offset, nearest[..., None], axis=-2)[..., 0, :]
        out[..., i, :] = np.where(
            apart > 0, towards / np.where(apart > 0, apart, 1.0), np.array(FALLBACK)
        )
    return out


def foci(roles: Sequence[str]) -> list[list[int] | None]:
    """Return, for each individual, those whose nearest is its focus; ``None`` for a searcher.

    There are none for a free animal.
    """
    last = len(roles) - 1
    one, many = [last], list(range(last))
    if "target" in roles:
        return [many if i == last else one for i in range(len(roles))]
    return [None if "searcher" in roles else [] for _ in roles]


def first_pursuer(roles: Sequence[str]) -> int:
    """The first individual that is no target."""
    return next(i for i, role in enumerate(roles) if role != "target")


def lone_pursuer(roles: Sequence[str]) -> bool:
    """Whether the last individual pursues all others."""
    *many, last = roles
    return last == "pursuer" and set(many) == {"target"}


def distances_to_target(
    positions: NDArray[np.float64], roles: Sequence[str]
) -> NDArray[np.float64]:
    """``(frames, pursuers)`` to the target, or of a searcher to the source at the origin.

    Of a lone pursuer to each target: ``(frames, targets)``.
    """
    if "target" in roles:
        return np.asarray(np.linalg.norm(positions[:, :-1] - positions[:, -1:], axis=2))
    if "searcher" in roles:
        return np.asarray(np.linalg.norm(positions, axis=2))
    return np.full((len(positions), 1), np.inf)
