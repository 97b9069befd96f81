"""QRDQN: the same on quantiles of the return (Dabney et al. 2018)."""

from __future__ import annotations

from typing import ClassVar

import sb3_contrib

from animarl_algos.base import SequenceQLearning
from animarl_algos.dqn import DQN_RECIPE
from animarl_algos.recipe import Recipe


class QRDQN(SequenceQLearning, sb3_contrib.QRDQN):  # type: ignore[misc]
    """Quantile twin of :class:`animarl_algos.dqn.DQN`; all recipes exist on it.

    The number of quantiles is ``policy_kwargs={"n_quantiles": ...}``, by default 20.
    """

    recipe: ClassVar[Recipe] = DQN_RECIPE
    default_quantiles: ClassVar[int | None] = 20
