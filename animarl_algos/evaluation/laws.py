"""A simple law of motion, fitted to recordings: what a simulator should beat.

Each animal is a persistent random walker (Codling, Plank and Benhamou 2008, J. R. Soc. Interface 5,
813): its speed and the noise of its turns forget themselves at the recorded rate. It also turns
towards its focus, or away from it, in proportion to the sine of the angle, with a gain for each of
``ZONES`` distances (pursuit of a target; repulsion, alignment of courses left out, and attraction
in a group, after Couzin et al. 2002). In a chase it also turns in proportion to the turn of the
line of sight (proportional navigation; Brighton, Thomas and Taylor 2017, PNAS 114, 13495). Rollouts
last as long as their recordings and end as they do, so a law says nothing of endings.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from animarl_algos.evaluation.order_in_time import Series, cross
from animarl_algos.evaluation.prepared import Prepared, resting_step
from animarl_algos.evaluation.rollouts import Rollouts
from animarl_envs.arena import Arena
from animarl_envs.array_types import Floats
from animarl_envs.focus import focus_directions, nearest_other

ZONES = 3  # distances to the focus with a gain each
EACH = 2  # rollouts from every start
LAW = "law"


@dataclass(frozen=True)
class Law:
    """The law of each individual, or of each animal of a group, ``(individuals, ...)``.

    ``speed`` and ``turn`` hold mean, standard deviation and autocorrelation of one step, ``edges``
    the distances between zones [arena unit], ``gains`` the turn per step towards the focus, and
    ``navigation`` the turn for each radian by which the line of sight turns.
    """

    speed: Floats
    turn: Floats
    edges: Floats
    gains: Floats
    navigation: Floats

    @classmethod
    def fit(cls, recorded: Rollouts) -> Law:
        """Fit speeds, turns and reactions to recordings."""
        rest = resting_step(recorded)
        parts = [_samples(series, recorded.has_goal) for series in Series.of(recorded, rest)]
        number = recorded.num_individuals
        if recorded.is_group:  # animals of a group are alike
            fitted = [_fit(parts)] * number
        else:
            each = [slice(k, k + 1) for k in range(number)]
            fitted = [_fit([tuple(v[..., one] for v in part) for part in parts]) for one in each]
        return cls(*(np.array(each) for each in zip(*fitted)))

    def rollouts(self, prepared: Prepared, rng: np.random.Generator) -> Rollouts:
        """Simulate ``EACH`` episodes from every recorded start, as long as the recorded ones."""
        recorded, demos = prepared.recorded, prepared.demos
        demo = np.repeat(np.arange(len(recorded)), EACH)
        lengths, dt = recorded.lengths[demo], recorded.dt
        position = recorded.positions[recorded.offsets[:-1]][demo]
        velocity = demos.initial_velocity[demo]
        heading = np.arctan2(velocity[..., 1], velocity[..., 0])
        still = np.linalg.norm(velocity, axis=-1) == 0
        heading = np.where(still, rng.uniform(-np.pi, np.pi, heading.shape), heading)
        speed, noise = np.linalg.norm(velocity, axis=-1), np.zeros(heading.shape)
        path, seen = [position], _focus(position, recorded)
        for _ in range(int(lengths.max()) - 1):
            mean, spread, memory = self.speed.T
            fresh = np.sqrt(1 - memory**2) * spread * rng.normal(size=heading.shape)
            speed = np.maximum(mean + memory * (speed - mean) + fresh, 0.0)
            mean, spread, memory = self.turn.T
            fresh = np.sqrt(1 - memory**2) * spread * rng.normal(size=heading.shape)
            noise = memory * noise + fresh
            before, seen = seen, _focus(position, recorded)
            heading = heading + mean + noise + self._reaction(position, heading, before, seen)
            course = np.stack([np.cos(heading), np.sin(heading)], axis=-1)
            position, heading = _held(
                position + dt * speed[..., None] * course, heading, demos.arena
            )
            path.append(position)
        whole = np.stack(path, axis=1)
        kept = np.arange(whole.shape[1]) < lengths[:, None]
        return replace(
            recorded.select(demo),
            positions=whole[kept],
            method=LAW,
            repetition=np.tile(np.arange(EACH), len(recorded)),
        )

    def _reaction(
        self, position: Floats, heading: Floats, before: Floats, towards: Floats
    ) -> Floats:
        """Return the turn of every individual by where its focus is, and was a step before."""
        if position.shape[1] == 1:
            return np.zeros(heading.shape)
        distance = np.linalg.norm(nearest_other(position), axis=-1)
        course = np.stack([np.cos(heading), np.sin(heading)], axis=-1)
        zone = (distance[..., None] > self.edges).sum(axis=-1)
        gain = np.take_along_axis(self.gains[None], zone[..., None], axis=-1)[..., 0]
        return np.asarray(gain * cross(course, towards) + self.navigation * cross(before, towards))


def _focus(position: Floats, like: Rollouts) -> Floats:
    """Return unit vectors from each individual to its focus: in a group to the nearest other."""
    if like.num_individuals == 1:
        return np.zeros_like(position)
    if like.has_goal:
        return focus_directions(position, like.roles)
    apart = nearest_other(position)
    distance = np.linalg.norm(apart, axis=-1, keepdims=True)
    return np.asarray(apart / np.where(distance > 0, distance, 1.0))


def _samples(series: Series, chase: bool) -> tuple[Floats, ...]:
    """Return by step speeds, turns, sines of the angle to the focus, turns of sight, distances.

    The line of sight turns in a ``chase`` alone: in a group another animal may become the nearest.
    """
    sine = cross(series.course[:, :-1], series.focus[:, 1:-1])
    near = sight = series.position[:, 1:-1, :, 0] * 0.0
    if series.position.shape[2] > 1:
        near = series.nearest[:, 1:-1]
    if chase:
        sight = cross(series.focus[:, :-2], series.focus[:, 1:-1])
    return series.speed, series.turn, sine, sight, near


def _fit(parts: Sequence[tuple[Floats, ...]]) -> tuple[Floats, Floats, Floats, Floats, Floats]:
    """Return moments of speed and turn, edges of zones, gains, and the gain of navigation."""
    near = np.concatenate([part[4].ravel() for part in parts])
    edges = np.full(ZONES - 1, np.inf)
    if np.isfinite(near).any():
        edges = np.nanquantile(near, np.arange(1, ZONES) / ZONES)

    def inputs(part: tuple[Floats, ...]) -> Floats:
        zone = (part[4][..., None] > edges).sum(axis=-1)
        return np.concatenate([np.eye(ZONES)[zone] * part[2][..., None], part[3][..., None]], -1)

    every = np.concatenate([inputs(part).reshape(-1, ZONES + 1) for part in parts])
    turn = np.concatenate([part[1].ravel() for part in parts])
    known = np.isfinite(turn) & np.isfinite(every).all(axis=1)
    gains = np.linalg.lstsq(every[known], turn[known])[0]
    left = [part[1] - np.nan_to_num(inputs(part) @ gains) for part in parts]
    speeds = [part[0] for part in parts]
    return _moments(speeds), _moments(left), edges, gains[:ZONES], gains[ZONES]


def _moments(parts: list[Floats]) -> Floats:
    """Return mean, standard deviation and autocorrelation at one step."""
    every = np.concatenate([part.ravel() for part in parts])
    if not np.isfinite(every).any():
        return np.zeros(3)
    mean, spread = float(np.nanmean(every)), float(np.nanstd(every))
    products = np.concatenate(
        [((part[:, 1:] - mean) * (part[:, :-1] - mean)).ravel() for part in parts]
    )
    known = products[np.isfinite(products)]
    memory = known.mean() / spread**2 if spread > 0 and known.size else 0.0
    return np.array([mean, spread, float(np.clip(memory, 0.0, 0.999))])


def _held(position: Floats, heading: Floats, arena: Arena) -> tuple[Floats, Floats]:
    """Hold individuals within the field; those that meet its edge turn round."""
    inside = arena.hold(position)
    met = (inside != position).any(axis=-1)
    return inside, np.where(met, heading + np.pi, heading)
