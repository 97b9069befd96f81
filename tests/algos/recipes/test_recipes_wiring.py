"""What joins the parts of a learner: each schedule, state and weight reaches where it belongs."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
import pytest
import torch
from pair_learners import demonstrations, evaluated, make_pair_learner
from scripted_pair import ScriptedPair
from stable_baselines3.common.callbacks import BaseCallback

from animarl_algos.learner.algorithm import SequenceQLearning
from animarl_algos.losses.terms import ActionSupervision
from animarl_algos.recipes.registry import DQAAS, DQDIL, DQN
from animarl_algos.replay.store import SequenceBatch
from animarl_envs.wrappers import DTWReward

NEVER = 10**9
SETTINGS: dict[str, Any] = {
    "buffer_size": 1000,
    "batch_size": 3,
    "offline_epochs": 0,
    "policy_kwargs": {"hidden": 6},
    "seed": 2,
    "device": "cpu",
}


def learner(
    recipe: type[SequenceQLearning] = DQDIL, **more: Any
) -> tuple[SequenceQLearning, ScriptedPair]:
    env = ScriptedPair(2)
    return recipe("GruPolicy", env, **SETTINGS | more), env


def stored(model: SequenceQLearning, columns: int = 200) -> SequenceBatch:
    """Enough draws to have met every sequence of the memory."""
    assert model.replay_buffer is not None
    return model.replay_buffer.sample(columns).clone()


def priorities(model: SequenceQLearning) -> Any:
    assert model.replay_buffer is not None
    return model.replay_buffer.trees.priorities[:, : model.replay_buffer.num_sequences].copy()


def scatter_weights(network: torch.nn.Module) -> None:
    """Other weights than those it began with."""
    generator = torch.Generator().manual_seed(0)
    with torch.no_grad():
        for parameter in network.parameters():
            parameter.add_(0.3 * torch.randn(parameter.shape, generator=generator))


class AtEveryRollout(BaseCallback):
    """Calls a function of the model between updates."""

    def __init__(self, look: Any) -> None:
        super().__init__()
        self.look = look

    def _on_rollout_start(self) -> None:
        self.look(self.model)

    def _on_step(self) -> bool:
        return True


# -- schedules ------------------------------------------------------------------------------------


def test_beta_anneals_with_progress(monkeypatch: pytest.MonkeyPatch) -> None:
    model, _ = learner()
    buffer, seen = model.replay_buffer, []
    assert buffer is not None
    sample = buffer.sample

    def watched(batch_size: int, progress: float = 0.0) -> SequenceBatch:
        seen.append((buffer.beta(progress), model.num_timesteps / 200))
        return sample(batch_size, progress)

    monkeypatch.setattr(buffer, "sample", watched)
    model.learn(200)
    beta, progress = np.array(seen).T
    np.testing.assert_allclose(beta, 0.4 + 0.6 * progress)
    assert beta[0] < 0.5 and beta[-1] > 0.9


def test_the_learning_rate_follows_its_schedule() -> None:
    rates = []

    def look(model: SequenceQLearning) -> None:
        if model._n_updates:
            remaining = 1.0 - model.num_timesteps / 200
            rates.append((model.policy.optimizer.param_groups[0]["lr"], 0.01 * remaining))

    model, _ = learner(learning_rate=lambda remaining: 0.01 * remaining)
    model.learn(200, callback=AtEveryRollout(look))
    used, expected = np.array(rates).T
    np.testing.assert_allclose(used, expected)
    assert len(rates) > 10 and used[-1] < used[0] / 4


def test_the_target_moves_by_tau() -> None:
    model, _ = learner(target_update_interval=(2, "step"), tau=0.25, learning_starts=NEVER)
    scatter_weights(model.policy.q_net)
    policy = model.policy
    pairs = zip(policy.q_net_target.parameters(), policy.q_net.parameters())
    expected = [0.75 * old + 0.25 * new.detach() for old, new in pairs]
    model.learn(2)
    for parameter, value in zip(policy.q_net_target.parameters(), expected):
        torch.testing.assert_close(parameter, value)


def test_steps_before_learning_starts_are_acted_at_random() -> None:
    model, env = learner(
        learning_starts=200,
        updates_per_episode=0.0,
        exploration_initial_eps=0.0,
        exploration_final_eps=0.0,
    )
    model.learn(400)
    greedy = []
    state, begins = model.policy.initial_state(4), np.ones(4, dtype=bool)
    for step in env.steps:
        acted = step.actions.ravel()
        chosen, (hidden, _) = model.policy.predict(
            step.observations.reshape(4, -1), state, begins, deterministic=True
        )
        greedy.append(chosen == acted)
        state, begins = (hidden, acted), np.repeat(step.done, 2)
    assert np.mean(greedy[:100]) == pytest.approx(1 / 3, abs=0.1)  # four standard errors
    assert np.all(greedy[100:])


# -- replay ---------------------------------------------------------------------------------------


def test_training_sets_the_priorities_of_what_it_drew() -> None:
    model, _ = learner(learning_starts=NEVER)
    model.learn(200)
    before = priorities(model)
    assert (before == 1.0).all()
    model.train(1, 3)
    assert ((priorities(model) != before).sum(axis=1) > 0).all()


def test_warm_up_steps_enter_no_loss() -> None:
    model, env = learner(learning_starts=NEVER)
    model.learn(200)
    batch = stored(model)
    step = torch.arange(batch.num_steps).view(1, -1, 1)
    expected = (step >= env.WARMUP) & (step < batch.lengths.unsqueeze(1))
    assert torch.equal(batch.mask > 0, expected)


def test_the_state_stored_is_the_one_before_the_step() -> None:
    """Every step is a piece by itself; warm-up steps are none."""
    env = ScriptedPair(1)
    model = DQN(
        "GruPolicy",
        env,
        **SETTINGS,
        learning_starts=NEVER,
        sequence_length=1,
        state_mode="stored",
    )
    model.learn(100)
    net, expected = model.policy.q_net, []
    fresh = net.initial_state(1), torch.full((2, 1), net.num_actions)
    state, previous = fresh
    for step in env.steps:
        if not step.warmup[0]:
            expected.append(state[:, 0])
        observation = torch.from_numpy(step.observations).transpose(0, 1)
        _, state = net.step(observation, previous, state)
        previous = torch.from_numpy(step.actions).T
        if step.done[0]:
            state, previous = fresh
    batch = stored(model)
    assert batch.initial_state is not None
    for k in range(2):
        own = torch.stack([expected[i][k] for i in batch.indices[k]])
        torch.testing.assert_close(batch.initial_state[k], own, atol=1e-5, rtol=0.0)
        assert own.abs().max() > 0.01


def test_an_ended_episode_is_forgotten_in_its_own_slots() -> None:
    model, _ = learner(learning_starts=NEVER)
    ended = going = 0
    model.learn(2)
    for _ in range(40):
        begins = model._last_episode_starts
        hidden, previous = model.memory
        assert (hidden[begins] == 0.0).all() and (previous[begins] == 3).all()
        assert hidden[~begins].any(axis=1).all() and (previous[~begins] < 3).all()
        ended, going = ended + begins.sum(), going + (~begins).sum()
        model.learn(2, reset_num_timesteps=False)
    assert ended > 5 and going > 5


def test_the_task_reward_is_stored_where_the_reward_is_shaped_already() -> None:
    env = DTWReward(gym.make("AnimaRL/Agent-v0"), alpha=3.0)
    model = DQDIL("MlpPolicy", env, **SETTINGS, learning_starts=NEVER)
    shaped: list[list[float]] = [[]]
    task: list[list[float]] = [[]]

    class Watch(BaseCallback):
        def _on_step(self) -> bool:
            shaped[-1].append(self.locals["rewards"][0])
            task[-1].append(self.locals["infos"][0]["task_reward"])
            if self.locals["dones"][0]:
                shaped.append([])
                task.append([])
            return True

    model.learn(400, callback=Watch())
    batch = stored(model, 20)
    for column, episode in enumerate(batch.indices[0]):
        found = batch.rewards[0, : len(task[episode]), column].numpy()
        np.testing.assert_array_equal(found, np.float32(task[episode]))
        assert not np.allclose(found, shaped[episode])


# -- update ---------------------------------------------------------------------------------------


def test_the_target_burns_in_its_own_state() -> None:
    """As if it had run over the whole of each sequence that begins with its episode."""
    model, _ = learner(learning_starts=NEVER, sequence_length=6, burn_in=3)
    model.learn(200)
    scatter_weights(model.policy.q_net)
    batch = stored(model)
    evaluation = evaluated(model, batch)
    assert evaluation.target is not None and batch.burn_in == 3
    for found, net in (
        (evaluation.online, model.policy.q_net),
        (evaluation.target, model.policy.q_net_target),
    ):
        with torch.no_grad():
            whole = net(batch.observations, batch.previous_actions).q_values[:, 3:]
        row = torch.arange(whole.shape[1]).view(1, -1, 1)
        seen = (batch.starts == 0).unsqueeze(1) & (row + 3 <= batch.lengths.unsqueeze(1))
        assert seen.sum() > 100
        torch.testing.assert_close(found.q_values[seen], whole[seen])


def test_importance_weights_enter_the_supervision() -> None:
    """A weight on one sequence alone leaves its share of the loss."""
    model, _ = learner(DQAAS, learning_starts=NEVER)
    model.learn(200)
    batch = stored(model, 4)
    shares = []
    for column in range(4):
        batch.weights.zero_()
        batch.weights[:, column] = 1.0
        shares.append(ActionSupervision()(evaluated(model, batch)).detach())
    batch.weights.fill_(1.0)
    whole = ActionSupervision()(evaluated(model, batch)).detach()
    torch.testing.assert_close(torch.stack(shares).sum(0), whole)


# -- the offline phase ----------------------------------------------------------------------------


def test_the_target_is_renewed_after_every_offline_epoch() -> None:
    model = make_pair_learner(
        "dqdil-pt", demonstrations=demonstrations(), offline_epochs=3, offline_learning_rate=1e-2
    )
    seen = []

    class Look:
        def at_boundary(self) -> None:
            nets = (model.policy.q_net, model.policy.q_net_target)
            seen.append([torch.cat([p.detach().flatten() for p in n.parameters()]) for n in nets])

        def release(self) -> None:
            pass

    model.boundary_hooks = [Look()]
    model.pretrain()
    assert len(seen) == 3
    for online, target in seen:
        assert torch.equal(online, target)
    assert not torch.equal(seen[0][0], seen[1][0])
