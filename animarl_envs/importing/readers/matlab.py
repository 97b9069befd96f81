"""Numeric arrays of MATLAB's ``.mat`` files, versions 5 to 7 (7.3 is HDF5).

Read here rather than by SciPy, whose parser ends the whole process on some damaged files. Layout:
"MAT-File Format", The MathWorks: a header of 128 bytes, then elements, each with a tag of type and
size; a compressed element holds one other; a matrix holds its class, dimensions, name and numbers.
"""

from __future__ import annotations

import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from animarl_envs.errors import InputError
from animarl_envs.files import check_size

HEADER = 128  # [bytes]
ENDIANS = {b"IM": "<", b"MI": ">"}  # as the file's last two bytes of the header
MATRIX, COMPRESSED = 14, 15
STORED = {
    1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8",
}  # fmt: skip
CLASSES = {
    6: "f8", 7: "f4", 8: "i1", 9: "u1", 10: "i2", 11: "u2", 12: "i4", 13: "u4", 14: "i8", 15: "u8",
}  # fmt: skip
COMPLEX = 0x08  # flag


@dataclass
class _Bytes:
    """What is left to read."""

    data: memoryview
    endian: str

    def take(self, count: int) -> memoryview:
        if not 0 <= count <= len(self.data):
            raise ValueError(f"{count} bytes are announced, {len(self.data)} are there")
        taken, self.data = self.data[:count], self.data[count:]
        return taken

    def numbers(self, kind: str, count: int) -> NDArray[Any]:
        dtype = np.dtype(self.endian + kind)
        return np.frombuffer(self.take(count * dtype.itemsize), dtype=dtype)

    def element(self) -> tuple[int, _Bytes]:
        """Type and content of the next one; small ones lie within their tag."""
        kind, size = self.numbers("u4", 2).tolist()
        if kind >> 16:
            raise ValueError("an element's tag is damaged")
        content = self.take(size)
        if kind != COMPRESSED:
            self.take(min(-size % 8, len(self.data)))
        return kind, _Bytes(content, self.endian)

    def part(self) -> tuple[int, _Bytes]:
        """The next element of a matrix, which may be small: size, type and content in 8 bytes."""
        (word,) = np.frombuffer(self.data[:4], dtype=self.endian + "u4").tolist() or (0,)
        if word >> 16 == 0:
            return self.element()
        self.take(4)
        content = self.take(4)
        return word & 0xFFFF, _Bytes(content[: word >> 16], self.endian)


def read_mat5(path: Path) -> dict[str, NDArray[Any]]:
    """All real numeric arrays by name; cells, structures, texts, sparse matrices are passed over.

    Raises
    ------
    InputError
        If the file is of another version, or damaged; nothing is allocated beyond what its size
        allows.
    """
    raw = path.read_bytes()
    endian = ENDIANS.get(raw[HEADER - 2 : HEADER])
    if endian is None:
        raise InputError(
            f"{path}: it is no MATLAB file of version 5 or later: save it with save -v7"
        )
    rest, found = _Bytes(memoryview(raw)[HEADER:], endian), {}
    try:
        while rest.data:
            kind, content = rest.element()
            if kind == COMPRESSED:
                kind, content = _inflated(path, content)
            if kind != MATRIX:
                raise ValueError(f"an element is of type {kind}")
            named = _matrix(path, content)
            if named is not None:
                found[named[0]] = named[1]
    except (ValueError, zlib.error, UnicodeDecodeError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"{path}: the MATLAB file is damaged ({error}): copy it again") from None
    return found


def _inflated(path: Path, packed: _Bytes) -> tuple[int, _Bytes]:
    stream = zlib.decompressobj()
    head = stream.decompress(packed.data, 8)
    kind, size = _Bytes(memoryview(head), packed.endian).numbers("u4", 2).tolist()
    check_size(path, size, "a variable")
    data = stream.decompress(stream.unconsumed_tail, size + 8)
    more = stream.decompress(stream.unconsumed_tail, 8)  # reaches the checksum
    if more or not stream.eof or len(data) != size:
        raise ValueError("a compressed variable is shorter or longer than announced")
    return kind, _Bytes(memoryview(data), packed.endian)


def _matrix(path: Path, content: _Bytes) -> tuple[str, NDArray[Any]] | None:
    """Name and array, or nothing if it is not of real numbers."""
    _, flags = content.part()
    word = int(flags.numbers("u4", 2)[0])
    kind, is_complex = word & 0xFF, bool(word >> 8 & COMPLEX)
    if kind not in CLASSES or is_complex:
        return None
    _, sizes = content.part()
    shape = [int(n) for n in sizes.numbers("i4", len(sizes.data) // 4)]
    if len(shape) < 2 or min(shape) < 0:
        raise ValueError(f"a variable has shape {shape}")
    _, name = content.part()
    stored, values = content.part()
    count = int(np.prod(shape, dtype=object))
    check_size(path, count * 8, "a variable")
    if stored not in STORED or len(values.data) != count * np.dtype(STORED[stored]).itemsize:
        raise ValueError(f"a variable of {count} numbers holds {len(values.data)} bytes")
    if content.data:
        raise ValueError("a variable is longer than its numbers")
    if not _is_packing(np.dtype(STORED[stored]), np.dtype(CLASSES[kind])):
        raise ValueError(f"a variable of {CLASSES[kind]} is stored as {STORED[stored]}")
    array = values.numbers(STORED[stored], count).astype(CLASSES[kind])
    return bytes(name.data).decode("ascii"), array.reshape(shape, order="F")


def _is_packing(stored: np.dtype[Any], own: np.dtype[Any]) -> bool:
    """Whether MATLAB stores numbers of a class so: as themselves or as smaller whole numbers."""
    if own.kind == "f":
        return stored.itemsize <= (own.itemsize if stored.kind == "f" else 4)
    return stored.kind != "f" and stored.itemsize <= own.itemsize
