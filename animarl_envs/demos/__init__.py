"""Recorded episodes: the container, readers, cleaning, cutting, splits."""

from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.episode import Episode
from animarl_envs.demos.splits import assign_splits

__all__ = ["Demonstrations", "Episode", "assign_splits"]
