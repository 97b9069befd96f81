"""What each learner minimises, and the learners by their names.

A recipe is the list of its loss terms; a learner is a recipe on expected values (:class:`DQN`) or
on quantiles of the return (:class:`QRDQN`, the names ``QR...``). All learners are also public names
of :mod:`animarl_algos`; ``RECIPES`` holds them as the command line and ``zoo_configs`` call them.
"""

from dataclasses import replace
from typing import ClassVar, NamedTuple

import sb3_contrib
import stable_baselines3

from animarl_algos.learner.algorithm import SequenceQLearning
from animarl_algos.losses import terms
from animarl_envs.errors import InputError

__all__ = [
    "BC",
    "DQAAS",
    "DQCIL",
    "DQDIL",
    "DQN",
    "QRBC",
    "QRDQAAS",
    "QRDQCIL",
    "QRDQDIL",
    "QRDQN",
    "RECIPES",
    "NamedRecipe",
    "QRSoftBC",
    "SoftBC",
    "named_recipe",
]


class DQN(SequenceQLearning, stable_baselines3.DQN):  # type: ignore[misc]
    """Deep Q-network of the paper: ``J = J_DQ + lambda1 J_l2``.

    Recurrent dueling double Q-learning on the task reward alone, without demonstrations.
    """

    recipe: ClassVar[terms.Recipe] = terms.Recipe(
        name="dqn", online=(terms.TemporalDifference(), terms.WeightDecay())
    )
    quantiles: ClassVar[bool] = False
    preset: ClassVar[str] = "dqn"


class QRDQN(SequenceQLearning, sb3_contrib.QRDQN):  # type: ignore[misc]
    """Quantile twin of :class:`DQN` (Dabney et al. 2018).

    The number of quantiles is ``policy_kwargs={"n_quantiles": ...}``.
    """

    recipe: ClassVar[terms.Recipe] = DQN.recipe
    quantiles: ClassVar[bool] = True
    preset: ClassVar[str] = "qr-dqn"


class BC(DQN):
    """Behavioural cloning, ``J = J_AS + lambda1 J_l2``: cross-entropy on demonstrations.

    Offline only: ``learn`` runs the offline epochs and returns.
    """

    recipe: ClassVar[terms.Recipe] = terms.Recipe(
        name="bc",
        offline=(terms.ActionSupervision(weighted=False), terms.WeightDecay()),
        selection=terms.Selection.CROSS_ENTROPY,
    )
    preset: ClassVar[str] = "bc"


class SoftBC(DQN):
    """Soft-label cloning: actions are as right as they are near, and nothing else is learned.

    Offline only; ``offline_kwargs`` shrink the weights.
    """

    recipe: ClassVar[terms.Recipe] = terms.Recipe(
        name="soft-bc",
        offline=(terms.ActionSupervision(weighted=False, soft=True),),
        selection=terms.Selection.LABEL_CROSS_ENTROPY,
    )
    preset: ClassVar[str] = "soft-bc"


class DQAAS(DQN):
    """Q-learning with adaptive action supervision (Fujii et al. 2024).

    ``J = J_DQ + lambda3 J_AS + lambda1 J_l2``, the label aligned by dynamic time warping.
    """

    recipe: ClassVar[terms.Recipe] = terms.Recipe(
        name="dqaas",
        online=(terms.TemporalDifference(), terms.ActionSupervision(), terms.WeightDecay()),
        offline=(terms.TemporalDifference(), terms.ActionSupervision(), terms.WeightDecay()),
        selection=terms.Selection.CROSS_ENTROPY,
        needs_alignment=True,
    )
    preset: ClassVar[str] = "dqaas"


class DQDIL(DQN):
    """Distance-based imitation: ``J = J_DQ + lambda1 J_l2`` on the reward ``R - alpha R_DTW``.

    With ``offline_epochs > 0`` (DQDIL-PT) it is first trained on demonstrations, where the fitted
    dynamics scores all actions.
    """

    recipe: ClassVar[terms.Recipe] = terms.Recipe(
        name="dqdil",
        online=(terms.TemporalDifference(shaped=True), terms.WeightDecay()),
        offline=(terms.ScoredActionsTemporalDifference(), terms.WeightDecay()),
        needs_distance=True,
    )
    preset: ClassVar[str] = "dqdil"
    pretrained_preset: ClassVar[str | None] = "dqdil-pt"


class DQCIL(DQN):
    """DQDIL whose memory is made blind to the experimental condition.

    DQDIL plus ``lambda2 J_tr``, the treatment predicted through gradient reversal.
    """

    recipe: ClassVar[terms.Recipe] = replace(
        DQDIL.recipe,
        name="dqcil",
        online=(*DQDIL.recipe.online, terms.TreatmentAdversary()),
        offline=(*DQDIL.recipe.offline, terms.TreatmentAdversary()),
        needs_condition=True,
    )
    preset: ClassVar[str] = "dqcil"
    pretrained_preset: ClassVar[str | None] = "dqcil-pt"


def on_quantiles(learner: type[DQN]) -> type[QRDQN]:
    """Return the twin of a learner that learns quantiles of the return."""
    pretrained = learner.pretrained_preset
    return type(
        f"QR{learner.__name__}",
        (QRDQN,),
        {
            "__doc__": f":class:`{learner.__name__}` on quantiles of the return.",
            "__module__": __name__,
            "recipe": learner.recipe,
            "preset": f"qr-{learner.preset}",
            "pretrained_preset": None if pretrained is None else f"qr-{pretrained}",
        },
    )


QRBC = on_quantiles(BC)
QRSoftBC = on_quantiles(SoftBC)
QRDQAAS = on_quantiles(DQAAS)
QRDQDIL = on_quantiles(DQDIL)
QRDQCIL = on_quantiles(DQCIL)


class NamedRecipe(NamedTuple):
    """A learner's class, and whether its name asks for the offline phase."""

    algorithm: type[SequenceQLearning]
    pretrained: bool


LEARNERS: tuple[type[SequenceQLearning], ...] = (
    *(DQN, BC, SoftBC, DQAAS, DQDIL, DQCIL),
    *(QRDQN, QRBC, QRSoftBC, QRDQAAS, QRDQDIL, QRDQCIL),
)
RECIPES: dict[str, NamedRecipe] = {}
for one in LEARNERS:
    pretrained = bool(one.recipe.offline) and one.pretrained_preset is None
    RECIPES[one.preset] = NamedRecipe(one, pretrained=pretrained)
    if one.pretrained_preset is not None:
        RECIPES[one.pretrained_preset] = NamedRecipe(one, pretrained=True)


def named_recipe(name: str) -> NamedRecipe:
    """Return the learner called ``name``."""
    try:
        return RECIPES[name]
    except KeyError:
        raise InputError(
            f"algorithm {name!r} is unknown: choose one of {', '.join(RECIPES)}"
        ) from None
