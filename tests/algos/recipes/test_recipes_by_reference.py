"""Whole runs of the learners against a plain reference that follows the same steps and draws."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch
from reference_learner import ALPHA, ReferenceLearner
from scripted_pair import ScriptedPair, log_draws

from animarl_algos.recipes.registry import named_recipe

STEPS = 120
TOLERANCE = 1e-4
SETTINGS: dict[str, Any] = {
    "learning_rate": lambda remaining: 0.01 * remaining,
    "buffer_size": 1000,
    "batch_size": 3,
    "gamma": 0.9,
    "alpha": 0.7,
    "lambda1": 1e-3,
    "lambda2": 0.6,
    "lambda3": 0.8,
    "max_grad_norm": 1.0,
    "tau": 0.3,
    "target_update_interval": (10, "step"),
    "learning_starts": 20,
    "exploration": "epsilon",
    "exploration_initial_eps": 0.5,
    "exploration_final_eps": 0.3,
    "exploration_steps": 100,
    "offline_epochs": 0,
    "seed": 5,
    "device": "cpu",
}
PIECES = {"sequence_length": 5, "burn_in": 2}
PAPERS_NETWORK: dict[str, Any] = {
    "hidden": 6, "depth": 2, "head_layers": 1, "dropout": 0.0, "previous_action": None
}  # fmt: skip
MEMORIES: dict[str, tuple[str, dict[str, Any]]] = {
    "recomputed state": ("GruPolicy", PIECES | {"state_mode": "recompute"}),
    "stored state": ("GruPolicy", PIECES | {"state_mode": "stored"}),
    "whole episodes": ("GruPolicy", {}),
    "feed-forward": ("MlpPolicy", PIECES),
}


@pytest.mark.parametrize("memory", MEMORIES)
@pytest.mark.parametrize("name", ["dqdil", "dqaas", "dqcil", "qr-dqdil", "qr-dqaas", "qr-dqcil"])
def test_a_run_equals_its_reference(name: str, memory: str) -> None:
    policy, pieces = MEMORIES[memory]
    env = ScriptedPair(2, flagged="dqcil" in name)
    network = PAPERS_NETWORK | ({"n_quantiles": 4} if name.startswith("qr") else {})
    model = named_recipe(name).algorithm(policy, env, **SETTINGS, **pieces, policy_kwargs=network)
    references = [ReferenceLearner(model, k, STEPS) for k in range(2)]
    log_draws(model, env)
    model.learn(STEPS)
    assert model._n_updates >= 8
    nets = (model.policy.q_net, model.policy.q_net_target)
    buffer = model.replay_buffer
    assert buffer is not None
    for k, reference in enumerate(references):
        begun = dict(reference.online)
        reference.follow(env.log)
        for net, expected in zip(nets, (reference.online, reference.target)):
            for part, parameter in net.named_parameters():
                torch.testing.assert_close(
                    parameter[k].double(), expected[part], rtol=0.0, atol=TOLERANCE, msg=part
                )
        moved = [(reference.online[n] - begun[n]).abs().max() for n in begun]
        assert max(moved) > 100 * TOLERANCE
        np.testing.assert_allclose(
            buffer.trees.priorities[k][: buffer.num_sequences],
            np.array(reference.priorities) ** ALPHA,
            rtol=0.0,
            atol=TOLERANCE,
        )


def test_the_run_holds_every_case() -> None:
    """Both ends, at different times in the two copies, and labels missing."""
    env = ScriptedPair(2)
    named_recipe("dqaas").algorithm("GruPolicy", env, **SETTINGS).learn(STEPS)
    assert any(step.terminated.any() for step in env.steps)
    assert any(step.truncated.any() for step in env.steps)
    assert sum(step.done[0] != step.done[1] for step in env.steps) > 10
    assert any((step.labels < 0).any() for step in env.steps)
