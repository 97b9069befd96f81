"""The recipes' losses, gradients, ranks and schedules against numbers worked out by hand."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from pair_learners import evaluated, make_pair_learner

from animarl_algos.learner.collecting import boltzmann_nll, fit_boltzmann_temperature
from animarl_algos.learner.pretraining import demonstrated_rank
from animarl_algos.losses.terms import (
    TreatmentAdversary,
)


def test_the_reversal_turns_the_encoders_gradient_alone() -> None:
    """Gradient of J_tr: minus the plain one before the reversal, the plain one behind it."""
    gradients = {}
    for reversal in (1.0, -1.0):  # a reversal of -1 is the identity
        model = make_pair_learner("dqcil", updates_per_episode=0.0)
        model.policy.q_net.reversal = reversal
        model.learn(40)
        assert model.replay_buffer is not None
        minibatch = evaluated(model, model.replay_buffer.sample(4), needs_target=False)
        model.policy.optimizer.zero_grad()
        TreatmentAdversary()(minibatch).sum().backward()  # type: ignore[no-untyped-call]
        gradients[reversal] = {
            name: p.grad for name, p in model.policy.q_net.named_parameters() if p.grad is not None
        }
    assert any(name.startswith("gru") for name in gradients[1.0])
    for name, gradient in gradients[1.0].items():
        sign = 1.0 if name.startswith("treatment") else -1.0
        torch.testing.assert_close(gradient, sign * gradients[-1.0][name])


def test_ties_rank_as_chance_does() -> None:
    values = np.array([[1.0, 1.0, 1.0], [3.0, 2.0, 1.0], [0.0, 5.0, 5.0]])
    np.testing.assert_array_equal(demonstrated_rank(values, np.array([0, 2, 1])), [2.0, 3.0, 1.5])


def test_the_temperature_is_recovered() -> None:
    rng = np.random.default_rng(0)
    values = rng.normal(size=(20_000, 5))
    gumbel = rng.gumbel(size=values.shape)
    actions = (values / 0.3 + gumbel).argmax(1)  # samples of softmax(values / 0.3)
    fitted = fit_boltzmann_temperature(values, actions)
    assert fitted == pytest.approx(0.3, rel=0.03)
    assert boltzmann_nll(values, actions, fitted) <= boltzmann_nll(values, actions, 0.3)


def test_a_few_actions_that_are_all_the_same_make_no_greedy_animal() -> None:
    """Those of a validation animal at rest: the likelihood alone is highest at temperature 0."""
    values = np.array([4.0, 0.0, 0.0]) + np.random.default_rng(0).normal(0, 0.1, size=(25, 3))
    actions = np.zeros(25, dtype=int)
    fitted = fit_boltzmann_temperature(values, actions)
    assert 0.5 < fitted < 1.0
    assert boltzmann_nll(values, actions, 0.01) < boltzmann_nll(values, actions, fitted)
