"""How the zoo's commands act: by the rule that was saved with the model."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from commands import Done
from stable_baselines3.common import callbacks
from zoo_commands import AGENT, CARTPOLE, TINY
from zoo_commands import small as small
from zoo_commands import zoo as zoo

from animarl_algos.recipes.registry import RECIPES
from animarl_algos.zoo import enjoy, manager


@pytest.mark.parametrize(
    ("asked", "rule"),
    [
        ([], "boltzmann:2"),
        (["--stochastic"], "boltzmann:2"),
        (["--deterministic"], "greedy"),
        (["--acting", "epsilon:0.1"], "epsilon:0.1"),
        (["--acting=boltzmann:0.5"], "boltzmann:0.5"),
    ],
)
def test_enjoy_acts_by_the_saved_rule_unless_told(
    asked: list[str], rule: str, zoo: Callable[..., Done], monkeypatch: pytest.MonkeyPatch
) -> None:
    model = RECIPES["dqn"].algorithm("MlpPolicy", "CartPole-v1")
    model.policy.epsilon, model.policy.temperature = 0.3, 2.0
    model.save("warm.zip")
    rules: list[str] = []
    monkeypatch.setattr(enjoy, "run", lambda m, *_: rules.append(str(m.policy.acting)))
    done = zoo("enjoy", "--algo=dqn", *CARTPOLE[:2], "--no-render", "--model", "warm.zip", *asked)
    assert rules == [rule] and f"Acting: {rule}\n" in done.stdout, done.stderr


@pytest.mark.parametrize("exploration", ["epsilon", "boltzmann"])
def test_training_scores_a_policy_that_samples_as_it_acts(
    exploration: str, zoo: Callable[..., Done], small: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By the best actions otherwise, as rl_zoo3 does; its callback and optuna's alike."""
    greedily: list[tuple[bool, str]] = []

    def score(model: Any, *_: Any, deterministic: bool, **asked: Any) -> Any:
        greedily.append((deterministic, str(model.policy.acting.kind)))
        return ([0.0], [1]) if asked.get("return_episode_rewards") else (0.0, 0.0)

    monkeypatch.setattr(callbacks, "evaluate_policy", score)
    monkeypatch.setattr(manager, "evaluate_policy", score)
    told = ["--algo", "dqdil-pt", "--env", AGENT, *TINY, "--env-kwargs", f"demos:{small}",
            "-params", "offline_epochs:1", f"exploration:{exploration}"]  # fmt: skip
    for command in (["train"], ["optimize", "--n-trials", "1", "--pruner", "none"]):
        done = zoo(*command, *told)
        assert done.returncode == 0, done.stderr
    assert len(greedily) > 2 and set(greedily) == {(exploration == "epsilon", exploration)}
