"""Who is told between updates, among them a progress bar that counts steps of the world."""

from __future__ import annotations

import sys
from typing import Protocol

from stable_baselines3.common.callbacks import BaseCallback, ConvertCallback
from stable_baselines3.common.type_aliases import MaybeCallback
from tqdm.auto import tqdm


class BoundaryHook(Protocol):
    """Is told between updates, when the state of a run is whole, and when ``learn`` ends."""

    def at_boundary(self) -> None: ...

    def release(self) -> None: ...


class ProgressBar(BaseCallback):
    """Advances by the world steps done; its line is ended however training ends."""

    _bar: tqdm | None = None

    def _on_training_start(self) -> None:
        self._seen = self.model.num_timesteps
        self._bar = tqdm(
            total=self.locals["total_timesteps"] - self._seen, desc="online", unit="step"
        )
        self.model.boundary_hooks.append(self)  # type: ignore[attr-defined]

    def _on_step(self) -> bool:
        assert self._bar is not None
        self._bar.update(self.model.num_timesteps - self._seen)
        self._seen = self.model.num_timesteps
        return True

    def at_boundary(self) -> None:
        """Nothing to do between updates."""

    def release(self) -> None:
        """End the line, also after an error or an interruption."""
        if self._bar is not None:
            self._bar.close()

    def _on_training_end(self) -> None:
        self.release()


def with_progress_bar(callback: MaybeCallback) -> list[BaseCallback]:
    """What ``learn`` was given as its callback, and on a terminal a bar."""
    given = callback if isinstance(callback, list) else [callback]
    each = [
        c if isinstance(c, BaseCallback) else ConvertCallback(c) for c in given if c is not None
    ]
    return [*each, ProgressBar()] if sys.stderr.isatty() else each
