"""What the offline phase needs of a learner."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

import torch
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.type_aliases import Schedule
from stable_baselines3.common.vec_env import VecEnv

from animarl_algos.data.slots import SlotLayout
from animarl_algos.learner.offline_settings import OfflineSettings
from animarl_algos.losses.terms import Phase, Recipe
from animarl_algos.networks.policies import GruPolicy

if TYPE_CHECKING:
    from animarl_algos.learner.offline import OfflineProgress


class OfflineLearner(Protocol):
    """Its networks, settings and log."""

    policy: GruPolicy
    layout: SlotLayout
    env: VecEnv | None
    lr_schedule: Schedule
    device: torch.device
    observation_size: int
    root_seed: int
    offline_epochs: int
    offline_learning_rate: float
    offline_batch_size: int
    offline_patience: int | None
    offline_settings: OfflineSettings
    offline_progress: OfflineProgress
    best_weights: dict[str, torch.Tensor] | None
    average_weights: dict[str, torch.Tensor] | None
    offline_loss: str

    @property
    def offline_recipe(self) -> Recipe: ...

    @property
    def logger(self) -> Logger: ...

    def phase(self, name: str) -> Phase:
        """The numbers of the ``"offline"`` phase."""
        ...

    def at_boundary(self) -> None:
        """Called before each epoch, when all that a checkpoint holds is whole."""
        ...

    def reset_optimizer(self, learning_rate: float) -> None:
        """A new optimiser for the online network, with nothing accumulated."""
        ...
