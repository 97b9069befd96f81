"""Checkpoints, models and replay memories on disk: written whole or not at all, checked when read.

From a checkpoint a run goes on exactly: same weights as if it had never been stopped (CPU).

A checkpoint is a folder ``checkpoint_000012`` with

- ``model.pt``: online and target networks, optimiser, best weights of the offline phase, torch's
  random state (tensors only, read with ``weights_only=True``);
- ``replay.npz``: the replay memory with its open episodes;
- ``run.npz``: last observations, recurrent states, the running worlds;
- ``state.json``: counters, schedules, NumPy's and Python's random states, and what it belongs to.

It is written under a temporary name, flushed to disk, then renamed; only then are older ones
removed. A kill at any moment, a full disk or an unwritable folder leaves the last one whole.
Checkpoints are taken between updates only (``boundary_hooks`` of a learner), never within a step.
"""

from __future__ import annotations

import io
import json
import os
import random
import re
import shutil
import textwrap
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3.common.save_util import open_path

from animarl_algos.learner.pretraining import OfflineProgress
from animarl_algos.replay.sequence_buffer import SequenceReplayBuffer
from animarl_envs.errors import InputError
from animarl_envs.files import write_then_rename

FORMAT = 2
PREFIX = "checkpoint_"
OWN_NAME = re.compile(PREFIX + r"\d+(\.part)?")


State = tuple[dict[str, Any], dict[str, NDArray[Any]], dict[str, Any]]
"""All that a learner needs to go on exactly, but its replay memory: counters (JSON-like), arrays
(the environment's state and the running episodes'), tensors (the weights)."""
Place = str | Path | io.BufferedIOBase
SAVED_BY = "saved_by"
"""Under this name a zip file says which class, recipe and kind of values it is of."""


def latest_checkpoint(folder: str | Path) -> Path | None:
    """Return the newest whole checkpoint in ``folder``, or None."""
    whole = [path for path in _written(folder) if path.suffix != ".part"]
    return max(whole, key=_number, default=None)


def _written(folder: str | Path) -> list[Path]:
    """Return all checkpoints, unfinished ones (``.part``) too, but not copies of other names."""
    return [p for p in Path(folder).glob(PREFIX + "*") if OWN_NAME.fullmatch(p.name)]


def _number(checkpoint: Path) -> int:
    return int(checkpoint.stem.removeprefix(PREFIX))


def steps_done(checkpoint: Path) -> int:
    """Return the world steps that a run had done at a checkpoint."""
    with _damage_refused(checkpoint):
        return int(_state(checkpoint)["counters"]["num_timesteps"])


def save_checkpoint(model: Any, folder: str | Path) -> Path:
    """Write a checkpoint of ``model`` into ``folder`` and remove those before.

    Raises
    ------
    InputError
        If it cannot be written; what was there before is untouched.
    """
    folder = Path(folder)
    previous = latest_checkpoint(folder)
    number = 0 if previous is None else _number(previous) + 1
    target = folder / f"{PREFIX}{number:06d}"
    part = target.with_suffix(".part")
    try:
        _remove_all_but(previous, folder)
        part.mkdir(parents=True)
        counters, arrays, tensors = model.training_state()
        tensors = tensors | {"torch_random_state": torch.get_rng_state()}
        _write(part / "model.pt", lambda file: file.write(serialise_tensors(tensors)))
        if model.replay_buffer is not None:
            replay = model.replay_buffer.state()
            _write(part / "replay.npz", lambda file: np.savez(file, **replay))
        _write(part / "run.npz", lambda file: np.savez(file, **arrays))
        generator, keys, *rest = np.random.get_state()  # noqa: NPY002
        state = {
            "format": FORMAT,
            "identity": model.identity(),
            "counters": counters,
            "numpy_random_state": [generator, np.asarray(keys).tolist(), *rest],
            "python_random_state": random.getstate(),
        }
        _write(part / "state.json", lambda file: file.write(json.dumps(state).encode()))
        _sync_folder(part)
        part.rename(target)
        _sync_folder(folder)
    except OSError as error:
        raise InputError(
            f"{target}: the checkpoint cannot be written ({error.strerror or error}): make room or "
            "choose a writable folder; the last checkpoint is untouched"
        ) from error
    finally:
        shutil.rmtree(part, ignore_errors=True)
    _remove_all_but(target, folder)
    return target


def _remove_all_but(kept: Path | None, folder: Path) -> None:
    """Remove older and unfinished checkpoints; what cannot be removed is tried again later."""
    for path in _written(folder):
        if path != kept:
            shutil.rmtree(path, ignore_errors=True)


def serialise_tensors(tensors: dict[str, Any]) -> bytes:
    """Return the bytes of ``torch.save``, which itself fails with a RuntimeError on a full disk."""
    stream = io.BytesIO()
    torch.save(tensors, stream)
    return stream.getvalue()


def load_tensors(file: Path) -> Any:
    """Return the tensors in a file, whose checksums are compared (torch does not).

    Raises
    ------
    OSError
        If the file cannot be read.
    ValueError
        If it is damaged, or holds more than tensors and plain values.
    """
    content = io.BytesIO(file.read_bytes())
    try:
        with zipfile.ZipFile(content) as archive:
            changed = archive.testzip()
        if changed is None:
            content.seek(0)
            return torch.load(content, map_location="cpu", weights_only=True)
    except Exception as error:  # whatever zipfile, its decompressors, torch and pickle raise
        raise ValueError(f"{file.name} is no whole archive of tensors") from error
    raise ValueError(f"{file.name} has changed since it was written, in {changed}")


def summarise_error(error: Exception) -> str:
    """Return an error's first line, shortened between words, for use within a sentence."""
    if isinstance(error, FileNotFoundError):
        return f"{Path(error.filename).name} is missing"
    kind = "" if type(error) is ValueError else f"{type(error).__name__}: "
    line = kind + (str(error).splitlines() or [""])[0]
    return textwrap.shorten(line, 120, placeholder=" ...", break_on_hyphens=False)


def load_checkpoint(model: Any, folder: str | Path) -> None:
    """Put ``model`` into the state of the newest checkpoint in ``folder`` (or of ``folder``
    itself).

    Then ``model.learn(total - model.num_timesteps, reset_num_timesteps=False)`` goes on.

    Raises
    ------
    InputError
        If there is none, or it is damaged, or belongs to another recipe, policy or environment.
    """
    folder = Path(folder)
    path = latest_checkpoint(folder)
    if path is None and (OWN_NAME.fullmatch(folder.name) or (folder / "state.json").exists()):
        path = folder
    if path is None or not path.is_dir():
        raise InputError(f"{folder}: there is no checkpoint in it: name the folder of a run")
    with _damage_refused(path):
        state = _state(path)
        mine = json.loads(json.dumps(model.identity()))
        for key, value in mine.items():
            if (stored := state["identity"].get(key)) != value:
                raise InputError(
                    f"{path}: it belongs to another run ({key} is {stored!r} there, {value!r} "
                    "here): resume with the settings it was made with"
                )
        tensors = load_tensors(path / "model.pt")
        arrays = _arrays(path / "run.npz")
        if model.replay_buffer is not None:
            model.replay_buffer.restore(_arrays(path / "replay.npz"))
        torch_random_state = tensors.pop("torch_random_state")
        model.restore_training_state((state["counters"], arrays, tensors))
        torch.set_rng_state(torch_random_state)
        name, keys, *rest = state["numpy_random_state"]
        np.random.set_state((name, np.array(keys, dtype=np.uint32), *rest))  # noqa: NPY002
        version, words, gauss = state["python_random_state"]
        random.setstate((version, tuple(words), gauss))


def cloned_progress(folder: str | Path) -> OfflineProgress:
    """Return the offline phase of the newest checkpoint in ``folder``, for another learner to end.

    It is to be of soft-label cloning alone, with the same networks, demonstrations, seed and
    offline settings as that learner's. Its ``learn`` then goes on as if the phase, which draws from
    no stream that lasts, had been its own.
    """
    path = latest_checkpoint(folder)
    if path is None:
        raise InputError(f"{folder}: there is no checkpoint in it: name the folder of a run")
    with _damage_refused(path):
        row = _state(path)["counters"]["offline_progress"] | {"done": False}
        return OfflineProgress(**row, best_weights=load_tensors(path / "model.pt")["q_net"])


def _state(path: Path) -> dict[str, Any]:
    state: dict[str, Any] = json.loads((path / "state.json").read_text())
    if state["format"] != FORMAT:
        raise InputError(
            f"{path}: its format {state['format']} is of another version of animarl: use that one"
        )
    return state


def _arrays(path: Path) -> dict[str, NDArray[Any]]:
    with path.open("rb") as file, np.load(file, allow_pickle=False) as archive:
        return dict(archive)


@contextmanager
def _damage_refused(path: Path) -> Iterator[None]:
    """Say in one sentence what is wrong with a checkpoint that is being read."""
    try:
        yield
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
            "put a copy of this folder in its place, or remove it and start the run anew"
        ) from error


def _write(path: Path, write: Any) -> None:
    with path.open("wb") as file:
        write(file)
        file.flush()
        os.fsync(file.fileno())


def _sync_folder(folder: Path) -> None:
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


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
