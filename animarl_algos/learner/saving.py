"""What a learner saves and loads by itself: SB3's zip file, and its replay memory."""

from __future__ import annotations

import importlib
import io
import json
import sys
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from stable_baselines3.common.save_util import open_path

from animarl_algos.learner.pace import Pace
from animarl_algos.replay.buffer_state import buffer_state, restore_buffer
from animarl_algos.replay.sequence_buffer import SequenceReplayBuffer
from animarl_envs.errors import InputError
from animarl_envs.files import write_then_rename

if TYPE_CHECKING:
    from animarl_algos.learner.algorithm import SequenceQLearning

Place = str | Path | io.BufferedIOBase
MOVED = {
    "animarl_algos.exploration": "animarl_algos.learner.exploration",
    "animarl_algos.offline": "animarl_algos.learner.offline",
    "animarl_algos.recurrent": "animarl_algos.networks",
    "animarl_algos.recurrent.policies": "animarl_algos.networks.policies",
    "animarl_algos.slots": "animarl_algos.data.slots",
}
"""Where modules stood when the first zip files were written, which name their classes by it."""

NOT_IN_ZIP = (
    "demonstrations", "boundary_hooks", "memory", "pace", "collector", "updater",
    "_last_obs", "_last_episode_starts", "_last_original_obs",
)  # fmt: skip
"""What a learner makes anew, beside what stable-baselines3 leaves out."""
PACE_NAMES = {
    "steps": "_rollout_steps",
    "episodes": "_rollout_episodes",
    "updates_due": "_updates_due",
    "since_target": "_target_count",
}
"""The names of :class:`.pace.Pace`'s numbers in zip files and checkpoints."""


def pace_numbers(pace: Pace) -> dict[str, Any]:
    """The numbers of ``pace`` under their names in files."""
    return {name: getattr(pace, key) for key, name in PACE_NAMES.items()}


def pace_from(numbers: dict[str, Any]) -> Pace:
    """The pace that ``numbers`` of a file describe; they are taken out of it, if it has any."""
    numbers.pop(SAVED_BY, None)  # was looked at before
    found = {k: numbers.pop(name) for k, name in PACE_NAMES.items() if name in numbers}
    return Pace(**found)


SAVED_BY = "saved_by"
"""Under this name a zip file says which class, recipe and kind of values it is of."""


def _of(learner: type[SequenceQLearning]) -> dict[str, Any]:
    return {"recipe": learner.recipe.name, "quantiles": learner.quantiles}


@contextmanager
def with_saved_numbers(model: SequenceQLearning) -> Iterator[None]:
    """While stable-baselines3 writes the attributes of ``model``, the pace's are among them."""
    model.acting_rule = model.policy.acting.to_json()
    said = {SAVED_BY: {"name": type(model).__name__} | _of(type(model))}
    numbers = pace_numbers(model.pace) | said
    vars(model).update(numbers)
    try:
        yield
    finally:
        for name in numbers:
            delattr(model, name)


@contextmanager
def whole_zip(path: Place) -> Iterator[Place]:
    """Where to write a zip file that is to be at ``path``, whole or not at all; a stream itself."""
    if not isinstance(path, (str, Path)):
        yield path
        return
    named = Path(path)
    with write_then_rename(named if named.suffix else Path(f"{path}.zip")) as part:
        yield part


@contextmanager
def only_of(learner: type[SequenceQLearning], path: Place) -> Iterator[None]:
    """While a zip file is loaded as ``learner``, one that something else saved is refused.

    Raises
    ------
    InputError
        If it is of another recipe or another kind of values, or of no learner of this project, or
        the environment it is to learn in has other spaces.
    """
    found = _settings_in(path)
    if found is None or "offline_epochs" not in found:
        raise InputError(
            f"{path}: it is no model of {learner.__name__}: load it with the class that saved it"
        )
    saved_by = found.get(SAVED_BY)  # older files do not say
    if isinstance(saved_by, dict) and not _of(learner).items() <= saved_by.items():
        name = saved_by["name"]
        raise InputError(
            f"{path}: it was saved by {name} and is no {learner.__name__}: load it with {name}.load"
        )
    try:
        yield
    except RuntimeError as error:  # of torch: weights of other shapes or names
        raise InputError(
            f"{path}: its networks are not those of {learner.__name__} "
            f"({str(error).splitlines()[0]}): load it with the class that saved it"
        ) from error
    except ValueError as error:
        if "spaces do not match" not in str(error):
            raise
        raise InputError(f"{path}: {error}: give the environment it was trained in") from error


def _settings_in(path: Place) -> dict[str, Any] | None:
    """Attributes in a zip file of stable-baselines3, pickled ones unread; None if it is none."""
    with _opened(path, "zip") as file:
        try:
            with zipfile.ZipFile(file) as archive:
                found = json.loads(archive.read("data"))
        except (zipfile.BadZipFile, KeyError, ValueError):
            return None
        finally:
            if not isinstance(path, str | Path):  # one that was given is read again
                path.seek(0)
    return found if isinstance(found, dict) else None


@contextmanager
def _opened(path: Place, suffix: str = "npz") -> Iterator[Any]:
    """The file at ``path``, as stable-baselines3 finds it; one that was given stays open."""
    file = open_path(path, "r", suffix=suffix)
    try:
        yield file
    finally:
        if file is not path:
            file.close()


@contextmanager
def found_where_they_stood() -> Iterator[None]:
    """While an old file is read, its classes are found under the names that it has for them."""
    present = {old: importlib.import_module(new) for old, new in MOVED.items()}
    sys.modules.update(present)
    try:
        yield
    finally:
        for old in present:
            del sys.modules[old]


def save_replay(buffer: SequenceReplayBuffer, path: Place) -> None:
    """Write a replay memory as an ``npz`` archive, whatever the name of ``path``."""
    state = buffer_state(buffer)
    if isinstance(path, io.BufferedIOBase):
        np.savez(path, **state)
        return
    path = Path(path)
    named = path if path.suffix else path.with_suffix(".npz")
    with write_then_rename(named) as part, part.open("wb") as file:
        np.savez(file, **state)


def load_replay(buffer: SequenceReplayBuffer, path: Place) -> None:
    """Read into ``buffer`` what :func:`save_replay` wrote.

    Raises
    ------
    InputError
        If it is none, or was saved with other settings.
    """
    try:
        with _opened(path) as file, np.load(file, allow_pickle=False) as arrays:
            restore_buffer(buffer, dict(arrays))
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
    except (OSError, EOFError, TypeError, ValueError, zipfile.BadZipFile) as error:
        raise InputError(
            f"{path}: this is no replay memory saved by save_replay_buffer ({error})"
        ) from error
