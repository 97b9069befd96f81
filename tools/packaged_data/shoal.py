"""A shoal that follows the zonal model of Couzin et al. (2002), and its radii found again.

Couzin, Krause, James, Ruxton and Franks (2002), Collective memory and spatial sorting in animal
groups, Journal of Theoretical Biology 218, 1-11: animals of constant speed turn away from all that
are nearer than the zone of repulsion; where nobody is, they align with those in the zone of
orientation and turn to those in the zone of attraction, of which neither reaches behind them. The
paper swims in free space of three dimensions, this shoal in the plane, in a round tank: the nearest
point of the wall repels from its own distance as a neighbour does, and speeds vary a little (both
ours).
"""

from __future__ import annotations

from dataclasses import astuple, dataclass, replace

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

RADII = ("repulsion", "orientation", "attraction")
FRAMES = 600  # of all animals, that radii are found by
SWEEPS = 3  # over the radii, each with a finer grid


@dataclass(frozen=True, kw_only=True)
class ZonalLaw:
    """The numbers of the model, in the ranges of its Table 1; lengths in body lengths."""

    repulsion: float = 1.0  # r_r, the unit of the paper
    orientation: float = 2.5  # r_o, outer radius
    attraction: float = 6.0  # r_a, outer radius
    perception: float = 270.0  # alpha, the field of view [deg]
    turning: float = 100.0  # theta, the highest turning rate [deg/s]
    speed: float = 2.0  # s [body lengths / s]
    speed_varies: float = 0.15  # standard deviation, of the speed
    speed_lasts: float = 1.0  # correlation time of these variations [s]
    noise: float = 0.1  # sigma of the direction of each step [rad]
    dt: float = 0.1  # tau [s]
    tank: float = 10.0  # radius
    wall: float = 1.5  # from which the wall repels


def simulate(
    law: ZonalLaw, groups: int, animals: int, steps: int, rng: np.random.Generator
) -> Floats:
    """Return paths ``(groups, steps + 1, animals, 2)`` [body length] from random starts."""
    radius = 0.5 * law.tank * np.sqrt(rng.random((groups, animals)))
    place, heading = rng.uniform(-np.pi, np.pi, (2, *radius.shape))
    return continued(law, radius[..., None] * _unit(place), heading, steps, rng)


def continued(
    law: ZonalLaw, position: Floats, heading: Floats, steps: int, rng: np.random.Generator
) -> Floats:
    """Return the same from given positions ``(groups, animals, 2)`` and headings."""
    groups, animals = heading.shape
    path = np.empty((groups, steps + 1, animals, 2))
    path[:, 0] = position
    most, keeps = np.deg2rad(law.turning) * law.dt, np.exp(-law.dt / law.speed_lasts)
    pace = rng.normal(size=heading.shape)
    for step in range(1, steps + 1):
        pace = keeps * pace + np.sqrt(1 - keeps**2) * rng.normal(size=heading.shape)
        moved = law.speed * law.dt * np.exp(law.speed_varies * pace)
        wanted = wanted_turn(law, position, heading) + law.noise * rng.normal(size=heading.shape)
        heading = heading + np.clip(_wrapped(wanted), -most, most)
        position = position + moved[..., None] * _unit(heading)
        out = np.maximum(1.0, np.linalg.norm(position, axis=-1, keepdims=True) / law.tank)
        position = position / out
        path[:, step] = position
    return path


def wanted_turn(law: ZonalLaw, position: Floats, heading: Floats) -> Floats:
    """Return the angle from each heading to the direction that the law asks for [rad].

    ``position`` is ``(..., animals, 2)``, ``heading`` ``(..., animals)``.
    """
    apart = position[..., None, :, :] - position[..., :, None, :]
    distance = np.linalg.norm(apart, axis=-1)
    own = np.arange(position.shape[-2])
    distance[..., own, own] = np.inf
    towards = apart / distance[..., None]
    bearing = np.arctan2(apart[..., 1], apart[..., 0]) - heading[..., None]
    seen = np.abs(_wrapped(bearing)) <= np.deg2rad(law.perception) / 2
    near = distance < law.repulsion
    away = -(near[..., None] * towards).sum(axis=-2)
    radius = np.linalg.norm(position, axis=-1)
    at_wall = law.tank - radius < law.wall
    away -= at_wall[..., None] * position / np.maximum(radius, 1e-9)[..., None]
    aligning = seen & ~near & (distance < law.orientation)
    attracting = seen & (distance >= max(law.orientation, law.repulsion))
    attracting &= distance < law.attraction
    courses = _unit(heading)[..., None, :, :]
    along = (aligning[..., None] * courses).sum(-2) + (attracting[..., None] * towards).sum(-2)
    repelled = near.any(axis=-1) | at_wall
    wanted = np.where(repelled[..., None], away, along)
    nothing = np.linalg.norm(wanted, axis=-1) < 1e-9
    direction = np.where(nothing, heading, np.arctan2(wanted[..., 1], wanted[..., 0]))
    return _wrapped(direction - heading)


def recovered_radii(law: ZonalLaw, paths: Floats, rng: np.random.Generator) -> dict[str, float]:
    """Return the radii of :data:`RADII` by which the turns along paths are explained best.

    Those are sought that leave the least mean size of unexplained turning, one radius after the
    other; all else is as in ``law``, and animals near the wall do not count.

    Parameters
    ----------
    paths
        ``(groups, frames, animals, 2)`` [body length], one frame each ``law.dt``.
    """
    moved = np.diff(paths, axis=1)
    heading = np.arctan2(moved[..., 1], moved[..., 0])
    turned = _wrapped(np.diff(heading, axis=1)).reshape(-1, paths.shape[2])
    position, heading = paths[:, 1:-1].reshape(-1, *paths.shape[2:]), heading[:, :-1]
    heading = heading.reshape(-1, paths.shape[2])
    chosen = rng.permutation(len(turned))[:FRAMES]
    position, heading, turned = position[chosen], heading[chosen], turned[chosen]
    free = law.tank - np.linalg.norm(position, axis=-1) >= law.wall
    most = np.deg2rad(law.turning) * law.dt

    def unexplained(tried: ZonalLaw) -> float:
        expected = np.clip(wanted_turn(tried, position, heading), -most, most)
        return float(np.abs(_wrapped(turned - expected))[free].mean())

    found = replace(law, repulsion=0.5, orientation=2.0, attraction=6.0)
    for sweep in range(SWEEPS):
        for name in RADII if sweep else RADII[::-1]:
            here = getattr(found, name)
            factors = np.geomspace(0.4, 2.5, 19) if sweep < 2 else np.geomspace(0.85, 1.18, 19)
            tried = [replace(found, **{name: here * factor}) for factor in factors.tolist()]
            found = min(tried, key=unexplained)
    return dict(zip(RADII, astuple(found)))


def _unit(angle: Floats) -> Floats:
    return np.stack([np.cos(angle), np.sin(angle)], axis=-1)


def _wrapped(angle: Floats) -> Floats:
    return np.asarray((angle + np.pi) % (2 * np.pi) - np.pi)
