"""Columns of Parquet files, in pieces; refused before allocation where the header is absurd.

A text is kept once in a dictionary, however many rows refer to it, and stays there until it is
known to be short: written out, a few hundred kilobytes of it can become gigabytes.
"""

from __future__ import annotations

import importlib
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from animarl_envs.errors import InputError, MissingExtraError
from animarl_envs.files import check_size, refuse_special
from animarl_envs.importing.readers.guards import refuse_empty, refuse_long

SUFFIXES = {".parquet", ".pq"}
BUFFER = 2**20  # [bytes] read at a time from each column
MOST_COLUMNS = 10_000
BATCH = 65_536  # rows at a time


def is_parquet(path: Path) -> bool:
    """By the suffix."""
    return path.suffix.lower() in SUFFIXES


def parquet_names(path: Path) -> list[str]:
    """Names of the columns; none where the file is damaged."""
    try:
        with _open(path) as file:
            return [str(name) for name in file.schema_arrow.names]
    except (InputError, OSError, ValueError):  # pyarrow's own errors are of these two kinds
        return []


def parquet_pieces(
    path: Path,
    columns: Sequence[str],
    text: Sequence[str],
    rows: int,
    progress: Callable[[float], None] | None,
) -> Iterator[dict[str, NDArray[Any]]]:
    """The named columns, at most ``rows`` rows at a time, one row group after the other.

    Numbers become float64 (empty ones NaN), an integer too large for that is refused; ``text``
    columns may be of text or numbers and become text.
    """
    with _open(path) as file:
        names = [str(name) for name in file.schema_arrow.names]
        times = Counter(names)
        for name in columns:
            if times[name] != 1:
                raise InputError(
                    f"{path}: it has {times[name]} columns {name!r} "
                    f"({', '.join(names)[:200]}): name the column by an option"
                )
            _check_type(path, name, file.schema_arrow.field(name).type, as_text=name in text)
        _check_sizes(path, file, len(columns))
        packed = [name for name in text if _is_text(file.schema_arrow.field(name).type)]
    with _open(path, packed) as file:
        read, total = 0, max(file.metadata.num_rows, 1)
        size = min(rows, BATCH)
        for batch in file.iter_batches(batch_size=size, columns=list(columns), use_threads=False):
            for name in text:
                refuse_empty(path, name, batch.column(name).is_null().to_numpy(False), read)
            yield {
                name: _values(path, name, batch.column(name), as_text=name in text)
                for name in columns
            }
            read += batch.num_rows
            if progress is not None:
                progress(min(read / total, 1.0))
        if read != file.metadata.num_rows:
            raise InputError(
                f"{path}: it announces {file.metadata.num_rows} rows and holds {read}: "
                "copy the file again"
            )


def _check_type(path: Path, name: str, kind: Any, *, as_text: bool) -> None:
    """Refuse a column of lists, records, dates and the like, before any of it is read."""
    types = _library("pyarrow.types")
    if types.is_dictionary(kind):
        kind = kind.value_type
    number = types.is_integer(kind) or types.is_floating(kind)
    if not number and not (as_text and (_is_text(kind) or types.is_boolean(kind))):
        raise InputError(
            f"{path}: column {name!r} is not {'text' if as_text else 'numbers'} (but {kind!s:.80}):"
            " name another column by an option"
        )


def _is_text(kind: Any) -> bool:
    types = _library("pyarrow.types")
    return bool(types.is_string(kind) or types.is_large_string(kind))


def _check_sizes(path: Path, file: Any, columns: int) -> None:
    size = path.stat().st_size
    check_size(path, max(file.metadata.num_rows, 0) * 8 * columns, "its rows")
    total = 0
    for group in range(file.metadata.num_row_groups):
        chunks = file.metadata.row_group(group)
        for index in range(chunks.num_columns):
            chunk = chunks.column(index)
            total += max(chunk.total_uncompressed_size, 0)
            check_size(path, total, "its columns")
            if not 0 <= chunk.total_compressed_size <= size:
                raise InputError(
                    f"{path}: a column announces {chunk.total_compressed_size:,} bytes, the file "
                    f"has {size:,}: copy it again"
                )


def _values(path: Path, name: str, column: Any, *, as_text: bool) -> NDArray[Any]:
    arrow, compute = _library("pyarrow"), _library("pyarrow.compute")
    if hasattr(column, "dictionary"):
        if as_text and _is_text(column.dictionary.type):
            longest = compute.max(compute.utf8_length(column.dictionary)).as_py() or 0
            refuse_long(path, name, longest)
        column = column.dictionary_decode()
    kind = arrow.string() if as_text else arrow.float64()
    try:
        column.validate(full=True)  # offsets and text are as the file has them
        values = compute.cast(column, kind)
    except (ValueError, NotImplementedError) as error:
        first = str(error).splitlines()[0][:160]
        raise InputError(
            f"{path}: column {name!r} is not {'text' if as_text else 'numbers'} ({first}): "
            "name another column by an option"
        ) from None
    return np.asarray(values.to_numpy(zero_copy_only=False))


def _open(path: Path, packed: Sequence[str] = ()) -> Any:
    """``packed`` are text columns whose dictionary is kept."""
    refuse_special(path)
    parquet = _library("pyarrow.parquet")
    limit = path.stat().st_size  # no text or list in the header is longer than the file
    file = parquet.ParquetFile(
        path,
        buffer_size=BUFFER,
        pre_buffer=False,
        read_dictionary=list(packed),
        page_checksum_verification=True,  # where the writer made checksums
        thrift_string_size_limit=max(limit, 1),
        thrift_container_size_limit=max(limit, 1),
    )
    if file.metadata.num_columns > MOST_COLUMNS:
        file.close()
        raise InputError(
            f"{path}: it has {file.metadata.num_columns:,} columns, more than {MOST_COLUMNS:,}: "
            "cut it in parts"
        )
    return file


def _library(name: str) -> Any:
    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise MissingExtraError("reading Parquet", "data") from error
