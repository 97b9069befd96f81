"""Plain arrays: NumPy (``.npy``, ``.npz``) and MATLAB (``.mat``, version 5 to 7.3)."""

from collections.abc import Sequence
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from animarl_envs.array_types import Floats
from animarl_envs.errors import InputError
from animarl_envs.files import load_npy, npz_members, read_npz
from animarl_envs.importing.hdf import is_hdf, open_hdf, read_dataset
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
    scale: float = 1.0,
    frames: int | None = None,
) -> list[Tracks]:
    """Read one recording, or every array whose name fits a ``key`` with ``*`` as one.

    Numbers are multiplied by ``scale`` to be in ``unit``; of long recordings the first ``frames``
    are read.

    Axes are as NumPy and MATLAB show them (MATLAB 7.3 stores them reversed, which is undone).
    """
    suffix = path.suffix.lower()
    if suffix == ".npz":
        arrays = read_npz(path)
    elif suffix == ".mat":
        arrays = _matlab_arrays(path)
    else:
        arrays = {path.stem: load_npy(path.read_bytes(), path)}
    numbers = {name: array for name, array in arrays.items() if array.dtype.kind in "iuf"}
    plausible = {name: a for name, a in numbers.items() if a.ndim >= 2 and 2 in a.shape}
    several = "*" if key is None and len(plausible) == 1 else key or ""
    chosen = {name: a for name, a in plausible.items() if fnmatchcase(name, several)}
    if key in arrays:
        chosen = {key: arrays[key]}
    if not chosen:
        raise InputError(f"{path}: {_what_it_holds(arrays, list(numbers))}")
    recordings = []
    for name, array in chosen.items():
        positions = scale * _ordered(path, name, array, axes)[:frames]
        individuals = _names(path, "individual", names, positions.shape[1])
        parts = _names(path, "keypoint", keypoints, positions.shape[2])
        if keypoints is None and positions.shape[2] == 1:
            parts = (CENTROID,)
        recordings.append(
            Tracks(
                recording=path.stem if len(chosen) == 1 else name,
                individuals=individuals,
                keypoints=parts,
                positions=positions,
                frame_rate=fps,
                unit=unit,
                y_down=y_down,
                provenance={"file": path.name},
            )
        )
    return recordings


def _what_it_holds(arrays: dict[str, NDArray[Any]], numbers: list[str]) -> str:
    """Say which arrays and structs a file holds, and how to name or export the positions."""
    structs = [
        f"the struct {name} ({', '.join(array.dtype.names)})"
        for name, array in arrays.items()
        if array.dtype.names
    ]
    if structs:
        return (
            f"it holds {' and '.join(structs)}, whose layout is not known: in MATLAB put the "
            "positions into one array, frames x individuals x 2, and save it by "
            "save('tracks.mat', 'positions')"
        )
    return (
        f"it holds {', '.join(numbers) or 'no array of numbers'}: name the one with the positions "
        "by --option key=NAME, or '*' for all"
    )


def _matlab_arrays(path: Path) -> dict[str, NDArray[Any]]:
    """Return the variables of a file by name; structs have the names of their fields."""
    if not is_hdf(path):
        return matlab_variables(path)
    with open_hdf(path) as file:
        names = [name for name in file if not name.startswith("#")]
        return {
            name: read_dataset(path, file, name).T
            if hasattr(file[name], "shape")
            else np.zeros(0, [(field, "O") for field in file[name]])
            for name in names
        }


def matlab_variables(path: Path) -> dict[str, NDArray[Any]]:
    """Return the variables of a ``.mat`` before version 7.3; cells and fields are objects."""
    from scipy.io import loadmat

    return {name: value for name, value in loadmat(path).items() if hasattr(value, "dtype")}


def _ordered(path: Path, name: str, array: NDArray[Any], axes: Sequence[str] | None) -> Floats:
    """Return an array with the axes frame, individual, keypoint and xy."""
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
        table = "if each row is a position, save it as CSV with the columns frame, animal, x, y"
        raise InputError(
            f"{path}: {name} has {array.shape[given.index('xy')]} entries along xy (shape "
            f"{array.shape}): "
            + (table if array.ndim == 2 else "give the option axes in the order of the array")
        )
    longest = max(array.shape[given.index(axis)] for axis in given)
    if axes is None and 0 < array.shape[given.index("frame")] < longest:
        swapped = [given[1], given[0], *given[2:]]
        raise InputError(
            f"{path}: {name} has shape {array.shape}, which would be {array.shape[0]} frames of "
            f"{array.shape[1]} {given[1]}s: if frames are its second axis, give --option "
            f"'axes=[{', '.join(swapped)}]', else 'axes=[{', '.join(given)}]'"
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
