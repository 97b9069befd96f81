"""Measures of how an episode unfolds: order in time, reactions to others, and place.

Means, spreads and extremes of short windows cannot see whether motion is played backwards, whether
turns follow each other over ten seconds, or who follows whom. The measures here can. Every measure
is one number per episode and individual, so that it can be averaged, resampled and exchanged as any
other measure of an episode.

Frames and units: positions in the arena frame [arena unit], lags in steps, turning in rad, positive
to the left. A measure that an episode is too short for is NaN.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from animarl_algos.evaluation.rollouts import Rollouts
from animarl_envs.arena import Arena
from animarl_envs.focus import focus_directions

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

LAGS = (0.5, 2.0, 5.0, 20.0)  # [s] at which order in time is looked at
LONGEST_LAG = 0.5  # of the median episode: beyond it too few pairs of steps are left
CHUNK = 4_000_000  # frames x individuals that are padded at once
NEAR_WALL = 0.1  # of the arena's size: so near a wall counts as being at it
KINEMATIC, ORDER, INTERACTIVE, PLACE = "kinematic", "order in time", "interactive", "place"


@dataclass(frozen=True)
class Series:
    """Padded series of several episodes, NaN where an episode has ended or nothing is defined.

    Parameters
    ----------
    speed
        ``(episodes, steps, individuals)`` [arena unit / s].
    turn
        ``(episodes, steps - 1, individuals)``, signed angle between successive steps [rad]; NaN
        where either step is at rest.
    moving
        ``(episodes, steps, individuals)``, whether the individual moves; false after the end.
    step
        ``(episodes, steps, individuals, 2)`` [arena unit].
    position
        ``(episodes, steps + 1, individuals, 2)`` [arena unit].
    focus
        ``(episodes, steps + 1, individuals, 2)``, unit vectors towards the focus.
    """

    speed: Floats
    turn: Floats
    moving: NDArray[np.bool_]
    step: Floats
    position: Floats
    focus: Floats

    @classmethod
    def of(cls, rollouts: Rollouts, chosen: Ints, rest: Floats) -> Series:
        """Series of the ``chosen`` episodes; steps up to ``rest`` [arena unit] are at rest."""
        lengths = rollouts.lengths[chosen]
        frames = np.arange(lengths.max())
        inside = frames < lengths[:, None]
        index = rollouts.offsets[:-1][chosen][:, None] + np.minimum(frames, lengths[:, None] - 1)
        position = rollouts.positions[index]
        focus = focus_directions(position, rollouts.roles)
        position = np.where(inside[..., None, None], position, np.nan)
        step = np.diff(position, axis=1)
        length = np.linalg.norm(step, axis=-1)
        moving = length > rest
        cross = step[:, :-1, :, 0] * step[:, 1:, :, 1] - step[:, :-1, :, 1] * step[:, 1:, :, 0]
        turn = np.arctan2(cross, (step[:, :-1] * step[:, 1:]).sum(axis=-1))
        turn[~(moving[:, :-1] & moving[:, 1:])] = np.nan
        return cls(length / rollouts.dt, turn, moving, step, position, focus)


@dataclass(frozen=True)
class EpisodeMeasures:
    """Measures of episodes.

    Parameters
    ----------
    names
        Of each measure, with its individual where there are several.
    kinds
        Of each measure: one of the constants of this module.
    values
        ``(episodes, measures)``.
    """

    names: tuple[str, ...]
    kinds: tuple[str, ...]
    values: Floats


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
    rollouts: Rollouts, arena: Arena, lags: tuple[int, ...], rest: Floats
) -> EpisodeMeasures:
    """Measure every episode.

    Parameters
    ----------
    rollouts
        Of one method, or the recordings as rollouts, both smoothed alike.
    arena
        The field, for distances to its wall; in an open field to the origin, the source.
    lags
        Of :func:`lags_for` of the recordings, so that both sides are measured alike [steps].
    rest
        ``(individuals,)`` steps up to this length are at rest [arena unit].
    """
    per_chunk = max(1, CHUNK // max(1, int(rollouts.lengths.max()) * len(rollouts.individuals)))
    parts = []
    found: list[tuple[str, str, Floats]] = []
    with np.errstate(invalid="ignore", divide="ignore"):
        for first in range(0, len(rollouts), per_chunk):
            chosen = np.arange(first, min(first + per_chunk, len(rollouts)))
            series = Series.of(rollouts, chosen, rest)
            found = list(_measures(series, rollouts, arena, lags))
            parts.append(np.concatenate([values for _, _, values in found], axis=1))
    names, kinds = [], []
    for name, kind, values in found:
        who = rollouts.individuals if values.shape[1] > 1 else ("",)
        names += [f"{name}, {individual}" if individual else name for individual in who]
        kinds += [kind] * values.shape[1]
    return EpisodeMeasures(tuple(names), tuple(kinds), np.concatenate(parts))


def rest_and_turns(
    rollouts: Rollouts, rest: Floats, lags: tuple[int, ...]
) -> tuple[Floats, Floats]:
    """Return the share of steps at rest and the autocorrelation of turns, over all episodes.

    ``(individuals,)`` and ``(lags, individuals)``.
    """
    longest = int(rollouts.lengths.max()) * len(rollouts.individuals)
    per_chunk = max(1, CHUNK // max(1, longest))
    still, turns = [], []
    with np.errstate(invalid="ignore", divide="ignore"):
        for first in range(0, len(rollouts), per_chunk):
            chosen = np.arange(first, min(first + per_chunk, len(rollouts)))
            series = Series.of(rollouts, chosen, rest)
            still.append(_share(~series.moving, np.isfinite(series.speed)))
            turns.append(np.stack([_turn_autocorrelation(series.turn, lag) for lag in lags]))
        return _mean(np.concatenate(still), axis=0), _mean(np.concatenate(turns, axis=1), axis=1)


def _measures(
    series: Series, rollouts: Rollouts, arena: Arena, lags: tuple[int, ...]
) -> Iterator[tuple[str, str, Floats]]:
    """Name, kind and values ``(episodes, individuals)`` or ``(episodes, 1)`` of each measure."""
    dt, speed, turn = rollouts.dt, series.speed, series.turn
    acceleration = np.diff(speed, axis=1) / dt
    yield "speed", KINEMATIC, _mean(speed)
    yield "spread of speed", KINEMATIC, np.sqrt(_mean((speed - _mean(speed)[:, None]) ** 2))
    yield "share at rest", KINEMATIC, _share(~series.moving, np.isfinite(speed))
    yield "turning", KINEMATIC, _mean(np.abs(turn)) / dt
    yield "turning to the left", KINEMATIC, _mean(turn) / dt
    yield "skewness of acceleration", ORDER, _skewness(acceleration)
    yield "length of bouts of motion", ORDER, _bouts(series.moving, np.isfinite(speed)) * dt
    yield "longest rest", ORDER, _longest(~series.moving & np.isfinite(speed)) * dt
    yield "windings", ORDER, np.abs(np.nansum(turn, axis=1)) / _count(turn) / (2 * np.pi * dt)
    for lag in lags:
        seconds = f"{lag * dt:.3g} s"
        gone = np.linalg.norm(series.position[:, lag:] - series.position[:, :-lag], axis=-1)
        yield f"displacement in {seconds}", ORDER, _mean(gone)
        yield f"speed autocorrelation at {seconds}", ORDER, _correlation(speed, speed, lag)
        yield f"turn autocorrelation at {seconds}", ORDER, _turn_autocorrelation(turn, lag)
    lag = lags[0]
    ahead = _correlation(speed[:, :-1], np.abs(turn), lag)
    yield "speed before turn", ORDER, ahead - _correlation(np.abs(turn), speed[:, :-1], lag)
    yield from _interactions(series, rollouts, lag)
    yield from _places(series, arena)


def _interactions(
    series: Series, rollouts: Rollouts, lag: int
) -> Iterator[tuple[str, str, Floats]]:
    """Measures of how individuals react to their focus and to each other."""
    step, focus = series.step, series.focus[:, :-1]
    length = np.linalg.norm(step, axis=-1)
    length[~series.moving] = np.nan
    along = (step * focus).sum(axis=-1) / length
    left = (focus[..., 0] * step[..., 1] - focus[..., 1] * step[..., 0]) / length
    yield "course towards the focus", INTERACTIVE, _mean(along)
    yield "course to the left of the focus", INTERACTIVE, _mean(left)
    num = len(rollouts.individuals)
    if num == 1:
        return
    between = np.linalg.norm(series.position[:, :, :, None] - series.position[:, :, None], axis=-1)
    between[:, :, np.arange(num), np.arange(num)] = np.inf
    nearest = between.min(axis=-1)
    nearest[~np.isfinite(series.position[..., 0])] = np.nan
    yield "nearest neighbour", INTERACTIVE, _mean(nearest)
    yield (
        "spread of the nearest neighbour",
        INTERACTIVE,
        np.sqrt(_mean((nearest - _mean(nearest)[:, None]) ** 2)),
    )
    unit = step / length[..., None]
    yield "polarisation", INTERACTIVE, _mean(np.linalg.norm(_mean(unit, axis=2), axis=-1))[:, None]
    others = (np.nansum(series.speed, axis=2, keepdims=True) - series.speed) / (num - 1)
    yield "speed with the others", INTERACTIVE, _correlation(series.speed, others, 0)
    leading = _correlation(series.speed, others, lag) - _correlation(others, series.speed, lag)
    yield "speed ahead of the others", INTERACTIVE, leading


def _places(series: Series, arena: Arena) -> Iterator[tuple[str, str, Floats]]:
    """Measures of where individuals are."""
    position = series.position
    if arena.shape == "square":
        wall = arena.size - np.abs(position).max(axis=-1)
    else:
        radius = np.linalg.norm(position, axis=-1)
        wall = radius if arena.shape == "open" else arena.size - radius
    name = "distance from the source" if arena.shape == "open" else "distance from the wall"
    yield name, PLACE, _mean(wall)
    if arena.shape != "open":
        at_wall = wall < NEAR_WALL * arena.size
        yield "share at the wall", PLACE, _share(at_wall, np.isfinite(wall))


def _count(series: Floats) -> Ints:
    return np.asarray(np.isfinite(series).sum(axis=1))


def _mean(series: Floats, axis: int = 1) -> Floats:
    """Mean of what is defined; NaN where nothing is."""
    count = np.isfinite(series).sum(axis=axis)
    return np.asarray(np.nansum(series, axis=axis) / np.where(count, count, np.nan))


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
