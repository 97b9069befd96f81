"""Trackers of whole bodies: EthoVision, TRex and idtracker.ai."""

import contextlib
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from animarl_envs.errors import InputError, require
from animarl_envs.files import npz_members, read_npz
from animarl_envs.importing import tables
from animarl_envs.importing.clock import fit_clock, rate_of_rows
from animarl_envs.importing.hdf import hdf_keys, open_hdf, read_dataset
from animarl_envs.importing.readers.registry import numbers, register_track_reader
from animarl_envs.importing.readers.table_files import read_long_table
from animarl_envs.importing.table_columns import Named, parsed_names
from animarl_envs.importing.table_geometry import are_corners
from animarl_envs.importing.tracks import BODY_LENGTH, RATE_FROM, Tracks

ETHOVISION = "Number of header lines:"  # the first cell
ETHOVISION_CLOCKS = ("Trial time", "Recording time")
IDTRACKER_TIDY = ("frame", "time", "individual", "x", "y", "probability")
_TREX_NAME = re.compile(r"^(?P<recording>.+)_(?P<individual>(?:fish|id|agent)\d+)$")
_TREX_X = ("X#wcentroid", "X#pcentroid", "X")


def _is_ethovision(path: Path) -> bool:
    if path.suffix.lower() in tables.PARQUET:
        return False
    with contextlib.suppress(InputError, ImportError):
        sheets = tables.sheet_names(path) if tables.is_workbook(path) else [None]
        return any(
            table is not None and table.before[:1] and table.before[0][0] == ETHOVISION
            for table in (tables.table_or_none(path, sheet) for sheet in sheets)
        )
    return False


@register_track_reader(
    "ethovision",
    "EthoVision exports (text, Excel): a subject per file or sheet, merged by trial and arena",
    sniff=_is_ethovision,
    extensions=tables.EXTENSIONS,
)
def read_ethovision(
    path: Path, encoding: str | None = None, progress: tables.Progress = None
) -> list[Tracks]:
    """Read all subjects of the file; unit and frame rate are in it. In EthoVision y grows upwards.

    Points (``X center``, ``X nose``, ``X tail``) become keypoints; what was not found is ``-``.
    Sheets without points, such as those of manual scoring, are left out and named as not used.
    """
    sheets = tables.sheet_names(path) if tables.is_workbook(path) else [None]
    opened = {sheet: tables.open_table(path, encoding, sheet) for sheet in sheets}
    tracked = [one for one in opened.values() if _ethovision_points(one)] or [*opened.values()][:1]
    unused = [f"sheet {sheet}" for sheet, one in opened.items() if one not in tracked]
    return [_ethovision(table, unused, progress) for table in tracked]


def _ethovision_points(table: tables.Table) -> dict[str, tuple[str, str]]:
    """Return the columns of x and y by the name of the point that they are of."""
    return {name[2:]: (name, "Y" + name[1:]) for name in table.names if re.match(r"X .", name)}


def _ethovision(table: tables.Table, unused: list[str], progress: tables.Progress) -> Tracks:
    path, names, points = table.path, table.names, _ethovision_points(table)
    header = {row[0].rstrip(":").lower(): row[1] for row in table.before if len(row) > 1}
    clock = next((name for name in ETHOVISION_CLOCKS if name in names), None)
    lacking = [y for _, y in points.values() if y not in names]
    if clock is None or not points or lacking:
        what = "a time" if clock is None else (lacking or ["X center"])[0]
        raise InputError(f"{path}: it lacks the column {what!r}: export it with time, X and Y")
    wanted = [name for pair in points.values() for name in pair]
    units = {table.units[names.index(name)] for name in wanted}
    if len(units) != 1:
        raise InputError(f"{path}: its points have several units: export them in one")
    number, _ = table.columns([clock, *wanted], progress=progress)
    values = np.column_stack([number[name] for name in wanted])
    return Tracks(
        recording=header.get("trial name") or path.stem,
        individuals=(header.get("subject name") or table.sheet or "subject",),
        keypoints=tuple(points),
        positions=values.reshape(len(values), 1, -1, 2),
        frame_rate=rate_of_rows(path, number[clock], table.place),
        start_time=float(number[clock][0]),
        unit=units.pop() or "px",
        provenance={
            "file": path.name,
            "tracker": "EthoVision",
            "read_as": table.description,
            RATE_FROM: f"the column {clock}",
            "arena": header.get("arena name", ""),
            **({"columns_not_used": unused} if unused else {}),
        },
    )


def _trex_columns(path: Path) -> dict[str, Named]:
    """Return the columns of a table by their names without units."""
    return {one.bare: one for one in parsed_names(tables.plain_table(path).names)}


def _trex_x(names: set[str]) -> str | None:
    return next((name for name in _TREX_X if name in names), None)


def _is_trex(path: Path) -> bool:
    if path.suffix.lower() == ".csv":
        names = set(_trex_columns(path))
        return {"frame", "missing"} <= names and _trex_x(names) is not None
    names = {name.removesuffix(".npy") for name in npz_members(path)}
    return {"frame"} < names and _trex_x(names) is not None


@register_track_reader(
    "trex",
    "TRex exports, one NAME_fish0.npz or .csv per individual (give all files of a recording)",
    sniff=_is_trex,
    extensions=(".npz", ".csv"),
)
def read_trex(path: Path, fps: float | None = None, unit: str | None = None) -> list[Tracks]:
    """Read one individual; files of one recording are merged by name. Missing frames are gaps."""
    if path.suffix.lower() == ".csv":
        columns = _trex_columns(path)
        x_name = _trex_x(set(columns)) or "X"
        names = ["frame", x_name, "Y" + x_name[1:], "missing", "time"]
        known = [name for name in names if name in columns]
        table = tables.open_table(path)
        number, _ = table.columns([columns[name].column for name in known])
        arrays = {name: number[columns[name].column] for name in known}
        unit = unit or columns[x_name].unit
    else:
        arrays = read_npz(path)
        x_name = _trex_x(set(arrays)) or "X"
    names = ["frame", x_name, "Y" + x_name[1:]]
    for name in names:
        require(name in arrays, f"{path}: it lacks the array {name!r}: export it from TRex")
    count = arrays["frame"].size
    frame, x, y = (numbers(path, name, arrays[name].ravel(), count) for name in names)
    whole = (frame >= 0) & (frame == np.floor(frame)) & (frame < 64 * len(frame) + 1e6)
    once = count > 0 and whole.all() and len(np.unique(frame)) == count
    require(once, f"{path}: frame numbers are not whole, or repeat: export the file again")
    index = frame.astype(np.int64)
    start = int(index.min())
    index = index - start
    positions = np.full((int(index.max()) + 1, 1, 1, 2), np.nan)
    positions[index, 0, 0] = np.column_stack([x, y])
    if "missing" in arrays and arrays["missing"].shape == frame.shape:
        positions[index[arrays["missing"] > 0]] = np.nan
    provenance: dict[str, Any] = {"file": path.name, "tracker": "TRex"}
    rate = fps if fps is not None else _number(arrays.get("frame_rate"))
    if rate is None and path.suffix.lower() == ".csv" and "time" in arrays:
        group = np.zeros(count, dtype=np.int64)
        rate = fit_clock(path, arrays["time"], group, table.place, index).rate
        provenance[RATE_FROM] = "the column time (s)"
    if fps is None and "frame_rate" in arrays:
        provenance[RATE_FROM] = "the array frame_rate"
    if {"midline_length", "cm_per_pixel"} <= arrays.keys() and unit in (None, "cm"):
        pixels = numbers(path, "midline_length", arrays["midline_length"].ravel(), count)
        if len(seen := pixels[np.isfinite(pixels)]):
            provenance[BODY_LENGTH] = float(np.median(seen)) * (
                _number(arrays["cm_per_pixel"]) or 1.0
            )
    match = _TREX_NAME.match(path.stem)
    return [
        Tracks(
            recording=match["recording"] if match else path.stem,
            individuals=(match["individual"] if match else path.stem,),
            positions=positions,
            unit=unit or "cm",
            y_down=True,
            start=start,
            frame_rate=rate,
            provenance=provenance,
        )
    ]


@register_track_reader(
    "idtracker",
    "idtracker.ai trajectories (.h5, .csv)",
    sniff=lambda path: (
        (path.suffix == ".npy" and path.stem in {"trajectories", "with_gaps", "without_gaps"})
        or {"trajectories"} <= hdf_keys(path)
        or (path.suffix == ".csv" and _is_idtracker_csv(path))
    ),
    extensions=(".npy", ".h5", ".csv"),
)
def read_idtracker(path: Path, fps: float | None = None) -> list[Tracks]:
    """Read all individuals, in pixels; the recording is named after the file."""
    suffix = path.suffix.lower()
    if suffix == ".csv":
        table = tables.plain_table(path)
        if table.names == IDTRACKER_TIDY:
            provenance = {"file": path.name, "tracker": "idtracker.ai"}
            recordings = read_long_table(path, fps=fps, y_down=True)
            assert isinstance(recordings, list)
            return [replace(one, provenance=provenance) for one in recordings]
        count = sum(1 for name in table.names if re.fullmatch(r"x\d+", name))
        names = [f"{axis}{i + 1}" for i in range(count) for axis in "xy"]
        clock = [name for name in table.names[:1] if name in ("time", "seconds")]
        number, _ = table.columns([*clock, *names])
        values = np.column_stack([number[name] for name in names])
        positions = values.reshape(len(values), count, 2)
        rate = rate_of_rows(path, number[clock[0]], table.place) if clock else None
    elif suffix == ".npy":
        raise InputError(
            f"{path}: it holds a pickle, which is never opened: import trajectories.h5 or "
            "trajectories.csv of the same folder, or export them from idtracker.ai"
        )
    else:
        with open_hdf(path) as file:
            values = read_dataset(path, file, "trajectories")
            positions = numbers(path, "trajectories", values, "frames", "individuals", 2)
            rate = _number(file.attrs.get("frames_per_second"))
            if rate is None and "frames_per_second" in file:
                rate = _number(read_dataset(path, file, "frames_per_second"))
    return [
        Tracks(
            recording=path.stem,
            individuals=tuple(str(i + 1) for i in range(positions.shape[1])),
            positions=positions[:, :, None],
            frame_rate=fps or rate,
            y_down=True,
            provenance={"file": path.name, "tracker": "idtracker.ai"},
        )
    ]


def _is_idtracker_csv(path: Path) -> bool:
    """Return whether a table is of idtracker.ai: of version 6, of an earlier one, or by its name.

    Under another name ``x1, y1, x2, y2`` may be the corners of a box, as in any wide table.
    """
    table, named = tables.plain_table(path), path.stem.startswith("trajectories")
    names = table.names
    dated = names[:2] in (("time", "x1"), ("seconds", "x1"))
    if dated and not named and names[2:] == ("y1", "x2", "y2"):
        if table.separator != ",":
            return False
        number, _ = table.columns(names[1:])
        return not are_corners(*number.values())
    return dated or names == IDTRACKER_TIDY or (names[:2] == ("x1", "y1") and named)


def _number(value: NDArray[Any] | None) -> float | None:
    with contextlib.suppress(TypeError, ValueError, IndexError):
        return None if value is None else float(np.asarray(value, dtype=np.float64).ravel()[0])
    return None
