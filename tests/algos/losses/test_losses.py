"""Targets, losses and clipping against numbers worked out by hand."""

import math
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import pytest
import torch
from refusals import refuses
from sb3_contrib.common.utils import quantile_huber_loss
from torch import nn

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
from animarl_algos.losses.values import (
    ValueDistribution,
    clip_grad_norm_per_individual,
    masked_mean,
    mean_recall,
    quantile_huber,
    quantile_huber_definition,
    take_action,
    treatment_counts,
)
from animarl_algos.networks.policies import PolicySettings


@dataclass(frozen=True)
class GivenValues:
    """Made up, in the place of a network's (``terms.ActionValues``); (K, T + 1, B, A, Q)."""

    values: torch.Tensor

    @property
    def q_values(self) -> torch.Tensor:
        return self.values.mean(-1)

    def of_actions(self, actions: torch.Tensor) -> torch.Tensor:
        return take_action(self.values, actions)


@pytest.mark.parametrize(
    ("loss", "expected"), [("squared", [4.0, 1.0, 1.0]), ("huber", [1.5, 0.5, 0.5])]
)
def test_expected_value_loss_by_hand(loss: Any, expected: list[float]) -> None:
    taken, target = (
        torch.tensor(row).view(1, 3, 1, 1) for row in ([1.0, 2.0, 1.0], [3.0, 3.0, 2.0])
    )
    found, error = ValueDistribution(None, loss).td_loss(taken, target)
    assert found.flatten().tolist() == expected
    assert error.flatten().tolist() == [2.0, 1.0, 1.0]


def test_quantile_huber_equals_sb3_contrib_in_value_and_gradient() -> None:
    generator = torch.Generator().manual_seed(0)
    current = torch.randn(64, 9, generator=generator, requires_grad=True)
    target = 2 * torch.randn(64, 9, generator=generator)
    ours = quantile_huber(current, target)
    theirs = quantile_huber_loss(current, target)
    assert ours.shape == (64,)
    torch.testing.assert_close(ours.mean(), theirs)
    torch.testing.assert_close(
        torch.autograd.grad(ours.mean(), current)[0], torch.autograd.grad(theirs, current)[0]
    )


@pytest.mark.parametrize("spread", [0.1, 1.0, 20.0])  # within the threshold, around it, beyond
@pytest.mark.parametrize("quantiles", [2, 7, 20])
def test_quantile_huber_equals_its_definition(quantiles: int, spread: float) -> None:
    """Rows of any leading shape, each weighted differently, against autograd."""
    generator = torch.Generator().manual_seed(2)
    shape = (3, 5, 13, quantiles)
    current = spread * torch.randn(shape, generator=generator, dtype=torch.float64)
    target = spread * torch.randn(shape, generator=generator, dtype=torch.float64)
    target[0] = current[0].flip(-1)  # ties: some differences are exactly zero
    weight = torch.rand(shape[:-1], generator=generator, dtype=torch.float64)
    current.requires_grad_()
    ours, plain = quantile_huber(current, target), quantile_huber_definition(current, target)
    torch.testing.assert_close(ours, plain, rtol=1e-12, atol=1e-12)
    gradients = [torch.autograd.grad((weight * loss).sum(), current)[0] for loss in (ours, plain)]
    torch.testing.assert_close(*gradients, rtol=1e-12, atol=1e-12)
    # A view that is not contiguous, in single precision.
    single = current.detach().float().transpose(0, 1).requires_grad_()
    ours = quantile_huber(single, target.float().transpose(0, 1))
    torch.testing.assert_close(ours, plain.float().transpose(0, 1), rtol=1e-6, atol=1e-6)


def test_quantile_huber_passes_on_what_is_not_a_number() -> None:
    """So that a run that diverges is noticed."""
    current = torch.tensor([[0.0, 1.0], [0.0, 1.0]], requires_grad=True)
    loss = quantile_huber(current, torch.tensor([[math.nan, 0.0], [0.0, 1.0]]))
    assert loss.isnan().tolist() == [True, False]
    loss.sum().backward()  # type: ignore[no-untyped-call]
    assert current.grad is not None and current.grad.isnan().any(1).tolist() == [True, False]


def test_the_choice_of_distribution() -> None:
    values = torch.arange(12.0).view(2, 3, 2)
    assert take_action(values, torch.tensor([2, 0])).tolist() == [[4, 5], [6, 7]]
    for name, wrong in (("n_quantiles", 1), ("n_quantiles", 2.5), ("td_loss", "hubber")):
        refuses(f"{name} is {wrong!r}", PolicySettings, **{name: wrong})


def test_masked_mean_counts_each_individuals_own_steps() -> None:
    per_step = torch.tensor([[[1.0], [3.0], [math.inf]], [[5.0], [7.0], [9.0]]])
    valid = torch.tensor([[[True], [True], [False]], [[True], [True], [True]]])
    assert masked_mean(per_step, valid).tolist() == [2.0, 7.0]
    weights = torch.tensor([[0.5], [2.0]])
    assert masked_mean(per_step, valid, weights).tolist() == [1.0, 14.0]
    assert masked_mean(per_step, torch.zeros_like(valid)).tolist() == [0.0, 0.0]
    assert masked_mean(per_step, valid & (per_step == 3.0)).tolist() == [3.0, 0.0]


def test_conditions_belong_to_their_own_individual_and_column() -> None:
    """Three individuals, two steps, three columns: no two axes can be mistaken unnoticed."""
    generator = torch.Generator().manual_seed(4)
    logits = torch.randn(3, 2, 3, generator=generator)
    condition = torch.tensor([[1, 0, 0], [1, 1, 0], [0, 1, 1]])
    valid = torch.rand(3, 2, 3, generator=generator) < 0.8
    counts, losses = torch.zeros(3, 2, 2, dtype=torch.int64), torch.zeros(3)
    for k, t, b in valid.nonzero().tolist():
        sign = 1.0 if condition[k, b] else -1.0
        losses[k] += math.log1p(math.exp(-sign * float(logits[k, t, b])))
        counts[k, condition[k, b]] += torch.tensor([sign * float(logits[k, t, b]) > 0, True])
    assert torch.equal(treatment_counts(logits, condition, valid), counts)
    batch = SimpleNamespace(condition=condition, weights=None)
    given = SimpleNamespace(batch=batch, treatment_logits=logits, valid=valid)
    torch.testing.assert_close(TreatmentAdversary()(given), losses / valid.sum((1, 2)))


def test_balanced_accuracy_weighs_both_treatments_equally() -> None:
    logits = torch.tensor([[[1.0, 1.0, 1.0, 1.0, -1.0]]])
    condition = torch.tensor([[1, 1, 1, 0, 0]])
    valid = torch.ones(1, 1, 5, dtype=torch.bool)
    assert mean_recall(treatment_counts(logits, condition, valid)).item() == 0.75
    undecided = treatment_counts(torch.zeros(1, 1, 5), condition, valid)
    assert undecided.tolist() == [[[2, 2], [0, 3]]]  # evens are told as treatment 0
    valid[..., 3] = False
    assert mean_recall(treatment_counts(logits, condition, valid)).item() == 1.0
    one = treatment_counts(logits[..., :3], condition[..., :3], valid[..., :3])
    assert mean_recall(one).isnan().all()


def test_clipping_equals_torch_for_each_individual() -> None:
    generator = torch.Generator().manual_seed(0)
    parameters = [nn.Parameter(torch.zeros(3, 4, 2)), nn.Parameter(torch.zeros(3, 1, 5))]
    parameters.append(nn.Parameter(torch.zeros(3, 2)))  # has no gradient
    scales = torch.tensor([0.01, 1.0, 50.0])
    for p in parameters[:2]:
        p.grad = torch.randn(p.shape, generator=generator) * scales.view(3, 1, 1)
    before = [p.grad.clone() for p in parameters[:2]]
    norms = clip_grad_norm_per_individual(parameters, 1.0)
    for k in range(3):
        alone = [nn.Parameter(torch.zeros_like(g[k])) for g in before]
        for p, g in zip(alone, before):
            p.grad = g[k].clone()
        norm = nn.utils.clip_grad_norm_(alone, 1.0)
        torch.testing.assert_close(norms[k], norm)
        for p, q in zip(parameters, alone):
            torch.testing.assert_close(p.grad[k], q.grad)
    assert torch.equal(parameters[0].grad[0], before[0][0])  # small gradients are left alone


def test_a_broken_gradient_or_none_leaves_the_clipping_of_the_others() -> None:
    parameter = nn.Parameter(torch.zeros(2, 3))
    parameter.grad = torch.tensor([[30.0, 0.0, 0.0], [math.nan, 0.0, 0.0]])
    assert clip_grad_norm_per_individual([nn.Parameter(torch.zeros(1, 2))], 1.0).shape == (0,)
    clip_grad_norm_per_individual([parameter], 10.0)
    torch.testing.assert_close(parameter.grad[0], torch.tensor([10.0, 0.0, 0.0]))


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
        num_steps=2, actions=torch.tensor([[[0, 2], [1, 1]], [[2, 0], [0, 1]]]),
        rewards=drawn(*SHAPE), penalties=drawn(*SHAPE).abs(),
        terminated=torch.tensor([[[0.0, 0.0], [1.0, 0.0]], [[0.0, 1.0], [0.0, 0.0]]]),
        weights=torch.tensor([[1.0, 0.5], [0.25, 1.0]], dtype=torch.float64),
        labels=torch.tensor([[[1, -1], [0, 2]], [[2, 1], [-1, 0]]]),
        condition=torch.tensor([[0.0, 1.0], [1.0, 0.0]]), action_penalties=drawn(*SHAPE, 3).abs(),
        label_shares=None,
    )  # fmt: skip
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


def test_of_equal_values_the_first_is_the_best() -> None:
    given = minibatch()
    given.online = GivenValues(torch.zeros(2, 3, 2, 3, 1))
    assert given.target is not None
    ahead = torch.where(given.batch.terminated > 0, 0.0, 0.5) * given.target.q_values[:, 1:, :, 0]
    found = given.double_q_target(torch.zeros(SHAPE))
    torch.testing.assert_close(found[..., 0], ahead)


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
