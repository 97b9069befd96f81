"""Learners for the environments of ``animarl_envs``: data, recipes, evaluation, command line.

``from animarl_algos import DQDIL, SlotVecEnv`` is all that training in Python needs. The names
below are loaded when they are first asked for, so that importing the package costs nothing.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from animarl_algos.data.vec_env import SlotVecEnv
    from animarl_algos.evaluation.tables import evaluate
    from animarl_algos.recipes.bc import BC, QRBC
    from animarl_algos.recipes.dqaas import DQAAS, QRDQAAS
    from animarl_algos.recipes.dqcil import DQCIL, QRDQCIL
    from animarl_algos.recipes.dqdil import DQDIL, QRDQDIL
    from animarl_algos.recipes.dqn import DQN
    from animarl_algos.recipes.qrdqn import QRDQN

_HOME = {
    "DQN": "recipes.dqn",
    "QRDQN": "recipes.qrdqn",
    "BC": "recipes.bc",
    "QRBC": "recipes.bc",
    "DQAAS": "recipes.dqaas",
    "QRDQAAS": "recipes.dqaas",
    "DQDIL": "recipes.dqdil",
    "QRDQDIL": "recipes.dqdil",
    "DQCIL": "recipes.dqcil",
    "QRDQCIL": "recipes.dqcil",
    "SlotVecEnv": "data.vec_env",
    "evaluate": "evaluation.tables",
}

__all__ = [
    "BC", "DQAAS", "DQCIL", "DQDIL", "DQN", "QRBC", "QRDQAAS", "QRDQCIL", "QRDQDIL", "QRDQN",
    "SlotVecEnv", "evaluate",
]  # fmt: skip


def __getattr__(name: str) -> Any:
    """Load a public name; from then on it is an attribute like any other."""
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module(f"{__name__}.{_HOME[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
