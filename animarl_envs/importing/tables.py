"""Tables of text, Excel or Parquet: their names, and their columns as numbers or words.

Pandas parses all of them. What it would read in silence as other numbers is refused before or
after: lines of another length, truth values, whole numbers that no float holds, empty names.
"""

from __future__ import annotations

import contextlib
import csv
import datetime
import gzip
import io
import itertools
import zlib
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from animarl_envs import files
from animarl_envs.checks import LONGEST_NAME
from animarl_envs.errors import InputError, MissingExtraError, require
from animarl_envs.importing.table_layout import (
    BLANK,
    UTF_8,
    Layout,
    encoding_of,
    is_number,
    layout_of_lines,
    split_cells,
)

EXTENSIONS = (
    ".csv", ".tsv", ".txt", ".dat", ".asc", ".tab", ".xlsx", ".xlsm", ".xls", ".parquet", ".pq",
    ".csv.gz", ".tsv.gz", ".txt.gz",
)  # fmt: skip
PARQUET = {".parquet", ".pq"}
PACKED = ".gz"
HEAD = 2**18  # [bytes] that are looked at
BLOCK = 2**20  # [bytes] that are checked at once
LONGEST_LINE = 2**20
MOST_COLUMNS = 10_000
OLD_EXCEL = bytes.fromhex("d0cf11e0a1b11ae1")
NO_VALUE = "-"  # of EthoVision
MISSING = {"", NO_VALUE, "NA", "N/A", "n/a", "NULL", "null", "None", "#N/A", "#NA", "<NA>"}
Progress = Callable[[float], None] | None


@dataclass(frozen=True)
class Words:
    """A column of text: its different entries, sorted, and for each row the number of its own."""

    entries: list[str]
    number: NDArray[np.int64]


@dataclass(frozen=True, kw_only=True)
class Table(Layout):
    """A table whose layout is known; its columns are read on demand."""

    path: Path
    encoding: str = UTF_8
    sheet: str | None = None
    kind: str = "text"  # or workbook, packed text, Parquet

    @property
    def parsed_separator(self) -> str:
        """Between cells as they are parsed: blanks were made tabs."""
        return "\t" if self.separator == BLANK else self.separator

    @property
    def description(self) -> str:
        """How it was read, for messages and provenance."""
        if self.kind == "Parquet":
            return self.kind
        kind = self.kind if self.kind == "workbook" else f"{self.kind} in {self.encoding}"
        sign = {"\t": "tabs", BLANK: "blanks"}.get(self.separator, repr(self.separator))
        return f"{kind}, separator {sign}, decimal {self.decimal!r}, first row on {self.first + 1}"

    def place(self, row: int) -> str:
        """Return what messages call a row, counted from 0: its line, of Parquet the row."""
        if self.kind == "Parquet":
            return f"row {row + 1}"
        with contextlib.closing(self._rows()) as file:
            for line in itertools.count(self.first + 1):
                text = file.readline(LONGEST_LINE)
                row -= bool(text.strip())  # blank lines are no rows
                if row < 0 or not text:
                    return f"line {line}"
        raise AssertionError

    def check_names(self) -> None:
        """Refuse a first line that is no header, or one of absurdly many columns."""
        if len(self.names) > MOST_COLUMNS:
            raise InputError(
                f"{self.path}: it has {len(self.names):,} columns, more than {MOST_COLUMNS:,}: cut "
                "it in parts"
            )
        if self.names and all(map(is_number, self.names)):
            raise InputError(
                f"{self.path}: its first line holds numbers, not names: put a line of names above "
                "them"
            )

    def check_lines(self) -> None:
        """Check all lines of a table that another package is going to read."""
        with contextlib.closing(self._rows()) as file:
            for _ in self._checked_blocks(file, None):
                pass

    def columns(
        self, numbers: Sequence[str], words: Sequence[str] = (), progress: Progress = None
    ) -> tuple[dict[str, NDArray[np.float64]], dict[str, Words]]:
        """Return the named columns: numbers, empty cells NaN, and words, of which none is empty.

        Raises InputError: it names the line and column of what cannot be read.
        """
        numbers = list(dict.fromkeys(numbers))
        self.check_names()
        times = Counter(self.names)
        for name in (*numbers, *words):
            if times[name] != 1:
                raise InputError(
                    f"{self.path}: it has {times[name]} columns {name!r} (header: "
                    f"{', '.join(self.names)[:200]}): name the column by an option"
                )
        read = self._parquet if self.kind == "Parquet" else self._text
        column = read(numbers, list(words), progress)
        if not column or not len(next(iter(column.values()))):
            raise InputError(f"{self.path}: it has a header but no rows: check the file")
        found = {name: self._words(name, column[name]) for name in words}
        return {name: column[name].to_numpy(np.float64) for name in numbers}, found

    def _words(self, name: str, column: Any) -> Words:
        number, entries = _pandas().factorize(column)
        if (number < 0).any():
            raise InputError(
                f"{self.path}: {self.place(int((number < 0).argmax()))} has no {name}: fill it in, "
                "or leave the row out"
            )
        texts = [str(entry) for entry in entries]
        longest = max(map(len, texts), default=0)
        if longest > LONGEST_NAME:
            raise InputError(
                f"{self.path}: column {name!r} has an entry of {longest:,} characters: give names "
                f"of at most {LONGEST_NAME}"
            )
        order = sorted(range(len(texts)), key=texts.__getitem__)
        return Words([texts[i] for i in order], np.argsort(order)[number])

    # -- text ----------------------------------------------------------------------------------

    @cached_property
    def _content(self) -> bytes | None:
        """All of it as UTF-8, where it is not a file in UTF-8 as it stands."""
        if self.kind == "workbook":
            raw = _sheet_as_text(self.path, self.sheet)
        elif self.kind == "packed text":
            raw = _unpacked(self.path)
        elif self.encoding != UTF_8:
            raw = _decoded(self.path, self.encoding)
        elif self.separator == BLANK:
            raw = self.path.read_bytes()
        else:
            return None
        if self.separator == BLANK:
            return b"\n".join(b"\t".join(line.split()) for line in raw.split(b"\n"))
        return raw

    def _rows(self) -> IO[bytes]:
        """The lines of numbers."""
        file: IO[bytes]
        file = self.path.open("rb") if self._content is None else io.BytesIO(self._content)
        for _ in range(self.first):
            file.readline(LONGEST_LINE)
        return file

    def _checked_blocks(self, file: IO[bytes], progress: Progress) -> Iterator[bytes]:
        """Blocks of whole lines, each with as many cells as the header.

        Parsers fill short lines with nothing and drop what a long line has too much. After a cut or
        a lost piece that shifts numbers into the wrong columns without a word. Separators and line
        ends inside quotes belong to the cell; blank lines count for none.
        """
        size, seen = max(len(self._content or b"") or self.path.stat().st_size, 1), 0
        line = 1 + self.first
        while block := file.read(BLOCK) + file.readline():
            parts, quotes = [block], block.count(b'"')
            while quotes % 2:
                if not (more := file.read(BLOCK) + file.readline()):
                    raise InputError(f"{self.path}: a quote is never closed: correct the file")
                parts.append(more)
                quotes += more.count(b'"')
            block = b"".join(parts)
            line += self._check_block(np.frombuffer(block, dtype=np.uint8), line, quotes > 0)
            if not block.endswith(b"\n"):
                raise files.unfinished(self.path)
            yield block
            seen += len(block)
            if progress is not None:
                progress(min(seen / size, 1.0))

    def _check_block(self, block: NDArray[np.uint8], line: int, quoted: bool) -> int:
        """Return the number of lines of a block; ``line`` is the number of the first one."""
        if (block == 0).any():
            raise InputError(f"{self.path}: it holds NUL bytes: it is no text table")
        returns = np.flatnonzero(block[:-1] == ord("\r"))
        if (block[returns + 1] != ord("\n")).any():
            raise InputError(
                f"{self.path}: a carriage return stands alone: end lines with a line feed"
            )
        inside = np.cumsum(block == ord('"')) % 2 == 1 if quoted else np.False_
        ends = np.flatnonzero((block == ord("\n")) & ~inside)
        if block[-1] != ord("\n"):
            ends = np.append(ends, len(block))
        separators = np.flatnonzero((block == ord(self.parsed_separator)) & ~inside)
        cells = np.diff(np.searchsorted(separators, ends), prepend=0) + 1
        length = np.diff(ends, prepend=-1) - 1
        length -= (block[ends - 1] == ord("\r")) & (length > 0)
        wrong = np.flatnonzero((cells != len(self.names)) & (length > 0))
        if len(wrong):
            raise InputError(
                f"{self.path}: line {line + wrong[0]} has {cells[wrong[0]]} cells, the header "
                f"{len(self.names)}: correct the line, or copy the file again"
            )
        return len(ends)

    def _text(self, numbers: list[str], words: list[str], progress: Progress) -> dict[str, Any]:
        pandas = _pandas()
        if self.unclear:
            plain, decimal = (self.unclear.replace(self.decimal, sign) for sign in ("", "."))
            raise InputError(
                f"{self.path}: {self.unclear} may be {plain} or {decimal}: write numbers without "
                f"signs between thousands, or say --option decimal={self.decimal!r} if it is the "
                "decimal sign"
            )
        at = {name: self.names.index(name) for name in (*numbers, *words)}
        kinds = {i: "category" if name in words else np.float64 for name, i in at.items()}
        try:
            with contextlib.closing(self._rows()) as file:
                frame = pandas.read_csv(
                    _Blocks(self._checked_blocks(file, progress)), names=range(len(self.names)),
                    header=None, usecols=list(at.values()), index_col=False, dtype=kinds,
                    sep=self.parsed_separator, encoding=UTF_8, skipinitialspace=True,
                    decimal=self.decimal, float_precision="round_trip",
                    na_values={at[name]: [NO_VALUE] for name in numbers},
                )  # fmt: skip
        except InputError:
            raise
        except pandas.errors.EmptyDataError:
            return {}  # a header without rows
        except ValueError as error:
            first = str(error).splitlines()[0][:200]
            self._refuse_bad_cell(numbers)
            raise InputError(f"{self.path}: a line cannot be read ({first}): correct it") from None
        # Columns of True and False alone are parsed as numbers.
        doubted = [name for name in numbers if frame[at[name]].iloc[:1000].isin([0.0, 1.0]).all()]
        self._refuse_bad_cell([name for name in doubted if frame[at[name]].isin([0.0, 1.0]).all()])
        return {name: frame[i] for name, i in at.items()}

    def _refuse_bad_cell(self, numbers: Sequence[str]) -> None:
        """Name line and column of the first cell that is no number, where one should be."""
        places = {name: self.names.index(name) for name in numbers}
        with contextlib.closing(self._rows()) as file:
            for line in itertools.count(self.first + 1):
                text = file.readline(LONGEST_LINE).decode(errors="replace")
                if not text or not places:
                    return
                cells = split_cells(text.rstrip("\r\n"), self.parsed_separator)
                for name, at in places.items():
                    cell = cells[at] if at < len(cells) else ""
                    if not (cell in MISSING or is_number(cell, self.decimal)):
                        raise InputError(
                            f"{self.path}: line {line}, column {name!r} holds {cell[:40]!r}, which "
                            "is no number: correct it, or name another column by an option"
                        )

    # -- Parquet -------------------------------------------------------------------------------

    def _parquet(self, numbers: list[str], words: list[str], progress: Progress) -> dict[str, Any]:
        import pyarrow
        from pyarrow import types

        with _open_parquet(self.path, words) as file:
            announced = file.metadata.num_rows
            arrow = file.read([*numbers, *words], use_threads=False)
        for name in (*numbers, *words):
            kind = arrow.schema.field(name).type
            kind = kind.value_type if types.is_dictionary(kind) else kind
            text = types.is_string(kind) or types.is_large_string(kind) or types.is_boolean(kind)
            number = types.is_integer(kind) or types.is_floating(kind)
            if not number and not (name in words and text):
                raise InputError(
                    f"{self.path}: column {name!r} is not {'text' if name in words else 'numbers'} "
                    f"(but {kind!s:.80}): name another column by an option"
                )
        try:
            arrow.validate(full=True)
            for name in numbers:
                at = arrow.schema.get_field_index(name)
                column = arrow.column(at).cast(pyarrow.float64())  # refuses what none holds
                arrow = arrow.set_column(at, name, column)
            frame = arrow.to_pandas()
        except (ValueError, NotImplementedError) as error:
            first = str(error).splitlines()[0][:160]
            raise InputError(
                f"{self.path}: column {name!r} is not numbers ({first}): name another column by an "
                "option"
            ) from None
        if len(frame) != announced:
            raise InputError(
                f"{self.path}: it announces {announced} rows and holds {len(frame)}: copy it again"
            )
        if progress is not None:
            progress(1.0)
        return {name: frame[name] for name in (*numbers, *words)}


class _Blocks:
    """What pandas takes for a file: it is handed one block after another."""

    def __init__(self, blocks: Iterator[bytes]) -> None:
        self._blocks = blocks

    def read(self, size: int = -1) -> bytes:
        return next(self._blocks, b"")

    def __iter__(self) -> Iterator[bytes]:
        return self._blocks


def open_table(
    path: Path, encoding: str | None = None, sheet: str | None = None, decimal: str | None = None
) -> Table:
    """Return the table in a file.

    Raises InputError if the file is no table, or it is not clear which sheet of a workbook is
    meant.
    """
    files.refuse_special(path)
    status = path.stat()
    table = _open_table(path, status.st_mtime_ns, status.st_size, encoding, sheet)
    if decimal is None:
        return table
    if decimal not in (".", ","):
        raise InputError(f"{path}: decimal is {decimal!r}: give . or ,")
    return replace(table, decimal=decimal, unclear="")


def table_or_none(path: Path, sheet: str | None = None) -> Table | None:
    """Return the table in a file, ``None`` where there is none. For sniffing: it never raises."""
    with contextlib.suppress(InputError, ImportError, OSError, LookupError, ValueError):
        return open_table(path, sheet=sheet)
    return None


def plain_table(path: Path) -> Table:
    """Return a table as programs write it: UTF-8, its names on the first line."""
    try:
        with path.open("rb") as file:
            header = file.readline(LONGEST_LINE).decode("utf-8-sig").strip("\r\n")
    except (OSError, UnicodeDecodeError):
        header = ""
    separator = ";" if ";" in header and "," not in header else ","
    separator = "\t" if path.suffix.lower() == ".tsv" else separator
    names = tuple(split_cells(header, separator))
    return Table(names, separator=separator, path=path)


def read_rows(path: Path, needed: set[str]) -> tuple[list[tuple[int, dict[str, str]]], list[str]]:
    """Return the lines of a small table beside recordings, and the names of its columns.

    Of each line that is not blank its number, and its cells by column. Raises InputError if it
    cannot be read, lacks a needed column, or has a line of another length.
    """
    files.refuse_unfinished(path)
    try:
        with path.open(newline="", encoding=encoding_of(path)) as file:
            header = file.readline()
            separator = max(",;\t", key=header.count)
            file.seek(0)
            table = [
                [cell.strip() for cell in row] for row in csv.reader(file, delimiter=separator)
            ]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"{path}: it cannot be read ({error}): check it") from None
    names = [name.lower() for name in table[0]] if table else []
    if lacking := sorted(needed - set(names)):
        raise InputError(
            f"{path}: it lacks the column {lacking[0]} (it has {', '.join(names) or 'none'}): add "
            "it"
        )
    if len(set(names)) < len(names):
        raise InputError(f"{path}: two columns have one name: rename one of them")
    rows = [(number, cells) for number, cells in enumerate(table[1:], 2) if any(cells)]
    for number, cells in rows:
        if len(cells) != len(names):
            raise InputError(
                f"{path}: line {number} has {len(cells)} cells, the header {len(names)}: correct it"
            )
    return [(number, dict(zip(names, cells, strict=True))) for number, cells in rows], names


@lru_cache(maxsize=4)
def _open_table(
    path: Path, changed: int, size: int, encoding: str | None, sheet: str | None
) -> Table:
    if path.suffix.lower() in PARQUET:
        with _open_parquet(path) as file:
            names = tuple(str(name) for name in file.schema_arrow.names)
        return Table(names, path=path, kind="Parquet")
    if is_workbook(path):
        head, encoding, kind = _sheet_as_text(path, sheet)[:HEAD], UTF_8, "workbook"
    elif path.suffix.lower() == PACKED:
        head, encoding, kind = _unpacked(path)[:HEAD], UTF_8, "packed text"
    else:
        with path.open("rb") as file:
            if file.read(len(OLD_EXCEL)) == OLD_EXCEL:
                raise InputError(f"{path}: it is of the old Excel format: save it as .xlsx or .csv")
            file.seek(0)
            encoding, kind = encoding or encoding_of(path), "text"
            head = file.read(HEAD) if encoding == UTF_8 else _decoded(path, encoding)[:HEAD]
    if b"\0" in head:
        raise InputError(f"{path}: it holds NUL bytes: it is no text table")
    lines = head.decode("utf-8-sig", errors="ignore").split("\n")
    if len(head) == HEAD and len(lines) > 1:
        lines = lines[:-1]
    lines = [line.removesuffix("\r") for line in lines]
    while lines and not lines[-1]:
        lines.pop()
    if not lines:
        raise InputError(f"{path}: it is empty: check the file")
    layout = vars(layout_of_lines(lines))
    return Table(path=path, encoding=encoding, sheet=sheet, kind=kind, **layout)


forget_tables = _open_table.cache_clear  # of files that may change, and with what they hold


def _decoded(path: Path, encoding: str) -> bytes:
    try:
        return path.read_bytes().decode(encoding).encode()
    except (LookupError, UnicodeError) as error:
        raise InputError(f"{path}: it is no text in {encoding} ({error}): check it") from None


def _unpacked(path: Path) -> bytes:
    """What a gzip file holds, refused where it is more than such a file may ask for."""
    most = files.allowed_bytes(path.stat().st_size)
    try:
        with gzip.open(path) as file:
            content = file.read(most + 1)
    except (OSError, EOFError, zlib.error) as error:
        raise InputError(f"{path}: it cannot be unpacked ({error}): copy it again") from None
    require(len(content) <= most, f"{path}: it unpacks to more than {most:,} bytes: unpack it")
    return content


def _open_parquet(path: Path, words: Sequence[str] = ()) -> Any:
    files.refuse_special(path)
    try:
        import pyarrow
        import pyarrow.parquet as parquet
    except ImportError as error:
        raise MissingExtraError("reading Parquet", "data") from error
    try:
        return parquet.ParquetFile(
            path, read_dictionary=list(words), page_checksum_verification=True, pre_buffer=False
        )
    except (pyarrow.ArrowException, OSError) as error:
        first = str(error).splitlines()[0][:160]
        raise InputError(f"{path}: the Parquet file is damaged ({first}): copy it again") from None


def is_workbook(path: Path) -> bool:
    """Whether the file is an ``.xlsx``, whatever its name."""
    return "xl/workbook.xml" in files.npz_members(path)


def sheet_names(path: Path) -> list[str]:
    """Return the sheets that hold cells, in their order."""
    return [name for name, cells in _sheets(path).items() if len(cells)]


def _sheet_as_text(path: Path, sheet: str | None) -> bytes:
    """The sheet as UTF-8 with tabs; every row as long as the longest, empty cells nothing."""
    names = sheet_names(path) if sheet is None else [sheet]
    require(
        len(names) == 1,
        f"{path}: it has {len(names)} sheets with cells ({', '.join(names)[:200]}): name "
        "one by --option sheet=NAME",
    )
    sheets = _sheets(path)
    known = ", ".join(sheets)
    require(names[0] in sheets, f"{path}: there is no sheet {names[0]!r}: choose among {known}")
    cells = sheets[names[0]].map(_text_of)
    return str(cells.to_csv(sep="\t", header=False, index=False, lineterminator="\n")).encode()


def _sheets(path: Path) -> dict[str, Any]:
    """All sheets of a workbook, as they are."""
    files.refuse_special(path)
    try:
        import openpyxl  # noqa: F401
    except ImportError as error:
        raise MissingExtraError("reading Excel workbooks", "data") from error
    try:
        return dict(
            _pandas().read_excel(
                path, sheet_name=None, header=None, dtype=object, keep_default_na=False,
                engine="openpyxl",
            )
        )  # fmt: skip
    except MemoryError:
        raise
    except Exception as error:  # whatever zipfile, the XML parser and openpyxl raise
        raise InputError(
            f"{path}: the workbook is damaged ({type(error).__name__}): save it again"
        ) from None


def _text_of(cell: Any) -> str:
    if isinstance(cell, (datetime.date, datetime.time)):
        return cell.isoformat()
    if isinstance(cell, datetime.timedelta):
        return repr(cell.total_seconds())
    return repr(cell) if isinstance(cell, float) else str(cell)


def _pandas() -> Any:
    try:
        import pandas
    except ImportError as error:
        raise MissingExtraError("reading tables", "data") from error
    return pandas
