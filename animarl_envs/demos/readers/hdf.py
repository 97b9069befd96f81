"""HDF5 files: opened, looked at, and read within the memory that their size allows."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from animarl_envs.demos.readers.guards import check_size
from animarl_envs.errors import InputError, MissingExtraError

MAGIC = b"\x89HDF\r\n\x1a\n"
MATLAB_OFFSET = 512  # MATLAB writes a header of its own before the HDF5 one


def is_hdf(path: Path) -> bool:
    """Whether the file starts like HDF5 (or MATLAB 7.3)."""
    try:
        with path.open("rb") as file:
            start = file.read(MATLAB_OFFSET + len(MAGIC))
    except OSError:
        return False
    return start.startswith(MAGIC) or start[MATLAB_OFFSET:] == MAGIC


def open_hdf(path: Path) -> Any:
    """An open ``h5py.File``, or one sentence that says why not."""
    try:
        import h5py
    except ImportError as error:
        raise MissingExtraError("reading HDF5", "data") from error
    if not is_hdf(path):
        raise InputError(f"{path}: it is no HDF5 file: check --source, or copy the file again")
    try:
        return h5py.File(path, "r")
    except (OSError, RuntimeError, ValueError) as error:
        first = str(error).splitlines()[0][:160]
        raise InputError(f"{path}: the HDF5 file is damaged ({first}): copy it again") from None


def hdf_keys(path: Path) -> set[str]:
    """Names at the top of an HDF5 file; empty if it is none."""
    if not is_hdf(path):
        return set()
    try:
        with open_hdf(path) as file:
            return set(file.keys())
    except (InputError, MissingExtraError, OSError, RuntimeError, KeyError, ValueError):
        return set()


def read_dataset(path: Path, file: Any, key: str) -> NDArray[Any]:
    """One dataset, refused before allocation if it is absurdly large."""
    if key not in file:
        raise InputError(f"{path}: it has no dataset {key!r}: check --source")
    dataset = file[key]
    if not hasattr(dataset, "shape"):
        raise InputError(f"{path}: {key!r} is a group, not an array: name an array")
    size = int(np.prod([int(n) for n in dataset.shape], dtype=object)) * dataset.dtype.itemsize
    check_size(path, size, f"dataset {key!r}")
    return np.asarray(dataset[()])
