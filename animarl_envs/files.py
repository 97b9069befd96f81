"""Files: written whole or not at all, arrays read without pickle."""

from __future__ import annotations

import shutil
import tempfile
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from animarl_envs.errors import InputError


@contextmanager
def write_then_rename(path: str | Path) -> Iterator[Path]:
    """Hand out a temporary path beside ``path``; rename it to ``path`` if the block succeeds.

    An error or Ctrl-C inside the block removes the temporary file and leaves ``path`` as it was.
    The temporary name ends like ``path``, for libraries that look at the suffix.

    Raises
    ------
    InputError
        If the file cannot be written: a full disk, a folder that is not writable.
    """
    path = Path(path)
    if path.is_dir():
        raise InputError(f"{path}: it is a folder: name a file")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(
            dir=path.parent, prefix=f".{path.stem}.", suffix=f".part{path.suffix}", delete=False
        ) as file:
            part = Path(file.name)
    except OSError as error:
        raise _unwritable(path, error) from None
    try:
        part.chmod(0o644)
        yield part
        part.replace(path)
    except OSError as error:
        raise _unwritable(path, error) from error
    finally:
        part.unlink(missing_ok=True)


@contextmanager
def all_files_or_none(folder: str | Path) -> Iterator[Path]:
    """Hand out an empty folder beside ``folder``; move its files there if the block succeeds.

    An error or Ctrl-C inside the block leaves ``folder`` as it was, with all results of before.
    Afterwards files of the same name are replaced; others that lie there stay.

    Raises
    ------
    InputError
        If ``folder`` is a file, or something cannot be written: a full disk, no permission.
    """
    folder = Path(folder)
    if folder.exists() and not folder.is_dir():
        raise InputError(f"{folder}: it is a file: name a folder")
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        part = Path(tempfile.mkdtemp(dir=folder.parent, prefix=f".{folder.name}.", suffix=".part"))
    except OSError as error:
        raise _unwritable(folder, error) from None
    try:
        yield part
        for file in sorted(path for path in part.rglob("*") if path.is_file()):
            place = folder / file.relative_to(part)
            place.parent.mkdir(parents=True, exist_ok=True)
            file.replace(place)
    except OSError as error:
        raise _unwritable(folder, error) from error
    finally:
        shutil.rmtree(part, ignore_errors=True)


def unreadable_or_unwritable(error: OSError) -> str:
    """What to say of a file where nobody nearer knew better."""
    where = f"{error.filename}: " if error.filename else ""
    return (
        f"{where}a file cannot be read or written ({error.strerror or error}): make room, or see "
        "to its permissions"
    )


def _unwritable(path: Path, error: OSError) -> InputError:
    return InputError(
        f"{path}: it cannot be written ({error.strerror or error}): make room or name another place"
    )


def read_npz(path: Path) -> dict[str, NDArray[Any]]:
    """All arrays of an ``.npz`` without pickle, or one sentence that says why not."""
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as archive:
            if not isinstance(archive, np.lib.npyio.NpzFile):
                raise InputError(
                    f"{path}: it is a single array, not an npz archive: save it with np.savez"
                )
            return {key: archive[key] for key in archive.files}
    except InputError:
        raise
    except FileNotFoundError:
        raise InputError(f"{path}: there is no such file: check the path") from None
    except IsADirectoryError:
        raise InputError(f"{path}: it is a folder: name a file in it") from None
    except (zipfile.BadZipFile, EOFError, OSError, zipfile.LargeZipFile) as error:
        raise InputError(
            f"{path}: the archive is damaged or cut short ({error}): copy it again"
        ) from None
    except ValueError as error:
        if "pickle" in str(error).lower():
            raise InputError(
                f"{path}: it is not a plain npz archive or holds a pickle, which is never opened "
                "here: save plain arrays with np.savez"
            ) from None
        raise InputError(
            f"{path}: it cannot be read ({error}): save it again with np.savez"
        ) from None
