"""When checkpoints are written: now and then, and when a run is stopped by a signal."""

from __future__ import annotations

import signal
import sys
import threading
from pathlib import Path
from types import FrameType
from typing import Any, NoReturn

from stable_baselines3.common.callbacks import BaseCallback

from animarl_algos.learner.algorithm import SequenceQLearning
from animarl_algos.learner.checkpoint import save_checkpoint
from animarl_envs.errors import InputError

TERMINATED = 128 + signal.SIGTERM
"""The exit code after SIGTERM, as a shell gives it."""


class CheckpointCallback(BaseCallback):
    """Writes a checkpoint every ``every`` world steps, after each offline epoch, and when stopped.

    On Ctrl-C (SIGINT) and SIGTERM the update under way is finished, the checkpoint written, and
    ``KeyboardInterrupt`` or ``SystemExit`` raised; a second signal does so at once.

    Parameters
    ----------
    folder
        Where the checkpoints go; one is kept.
    every
        World steps between checkpoints.
    """

    def __init__(self, folder: str | Path, every: int, verbose: int = 0) -> None:
        super().__init__(verbose)
        if every < 1:
            raise InputError(f"a checkpoint every {every} steps is not possible: give at least 1")
        self.folder = Path(folder)
        self.every = every
        self.interrupted: int | None = None
        self._previous_handlers: dict[int, Any] = {}

    def _init_callback(self) -> None:
        self.interrupted = None  # the same callback may serve again after a Ctrl-C
        self.model.boundary_hooks.append(self)  # type: ignore[attr-defined]
        self.due = self.every * (self.model.num_timesteps // self.every + 1)
        self.epochs = 0
        self._catch_interrupt()

    def _catch_interrupt(self) -> None:
        if threading.current_thread() is not threading.main_thread():
            return  # signals go to the main thread
        for number in (signal.SIGINT, signal.SIGTERM):
            self._previous_handlers[number] = signal.signal(number, self._on_interrupt)

    def _on_interrupt(self, number: int, frame: FrameType | None) -> None:
        if self.interrupted is not None:
            _stop(number)
        self.interrupted = number

    def _on_step(self) -> bool:
        return True

    def at_boundary(self) -> None:
        """Called by the algorithm between updates and after each offline epoch."""
        model: SequenceQLearning = self.model  # type: ignore[assignment]
        due = model.num_timesteps >= self.due or model.offline_progress.epoch > self.epochs
        if due or self.interrupted is not None:
            save_checkpoint(model, self.folder)
            self.due = self.every * (model.num_timesteps // self.every + 1)
            self.epochs = model.offline_progress.epoch
        if self.interrupted is not None:
            self.release()
            _stop(self.interrupted)

    def _on_training_end(self) -> None:
        save_checkpoint(self.model, self.folder)  # type: ignore[arg-type]
        self.release()

    def release(self) -> None:
        """Give the signals back to whoever had them."""
        while self._previous_handlers:
            signal.signal(*self._previous_handlers.popitem())


def _stop(number: int) -> NoReturn:
    if number == signal.SIGTERM:
        sys.exit(TERMINATED)
    raise KeyboardInterrupt
