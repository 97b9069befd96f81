"""Excel workbooks (``.xlsx``): a sheet becomes a text table with tabs, as all others are read.

Formulas count by the value that Excel saved with them. Nothing in a workbook is run.
"""

from __future__ import annotations

import contextlib
import csv
import datetime
import io
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from animarl_envs.errors import InputError, MissingExtraError
from animarl_envs.files import MOST_MEMBERS, check_size, npz_members, refuse_special

MOST_ROWS = 2**20  # of a sheet of Excel
MOST_COLUMNS = 2**14
OLD_EXCEL = bytes.fromhex("d0cf11e0a1b11ae1")


def is_workbook(path: Path) -> bool:
    """Whether the file is an ``.xlsx``, whatever its name."""
    return "xl/workbook.xml" in npz_members(path)


def refuse_old(path: Path) -> None:
    """Refuse the binary format of Excel before 2007; many a text is called ``.xls`` as well."""
    with path.open("rb") as file:
        if file.read(len(OLD_EXCEL)) == OLD_EXCEL:
            raise InputError(f"{path}: it is of the old Excel format: save it as .xlsx or .csv")


def sheet_names(path: Path) -> list[str]:
    """Of the sheets that hold cells, in their order."""
    with _opened(path) as book:
        return [str(sheet.title) for sheet in book.worksheets if _has_cells(sheet)]


def sheet_as_text(path: Path, sheet: str | None = None) -> io.BytesIO:
    """The sheet as UTF-8 with tabs; every row as long as the longest, empty cells nothing.

    Raises
    ------
    InputError
        If the workbook is damaged or asks for too much, or if which sheet is not clear.
    """
    if sheet is None:
        names = sheet_names(path)
        if len(names) != 1:
            raise InputError(
                f"{path}: it has {len(names)} sheets with cells ({', '.join(names)[:200]}): name "
                "one by --option sheet=NAME"
            )
        sheet = names[0]
    with _opened(path) as book:
        if sheet not in book.sheetnames:
            raise InputError(
                f"{path}: there is no sheet {sheet!r}: choose among {', '.join(book.sheetnames)}"
            )
        rows, width, walked = [], 0, 0
        for number, cells in enumerate(book[sheet].iter_rows(values_only=True), start=1):
            last = max((i for i, cell in enumerate(cells, 1) if cell is not None), default=0)
            width = max(width, last)
            if number > MOST_ROWS or width > MOST_COLUMNS:
                raise InputError(f"{path}: it has more rows or columns than Excel: mend it")
            walked += max(len(cells), 1)
            check_size(path, walked * 8, f"sheet {sheet}")
            rows.append([_text(cell) for cell in cells[:last]])
    text = io.StringIO(newline="")
    writer = csv.writer(text, delimiter="\t", lineterminator="\n")
    writer.writerows([*row, *[""] * (width - len(row))] for row in rows)
    return io.BytesIO(text.getvalue().encode())


@contextlib.contextmanager
def _opened(path: Path) -> Iterator[Any]:
    """An open workbook; what is raised over damage within the block becomes one sentence."""
    refuse_special(path)
    try:
        import openpyxl
    except ImportError as error:
        raise MissingExtraError("reading Excel workbooks", "data") from error
    try:
        with zipfile.ZipFile(path) as archive:
            members = archive.infolist()
            if len(members) > MOST_MEMBERS:
                raise InputError(f"{path}: it holds {len(members):,} parts: save the sheet as .csv")
            check_size(path, sum(member.file_size for member in members), "its content")
        book = openpyxl.load_workbook(path, read_only=True, data_only=True, keep_links=False)
        with contextlib.closing(book):
            yield book
    except InputError:
        raise
    except Exception as error:  # whatever zipfile, the XML parser and openpyxl raise
        raise InputError(
            f"{path}: the workbook is damaged ({type(error).__name__}): save it again"
        ) from None


def _has_cells(sheet: Any) -> bool:
    for number, cells in enumerate(sheet.iter_rows(values_only=True), start=1):
        if any(cell is not None for cell in cells):
            return True
        if number > 1000:  # rows of nothing
            break
    return False


def _text(cell: Any) -> str:
    if cell is None:
        return ""
    if isinstance(cell, (datetime.datetime, datetime.date, datetime.time)):
        return cell.isoformat()
    if isinstance(cell, datetime.timedelta):
        return repr(cell.total_seconds())
    return repr(cell) if isinstance(cell, float) else str(cell)
