"""Lines of a text table, checked before a parser sees them.

Parsers fill short lines with nothing and drop what a long line has too much. After a cut or a lost
piece that shifts numbers into the wrong columns without a word. Here every line must have as many
cells as the header, and the last one must end: cut within its last number it would be another.
"""

from __future__ import annotations

import io
from collections.abc import Callable
from pathlib import Path
from typing import IO

import numpy as np
from numpy.typing import NDArray

from animarl_envs.errors import InputError
from animarl_envs.files import unfinished

BLOCK = 2**20  # [bytes]
_NUL, _LINE_FEED, _RETURN, _QUOTE = 0, 10, 13, 34


class CheckedLines(io.RawIOBase):
    """Pass a file's bytes on; refuse the first line whose cells are not ``cells`` in number.

    Blank lines count for none. Separators and line ends inside quotes belong to the cell.
    ``before`` is the number of lines left out above; ``progress`` is told the bytes passed on.
    """

    def __init__(
        self, file: IO[bytes], path: Path, separator: str, cells: int, before: int = 0,
        progress: Callable[[int], None] | None = None,
    ) -> None:  # fmt: skip
        self._file, self._path, self._cells = file, path, cells
        self._separator, self._progress, self._seen = ord(separator), progress, 0
        self._line = 1 + before
        self._separators = 0  # on the line that a block broke off
        self._length = 0  # of that line [bytes]
        self._quoted = False
        self._returned = False  # whether the last byte was a carriage return

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: memoryview) -> int:  # type: ignore[override]
        data = self._file.read(min(len(buffer), BLOCK))
        if data:
            self._check(np.frombuffer(data, dtype=np.uint8))
        elif self._quoted:
            raise InputError(f"{self._path}: a quote is never closed: correct the file")
        elif self._length:
            self._refuse_unless(self._separators + 1)
            raise unfinished(self._path)
        buffer[: len(data)] = data
        self._seen += len(data)
        if self._progress is not None:
            self._progress(self._seen)
        return len(data)

    def _check(self, block: NDArray[np.uint8]) -> None:
        if (block == _NUL).any():
            raise InputError(f"{self._path}: it holds NUL bytes: it is no text table")
        outside = np.ones(len(block), dtype=bool)
        quote = block == _QUOTE
        if self._quoted or quote.any():
            outside = (np.cumsum(quote) + self._quoted) % 2 == 0
            self._quoted = not bool(outside[-1])
        returns = block == _RETURN
        if self._returned or returns.any():
            follows = np.concatenate([[self._returned], returns[:-1]])
            if (follows & (block != _LINE_FEED)).any():
                raise InputError(
                    f"{self._path}: a carriage return stands alone: end lines with a line feed"
                )
            self._returned = bool(returns[-1])
        ends = np.flatnonzero((block == _LINE_FEED) & outside)
        separators = np.flatnonzero((block == self._separator) & outside)
        if len(ends) == 0:
            self._separators += len(separators)
            self._length += len(block) - int(returns[-1])
            return
        count = np.diff(np.searchsorted(separators, ends), prepend=0)
        length = np.diff(ends, prepend=-1) - 1
        length -= returns[ends - 1] & (length > 0)
        count[0] += self._separators
        length[0] += self._length
        wrong = np.flatnonzero((count != self._cells - 1) & (length > 0))
        if len(wrong):
            self._line += int(wrong[0])
            self._refuse_unless(int(count[wrong[0]]) + 1)
        self._line += len(ends)
        self._separators = len(separators) - int(np.searchsorted(separators, ends[-1]))
        self._length = len(block) - 1 - int(ends[-1]) - int(returns[-1])

    def _refuse_unless(self, found: int) -> None:
        if found != self._cells:
            raise InputError(
                f"{self._path}: line {self._line} has {found} cells, the header {self._cells}: "
                "correct the line, or copy the file again"
            )


def check_lines(path: Path, separator: str, cells: int) -> None:
    """Check all lines of a text table that another package is going to read."""
    with path.open("rb") as file:
        lines = io.BufferedReader(CheckedLines(file, path, separator, cells), BLOCK)
        while lines.read(BLOCK):
            pass
