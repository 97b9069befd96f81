"""Columns of CSV, TSV and Parquet files, in pieces, so that large tables fit in memory."""

from __future__ import annotations

import contextlib
import csv
import io
import itertools
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from animarl_envs.errors import InputError, MissingExtraError
from animarl_envs.files import refuse_special
from animarl_envs.importing.readers.encodings import UTF_8
from animarl_envs.importing.readers.guards import refuse_empty, refuse_long, row_of
from animarl_envs.importing.readers.layouts import (
    LONGEST_LINE,
    Layout,
    is_number,
    refuse_unclear_numbers,
    split_cells,
)
from animarl_envs.importing.readers.lines import BLOCK, CheckedLines
from animarl_envs.importing.readers.parquet import is_parquet, parquet_names, parquet_pieces

PIECE_ROWS = 500_000
MOST_COLUMNS = 10_000
NO_VALUE = "-"  # of EthoVision
MISSING = {"", NO_VALUE, "NA", "N/A", "n/a", "NULL", "null", "None", "#N/A", "#NA", "<NA>"}
_SWALLOWED = "Calling read(nbytes) on source failed"
"""What pandas makes of Ctrl-C while it asks for more; errors of the source come through as such."""


def first_line(path: Path) -> str:
    """First line of a text file, empty if it is not text."""
    try:
        with path.open("rb") as file:
            line = file.readline(LONGEST_LINE)
        return line.decode("utf-8-sig").strip("\r\n")
    except (OSError, UnicodeDecodeError):
        return ""


def separator_of(path: Path) -> str:
    """Tab in a ``.tsv``; else comma, or semicolon where the header has only those."""
    if path.suffix.lower() == ".tsv":
        return "\t"
    header = first_line(path)
    return ";" if ";" in header and "," not in header else ","


def column_names(path: Path) -> list[str]:
    """Names in the header of a table; none where it cannot be read."""
    if is_parquet(path):
        return parquet_names(path)
    try:
        cells = next(csv.reader([first_line(path)], delimiter=separator_of(path)), [])
    except csv.Error:
        return []
    return [name.strip() for name in cells]


def check_header(path: Path, header: Sequence[str]) -> None:
    """Refuse a first line that is no header, or one of absurdly many columns."""
    if len(header) > MOST_COLUMNS:
        raise InputError(
            f"{path}: it has {len(header):,} columns, more than {MOST_COLUMNS:,}: cut it in parts"
        )
    if header and all(is_number(name) for name in header):
        raise InputError(
            f"{path}: its first line holds numbers, not names: put a line of names above them"
        )


def numbered(texts: NDArray[Any]) -> tuple[list[str], NDArray[np.int64]]:
    """The different texts in their order, and for each entry the number of its own.

    An array of fixed-width text, which NumPy would sort, is as wide as the longest one in all rows.
    """
    codes, found = _pandas().factorize(texts, sort=True)
    return [str(text) for text in found], codes.astype(np.int64)


def pieces(
    path: Path,
    columns: Sequence[str],
    text: Sequence[str] = (),
    progress: Callable[[float], None] | None = None,
    layout: Layout | None = None,
) -> Iterator[dict[str, NDArray[Any]]]:
    """The named columns, ``PIECE_ROWS`` rows at a time.

    Numbers are float64, empty cells NaN; ``text`` columns are strings and must not be empty.
    Without a ``layout`` a text is UTF-8, and its first line the header.
    """
    if is_parquet(path):
        yield from parquet_pieces(path, columns, text, PIECE_ROWS, progress)
    else:
        yield from _text_pieces(path, columns, text, progress, layout or plain_layout(path))


def line_of(path: Path, layout: Layout, row: int) -> str:
    """What messages call a row of numbers, counted from 0: its line, of Parquet the row."""
    if is_parquet(path):
        return row_of(row)
    line = layout.first
    with contextlib.closing(layout.open(path)) as file:
        while row >= 0 and (text := file.readline(LONGEST_LINE)):
            line += 1
            row -= bool(text.strip())  # blank lines are no rows
    return f"line {line}"


def plain_layout(path: Path) -> Layout:
    """Of a table as programs write it: UTF-8, its names on the first line."""
    names = tuple(column_names(path))
    return Layout(names, ("",) * len(names), separator_of(path))


def read_columns(
    path: Path, columns: Sequence[str], text: Sequence[str] = ()
) -> dict[str, NDArray[Any]]:
    """All rows of the named columns."""
    parts = list(pieces(path, columns, text))
    if not parts or not sum(len(part[columns[0]]) for part in parts):
        raise InputError(f"{path}: it has a header but no rows: check the file")
    return {name: np.concatenate([part[name] for part in parts]) for name in columns}


def _text_pieces(
    path: Path,
    columns: Sequence[str],
    text: Sequence[str],
    progress: Callable[[float], None] | None,
    layout: Layout,
) -> Iterator[dict[str, NDArray[Any]]]:
    pandas = _pandas()
    refuse_special(path)
    refuse_unclear_numbers(path, layout)
    header, separator = layout.names, layout.parsed_separator
    check_header(path, header)
    times = Counter(header)
    for name in columns:
        if times[name] != 1:
            raise InputError(
                f"{path}: it has {times[name]} columns {name!r} (header: "
                f"{', '.join(header)[:200]}): name the column by an option"
            )
    where = {name: at for at, name in enumerate(header)}
    place = {name: where[name] for name in columns}
    kinds = {at: str if name in text else np.float64 for name, at in place.items()}
    numbers = [at for at, kind in kinds.items() if kind is np.float64]
    size, row = max(path.stat().st_size, 1), 0
    try:
        with contextlib.closing(layout.open(path)) as file:
            lines = CheckedLines(file, path, separator, len(header), layout.first)
            with pandas.read_csv(
                io.BufferedReader(lines, BLOCK), names=range(len(header)), header=None,
                usecols=list(kinds), index_col=False, dtype=kinds, chunksize=PIECE_ROWS,
                skipinitialspace=True, sep=separator, decimal=layout.decimal, encoding=UTF_8,
                float_precision="round_trip", na_values={at: [NO_VALUE] for at in numbers},
            ) as reader:  # fmt: skip
                for piece in reader:
                    for name in text:
                        empty = piece[place[name]].isna().to_numpy()
                        refuse_empty(path, name, empty, row, partial(line_of, path, layout))
                        lengths = piece[place[name]].str.len()
                        refuse_long(path, name, int(lengths.max()) if len(piece) else 0)
                    for name in (name for name in columns if name not in text):
                        if piece[place[name]].isin([0.0, 1.0]).all():  # as truth values are parsed
                            _refuse_bad_cell(path, layout, {name: place[name]})
                    row += len(piece)
                    yield {name: piece[at].to_numpy() for name, at in place.items()}
                    if progress is not None:
                        progress(min(lines.seen / size, 1.0))
        if progress is not None:
            progress(1.0)
    except InputError:
        raise
    except pandas.errors.EmptyDataError:
        return  # a header without rows
    except (ValueError, UnicodeDecodeError, pandas.errors.ParserError) as error:
        first = str(error).splitlines()[0][:200]
        if _SWALLOWED in first:
            raise KeyboardInterrupt from None
        wanted = {name: at for name, at in place.items() if at in numbers}
        _refuse_bad_cell(path, layout, wanted)
        raise InputError(f"{path}: a line cannot be read ({first}): correct it") from None


def _refuse_bad_cell(path: Path, layout: Layout, numbers: Mapping[str, int]) -> None:
    """Name line and column of the first cell that is no number, where one should be."""
    with contextlib.closing(layout.open(path)) as file:
        for line in itertools.count(layout.first + 1):
            text = file.readline(LONGEST_LINE).decode(errors="replace")
            if not text:
                return
            cells = split_cells(text.rstrip("\r\n"), layout.parsed_separator)
            for name, at in numbers.items():
                cell = cells[at] if at < len(cells) else ""
                if not (cell in MISSING or is_number(cell, layout.decimal)):
                    raise InputError(
                        f"{path}: line {line}, column {name!r} holds {cell[:40]!r}, which is no "
                        "number: correct it, or name another column by an option"
                    )


def _pandas() -> Any:
    try:
        import pandas
    except ImportError as error:
        raise MissingExtraError("reading tables", "data") from error
    return pandas
