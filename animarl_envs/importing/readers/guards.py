"""What stands between a file and memory: absurd headers, zip bombs, pickles, broken libraries.

The rule: a file may ask for at most ``EXPANSION`` times its own size, plus ``ALLOWANCE``; a header
that asks for more is refused before anything is allocated.
"""

from __future__ import annotations

import contextlib
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from animarl_envs.errors import InputError, MissingExtraError
from animarl_envs.files import read_npz

EXPANSION = 64
ALLOWANCE = 16 * 2**20  # [bytes]


def allowed_bytes(path: Path) -> int:
    """Most bytes that arrays read from ``path`` may take."""
    return EXPANSION * path.stat().st_size + ALLOWANCE


def check_size(path: Path, size: int, what: str) -> None:
    """Refuse ``size`` bytes of ``what`` if the file is too small to mean it."""
    if size > allowed_bytes(path):
        raise InputError(
            f"{path}: {what} would take {size / 2**20:,.0f} MiB, more than {EXPANSION} times the "
            "file: its header is damaged, copy it again"
        )


def refuse_empty(path: Path, column: str, empty: NDArray[np.bool_], first_row: int) -> None:
    """Refuse a table whose text ``column`` is empty somewhere; rows are counted from 1."""
    if empty.any():
        raise InputError(
            f"{path}: row {first_row + int(empty.argmax()) + 1} has no {column}: fill it in, or "
            "leave the row out"
        )


@contextlib.contextmanager
def refusing(path: Path, source: str) -> Iterator[None]:
    """Turn what a library raises over a damaged file into one sentence."""
    try:
        yield
    except (InputError, MissingExtraError):
        raise
    except MemoryError:
        raise InputError(
            f"{path}: reading it as {source} needs more memory than there is: cut it in parts"
        ) from None
    except IsADirectoryError:
        raise InputError(f"{path}: it is a folder: name a file in it") from None
    except Exception as error:
        first = (str(error).strip() or type(error).__name__).splitlines()[0][:200]
        raise InputError(
            f"{path}: it cannot be read as {source} ({type(error).__name__}: {first}): "
            "check --source, or copy the file again"
        ) from error


def npz_members(path: Path) -> set[str]:
    """Names inside a zip archive; empty if it is none or damaged."""
    try:
        with zipfile.ZipFile(path) as archive:
            return set(archive.namelist())
    except (zipfile.BadZipFile, OSError, ValueError, NotImplementedError):
        return set()


def check_npz(path: Path) -> None:
    """Refuse an archive whose members, or the arrays their headers announce, are too large."""
    try:
        with zipfile.ZipFile(path) as archive:
            total = 0
            for member in archive.infolist():
                total += member.file_size
                check_size(path, total, "its content")
                with archive.open(member) as file:
                    shape, dtype = npy_header(path, file)
                    held = member.file_size - file.tell()
                if dtype.hasobject:
                    continue
                size = int(np.prod([int(n) for n in shape], dtype=object)) * dtype.itemsize
                if size != held:
                    raise InputError(
                        f"{path}: {member.filename} announces {size:,} bytes and holds {held:,}: "
                        "copy the file again"
                    )
    except InputError:
        raise
    except Exception as error:
        raise InputError(
            f"{path}: it is not a plain npz archive, or damaged or cut short "
            f"({type(error).__name__}): copy it again"
        ) from None


def npy_header(path: Path, file: IO[bytes]) -> tuple[tuple[int, ...], np.dtype[Any]]:
    """Shape and dtype that an ``.npy`` stream announces."""
    version = np.lib.format.read_magic(file)
    if version == (1, 0):
        shape, _, dtype = np.lib.format.read_array_header_1_0(file)
    elif version == (2, 0):
        shape, _, dtype = np.lib.format.read_array_header_2_0(file)
    else:
        raise InputError(f"{path}: npy version {version} is unknown: save it with np.save")
    return shape, dtype


def guarded_npz(path: Path) -> dict[str, NDArray[Any]]:
    """All arrays of an ``.npz`` without pickle, within the memory that its size allows."""
    if not path.is_file():
        return read_npz(path)
    check_npz(path)
    return read_npz(path)
