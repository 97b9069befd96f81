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

from animarl_algos.evaluation.rollouts import Rollouts
from animarl_envs.arena import Arena
from animarl_envs.array_types import Bools, Floats, Ints
from animarl_envs.demos.episode import Episodes
from animarl_envs.focus import FALLBACK, focus_directions, nearest_other

LAGS = (0.5, 2.0, 5.0, 20.0)  # [s] at which order in time is looked at
LONGEST_LAG = 0.5  # of the median episode: beyond it too few pairs of steps are left
CHUNK = 4_000_000  # frames x individuals that are padded at once
LOW = 0.05  # quantile of the distance to the nearest neighbour
LEAD, DELAYS = 2.0, 10  # by which an animal may lead [s]; delays that are tried, to either side
ROUNDING = 1e-24  # variance that is rounding alone: of a constant speed, which correlates with none
OF_EACH_ANIMAL = (
    "speed",
    "share at rest",
    "turning",
    "nearest neighbour",
    "distance from the wall",
    "distance from the start",
)
"""Measures whose differences between the animals of a group are compared."""
NEAR_WALL = 0.1  # of the arena's size: so near a wall counts as being at it


@dataclass(frozen=True)
class Series:
    """Padded series of several episodes, NaN where an episode has ended or nothing is defined.

    ``chosen`` ``(episodes,)`` says which of all. ``position`` is ``(episodes, frames, individuals,
    2)`` [arena unit], ``focus`` unit vectors of that shape towards the focus (of free animals the
    nearest companion, not the course that their actions are relative to), ``step`` one frame
    shorter; ``speed`` [arena unit / s] and ``moving`` are ``(episodes, steps, individuals)``,
    ``turn`` is one step shorter, the signed angle between successive steps [rad], NaN where either
    is at rest.
    """

    chosen: Ints
    speed: Floats
    turn: Floats
    moving: Bools
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
            if rollouts.has_goal:
                focus = focus_directions(position, rollouts.roles)
            else:  # of free animals it is measured how they go about their nearest companion
                apart = nearest_other(position)
                length = np.linalg.norm(apart, axis=-1, keepdims=True)
                focus = np.where(length > 0, apart / np.where(length > 0, length, 1.0), FALLBACK)
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
        return np.asarray(np.linalg.norm(nearest_other(self.position), axis=-1))

    @cached_property
    def course(self) -> Floats:
        """Unit vectors of all steps; NaN of one at rest."""
        length = np.linalg.norm(self.step, axis=-1)
        length[~self.moving] = np.nan
        return np.asarray(self.step / length[..., None])


def cross(first: Floats, second: Floats) -> Floats:
    """Of vectors in the plane."""
    return np.asarray(first[..., 0] * second[..., 1] - first[..., 1] * second[..., 0])


def angle(first: Floats, second: Floats) -> Floats:
    """Signed angle between vectors [rad], positive to the left."""
    return np.asarray(np.arctan2(cross(first, second), (first * second).sum(axis=-1)))


@dataclass(frozen=True)
class EpisodeMeasures:
    """Measures of episodes, ``values`` ``(episodes, measures)``.

    ``names`` hold the lag, and the individual where there are several.
    """

    names: tuple[str, ...]
    values: Floats

    def column(self, name: str) -> Floats:
        """Return the measure of that name of every episode, ``(episodes,)``."""
        return np.asarray(self.values[:, self.names.index(name)])


def plain_name(name: str) -> str:
    """Return the name of a measure without its lag and its individual."""
    name = name.partition(", ")[0]
    return name.rsplit(" ", 2)[0] if name.endswith(" s") else name


def lags_for(steps: float, dt: float) -> tuple[int, ...]:
    """Return the lags [steps] at which episodes of so many steps can be looked at."""
    longest = LONGEST_LAG * steps
    fitting = sorted({max(1, round(lag / dt)) for lag in LAGS if lag / dt <= longest})
    if len(fitting) >= 2:
        return tuple(fitting)
    return tuple(sorted({max(1, round(longest / part)) for part in (8, 2)}))


def seconds_of(lag: int, dt: float) -> str:
    """Return a lag in words."""
    return f"{lag * dt:.3g} s"


def median_steps(rollouts: Episodes) -> float:
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
    measures: list[tuple[str, Floats]] = []
    with np.errstate(invalid="ignore", divide="ignore"):
        for series in Series.of(rollouts, rest):
            measures = [*_motion(series, rollouts.dt, lags)]
            alone = rollouts.num_individuals == 1 and not rollouts.has_goal
            measures += () if alone else _interactions(series, lags[0])
            if alone or rollouts.is_group:
                rests = _bouts(~series.moving, np.isfinite(series.speed))
                measures.append(("length of rests", rests * rollouts.dt))
            if arena is not None:
                measures += _places(series, arena, "searcher" in rollouts.roles)
            if rollouts.is_group:
                means = [(name, _mean(values)[:, None]) for name, values in measures]
                groups = _groups(series, rollouts.dt, lags[-1])
                measures = [*means, *groups, *_differences_between_animals(measures)]
            parts.append(np.concatenate([values for _, values in measures], axis=1))
    names = [
        f"{name}, {one}" if one else name
        for name, values in measures
        for one in (rollouts.individuals if values.shape[1] > 1 else ("",))
    ]
    return EpisodeMeasures(tuple(names), np.concatenate(parts))


def _motion(series: Series, dt: float, lags: tuple[int, ...]) -> Iterator[tuple[str, Floats]]:
    """Name and values ``(episodes, individuals)`` or ``(episodes, 1)`` of each measure."""
    speed, turn = series.speed, series.turn
    acceleration = np.diff(speed, axis=1) / dt
    yield "speed", _mean(speed)
    yield "spread of speed", _spread(speed)
    yield "share at rest", _mean(np.where(np.isfinite(speed), ~series.moving, np.nan))
    yield "turning", _mean(np.abs(turn)) / dt
    yield "turning to the left", _mean(turn) / dt
    yield "skewness of acceleration", _skewness(acceleration)
    yield "length of bouts of motion", _bouts(series.moving, np.isfinite(speed)) * dt
    yield "speed gained late", _gained(speed)
    yield "longest rest", _longest(~series.moving & np.isfinite(speed)) * dt
    wound = np.abs(np.nansum(turn, axis=1)) / np.isfinite(turn).sum(axis=1)
    yield "windings", wound / (2 * np.pi * dt)
    for lag in lags:
        seconds = seconds_of(lag, dt)
        gone = np.linalg.norm(series.position[:, lag:] - series.position[:, :-lag], axis=-1)
        yield f"displacement in {seconds}", _mean(gone)
        yield f"speed autocorrelation at {seconds}", _correlation(speed, speed, lag)
        yield f"turn autocorrelation at {seconds}", _turn_autocorrelation(turn, lag)
    lag = lags[0]
    ahead = _correlation(speed[:, :-1], np.abs(turn), lag)
    yield "speed before turn", ahead - _correlation(np.abs(turn), speed[:, :-1], lag)


def _interactions(series: Series, lag: int) -> Iterator[tuple[str, Floats]]:
    """Measures of how individuals react to their focus and to each other."""
    step, focus = series.step, series.focus[:, :-1]
    length = np.linalg.norm(step, axis=-1)
    length[~series.moving] = np.nan
    along = (step * focus).sum(axis=-1) / length
    left = cross(focus, step) / length
    yield "course towards the focus", _mean(along)
    yield "course to the left of the focus", _mean(left)
    num = series.speed.shape[2]
    if num == 1:
        return
    yield "nearest neighbour", _mean(series.nearest)
    yield "spread of the nearest neighbour", _spread(series.nearest)
    heading = np.linalg.norm(_mean(series.course, axis=2), axis=-1)
    yield "polarisation", _mean(heading)[:, None]
    others = (np.nansum(series.speed, axis=2, keepdims=True) - series.speed) / (num - 1)
    yield "speed with the others", _correlation(series.speed, others, 0)
    leading = _correlation(series.speed, others, lag) - _correlation(others, series.speed, lag)
    yield "speed ahead of the others", leading


def _groups(series: Series, dt: float, longest: int) -> Iterator[tuple[str, Floats]]:
    """Measures of a group as a whole.

    Milling is the angular momentum of Couzin et al. (2002, J. Theor. Biol. 218, 1): the mean over
    animals of the sine between the direction from the group's centre and the course, 1 where all
    circle about it. The lag is that of Nagy et al. (2010, Nature 464, 890): by how much an animal's
    course precedes, or follows, that of the others, where their correlation is highest; the mean
    of its size is 0 where all turn together.
    """
    near = series.nearest.reshape(len(series.nearest), -1)
    yield "5 % nearest neighbour", np.nanquantile(near, LOW, axis=1)[:, None]
    arm = series.position - _mean(series.position, axis=2)[:, :, None]
    extent = np.sqrt(_mean((arm**2).sum(axis=-1), axis=2))
    yield "extent of the group", _mean(extent)[:, None]
    unit = arm / np.linalg.norm(arm, axis=-1, keepdims=True)
    around = np.abs(_mean(cross(unit[:, :-1], series.course), axis=2))
    yield "milling", _mean(around)[:, None]
    lead = np.abs(_lead(series.course, min(longest, max(1, round(LEAD / dt)))))
    yield "leadership lag", _mean(lead, axis=1)[:, None] * dt


def _differences_between_animals(
    measures: list[tuple[str, Floats]],
) -> Iterator[tuple[str, Floats]]:
    """Standard deviation between the animals of a group of what each of them does."""
    for name, values in measures:
        if name in OF_EACH_ANIMAL:
            apart = np.sqrt(_mean((values - _mean(values)[:, None]) ** 2))[:, None]
            yield f"spread of {name} between animals", apart


def _lead(course: Floats, farthest: int) -> Floats:
    """By how many steps each animal's course precedes that of the others, ``(episodes, K)``."""
    episodes, steps, num, _ = course.shape
    filled = np.nan_to_num(course)
    others = (filled.sum(axis=2, keepdims=True) - filled) / (num - 1)
    delays = np.unique(np.linspace(-farthest, farthest, 2 * min(farthest, DELAYS) + 1).round())
    delays = delays[np.abs(delays) < steps]
    agree = np.empty((len(delays), episodes, num))
    for row, delay in zip(agree, delays.astype(int).tolist()):
        own, later = max(0, -delay), max(0, delay)
        both = course[:, own : steps - later] * others[:, later : steps - own]
        row[:] = _mean(both.sum(axis=-1))
    known = np.isfinite(agree).any(axis=0)
    best = np.nan_to_num(agree, nan=-np.inf).argmax(axis=0)
    return np.where(known, delays[best], np.nan)


def _places(series: Series, arena: Arena, searching: bool) -> Iterator[tuple[str, Floats]]:
    """Measures of where individuals are, and along which axis of the field they go.

    The anisotropy of the course is 1 where all steps run along one line, and 0 where they have no
    axis. An open field without a source has the start alone.
    """
    course = series.course
    axis = 2 * np.arctan2(course[..., 1], course[..., 0])
    yield "anisotropy of the course", np.hypot(_mean(np.cos(axis)), _mean(np.sin(axis)))
    yield "course along the x axis", _mean(np.cos(axis))
    if arena.shape == "open" and not searching:
        gone = np.linalg.norm(series.position - series.position[:, :1], axis=-1)
        yield "distance from the start", _mean(gone)
        return
    wall = distance_to_edge(series.position, arena)
    name = "distance from the source" if arena.shape == "open" else "distance from the wall"
    yield name, _mean(wall)
    if arena.shape != "open":
        at_wall = np.where(np.isfinite(wall), wall < NEAR_WALL * arena.size, np.nan)
        yield "share at the wall", _mean(at_wall)


def distance_to_edge(points: Floats, arena: Arena) -> Floats:
    """Return the distance to the nearest wall of the field, or to the origin of an open one."""
    radius = np.linalg.norm(points, axis=-1)
    if arena.shape == "open":
        return np.asarray(radius)
    out = np.abs(points).max(axis=-1) if arena.shape == "square" else radius
    return np.asarray(np.minimum(arena.size - out, arena.clearance(points)))


def _mean(series: Floats, axis: int = 1) -> Floats:
    """Mean of what is defined; NaN where nothing is."""
    count = np.isfinite(series).sum(axis=axis)
    return np.asarray(np.nansum(series, axis=axis) / np.where(count, count, np.nan))


def _spread(series: Floats) -> Floats:
    return np.sqrt(_mean((series - _mean(series)[:, None]) ** 2))


def _gained(series: Floats) -> Floats:
    """Mean of the second half less that of the first, over the mean of both."""
    half = np.isfinite(series).sum(axis=1, keepdims=True) / 2
    late = np.arange(series.shape[1])[None, :, None] >= half
    before, after = (_mean(np.where(late == side, series, np.nan)) for side in (False, True))
    mean = _mean(series)
    return np.asarray((after - before) / np.where(mean > 0, mean, np.nan))


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
    one, other = _mean(a**2), _mean(b**2)
    varies = np.minimum(one, other) > ROUNDING
    return np.asarray(_mean(a * b) / np.where(varies, np.sqrt(one * other), np.nan))


def _turn_autocorrelation(turn: Floats, lag: int) -> Floats:
    """Mean of sin(turn) sin(turn later), per mean square: 1 for circles, 0 without memory."""
    if turn.shape[1] <= lag:
        return np.full((turn.shape[0], turn.shape[2]), np.nan)
    sine = np.sin(turn)
    square = _mean(sine**2)
    return np.asarray(_mean(sine[:, lag:] * sine[:, :-lag]) / np.where(square > 0, square, np.nan))


def _bouts(moving: Bools, defined: Bools) -> Floats:
    """Mean length of uninterrupted stretches [steps]; 0 where there is none."""
    moving = moving & defined
    begins = moving & ~np.concatenate([np.zeros_like(moving[:, :1]), moving[:, :-1]], axis=1)
    count = begins.sum(axis=1)
    return np.asarray(moving.sum(axis=1) / np.maximum(count, 1))


def stretches(true: Bools) -> Ints:
    """Return the length of every uninterrupted stretch [steps].

    ``true`` is ``(episodes, steps, individuals)``.
    """
    padded = np.pad(true, ((0, 0), (1, 1), (0, 0))).astype(np.int8)
    change = np.diff(padded, axis=1).swapaxes(1, 2)
    return np.nonzero(change < 0)[2] - np.nonzero(change > 0)[2]


def _longest(true: Bools) -> Floats:
    """Length of the longest uninterrupted stretch of each column [steps]."""
    count = true.cumsum(axis=1)
    before = np.maximum.accumulate(np.where(true, 0, count), axis=1)
    return np.asarray((count - before).max(axis=1, initial=0), dtype=np.float64)
