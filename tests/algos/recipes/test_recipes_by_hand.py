"""The recipes' losses, gradients, ranks and schedules against numbers worked out by hand."""

from __future__ import annotations

import numpy as np
import pytest
import torch
import toys
from given_values import GivenValues
from pair_learners import SETTINGS, evaluated, make_pair_learner

from animarl_algos.learner.exploration import LinearDecay, boltzmann_nll, fit_boltzmann_temperature
from animarl_algos.learner.updates import sequence_priorities
from animarl_algos.learner.validation import demonstrated_rank
from animarl_algos.losses.terms import (
    MinibatchValues,
    ScoredActionsTemporalDifference,
    TemporalDifference,
    TreatmentAdversary,
)
from animarl_algos.recipes.registry import DQDIL
from animarl_algos.replay.store import SequenceBatch


def three_steps() -> SequenceBatch:
    """One episode of three steps and two actions, for one individual; the last step terminates."""
    column = (1, 3, 1)
    return SequenceBatch(
        observations=torch.zeros(1, 4, 1, 2),
        previous_actions=torch.full((1, 4, 1), 2),
        actions=torch.tensor([0, 1, 0]).view(column),
        rewards=torch.tensor([1.0, 0.0, 2.0]).view(column),
        penalties=torch.tensor([0.5, 0.0, 1.0]).view(column),
        terminated=torch.tensor([0.0, 0.0, 1.0]).view(column),
        mask=torch.tensor([1.0, 1.0, 1.0]).view(column),
        weights=torch.ones(1, 1),
        starts=torch.zeros(1, 1, dtype=torch.int64),
        lengths=torch.full((1, 1), 3),
        indices=np.zeros((1, 1), dtype=np.int64),
        labels=torch.tensor([0, 1, 0]).view(column),
        condition=torch.zeros(1, 1),
        active=np.ones(4, dtype=np.int64),
        action_penalties=torch.tensor([[0.0, 1.0], [1.0, 0.0], [0.0, 2.0]]).view(1, 3, 1, 2),
    )


def three_steps_evaluated() -> MinibatchValues:
    """Values: online (1, 2), (3, 1), (0, 4), (9, 9); the target network's ten times; gamma 0.5."""
    model = DQDIL("MlpPolicy", toys.Recall(2), **SETTINGS, alpha=2.0, gamma=0.5)
    minibatch = evaluated(model, three_steps())
    online = torch.tensor([[1.0, 2.0], [3.0, 1.0], [0.0, 4.0], [9.0, 9.0]]).view(1, 4, 1, 2, 1)
    minibatch.online, minibatch.target = GivenValues(online), GivenValues(10.0 * online)
    return minibatch


def test_temporal_difference_by_hand() -> None:
    """Targets: 1 + 15 = 16, 0 + 20 = 20, 2; values of the actions taken 1, 1, 0."""
    minibatch = three_steps_evaluated()
    loss = TemporalDifference()(minibatch)
    assert loss.item() == pytest.approx((15**2 + 19**2 + 2**2) / 3)
    priority = sequence_priorities(minibatch)
    assert priority is not None
    assert priority.item() == pytest.approx(0.9 * 19 + 0.1 * (15 + 19 + 2) / 3)


def test_the_distance_is_subtracted_with_its_weight() -> None:
    """Rewards become 0, 0, 0."""
    loss = TemporalDifference(shaped=True)(three_steps_evaluated())
    assert loss.item() == pytest.approx((14**2 + 19**2 + 0) / 3)


def test_all_actions_are_scored_by_hand() -> None:
    """Targets: (16, 14), (18, 20), (2, -2)."""
    loss = ScoredActionsTemporalDifference()(three_steps_evaluated())
    squares = [15**2 + 12**2, 15**2 + 19**2, 2**2 + 6**2]
    assert loss.item() == pytest.approx(sum(squares) / 6)


def test_masked_steps_enter_no_loss() -> None:
    minibatch = three_steps_evaluated()
    minibatch.valid[0, 1] = False
    assert TemporalDifference()(minibatch).item() == pytest.approx((15**2 + 2**2) / 2)


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


def test_epsilon_decays_linearly_then_stays() -> None:
    decay = LinearDecay(0.5, 0.3, 100)
    assert [decay(n) for n in (0, 50, 100, 1000)] == pytest.approx([0.5, 0.4, 0.3, 0.3])
