"""HDF5 files of others: opened without following links out of the file.

HDF5 can point out of the file (links, external storage, virtual datasets), ask for filters that are
loaded from the disk, and describe numbers of any layout. None of it is in a file of tracks, so none
of it is followed: such a file is refused as a whole. A dataset that was created and never written
reads as zeros, which would be positions: it is refused too.
"""

import contextlib
import math
import struct
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from animarl_envs.demos.episode import refusing_damage
from animarl_envs.errors import InputError, MissingExtraError, require, require_extra

MAGIC = b"\x89HDF\r\n\x1a\n"
HEAD = 96  # the longest header of a file [bytes]
END_AT = {0: 40, 1: 44, 2: 28, 3: 28}  # where it says the file's length, by its version
MATLAB_OFFSET = 512  # MATLAB writes a header of its own before the HDF5 one
FILTERS = {1, 2, 3, 32000}  # deflate, shuffle, checksum, lzf: those that h5py brings along


def is_hdf(path: Path) -> bool:
    """Return whether the file starts like HDF5 (or MATLAB 7.3)."""
    with contextlib.suppress(OSError), path.open("rb") as file:
        start = file.read(MATLAB_OFFSET + len(MAGIC))
        return start.startswith(MAGIC) or start[MATLAB_OFFSET:] == MAGIC
    return False


def open_hdf(path: Path, soft_links: bool = False) -> Any:
    """Open an HDF5 file that has no links to other files and holds usual numbers.

    ``soft_links`` are names of other places in the same file, as NWB has them. Raises InputError if
    it is none or holds anything unusual; damaged, whatever h5py raises.
    """
    with require_extra("reading HDF5", "data"):
        import h5py
    if not is_hdf(path):
        raise InputError(f"{path}: it is no HDF5 file: check --source, or copy the file again")
    _check_end(path)
    with contextlib.ExitStack() as stack:
        file = stack.enter_context(h5py.File(path, "r"))
        _check_contents(path, file, soft_links)
        stack.pop_all()
    return file


def hdf_keys(path: Path) -> set[str]:
    """Return the names at the top of an HDF5 file; empty if it is no such file or damaged."""
    with contextlib.suppress(InputError, MissingExtraError), refusing_damage(path):
        if is_hdf(path):
            with open_hdf(path) as file:
                return set(file.keys())
    return set()


def read_dataset(path: Path, file: Any, key: str) -> NDArray[Any]:
    """Return one dataset of a file from :func:`open_hdf`; refuse one that was never written."""
    require(key in file, f"{path}: it has no dataset {key!r}: check --source")
    dataset = file[key]
    require(hasattr(dataset, "shape"), f"{path}: {key!r} is a group, not an array: name an array")
    require(
        _is_written(dataset),
        f"{path}: {key!r} was created, and some or all of it was never written: the program that "
        "wrote it ended early, export it again",
    )
    return np.asarray(dataset[()])


def hdf_text(value: Any) -> str:
    """Return a text as it stands in a dataset or attribute: bytes, text, or an array of one."""
    value = value.item() if hasattr(value, "item") else value
    return value.decode(errors="replace") if isinstance(value, bytes) else str(value)


def _is_written(dataset: Any) -> bool:
    """Return whether all of a dataset was written, or reads as NaN where it was not."""
    if not dataset.size or (dataset.dtype.kind == "f" and np.isnan(dataset.fillvalue)):
        return True
    if dataset.chunks is None:
        return bool(dataset.id.get_storage_size() > 0)
    grid = zip(dataset.shape, dataset.chunks, strict=True)
    return bool(dataset.id.get_num_chunks() >= math.prod(-(-n // size) for n, size in grid))


def _check_end(path: Path) -> None:
    """Refuse a file that is longer than its header says (a shorter one fails to open)."""
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


def _check_contents(path: Path, file: Any, soft_links: bool) -> None:
    """Refuse a file that points outside, or holds numbers or filters of no usual kind."""
    import h5py

    waiting, seen = [file["/"]], set()
    while waiting:
        thing = waiting.pop()
        address = h5py.h5o.get_info(thing.id).addr
        if address in seen:
            continue
        seen.add(address)
        place, faults = thing.name, []
        kinds = [thing.attrs.get_id(name).get_type() for name in thing.attrs]
        if isinstance(thing, h5py.Dataset):
            settings = thing.id.get_create_plist()
            kinds.append(thing.id.get_type())
            packed = {settings.get_filter(i)[0] for i in range(settings.get_nfilters())}
            faults = [
                "a virtual dataset, made of other files" * thing.is_virtual,
                "stored in another file" * bool(thing.external),
                "packed by an unusual filter" * bool(packed - FILTERS),
            ]
        elif isinstance(thing, h5py.Group):
            for name in thing:
                link = thing.get(name, getlink=True)
                if isinstance(link, h5py.HardLink):
                    waiting.append(thing[name])
                elif not (soft_links and isinstance(link, h5py.SoftLink)):
                    place, faults = f"{place.rstrip('/')}/{name}", ["a link to elsewhere"]
                    break
        if not all(map(_is_plain, kinds)):
            faults.append("of numbers laid out unusually")
        if what := next(filter(None, faults), ""):
            raise InputError(
                f"{path}: {place} is {what}: it is not followed, export plain arrays instead"
            )


def _is_plain(kind: Any) -> bool:
    """Return whether numbers of this kind are laid out as NumPy has them."""
    from h5py import h5t

    if isinstance(kind, (h5t.TypeFloatID, h5t.TypeIntegerID)):
        return bool(kind.equal(h5t.py_create(kind.dtype)))
    if isinstance(kind, h5t.TypeCompoundID):
        return all(_is_plain(kind.get_member_type(i)) for i in range(kind.get_nmembers()))
    if isinstance(kind, (h5t.TypeArrayID, h5t.TypeEnumID, h5t.TypeVlenID)):
        return _is_plain(kind.get_super())
    return True
