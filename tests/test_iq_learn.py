"""IQ-Learn's terms by hand, what they are minimal at, and what it does to a clone."""

from __future__ import annotations

import math

import pytest
import torch
from torch.nn import functional

from animarl_algos.losses.iq_learn import (
    ImpliedRewards,
    soft_value,
    value_after,
)
from animarl_algos.networks.networks import StackedQNetwork
from animarl_algos.networks.value_stream import zero_value_stream

LOG2, LOG3 = math.log(2.0), math.log(3.0)


def two_rows() -> ImpliedRewards:
    """One individual, two actions; the first row is demonstrated and ends, the second goes on.

    Q = (log 2, 0), (0, 0); the actions are 0 and 1; V' = 4 by absorption, and log 2 from (0, 0).
    """
    q = torch.tensor([[[LOG2, 0.0], [0.0, 0.0]]])
    after = value_after(torch.zeros((1, 2, 2)), torch.tensor([[4.0, torch.nan]]))
    return ImpliedRewards(
        q_values=q,
        actions=torch.tensor([[0, 1]]),
        next_value=after,
        demonstrated=torch.tensor([True, False]),
        gamma=0.5,
    )


def test_terms_by_hand() -> None:
    rows = two_rows()
    assert soft_value(rows.q_values).tolist() == [pytest.approx([LOG3, LOG2])]
    rewards = [LOG2 - 0.5 * 4.0, 0.0 - 0.5 * LOG2]
    assert rows.reward.tolist() == [pytest.approx(rewards)]
    assert rows.demonstrated_reward().item() == pytest.approx(-rewards[0])
    worth = ((LOG3 - 2.0) + (LOG2 - 0.5 * LOG2)) / 2
    assert rows.policy_worth().item() == pytest.approx(worth)
    squares = (rewards[0] ** 2 + rewards[1] ** 2) / 4
    assert rows.squared_reward().item() == pytest.approx(squares)
    assert rows.loss().item() == pytest.approx(-rewards[0] + worth + squares)


def test_an_ended_episode_passes_no_gradient_to_what_the_network_says_of_its_end() -> None:
    next_q = torch.zeros((1, 2, 3), requires_grad=True)
    value_after(next_q, torch.tensor([[1.0, torch.nan]])).sum().backward()
    assert next_q.grad is not None
    assert (next_q.grad[0, 0] == 0.0).all()
    assert next_q.grad[0, 1].tolist() == pytest.approx([1 / 3] * 3)


def test_individuals_are_their_own() -> None:
    generator = torch.Generator().manual_seed(0)
    q = torch.randn((3, 8, 5), generator=generator)
    actions = torch.randint(5, (3, 8), generator=generator)
    after = torch.randn((3, 8), generator=generator)
    demonstrated = torch.arange(8) < 4
    together = ImpliedRewards(q, actions, after, demonstrated, 0.9).loss()
    for k in range(3):
        alone = ImpliedRewards(
            q[k : k + 1], actions[k : k + 1], after[k : k + 1], demonstrated, 0.9
        )
        assert together[k].item() == pytest.approx(alone.loss().item(), abs=1e-6)


def test_without_a_future_and_unregularised_it_is_cloning() -> None:
    """One state, actions demonstrated 1, 2 and 5 times in 8: the policy takes over these shares."""
    actions = torch.tensor([[0, 1, 1, 2, 2, 2, 2, 2]])
    q = torch.zeros((1, 1, 3), requires_grad=True)
    optimizer = torch.optim.Adam([q], lr=0.05)
    for _ in range(600):
        rows = ImpliedRewards(
            q.expand(1, 8, 3), actions, torch.zeros((1, 8)), torch.ones(8, dtype=torch.bool), 0.0
        )
        optimizer.zero_grad()
        (rows.demonstrated_reward() + rows.policy_worth()).sum().backward()
        optimizer.step()
    shares = functional.softmax(q[0, 0].detach(), dim=-1)
    assert shares.tolist() == pytest.approx([1 / 8, 2 / 8, 5 / 8], abs=5e-3)


@pytest.mark.parametrize("quantiles", [1, 4])
@pytest.mark.parametrize("recurrent", [False, True])
def test_zeroing_the_value_stream_keeps_the_policy(recurrent: bool, quantiles: int) -> None:
    network = StackedQNetwork(
        ("a", "b"), 4, 5, num_quantiles=quantiles, recurrent=recurrent, seed=1
    )
    with torch.no_grad():
        network.dueling.value.bias.fill_(-100.0)  # as after cloning
    generator = torch.Generator().manual_seed(0)
    observations = torch.randn((2, 3, 6, 4), generator=generator)
    previous = torch.randint(6, (2, 3, 6), generator=generator)
    before = network(observations, previous).q_values.detach()
    zero_value_stream(network)
    after = network(observations, previous).q_values.detach()
    torch.testing.assert_close(after.mean(-1), torch.zeros((2, 3, 6)), atol=1e-5, rtol=0.0)
    torch.testing.assert_close(
        functional.softmax(before, -1), functional.softmax(after, -1), atol=1e-5, rtol=0.0
    )
    assert before.mean().item() < -90.0
