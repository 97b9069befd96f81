"""After offline training the demonstrated action ranks high among the thirteen (validation)."""

from __future__ import annotations

import pytest

from animarl_algos.data.vec_env import SlotVecEnv
from animarl_algos.learner.presets import constructed, learner_preset
from animarl_algos.recipes.registry import named_recipe

CHANCE = 3 / 13


@pytest.mark.parametrize("name", ["bc", "dqaas", "dqdil-pt", "qr-bc", "qr-dqaas", "qr-dqdil-pt"])
def test_the_demonstrated_action_is_among_the_top_three(name: str) -> None:
    """On the packaged agents; benchmarks/ranks.py gives the shares after whole training."""
    overrides = {"offline_epochs": 2, "offline_learning_rate": 1e-2, "buffer_size": 2000}
    preset = learner_preset(name, "AnimaRL/Agent-v0", "default", overrides)
    env = SlotVecEnv("agent", 1, **preset.env_kwargs)
    arguments = constructed(preset.arguments)
    model = named_recipe(name).algorithm(env=env, seed=0, device="cpu", **arguments)
    progress = model.pretrain()
    figures = progress.history[progress.best_epoch - 1]
    assert figures["val/top_3"] > 2 * CHANCE
    assert all(figures[f"val/top_3/{who}"] > 1.5 * CHANCE for who in env.individuals)
