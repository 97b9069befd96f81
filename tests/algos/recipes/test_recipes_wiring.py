"""What joins the parts of a learner: each schedule, state and weight reaches where it belongs."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
import pytest
import torch
from pair_learners import demonstrations, make_pair_learner
from scripted_pair import ScriptedPair
from stable_baselines3.common.callbacks import BaseCallback

from animarl_algos.learner.algorithm import SequenceQLearning
from animarl_algos.recipes.registry import DQDIL
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
    return model.replay_buffer.sample(columns)


# -- schedules ------------------------------------------------------------------------------------


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
