"""Where the positions of a table's rows are: degrees, corners of boxes, arenas side by side."""

import itertools
from dataclasses import replace
from pathlib import Path

import numpy as np

from animarl_envs.array_types import Floats
from animarl_envs.errors import require
from animarl_envs.importing.table_columns import Columns, Position, corners_of
from animarl_envs.importing.tables import Table
from animarl_envs.importing.tracks import Tracks

EARTH = 6_371_008.8  # [m], its mean radius
ORDERED = 0.99  # share of rows in which corners of a box are left of and above the others
STEADY = 0.5  # spread of the size of a box, of that of its centre; of two animals it is more


def project_degrees(path: Path, number: dict[str, Floats], columns: Columns) -> str:
    """Turn longitudes and latitudes [degrees] into metres on a plane around their middle.

    A local equirectangular projection; returns what an import says of it.
    """
    (east, north), *_ = (position.columns for position in columns.positions)
    longitude, latitude = number[east], number[north]
    seen = np.isfinite(longitude) & np.isfinite(latitude)
    fits = (
        seen.any() and np.abs(latitude[seen]).max() <= 90 and np.abs(longitude[seen]).max() <= 360
    )
    require(
        fits,
        f"{path}: columns {east!r} and {north!r} are longitudes and latitudes by their names, but "
        "hold other numbers than degrees: name the unit by --option unit=m",
    )
    first = longitude[seen][0]
    longitude = first + (longitude - first + 180.0) % 360.0 - 180.0  # across the date line
    middle = np.median(longitude[seen]), np.median(latitude[seen])
    per_degree = EARTH * np.pi / 180.0
    number[east] = per_degree * np.cos(np.radians(middle[1])) * (longitude - middle[0])
    number[north] = per_degree * (latitude - middle[1])
    return (
        f"{east} and {north} are degrees: projected to metres on a plane around longitude "
        f"{middle[0]:.5f}, latitude {middle[1]:.5f}"
    )


def with_boxes(table: Table, columns: Columns, number: dict[str, Floats]) -> Columns:
    """Return the columns with x1, y1, x2, y2 as a box, unless they are two animals."""
    corners = corners_of(table.names) or ()
    pairs = itertools.chain(*(one.columns for one in columns.positions))
    is_box = corners == tuple(pairs) and are_corners(*(number[name] for name in corners))
    return replace(columns, positions=(Position(corners),)) if is_box else columns


def are_corners(x1: Floats, y1: Floats, x2: Floats, y2: Floats) -> bool:
    """Return whether two points of each row are corners of a box, not two animals."""
    low, high = np.stack([x1, y1]), np.stack([x2, y2])
    seen = np.isfinite(low + high).all(axis=0)
    seen &= (low != high).any(axis=0)  # the corners of a lost animal are one mark, such as 0
    low, high = low[:, seen], high[:, seen]
    if not seen.any() or (high > low).all(axis=0).mean() < ORDERED:
        return False
    size, centre = high - low, (low + high) / 2
    return bool((size.std(axis=1) < STEADY * centre.std(axis=1)).all())


def centre_arenas(tracks: list[Tracks]) -> list[Tracks]:
    """Return the arenas of a table, each moved to its own middle if they are side by side."""
    places = [one.positions.reshape(-1, 2) for one in tracks]
    low, high = (np.array([end(own, axis=0) for own in places]) for end in (np.nanmin, np.nanmax))
    apart = (low[:, None] > high).any(axis=2)
    if not (apart | apart.T | np.eye(len(tracks), dtype=bool)).all():
        return tracks
    middles = (low + high) / 2
    return [replace(one, positions=one.positions - m) for one, m in zip(tracks, middles)]
