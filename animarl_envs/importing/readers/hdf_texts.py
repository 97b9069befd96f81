"""Texts of varying length in HDF5, checked before the library reads them.

They lie in collections ("global heaps") apart from the dataset, which only holds lengths and
places. The library believes both: a damaged length makes it allocate gigabytes, and free space of
no size makes it loop without end.
"""

from __future__ import annotations

import mmap
import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np

from animarl_envs.errors import InputError
from animarl_envs.files import allowed_bytes, check_size

HEAP = b"GCOL"
HEAP_HEADER, OBJECT_HEADER = 16, 16  # [bytes]
REFERENCE = np.dtype([("length", "<u4"), ("place", "<u8"), ("number", "<u4")])
DEFLATE = 1  # id of the filter


def check_heaps(path: Path) -> None:
    """Refuse free space of no size.

    A collection is its mark, version (1), 3 bytes, its size (8 bytes), then objects: number (2),
    count (2), 4 bytes, size (8), content up to a multiple of 8; number 0 is free space, whose size
    includes its header.
    """
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as data:
        start = data.find(HEAP)
        while start >= 0:
            if data[start + 4 : start + 5] == b"\x01" and start + HEAP_HEADER <= len(data):
                (size,) = struct.unpack_from("<Q", data, start + 8)
                at, end = start + HEAP_HEADER, min(start + size, len(data))
                while at + OBJECT_HEADER <= end:
                    number, _, _, length = struct.unpack_from("<HHIQ", data, at)
                    if number == 0 and length == 0:
                        raise _damaged(path, f"at byte {at:,}")
                    at += length if number == 0 else OBJECT_HEADER + (length + 7) // 8 * 8
            start = data.find(HEAP, start + 1)


def check_texts(path: Path, key: str, dataset: Any) -> None:
    """Refuse a dataset of texts whose lengths add up to more than the file may ask for."""
    import h5py

    kind = dataset.dtype
    if h5py.check_vlen_dtype(kind) is None and h5py.check_string_dtype(kind) is None:
        return
    if kind.kind != "O" or dataset.size == 0:
        return
    total = 0
    for raw in _stored(path, key, dataset):
        if len(raw) % REFERENCE.itemsize:
            raise _damaged(path, key)
        lengths = np.frombuffer(raw, dtype=REFERENCE)["length"]
        total += int(lengths.sum(dtype=np.int64)) * np.dtype(np.float64).itemsize
    check_size(path, total, f"dataset {key!r}")


def _stored(path: Path, key: str, dataset: Any) -> list[bytes]:
    """The references as they lie in the file, whole or in chunks."""
    size = dataset.size * REFERENCE.itemsize
    if dataset.chunks is None:
        offset = dataset.id.get_offset()
        if offset is None:
            raise InputError(
                f"{path}: dataset {key!r} holds texts in its header: export it once more"
            )
        with path.open("rb") as file:
            file.seek(offset)
            return [file.read(size)]
    filters = dataset.id.get_create_plist()
    kinds = [filters.get_filter(i)[0] for i in range(filters.get_nfilters())]
    if set(kinds) - {DEFLATE}:
        raise InputError(f"{path}: dataset {key!r} holds packed texts: export it without a filter")
    found = []
    for number in range(dataset.id.get_num_chunks()):
        place = dataset.id.get_chunk_info(number).chunk_offset
        mask, raw = dataset.id.read_direct_chunk(place)
        if kinds and mask == 0:
            raw = zlib.decompressobj().decompress(raw, allowed_bytes(path.stat().st_size))
        found.append(raw)
    return found


def _damaged(path: Path, place: str) -> InputError:
    return InputError(f"{path}: the HDF5 file is damaged ({place}): copy it again")
