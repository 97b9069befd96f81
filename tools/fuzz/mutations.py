"""Damage to files: cuts, losses, repeats, other bytes and lines, other content in sound archives.

Every mutation is drawn from a generator, so that a seed names it.
"""

from __future__ import annotations

import io
import zipfile
from dataclasses import dataclass

import numpy as np

HEAD = 512  # headers lie at the start [bytes]
TELLING = (0, 1, 0x7F, 0x80, 0xFE, 0xFF)  # bytes at which sizes and signs turn
TEXTS = (b",", b"\n", b"\r\n", b'"', b"nan", b"inf", b"-", b"1e308", b"\0", b"=", b"\xff", b"0x1")


@dataclass(frozen=True)
class Damage:
    """Bytes after the damage, and how many were overwritten (0: lost, repeated or cut off).

    ``sealed``: the checksums around the damage were made anew.
    """

    data: bytes
    overwritten: int
    sealed: bool = False


def damaged(raw: bytes, rng: np.random.Generator) -> Damage:
    """One damage of any kind to a file that is not empty."""
    if raw[:2] == b"PK" and rng.random() < 0.5:
        return _inside_archive(raw, rng)
    return _anywhere(raw, rng)


def _anywhere(raw: bytes, rng: np.random.Generator) -> Damage:
    data, how = bytearray(raw), int(rng.integers(9))
    place = int(rng.integers(1, max(len(data), 2)))
    if how == 0:
        return Damage(bytes(data[:place]), 0)
    if how == 1:
        start = int(rng.integers(place))
        return Damage(bytes(data[:place] + data[start:place] + data[place:]), 0)
    if how == 2:
        return Damage(bytes(data[:place] + data[place + int(rng.integers(1, 64)) :]), 0)
    if how == 3:
        moved = _other_lines(raw, rng)
        return Damage(moved, _differing(raw, moved) if len(moved) == len(raw) else 0)
    if how == 4:
        piece = TEXTS[int(rng.integers(len(TEXTS)))]
        return Damage(bytes(data[:place] + piece + data[place:]), 0)
    count = 1 if how in (5, 6) else int(rng.integers(1, 40))
    reach = len(data) if rng.random() < 0.5 else min(len(data), HEAD)
    for at in rng.integers(reach, size=count).tolist():
        if how == 6:
            data[at] ^= 1 << int(rng.integers(8))
        elif how == 7:
            data[at] = TELLING[int(rng.integers(len(TELLING)))]
        else:
            data[at] = int(rng.integers(256))
    return Damage(bytes(data), count)


def _differing(one: bytes, other: bytes) -> int:
    """Places at which two equally long files differ: what swapped lines have overwritten."""
    return int(np.count_nonzero(np.frombuffer(one, np.uint8) != np.frombuffer(other, np.uint8)))


def _other_lines(raw: bytes, rng: np.random.Generator) -> bytes:
    """Two lines change places, or one comes twice, or is gone."""
    lines = raw.splitlines(keepends=True)
    one, other = (int(i) for i in rng.integers(len(lines), size=2))
    how = int(rng.integers(3))
    if how == 0:
        lines[one], lines[other] = lines[other], lines[one]
    elif how == 1:
        lines.insert(one, lines[other])
    else:
        del lines[one]
    return b"".join(lines)


def _inside_archive(raw: bytes, rng: np.random.Generator) -> Damage:
    """One member is damaged, and packed as if it had always been so."""
    with zipfile.ZipFile(io.BytesIO(raw)) as archive:
        members = [(info, archive.read(info)) for info in archive.infolist()]
    chosen, overwritten = int(rng.integers(len(members))), 0
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as archive:
        for number, (info, content) in enumerate(members):
            if number == chosen and content:
                damage = _anywhere(content, rng)
                content, overwritten = damage.data, damage.overwritten
            archive.writestr(info.filename, content, compress_type=info.compress_type)
    return Damage(out.getvalue(), overwritten, sealed=True)
