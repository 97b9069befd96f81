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
from collections import deque
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3.common.save_util import open_path

from animarl_algos.data.slot_layout import is_observed_as_declared
from animarl_algos.learner.pretraining import OfflineProgress
from animarl_algos.learner.updates import UpdateSchedule
from animarl_algos.networks.acting_rule import Acting
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
DAMAGE = (
    *(OSError, LookupError, TypeError, ValueError, EOFError, RuntimeError, AttributeError),
    *(OverflowError, zipfile.BadZipFile),
)
"""Errors that reading a damaged archive raises."""
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
    counters, arrays, tensors = _training_state(model)
    tensors = tensors | {"torch_random_state": torch.get_rng_state()}
    generator, keys, *rest = np.random.get_state()  # noqa: NPY002
    state = {
        "format": FORMAT,
        "identity": _identity(model),
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
        mine = json.loads(json.dumps(_identity(model)))
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
        _restore_training_state(model, (state["counters"], arrays, tensors))
        torch.set_rng_state(torch_random_state)
        name, keys, *rest = state["numpy_random_state"]
        np.random.set_state((name, np.array(keys, dtype=np.uint32), *rest))  # noqa: NPY002
        version, words, gauss = state["python_random_state"]
        random.setstate((version, tuple(words), gauss))


def _identity(model: Any) -> dict[str, Any]:
    """Return what a run and its checkpoint must have in common, as plain data."""
    return {
        "algorithm": type(model).__name__,
        "policy": model.policy_class.__name__,
        "individuals": list(model.layout.individuals),
        "num_copies": model.layout.num_copies,
        "observation_size": model.observation_size,
        "num_actions": model.policy.num_actions,
        "parameters": model.q_net.num_parameters,
        "buffer_size": model.buffer_size,
    }


COUNTERS = (
    "num_timesteps",
    "_total_timesteps",
    "_episode_num",
    "_n_updates",
    "_current_progress_remaining",
    "exploration_rate",
    "root_seed",
)
"""Attributes of a learner that a checkpoint holds as they are."""


def _training_state(model: Any) -> State:
    """Return all that is needed to go on exactly, but the replay memory."""
    policy, progress = model.policy, model.offline_progress
    counters = {name: getattr(model, name) for name in COUNTERS} | {
        "schedule": vars(model.schedule),
        "offline_progress": progress.to_json(),
        "policy_random_state": policy.random_state,
        "acting": policy.acting.to_json(),
        "late_episodes": [
            {key: float(value) for key, value in info.items()}
            for info in model.ep_info_buffer or ()
        ],
    }
    arrays: dict[str, NDArray[Any]] = {}
    env: Any = model.env
    whole = hasattr(env, "get_state") and is_observed_as_declared(env, "get_state")
    if whole and model._last_obs is not None:
        arrays = {f"env/{key}": value for key, value in env.get_state().items()}
        arrays["last_observation"] = np.asarray(model._last_obs)
        arrays["episode_starts"] = np.asarray(model._last_episode_starts)
        arrays["hidden"], arrays["previous_action"] = model.memory
    tensors = {
        "q_net": policy.q_net.state_dict(),
        "q_net_target": policy.q_net_target.state_dict(),
        "optimizer": policy.optimizer.state_dict(),
        "best_weights": progress.best_weights,
        "average_weights": progress.average_weights,
    }
    return counters, arrays, tensors


def _restore_training_state(model: Any, state: State) -> None:
    """Go on from a state.

    An environment without ``get_state`` and ``set_state``, or in a wrapper that changes its
    observations, starts new episodes instead of continuing those that were running.
    """
    counters, arrays, tensors = state
    policy, average = model.policy, tensors["average_weights"]
    if average is not None:  # follows the networks, where they are
        average = {name: value.to(model.device) for name, value in average.items()}
    for name in COUNTERS:
        setattr(model, name, counters[name])
    model.schedule = UpdateSchedule(**counters["schedule"])
    model.offline_progress = OfflineProgress(
        **counters["offline_progress"],
        best_weights=tensors["best_weights"],
        average_weights=average,
    )
    policy.random_state = counters["policy_random_state"]
    policy.acting = Acting.from_json(counters["acting"])
    model.ep_info_buffer = deque(counters["late_episodes"], maxlen=model._stats_window_size)
    model.ep_success_buffer = deque(maxlen=model._stats_window_size)
    policy.q_net.load_state_dict(tensors["q_net"])
    policy.q_net_target.load_state_dict(tensors["q_net_target"])
    policy.optimizer.load_state_dict(tensors["optimizer"])
    model._last_obs = None
    if "last_observation" in arrays:
        env_state = {key[4:]: value for key, value in arrays.items() if key[:4] == "env/"}
        model.env.set_state(env_state)
        model._last_obs = arrays["last_observation"]
        model._last_episode_starts = arrays["episode_starts"]
        model.memory = (arrays["hidden"], arrays["previous_action"])


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
        raise InputError(f"{error.filename}: it cannot be read: check its permissions") from error
    except DAMAGE as error:
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
    saved, name = _saved_by(path), saved_by["name"]
    if saved is None:
        raise InputError(f"{path}: it is no model of {name}: load it with the class that saved it")
    if any(saved.get(key) != saved_by[key] for key in ("recipe", "quantiles")):
        raise InputError(
            f"{path}: it was saved by {saved['name']} and is no {name}: load it with "
            f"{saved['name']}.load"
        )
    try:
        yield
    except ValueError as error:
        if "spaces do not match" not in str(error):
            raise
        raise InputError(f"{path}: {error}: give the environment it was trained in") from error


def _saved_by(path: Place) -> dict[str, Any] | None:
    """Return the learner that a zip file records, without its pickles; None for other files."""
    with _opened(path, "r", "zip") as file:
        try:
            with zipfile.ZipFile(file) as archive:
                saved: dict[str, Any] = json.loads(archive.read("data"))[SAVED_BY]
                return dict(saved)
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
