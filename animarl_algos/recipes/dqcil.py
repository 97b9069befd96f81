"""DQCIL: DQDIL whose memory is made blind to the experimental condition."""

from __future__ import annotations

from dataclasses import replace
from typing import ClassVar

from animarl_algos.losses.recipe import Recipe
from animarl_algos.losses.terms import TreatmentAdversary
from animarl_algos.recipes.dqdil import DQDIL_RECIPE
from animarl_algos.recipes.dqn import DQN
from animarl_algos.recipes.qrdqn import QRDQN

DQCIL_RECIPE = replace(
    DQDIL_RECIPE,
    name="dqcil",
    online=(*DQDIL_RECIPE.online, TreatmentAdversary()),
    offline=(*DQDIL_RECIPE.offline, TreatmentAdversary()),
    needs_condition=True,
)


class DQCIL(DQN):
    """DQDIL plus ``lambda2 J_tr``, the treatment predicted through gradient reversal."""

    recipe: ClassVar[Recipe] = DQCIL_RECIPE
    preset: ClassVar[str] = "dqcil"
    pretrained_preset: ClassVar[str | None] = "dqcil-pt"


class QRDQCIL(QRDQN):
    """DQCIL on quantiles."""

    recipe: ClassVar[Recipe] = DQCIL_RECIPE
    preset: ClassVar[str] = "qr-dqcil"
    pretrained_preset: ClassVar[str | None] = "qr-dqcil-pt"
