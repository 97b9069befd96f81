"""Headings of recorded bodies, cleaned and thinned as their positions are, but on the circle.

In tracks a heading counts from x towards y of the file [rad], in demonstrations counter-clockwise
in the arena frame: where images' y is turned upwards, headings are turned as well.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from animarl_envs.demos.episode import HEADING
from animarl_envs.errors import InputError
from animarl_envs.importing.scaling import Scale
from animarl_envs.importing.tracks import Tracks

Floats = NDArray[np.float64]

PER_UNIT = {"rad": 1.0, "deg": np.pi / 180.0}
_UNIT_IN_NAME = re.compile(r"[\s_/\[(]+(rad|deg)(?:ians?|rees?|s)?[\])]?\s*$", re.IGNORECASE)


def direction(start: Floats, end: Floats) -> Floats:
    """Angles ``(...)`` of the ways from points ``(..., 2)`` to others [rad]; NaN for no way."""
    apart = end - start
    angle = np.arctan2(apart[..., 1], apart[..., 0])
    return np.where((apart == 0.0).all(axis=-1), np.nan, angle)


def fill_headings(heading: Floats, longest: int) -> Floats:
    """Inner gaps of at most ``longest`` frames are turned through evenly, by the shorter way.

    ``heading`` is ``(frames, individuals)`` [rad], NaN where it is not known.
    """
    out = heading.copy()
    for i in range(heading.shape[1]):
        known = np.flatnonzero(np.isfinite(heading[:, i]))
        gaps = np.diff(known) - 1
        for k in np.flatnonzero((gaps > 0) & (gaps <= longest)):
            first, last = known[k], known[k + 1]
            share = (np.arange(first + 1, last) - first) / (last - first)
            turn = _shorter(heading[last, i] - heading[first, i])
            out[first + 1 : last, i] = heading[first, i] + share * turn
    return out


def smooth_headings(heading: Floats, smoothed: Callable[[Floats], Floats]) -> Floats:
    """The angles of smoothed unit vectors; ``smoothed`` takes and gives positions ``(..., 2)``."""
    vectors = smoothed(np.stack([np.cos(heading), np.sin(heading)], axis=-1))
    return np.arctan2(vectors[..., 1], vectors[..., 0])


def resample_headings(heading: Floats, frame_rate: float, decision_rate: float) -> Floats:
    """Headings at the times of :func:`animarl_envs.importing.cleaning.resample`, by the shorter
    way between frames."""
    ratio = frame_rate / decision_rate
    times = np.arange(0, int((len(heading) - 1) / ratio + 1e-9) + 1) * ratio
    low = np.minimum((times + 1e-9).astype(np.int64), len(heading) - 1)
    high = np.minimum(low + 1, len(heading) - 1)
    share = np.maximum(times - low, 0.0)[:, None]
    return np.asarray(heading[low] + share * _shorter(heading[high] - heading[low]))


def in_arena_frame(tracks: Tracks, scale: Scale) -> Tracks:
    """The recording with its headings, if it has some, counted counter-clockwise."""
    if HEADING not in tracks.signals or scale.y_sign > 0:
        return tracks
    turned = -np.asarray(tracks.signals[HEADING], dtype=np.float64)
    return replace(tracks, signals={**tracks.signals, HEADING: turned})


def radians_per_unit(path: Path, column: str, unit: str | None) -> float:
    """Of a table's column of headings, whose unit is stated or stands in its name.

    Raises
    ------
    InputError
        If neither says whether these are radians or degrees.
    """
    match = _UNIT_IN_NAME.search(column)
    named = unit or (match[1].lower() if match else None)
    if named not in PER_UNIT:
        raise InputError(
            f"{path}: column {column!r} has angles in {named or 'no stated unit'}: give --option "
            "angle_unit=rad or angle_unit=deg"
        )
    return PER_UNIT[named]


def _shorter(turn: Floats) -> Floats:
    """Turns [rad] by the shorter way, in [-pi, pi)."""
    return np.asarray((turn + np.pi) % (2.0 * np.pi) - np.pi)
