"""How a text table is laid out, found by a look at its beginning.

Encoding, separator, decimal sign, lines before the header, names of the columns (of several header
rows where one does not tell columns apart), their units, and the line of the first row. Every line
from there on is checked again when it is read; nothing here decides about a number.
"""

import codecs
import csv
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import islice
from pathlib import Path

import numpy as np

from animarl_envs.errors import InputError, require_extra

UTF_8 = "utf-8-sig"
WESTERN = "cp1252"  # Latin-1 as Windows has it
SIGNS = "°µ²³±·"
CODE_PAGES = ["cp1250", "cp1251", "mac_roman", "shift_jis", "gb18030"]
SAMPLE = 2**16  # [bytes] by which an encoding is guessed
LINES_GUESSED = 1000  # most lines by which an encoding is guessed
WIDE = 0.4  # share of nothing among every second byte that makes UTF-16
HEADER_LINES = 120  # most lines before the first row
LOOKED_AT = 40  # rows that tell the number of cells
BLANK = " "
SEPARATORS = ",;\t|" + BLANK
_UNITS = {
    "px": "px pixel pixels pix",
    "mm": "mm millimeter millimetre",
    "cm": "cm centimeter centimetre",
    "m": "m meter metre",
    "um": "um µm micron",
    "inch": "inch in",
    "s": "s sec secs second seconds",
    "ms": "ms millisecond milliseconds msec",
    "min": "min",
    "us": "us µs",
}
UNIT_NAMES = {name: unit for unit, names in _UNITS.items() for name in names.split()}
_OTHERS = (
    "- # deg ° degrees rad cm/s mm/s m/s px/s cm² mm² px² cm2 mm2 cm^2 % frame frames counts "
    "quality n a.u. au 1/s deg/s °/s pixel²"
)
OTHER_UNITS = {"", *_OTHERS.split()}


@dataclass(frozen=True)
class Layout:
    """Where the numbers of a text are, and what they are called.

    ``before`` are the cells of the lines above the header, ``first`` is the number of lines before
    the first row. ``words_in`` are columns whose first entry is no number. ``unclear`` is a number
    whose sign may part thousands or decimals. ``headless`` tables have no line of names; theirs are
    supplied.
    """

    names: tuple[str, ...]
    units: tuple[str, ...] = ()
    separator: str = ","
    decimal: str = "."
    first: int = 1
    before: tuple[tuple[str, ...], ...] = ()
    words_in: tuple[str, ...] = ()
    unclear: str = ""
    headless: bool = False


def encoding_of(path: Path) -> str:
    """Return Python's name of the encoding of a text file.

    A byte order mark decides; else UTF-8 if the whole file is; else UTF-16 where every second byte
    is nothing; else Latin-1 if it reads as that. Other code pages are guessed, and the guess is
    only said: numbers are the same in all of them, but names would be misspelt.
    """
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
        try:
            for _ in codecs.iterdecode(iter(partial(file.read, SAMPLE), b""), "utf-8"):
                pass
        except UnicodeDecodeError:
            file.seek(0)
            lines = (line for line in file if not line.isascii())
            return _guessed_encoding(path, b"".join(islice(lines, LINES_GUESSED))[:SAMPLE])
    return UTF_8


def _guessed_encoding(path: Path, sample: bytes) -> str:
    with require_extra("reading tables that are not UTF-8", "data"):
        from charset_normalizer import from_bytes
    try:
        sample.decode("utf-8", errors="surrogatepass")
    except UnicodeDecodeError:
        pass
    else:
        raise InputError(f"{path}: it is UTF-8 with characters that do not exist: save it again")
    text = sample.decode(WESTERN, errors="replace")
    western = all(c.isascii() or c.isalpha() or c in SIGNS for c in text)
    if western and not re.search(r"[^\x00-\x7f]{3}", text):
        return WESTERN
    best = from_bytes(sample, cp_isolation=CODE_PAGES).best()
    guess = "" if best is None else f" (it may be {best.encoding})"
    raise InputError(
        f"{path}: its encoding is not clear{guess}: save it as UTF-8, or say what it is by "
        "--source long-table --option encoding=NAME"
    )


def layout_of_lines(lines: Sequence[str]) -> Layout:
    """Return the layout under the separator that makes most numbers."""
    score, layout = max((_under(lines, one) for one in SEPARATORS), key=lambda scored: scored[0])
    if score > 0:
        return _with_supplied_names(lines, layout)
    separator = max(SEPARATORS[:-1], key=lambda one: len(split_cells(lines[0], one)))
    names = tuple(split_cells(lines[0], separator))  # a header alone
    return Layout(names, separator=separator)


def _with_supplied_names(lines: Sequence[str], layout: Layout) -> Layout:
    """Return the layout of three columns without names as frame or time, x and y."""
    sign = layout.decimal
    if layout.first != 1 or len(layout.names) != 3:
        return layout
    if not all(is_number(name, sign) for name in layout.names):
        return layout
    rows = [split_cells(line, layout.separator) for line in lines[:LOOKED_AT]]
    first = [row[0].replace(sign, ".") for row in rows if row and is_number(row[0], sign)]
    steps = np.diff(np.array(first, dtype=np.float64))
    if not len(steps) or not (steps > 0).all():
        return layout
    clock = "frame" if (steps == 1).all() and all(cell.isdecimal() for cell in first) else "time"
    return replace(layout, names=(clock, "x", "y"), first=0, headless=True)


def split_cells(line: str, separator: str) -> list[str]:
    """Return the cells of one line."""
    if separator == BLANK:
        return line.split()
    try:
        return [cell.strip() for cell in next(csv.reader([line], delimiter=separator), [])]
    except csv.Error:
        return []


def is_number(cell: str, decimal: str = ".") -> bool:
    """Return whether a cell is a number to the parser."""
    if decimal == ",":
        if "." in cell:  # it might part thousands
            return False
        cell = cell.replace(",", ".")
    try:
        float(cell)
    except ValueError:
        return False
    return "_" not in cell and cell.isascii()


def bare_unit(cell: str) -> str:
    """Return the usual short form of a unit, empty if it is none of a length or time."""
    return UNIT_NAMES.get(_without_brackets(cell), "")


def _without_brackets(cell: str) -> str:
    return re.sub(r"[\[\]()]", "", cell).strip().lower()


def _under(lines: Sequence[str], separator: str) -> tuple[float, Layout]:
    """Return a score and the layout under this separator: the numbers in a usual row."""
    none = (0.0, Layout(()))
    rows = [split_cells(line, separator) for line in lines[: HEADER_LINES + LOOKED_AT]]
    counts = Counter(len(row) for row in rows[-LOOKED_AT:] if any(row))
    width = max(counts, key=lambda n: (counts[n], n), default=0)
    if width < 2:
        return none
    decimal = _decimal_sign(rows[-LOOKED_AT:], separator)

    def numbers(row: Sequence[str]) -> int:
        return sum(is_number(cell, decimal) for cell in row)

    def may_be_header(row: Sequence[str]) -> bool:  # a remark fills one or two cells
        if len(row) != width:
            return False
        return any(row[2 if width > 3 or (width == 3 and row[0]) else 0 :])

    first = next((i for i, row in enumerate(rows) if may_be_header(row) and numbers(row)), -1)
    if not 0 <= first <= HEADER_LINES:
        return none
    if first + 1 < len(rows) and _is_xy(rows[first + 1], width):  # animals that are called 1, 2
        first = next((i for i in range(first + 2, len(rows)) if numbers(rows[i])), len(rows))
    top = first
    while top > 0 and may_be_header(rows[top - 1]):
        top -= 1
    if top == first:  # the first row is damaged, or there is no header
        above = [i for i in range(first) if len(rows[i]) == width and not numbers(rows[i])]
        top, first = (above[-1], above[-1] + 1) if above else (first, first + 1)
    names, units = _names_and_units(rows[top:first], width)
    usual = [row for row in rows[first:] if len(row) == width]
    score = sum(map(numbers, usual)) / max(len(usual), 1)
    share = len(usual) / max(sum(map(any, rows[first:])), 1)
    words = [next((row[i] for row in usual if row[i]), "0") for i in range(width)]
    layout = Layout(
        names,
        units,
        separator,
        decimal,
        first,
        tuple(map(tuple, rows[:top])),
        tuple(n for n, word in zip(names, words, strict=False) if not is_number(word, decimal)),
        "" if separator == "," else _unclear_number(usual, decimal),
    )
    return score * share + 1e-3 * (first > top) - 1e-6 * SEPARATORS.index(separator), layout


def _decimal_sign(rows: Sequence[Sequence[str]], separator: str) -> str:
    """Return a comma if more cells are numbers only with it than only with a point."""
    if separator == ",":
        return "."
    cells = [cell for row in rows for cell in row]
    comma, point = (
        sum(bool(re.fullmatch(rf"[-+]?\d*[{sign}]\d+([eE][-+]?\d+)?", cell)) for cell in cells)
        for sign in ",."
    )
    return "," if comma > point else "."


def _unclear_number(rows: Sequence[Sequence[str]], decimal: str) -> str:
    """Return a number such as 1,000 whose sign may part thousands; empty if others are clear.

    A point is only doubted where whole numbers other than 0, which trackers write of lost animals,
    stand in the same column: 1.000 below 996.
    """
    thousands = re.compile(rf"[-+]?[1-9]\d{{0,2}}([{decimal}]\d{{3}})+")
    doubted = ""
    for cells in zip(*rows, strict=True):
        signed = [cell for cell in cells if decimal in cell and is_number(cell, decimal)]
        if any(not thousands.fullmatch(cell) for cell in signed):
            return ""
        whole = any(re.fullmatch(r"[-+]?\d+", cell) and int(cell) for cell in cells)
        if signed and (whole or decimal == ","):
            doubted = doubted or signed[0]
    return doubted


def _names_and_units(
    header: Sequence[Sequence[str]], width: int
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return names and units by those header rows that together tell columns apart."""
    rows, units = [list(row) for row in header], [""] * width
    if len(rows) > 1:
        words = [cell for cell in rows[-1] if not re.fullmatch(r"[\[(].*[\])]", cell)]
        bare = {*map(_without_brackets, words), *filter(None, map(bare_unit, rows[-1]))}
        if bare <= UNIT_NAMES.keys() | OTHER_UNITS and bare & UNIT_NAMES.keys():
            units = [bare_unit(cell) for cell in rows.pop()]
    if not rows:
        return (), tuple(units)
    filled = [cell for cell in rows[0] if cell]
    if len(set(filled)) == len(filled) > 1 and not (len(rows) > 1 and _is_xy(rows[-1], width)):
        return tuple(rows[0]), tuple(units)
    for row in rows[:-1]:  # a merged cell of a spreadsheet stands for those to its right
        for i in range(1, width):
            if not row[i] and rows[-1][i].lower() not in ("time", "frame"):
                row[i] = row[i - 1]
    return tuple("_".join(filter(None, cells)) for cells in zip(*rows, strict=True)), tuple(units)


def _is_xy(row: Sequence[str], width: int) -> bool:
    named = [cell.lower() for cell in row if cell]
    return len(row) == width and {"x", "y"} <= set(named) and len(named) > len(set(named))
