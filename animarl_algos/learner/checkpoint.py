"""Checkpoints, models and replay memories on disk: written whole or not at all, checked when read.

From a checkpoint a run goes on exactly: same weights as if it had never been stopped (CPU).

A checkpoint is one archive of arrays: ``model``, the bytes of online and target networks,
optimiser, best weights of the offline phase and torch's random state (tensors only, read with
``weights_only=True``); ``replay/...``, the replay memory with its open episodes; ``run/...``, last
observations, recurrent states, the running worlds; and ``state``, JSON with counters, schedules,
NumPy's and Python's random states, and what it belongs to.

It is written under a temporary name, flushed to disk, then renamed over the one before. A kill at
any moment, a full disk or an unwritable folder leaves the last one whole. Checkpoints are taken
between updates only (``boundary_hooks`` of a learner), never within a step.
"""

import io
import json
import os
import random
import textwrap
import zipfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3.common.save_util import open_path

from animarl_algos.replay.sequence_buffer import SequenceReplayBuffer
from animarl_envs.errors import InputError
from animarl_envs.files import read_regular, refuse_special, write_then_rename

FORMAT = 3
FILE = "checkpoint.npz"
LARGEST_WEIGHTS = 2**31  # [bytes]

State = tuple[dict[str, Any], dict[str, NDArray[Any]], dict[str, Any]]
"""All that a learner needs to go on exactly, but its replay memory: counters (JSON-like), arrays
(the environment's state and the running episodes'), tensors (the weights)."""
Place = str | Path | io.BufferedIOBase
SAVED_BY = "saved_by"
"""Under this name a zip file says which class, recipe and kind of values it is of."""


def latest_checkpoint(folder: str | Path) -> Path | None:
    """Return the checkpoint in ``folder``, or None."""
    file = Path(folder) / FILE
    return file if file.exists() else None


def steps_done(checkpoint: Path) -> int:
    """Return the world steps that a run had done at a checkpoint."""
    with _opened_checkpoint(checkpoint) as (state, _):
        return int(state["counters"]["num_timesteps"])


def save_checkpoint(model: Any, folder: str | Path) -> Path:
    """Write a checkpoint of ``model`` into ``folder``, in place of the one before.

    Raises InputError if it cannot be written; what was there before is untouched.
    """
    counters, arrays, tensors = model.training_state()
    tensors = tensors | {"torch_random_state": torch.get_rng_state()}
    generator, keys, *rest = np.random.get_state()  # noqa: NPY002
    state = {
        "format": FORMAT,
        "identity": model.identity(),
        "counters": counters,
        "numpy_random_state": [generator, np.asarray(keys).tolist(), *rest],
        "python_random_state": random.getstate(),
    }
    parts: dict[str, Any] = {f"run/{name}": array for name, array in arrays.items()}
    if model.replay_buffer is not None:
        parts |= {f"replay/{name}": value for name, value in model.replay_buffer.state().items()}
    parts["model"] = np.frombuffer(serialise_tensors(tensors), dtype=np.uint8)
    target = Path(folder) / FILE
    with write_then_rename(target) as part, part.open("wb") as file:
        np.savez(file, state=np.array(json.dumps(state)), **parts)
        file.flush()
        os.fsync(file.fileno())
    return target


def serialise_tensors(tensors: dict[str, Any]) -> bytes:
    """Return the bytes of ``torch.save``, which itself fails with a RuntimeError on a full disk."""
    stream = io.BytesIO()
    torch.save(tensors, stream)
    return stream.getvalue()


def load_tensors(file: Path) -> Any:
    """Return the tensors in a file, whose checksums are compared (torch does not).

    Raises OSError if the file cannot be read. Raises ValueError if it is damaged, or holds more
    than tensors and plain values.
    """
    return _tensors_of(read_regular(file, LARGEST_WEIGHTS), file.name)


def _tensors_of(raw: bytes, name: str) -> Any:
    content = io.BytesIO(raw)
    try:
        with zipfile.ZipFile(content) as archive:
            changed = archive.testzip()
        if changed is None:
            content.seek(0)
            return torch.load(content, map_location="cpu", weights_only=True)
    except Exception as error:  # whatever zipfile, its decompressors, torch and pickle raise
        raise ValueError(f"{name} is no whole archive of tensors") from error
    raise ValueError(f"{name} has changed since it was written, in {changed}")


def summarise_error(error: Exception) -> str:
    """Return an error's first line, shortened between words, for use within a sentence."""
    if isinstance(error, FileNotFoundError):
        return f"{Path(error.filename).name} is missing"
    kind = "" if type(error) is ValueError else f"{type(error).__name__}: "
    line = kind + (str(error).splitlines() or [""])[0]
    return textwrap.shorten(line, 120, placeholder=" ...", break_on_hyphens=False)


def load_checkpoint(model: Any, folder: str | Path) -> None:
    """Put ``model`` into the state of the checkpoint in ``folder`` (or that is ``folder`` itself).

    Then ``model.learn(total - model.num_timesteps, reset_num_timesteps=False)`` goes on. Raises
    InputError if there is none, or it is damaged, or belongs to another recipe, policy or
    environment.
    """
    path = _checkpoint_of(folder)
    with _opened_checkpoint(path) as (state, archive):
        mine = json.loads(json.dumps(model.identity()))
        for key, value in mine.items():
            if (stored := state["identity"].get(key)) != value:
                raise InputError(
                    f"{path}: it belongs to another run ({key} is {stored!r} there, {value!r} "
                    "here): resume with the settings it was made with"
                )
        tensors = _tensors_of(archive["model"].tobytes(), "model")
        arrays, replay = (
            {name.removeprefix(begin): archive[name] for name in archive if name.startswith(begin)}
            for begin in ("run/", "replay/")
        )
        if model.replay_buffer is not None:
            model.replay_buffer.restore(replay)
        torch_random_state = tensors.pop("torch_random_state")
        model.restore_training_state((state["counters"], arrays, tensors))
        torch.set_rng_state(torch_random_state)
        name, keys, *rest = state["numpy_random_state"]
        np.random.set_state((name, np.array(keys, dtype=np.uint32), *rest))  # noqa: NPY002
        version, words, gauss = state["python_random_state"]
        random.setstate((version, tuple(words), gauss))


def _checkpoint_of(folder: str | Path) -> Path:
    path = Path(folder) if Path(folder).is_file() else latest_checkpoint(folder)
    if path is None:
        raise InputError(f"{folder}: there is no checkpoint in it: name the folder of a run")
    return path


@contextmanager
def _opened_checkpoint(path: Path) -> Iterator[tuple[dict[str, Any], Mapping[str, NDArray[Any]]]]:
    """Yield the state in a checkpoint and its arrays; refuse a damaged one in one sentence."""
    try:
        refuse_special(path)
        with path.open("rb") as file, np.load(file, allow_pickle=False) as archive:
            state: dict[str, Any] = json.loads(str(archive["state"]))
            if state["format"] != FORMAT:
                raise InputError(
                    f"{path}: its format {state['format']} is of another version of animarl: use "
                    "that one"
                )
            yield state, archive
    except InputError:
        raise
    except PermissionError as error:
        raise InputError(f"{error.filename}: it cannot be read: see to its permissions") from error
    except (
        OSError, LookupError, TypeError, ValueError, EOFError, RuntimeError, zipfile.BadZipFile,
        AttributeError, OverflowError,
    ) as error:  # fmt: skip
        raise InputError(
            f"{path}: the checkpoint is damaged ({summarise_error(error)}): "
            "put a copy of this file in its place, or remove it and start the run anew"
        ) from error


# -- models and replay memories -------------------------------------------------------------------


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
    """Refuse a zip file that a learner of another kind saved; say what fails as it is loaded."""
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
    with _opened(path, "r", "zip") as file:
        try:
            with zipfile.ZipFile(file) as archive:
                found: dict[str, Any] = json.loads(archive.read("data"))[SAVED_BY]
                return dict(found)
        except (zipfile.BadZipFile, LookupError, TypeError, ValueError):
            return None
        finally:
            if not isinstance(path, str | Path):  # one that was given is read again
                path.seek(0)


@contextmanager
def _opened(path: Place, mode: str, suffix: str | None) -> Iterator[Any]:
    """Yield the file at ``path``, as stable-baselines3 finds it; one that was given stays open."""
    file = open_path(path, mode, suffix=suffix)
    try:
        yield file
    finally:
        if file is not path:
            file.close()


def save_replay(buffer: SequenceReplayBuffer, path: Place) -> None:
    """Write a replay memory as an ``npz`` archive, whatever the name of ``path``."""
    with whole_file(path, ".npz") as place, _opened(place, "w", None) as file:
        np.savez(file, **buffer.state())


def load_replay(buffer: SequenceReplayBuffer, path: Place) -> None:
    """Read into ``buffer`` what :func:`save_replay` wrote."""
    try:
        with _opened(path, "r", "npz") as file, np.load(file, allow_pickle=False) as arrays:
            buffer.restore(dict(arrays))
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
    except (OSError, EOFError, TypeError, ValueError, zipfile.BadZipFile) as error:
        raise InputError(
            f"{path}: this is no replay memory saved by save_replay_buffer ({error})"
        ) from error
