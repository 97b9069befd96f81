"""A piece of work: keyed by what determines it, attempted, its error recorded."""

from __future__ import annotations

import hashlib
import json
import time
import traceback
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import torch
from filelock import FileLock
from threadpoolctl import threadpool_limits

from animarl_algos.runs.run_files import versions
from animarl_envs.compiling import source_key
from animarl_envs.errors import InputError
from animarl_envs.files import write_then_rename

ERROR, LOCK = "error.json", ".piece.lock"
TERMINATED = 143  # a worker ends with it where it was told to end


class Piece(Protocol):
    """A piece of work; it may be sent to another process."""

    @property
    def name(self) -> str: ...

    @property
    def key(self) -> str: ...

    def folder(self, out: Path) -> Path:
        """Where everything of it lies."""
        ...

    def finished(self, out: Path) -> bool:
        """Whether its result is there."""
        ...

    @property
    def needs(self) -> tuple[str, ...]:
        """Names of the pieces that come first."""
        ...

    def lacks(self, out: Path) -> str:
        """What it needs and is not there; empty if it can be done."""
        ...

    def perform(self, out: Path) -> None:
        """Make the result, going on from what an earlier attempt left."""
        ...


def hashed(determining: Mapping[str, Any]) -> str:
    """A key of 16 hexadecimal digits."""
    text = json.dumps(determining, sort_keys=True, default=str)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def code() -> dict[str, Any]:
    """What decides a result beside settings and recordings: versions, and the kernels' sources."""
    return {"versions": versions(), "kernels": source_key("animarl_algos")}


@dataclass(frozen=True)
class Done:
    """How an attempt ended, and after how many seconds; ``error`` is empty where it succeeded."""

    name: str
    seconds: float
    error: str = ""


class Watch(Protocol):
    """Is told what happens."""

    def at_once(self, number: int) -> None:
        """So many pieces are done side by side."""
        ...

    def started(self, piece: Piece) -> None: ...

    def ended(self, piece: Piece, done: Done) -> None: ...


def attempt(piece: Piece, out: Path) -> Done:
    """Do a piece of work in one thread; an error is recorded in its folder, and the rest goes on.

    Warnings are kept there too: dozens of them would hide the table of what runs.
    Several commands may be at work in the same results: each piece is done by one of them.
    Ctrl-C and a signal to end go through.
    """
    folder = piece.folder(out)
    torch.set_num_threads(1)
    folder.mkdir(parents=True, exist_ok=True)
    with FileLock(folder / LOCK):
        if piece.finished(out):  # by another command, while this one waited
            return Done(piece.name, 0.0)
        if lacking := piece.lacks(out):
            record_error(piece, out, lacking)
            return Done(piece.name, 0.0, lacking)
        return _performed(piece, out)


def _performed(piece: Piece, out: Path) -> Done:
    folder, began = piece.folder(out), time.monotonic()
    (folder / ERROR).unlink(missing_ok=True)
    try:
        with threadpool_limits(1), warnings.catch_warnings(record=True) as said_by_the_way:
            piece.perform(out)
    except Exception as error:  # a failing cell is one line of the results, whatever failed
        said = str(error) if isinstance(error, InputError) else f"{type(error).__name__}: {error}"
        said = one_line(said)
        record_error(piece, out, said, traceback.format_exc())
        return Done(piece.name, time.monotonic() - began, said)
    if said_by_the_way:
        write_json(folder / "warnings.json", [str(one.message) for one in said_by_the_way])
    return Done(piece.name, time.monotonic() - began)


def one_line(text: object) -> str:
    """What somebody else's code said, without its line ends: they would end a table or a list."""
    return " ".join(str(text).split())


def record_error(piece: Piece, out: Path, said: str, where: str = "") -> None:
    write_json(piece.folder(out) / ERROR, {"error": said, "traceback": where})


def recorded_error(piece: Piece, out: Path) -> str:
    """What the last attempt failed with; empty if it did not."""
    file = piece.folder(out) / ERROR
    return str(json.loads(file.read_text())["error"]) if file.exists() else ""


def write_cost(
    folder: Path, began: float, parameters: int | None, clone: str | None = None
) -> None:
    """Processor time since ``began``; with it a piece, maybe begun as a ``clone``, is finished."""
    seconds = time.process_time() - began
    spent = {"processor_seconds": seconds, "parameters": parameters, "clone": clone}
    write_json(folder / "cost.json", spent)


def cost(folder: Path) -> dict[str, Any]:
    """What :func:`write_cost` wrote; empty if the piece is not finished."""
    file = folder / "cost.json"
    return {"clone": None} | json.loads(file.read_text()) if file.exists() else {}


def write_json(path: Path, content: Any) -> None:
    with write_then_rename(path) as part:
        part.write_text(json.dumps(content, indent=1, allow_nan=False) + "\n")
