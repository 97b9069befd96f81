"""IQ-Learn's terms by hand, what they are minimal at, and what it does to a clone."""

from __future__ import annotations

import math
from dataclasses import fields
from typing import Any

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from torch.nn import functional

from animarl_algos.data.vec_env import SlotVecEnv
from animarl_algos.learner.iq_learn import IQLearnSettings, iq_learn
from animarl_algos.learner.transition_rows import Collector, EndValues, Rows, demonstrated_rows
from animarl_algos.losses.iq_learn import ImpliedRewards, soft_value, value_after
from animarl_algos.networks.networks import StackedQNetwork
from animarl_algos.networks.value_stream import zero_value_stream
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.packaged import load_packaged
from animarl_envs.errors import InputError

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


# -- rows and the online phase --------------------------------------------------------------------

VALUES = EndValues(success=5.0)


def world(**options: Any) -> SlotVecEnv:
    return SlotVecEnv("agent", 4, **options)


def network_of(env: SlotVecEnv, *, recurrent: bool = True) -> StackedQNetwork:
    size = env.observation_space.shape[0]  # type: ignore[index]
    return StackedQNetwork(env.individuals, size, 13, units=16, recurrent=recurrent, seed=0)


def outcomes_of(env: SlotVecEnv) -> NDArray[np.int8]:
    assert env.demos is not None
    return env.demos.select(split="train").outcome


@pytest.fixture(scope="module")
def few() -> Demonstrations:
    """Eight training episodes, three of them ended by contact and some cut by the clock."""
    demos = load_packaged("agent").select(split="train")
    short = np.argsort(demos.lengths)
    kinds = (demos.outcome > 0, demos.outcome < 0, demos.outcome == 0)
    return demos.select(episodes=np.concatenate([short[kind[short]][:3] for kind in kinds]))


@pytest.mark.parametrize("recurrent", [False, True])
def test_rows_of_demonstrations_are_the_whole_sequences_taken_apart(
    few: Demonstrations, recurrent: bool
) -> None:
    env = world(demos=few)
    network = network_of(env, recurrent=recurrent)
    data = env.offline_data().train
    rows = demonstrated_rows(network, data, outcomes_of(env), VALUES)
    (batch,) = data.batches(64)
    whole = network(batch.observations, batch.previous_actions).q_values
    entering = batch.mask[0] > 0
    before, after = rows.q_values(network)
    torch.testing.assert_close(before, whole[:, :-1][:, entering])
    torch.testing.assert_close(after, whole[:, 1:][:, entering])
    assert len(rows) == (few.lengths - 1).sum()
    ends = rows.absorbed[0][~rows.absorbed[0].isnan()]
    assert sorted(ends.tolist()) == [0.0] * 3 + [5.0] * 3  # those cut by the clock go on


def test_rows_of_own_episodes_follow_each_other_until_an_end(few: Demonstrations) -> None:
    env = world(demos=few)
    network = network_of(env)
    collector = Collector(network, env, VALUES, seed=0)
    rows = collector.collect(120)
    steps = {f.name: getattr(rows, f.name).unflatten(1, (120, 4)) for f in fields(Rows)}
    _, after = rows.q_values(network)
    before, _ = rows.q_values(network)
    fresh = steps["previous"][:, 1:] == 13
    following = steps["observations"][:, 1:]
    same = (steps["next_observations"][:, :-1] == following).all(-1)
    assert (same | fresh).all()
    before, after = (q.unflatten(1, (120, 4)) for q in (before, after))
    torch.testing.assert_close(after[:, :-1][~fresh], before[:, 1:][~fresh], atol=1e-5, rtol=1e-5)
    absorbed = steps["absorbed"][0, :-1]
    ended = ~absorbed.isnan()
    assert (fresh[0] | ~ended).all()
    absorbed = steps["absorbed"][0]
    expected = [5.0 if outcome > 0 else 0.0 for outcome in collector.outcomes if outcome]
    assert len(expected) >= 10
    assert absorbed[~absorbed.isnan()].tolist() == expected


def test_the_same_seed_learns_the_same(few: Demonstrations) -> None:
    learned = []
    for seed in (3, 3, 4):
        env = world(demos=few)
        network = network_of(env)
        reports = iq_learn(
            network, env, env.offline_data().train, outcomes_of(env),
            IQLearnSettings(collections=2, steps=20, updates=3, rows=16), seed=seed,
        )  # fmt: skip
        assert len(reports) == 2 and reports[-1].loss.shape == (3,)
        learned.append(torch.cat([p.detach().flatten() for p in network.parameters()]))
    assert torch.equal(learned[0], learned[1])
    assert not torch.equal(learned[0], learned[2])


def test_demonstrations_of_others_are_refused(few: Demonstrations) -> None:
    env = world(demos=few)
    network = StackedQNetwork(("x", "y", "z"), 18, 13)
    with pytest.raises(InputError, match="same individuals"):
        iq_learn(network, env, env.offline_data().train, outcomes_of(env), IQLearnSettings())


@pytest.mark.parametrize(
    ("settings", "says"),
    [({"gamma": 1.0}, "gamma"), ({"rows": 0}, "rows"), ({"learning_rate": 0.0}, "learning_rate")],
)
def test_settings_out_of_range_are_refused(settings: dict[str, Any], says: str) -> None:
    with pytest.raises(InputError, match=says):
        IQLearnSettings(**settings)
