"""What readers share: rows without a name, and libraries that trip over a damaged file."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from animarl_envs.checks import LONGEST_NAME, printable
from animarl_envs.errors import InputError, MissingExtraError

Place = Callable[[int], str]  # what messages call a row, counted from 0


def row_of(row: int) -> str:
    """What messages call a row, counted from 0, where lines are not known."""
    return f"row {row + 1}"


def refuse_empty(
    path: Path, column: str, empty: NDArray[np.bool_], first_row: int, place: Place = row_of
) -> None:
    """Refuse a table whose text ``column`` is empty somewhere."""
    if empty.any():
        raise InputError(
            f"{path}: {place(first_row + int(empty.argmax()))} has no {column}: fill it in, or "
            "leave the row out"
        )


def refuse_long(path: Path, column: str, length: int) -> None:
    """Refuse a table whose text ``column`` has an entry of more characters than a name has."""
    if length > LONGEST_NAME:
        raise InputError(
            f"{path}: column {column!r} has an entry of {length:,} characters: give names of at "
            f"most {LONGEST_NAME}"
        )


@contextlib.contextmanager
def naming(files: Mapping[str, Path]) -> Iterator[None]:
    """Put the file before what is said of a recording, each by its name."""
    try:
        yield
    except InputError as error:
        for recording, file in files.items():
            if str(error).startswith((f"{recording}: ", f"{recording}, ")):
                raise InputError(f"{file}: {error}") from None
        raise


@contextlib.contextmanager
def refusing(path: Path, source: str) -> Iterator[None]:
    """Turn what a library raises over a damaged file into one sentence."""
    try:
        yield
    except MissingExtraError:
        raise
    except InputError as error:
        if printable(str(path)) in str(error):
            raise
        raise InputError(f"{path}: {error}") from None
    except MemoryError:
        raise InputError(
            f"{path}: reading it as {source} needs more memory than there is: cut it in parts"
        ) from None
    except IsADirectoryError:
        raise InputError(f"{path}: it is a folder: name a file in it") from None
    except Exception as error:
        first = (str(error).strip() or type(error).__name__).splitlines()[0][:200]
        raise InputError(
            f"{path}: it cannot be read as {source} ({type(error).__name__}: {first}): "
            "check --source, or copy the file again"
        ) from error
