"""Trackers of whole bodies: EthoVision, TRex and idtracker.ai."""

from __future__ import annotations

import contextlib
import re
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from animarl_envs.errors import InputError, require
from animarl_envs.files import npz_members, read_npz
from animarl_envs.importing import tables
from animarl_envs.importing.readers.arrays import hdf_keys, open_hdf, read_dataset
from animarl_envs.importing.readers.columns import rate_of_rows
from animarl_envs.importing.readers.registry import numbers, register_track_reader
from animarl_envs.importing.tracks import Tracks

ETHOVISION = "Number of header lines:"  # the first cell
ETHOVISION_CLOCKS = ("Trial time", "Recording time")
_TREX_NAME = re.compile(r"^(?P<recording>.+)_(?P<individual>(?:fish|id|agent)\d+)$")
_TREX_X = ("X#wcentroid", "X#pcentroid", "X")


def _is_ethovision(path: Path) -> bool:
    if path.suffix.lower() in tables.PARQUET:
        return False
    with contextlib.suppress(InputError, ImportError, IndexError):
        table = tables.table_or_none(
            path, tables.sheet_names(path)[0] if tables.is_workbook(path) else None
        )
        return table is not None and table.before[0][0] == ETHOVISION
    return False


@register_track_reader(
    "ethovision",
    "EthoVision exports (text, Excel): a subject per file or sheet, merged by the trial's name",
    sniff=_is_ethovision,
    extensions=tables.EXTENSIONS,
)
def read_ethovision(
    path: Path, encoding: str | None = None, progress: tables.Progress = None
) -> list[Tracks]:
    """All subjects of the file; unit and frame rate are in it. In EthoVision y grows upwards.

    Points (``X center``, ``X nose``, ``X tail``) become keypoints; what was not found is ``-``.
    """
    sheets = tables.sheet_names(path) if tables.is_workbook(path) else [None]
    return [_ethovision(tables.open_table(path, encoding, sheet), progress) for sheet in sheets]


def _ethovision(table: tables.Table, progress: tables.Progress) -> Tracks:
    path, names = table.path, table.names
    said = {row[0].rstrip(":").lower(): row[1] for row in table.before if len(row) > 1}
    points = {name[2:]: (name, "Y" + name[1:]) for name in names if re.match(r"X .", name)}
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
        recording=said.get("trial name") or path.stem,
        individuals=(said.get("subject name") or table.sheet or "subject",),
        keypoints=tuple(points),
        positions=values.reshape(len(values), 1, -1, 2),
        frame_rate=rate_of_rows(path, number[clock], table.place),
        start=float(number[clock][0]),
        unit=units.pop() or "px",
        provenance={"file": path.name, "tracker": "EthoVision", "read_as": table.description},
    )


def _trex_x(members: set[str]) -> str | None:
    return next((name for name in _TREX_X if f"{name}.npy" in members), None)


@register_track_reader(
    "trex",
    "TRex exports, one NAME_fish0.npz per individual (give all files of a recording)",
    sniff=lambda path: {"frame.npy"} < npz_members(path) and _trex_x(npz_members(path)) is not None,
    extensions=(".npz",),
)
def read_trex(path: Path, fps: float | None = None, unit: str = "cm") -> list[Tracks]:
    """One individual; files of one recording are merged by their name. Missing frames are gaps."""
    arrays = read_npz(path)
    x_name = _trex_x({f"{name}.npy" for name in arrays}) or "X"
    names = ("frame", x_name, "Y" + x_name[1:])
    for name in names:
        require(name in arrays, f"{path}: it lacks the array {name!r}: export it from TRex")
    count = arrays["frame"].size
    frame, x, y = (numbers(path, name, arrays[name].ravel(), count) for name in names)
    whole = (frame >= 0) & (frame == np.floor(frame)) & (frame < 64 * len(frame) + 1e6)
    once = count > 0 and whole.all() and len(np.unique(frame)) == count
    require(once, f"{path}: frame numbers are not whole, or repeat: export the file again")
    positions = np.full((int(frame.max()) + 1, 1, 1, 2), np.nan)
    index = frame.astype(np.int64)
    positions[index, 0, 0] = np.column_stack([x, y])
    if "missing" in arrays and arrays["missing"].shape == frame.shape:
        positions[index[arrays["missing"].astype(bool)]] = np.nan
    match = _TREX_NAME.match(path.stem)
    return [
        Tracks(
            recording=match["recording"] if match else path.stem,
            individuals=(match["individual"] if match else path.stem,),
            positions=positions, unit=unit, y_down=True,
            frame_rate=fps if fps is not None else _number(arrays.get("frame_rate")),
            provenance={"file": path.name, "tracker": "TRex"},
        )
    ]  # fmt: skip


@register_track_reader(
    "idtracker",
    "idtracker.ai trajectories (.h5, .csv)",
    sniff=lambda path: (
        (path.suffix == ".npy" and path.stem in {"trajectories", "with_gaps", "without_gaps"})
        or {"trajectories"} <= hdf_keys(path)
        or (path.suffix == ".csv" and tables.plain_table(path).names[:2] == ("time", "x1"))
    ),
    extensions=(".npy", ".h5", ".csv"),
)
def read_idtracker(path: Path, fps: float | None = None) -> list[Tracks]:
    """All individuals, in pixels; the frame rate is in the file. Recording: the folder's name."""
    suffix = path.suffix.lower()
    if suffix == ".csv":
        table = tables.plain_table(path)
        count = sum(1 for name in table.names if re.fullmatch(r"x\d+", name))
        names = [f"{axis}{i + 1}" for i in range(count) for axis in "xy"]
        number, _ = table.columns(["time", *names])
        values = np.column_stack([number[name] for name in names])
        positions = values.reshape(len(values), count, 2)
        rate: float | None = rate_of_rows(path, number["time"], table.place)
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
            positions=positions[:, :, None], frame_rate=fps or rate, y_down=True,
            provenance={"file": path.name, "tracker": "idtracker.ai"},
        )
    ]  # fmt: skip


def _number(value: NDArray[Any] | None) -> float | None:
    with contextlib.suppress(TypeError, ValueError, IndexError):
        return None if value is None else float(np.asarray(value, dtype=np.float64).ravel()[0])
    return None
