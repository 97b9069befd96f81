"""Columns of CSV and Parquet files, in pieces, so that large tables fit in memory."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from animarl_envs.errors import InputError, MissingExtraError

PIECE_ROWS = 500_000
LONGEST_LINE = 65536


def first_line(path: Path) -> str:
    """First line of a text file without quotes, empty if it is not text."""
    try:
        with path.open("rb") as file:
            line = file.readline(LONGEST_LINE)
        return line.decode("utf-8-sig").strip().replace('"', "")
    except (OSError, UnicodeDecodeError):
        return ""


def pieces(
    path: Path,
    columns: Sequence[str],
    text: Sequence[str] = (),
    progress: Callable[[float], None] | None = None,
    separator: str = ",",
) -> Iterator[dict[str, NDArray[Any]]]:
    """The named columns, ``PIECE_ROWS`` rows at a time; numbers as float64, empty cells as NaN."""
    if path.suffix.lower() in {".parquet", ".pq"}:
        yield from _parquet_pieces(path, columns, text, progress)
        return
    pandas = _pandas()
    header = [name.strip() for name in first_line(path).split(separator)]
    for name in columns:
        if header.count(name) != 1:
            raise InputError(
                f"{path}: it has {header.count(name)} columns {name!r} (header: "
                f"{', '.join(header)[:200]}): name the column by an option"
            )
    kinds = {name: str if name in text else np.float64 for name in columns}
    size = max(path.stat().st_size, 1)
    try:
        with (
            path.open("rb") as file,
            pandas.read_csv(
                file, usecols=list(columns), dtype=kinds, chunksize=PIECE_ROWS,
                skipinitialspace=True, keep_default_na=True, sep=separator, encoding="utf-8-sig",
            ) as reader,
        ):  # fmt: skip
            for piece in reader:
                yield {name: piece[name].to_numpy() for name in columns}
                if progress is not None:
                    progress(min(file.tell() / size, 1.0))
    except (ValueError, UnicodeDecodeError, pandas.errors.ParserError) as error:
        first = str(error).splitlines()[0][:200]
        raise InputError(f"{path}: a cell or line cannot be read ({first}): mend it") from None


def read_columns(
    path: Path, columns: Sequence[str], text: Sequence[str] = ()
) -> dict[str, NDArray[Any]]:
    """All rows of the named columns."""
    parts = list(pieces(path, columns, text))
    if not parts or not sum(len(part[columns[0]]) for part in parts):
        raise InputError(f"{path}: it has a header but no rows: check the file")
    return {name: np.concatenate([part[name] for part in parts]) for name in columns}


def column_names(path: Path, separator: str = ",") -> list[str]:
    """Names in the header of a CSV or Parquet file."""
    if path.suffix.lower() in {".parquet", ".pq"}:
        return [str(name) for name in _parquet(path).schema_arrow.names]
    return [name.strip() for name in first_line(path).split(separator)]


def _parquet_pieces(
    path: Path,
    columns: Sequence[str],
    text: Sequence[str],
    progress: Callable[[float], None] | None,
) -> Iterator[dict[str, NDArray[Any]]]:
    file = _parquet(path)
    names = file.schema_arrow.names
    for name in columns:
        if name not in names:
            raise InputError(
                f"{path}: it has no column {name!r} ({', '.join(names)[:200]}): "
                "name the column by an option"
            )
    rows, total = 0, max(file.metadata.num_rows, 1)
    for batch in file.iter_batches(batch_size=PIECE_ROWS, columns=list(columns)):
        piece = {}
        for name in columns:
            values = batch.column(name).to_numpy(zero_copy_only=False)
            piece[name] = values.astype(str if name in text else np.float64)
        rows += batch.num_rows
        yield piece
        if progress is not None:
            progress(rows / total)


def _parquet(path: Path) -> Any:
    try:
        parquet = importlib.import_module("pyarrow.parquet")
    except ImportError as error:
        raise MissingExtraError("reading Parquet", "data") from error
    return parquet.ParquetFile(path)


def _pandas() -> Any:
    try:
        import pandas
    except ImportError as error:
        raise MissingExtraError("reading tables", "data") from error
    return pandas
