"""How a text table is laid out, found by a look at its beginning.

Encoding, separator, decimal sign, lines before the header, names of the columns (of several header
rows where one does not tell columns apart), their units, and the line of the first row. Every line
from there on is looked at again when it is read; nothing here decides about a number.
"""

from __future__ import annotations

import contextlib
import csv
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

from animarl_envs.errors import InputError
from animarl_envs.files import refuse_special
from animarl_envs.importing.readers import sheets
from animarl_envs.importing.readers.encodings import UTF_8, Blanks, encoding_of, open_utf8
from animarl_envs.importing.readers.lines import Readable

HEAD = 2**18  # [bytes] that are looked at
LONGEST_LINE = 2**20
HEADER_LINES = 120  # most lines before the first row
LOOKED_AT = 40  # rows that tell the number of cells
SEPARATORS = ",;\t|"
BLANK = " "
UNIT_NAMES = {
    "pixel": "px", "pixels": "px", "pix": "px", "px": "px", "mm": "mm", "millimeter": "mm",
    "millimetre": "mm", "cm": "cm", "centimeter": "cm", "centimetre": "cm", "m": "m", "meter": "m",
    "metre": "m", "µm": "um", "um": "um", "micron": "um", "inch": "inch", "in": "inch",
    "s": "s", "sec": "s", "secs": "s", "second": "s", "seconds": "s", "ms": "ms",
    "millisecond": "ms", "milliseconds": "ms", "msec": "ms", "min": "min", "us": "us", "µs": "us",
}  # fmt: skip
OTHER_UNITS = {
    "", "-", "deg", "°", "degrees", "rad", "cm/s", "mm/s", "m/s", "px/s", "cm²", "mm²", "px²",
    "cm2", "mm2", "cm^2", "%", "frame", "frames", "counts", "quality", "n", "a.u.", "au", "1/s",
    "deg/s", "°/s", "pixel²",
}  # fmt: skip


@dataclass(frozen=True)
class Layout:
    """Where the numbers of a table are, and what they are called.

    ``before`` are the cells of the lines above the header; ``first`` is the number of lines before
    the first row of numbers. ``sheet`` is of a workbook.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    separator: str = ","
    decimal: str = "."
    encoding: str = UTF_8
    first: int = 1
    before: tuple[tuple[str, ...], ...] = ()
    sheet: str | None = None
    workbook: bool = False
    words_in: tuple[str, ...] = ()  # columns whose first entry is no number
    unclear: str = ""  # a number whose sign may part thousands or decimals

    def open(self, path: Path) -> Readable:
        """The rows of numbers as UTF-8 text."""
        file: Readable
        if self.workbook:
            file = sheets.sheet_as_text(path, self.sheet)
        else:
            file = open_utf8(path, self.encoding)
        for _ in range(self.first):
            file.readline(LONGEST_LINE)
        return Blanks(file) if self.separator == BLANK else file

    @property
    def parsed_separator(self) -> str:
        """The separator of what :meth:`open` gives."""
        return "\t" if self.separator == BLANK else self.separator

    @property
    def words(self) -> str:
        """For messages and provenance."""
        kind = "workbook" if self.workbook else f"text in {self.encoding}"
        shown = {"\t": "tabs", BLANK: "blanks"}.get(self.separator, repr(self.separator))
        return f"{kind}, separator {shown}, decimal {self.decimal!r}, first row on {self.first + 1}"


def layout_of(
    path: Path, encoding: str | None = None, sheet: str | None = None, decimal: str | None = None
) -> Layout:
    """The layout of a table.

    Raises
    ------
    InputError
        If the file is no text table and no workbook.
    """
    refuse_special(path)
    status = path.stat()
    found = _layout(path, status.st_mtime_ns, status.st_size, encoding, sheet)
    return found if decimal is None else _with_decimal(path, found, decimal)


def names_by_look(path: Path) -> tuple[str, ...]:
    """Names of the columns; none where the file is no table. For sniffing: it never raises."""
    try:
        return layout_of(path).names
    except (InputError, ImportError, OSError, LookupError, ValueError):
        return ()


@lru_cache(maxsize=32)
def _layout(path: Path, changed: int, size: int, encoding: str | None, sheet: str | None) -> Layout:
    workbook = sheets.is_workbook(path)
    if workbook:
        head = sheets.sheet_as_text(path, sheet).read(HEAD)
        encoding = UTF_8
    else:
        sheets.refuse_old(path)
        encoding = encoding or encoding_of(path)
        try:
            with contextlib.closing(open_utf8(path, encoding)) as file:
                head = file.read(HEAD)
        except (LookupError, UnicodeDecodeError) as error:
            raise InputError(f"{path}: it is no text in {encoding} ({error}): check it") from None
    if b"\0" in head:
        raise InputError(f"{path}: it holds NUL bytes: it is no text table")
    lines = head.decode("utf-8-sig", errors="ignore").split("\n")
    if len(head) >= HEAD - 4 and len(lines) > 1:
        lines = lines[:-1]
    lines = [line.removesuffix("\r") for line in lines]
    while lines and not lines[-1]:
        lines.pop()
    if not lines:
        raise InputError(f"{path}: it is empty: check the file")
    candidates = [_by_separator(lines, separator) for separator in SEPARATORS + BLANK]
    score, layout = max(candidates, key=lambda one: one[0])
    if score == 0:
        layout = _of_header_only(lines)
    return replace(layout, encoding=encoding, sheet=sheet, workbook=workbook)


def _with_decimal(path: Path, layout: Layout, decimal: str) -> Layout:
    if decimal not in (".", ","):
        raise InputError(f"{path}: decimal is {decimal!r}: give . or ,")
    return replace(layout, decimal=decimal, unclear="")


def _unclear_number(rows: Sequence[Sequence[str]], decimal: str) -> str:
    """A number such as 1,000 whose sign may part thousands, where no other shows that it does not.

    A point is only doubted where whole numbers stand in the same column: 1.000 below 996.
    """
    sign = re.escape(decimal)
    thousands = re.compile(rf"[-+]?[1-9]\d{{0,2}}({sign}\d{{3}})+")
    doubted = ""
    for cells in zip(*rows, strict=True):
        signed = [cell for cell in cells if decimal in cell and is_number(cell, decimal)]
        if any(not thousands.fullmatch(cell) for cell in signed):
            return ""
        whole = any(re.fullmatch(r"[-+]?\d+", cell) for cell in cells)
        if signed and (whole or decimal == ","):
            doubted = doubted or signed[0]
    return doubted


def refuse_unclear_numbers(path: Path, layout: Layout) -> None:
    """Refuse a table whose decimal sign may part thousands, until it is stated."""
    if layout.unclear:
        raise InputError(
            f"{path}: {layout.unclear} may be "
            f"{layout.unclear.replace(layout.decimal, '')} or "
            f"{layout.unclear.replace(layout.decimal, '.')}: write numbers without signs between "
            f"thousands, or say --option decimal={layout.decimal!r} if it is the decimal sign"
        )


def split_cells(line: str, separator: str) -> list[str]:
    """The cells of one line."""
    if separator == BLANK:
        return line.split()
    try:
        return [cell.strip() for cell in next(csv.reader([line], delimiter=separator), [])]
    except csv.Error:
        return []


def _by_separator(lines: Sequence[str], separator: str) -> tuple[float, Layout]:
    """Numbers in a usual row under this separator, and the layout that would have."""
    rows = [split_cells(line, separator) for line in lines[: HEADER_LINES + LOOKED_AT]]
    counts = Counter(len(row) for row in rows[-LOOKED_AT:] if row and any(row))
    width = max(counts, key=lambda n: (counts[n], n), default=0)
    none = (0.0, Layout((), ()))
    if width < 2:
        return none
    decimal = _decimal(rows[-LOOKED_AT:], separator)
    first = next(
        (i for i, row in enumerate(rows) if len(row) == width and _is_row(row, decimal)), None
    )
    if first is None or first > HEADER_LINES:
        return none
    if first + 1 < len(rows) and _is_xy(rows[first + 1], width):  # animals that are called 1, 2
        first = next(
            (i for i in range(first + 2, len(rows)) if _numbers(rows[i], decimal)), len(rows)
        )
    top = first
    while top > 0 and len(rows[top - 1]) == width and _is_header(rows[top - 1]):
        top -= 1
    header = rows[top:first]
    if not header:  # the first row is damaged, or there is none
        above = [
            i for i in range(first) if len(rows[i]) == width and not _numbers(rows[i], decimal)
        ]
        top, first = (above[-1], above[-1] + 1) if above else (first, first + 1)
        header = rows[top:first]
    usual = [row for row in rows[first:] if len(row) == width]
    score = sum(_numbers(row, decimal) for row in usual) / max(len(usual), 1)
    share = len(usual) / max(sum(bool(any(row)) for row in rows[first:]), 1)
    names, units = _named(header, width)
    before = tuple(tuple(row) for row in rows[:top])
    words = [next((row[i] for row in usual if row[i]), "0") for i in range(width)]
    words_in = [
        name for name, word in zip(names, words, strict=False) if not is_number(word, decimal)
    ]
    layout = Layout(
        names, units, separator, decimal, first=first, before=before, words_in=tuple(words_in),
        unclear=_unclear_number(usual, decimal),
    )  # fmt: skip
    preferred = -1e-6 * (SEPARATORS + BLANK).index(separator)
    return score * share + 1e-3 * bool(header) + preferred, layout


def _of_header_only(lines: Sequence[str]) -> Layout:
    """A table without a row of numbers: the first line is its header."""
    separator = max(SEPARATORS, key=lambda one: len(split_cells(lines[0], one)))
    names = tuple(split_cells(lines[0], separator))
    return Layout(names, ("",) * len(names), separator)


def _decimal(rows: Sequence[Sequence[str]], separator: str) -> str:
    """A comma where more cells are numbers only with it than only with a point."""
    if separator == ",":
        return "."
    cells = [cell for row in rows for cell in row]
    comma = sum(bool(re.fullmatch(r"[-+]?\d*,\d+([eE][-+]?\d+)?", cell)) for cell in cells)
    point = sum(bool(re.fullmatch(r"[-+]?\d*\.\d+([eE][-+]?\d+)?", cell)) for cell in cells)
    return "," if comma > point else "."


def is_number(cell: str, decimal: str = ".") -> bool:
    """Whether a cell is one, as the parser takes it."""
    if decimal == ",":
        if "." in cell:  # it might part thousands
            return False
        cell = cell.replace(",", ".")
    try:
        float(cell)
    except ValueError:
        return False
    return "_" not in cell and cell.isascii()


def _numbers(row: Sequence[str], decimal: str) -> int:
    return sum(is_number(cell, decimal) for cell in row)


def _is_xy(row: Sequence[str], width: int) -> bool:
    named = [cell.lower() for cell in row if cell]
    return len(row) == width and {"x", "y"} <= set(named) and len(named) > len(set(named))


def _named(header: Sequence[Sequence[str]], width: int) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Names and units; of several header rows those that together tell the columns apart."""
    rows = list(header)
    units = [""] * width
    if len(rows) > 1 and _is_units(rows[-1]):
        units = [bare_unit(cell) for cell in rows.pop()]
    if not rows:
        return (), tuple(units)
    filled = [cell for cell in rows[0] if cell]
    if len(set(filled)) == len(filled) > 1 and not (len(rows) > 1 and _is_xy(rows[-1], width)):
        return tuple(rows[0]), tuple(units)
    for row in rows[:-1]:  # a merged cell of a spreadsheet stands for those to its right
        for i in range(1, width):
            if (
                not row[i]
                and isinstance(row, list)
                and rows[-1][i].lower() not in ("time", "frame")
            ):
                row[i] = row[i - 1]
    names = ["_".join(cell for cell in column if cell) for column in zip(*rows, strict=True)]
    return tuple(names), tuple(units)


def _is_row(row: Sequence[str], decimal: str) -> bool:
    return _is_header(row) and _numbers(row, decimal) > 0


def _is_header(row: Sequence[str]) -> bool:
    """Whether a row of the right length may be one of names: a remark fills one or two cells."""
    return any(row[2:]) if len(row) > 3 else any(row)


def _is_units(row: Sequence[str]) -> bool:
    bare = [re.sub(r"[\[\]()]", "", cell).strip().lower() for cell in row]
    known = [cell in UNIT_NAMES or cell in OTHER_UNITS for cell in bare]
    return all(known) and any(cell in UNIT_NAMES for cell in bare)


def bare_unit(cell: str) -> str:
    """The usual short form of a unit, empty if it is none of a length or time."""
    return UNIT_NAMES.get(re.sub(r"[\[\]()]", "", cell).strip().lower(), "")
