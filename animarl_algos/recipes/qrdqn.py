"""QRDQN: the same on quantiles of the return (Dabney et al. 2018)."""

from __future__ import annotations

from typing import ClassVar

import sb3_contrib

from animarl_algos.learner.algorithm import SequenceQLearning
from animarl_algos.losses.recipe import Recipe
from animarl_algos.recipes.dqn import DQN_RECIPE


class QRDQN(SequenceQLearning, sb3_contrib.QRDQN):  # type: ignore[misc]
    """Quantile twin of :class:`animarl_algos.recipes.dqn.DQN`; all recipes exist on it.

    The number of quantiles is ``policy_kwargs={"n_quantiles": ...}``.
    """

    recipe: ClassVar[Recipe] = DQN_RECIPE
    quantiles: ClassVar[bool] = True
    preset: ClassVar[str] = "qr-dqn"
