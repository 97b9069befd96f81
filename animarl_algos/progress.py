"""A progress bar that counts steps of the world, not of slots."""

from __future__ import annotations

from stable_baselines3.common.callbacks import BaseCallback
from tqdm.auto import tqdm


class ProgressBar(BaseCallback):
    """Advances by the world steps done; shows the epsilon and the mean return of late episodes."""

    def _on_training_start(self) -> None:
        self._seen = self.model.num_timesteps
        self._bar = tqdm(
            total=self.locals["total_timesteps"] - self._seen, desc="online", unit="step"
        )

    def _on_step(self) -> bool:
        self._bar.update(self.model.num_timesteps - self._seen)
        self._seen = self.model.num_timesteps
        return True

    def _on_training_end(self) -> None:
        self._bar.close()
