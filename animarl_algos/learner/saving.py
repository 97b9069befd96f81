"""What a learner saves and loads by itself: SB3's zip file, and its replay memory."""

from __future__ import annotations

import importlib
import io
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
    found = {k: numbers.pop(name) for k, name in PACE_NAMES.items() if name in numbers}
    return Pace(**found)


@contextmanager
def with_saved_numbers(model: SequenceQLearning) -> Iterator[None]:
    """While stable-baselines3 writes the attributes of ``model``, the pace's are among them."""
    model.acting_rule = model.policy.acting.to_json()
    numbers = pace_numbers(model.pace)
    vars(model).update(numbers)
    try:
        yield
    finally:
        for name in numbers:
            delattr(model, name)


@contextmanager
def _opened(path: Place) -> Iterator[Any]:
    """The file at ``path``, as stable-baselines3 finds it; one that was given stays open."""
    file = open_path(path, "r", suffix="npz")
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
