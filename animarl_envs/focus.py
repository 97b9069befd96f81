"""What each recorded individual is heading for: the x axis of its egocentric frame.

The focus of a pursuer is the target; the focus of the target is its nearest pursuer, chosen anew at
each frame (ties: the lower index). Where one pursues several, the focus of each target is the
pursuer, that of the pursuer its nearest target. A searcher must not be told where the source is:
its focus is the fixed upwind direction. Where nobody is pursued each animal has its own course:
where it has been going over the last second (:data:`COURSE`).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

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


def courses(
    velocities: NDArray[np.floating], steps: NDArray[np.integer], dt: float
) -> NDArray[np.float64]:
    """Unit vectors ``(frames, individuals, 2)`` along the course of each free animal.

    Parameters
    ----------
    velocities
        ``(frames, individuals, 2)``, episodes end to end [arena unit / s].
    steps
        ``(frames,)`` since the start of each episode.
    dt
        Duration of a step [s].
    """
    mean: NDArray[np.float64] = np.array(velocities, dtype=np.float64)
    _average(mean, np.asarray(steps, dtype=np.int64), share_of(COURSE, dt))
    length = np.hypot(mean[..., 0], mean[..., 1])[..., None]
    return np.where(length > 0, mean / np.where(length > 0, length, 1.0), np.array(FALLBACK))


@jit
def _average(mean, steps, share):  # type: ignore[no-untyped-def]
    """Average velocities with those before, in place."""
    for t in range(1, len(mean)):
        if steps[t] > 0:
            for i in range(mean.shape[1]):
                for x in range(2):
                    mean[t, i, x] = averaged(mean[t - 1, i, x], mean[t, i, x], share, steps[t])


def focus_directions(
    positions: NDArray[np.floating],
    roles: Sequence[str],
    velocities: NDArray[np.floating] | None = None,
    steps: NDArray[np.integer] | None = None,
    dt: float = 0.0,
) -> NDArray[np.float64]:
    """Unit vectors towards the focus of each individual.

    That of a free animal is its course, by its ``velocities``, the ``steps`` since the start and
    their duration (:func:`courses`); without them it has not moved yet.

    Parameters
    ----------
    positions
        ``(..., individuals, 2)``, arena frame [arena unit].
    roles
        ``"pursuer"``, ``"target"`` or ``"searcher"`` for each individual; the target comes last,
        or a pursuer of several targets (:func:`lone_pursuer`).

    Returns
    -------
    ``(..., individuals, 2)``, arena frame; ``FALLBACK`` where the distance is zero.
    """
    if is_free(roles) and velocities is not None and steps is not None:
        return courses(velocities, steps, dt)
    points: NDArray[np.float64] = np.asarray(positions, dtype=np.float64)
    out = np.empty_like(points)
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
