"""Scaling of tracks to the arena frame: invertible, and stored with the demonstrations.

All recordings of an import share one scale, since with scales of their own their speeds would not
compare.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from animarl_envs.arena import Arena
from animarl_envs.checks import check_options, option
from animarl_envs.demos.episode import HEADING
from animarl_envs.errors import require
from animarl_envs.importing.tracks import Tracks


@dataclass(frozen=True, kw_only=True)
class Scaling:
    """How positions become arena units."""

    shape: Literal["square", "disc", "open"] = option(
        "square", "arena", "square, disc (half side or radius 1) or open (only the unit changes)."
    )
    width: float | None = option(
        None, "arena_width", "Side or diameter in the file's unit; default: extent.",
        "a positive number",
    )  # fmt: skip
    centre: tuple[float, float] | None = option(
        None, "centre", "Of the arena, x,y in the file's unit; default: of extent, or the source."
    )
    each: bool = option(False, "scale_each", "Each recording by its own extent, not all by one.")
    px_per_cm: float | None = option(
        None, "px_per_cm", "The file's units to 1 cm; all lengths then are in cm.",
        "a positive number",
    )  # fmt: skip
    units_per_arena_unit: float | None = option(
        None, "units",
        "Open arena: the file's units per arena unit; default: half the extent, 1 for a source.",
        "a positive number",
    )  # fmt: skip
    boundary: float = option(1.1, "boundary", "Beyond it an individual is out, in arena units.")
    flip_y: bool | None = option(
        None, "", "Whether y is turned upwards; default: if it grows downwards in the file."
    )

    def __post_init__(self) -> None:
        check_options(self)
        if self.centre is not None:
            require(len(self.centre) == 2, f"centre is {self.centre}: give x and y")
            object.__setattr__(self, "centre", (float(self.centre[0]), float(self.centre[1])))

    @property
    def arena(self) -> Arena:
        """The arena in arena units."""
        return Arena(self.shape, size=1.0, boundary=self.boundary)


@dataclass(frozen=True)
class Scale:
    """``p' = (p - centre) / unit``, then y times ``y_sign``: one recording's way to the arena."""

    centre: tuple[float, float]
    unit: float  # of the file per arena unit
    y_sign: float

    def to_arena(self, positions: NDArray[np.floating]) -> NDArray[np.float64]:
        """From the file's unit to arena units, ``(..., 2)``."""
        return np.asarray((positions - np.array(self.centre)) / self.unit * [1.0, self.y_sign])

    def to_file(self, positions: NDArray[np.floating]) -> NDArray[np.float64]:
        """From arena units back to the file's unit, ``(..., 2)``."""
        return np.asarray(positions * [1.0, self.y_sign] * self.unit + np.array(self.centre))

    def turn_headings(self, tracks: Tracks) -> Tracks:
        """The recording with its headings, if it has some, counted counter-clockwise."""
        if HEADING not in tracks.signals or self.y_sign > 0:
            return tracks
        turned = -np.asarray(tracks.signals[HEADING], dtype=np.float64)
        return replace(tracks, signals={**tracks.signals, HEADING: turned})

    def to_dict(self) -> dict[str, Any]:
        return asdict(self)

    @classmethod
    def from_dict(cls, record: Mapping[str, Any]) -> Scale:
        x, y = record["centre"]
        return cls((float(x), float(y)), float(record["unit"]), float(record["y_sign"]))


def scales_of(
    recordings: Sequence[Tracks], settings: Scaling, searched: bool = False
) -> list[Scale]:
    """The scale of each recording (one keypoint per individual): one for all, or each its own.

    ``searched`` says that a source is at the origin, which then stays in its place.
    """
    if settings.each:
        return [scale_of([tracks], settings, searched) for tracks in recordings]
    common = scale_of(recordings, settings, searched)
    return [replace(common, y_sign=_sign(tracks, settings)) for tracks in recordings]


def scale_of(recordings: Sequence[Tracks], settings: Scaling, searched: bool = False) -> Scale:
    """The scale of recordings whose extent is taken together."""
    first = recordings[0]
    sign = _sign(first, settings)
    is_open = settings.shape == "open"
    if is_open and searched:
        return Scale(settings.centre or (0.0, 0.0), settings.units_per_arena_unit or 1.0, sign)
    points = np.concatenate([one.bodies[np.isfinite(one.bodies).all(axis=2)] for one in recordings])
    require(
        len(points),
        f"{first.recording}: no individual was ever tracked: check the file, "
        "or see to --min-confidence",
    )
    x, y = (points.min(axis=0) + points.max(axis=0)) / 2
    centre = settings.centre or (float(x), float(y))
    if is_open and settings.units_per_arena_unit is not None:
        half = settings.units_per_arena_unit
    elif settings.width is not None:
        half = settings.width / 2
    elif settings.shape == "disc":
        half = float(np.linalg.norm(points - np.array(centre), axis=1).max())
    else:
        half = float(np.abs(points - np.array(centre)).max())
    require(
        half > 0, f"{first.recording}: its tracks have no extent: give the arena's width instead"
    )
    return Scale(centre, half, sign)


def _sign(tracks: Tracks, settings: Scaling) -> float:
    flip = tracks.y_down if settings.flip_y is None else settings.flip_y
    return -1.0 if flip else 1.0
