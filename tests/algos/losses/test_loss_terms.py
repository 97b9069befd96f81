"""The loss terms on a made-up minibatch of two individuals, each number worked out by hand."""

from __future__ import annotations

import dataclasses
import math
from types import SimpleNamespace
from typing import Any

import pytest
import torch
from given_values import GivenValues

from animarl_algos.losses.terms import (
    ActionSupervision,
    LossTerm,
    MinibatchValues,
    Phase,
    ScoredActionsTemporalDifference,
    TemporalDifference,
    TreatmentAdversary,
    WeightDecay,
)
from animarl_algos.losses.values import ValueDistribution
from animarl_envs.errors import InputError

# Two individuals, two steps, two columns, three actions; steps are (K, T, B).
SHAPE = (2, 2, 2)
VALID = torch.tensor([[[1, 1], [1, 0]], [[1, 1], [1, 1]]], dtype=torch.bool)


def phase(**changed: Any) -> Phase:
    numbers: dict[str, Any] = {
        "name": "online", "gamma": 0.5, "alpha": 2.0, "lambda1": 0.1, "lambda2": 0.2,
        "lambda3": 0.3, "max_grad_norm": None,
    }  # fmt: skip
    return Phase(**numbers | changed)


def minibatch(seed: int = 0, quantiles: int = 1, **numbers: Any) -> MinibatchValues:
    generator = torch.Generator().manual_seed(seed)

    def drawn(*shape: int) -> torch.Tensor:
        return torch.randn(*shape, generator=generator, dtype=torch.float64)

    batch = SimpleNamespace(
        num_steps=2,
        actions=torch.tensor([[[0, 2], [1, 1]], [[2, 0], [0, 1]]]),
        rewards=drawn(*SHAPE),
        penalties=drawn(*SHAPE).abs(),
        terminated=torch.tensor([[[0.0, 0.0], [1.0, 0.0]], [[0.0, 1.0], [0.0, 0.0]]]),
        weights=torch.tensor([[1.0, 0.5], [0.25, 1.0]], dtype=torch.float64),
        labels=torch.tensor([[[1, -1], [0, 2]], [[2, 1], [-1, 0]]]),
        condition=torch.tensor([[0.0, 1.0], [1.0, 0.0]]),
        action_penalties=drawn(*SHAPE, 3).abs(),
        label_shares=None,
    )
    return MinibatchValues(
        batch=batch,  # type: ignore[arg-type]
        phase=phase(**numbers),
        distribution=ValueDistribution(None if quantiles == 1 else quantiles),
        valid=VALID,
        online=GivenValues(drawn(2, 3, 2, 3, quantiles)),
        target=GivenValues(drawn(2, 3, 2, 3, quantiles)),
        treatment_logits=drawn(*SHAPE),
        parameters=[drawn(2, 4).requires_grad_(), drawn(2, 1, 3)],
    )


def averaged(per_step: dict[tuple[int, int, int], float], given: MinibatchValues) -> torch.Tensor:
    """What :func:`masked_mean` is to make of numbers at ``(k, t, b)``, without it."""
    sums, counts = [0.0, 0.0], [0, 0]
    for (k, t, b), number in per_step.items():
        if VALID[k, t, b]:
            sums[k] += number * float(given.batch.weights[k, b])
            counts[k] += 1
    return torch.tensor([s / max(n, 1) for s, n in zip(sums, counts)], dtype=torch.float64)


def steps() -> list[tuple[int, int, int]]:
    return [(k, t, b) for k in range(2) for t in range(2) for b in range(2)]


def bootstrapped(given: MinibatchValues, k: int, t: int, b: int) -> float:
    assert given.target is not None
    best = int(given.online.values[k, t + 1, b, :, 0].argmax())
    ahead = 0.5 * float(given.target.values[k, t + 1, b, best, 0])
    return 0.0 if given.batch.terminated[k, t, b] else ahead


@pytest.mark.parametrize("shaped", [False, True])
def test_the_action_taken_is_regressed_towards_the_double_q_target(shaped: bool) -> None:
    given = minibatch()
    loss = TemporalDifference(shaped=shaped)(given)
    errors = {}
    for k, t, b in steps():
        reward = float(given.batch.rewards[k, t, b])
        reward -= 2.0 * float(given.batch.penalties[k, t, b]) if shaped else 0.0
        taken = float(given.online.values[k, t, b, int(given.batch.actions[k, t, b]), 0])
        errors[k, t, b] = reward + bootstrapped(given, k, t, b) - taken
    squares = {step: error**2 for step, error in errors.items()}
    torch.testing.assert_close(loss, averaged(squares, given))
    assert given.errors is not None
    for step, error in errors.items():
        assert given.errors[step].item() == pytest.approx(abs(error))


@pytest.mark.parametrize("scaled", [False, True])
def test_every_action_is_regressed_with_its_own_penalty(scaled: bool) -> None:
    given = minibatch(scaled_penalties=scaled)
    loss = ScoredActionsTemporalDifference()(given)
    penalties = given.batch.action_penalties
    assert penalties is not None
    mean = [float(penalties[k][VALID[k]].mean()) if scaled else 1.0 for k in range(2)]
    squares, errors = {}, {}
    for k, t, b in steps():
        target = float(given.batch.rewards[k, t, b]) + bootstrapped(given, k, t, b)
        missed = [
            target - 2.0 * float(penalties[k, t, b, a]) / mean[k]
            - float(given.online.values[k, t, b, a, 0])
            for a in range(3)
        ]  # fmt: skip
        squares[k, t, b] = sum(m**2 for m in missed) / 3
        errors[k, t, b] = sum(abs(m) for m in missed) / 3 if VALID[k, t, b] else 0.0
    torch.testing.assert_close(loss, averaged(squares, given))
    assert given.errors is not None
    for step, error in errors.items():
        assert given.errors[step].item() == pytest.approx(error)


def test_scored_actions_of_quantiles_are_each_an_action_taken() -> None:
    """Axes: with the reward lowered by an action's penalty, as if that action had been taken."""
    given = minibatch(quantiles=4)
    loss = ScoredActionsTemporalDifference()(given)
    penalties, rewards = given.batch.action_penalties, given.batch.rewards
    assert penalties is not None
    each = []
    for a in range(3):
        given.batch.actions = torch.full(SHAPE, a)
        given.batch.rewards = rewards - 2.0 * penalties[..., a]
        each.append(TemporalDifference()(given))
    torch.testing.assert_close(loss, torch.stack(each).mean(0))


def test_scored_actions_need_penalties() -> None:
    given = minibatch()
    given.batch.action_penalties = None
    with pytest.raises(InputError, match="no penalties of all actions"):
        ScoredActionsTemporalDifference()(given)


def cross_entropy(given: MinibatchValues, k: int, t: int, b: int, action: int) -> float:
    logits = given.online.values[k, t, b, :, 0].tolist()
    return math.log(sum(math.exp(x) for x in logits)) - float(logits[action])


@pytest.mark.parametrize(
    "term", [ActionSupervision(), ActionSupervision(weighted=False, soft=True)]
)
def test_supervision_is_the_cross_entropy_of_the_labels(term: LossTerm) -> None:
    given = minibatch()
    sums, counts = [0.0, 0.0], [0, 0]
    for k, t, b in steps():
        label = int(given.batch.labels[k, t, b])
        if VALID[k, t, b] and label >= 0:
            weight = float(given.batch.weights[k, b])
            sums[k] += weight * cross_entropy(given, k, t, b, label)
            counts[k] += 1
    expected = [s / n for s, n in zip(sums, counts)]
    given.online.values.requires_grad_()
    loss = term(given)
    assert counts == [2, 3] and loss.tolist() == pytest.approx(expected)
    (slope,) = torch.autograd.grad(loss.sum(), given.online.values)
    for k, t, b in steps():
        enters = bool(VALID[k, t, b]) and int(given.batch.labels[k, t, b]) >= 0
        assert bool(slope[k, t, b].abs().sum() > 0) == enters


def test_soft_labels_share_the_cross_entropy_out() -> None:
    given = minibatch()
    shares = torch.zeros(*SHAPE, 3, dtype=torch.float64)
    shares[0, 0, 0] = torch.tensor([0.5, 0.3, 0.2])
    shares[1, 1, 1] = torch.tensor([0.0, 1.0, 0.0])
    shares[1, 0, 0] = torch.tensor([0.1, 0.0, 0.9])
    shares[0, 1, 1] = torch.tensor([1.0, 0.0, 0.0])  # of a step that is not valid
    given.batch.label_shares = shares
    first = sum(s * cross_entropy(given, 0, 0, 0, a) for a, s in enumerate((0.5, 0.3, 0.2)))
    second = 1.0 * cross_entropy(given, 1, 1, 1, 1)  # weights 1 and 0.25 of the two columns
    third = sum(s * cross_entropy(given, 1, 0, 0, a) for a, s in enumerate((0.1, 0.0, 0.9)))
    loss = ActionSupervision(weighted=False, soft=True)(given)
    assert loss.tolist() == pytest.approx([first, (second + 0.25 * third) / 2])


def test_the_adversary_is_the_cross_entropy_of_the_condition() -> None:
    given = minibatch()
    assert given.treatment_logits is not None
    losses = {}
    for k, t, b in steps():
        logit, condition = float(given.treatment_logits[k, t, b]), given.batch.condition[k, b]
        losses[k, t, b] = math.log1p(math.exp(-logit if condition else logit))
    torch.testing.assert_close(TreatmentAdversary()(given), averaged(losses, given))


def test_weight_decay_is_a_number_without_gradient() -> None:
    given = minibatch()
    loss = WeightDecay()(given)
    squares = [sum(float(x) ** 2 for p in given.parameters for x in p[k].flatten()) for k in (0, 1)]
    assert loss.tolist() == pytest.approx(squares) and not loss.requires_grad


@pytest.mark.parametrize(
    ("term", "name", "weight", "needs_target"),
    [
        (TemporalDifference(), "td", 1.0, True),
        (ScoredActionsTemporalDifference(), "td", 1.0, True),
        (ActionSupervision(), "supervision", 0.3, False),
        (ActionSupervision(weighted=False), "supervision", 1.0, False),
        (ActionSupervision(weighted=False, soft=True), "supervision", 1.0, False),
        (TreatmentAdversary(), "treatment", 0.2, False),
        (WeightDecay(), "l2", 0.1, False),
    ],
)
def test_terms_say_what_they_weigh_and_need(
    term: LossTerm, name: str, weight: float, needs_target: bool
) -> None:
    """What needs no target network does without: then the last states may be left out too."""
    assert (term.name, term.weight(phase()), term.needs_target) == (name, weight, needs_target)
    with pytest.raises(dataclasses.FrozenInstanceError):
        term.name = "other"  # type: ignore[misc]
    if not needs_target:
        given = minibatch()
        whole = term(given)
        given.target, given.online = None, GivenValues(given.online.values[:, :2])
        torch.testing.assert_close(term(given), whole)
        assert given.errors is None


@pytest.mark.parametrize("n_steps", [1, 2, 4, 9])
def test_the_target_sums_rewards_as_far_as_the_sequence_goes(n_steps: int) -> None:
    generator = torch.Generator().manual_seed(0)
    lengths, last = torch.tensor([[6, 3]]), {0: False, 1: True}  # the second one terminates
    terminated = torch.zeros(1, 6, 2)
    terminated[0, 2, 1] = 1.0
    rewards = torch.randn(1, 6, 2, generator=generator)
    online = torch.randn(1, 7, 2, 3, 1, generator=generator)
    target = torch.randn(1, 7, 2, 3, 1, generator=generator)
    given = MinibatchValues(
        batch=SimpleNamespace(num_steps=6, lengths=lengths, terminated=terminated),  # type: ignore[arg-type]
        phase=phase(n_steps=n_steps),
        distribution=ValueDistribution(),
        valid=torch.ones(1, 6, 2, dtype=torch.bool),
        online=GivenValues(online),
        target=GivenValues(target),
        treatment_logits=None,
        parameters=[],
    )
    found = given.double_q_target(rewards)
    gamma = given.phase.gamma
    for b, ends in last.items():
        for t in range(int(lengths[0, b])):
            stop = min(t + n_steps, int(lengths[0, b]))
            wanted = sum(gamma ** (s - t) * float(rewards[0, s, b]) for s in range(t, stop))
            if not (ends and stop == lengths[0, b]):
                best = int(online[0, stop, b, :, 0].argmax())
                wanted += gamma ** (stop - t) * float(target[0, stop, b, best, 0])
            assert found[0, t, b, 0].item() == pytest.approx(wanted, abs=1e-5)
