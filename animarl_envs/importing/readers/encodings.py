"""Texts of any encoding, handed on as UTF-8.

A byte order mark decides; else UTF-8 if the whole file is; else UTF-16 where every second byte is
nothing; else Latin-1 if it reads as that. Other code pages are guessed, and the guess is only said:
numbers are the same in all of them, but names would be misspelt.
"""

from __future__ import annotations

import codecs
import re
from pathlib import Path
from typing import IO

import numpy as np

from animarl_envs.errors import InputError, MissingExtraError
from animarl_envs.importing.readers.lines import BLOCK, Readable

UTF_8 = "utf-8-sig"
WESTERN = "cp1252"  # Latin-1 as Windows has it
SIGNS = "°µ²³±·"
CODE_PAGES = ["cp1250", "cp1251", "mac_roman", "shift_jis", "gb18030"]
SAMPLE = 2**16  # [bytes] that the guess looks at
WIDE = 0.4  # share of nothing among every second byte that makes UTF-16


def encoding_of(path: Path) -> str:
    """Python's name of the encoding of a text file."""
    with path.open("rb") as file:
        start = file.read(SAMPLE)
        if start.startswith((codecs.BOM_UTF32_LE, codecs.BOM_UTF32_BE)):
            return "utf-32"
        if start.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
            return "utf-16"
        nothing = np.frombuffer(start, dtype=np.uint8) == 0
        for first, name in ((1, "utf-16-le"), (0, "utf-16-be")):
            other = nothing[1 - first :: 2]
            if len(other) and nothing[first::2].mean() > WIDE and not other.any():
                return name
        file.seek(0)
        return UTF_8 if _is_utf8(file) else _guess(path, file)


def open_utf8(path: Path, encoding: str) -> Readable:
    """The file as UTF-8; whoever asked for it closes it."""
    if encoding == UTF_8:
        return path.open("rb")
    return Recoded(path, encoding)


class Recoded:
    """A text of another encoding, as UTF-8 bytes; line ends are left as they are."""

    def __init__(self, path: Path, encoding: str) -> None:
        self._text = path.open("r", encoding=encoding, newline="")

    def read(self, size: int = -1, /) -> bytes:
        """At most ``size`` bytes: a character takes up to four."""
        return self._text.read(-1 if size < 0 else max(size // 4, 1)).encode()

    def readline(self, size: int = -1, /) -> bytes:
        """The next line."""
        return self._text.readline(size).encode()

    def close(self) -> None:
        """Close the file."""
        self._text.close()


class Blanks:
    """Lines whose cells are told apart by blanks of any number, with tabs instead."""

    def __init__(self, file: Readable) -> None:
        self._file, self._rest = file, b""

    def read(self, size: int = -1, /) -> bytes:
        """At most ``size`` bytes."""
        while len(self._rest) < size and (line := self._file.readline(BLOCK)):
            end = b"\n" if line.endswith(b"\n") else b""
            self._rest += b"\t".join(line.split()) + end
        found, self._rest = self._rest[:size], self._rest[size:]
        return found

    def readline(self, size: int = -1, /) -> bytes:
        """The next line, with its blanks."""
        return b"\t".join(self._file.readline(size).split())

    def close(self) -> None:
        """Close the file."""
        self._file.close()


def _is_utf8(file: IO[bytes]) -> bool:
    decoder = codecs.getincrementaldecoder("utf-8")()
    try:
        while block := file.read(BLOCK):
            decoder.decode(block)
        decoder.decode(b"", final=True)
    except UnicodeDecodeError:
        return False
    return True


def _guess(path: Path, file: IO[bytes]) -> str:
    try:
        from charset_normalizer import from_bytes
    except ImportError as error:
        raise MissingExtraError("reading tables that are not UTF-8", "data") from error
    file.seek(0)
    other, found = [], 0
    while found < SAMPLE and (line := file.readline(BLOCK)):
        if not line.isascii():
            other.append(line)
            found += len(line)
    sample = b"".join(other)[:SAMPLE]
    if _is_damaged_utf8(sample):
        raise InputError(f"{path}: it is UTF-8 with characters that do not exist: save it again")
    if _is_western(sample):
        return WESTERN
    best = from_bytes(sample, cp_isolation=CODE_PAGES).best()
    guess = "" if best is None else f" (it may be {best.encoding})"
    raise InputError(
        f"{path}: its encoding is not clear{guess}: save it as UTF-8, or say what it is by "
        "--source long-table --option encoding=NAME"
    )


def _is_damaged_utf8(sample: bytes) -> bool:
    try:
        sample.decode("utf-8", errors="surrogatepass")
    except UnicodeDecodeError:
        return False
    return True


def _is_western(sample: bytes) -> bool:
    """Whether the sample reads as Latin-1, where single letters and signs are beyond ASCII."""
    try:
        text = sample.decode(WESTERN)
    except UnicodeDecodeError:
        return False
    known = all(c.isascii() or c.isalpha() or c in SIGNS for c in text)
    return known and not re.search(r"[^\x00-\x7f]{3}", text)
