"""Zip files of stable-baselines3 and replay memories: written whole or not at all, checked."""

from __future__ import annotations

import io
import json
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from stable_baselines3.common.save_util import open_path

from animarl_algos.replay.sequence_buffer import SequenceReplayBuffer
from animarl_envs.errors import InputError
from animarl_envs.files import write_then_rename

Place = str | Path | io.BufferedIOBase
SAVED_BY = "saved_by"
"""Under this name a zip file says which class, recipe and kind of values it is of."""


@contextmanager
def whole_file(path: Place, suffix: str) -> Iterator[Place]:
    """Yield where to write a file that is to be at ``path``, whole or not at all; a stream itself.

    A name without a suffix gets ``suffix``.
    """
    if not isinstance(path, (str, Path)):
        yield path
        return
    named = Path(path)
    with write_then_rename(named if named.suffix else Path(f"{path}{suffix}")) as part:
        yield part


@contextmanager
def loading(path: Place, saved_by: dict[str, Any]) -> Iterator[None]:
    """Refuse a zip file that a learner of another kind saved; say what fails as it is loaded.

    Raises
    ------
    InputError
        If it is of another recipe or another kind of values than ``saved_by``, or of no learner of
        this project, or the environment it is to learn in has other spaces.
    """
    found, name = _saved_by(path), saved_by["name"]
    if found is None:
        raise InputError(f"{path}: it is no model of {name}: load it with the class that saved it")
    if any(found.get(key) != saved_by[key] for key in ("recipe", "quantiles")):
        raise InputError(
            f"{path}: it was saved by {found['name']} and is no {name}: load it with "
            f"{found['name']}.load"
        )
    try:
        yield
    except ValueError as error:
        if "spaces do not match" not in str(error):
            raise
        raise InputError(f"{path}: {error}: give the environment it was trained in") from error


def _saved_by(path: Place) -> dict[str, Any] | None:
    """Return what a zip file says of its learner, pickles unread; None if it is no such file."""
    with _opened(path, "zip") as file:
        try:
            with zipfile.ZipFile(file) as archive:
                found = json.loads(archive.read("data"))[SAVED_BY]
        except (zipfile.BadZipFile, LookupError, TypeError, ValueError):
            return None
        finally:
            if not isinstance(path, str | Path):  # one that was given is read again
                path.seek(0)
    return found if isinstance(found, dict) else None


@contextmanager
def _opened(path: Place, suffix: str) -> Iterator[Any]:
    """Yield the file at ``path``, as stable-baselines3 finds it; one that was given stays open."""
    file = open_path(path, "r", suffix=suffix)
    try:
        yield file
    finally:
        if file is not path:
            file.close()


def save_replay(buffer: SequenceReplayBuffer, path: Place) -> None:
    """Write a replay memory as an ``npz`` archive, whatever the name of ``path``."""
    with whole_file(path, ".npz") as place:
        state = buffer.state()
        if isinstance(place, io.BufferedIOBase):
            np.savez(place, **state)
        else:
            with Path(place).open("wb") as file:
                np.savez(file, **state)


def load_replay(buffer: SequenceReplayBuffer, path: Place) -> None:
    """Read into ``buffer`` what :func:`save_replay` wrote.

    Raises
    ------
    InputError
        If it is none, or was saved with other settings.
    """
    try:
        with _opened(path, "npz") as file, np.load(file, allow_pickle=False) as arrays:
            buffer.restore(dict(arrays))
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
    except (OSError, EOFError, TypeError, ValueError, zipfile.BadZipFile) as error:
        raise InputError(
            f"{path}: this is no replay memory saved by save_replay_buffer ({error})"
        ) from error
