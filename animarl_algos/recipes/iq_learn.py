"""IQ-Learn, begun from a soft-label clone."""

from __future__ import annotations

from typing import ClassVar

from animarl_algos.losses.iq_learn import InverseSoftQ
from animarl_algos.losses.recipe import Recipe, Selection
from animarl_algos.losses.terms import SoftActionSupervision
from animarl_algos.recipes.dqn import DQN

IQ_LEARN_RECIPE = Recipe(
    name="iq-learn",
    online=(InverseSoftQ(),),
    offline=(SoftActionSupervision(),),
    selection=Selection.LABEL_CROSS_ENTROPY,
    inverse=True,
)


class IQLearn(DQN):
    """Inverse soft Q-learning (Garg et al. 2021), online, on demonstrated and own steps.

    A clone errs where its own errors lead it; here it meets those states, and the soft values of
    its future tell them from the demonstrated ones. Some 25 collections improve a clone; by 60 it
    drifts. There is no twin on quantiles: the loss asks nothing of a return's distribution, so that
    all but the quantiles' mean would be left to chance.
    """

    recipe: ClassVar[Recipe] = IQ_LEARN_RECIPE
    preset: ClassVar[str] = "iq-learn"
