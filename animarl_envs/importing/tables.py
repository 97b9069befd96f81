"""Tables of text, Excel or Parquet: their names, and their columns as numbers or words.

Arrow parses all of them, and Excel's sheets once pandas has made text of them. It refuses lines of
another length, truth values among numbers, and whole numbers that no float holds.
"""

import contextlib
import csv
import datetime
import gzip
import io
import itertools
import os
import re
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from importlib import import_module
from pathlib import Path
from typing import IO, Any

import numpy as np

from animarl_envs import files
from animarl_envs.array_types import Floats, Ints
from animarl_envs.demos.episode import refusing_damage
from animarl_envs.errors import (
    InputError,
    MissingExtraError,
    SeveralFaultsError,
    refuse_rows,
    require,
    require_extra,
)
from animarl_envs.importing.table_layout import (
    BLANK,
    UTF_8,
    Layout,
    encoding_of,
    is_number,
    layout_of_lines,
    split_cells,
)
from animarl_envs.settings import LONGEST_NAME

EXTENSIONS = (
    ".csv",
    ".tsv",
    ".txt",
    ".dat",
    ".asc",
    ".tab",
    ".xlsx",
    ".xlsm",
    ".xls",
    ".parquet",
    ".pq",
    ".csv.gz",
    ".tsv.gz",
    ".txt.gz",
)
PARQUET = {".parquet", ".pq"}
PACKED = ".gz"
HEAD = 2**18  # [bytes] that are looked at
BLOCK = 2**20  # [bytes] that are parsed at once
LONGEST_LINE = 2**20
MOST_COLUMNS = 10_000
RECORDINGS = ("trial", "session", "video")  # what a table beside recordings may call them
OLD_EXCEL = bytes.fromhex("d0cf11e0a1b11ae1")
_NULLS = ["", "-", "NA", "N/A", "n/a", "NULL", "null", "None", "nan", "NaN", "#N/A", "#NA", "<NA>"]
NULLS = [" " * blanks + sign for sign in _NULLS for blanks in range(32)]
"""What stands in an empty cell; a dash in those of EthoVision."""
Progress = Callable[[float], None] | None


@dataclass(frozen=True)
class TextColumn:
    """A column of text: its different entries, sorted, and for each row the number of its own."""

    entries: list[str]
    number: Ints


@dataclass(frozen=True, kw_only=True)
class Table(Layout):
    """A table whose layout is known; its columns are read on demand.

    ``content`` is all of it as UTF-8, where it is not a file in UTF-8 as it stands; blanks between
    cells are then tabs.
    """

    path: Path
    encoding: str = UTF_8
    sheet: str | None = None
    kind: str = "text"  # or workbook, packed text, Parquet
    content: bytes | None = None

    @property
    def description(self) -> str:
        """How it was read, for messages and provenance."""
        if self.kind == "Parquet":
            return self.kind
        kind = self.kind if self.kind == "workbook" else f"{self.kind} in {self.encoding}"
        sign = {"\t": "tabs", BLANK: "blanks"}.get(self.separator, repr(self.separator))
        return f"{kind}, separator {sign}, decimal {self.decimal!r}, first row on {self.first + 1}"

    def place(self, row: int) -> str:
        """Return the name of a row (from 0) in messages: its line, or of Parquet the row."""
        if self.kind == "Parquet":
            return f"row {row + 1}"
        with contextlib.closing(self._rows()) as file:
            for line in itertools.count(self.first + 1):
                text = file.readline(LONGEST_LINE)
                row -= bool(text.strip())  # blank lines are no rows
                if row < 0 or not text:
                    return f"line {line}"
        raise AssertionError

    def first_lines(self, count: int) -> list[list[str]]:
        """Return the cells of the first lines of the file, whatever stands in them."""
        separator = "\t" if self.separator == BLANK else self.separator
        with contextlib.closing(replace(self, first=0)._rows()) as file:
            lines = [file.readline(LONGEST_LINE).decode(UTF_8) for _ in range(count)]
        return [split_cells(line.strip("\r\n"), separator) for line in lines]

    def check_names(self) -> None:
        """Refuse a first line without names, or one of too many columns."""
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
        require(
            not self._is_cut,
            f"{self.path}: the last line has no line ending and its last number is the shortest: "
            "copy the file again, or add a line ending if it is whole",
        )
        self._text([], self.names[:1], None)

    def columns(
        self,
        numbers: Sequence[str],
        words: Sequence[str] = (),
        progress: Progress = None,
        may_be_empty: Sequence[str] = (),
    ) -> tuple[dict[str, Floats], dict[str, TextColumn]]:
        """Return the named columns: numbers, empty cells NaN, and words.

        Empty words have the number -1; they are refused but in columns that ``may_be_empty``.

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
        column = read(numbers, words, progress)
        if not column.num_rows:
            raise InputError(f"{self.path}: it has a header but no rows: check the file")
        texts = {name: self._words(name, column[name], name in may_be_empty) for name in words}
        values = {name: column[name].to_numpy() for name in numbers}
        if self.names[-1] in values and self._is_cut:
            values[self.names[-1]] = np.append(values[self.names[-1]][:-1], np.nan)
        return values, texts

    def _words(self, name: str, column: Any, may_be_empty: bool) -> TextColumn:
        codes = column.combine_chunks()
        codes = codes if hasattr(codes, "dictionary") else codes.dictionary_encode()
        known = [*codes.dictionary.to_pylist(), ""]  # the last one of empty cells
        number = codes.indices.fill_null(len(known) - 1).to_numpy()
        used = np.flatnonzero(np.bincount(number, minlength=len(known)))
        texts = [str(known[code]).strip() for code in used]
        if len(longest := max(texts, key=len)) > LONGEST_NAME:
            raise InputError(
                f"{self.path}: column {name!r} has an entry of {len(longest):,} characters: give "
                f"names of at most {LONGEST_NAME}"
            )
        entries = sorted({*texts} - {""})
        places = {text: place for place, text in enumerate(entries)} | {"": -1}
        place = np.full(len(known), -1)
        place[used] = [places[text] for text in texts]
        own = place[number]
        refuse_rows(
            () if may_be_empty else np.flatnonzero(own < 0).tolist(),
            lambda row: (
                f"{self.path}: {self.place(row)} has no {name}: fill it in, or leave the row out"
            ),
        )
        return TextColumn(entries, own)

    @property
    def notes(self) -> list[str]:
        """Remarks on the file, for the report of an import."""
        notes = []
        if self.headless:
            notes.append(f"it has no line of names: taken for {', '.join(self.names)}")
        if self._is_cut:
            notes.append(
                "the last line has no line ending and its last number is the shortest, as where a "
                "copy was cut off: that number is left out"
            )
        return notes

    @cached_property
    def _is_cut(self) -> bool:
        """Whether the last number of the last line may be truncated."""
        if self.kind == "Parquet":
            return False
        with contextlib.closing(self._rows()) as file:
            start = file.tell()
            file.seek(max(start, file.seek(0, os.SEEK_END) - HEAD))
            lines = file.read().decode(errors="replace").splitlines(keepends=True)
        if not lines or lines[-1].endswith(("\n", "\r")):
            return False
        between = "\t" if self.separator == BLANK else self.separator
        cells = [split_cells(line.strip("\r\n"), between)[-1:] for line in lines[1:]]
        lengths = [len(cell[0]) for cell in cells if cell and cell[0]]
        return len(lengths) > 1 and lengths[-1] < min(lengths[:-1])

    # -- text ----------------------------------------------------------------------------------

    def _rows(self) -> IO[bytes]:
        """Open the table at its first row."""
        file: IO[bytes]
        file = self.path.open("rb") if self.content is None else io.BytesIO(self.content)
        for _ in range(self.first):
            file.readline(LONGEST_LINE)
        return file

    def _text(self, numbers: Sequence[str], words: Sequence[str], progress: Progress) -> Any:
        """Parse columns by Arrow, which refuses lines of another length than the header."""
        pyarrow, arrow = _pyarrow("csv")
        if self.unclear:
            plain, decimal = (self.unclear.replace(self.decimal, sign) for sign in ("", "."))
            raise InputError(
                f"{self.path}: {self.unclear} may be {plain} or {decimal}: write numbers without "
                f"signs between thousands, or say --option decimal={self.decimal!r} if it is the "
                "decimal sign"
            )
        wanted = [*numbers, *words]
        at = [str(self.names.index(name)) for name in wanted]
        kinds = [pyarrow.float64()] * len(numbers)
        kinds += [pyarrow.dictionary(pyarrow.int32(), pyarrow.string())] * len(words)
        positions = [str(i) for i in range(len(self.names))]
        between = "\t" if self.separator == BLANK else self.separator
        size = max(len(self.content or b"") or self.path.stat().st_size, 1)
        batches = []
        try:
            with contextlib.closing(self._rows()) as file:
                for batch in arrow.open_csv(
                    file,
                    arrow.ReadOptions(use_threads=False, block_size=BLOCK, column_names=positions),
                    arrow.ParseOptions(delimiter=between, newlines_in_values=True),
                    arrow.ConvertOptions(
                        column_types=dict(zip(at, kinds, strict=True)),
                        include_columns=at,
                        null_values=NULLS,
                        strings_can_be_null=True,
                        decimal_point=self.decimal,
                    ),
                ):
                    batches.append(batch)
                    if progress is not None:
                        progress(min(file.tell() / size, 1.0))
        except pyarrow.ArrowInvalid as error:
            if "Empty CSV file" not in str(error):
                faults = list(self._find_faults(numbers)) or [self._fault(str(error))]
                faults = [f"{self.path}: {fault}" for fault in faults]
                raise (
                    InputError(faults[0]) if len(faults) == 1 else SeveralFaultsError(faults)
                ) from None
        schema = pyarrow.schema(list(zip(at, kinds, strict=True)))
        table = pyarrow.Table.from_batches(batches, schema).unify_dictionaries()
        rows = len(table)
        while rows and not any(column[rows - 1].is_valid for column in table.columns):
            rows -= 1  # spreadsheets write empty rows at the end
        return table.slice(0, rows).rename_columns(wanted)

    def _find_faults(self, numbers: Sequence[str]) -> Iterator[str]:
        """Yield what is wrong with the lines of the table, and with the cells of its numbers."""
        between = "\t" if self.separator == BLANK else self.separator
        columns = {name: self.names.index(name) for name in numbers}
        lines = io.TextIOWrapper(self._rows(), UTF_8, errors="replace", newline="")
        with lines, contextlib.suppress(csv.Error):
            rows, begins = csv.reader(lines, delimiter=between), self.first + 1
            for cells in rows:
                line, begins = f"line {begins}", self.first + rows.line_num + 1
                if not any(cell.strip() for cell in cells):
                    continue
                if len(cells) != len(self.names):
                    yield _wrong_length(line, len(cells), len(self.names))
                    continue
                for name, at in columns.items():
                    if not self._holds_number(cells[at]):
                        yield _no_number(line, name, cells[at])

    def _holds_number(self, cell: str) -> bool:
        """Return whether a cell is empty or a number, as Arrow reads it."""
        text = cell.strip()
        if text in _NULLS:
            return True
        other = "." if self.decimal == "," else ","
        try:
            float(text.replace(self.decimal, "."))
        except ValueError:
            return False
        return not {other, "_"} & set(text)

    def _fault(self, message: str) -> str:
        """Return where and why Arrow failed, and how to fix it."""
        if bad := re.search(r"Row #(\d+): Expected \d+ columns, got (\d+)", message):
            return _wrong_length(self.place(int(bad[1]) - 1), int(bad[2]), len(self.names))
        if bad := re.search(r"column #(\d+): Row #(\d+): .* value '(.{0,40})", message, re.DOTALL):
            line, name = self.place(int(bad[2]) - 1), self.names[int(bad[1])]
            return _no_number(line, name, bad[3].removesuffix("'"))
        return f"a line cannot be read ({message.splitlines()[0][:200]}): correct it"

    # -- Parquet -------------------------------------------------------------------------------

    def _parquet(self, numbers: Sequence[str], words: Sequence[str], progress: Progress) -> Any:
        pyarrow, types = _pyarrow("types")
        with _open_parquet(self.path, words) as file:
            announced = file.metadata.num_rows
            table = file.read([*numbers, *words], use_threads=False)
        for name in (*numbers, *words):
            kind = table.schema.field(name).type
            kind = kind.value_type if types.is_dictionary(kind) else kind
            text = types.is_string(kind) or types.is_large_string(kind) or types.is_boolean(kind)
            number = types.is_integer(kind) or types.is_floating(kind)
            if not number and not (name in words and text):
                raise InputError(
                    f"{self.path}: column {name!r} is not {'text' if name in words else 'numbers'} "
                    f"(but {kind!s:.80}): name another column by an option"
                )
        try:
            table.validate(full=True)
            for name in numbers:  # what no float holds is refused
                column = table[name].cast(pyarrow.float64())
                table = table.set_column(table.schema.get_field_index(name), name, column)
        except (ValueError, NotImplementedError) as error:
            first = str(error).splitlines()[0][:160]
            raise InputError(
                f"{self.path}: column {name!r} is not numbers ({first}): name another column by an "
                "option"
            ) from None
        if len(table) != announced:
            raise InputError(
                f"{self.path}: it announces {announced} rows and holds {len(table)}: copy it again"
            )
        if progress is not None:
            progress(1.0)
        return table.unify_dictionaries()


def _wrong_length(line: str, cells: int, names: int) -> str:
    return f"{line} has {cells} cells, the header {names}: correct the line, or copy the file again"


def _no_number(line: str, name: str, cell: str) -> str:
    return (
        f"{line}, column {name!r} holds {cell[:40]!r}, which is no number: correct it, or name "
        "another column by an option"
    )


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
    """Return the table in a file, ``None`` where there is none. For sniffing."""
    with contextlib.suppress(InputError, MissingExtraError), refusing_damage(path):
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

    Of each line that is not blank its number, and its cells by column. A column of trials, sessions
    or videos is that of recordings where no other is. Raises InputError if it cannot be read, lacks
    a needed column, or has a line of another length.
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
    if "recording" not in names:
        names = ["recording" if name in RECORDINGS else name for name in names]
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
    content, kind = None, "text"
    if is_workbook(path):
        content, encoding, kind = _sheet_as_text(path, sheet), UTF_8, "workbook"
    elif path.suffix.lower() == PACKED:
        content, encoding, kind = _unpacked(path), UTF_8, "packed text"
    else:
        with path.open("rb") as file:
            head = file.read(HEAD)
        if head.startswith(OLD_EXCEL):
            raise InputError(f"{path}: it is of the old Excel format: save it as .xlsx or .csv")
        encoding = encoding or encoding_of(path)
        if encoding != UTF_8:
            content = _decoded(path, encoding)
    if content is not None:
        head = content[:HEAD]
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
    layout = layout_of_lines(lines)
    if layout.separator == BLANK:
        rows = (path.read_bytes() if content is None else content).split(b"\n")
        content = b"\n".join(b"\t".join(row.split()) for row in rows)
    return Table(
        path=path, encoding=encoding, sheet=sheet, kind=kind, content=content, **vars(layout)
    )


def clear_caches() -> None:
    """Clear the caches of open files, which may change."""
    _open_table.cache_clear()
    _read_sheets.cache_clear()


def _decoded(path: Path, encoding: str) -> bytes:
    try:
        return path.read_bytes().decode(encoding).encode()
    except (LookupError, UnicodeError) as error:
        raise InputError(f"{path}: it is no text in {encoding} ({error}): check it") from None


def _unpacked(path: Path) -> bytes:
    """Decompress a gzip file; refuse one that expands beyond the size limit."""
    most = files.allowed_bytes(path.stat().st_size)
    with gzip.open(path) as file:
        content = file.read(most + 1)
    require(len(content) <= most, f"{path}: it unpacks to more than {most:,} bytes: unpack it")
    return content


def _open_parquet(path: Path, words: Sequence[str] = ()) -> Any:
    files.refuse_special(path)
    return _pyarrow("parquet")[1].ParquetFile(
        path, read_dictionary=list(words), page_checksum_verification=True, pre_buffer=False
    )


def is_workbook(path: Path) -> bool:
    """Return whether the file is an ``.xlsx``, whatever its name."""
    return "xl/workbook.xml" in files.npz_members(path)


def sheet_names(path: Path) -> list[str]:
    """Return the sheets that hold cells, in their order."""
    return [name for name, cells in _sheets(path).items() if len(cells)]


def _sheet_as_text(path: Path, sheet: str | None) -> bytes:
    """Return the sheet as UTF-8 with tabs; all rows have equally many cells."""
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
    """Return all sheets of a workbook, as they are."""
    files.refuse_special(path)
    status = path.stat()
    return _read_sheets(path, status.st_mtime_ns, status.st_size)


@lru_cache(maxsize=1)
def _read_sheets(path: Path, changed: int, size: int) -> dict[str, Any]:
    with require_extra("reading Excel workbooks", "data"):
        import openpyxl  # noqa: F401
        import pandas
    kept: Any = {"header": None, "dtype": object, "keep_default_na": False}
    try:
        return dict(pandas.read_excel(path, sheet_name=None, engine="openpyxl", **kept))
    except MemoryError:  # of which the wall speaks
        raise
    except Exception as error:
        raise InputError(
            f"{path}: the workbook is damaged ({type(error).__name__}): save it again"
        ) from error


def _text_of(cell: Any) -> str:
    if isinstance(cell, (datetime.date, datetime.time)):
        return cell.isoformat()
    if isinstance(cell, datetime.timedelta):
        return repr(cell.total_seconds())
    return repr(cell) if isinstance(cell, float) else str(cell)


def _pyarrow(part: str) -> tuple[Any, Any]:
    """Return the package Arrow and one of its modules."""
    with require_extra("reading tables", "data"):
        return import_module("pyarrow"), import_module(f"pyarrow.{part}")


def in_natural_order(entries: list[str], numbers: Ints) -> tuple[list[str], Ints]:
    """Return the entries that occur, 2 before 10, and the place of each among them."""

    def pieces(number: int) -> list[tuple[int, int, str]]:
        parts = re.findall(r"\d+|\D+", entries[number])
        return [(0, int(part), "") if part.isdecimal() else (1, 0, part) for part in parts]

    order = sorted(np.unique(numbers).tolist(), key=pieces)
    place = np.zeros(len(entries), dtype=np.int64)
    place[order] = np.arange(len(order))
    return [entries[number] for number in order], place
