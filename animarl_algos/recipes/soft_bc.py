"""Soft-label cloning: actions are as right as they are near, and nothing else is learned."""

from __future__ import annotations

from typing import ClassVar

from animarl_algos.losses.recipe import Recipe, Selection
from animarl_algos.losses.terms import SoftActionSupervision
from animarl_algos.recipes.dqn import DQN
from animarl_algos.recipes.qrdqn import QRDQN

SOFT_BC_RECIPE = Recipe(
    name="soft-bc",
    online=(),
    offline=(SoftActionSupervision(),),
    selection=Selection.LABEL_CROSS_ENTROPY,
)


class SoftBC(DQN):
    """Cross-entropy with soft labels, offline only; ``offline_kwargs`` shrink the weights."""

    recipe: ClassVar[Recipe] = SOFT_BC_RECIPE
    preset: ClassVar[str] = "soft-bc"


class QRSoftBC(QRDQN):
    """Soft-label cloning on the mean of quantiles."""

    recipe: ClassVar[Recipe] = SOFT_BC_RECIPE
    preset: ClassVar[str] = "qr-soft-bc"
