"""Readers by the software that wrote the file: registered by name, found by looking at the file."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.errors import InputError

ReadFunction = Callable[..., Demonstrations]
SniffFunction = Callable[[Path], bool]


@dataclass(frozen=True)
class Reader:
    """One source of recorded episodes.

    ``sniff`` says from a look at the file whether it is of this source; it never raises. ``read``
    takes the path and the reader's own options.
    """

    name: str
    description: str
    extensions: tuple[str, ...]
    sniff: SniffFunction
    read: ReadFunction


_READERS: dict[str, Reader] = {}


def register_reader(
    name: str, description: str, sniff: SniffFunction, extensions: Sequence[str]
) -> Callable[[ReadFunction], ReadFunction]:
    """Decorator: make a function ``read(path, **options) -> Demonstrations`` known by ``name``."""

    def register(function: ReadFunction) -> ReadFunction:
        if name in _READERS:
            raise ValueError(f"reader {name!r} is registered twice")
        _READERS[name] = Reader(name, description, tuple(extensions), sniff, function)
        return function

    return register


def available_readers() -> tuple[Reader, ...]:
    """All registered readers, by name."""
    return tuple(_READERS[name] for name in sorted(_READERS))


def read(path: str | Path, source: str | None = None, **options: Any) -> Demonstrations:
    """Read demonstrations from a file.

    Parameters
    ----------
    path
        The file.
    source
        Name of the reader; by default the file is looked at to find it.
    options
        Handed to the reader.

    Raises
    ------
    InputError
        If the file is missing, of no known source, or refused by its reader.
    """
    path = Path(path)
    if not path.exists():
        raise InputError(f"{path}: there is no such file: check the path")
    if source is not None:
        return get_reader(source).read(path, **options)
    for reader in available_readers():
        if path.name.lower().endswith(reader.extensions) and reader.sniff(path):
            return reader.read(path, **options)
    raise InputError(
        f"{path}: no reader recognises it: name its --source "
        f"({', '.join(reader.name for reader in available_readers())})"
    )


def get_reader(name: str) -> Reader:
    """The reader of that name, or one sentence that lists the names."""
    try:
        return _READERS[name]
    except KeyError:
        raise InputError(
            f"source {name!r} is unknown: choose one of "
            f"{', '.join(reader.name for reader in available_readers())}"
        ) from None
