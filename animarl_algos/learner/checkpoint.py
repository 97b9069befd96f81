"""Checkpoints from which a run goes on exactly: same weights as if it had never been stopped (CPU).

A checkpoint is a folder ``checkpoint_000012`` with

- ``model.pt``: online and target networks, optimiser, best weights of the offline phase, torch's
  random state (tensors only, read with ``weights_only=True``);
- ``replay.npz``: the replay memory with its open episodes;
- ``run.npz``: last observations, recurrent states, the running worlds;
- ``state.json``: counters, schedules, NumPy's and Python's random states, and what it belongs to.

It is written under a temporary name, flushed to disk, then renamed; only then are older ones
removed. A kill at any moment, a full disk or an unwritable folder leaves the last one whole.
Checkpoints are taken between updates only (``algorithm.boundary_hooks``), never within a step.
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
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from animarl_algos.learner.algorithm import SequenceQLearning
from animarl_algos.learner.offline import OfflineProgress
from animarl_algos.learner.training_state import identity, restore_training_state, training_state
from animarl_algos.replay.buffer_state import buffer_state, restore_buffer
from animarl_envs.errors import InputError

FORMAT = 1
PREFIX = "checkpoint_"
OWN_NAME = re.compile(PREFIX + r"\d+(\.part)?")


def latest_checkpoint(folder: str | Path) -> Path | None:
    """The newest whole checkpoint in ``folder``, or None."""
    whole = [path for path in _written(folder) if path.suffix != ".part"]
    return max(whole, key=_number, default=None)


def _written(folder: str | Path) -> list[Path]:
    """All checkpoints, unfinished ones (``.part``) too, but no copies under a name of their own."""
    return [p for p in Path(folder).glob(PREFIX + "*") if OWN_NAME.fullmatch(p.name)]


def _number(checkpoint: Path) -> int:
    return int(checkpoint.stem.removeprefix(PREFIX))


def steps_done(checkpoint: Path) -> int:
    """World steps of the run until then.

    Raises
    ------
    InputError
        If the checkpoint is damaged.
    """
    try:
        state = json.loads((checkpoint / "state.json").read_text())
        return int(state["counters"]["num_timesteps"])
    except (OSError, KeyError, TypeError, ValueError) as error:
        raise _damaged(checkpoint, error) from error


def save_checkpoint(model: SequenceQLearning, folder: str | Path) -> Path:
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
        counters, arrays, tensors = training_state(model)
        run: dict[str, Any] = dict(arrays)
        tensors["torch_random_state"] = torch.get_rng_state()
        _write(part / "model.pt", lambda file: file.write(serialised(tensors)))
        if model.replay_buffer is not None:
            replay = buffer_state(model.replay_buffer)
            _write(part / "replay.npz", lambda file: np.savez(file, **replay))
        _write(part / "run.npz", lambda file: np.savez(file, **run))
        state = {
            "format": FORMAT,
            "identity": identity(model),
            "counters": counters,
            "numpy_random_state": _json_random_state(np.random.get_state()),  # noqa: NPY002
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
    """What a kill left of older and unfinished checkpoints; what resists is tried again later."""
    for path in _written(folder):
        if path != kept:
            shutil.rmtree(path, ignore_errors=True)


def serialised(tensors: dict[str, Any]) -> bytes:
    """As ``torch.save`` writes them; its own writing fails on a full disk with a RuntimeError."""
    stream = io.BytesIO()
    torch.save(tensors, stream)
    return stream.getvalue()


def load_tensors(file: Path) -> Any:
    """What :func:`serialised` gave, unchanged: torch itself does not look at the checksums.

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


def in_short(error: Exception) -> str:
    """What an error says, for the middle of a sentence: its first line, cut between words."""
    if isinstance(error, FileNotFoundError):
        return f"{Path(error.filename).name} is missing"
    kind = "" if type(error) is ValueError else f"{type(error).__name__}: "
    line = kind + (str(error).splitlines() or [""])[0]
    return textwrap.shorten(line, 120, placeholder=" ...", break_on_hyphens=False)


def load_checkpoint(model: SequenceQLearning, folder: str | Path) -> None:
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
    try:
        state = json.loads((path / "state.json").read_text())
        if state["format"] > FORMAT:
            raise InputError(
                f"{path}: its format {state['format']} is newer than this animarl: upgrade it"
            )
        stored, mine = state["identity"], json.loads(json.dumps(identity(model)))
        for key in mine:
            if stored.get(key) != mine[key]:
                raise InputError(
                    f"{path}: it belongs to another run ({key} is {stored.get(key)!r} there, "
                    f"{mine[key]!r} here): resume with the settings it was made with"
                )
        tensors = load_tensors(path / "model.pt")
        arrays = _arrays(path / "run.npz")
        if model.replay_buffer is not None:
            restore_buffer(model.replay_buffer, _arrays(path / "replay.npz"))
        torch_random_state = tensors.pop("torch_random_state")
        restore_training_state(model, state["counters"], arrays, tensors)
        torch.set_rng_state(torch_random_state)
        name, keys, *rest = state["numpy_random_state"]
        np.random.set_state((name, np.array(keys, dtype=np.uint32), *rest))  # noqa: NPY002
        version, words, gauss = state["python_random_state"]
        random.setstate((version, tuple(words), gauss))
    except InputError:
        raise
    except (
        OSError, LookupError, TypeError, ValueError, EOFError, RuntimeError, zipfile.BadZipFile,
        AttributeError, OverflowError,
    ) as error:  # fmt: skip
        raise _damaged(path, error) from error


def begin_as_clone(model: SequenceQLearning, folder: str | Path) -> None:
    """Give ``model`` the offline phase that the newest checkpoint in ``folder`` has behind it.

    It is to be of soft-label cloning alone, with the same networks, demonstrations, seed and
    offline settings. ``model.learn`` then goes on as if the phase, which draws from no stream that
    lasts, had been its own.

    Raises
    ------
    InputError
        If there is none, or it is damaged.
    """
    path = latest_checkpoint(folder)
    if path is None:
        raise InputError(f"{folder}: there is no checkpoint in it: name the folder of a run")
    try:
        counters = json.loads((path / "state.json").read_text())["counters"]
        model.best_weights = load_tensors(path / "model.pt")["q_net"]
        progress = OfflineProgress.from_json(counters["offline_progress"])
    except (OSError, LookupError, TypeError, ValueError) as error:
        raise _damaged(path, error) from error
    model.offline_progress = replace(progress, done=False)  # the best weights are not in place yet


def _arrays(path: Path) -> dict[str, NDArray[Any]]:
    with path.open("rb") as file, np.load(file, allow_pickle=False) as archive:
        return dict(archive)


def _damaged(path: Path, error: Exception) -> InputError:
    if isinstance(error, PermissionError):
        return InputError(f"{error.filename}: it cannot be read: see to its permissions")
    return InputError(
        f"{path}: the checkpoint is damaged ({in_short(error)}): "
        "put a copy of this folder in its place, or remove it and start the run anew"
    )


def _json_random_state(state: Any) -> list[Any]:
    name, keys, *rest = state
    return [name, keys.tolist(), *rest]


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
