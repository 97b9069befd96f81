"""How the zoo's training scores policies: as they act."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from commands import Done
from stable_baselines3.common import callbacks
from zoo_commands import AGENT, TINY
from zoo_commands import small as small
from zoo_commands import zoo as zoo

from animarl_algos.zoo import manager


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
