"""Learners for the environments of ``animarl_envs``: data, recipes, evaluation, command line.

``from animarl_algos import DQDIL, SlotVecEnv`` is all that training in Python needs. The names, all
learners of :mod:`animarl_algos.recipes.registry` among them, are loaded when they are first asked
for, so that importing the package costs nothing.
"""

from __future__ import annotations

from functools import cache
from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from animarl_algos.data.vec_env import SlotVecEnv as SlotVecEnv
    from animarl_algos.evaluation.comparison import evaluate as evaluate
    from animarl_algos.learner.callbacks import EvaluateIndividuals as EvaluateIndividuals
    from animarl_algos.learner.callbacks import evaluate_individuals as evaluate_individuals
    from animarl_algos.recipes.registry import *  # noqa: F403
    from animarl_algos.runs.pretrained import load_pretrained as load_pretrained
    from animarl_algos.runs.pretrained import load_run as load_run


@cache
def _homes() -> dict[str, str]:
    """Return the module of every public name.

    Those of the learners are the classes of the registry, which is read and not run: that would
    load all that learns.
    """
    import ast
    from importlib.resources import files

    home = f"{__name__}.recipes.registry"
    registry = ast.parse((files(f"{__name__}.recipes") / "registry.py").read_text(encoding="utf-8"))
    learners = {
        node.value: home
        for statement in registry.body
        if isinstance(statement, ast.Assign) and ast.unparse(statement.targets[0]) == "__all__"
        for node in ast.walk(statement.value)
        if isinstance(node, ast.Constant)
        and isinstance(node.value, str)
        and node.value not in ("RECIPES", "NamedRecipe", "named_recipe")
    }
    others = {
        "EvaluateIndividuals": "learner.callbacks",
        "SlotVecEnv": "data.vec_env",
        "evaluate": "evaluation.comparison",
        "evaluate_individuals": "learner.callbacks",
        "load_run": "runs.pretrained",
        "load_pretrained": "runs.pretrained",
    }
    return learners | {name: f"{__name__}.{module}" for name, module in others.items()}


def __getattr__(name: str) -> Any:
    """Load a public name; from then on it is an attribute like any other."""
    value: Any
    if name == "__all__":
        value = sorted(_homes())
    elif not name.startswith("_") and name in _homes():
        value = getattr(import_module(_homes()[name]), name)
    else:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *_homes(), "__all__"})
