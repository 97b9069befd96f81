"""DQAAS: Q-learning with adaptive action supervision (Fujii et al. 2024)."""

from __future__ import annotations

from typing import ClassVar

from animarl_algos.losses.recipe import Recipe, Selection
from animarl_algos.losses.terms import ActionSupervision, TemporalDifference, WeightDecay
from animarl_algos.recipes.dqn import DQN
from animarl_algos.recipes.qrdqn import QRDQN

_TERMS = (TemporalDifference(), ActionSupervision(), WeightDecay())
DQAAS_RECIPE = Recipe(
    name="dqaas",
    online=_TERMS,
    offline=_TERMS,
    selection=Selection.CROSS_ENTROPY,
    needs_alignment=True,
)


class DQAAS(DQN):
    """``J = J_DQ + lambda3 J_AS + lambda1 J_l2``, the label aligned by dynamic time warping."""

    recipe: ClassVar[Recipe] = DQAAS_RECIPE
    preset: ClassVar[str] = "dqaas"


class QRDQAAS(QRDQN):
    """DQAAS on quantiles."""

    recipe: ClassVar[Recipe] = DQAAS_RECIPE
    preset: ClassVar[str] = "qr-dqaas"
