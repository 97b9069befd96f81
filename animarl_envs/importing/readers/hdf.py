"""HDF5 files: opened, looked at, and read within the memory that their size allows."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from animarl_envs.errors import InputError, MissingExtraError
from animarl_envs.importing.readers.hdf_contents import check_contents
from animarl_envs.importing.readers.hdf_texts import check_heaps, check_texts

MAGIC = b"\x89HDF\r\n\x1a\n"
HEAD = 96  # the longest header of a file [bytes]
END_AT = {0: 40, 1: 44, 2: 28, 3: 28}  # where it says the file's length, by its version
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
    """An open ``h5py.File`` all of whose content was looked at, or one sentence that says why not.

    Raises
    ------
    InputError
        If it is none, is damaged, or is refused by
        :func:`~animarl_envs.importing.readers.hdf_contents.check_contents`.
    """
    file = _opened(path)
    try:
        check_contents(path, file)
    except InputError:
        file.close()
        raise
    except Exception as error:  # what h5py raises over damage is of no one kind
        file.close()
        raise _damaged(path, error) from None
    return file


def _opened(path: Path) -> Any:
    try:
        import h5py
    except ImportError as error:
        raise MissingExtraError("reading HDF5", "data") from error
    if not is_hdf(path):
        raise InputError(f"{path}: it is no HDF5 file: check --source, or copy the file again")
    _check_end(path)
    check_heaps(path)
    try:
        return h5py.File(path, "r")
    except (OSError, RuntimeError, ValueError) as error:
        raise _damaged(path, error) from None


def _damaged(path: Path, error: Exception) -> InputError:
    first = (str(error).splitlines() or [type(error).__name__])[0][:160]
    return InputError(f"{path}: the HDF5 file is damaged ({first}): copy it again")


def _check_end(path: Path) -> None:
    """Refuse a file that goes on beyond the end its header names (a shorter one fails to open)."""
    with path.open("rb") as file:
        head = file.read(MATLAB_OFFSET + HEAD)
    start = 0 if head.startswith(MAGIC) else MATLAB_OFFSET
    version, widths = head[start + 8], head[start + 13 : start + 15]
    if version in END_AT and (version > 1 or widths[:1] == b"\x08"):
        (end,) = struct.unpack_from("<Q", head.ljust(MATLAB_OFFSET + HEAD), start + END_AT[version])
        if path.stat().st_size > end:
            raise InputError(
                f"{path}: the HDF5 file is longer ({path.stat().st_size:,} bytes) than its header "
                f"says ({end:,}): copy it again"
            )


def hdf_keys(path: Path) -> set[str]:
    """Names at the top of an HDF5 file; empty if it is none."""
    if not is_hdf(path):
        return set()
    try:
        with _opened(path) as file:
            return set(file.keys())
    except (InputError, MissingExtraError, OSError, RuntimeError, KeyError, ValueError):
        return set()


def read_dataset(path: Path, file: Any, key: str) -> NDArray[Any]:
    """One dataset of a file from :func:`open_hdf`, which has looked at its size."""
    if key not in file:
        raise InputError(f"{path}: it has no dataset {key!r}: check --source")
    dataset = file[key]
    if not hasattr(dataset, "shape"):
        raise InputError(f"{path}: {key!r} is a group, not an array: name an array")
    check_texts(path, key, dataset)
    return np.asarray(dataset[()])


def read_bytes_attribute(path: Path, thing: Any, name: str) -> bytes:
    """An attribute that is one text of fixed length, as its bytes."""
    value = thing.attrs.get(name)
    if not isinstance(value, bytes):
        raise InputError(f"{path}: it has no text {name!r}: check --source")
    return bytes(value)
