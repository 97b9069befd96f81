"""Measures of how an episode unfolds: order in time, reactions to others, and place.

One number per episode and individual, so that it can be averaged, resampled and exchanged as any
other. Positions are in the arena frame [arena unit], lags in steps, turning in rad, positive to the
left. A measure that an episode is too short for is NaN.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from animarl_algos.evaluation.rollouts import Rollouts
from animarl_algos.evaluation.statistics import Floats, Ints
from animarl_envs.arena import Arena
from animarl_envs.focus import focus_directions

LAGS = (0.5, 2.0, 5.0, 20.0)  # [s] at which order in time is looked at
LONGEST_LAG = 0.5  # of the median episode: beyond it too few pairs of steps are left
CHUNK = 4_000_000  # frames x individuals that are padded at once
NEAR_WALL = 0.1  # of the arena's size: so near a wall counts as being at it
KINEMATIC, ORDER, INTERACTIVE, PLACE = "kinematic", "order in time", "interactive", "place"


@dataclass(frozen=True)
class Series:
    """Padded series of several episodes, NaN where an episode has ended or nothing is defined.

    ``chosen`` ``(episodes,)`` says which of all. ``position`` is ``(episodes, frames, individuals,
    2)`` [arena unit], ``focus`` unit vectors of that shape towards the focus, ``step`` one frame
    shorter; ``speed`` [arena unit / s] and ``moving`` are ``(episodes, steps, individuals)``,
    ``turn`` is one step shorter, the signed angle between successive steps [rad], NaN where either
    is at rest.
    """

    chosen: Ints
    speed: Floats
    turn: Floats
    moving: NDArray[np.bool_]
    step: Floats
    position: Floats
    focus: Floats

    @classmethod
    def of(cls, rollouts: Rollouts, rest: Floats) -> Iterator[Series]:
        """Some episodes after the others; steps up to ``rest`` [arena unit] are at rest."""
        size = max(1, CHUNK // max(1, int(rollouts.lengths.max()) * len(rollouts.individuals)))
        for first in range(0, len(rollouts), size):
            chosen = np.arange(first, min(first + size, len(rollouts)))
            lengths = rollouts.lengths[chosen]
            frames = np.arange(lengths.max())
            last = np.minimum(frames, lengths[:, None] - 1)
            position = rollouts.positions[rollouts.offsets[:-1][chosen][:, None] + last]
            focus = focus_directions(position, rollouts.roles)
            inside = frames < lengths[:, None]
            position = np.where(inside[..., None, None], position, np.nan)
            step = np.diff(position, axis=1)
            length = np.linalg.norm(step, axis=-1)
            moving = length > rest
            turn = angle(step[:, :-1], step[:, 1:])
            turn[~(moving[:, :-1] & moving[:, 1:])] = np.nan
            yield cls(chosen, length / rollouts.dt, turn, moving, step, position, focus)

    @cached_property
    def nearest(self) -> Floats:
        """``(episodes, steps + 1, individuals)``, distance to the nearest other [arena unit]."""
        num = self.position.shape[2]
        apart = self.position[:, :, :, None] - self.position[:, :, None]
        between = np.linalg.norm(apart, axis=-1)
        between[:, :, np.arange(num), np.arange(num)] = np.inf
        return np.where(np.isfinite(self.position[..., 0]), between.min(axis=-1), np.nan)


def cross(first: Floats, second: Floats) -> Floats:
    """Of vectors in the plane."""
    return np.asarray(first[..., 0] * second[..., 1] - first[..., 1] * second[..., 0])


def angle(first: Floats, second: Floats) -> Floats:
    """Signed angle between vectors [rad], positive to the left."""
    return np.asarray(np.arctan2(cross(first, second), (first * second).sum(axis=-1)))


@dataclass(frozen=True)
class EpisodeMeasures:
    """Measures of episodes, ``values`` ``(episodes, measures)``.

    ``names`` hold the individual where there are several; ``kinds`` are constants of this module.
    """

    names: tuple[str, ...]
    kinds: tuple[str, ...]
    values: Floats

    def mean(self, name: str) -> Floats:
        """Means over episodes of those measures whose name begins so."""
        chosen = [one.startswith(name) for one in self.names]
        return _mean(self.values[:, chosen], axis=0)


def lags_for(steps: float, dt: float) -> tuple[int, ...]:
    """Return the lags [steps] at which episodes of so many steps can be looked at."""
    longest = LONGEST_LAG * steps
    fitting = sorted({max(1, round(lag / dt)) for lag in LAGS if lag / dt <= longest})
    if len(fitting) >= 2:
        return tuple(fitting)
    return tuple(sorted({max(1, round(longest / part)) for part in (8, 2)}))


def median_steps(rollouts: Rollouts) -> float:
    """Return the median number of steps of an episode."""
    return float(np.median(rollouts.lengths - 1))


def order_measures(
    rollouts: Rollouts, lags: tuple[int, ...], rest: Floats, arena: Arena | None = None
) -> EpisodeMeasures:
    """Measure every episode of rollouts, or of recordings, both smoothed alike.

    Parameters
    ----------
    lags
        Of :func:`lags_for` of the recordings, so that both sides are measured alike [steps].
    rest
        ``(individuals,)`` steps up to this length are at rest [arena unit].
    arena
        The field, for distances to its wall; in an open field to the origin, the source. Without
        one, places are not measured.
    """
    parts = []
    found: list[tuple[str, str, Floats]] = []
    with np.errstate(invalid="ignore", divide="ignore"):
        for series in Series.of(rollouts, rest):
            found = [*_motion(series, rollouts.dt, lags), *_interactions(series, lags[0])]
            found += _places(series, arena) if arena is not None else ()
            parts.append(np.concatenate([values for _, _, values in found], axis=1))
    names, kinds = [], []
    for name, kind, values in found:
        who = rollouts.individuals if values.shape[1] > 1 else ("",)
        names += [f"{name}, {individual}" if individual else name for individual in who]
        kinds += [kind] * values.shape[1]
    return EpisodeMeasures(tuple(names), tuple(kinds), np.concatenate(parts))


def _motion(series: Series, dt: float, lags: tuple[int, ...]) -> Iterator[tuple[str, str, Floats]]:
    """Name, kind and values ``(episodes, individuals)`` or ``(episodes, 1)`` of each measure."""
    speed, turn = series.speed, series.turn
    acceleration = np.diff(speed, axis=1) / dt
    yield "speed", KINEMATIC, _mean(speed)
    yield "spread of speed", KINEMATIC, _spread(speed)
    yield "share at rest", KINEMATIC, _share(~series.moving, np.isfinite(speed))
    yield "turning", KINEMATIC, _mean(np.abs(turn)) / dt
    yield "turning to the left", KINEMATIC, _mean(turn) / dt
    yield "skewness of acceleration", ORDER, _skewness(acceleration)
    yield "length of bouts of motion", ORDER, _bouts(series.moving, np.isfinite(speed)) * dt
    yield "longest rest", ORDER, _longest(~series.moving & np.isfinite(speed)) * dt
    wound = np.abs(np.nansum(turn, axis=1)) / np.isfinite(turn).sum(axis=1)
    yield "windings", ORDER, wound / (2 * np.pi * dt)
    for lag in lags:
        seconds = f"{lag * dt:.3g} s"
        gone = np.linalg.norm(series.position[:, lag:] - series.position[:, :-lag], axis=-1)
        yield f"displacement in {seconds}", ORDER, _mean(gone)
        yield f"speed autocorrelation at {seconds}", ORDER, _correlation(speed, speed, lag)
        yield f"turn autocorrelation at {seconds}", ORDER, _turn_autocorrelation(turn, lag)
    lag = lags[0]
    ahead = _correlation(speed[:, :-1], np.abs(turn), lag)
    yield "speed before turn", ORDER, ahead - _correlation(np.abs(turn), speed[:, :-1], lag)


def _interactions(series: Series, lag: int) -> Iterator[tuple[str, str, Floats]]:
    """Measures of how individuals react to their focus and to each other."""
    step, focus = series.step, series.focus[:, :-1]
    length = np.linalg.norm(step, axis=-1)
    length[~series.moving] = np.nan
    along = (step * focus).sum(axis=-1) / length
    left = cross(focus, step) / length
    yield "course towards the focus", INTERACTIVE, _mean(along)
    yield "course to the left of the focus", INTERACTIVE, _mean(left)
    num = series.speed.shape[2]
    if num == 1:
        return
    yield "nearest neighbour", INTERACTIVE, _mean(series.nearest)
    yield "spread of the nearest neighbour", INTERACTIVE, _spread(series.nearest)
    unit = step / length[..., None]
    yield "polarisation", INTERACTIVE, _mean(np.linalg.norm(_mean(unit, axis=2), axis=-1))[:, None]
    others = (np.nansum(series.speed, axis=2, keepdims=True) - series.speed) / (num - 1)
    yield "speed with the others", INTERACTIVE, _correlation(series.speed, others, 0)
    leading = _correlation(series.speed, others, lag) - _correlation(others, series.speed, lag)
    yield "speed ahead of the others", INTERACTIVE, leading


def _places(series: Series, arena: Arena) -> Iterator[tuple[str, str, Floats]]:
    """Measures of where individuals are."""
    wall = distance_to_edge(series.position, arena)
    name = "distance from the source" if arena.shape == "open" else "distance from the wall"
    yield name, PLACE, _mean(wall)
    if arena.shape != "open":
        at_wall = wall < NEAR_WALL * arena.size
        yield "share at the wall", PLACE, _share(at_wall, np.isfinite(wall))


def distance_to_edge(points: Floats, arena: Arena) -> Floats:
    """Distance to the edge of the field, or to the origin of an open one."""
    if arena.shape == "square":
        return np.asarray(arena.size - np.abs(points).max(axis=-1))
    radius = np.linalg.norm(points, axis=-1)
    return np.asarray(radius if arena.shape == "open" else arena.size - radius)


def _mean(series: Floats, axis: int = 1) -> Floats:
    """Mean of what is defined; NaN where nothing is."""
    count = np.isfinite(series).sum(axis=axis)
    return np.asarray(np.nansum(series, axis=axis) / np.where(count, count, np.nan))


def _spread(series: Floats) -> Floats:
    return np.sqrt(_mean((series - _mean(series)[:, None]) ** 2))


def _share(true: NDArray[np.bool_], defined: NDArray[np.bool_]) -> Floats:
    count = defined.sum(axis=1)
    return np.asarray((true & defined).sum(axis=1) / np.where(count, count, np.nan))


def _skewness(series: Floats) -> Floats:
    """Third standardised moment; negative where stops are harder than starts."""
    centred = series - _mean(series)[:, None]
    return np.asarray(_mean(centred**3) / _mean(centred**2) ** 1.5)


def _correlation(first: Floats, second: Floats, lag: int) -> Floats:
    """Correlation within an episode of ``first`` with ``second`` so many steps later."""
    frames = min(first.shape[1], second.shape[1])
    if frames <= lag + 2:
        return np.full((first.shape[0], first.shape[2]), np.nan)
    a, b = first[:, : frames - lag], second[:, lag:frames]
    a = np.where(np.isfinite(b), a, np.nan)
    b = np.where(np.isfinite(a), b, np.nan)
    a, b = (side - _mean(side)[:, None] for side in (a, b))
    spread = np.sqrt(_mean(a**2) * _mean(b**2))
    return np.asarray(_mean(a * b) / np.where(spread > 0, spread, np.nan))


def _turn_autocorrelation(turn: Floats, lag: int) -> Floats:
    """Mean of sin(turn) sin(turn later), per mean square: 1 for circles, 0 without memory."""
    if turn.shape[1] <= lag:
        return np.full((turn.shape[0], turn.shape[2]), np.nan)
    sine = np.sin(turn)
    square = _mean(sine**2)
    return np.asarray(_mean(sine[:, lag:] * sine[:, :-lag]) / np.where(square > 0, square, np.nan))


def _bouts(moving: NDArray[np.bool_], defined: NDArray[np.bool_]) -> Floats:
    """Mean length of uninterrupted motion [steps]; 0 where there is none."""
    moving = moving & defined
    begins = moving & ~np.concatenate([np.zeros_like(moving[:, :1]), moving[:, :-1]], axis=1)
    count = begins.sum(axis=1)
    return np.asarray(moving.sum(axis=1) / np.maximum(count, 1))


def _longest(true: NDArray[np.bool_]) -> Floats:
    """Length of the longest uninterrupted stretch of each column [steps]."""
    current = np.zeros(true.shape[::2])
    longest = np.zeros_like(current)
    for step in range(true.shape[1]):
        current = np.where(true[:, step], current + 1, 0.0)
        np.maximum(longest, current, out=longest)
    return longest
