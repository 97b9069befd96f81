"""DQN: recurrent dueling double Q-learning on the task reward alone, without demonstrations."""

from __future__ import annotations

from typing import ClassVar

import stable_baselines3

from animarl_algos.learner.algorithm import SequenceQLearning
from animarl_algos.losses.recipe import Recipe
from animarl_algos.losses.terms import TemporalDifference, WeightDecay

DQN_RECIPE = Recipe(name="dqn", online=(TemporalDifference(), WeightDecay()))


class DQN(SequenceQLearning, stable_baselines3.DQN):  # type: ignore[misc]
    """Deep Q-network of the paper: ``J = J_DQ + lambda1 J_l2``."""

    recipe: ClassVar[Recipe] = DQN_RECIPE
    quantiles: ClassVar[bool] = False
    preset: ClassVar[str] = "dqn"
