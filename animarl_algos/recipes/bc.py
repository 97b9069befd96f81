"""BC: behavioural cloning, cross-entropy on demonstrations; no interaction with the environment."""

from __future__ import annotations

from typing import ClassVar

from animarl_algos.losses.recipe import Recipe, Selection
from animarl_algos.losses.terms import ActionSupervision, WeightDecay
from animarl_algos.recipes.dqn import DQN
from animarl_algos.recipes.qrdqn import QRDQN

BC_RECIPE = Recipe(
    name="bc",
    online=(),
    offline=(ActionSupervision(weighted=False), WeightDecay()),
    selection=Selection.CROSS_ENTROPY,
)


class BC(DQN):
    """``J = J_AS + lambda1 J_l2``, offline only: ``learn`` runs the offline epochs and returns."""

    recipe: ClassVar[Recipe] = BC_RECIPE
    preset: ClassVar[str] = "bc"


class QRBC(QRDQN):
    """BC on the mean of quantiles."""

    recipe: ClassVar[Recipe] = BC_RECIPE
    preset: ClassVar[str] = "qr-bc"
