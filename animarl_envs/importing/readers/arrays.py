"""Plain arrays: NumPy (``.npy``, ``.npz``) and MATLAB (``.mat``, version 5 to 7.3)."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from animarl_envs.errors import InputError
from animarl_envs.files import load_npy, npz_members, read_npz
from animarl_envs.importing.readers.hdf import is_hdf, open_hdf, read_dataset
from animarl_envs.importing.readers.registry import register_track_reader
from animarl_envs.importing.tracks import CENTROID, Tracks

AXES = ("frame", "individual", "keypoint", "xy")
DEFAULT_AXES = {2: ("frame", "xy"), 3: ("frame", "individual", "xy"), 4: AXES}


@register_track_reader(
    "matlab",
    "MATLAB arrays (.mat, all versions); option axes as for numpy",
    sniff=lambda path: path.suffix.lower() == ".mat",
    extensions=(".mat",),
    generic=True,
)
@register_track_reader(
    "numpy",
    "NumPy arrays (.npy, .npz); option axes, such as [frame, individual, xy]",
    sniff=lambda path: path.suffix.lower() == ".npy" or len(npz_members(path)) == 1,
    extensions=(".npy", ".npz"),
    generic=True,
)
def read_arrays(
    path: Path,
    key: str | None = None,
    axes: Sequence[str] | None = None,
    names: Sequence[str] | None = None,
    keypoints: Sequence[str] | None = None,
    fps: float | None = None,
    unit: str = "px",
    y_down: bool = False,
) -> list[Tracks]:
    """One recording, or every array of a file as one where ``key`` is ``"*"``.

    Axes are as NumPy and MATLAB show them (MATLAB 7.3 stores them reversed, which is undone).
    """
    suffix = path.suffix.lower()
    if suffix == ".npz":
        arrays = read_npz(path)
    elif suffix == ".mat":
        arrays = _matlab_arrays(path)
    else:
        arrays = {path.stem: load_npy(path.read_bytes(), path)}
    numeric = {name: a for name, a in arrays.items() if a.dtype.kind in "iuf" and a.ndim >= 2}
    chosen = {} if key == "*" or key not in arrays else {key: arrays[key]}
    if key == "*" or (key is None and len(numeric) == 1):
        chosen = numeric
    if not chosen:
        known = [name for name, value in arrays.items() if value.dtype.kind in "iuf"]
        raise InputError(
            f"{path}: it holds {', '.join(known) or 'no array of numbers'}: name the one with the "
            "positions by the option key, or * for all"
        )
    found = []
    for name, array in chosen.items():
        positions = _ordered(path, name, array, axes)
        individuals = _names(path, "individual", names, positions.shape[1])
        parts = _names(path, "keypoint", keypoints, positions.shape[2])
        if keypoints is None and positions.shape[2] == 1:
            parts = (CENTROID,)
        found.append(
            Tracks(
                recording=path.stem if len(chosen) == 1 else name, individuals=individuals,
                keypoints=parts, positions=positions, frame_rate=fps, unit=unit, y_down=y_down,
                provenance={"file": path.name},
            )
        )  # fmt: skip
    return found


def _matlab_arrays(path: Path) -> dict[str, NDArray[Any]]:
    if is_hdf(path):
        with open_hdf(path) as file:
            names = [n for n in file if not n.startswith("#") and hasattr(file[n], "shape")]
            return {name: read_dataset(path, file, name).T for name in names}
    from scipy.io import loadmat

    try:
        found = loadmat(path)
    except (InputError, MemoryError):
        raise
    except Exception as error:  # what SciPy raises over damage is of no one kind
        first = (str(error).splitlines() or [type(error).__name__])[0][:160]
        raise InputError(f"{path}: the MATLAB file is damaged ({first}): copy it again") from None
    return {name: value for name, value in found.items() if hasattr(value, "dtype")}


def _ordered(
    path: Path, name: str, array: NDArray[Any], axes: Sequence[str] | None
) -> NDArray[np.float64]:
    """Axes (frame, individual, keypoint, xy)."""
    if array.dtype.kind not in "iuf":
        raise InputError(f"{path}: {name} is {array.dtype}, not numbers: choose another key")
    given = tuple(axes) if axes is not None else DEFAULT_AXES.get(array.ndim, ())
    fits = len(given) == array.ndim and len(set(given)) == len(given)
    if not fits or not {"frame", "xy"} <= set(given) <= set(AXES):
        raise InputError(
            f"{path}: {name} has shape {array.shape}, which the axes {', '.join(given) or '?'} do "
            f"not fit: give the option axes, an order of {', '.join(AXES)}"
        )
    if array.shape[given.index("xy")] != 2:
        raise InputError(
            f"{path}: {name} has {array.shape[given.index('xy')]} entries along xy (shape "
            f"{array.shape}): give the option axes in the order of the array"
        )
    present = [axis for axis in AXES if axis in given]
    positions = np.asarray(array, dtype=np.float64).transpose([given.index(a) for a in present])
    return np.expand_dims(positions, tuple(i for i, axis in enumerate(AXES) if axis not in given))


def _names(path: Path, what: str, names: Sequence[str] | None, count: int) -> tuple[str, ...]:
    if names is None:
        return tuple(f"{what}_{i}" for i in range(count))
    if len(names) != count:
        raise InputError(f"{path}: {len(names)} names for {count} {what}s: give one for each")
    return tuple(names)
