"""Files that are either whole or not there."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from animarl_envs.errors import InputError


@contextmanager
def write_then_rename(path: str | Path) -> Iterator[Path]:
    """Hand out a temporary path beside ``path``; rename it to ``path`` if the block succeeds.

    An error or Ctrl-C inside the block removes the temporary file and leaves ``path`` as it was.
    The temporary name ends like ``path``, for libraries that look at the suffix.
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
        raise InputError(
            f"{path}: it cannot be written ({error.strerror}): name another place"
        ) from None
    try:
        part.chmod(0o644)
        yield part
        part.replace(path)
    except BaseException:
        part.unlink(missing_ok=True)
        raise
