"""TRex and idtracker.ai."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from animarl_envs.errors import InputError
from animarl_envs.files import npz_members, read_npz
from animarl_envs.importing.readers.clocks import even_rate
from animarl_envs.importing.readers.hdf import hdf_keys, open_hdf, read_dataset
from animarl_envs.importing.readers.registry import register_track_reader
from animarl_envs.importing.readers.tables import plain_table
from animarl_envs.importing.tracks import Tracks

_TREX_NAME = re.compile(r"^(?P<recording>.+)_(?P<individual>(?:fish|id|agent)\d+)$")
_TREX_X = ("X#wcentroid", "X#pcentroid", "X")


@register_track_reader(
    "trex",
    "TRex exports, one NAME_fish0.npz per individual (give all files of a recording)",
    sniff=lambda path: {"frame.npy"} < npz_members(path) and _trex_x(npz_members(path)) is not None,
    extensions=(".npz",),
)
def read_trex(path: Path, fps: float | None = None, unit: str = "cm") -> list[Tracks]:
    """One individual; files of one recording are merged by their name. Missing frames are gaps."""
    arrays = read_npz(path)
    x_name = _trex_x({f"{name}.npy" for name in arrays})
    if x_name is None or "frame" not in arrays:
        raise InputError(f"{path}: it lacks X, Y or frame: export them from TRex")
    y_name = "Y" + x_name[1:]
    if y_name not in arrays:
        raise InputError(f"{path}: it lacks the array {y_name!r}: export it from TRex")
    frame = np.asarray(arrays["frame"], dtype=np.float64).ravel()
    x = np.asarray(arrays[x_name], dtype=np.float64).ravel()
    y = np.asarray(arrays[y_name], dtype=np.float64).ravel()
    if not len(frame) == len(x) == len(y) or len(frame) == 0:
        raise InputError(
            f"{path}: frame, {x_name} and {y_name} have {len(frame)}, {len(x)} and {len(y)} "
            "entries: export them again"
        )
    whole = (frame >= 0) & (frame == np.floor(frame)) & (frame < 64 * len(frame) + 1e6)
    if not whole.all() or len(np.unique(frame)) != len(frame):
        raise InputError(f"{path}: frame numbers are not whole, or repeat: export the file again")
    positions = np.full((int(frame.max()) + 1, 1, 1, 2), np.nan)
    index = frame.astype(np.int64)
    positions[index, 0, 0, 0], positions[index, 0, 0, 1] = x, y
    if "missing" in arrays and arrays["missing"].shape == frame.shape:
        positions[index[arrays["missing"].astype(bool)]] = np.nan
    if fps is None and "frame_rate" in arrays:
        fps = float(np.asarray(arrays["frame_rate"]).ravel()[0])
    match = _TREX_NAME.match(path.stem)
    return [
        Tracks(
            recording=match["recording"] if match else path.stem,
            individuals=(match["individual"] if match else path.stem,),
            positions=positions, frame_rate=fps, unit=unit, y_down=True,
            provenance={"file": path.name, "tracker": "TRex"},
        )
    ]  # fmt: skip


def _trex_x(members: set[str]) -> str | None:
    return next((name for name in _TREX_X if f"{name}.npy" in members), None)


@register_track_reader(
    "idtracker",
    "idtracker.ai trajectories (.h5, .csv)",
    sniff=lambda path: (
        (path.suffix == ".npy" and path.stem in {"trajectories", "with_gaps", "without_gaps"})
        or {"trajectories"} <= hdf_keys(path)
        or (path.suffix == ".csv" and plain_table(path).names[:2] == ("time", "x1"))
    ),
    extensions=(".npy", ".h5", ".csv"),
)
def read_idtracker(path: Path, fps: float | None = None) -> list[Tracks]:
    """All individuals, in pixels; the frame rate is in the file. Recording: the folder's name."""
    suffix = path.suffix.lower()
    if suffix == ".csv":
        positions, rate = _idtracker_csv(path)
    elif suffix == ".npy":
        raise InputError(
            f"{path}: it holds a pickle, which is never opened: import trajectories.h5 or "
            "trajectories.csv of the same folder, or export them from idtracker.ai"
        )
    else:
        with open_hdf(path) as file:
            positions = np.asarray(read_dataset(path, file, "trajectories"), dtype=np.float64)
            rate = _number(file.attrs.get("frames_per_second"))
            if rate is None and "frames_per_second" in file:
                rate = _number(read_dataset(path, file, "frames_per_second"))
    if positions.ndim != 3 or positions.shape[2] != 2:
        raise InputError(
            f"{path}: trajectories have shape {positions.shape}, not (frames, individuals, 2): "
            "check --source"
        )
    return [
        Tracks(
            recording=path.stem,
            individuals=tuple(str(i + 1) for i in range(positions.shape[1])),
            positions=positions[:, :, None], frame_rate=fps or rate, y_down=True,
            provenance={"file": path.name, "tracker": "idtracker.ai"},
        )
    ]  # fmt: skip


def _idtracker_csv(path: Path) -> tuple[NDArray[np.float64], float | None]:
    table = plain_table(path)
    count = sum(1 for name in table.names if re.fullmatch(r"x\d+", name))
    columns = [f"{axis}{i + 1}" for i in range(count) for axis in "xy"]
    number, _ = table.columns(["time", *columns])
    values = np.column_stack([number[name] for name in columns])
    rate = even_rate(path, number["time"], table.place)
    return values.reshape(len(values), count, 2), rate


def _number(value: Any) -> float | None:
    if value is None:
        return None
    try:
        return float(np.asarray(value, dtype=np.float64).ravel()[0])
    except (TypeError, ValueError, IndexError):
        return None
