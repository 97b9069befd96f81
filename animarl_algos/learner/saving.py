"""What a learner saves and loads by itself: SB3's zip file, and its replay memory."""

from __future__ import annotations

import importlib
import io
import sys
import zipfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Self

import numpy as np
from stable_baselines3.common.save_util import open_path

from animarl_algos.learner.offline import OfflineLearner
from animarl_algos.replay.buffer_state import buffer_state, restore_buffer
from animarl_algos.replay.sequence_buffer import SequenceReplayBuffer
from animarl_envs.errors import InputError
from animarl_envs.files import write_then_rename

Place = str | Path | io.BufferedIOBase
MOVED = {
    "animarl_algos.exploration": "animarl_algos.learner.exploration",
    "animarl_algos.offline": "animarl_algos.learner.offline",
    "animarl_algos.recurrent": "animarl_algos.networks",
    "animarl_algos.recurrent.policies": "animarl_algos.networks.policies",
    "animarl_algos.slots": "animarl_algos.data.slots",
}
"""Where modules stood when the first zip files were written, which name their classes by it."""


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
def _found_where_they_stood() -> Iterator[None]:
    """While an old file is read, its classes are found under the names that it has for them."""
    present = {old: importlib.import_module(new) for old, new in MOVED.items()}
    sys.modules.update(present)
    try:
        yield
    finally:
        for old in present:
            del sys.modules[old]


class SavedLearner(OfflineLearner):
    """``save`` with the acting rule of the policy, and the replay memory without pickle."""

    acting_rule: dict[str, Any]

    def save(
        self,
        path: Place,
        exclude: Iterable[str] | None = None,
        include: Iterable[str] | None = None,
    ) -> None:
        """All settings and the networks, as in stable-baselines3; the acting rule too."""
        self.acting_rule = self.policy.acting.to_json()
        super().save(path, exclude, include)

    @classmethod
    def load(cls, path: Place, *arguments: Any, **keywords: Any) -> Self:  # type: ignore[override]
        """A learner from :meth:`save`; arguments as in stable-baselines3.

        The file holds pickles, which can run code: load only your own.
        """
        with _found_where_they_stood():
            return super().load(path, *arguments, **keywords)

    def save_replay_buffer(self, path: Place) -> None:
        """Write the replay memory as an ``npz`` archive, whatever the name of ``path``."""
        state = buffer_state(self._the_memory())
        if isinstance(path, io.BufferedIOBase):
            np.savez(path, **state)
            return
        path = Path(path)
        named = path if path.suffix else path.with_suffix(".npz")
        with write_then_rename(named) as part, part.open("wb") as file:
            np.savez(file, **state)

    def load_replay_buffer(self, path: Place, truncate_last_traj: bool = True) -> None:
        """Read the finished episodes of :meth:`save_replay_buffer`; training begins new ones.

        Raises
        ------
        InputError
            If it is none, or was saved with other settings.
        """
        buffer = self._the_memory()
        try:
            with _opened(path) as file, np.load(file, allow_pickle=False) as arrays:
                restore_buffer(buffer, dict(arrays))
        except InputError as error:
            raise InputError(f"{path}: {error}") from error
        except (OSError, EOFError, TypeError, ValueError, zipfile.BadZipFile) as error:
            raise InputError(
                f"{path}: this is no replay memory saved by save_replay_buffer ({error})"
            ) from error
        buffer.allocate_staging(self.layout.num_copies)
        self._last_obs = None

    def _the_memory(self) -> SequenceReplayBuffer:
        if self.replay_buffer is None:
            raise InputError("there is no replay memory: give env=, or call set_env first")
        return self.replay_buffer

    def _excluded_save_params(self) -> list[str]:
        return [
            *super()._excluded_save_params(),
            *("demonstrations", "boundary_hooks", "memory", "_recorder", "_losses"),
            *("_treatment_counts", "_last_obs", "_last_episode_starts", "_last_original_obs"),
        ]

    def _get_torch_save_params(self) -> tuple[list[str], list[str]]:
        return ["policy", "policy.optimizer"], []
