"""What optuna may choose for each learner, by the terms of its recipe."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import optuna

from animarl_algos.recipes.registry import named_recipe

Params = dict[str, Any]
Sampler = Callable[[optuna.Trial, int, int, Params], Params]

ONLINE = {"learning_rate": (1e-6, 1e-3), "updates_per_episode": (0.25, 4.0)}
OFFLINE = {"offline_learning_rate": (1e-5, 1e-2)}
WEIGHTS = {"alpha": (0.01, 10.0), "lambda2": (0.1, 10.0), "lambda3": (0.1, 50.0)}
OFFLINE_WEIGHTS = {
    "offline_alpha": (0.1, 50.0), "offline_lambda2": (0.1, 50.0), "offline_lambda3": (0.1, 100.0)
}  # fmt: skip
LINEAR = {"gamma": (0.8, 0.99), "exploration_final_eps": (0.02, 0.5)}
QUANTILES = (10, 20, 50)


def ranges(algo: str) -> tuple[dict[str, tuple[float, float]], dict[str, tuple[float, float]]]:
    """Settings to search on a logarithmic and on a linear scale, with their ends."""
    named = named_recipe(algo)
    recipe = named.algorithm.recipe
    used = {
        "alpha": recipe.needs_distance,
        "lambda2": recipe.needs_condition,
        "lambda3": recipe.needs_alignment,
    }
    logarithmic: dict[str, tuple[float, float]] = {}
    if recipe.online:
        logarithmic |= ONLINE | {k: v for k, v in WEIGHTS.items() if used[k]}
    if named.pretrained:
        logarithmic |= OFFLINE
        logarithmic |= {
            k: v for k, v in OFFLINE_WEIGHTS.items() if used[k.removeprefix("offline_")]
        }
    return logarithmic, LINEAR if recipe.online else {}


def sampler(algo: str) -> Sampler:
    """A function that draws the settings of ``algo`` for a trial, as rl_zoo3 calls it.

    Of rl_zoo3's arguments the last holds settings that are given: those are not drawn.
    """
    logarithmic, linear = ranges(algo)

    def sample(trial: optuna.Trial, n_actions: int, n_envs: int, given: Params) -> Params:
        drawn: Params = {
            name: trial.suggest_float(name, low, high, log=True)
            for name, (low, high) in logarithmic.items()
            if name not in given
        }
        for name, (low, high) in linear.items():
            if name not in given:
                drawn[name] = trial.suggest_float(name, low, high)
        network = given.get("policy_kwargs") or {}
        if algo.startswith("qr-") and "n_quantiles" not in network:
            quantiles = trial.suggest_categorical("n_quantiles", QUANTILES)
            drawn["policy_kwargs"] = {"n_quantiles": quantiles}
        return drawn

    return sample
