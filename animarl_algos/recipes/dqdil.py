"""DQDIL: Q-learning with distance-based imitation learning."""

from __future__ import annotations

from typing import ClassVar

from animarl_algos.losses.recipe import Recipe
from animarl_algos.losses.terms import (
    ScoredActionsTemporalDifference,
    TemporalDifference,
    WeightDecay,
)
from animarl_algos.recipes.dqn import DQN
from animarl_algos.recipes.qrdqn import QRDQN

DQDIL_RECIPE = Recipe(
    name="dqdil",
    online=(TemporalDifference(shaped=True), WeightDecay()),
    offline=(ScoredActionsTemporalDifference(), WeightDecay()),
    needs_distance=True,
)


class DQDIL(DQN):
    """``J = J_DQ + lambda1 J_l2`` on the reward ``R - alpha R_DTW``.

    With ``offline_epochs > 0`` (DQDIL-PT) it is first trained on demonstrations, where the fitted
    dynamics scores all actions.
    """

    recipe: ClassVar[Recipe] = DQDIL_RECIPE
    preset: ClassVar[str] = "dqdil"
    pretrained_preset: ClassVar[str | None] = "dqdil-pt"


class QRDQDIL(QRDQN):
    """DQDIL on quantiles."""

    recipe: ClassVar[Recipe] = DQDIL_RECIPE
    preset: ClassVar[str] = "qr-dqdil"
    pretrained_preset: ClassVar[str | None] = "qr-dqdil-pt"
