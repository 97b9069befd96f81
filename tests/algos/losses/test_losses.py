"""Targets, losses and clipping against numbers worked out by hand."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import pytest
import torch
from given_values import GivenValues
from sb3_contrib.common.utils import quantile_huber_loss
from torch import nn

from animarl_algos.losses.terms import MinibatchValues, Phase, TreatmentAdversary
from animarl_algos.losses.values import (
    ValueDistribution,
    clip_grad_norm_per_individual,
    masked_mean,
    mean_recall,
    quantile_huber,
    quantile_huber_definition,
    reverse_gradient,
    take_action,
    treatment_counts,
)
from animarl_algos.networks.policies import PolicySettings
from animarl_envs.errors import InputError

# A three-step episode of one individual, two actions, gamma 0.5; steps are (1, 3, 1).
REWARDS = torch.tensor([1.0, 0.0, 2.0]).view(1, 3, 1)
ACTIONS = torch.tensor([0, 1, 0]).view(1, 3, 1)
VALUES = torch.tensor([[1.0, 0.0], [0.5, 2.0], [1.0, 9.0]]).view(1, 3, 1, 2, 1)
NEXT_ONLINE = torch.tensor([[0.5, 2.0], [1.0, 9.0], [4.0, 3.0]]).view(1, 3, 1, 2, 1)
NEXT_TARGET = torch.tensor([[8.0, 4.0], [8.0, 6.0], [2.0, 7.0]]).view(1, 3, 1, 2, 1)
CONTACT = torch.tensor([False, False, True]).view(1, 3, 1)


def double_q_target(
    rewards: torch.Tensor,
    terminated: torch.Tensor,
    next_online: torch.Tensor,
    next_target: torch.Tensor,
    gamma: float,
) -> torch.Tensor:
    """As the terms compute it; the state before the first step has no part in it."""

    def with_first(values: torch.Tensor) -> GivenValues:
        return GivenValues(torch.cat([torch.full_like(values[:, :1], 99.0), values], dim=1))

    minibatch = MinibatchValues(
        batch=SimpleNamespace(terminated=terminated.float()),  # type: ignore[arg-type]
        phase=Phase("online", gamma, 0.0, 0.0, 0.0, 0.0, None),
        distribution=ValueDistribution(),
        valid=torch.ones_like(terminated),
        online=with_first(next_online),
        target=with_first(next_target),
        treatment_logits=None,
        parameters=[],
    )
    return minibatch.double_q_target(rewards)


def test_ties_go_to_the_lowest_index() -> None:
    online = torch.zeros(1, 1, 1, 2, 1)
    target = double_q_target(REWARDS[:, :1], CONTACT[:, :1], online, NEXT_TARGET[:, :1], 0.5)
    assert target.item() == 1 + 0.5 * 8


@pytest.mark.parametrize(
    ("loss", "expected"),
    [
        # Errors: targets 3, 3, 2 minus Q of the actions taken, 1, 2, 1.
        ("squared", [4.0, 1.0, 1.0]),
        ("huber", [1.5, 0.5, 0.5]),
    ],
)
def test_expected_value_loss_by_hand(loss: Any, expected: list[float]) -> None:
    distribution = ValueDistribution(None, loss)
    target = double_q_target(REWARDS, CONTACT, NEXT_ONLINE, NEXT_TARGET, 0.5)
    found, error = distribution.td_loss(take_action(VALUES, ACTIONS), target)
    assert found.flatten().tolist() == expected
    assert error.flatten().tolist() == [2.0, 1.0, 1.0]


def test_quantile_target_and_loss_by_hand() -> None:
    """Two quantiles, spread by 1 to either side of the values above: tau = 1/4, 3/4."""
    spread = torch.tensor([-1.0, 1.0])
    distribution = ValueDistribution(2)
    target = double_q_target(REWARDS, CONTACT, NEXT_ONLINE + spread, NEXT_TARGET + spread, 0.5)
    assert target[0, :, 0].tolist() == [[2.5, 3.5], [2.5, 3.5], [2.0, 2.0]]
    loss, error = distribution.td_loss(take_action(VALUES + spread, ACTIONS), target)
    assert error.flatten().tolist() == [2.0, 1.0, 1.0]
    # Step 2: current (0, 2), target (2, 2): deltas of quantile 0 are 2, 2 (huber 1.5, weight 1/4),
    # of quantile 1 are 0: sum over quantiles of the mean over targets = 0.25 * 1.5.
    assert loss[0, 2, 0].item() == pytest.approx(0.375)
    # Step 0: current (0, 2), target (2.5, 3.5): 1/4 (2 + 3) / 2 + 3/4 (0.125 + 1) / 2.
    assert loss[0, 0, 0].item() == pytest.approx(0.625 + 0.421875)
    # Step 1: current (1, 3): 1/4 (1 + 2) / 2 + (1/4 * 0.125 [below: 1 - 3/4] + 3/4 * 0.125) / 2.
    assert loss[0, 1, 0].item() == pytest.approx(0.375 + 0.0625)


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
        with pytest.raises(InputError, match=f"{name} is {wrong!r}"):
            PolicySettings(**{name: wrong})


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


def test_a_gradient_hardly_too_long_is_clipped_and_none_is_no_error() -> None:
    parameter = nn.Parameter(torch.zeros(1, 2))
    parameter.grad = torch.tensor([[0.9, 1.2]])  # of length 1.5
    assert clip_grad_norm_per_individual([parameter], 1.0).item() == pytest.approx(1.5)
    torch.testing.assert_close(parameter.grad, torch.tensor([[0.6, 0.8]]))
    assert clip_grad_norm_per_individual([nn.Parameter(torch.zeros(1, 2))], 1.0).shape == (0,)


def test_a_broken_gradient_leaves_the_clipping_of_the_others() -> None:
    parameter = nn.Parameter(torch.zeros(2, 3))
    parameter.grad = torch.tensor([[30.0, 0.0, 0.0], [math.nan, 0.0, 0.0]])
    clip_grad_norm_per_individual([parameter], 10.0)
    torch.testing.assert_close(parameter.grad[0], torch.tensor([10.0, 0.0, 0.0]))


def test_gradient_reversal_is_minus_lambda_times_the_plain_gradient() -> None:
    x = torch.randn(4, 3, requires_grad=True)
    weight = torch.randn(4, 3)
    assert torch.equal(reverse_gradient(x, 2.5), x)
    (plain,) = torch.autograd.grad((x * weight).sum(), x)
    (reversed_,) = torch.autograd.grad((reverse_gradient(x, 2.5) * weight).sum(), x)
    torch.testing.assert_close(reversed_, -2.5 * plain)
