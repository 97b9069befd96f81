"""What readers share: rows without a name, and libraries that trip over a damaged file."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from animarl_envs.checks import LONGEST_NAME
from animarl_envs.errors import InputError, MissingExtraError


def refuse_empty(path: Path, column: str, empty: NDArray[np.bool_], first_row: int) -> None:
    """Refuse a table whose text ``column`` is empty somewhere; rows are counted from 1."""
    if empty.any():
        raise InputError(
            f"{path}: row {first_row + int(empty.argmax()) + 1} has no {column}: fill it in, or "
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
def refusing(path: Path, source: str) -> Iterator[None]:
    """Turn what a library raises over a damaged file into one sentence."""
    try:
        yield
    except (InputError, MissingExtraError):
        raise
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
