"""HDF5 files, checked before anything in them is read.

HDF5 can point out of the file (links, external storage, virtual datasets), ask for filters that are
loaded from the disk, and describe numbers of any layout. None of it is in a file of tracks, so none
of it is followed: such a file is refused as a whole.
"""

from __future__ import annotations

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
    try:
        with path.open("rb") as file:
            start = file.read(MATLAB_OFFSET + len(MAGIC))
    except OSError:
        return False
    return start.startswith(MAGIC) or start[MATLAB_OFFSET:] == MAGIC


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
    file = None
    try:
        file = h5py.File(path, "r")
        _check_contents(path, file)
    except Exception as error:
        if file is not None:
            file.close()
        if isinstance(error, (InputError, MemoryError)):
            raise
        first = (str(error).splitlines() or [type(error).__name__])[0][:160]
        raise InputError(f"{path}: the HDF5 file is damaged ({first}): copy it again") from None
    return file


def hdf_keys(path: Path) -> set[str]:
    """Return the names at the top of an HDF5 file; none if it is none."""
    try:
        if not is_hdf(path):
            return set()
        with open_hdf(path) as file:
            return set(file.keys())
    except (InputError, MissingExtraError, OSError, RuntimeError, KeyError, ValueError):
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
        kinds = [thing.attrs.get_id(name).get_type() for name in thing.attrs]
        if isinstance(thing, h5py.Dataset):
            settings = thing.id.get_create_plist()
            kinds.append(thing.id.get_type())
            if thing.is_virtual:
                raise _refused(path, thing.name, "a virtual dataset, made of other files")
            if thing.external:
                raise _refused(path, thing.name, "stored in another file")
            if {settings.get_filter(i)[0] for i in range(settings.get_nfilters())} - FILTERS:
                raise _refused(path, thing.name, "packed by an unusual filter")
        elif isinstance(thing, h5py.Group):
            for name in thing:
                if not isinstance(thing.get(name, getlink=True), h5py.HardLink):
                    inner = f"{thing.name.rstrip('/')}/{name}"
                    raise _refused(path, inner, "a link to elsewhere")
                waiting.append(thing[name])
        for kind in kinds:
            _check_kind(path, thing.name, kind)


def _check_kind(path: Path, place: str, kind: Any) -> None:
    """Refuse numbers whose bits are laid out in no usual way, which would be read as others."""
    from h5py import h5t

    if isinstance(kind, h5t.TypeFloatID):
        usual = (
            h5t.IEEE_F16LE, h5t.IEEE_F16BE, h5t.IEEE_F32LE, h5t.IEEE_F32BE,
            h5t.IEEE_F64LE, h5t.IEEE_F64BE,
        )  # fmt: skip
        if not any(kind.equal(one) for one in usual):
            raise _refused(path, place, "of floats that are not IEEE's")
    elif isinstance(kind, h5t.TypeIntegerID):
        if kind.get_precision() != 8 * kind.get_size() or kind.get_offset() != 0:
            raise _refused(path, place, "of whole numbers with unused bits")
    elif isinstance(kind, h5t.TypeCompoundID):
        for member in range(kind.get_nmembers()):
            _check_kind(path, place, kind.get_member_type(member))
    elif isinstance(kind, (h5t.TypeArrayID, h5t.TypeEnumID, h5t.TypeVlenID)):
        _check_kind(path, place, kind.get_super())


def _refused(path: Path, place: str, what: str) -> InputError:
    return InputError(f"{path}: {place} is {what}: it is not followed, export plain arrays instead")
