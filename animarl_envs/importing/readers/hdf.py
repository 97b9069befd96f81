"""HDF5 files, checked before anything in them is read.

HDF5 can point out of the file (links, external storage, virtual datasets), ask for filters that are
loaded from the disk, and describe numbers of any layout. None of it is in a file of tracks, so none
of it is followed: such a file is refused as a whole.
"""

from __future__ import annotations

import contextlib
import struct
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from animarl_envs.errors import InputError, MissingExtraError

MAGIC = b"\x89HDF\r\n\x1a\n"
HEAD = 96  # the longest header of a file [bytes]
END_AT = {0: 40, 1: 44, 2: 28, 3: 28}  # where it says the file's length, by its version
MATLAB_OFFSET = 512  # MATLAB writes a header of its own before the HDF5 one
FILTERS = {1, 2, 3, 32000}  # deflate, shuffle, checksum, lzf: those that h5py brings along


def is_hdf(path: Path) -> bool:
    """Whether the file starts like HDF5 (or MATLAB 7.3)."""
    with contextlib.suppress(OSError), path.open("rb") as file:
        start = file.read(MATLAB_OFFSET + len(MAGIC))
        return start.startswith(MAGIC) or start[MATLAB_OFFSET:] == MAGIC
    return False


def open_hdf(path: Path) -> Any:
    """Return an open ``h5py.File`` that points nowhere and holds usual numbers.

    Raises
    ------
    InputError
        If it is none, is damaged, or holds anything unusual.
    """
    try:
        import h5py
    except ImportError as error:
        raise MissingExtraError("reading HDF5", "data") from error
    if not is_hdf(path):
        raise InputError(f"{path}: it is no HDF5 file: check --source, or copy the file again")
    _check_end(path)
    with contextlib.ExitStack() as stack:
        try:
            file = stack.enter_context(h5py.File(path, "r"))
            _check_contents(path, file)
        except (InputError, MemoryError):
            raise
        except Exception as error:
            first = (str(error).splitlines() or [type(error).__name__])[0][:160]
            raise InputError(f"{path}: the HDF5 file is damaged ({first}): copy it again") from None
        stack.pop_all()
    return file


def hdf_keys(path: Path) -> set[str]:
    """Return the names at the top of an HDF5 file; none if it is none."""
    with contextlib.suppress(InputError, MissingExtraError, OSError, RuntimeError, LookupError):
        if is_hdf(path):
            with open_hdf(path) as file:
                return set(file.keys())
    return set()


def read_dataset(path: Path, file: Any, key: str) -> NDArray[Any]:
    """Return one dataset of a file from :func:`open_hdf`."""
    if key not in file:
        raise InputError(f"{path}: it has no dataset {key!r}: check --source")
    if not hasattr(file[key], "shape"):
        raise InputError(f"{path}: {key!r} is a group, not an array: name an array")
    return np.asarray(file[key][()])


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


def _check_contents(path: Path, file: Any) -> None:
    """Refuse a file that points outside, or holds numbers or filters of no usual kind."""
    import h5py

    waiting, seen = [file["/"]], set()
    while waiting:
        thing = waiting.pop()
        address = h5py.h5o.get_info(thing.id).addr
        if address in seen:
            continue
        seen.add(address)
        place, found = thing.name, []
        kinds = [thing.attrs.get_id(name).get_type() for name in thing.attrs]
        if isinstance(thing, h5py.Dataset):
            settings = thing.id.get_create_plist()
            kinds.append(thing.id.get_type())
            packed = {settings.get_filter(i)[0] for i in range(settings.get_nfilters())}
            found = [
                "a virtual dataset, made of other files" * thing.is_virtual,
                "stored in another file" * bool(thing.external),
                "packed by an unusual filter" * bool(packed - FILTERS),
            ]
        elif isinstance(thing, h5py.Group):
            for name in thing:
                if isinstance(thing.get(name, getlink=True), h5py.HardLink):
                    waiting.append(thing[name])
                else:
                    place, found = f"{place.rstrip('/')}/{name}", ["a link to elsewhere"]
                    break
        if what := next(filter(None, [*found, *map(_unusual, kinds)]), ""):
            raise InputError(
                f"{path}: {place} is {what}: it is not followed, export plain arrays instead"
            )


def _unusual(kind: Any) -> str:
    """Say how bits of numbers are laid out in an unusual way, which would be read as others."""
    from h5py import h5t

    if isinstance(kind, h5t.TypeFloatID):
        usual = [
            getattr(h5t, f"IEEE_F{bits}{order}") for bits in (16, 32, 64) for order in ("LE", "BE")
        ]
        return "" if any(map(kind.equal, usual)) else "of floats that are not IEEE's"
    if isinstance(kind, h5t.TypeIntegerID):
        whole = kind.get_precision() == 8 * kind.get_size() and kind.get_offset() == 0
        return "" if whole else "of whole numbers with unused bits"
    if isinstance(kind, h5t.TypeCompoundID):
        members = (_unusual(kind.get_member_type(i)) for i in range(kind.get_nmembers()))
        return next(filter(None, members), "")
    if isinstance(kind, (h5t.TypeArrayID, h5t.TypeEnumID, h5t.TypeVlenID)):
        return _unusual(kind.get_super())
    return ""
