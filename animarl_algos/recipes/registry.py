"""The learners by their names on the command line and in ``zoo_configs``.

The classes imported here are also public names of :mod:`animarl_algos`.
"""

from __future__ import annotations

from dataclasses import dataclass

from animarl_algos.learner.algorithm import SequenceQLearning
from animarl_algos.recipes.bc import BC, QRBC
from animarl_algos.recipes.dqaas import DQAAS, QRDQAAS
from animarl_algos.recipes.dqcil import DQCIL, QRDQCIL
from animarl_algos.recipes.dqdil import DQDIL, QRDQDIL
from animarl_algos.recipes.dqn import DQN
from animarl_algos.recipes.iq_learn import IQLearn
from animarl_algos.recipes.qrdqn import QRDQN
from animarl_algos.recipes.soft_bc import QRSoftBC, SoftBC
from animarl_envs.errors import InputError

__all__ = [
    "BC", "DQAAS", "DQCIL", "DQDIL", "DQN", "QRBC", "QRDQAAS", "QRDQCIL", "QRDQDIL", "QRDQN",
    "RECIPES", "IQLearn", "NamedRecipe", "QRSoftBC", "SoftBC", "named_recipe",
]  # fmt: skip


@dataclass(frozen=True)
class NamedRecipe:
    """A learner's class, and whether its name asks for the offline phase."""

    algorithm: type[SequenceQLearning]
    pretrained: bool


RECIPES: dict[str, NamedRecipe] = {
    "dqn": NamedRecipe(DQN, pretrained=False),
    "bc": NamedRecipe(BC, pretrained=True),
    "soft-bc": NamedRecipe(SoftBC, pretrained=True),
    "iq-learn": NamedRecipe(IQLearn, pretrained=True),
    "dqaas": NamedRecipe(DQAAS, pretrained=True),
    "dqdil": NamedRecipe(DQDIL, pretrained=False),
    "dqdil-pt": NamedRecipe(DQDIL, pretrained=True),
    "dqcil": NamedRecipe(DQCIL, pretrained=False),
    "dqcil-pt": NamedRecipe(DQCIL, pretrained=True),
    "qr-dqn": NamedRecipe(QRDQN, pretrained=False),
    "qr-bc": NamedRecipe(QRBC, pretrained=True),
    "qr-soft-bc": NamedRecipe(QRSoftBC, pretrained=True),
    "qr-dqaas": NamedRecipe(QRDQAAS, pretrained=True),
    "qr-dqdil": NamedRecipe(QRDQDIL, pretrained=False),
    "qr-dqdil-pt": NamedRecipe(QRDQDIL, pretrained=True),
    "qr-dqcil": NamedRecipe(QRDQCIL, pretrained=False),
    "qr-dqcil-pt": NamedRecipe(QRDQCIL, pretrained=True),
}


def named_recipe(name: str) -> NamedRecipe:
    """The learner called ``name``.

    Raises
    ------
    InputError
        If there is none of that name.
    """
    try:
        return RECIPES[name]
    except KeyError:
        raise InputError(
            f"algorithm {name!r} is unknown: choose one of {', '.join(RECIPES)}"
        ) from None
