"""What an HDF5 file holds, looked at before anything in it is read.

HDF5 can point out of the file (external links, external storage, virtual datasets), ask for filters
that are loaded from the disk, describe floats of any layout, and announce any size. None of it is
in a file of tracks, so none of it is followed: such a file is refused as a whole.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

from animarl_envs.errors import InputError
from animarl_envs.files import check_size

MOST_OBJECTS = 50_000
FILTERS = {1, 2, 3, 32000}  # deflate, shuffle, checksum, lzf: those that h5py brings along
NUMBER = 8  # [bytes] that every number takes once it is read


def check_contents(path: Path, file: Any) -> None:
    """Refuse a file that points outside, or holds anything whose size or kind is unusual.

    Raises
    ------
    InputError
        It names the object within the file.
    """
    import h5py

    waiting, seen, total = [("/", file.id)], set(), 0
    while waiting:
        place, thing = waiting.pop()
        address = h5py.h5o.get_info(thing).addr
        if address in seen:
            continue
        seen.add(address)
        if len(seen) > MOST_OBJECTS:
            raise InputError(f"{path}: it holds more than {MOST_OBJECTS:,} objects: export less")
        if isinstance(thing, h5py.h5d.DatasetID):
            total += _checked_dataset(path, place, thing)
            check_size(path, total, "its content")
        elif isinstance(thing, (h5py.h5g.GroupID, h5py.h5f.FileID)):
            group = thing if isinstance(thing, h5py.h5g.GroupID) else h5py.h5g.open(thing, b"/")
            for name in group:
                inner = f"{place.rstrip('/')}/{name.decode(errors='backslashreplace')}"
                if group.links.get_info(name).type != h5py.h5l.TYPE_HARD:
                    raise _refused(path, inner, "a link to elsewhere")
                waiting.append((inner, h5py.h5o.open(group, name)))
        else:
            continue  # a named type, which says nothing by itself
        if not isinstance(thing, h5py.h5f.FileID):
            _check_attributes(path, place, thing)


def _checked_dataset(path: Path, place: str, dataset: Any) -> int:
    """Bytes that the dataset will take."""
    import h5py

    settings = dataset.get_create_plist()
    layout = settings.get_layout()
    if layout == h5py.h5d.VIRTUAL:
        raise _refused(path, place, "a virtual dataset, made of other files")
    if settings.get_external_count():
        raise _refused(path, place, "stored in another file")
    if {settings.get_filter(i)[0] for i in range(settings.get_nfilters())} - FILTERS:
        raise _refused(path, place, "packed by an unusual filter")
    kind = dataset.get_type()
    check_kind(path, place, kind)
    size = max(kind.get_size(), NUMBER)
    if layout == h5py.h5d.CHUNKED:
        check_size(path, math.prod(settings.get_chunk()) * size, f"a chunk of {place}")
    return int(math.prod(dataset.shape) * size)


def _check_attributes(path: Path, place: str, thing: Any) -> None:
    import h5py

    for number in range(h5py.h5a.get_num_attrs(thing)):
        attribute = h5py.h5a.open(thing, index=number)
        inner = f"{place}, attribute {attribute.name.decode(errors='backslashreplace')}"
        kind = attribute.get_type()
        check_kind(path, inner, kind)
        count = attribute.get_space().get_simple_extent_npoints()
        check_size(path, count * kind.get_size(), inner)


def check_kind(path: Path, place: str, kind: Any) -> None:
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
            check_kind(path, place, kind.get_member_type(member))
    elif isinstance(kind, (h5t.TypeArrayID, h5t.TypeEnumID, h5t.TypeVlenID)):
        check_kind(path, place, kind.get_super())


def _refused(path: Path, place: str, what: str) -> InputError:
    return InputError(f"{path}: {place} is {what}: it is not followed, export plain arrays instead")
