"""Cleaning and scaling of tracks, each step explicit and stored with the demonstrations.

Order: confidence threshold, keypoint and heading, jumps flagged, gaps filled, smoothing. Nothing is
shifted in time: the low-pass filter runs forwards and backwards, and filled gaps are straight lines
(of headings, even turns).

Scaling to the arena frame is invertible. All recordings of an import share one scale, since with
scales of their own their speeds would not compare.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from animarl_envs.arena import Arena, parse_shape
from animarl_envs.array_types import Bools, Floats, Ints
from animarl_envs.demos.episode import FILLED, HEADING
from animarl_envs.errors import InputError, require, require_extra
from animarl_envs.importing.tracks import CENTROID, Tracks
from animarl_envs.locomotion import shorter_turn
from animarl_envs.settings import Checked, NotNegative, Positive, PositiveOrInfinite, option

JUMP_FACTOR = 8.0  # a step so many times longer than the 99th percentile is flagged as a jump
MOST_LISTED_JUMPS = 20
FEWER_THAN = 1000  # points to one outlier of the extent of an arena
EMPTY_RING = 3.0  # times the distance of the others from the middle: nothing lies between
LEAST_POINTS = 100  # of an extent in which outliers are looked for


@dataclass(frozen=True, kw_only=True)
class Cleaning(Checked):
    """What is done to the tracks of every recording."""

    keypoint: str = option(
        CENTROID, "keypoint", "Body part that is the position; default: mean of the visible ones."
    )
    heading: tuple[str, ...] | None = option(
        None, "heading", "Two keypoints; bodies point from the first to the second: thorax,head."
    )
    min_confidence: float | None = option(
        None,
        "min_confidence",
        "Keypoints with less count as not tracked; default: 0.6 for likelihoods; 0 keeps all.",
    )
    max_gap: NotNegative = option(
        0.0,
        "max_gap",
        "Fill gaps up to this many seconds linearly; longer gaps cut.",
    )
    smoothing_cutoff: NotNegative | None = option(
        None,
        "smoothing",
        "Low-pass cutoff in Hz (Butterworth, zero phase); 0: none.",
    )
    drop_jumps: bool = option(
        False, "drop_jumps/keep_jumps", "Turn jumps into gaps, or only flag them."
    )

    def __post_init__(self) -> None:
        if self.heading is not None:
            pair = tuple(self.heading) if isinstance(self.heading, Sequence) else ()
            require(
                not isinstance(self.heading, str) and len(pair) == 2 and pair[0] != pair[1],
                f"heading is {self.heading!r}: name two keypoints, the rear one first, such as "
                "thorax,head",
            )
            object.__setattr__(self, "heading", pair)
        if self.smoothing_cutoff == 0:
            object.__setattr__(self, "smoothing_cutoff", None)
        super().__post_init__()


def clean(
    tracks: Tracks, settings: Cleaning, likely: float | None = None
) -> tuple[Tracks, dict[str, Any]]:
    """Return a clean recording with one keypoint per individual, and what was done.

    Keypoints of a likelihood below ``likely`` are not used unless the settings state a threshold.
    Where gaps were filled, a signal says at which frames and of whom.
    """
    if tracks.frame_rate is None:
        raise InputError(f"{tracks.recording}: its frame rate is not known: give it with --fps")
    done: dict[str, Any] = {"frames": len(tracks)}
    rate, positions = tracks.frame_rate, tracks.positions
    longest = round(settings.max_gap * rate)
    stated = settings.min_confidence
    require(
        tracks.confidence is not None or (stated or 0) <= 0,
        f"{tracks.recording}: it holds no confidence: leave the threshold out",
    )
    limit = likely if stated is None else stated if stated > 0 else None
    if limit is not None and tracks.confidence is not None:
        unknown = np.isnan(tracks.confidence) & (stated is None)
        weak: Bools = np.logical_not((tracks.confidence >= limit) | unknown)
        positions = np.where(weak[..., None], np.nan, positions)
        done["below_confidence"] = int(weak.sum())
        done["confidence_of_at_least"] = limit
    bodies = _body_positions(positions, tracks.keypoints, settings.keypoint, tracks.recording)
    done["keypoint"] = settings.keypoint
    heading = _headings(tracks, positions, settings)
    jumps, swaps = find_jumps(bodies)
    done["jumps"], done["first_jumps"] = len(jumps), _flags(tracks, jumps)
    done["identity_swaps"], done["first_swaps"] = len(swaps), _flags(tracks, swaps)
    done["jumps_dropped"] = settings.drop_jumps
    if settings.drop_jumps:
        for individual in range(bodies.shape[1]):  # what trackers write of lost animals is no place
            for start, stop in pairwise(jumps[jumps[:, 1] == individual, 0]):
                if (bodies[start:stop, individual] == bodies[start, individual]).all():
                    bodies[start:stop, individual] = np.nan
        bodies[jumps[:, 0], jumps[:, 1]] = np.nan
        if heading is not None:
            heading[jumps[:, 0], jumps[:, 1]] = np.nan
    gaps: Bools = np.asarray(np.isnan(bodies).any(axis=2))
    seen = np.flatnonzero(~gaps.all(axis=1))  # before and after, nobody was in the recording
    done["untracked"] = int(np.count_nonzero(gaps[seen[0] : seen[-1] + 1])) if len(seen) else 0
    bodies, done["filled"] = fill_gaps(bodies, longest)
    if heading is not None:
        heading, _ = fill_gaps(heading, longest, shorter_turn)
        lost = np.isnan(heading) & np.isfinite(bodies).all(axis=2)
        bodies[lost] = np.nan
        done["heading"], done["heading_unknown"] = list(settings.heading or ()), int(lost.sum())
    signals = dict(tracks.signals)
    if settings.max_gap > 0:
        signals[FILLED] = np.asarray(gaps & np.isfinite(bodies).all(axis=2))
    if settings.smoothing_cutoff is not None:
        cutoff = settings.smoothing_cutoff
        low_pass = partial(smooth, cutoff=cutoff, frame_rate=rate, name=tracks.recording)
        bodies = low_pass(bodies)
        if heading is not None:  # angles of smoothed unit vectors
            x, y = np.moveaxis(
                low_pass(np.stack([np.cos(heading), np.sin(heading)], axis=-1)), -1, 0
            )
            heading = np.arctan2(y, x)
        done["smoothing"] = {
            "filter": "Butterworth low-pass, order 1, forward and backward",
            "cutoff_hz": cutoff,
        }
    if heading is not None:
        signals[HEADING] = heading
    tracks = replace(tracks, signals=signals)
    return tracks.with_bodies(bodies, keypoints=(settings.keypoint,)), done


def _headings(tracks: Tracks, positions: Floats, settings: Cleaning) -> Floats | None:
    """Return headings ``(frames, individuals)`` [rad] from two keypoints or the file."""
    if settings.heading is not None:
        rear, front = (
            _body_positions(positions, tracks.keypoints, name, f"{tracks.recording}, heading")
            for name in settings.heading
        )
        apart = front - rear
        angle = np.arctan2(apart[..., 1], apart[..., 0])
        return np.where((apart == 0.0).all(axis=-1), np.nan, angle)
    stated = tracks.signals.get(HEADING)
    if stated is None or stated.shape != (len(tracks), len(tracks.individuals)):
        return None  # one column for all is handed on as it is
    return stated.astype(np.float64)


def _flags(tracks: Tracks, flagged: Ints) -> list[dict[str, Any]]:
    """Return the first of the flagged frames: frame, time [s] and names."""
    rate = tracks.frame_rate or 1.0
    return [
        {
            "frame": tracks.start + frame,
            "time": round((tracks.start + frame) / rate, 3),
            "individuals": [tracks.individuals[i] for i in members],
        }
        for frame, *members in flagged[:MOST_LISTED_JUMPS].tolist()
    ]


def _body_positions(
    positions: Floats, keypoints: tuple[str, ...], keypoint: str, name: str
) -> Floats:
    """Return one position per individual ``(frames, individuals, 2)`` from all keypoints."""
    if keypoint in keypoints:
        return positions[:, :, keypoints.index(keypoint)].copy()
    require(
        keypoint == CENTROID,
        f"{name}: there is no keypoint {keypoint!r}: choose {CENTROID} or one of "
        f"{', '.join(keypoints)}",
    )
    if len(keypoints) == 1:
        return positions[:, :, 0].copy()
    seen: Bools = np.asarray(np.isfinite(positions).all(axis=-1))
    total = np.where(seen[..., None], positions, 0.0).sum(axis=2)
    count = seen.sum(axis=2)[..., None]
    return np.asarray(np.where(count > 0, total / np.maximum(count, 1), np.nan))


def find_jumps(bodies: Floats) -> tuple[Ints, Ints]:
    """Return jumps ``(n, 2)`` (frame, individual) and identity swaps ``(m, 3)`` (frame, i, j).

    A swap is a pair whose tracks fit better exchanged: each lands nearer to the other's last place,
    by less than half the way.
    """
    with np.errstate(invalid="ignore"):
        step = np.linalg.norm(np.diff(bodies, axis=0), axis=2)
    usual = np.nanquantile(step, 0.99) if np.isfinite(step).any() else 0.0
    far = np.argwhere(step > JUMP_FACTOR * usual) if usual > 0 else np.empty((0, 2), int)
    swaps = []
    for i in range(bodies.shape[1]):
        for j in range(i + 1, bodies.shape[1]):
            crossed = np.linalg.norm(bodies[1:, i] - bodies[:-1, j], axis=1) + np.linalg.norm(
                bodies[1:, j] - bodies[:-1, i], axis=1
            )
            own = step[:, i] + step[:, j]
            frames = np.flatnonzero((crossed < 0.5 * own) & (own > 4 * usual)) + 1
            swaps += [(frame, i, j) for frame in frames.tolist()]
    return np.asarray(far + [1, 0], dtype=np.int64), np.array(swaps, np.int64).reshape(-1, 3)


def fill_gaps(
    values: Floats, longest: int, way: Callable[[Floats, Floats], Floats] = np.subtract
) -> tuple[Floats, int]:
    """Fill inner gaps of at most ``longest`` frames evenly; return values and frames filled.

    ``values`` are ``(frames, individuals, ...)``, NaN where not known; of angles ``way`` is
    :func:`shorter_turn`.
    """
    out, filled = values.copy(), 0
    for i in range(values.shape[1]):
        own = out[:, i]
        known = np.flatnonzero(np.isfinite(own).reshape(len(own), -1).all(axis=1))
        gaps = np.diff(known) - 1
        for k in np.flatnonzero((gaps > 0) & (gaps <= longest)):
            first, last = known[k], known[k + 1]
            share = (np.arange(first + 1, last) - first) / (last - first)
            share = share.reshape(-1, *[1] * (own.ndim - 1))
            own[first + 1 : last] = own[first] + share * way(own[last], own[first])
            filled += len(share)
    return out, filled


def smooth(bodies: Floats, cutoff: float, frame_rate: float, name: str = "tracks") -> Floats:
    """Apply a zero-phase Butterworth low-pass of first order to each stretch without gaps.

    The two passes together halve the power twice: the amplitude at the cutoff is 1/2.
    """
    with require_extra("smoothing", "data"):
        from scipy.signal import butter, filtfilt
    require(
        cutoff < frame_rate / 2,
        f"{name}: smoothing at {cutoff:g} Hz needs more than {2 * cutoff:g} frames a second, "
        f"it has {frame_rate:g}: lower the cutoff or leave it out",
    )
    numerator, denominator = butter(1, cutoff / (frame_rate / 2))
    shortest = 3 * max(len(numerator), len(denominator)) + 1
    out = bodies.copy()
    for i in range(bodies.shape[1]):
        for start, stop in runs(np.isfinite(bodies[:, i]).all(axis=1)):
            if stop - start >= shortest:
                stretch = filtfilt(numerator, denominator, bodies[start:stop, i], axis=0)
                out[start:stop, i] = stretch
    return out


def runs(mask: Bools | np.bool_) -> list[tuple[int, int]]:
    """Return the first and one-past-last index of each run of True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], np.asarray(mask, dtype=np.int8), [0]])))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))


def resample(
    values: Floats,
    frame_rate: float,
    decision_rate: float,
    way: Callable[[Floats, Floats], Floats] = np.subtract,
) -> Floats:
    """Return values at decision times, interpolated where the rates do not divide.

    The first frame keeps its time, so nothing is shifted. ``way`` is as for :func:`fill_gaps`.
    """
    ratio = frame_rate / decision_rate
    times = np.arange(0, int((len(values) - 1) / ratio + 1e-9) + 1) * ratio
    low = np.minimum(times.astype(np.int64), len(values) - 1)
    high = np.minimum(low + 1, len(values) - 1)
    share = (times - low).reshape(-1, *[1] * (values.ndim - 1))
    between = values[low] + share * way(values[high], values[low])
    return np.asarray(np.where(share < 1e-9, values[low], between))


@dataclass(frozen=True, kw_only=True)
class Scaling(Checked):
    """How positions become arena units."""

    shape: str = option(
        "square",
        "arena",
        "square (half side 1), disc (radius 1), open (no edge), ring=0.6 (a disc with a hole of "
        "that radius, which nobody enters), rectangle=0.5 (its height as a share of its width) or "
        "'polygon=x,y;x,y;x,y' (its corners, without one that points inwards).",
    )
    width: Positive | None = option(
        None,
        "arena_width",
        "Side or diameter in the file's unit; default: extent of the tracks.",
    )
    centre: tuple[float, float] | None = option(
        None, "centre", "Centre x,y of the arena in the file's unit; default: found."
    )
    each: bool = option(False, "scale_each", "Scale each recording by its own extent.")
    centre_each: bool = option(
        False, "centre_each", "Each recording has its own centre, as where the camera was moved."
    )
    px_per_cm: Positive | None = option(
        None,
        "px_per_cm",
        "The file's units per cm; all lengths are then in cm.",
    )
    units_per_arena_unit: Positive | None = option(
        None,
        "units",
        "Open arena: the file's units per arena unit; default: half the extent, 1 for a source.",
    )
    landmarks: Mapping[str, Any] = option(
        dict,
        "landmark",
        "A point that animals perceive, as name=x,y in arena units from the middle, y upwards.",
    )
    obstacles: tuple[Any, ...] = option(
        (),
        "obstacle",
        "A disc that nobody enters, as x,y,radius in arena units from the middle, y upwards.",
    )
    boundary: PositiveOrInfinite = option(
        1.1, "boundary", "Individuals beyond it are out, in arena units."
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.centre is not None:
            require(len(self.centre) == 2, f"centre is {self.centre}: give x and y")
            object.__setattr__(self, "centre", (float(self.centre[0]), float(self.centre[1])))
        self.arena  # noqa: B018  # is checked

    @property
    def arena(self) -> Arena:
        """The arena in arena units."""
        shape, made = parse_shape(self.shape)
        return Arena(
            shape,
            size=1.0,
            boundary=self.boundary,
            landmarks=self.landmarks,  # type: ignore[arg-type]
            obstacles=(*made, *self.obstacles),
        )


@dataclass(frozen=True)
class Scale:
    """Map positions to the arena: ``p' = (p - centre) / unit``, then y times ``y_sign``."""

    centre: tuple[float, float]
    unit: float  # of the file per arena unit
    y_sign: float

    def to_arena(self, positions: NDArray[np.floating]) -> Floats:
        """Convert positions ``(..., 2)`` from the file's unit to arena units."""
        return np.asarray((positions - np.array(self.centre)) / self.unit * [1.0, self.y_sign])

    def apply(self, tracks: Tracks) -> Tracks:
        """Return the recording in arena units, with headings counter-clockwise."""
        signals = dict(tracks.signals)
        if HEADING in signals and self.y_sign < 0:
            signals[HEADING] = -np.asarray(signals[HEADING], dtype=np.float64)
        bodies = self.to_arena(tracks.bodies)
        return tracks.with_bodies(bodies, signals=signals, unit="arena unit")


def scales_of(
    recordings: Sequence[Tracks], settings: Scaling, searched: bool = False
) -> list[Scale]:
    """Return the scale of each recording (one keypoint per individual): one for all, or its own.

    ``searched`` says that a source is at the origin, which then stays in its place.
    """
    if settings.each or settings.centre_each:
        own = [scale_of([tracks], settings, searched) for tracks in recordings]
        widest = max(one.unit for one in own)
        return own if settings.each else [replace(one, unit=widest) for one in own]
    common = scale_of(recordings, settings, searched)
    return [replace(common, y_sign=-1.0 if one.y_down else 1.0) for one in recordings]


def far_outliers(points: Floats) -> NDArray[np.bool_]:
    """Return which of ``(points, 2)`` are so few and far away that they say nothing of the arena.

    They are one, or a thousandth of all, and nothing lies between the others and
    :data:`EMPTY_RING` times their distance from the middle.
    """
    away = np.linalg.norm(points - np.median(points, axis=0), axis=1)
    ordered = np.sort(away)[-(len(away) // FEWER_THAN) - 2 :]
    gaps = np.flatnonzero((ordered[1:] > EMPTY_RING * ordered[:-1]) & (ordered[:-1] > 0))
    enough = len(away) >= LEAST_POINTS and len(gaps) > 0
    return away > ordered[gaps[0]] if enough else np.zeros(len(away), dtype=bool)


def scale_of(recordings: Sequence[Tracks], settings: Scaling, searched: bool = False) -> Scale:
    """Return the common scale of recordings."""
    first = recordings[0]
    sign = -1.0 if first.y_down else 1.0
    is_open = settings.shape == "open"
    if is_open and searched:
        return Scale(settings.centre or (0.0, 0.0), settings.units_per_arena_unit or 1.0, sign)
    points = np.concatenate([one.bodies[one.tracked] for one in recordings])
    require(
        len(points),
        f"{first.recording}: no individual was ever tracked: check the file, "
        "or lower --min-confidence",
    )
    points = points[~far_outliers(points)]
    x, y = (points.min(axis=0) + points.max(axis=0)) / 2
    centre = settings.centre or (float(x), float(y))
    if is_open and settings.units_per_arena_unit is not None:
        half = settings.units_per_arena_unit
    elif settings.width is not None:
        half = settings.width / 2
    elif settings.arena.shape == "disc":
        half = float(np.linalg.norm(points - np.array(centre), axis=1).max())
    else:
        half = float(np.abs(points - np.array(centre)).max())
    require(
        half > 0, f"{first.recording}: its tracks have no extent: give the arena's width instead"
    )
    return Scale(centre, half, sign)
