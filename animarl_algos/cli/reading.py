"""What commands read and write: demonstrations by file or name, splits, tables."""

from __future__ import annotations

import csv
import re
import shlex
from collections.abc import Collection, Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from animarl_envs.demos import Demonstrations
from animarl_envs.demos.episode import SPLITS
from animarl_envs.demos.packaged import load_packaged, packaged_names
from animarl_envs.errors import InputError
from animarl_envs.files import write_then_rename
from animarl_envs.importing.readers import read

ALL = "all"
SOURCE = "--source"
OPTION = re.compile(r"(?<![\w-])--[a-z][a-z-]*")


def load(file: str, source: str | None = None, *, takes: Collection[str] = ()) -> Demonstrations:
    """A packaged set by name, or a file; ``takes`` as of :func:`suggest_import_on_error`."""
    path = Path(file)
    if file in packaged_names() and not path.exists():
        return load_packaged(file)
    if not path.exists():
        raise InputError(
            f"{file}: there is no such file, and packaged are {', '.join(packaged_names())}: check "
            "the path"
        )
    with suggest_import_on_error(file, takes):
        return read(file, source)


@contextmanager
def suggest_import_on_error(file: str | Path, takes: Collection[str] = ()) -> Iterator[None]:
    """Where a file is refused, say how ``animarl import`` reads it.

    Readers name options of that command; those in ``takes`` the command at hand has too.
    """
    try:
        yield
    except InputError as error:
        said = str(error)
        lacking = [name for name in dict.fromkeys(OPTION.findall(said)) if name not in takes]
        if not lacking or "animarl " in said:
            raise
        place = "" if said.startswith(str(file)) else f"{file}: "
        options = " ".join(f"{name} ..." for name in lacking)
        raise InputError(
            f"{place}{said}, as in 'animarl import {shlex.quote(str(file))} {options} --out "
            "demos.npz', and take what that writes"
        ) from None


def named_split(split: str) -> str | None:
    """What ``--split`` names; ``None``: all episodes."""
    if split not in (*SPLITS, ALL):
        raise InputError(f"--split is {split!r}: choose one of {', '.join((*SPLITS, ALL))}")
    return None if split == ALL else split


def refuse_overwriting(out: Path, *read_from: str | Path) -> None:
    """Refuse to write a result over a file that it is made from."""
    for file in map(Path, read_from):
        if out.exists() and file.exists() and out.samefile(file):
            raise InputError(f"{out}: it is the file that is read: name another --out")


def write_csv(out: Path, rows: Iterable[Mapping[str, object]]) -> None:
    """Write a table of at least one row; None is an empty cell."""
    with write_then_rename(out) as part, part.open("w", newline="") as file:
        for number, row in enumerate(rows):
            if number == 0:
                writer = csv.DictWriter(file, list(row))
                writer.writeheader()
            writer.writerow(row)
