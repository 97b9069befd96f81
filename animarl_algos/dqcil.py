"""DQCIL: DQDIL whose memory is made blind to the experimental condition."""

from __future__ import annotations

from dataclasses import replace
from typing import ClassVar

from animarl_algos.dqdil import DQDIL_RECIPE
from animarl_algos.dqn import DQN
from animarl_algos.qrdqn import QRDQN
from animarl_algos.recipe import Recipe
from animarl_algos.terms import TreatmentAdversary

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


class QRDQCIL(QRDQN):
    """DQCIL on quantiles."""

    recipe: ClassVar[Recipe] = DQCIL_RECIPE
