"""Scaling of tracks to the arena frame: invertible, and stored with the demonstrations.

All recordings of an import share one scale, since with scales of their own their speeds would not
compare.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from animarl_envs.arena import Arena
from animarl_envs.checks import option
from animarl_envs.errors import InputError
from animarl_envs.importing.tracks import Tracks


@dataclass(frozen=True, kw_only=True)
class Scaling:
    """How positions become arena units.

    Parameters
    ----------
    shape
        ``"square"`` and ``"disc"``: half side or radius 1; ``"open"``: only the unit changes.
    width
        Full side or diameter of the arena in the tracks' unit; ``None`` takes the extent of the
        tracks.
    centre
        Of the arena, in the tracks' unit; ``None``: the middle of the extent, and the origin where
        a source is searched there.
    each
        Whether extents are those of each recording, so that every one gets a centre and a scale of
        its own; by default all recordings are of one camera and share theirs.
    px_per_cm
        How many of the file's units make 1 cm; the tracks' unit then is the centimetre, also that
        of ``width`` and ``centre``.
    units_per_arena_unit
        For an open field: how many of the tracks' units make one arena unit (1000 for mm to m);
        ``None``: half of the extent, and 1 where a source is searched.
    boundary
        Virtual boundary [arena unit].
    flip_y
        Whether y is turned upwards; ``None``: if it grows downwards in the file.
    """

    shape: Literal["square", "disc", "open"] = option("square", "arena", "square, disc or open.")
    width: float | None = option(
        None, "arena_width", "Side or diameter in the file's unit; default: extent."
    )
    centre: tuple[float, float] | None = option(
        None, "centre", "Of the arena, x,y in the file's unit; default: of extent."
    )
    each: bool = option(False, "scale_each", "Each recording by its own extent, not all by one.")
    px_per_cm: float | None = option(
        None, "px_per_cm", "The file's units to 1 cm; all lengths then are in cm."
    )
    units_per_arena_unit: float | None = option(
        None, "units", "Open arena: the file's units per arena unit; default: extent."
    )
    boundary: float = option(1.1, "boundary", "Beyond it an individual is out, in arena units.")
    flip_y: bool | None = None

    def __post_init__(self) -> None:
        for name in ("width", "px_per_cm", "units_per_arena_unit"):
            value = getattr(self, name)
            if value is not None and not 0 < value < math.inf:
                raise InputError(f"{name} is {value}: it must be a positive number")
        if self.centre is not None:
            if len(self.centre) != 2:
                raise InputError(f"centre is {self.centre}: give x and y")
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
        unit = settings.units_per_arena_unit or 1.0
        return Scale(settings.centre or (0.0, 0.0), unit, sign)
    points = np.concatenate(
        [tracks.bodies[np.isfinite(tracks.bodies).all(axis=2)] for tracks in recordings]
    )
    if len(points) == 0:
        raise InputError(
            f"{first.recording}: no individual was ever tracked: check the file, "
            "or see to --min-confidence"
        )
    low, high = points.min(axis=0), points.max(axis=0)
    middle = (low + high) / 2
    centre = settings.centre or (float(middle[0]), float(middle[1]))
    if is_open and settings.units_per_arena_unit is not None:
        half = settings.units_per_arena_unit
    elif settings.width is not None:
        half = settings.width / 2
    elif settings.shape == "disc":
        half = float(np.linalg.norm(points - np.array(centre), axis=1).max())
    else:
        half = float(np.abs(points - np.array(centre)).max())
    if not half > 0:
        raise InputError(
            f"{first.recording}: its tracks have no extent: give the arena's width instead"
        )
    return Scale(centre, half, sign)


def to_centimetres(tracks: Tracks, px_per_cm: float | None) -> Tracks:
    """The same recording in cm, where it is known how many of its units make one."""
    if px_per_cm is None:
        return tracks
    return replace(tracks, positions=tracks.positions / px_per_cm, unit="cm")


def _sign(tracks: Tracks, settings: Scaling) -> float:
    flip = tracks.y_down if settings.flip_y is None else settings.flip_y
    return -1.0 if flip else 1.0
