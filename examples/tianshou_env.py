"""Tianshou 2: its vector environment and collector around AnimaRL, and double DQN on them.

python examples/tianshou_env.py --steps 20000
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence

import gymnasium as gym
import torch
from tianshou.algorithm import DQN
from tianshou.algorithm.modelfree.dqn import DiscreteQLearningPolicy
from tianshou.algorithm.optim import AdamOptimizerFactory
from tianshou.data import Collector, VectorReplayBuffer
from tianshou.env import DummyVectorEnv
from tianshou.trainer import OffPolicyTrainerParams
from tianshou.utils.net.common import Net

import animarl_envs  # noqa: F401  (registers the AnimaRL ids)

COPIES = 4


def main(arguments: Sequence[str] | None = None) -> float:
    """Train, and return the mean return of 5 test episodes."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=20_000)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args(arguments)
    torch.manual_seed(options.seed)

    def make() -> gym.Env:
        return gym.make("AnimaRL/AgentTask-v0")

    training, testing = DummyVectorEnv([make] * COPIES), DummyVectorEnv([make] * 2)
    training.seed(options.seed)
    testing.seed(options.seed + COPIES)
    sample = make()
    network = Net(
        state_shape=sample.observation_space.shape,
        action_shape=sample.action_space.n,
        hidden_sizes=[64, 64],
    )
    policy = DiscreteQLearningPolicy(
        model=network, action_space=sample.action_space, eps_training=0.3, eps_inference=0.05
    )
    algorithm = DQN(
        policy=policy, optim=AdamOptimizerFactory(lr=5e-4), gamma=0.99, target_update_freq=200
    )
    buffer = VectorReplayBuffer(options.steps, COPIES)
    result = algorithm.run_training(
        OffPolicyTrainerParams(
            training_collector=Collector(algorithm, training, buffer, exploration_noise=True),
            test_collector=Collector(algorithm, testing),
            max_epochs=1,
            epoch_num_steps=options.steps,
            collection_step_num_env_steps=10 * COPIES,
            update_step_num_gradient_steps_per_sample=0.1,
            batch_size=64,
            test_step_num_episodes=5,
            show_progress=False,
            verbose=False,
        )
    )
    print(f"{options.steps} steps, return of 5 episodes {result.best_reward:.2f}")
    return float(result.best_reward)


if __name__ == "__main__":
    main()
