"""stable-baselines3 DQN drives one predator; the other animals replay their demonstration.

python examples/sb3_dqn.py --steps 20000
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence

import gymnasium as gym
from stable_baselines3 import DQN
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.monitor import Monitor

import animarl_envs  # noqa: F401  (registers the AnimaRL ids)


def main(arguments: Sequence[str] | None = None) -> float:
    """Train, evaluate on 10 episodes, and return their mean return."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=20_000)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args(arguments)

    env = Monitor(gym.make("AnimaRL/AgentTask-v0"))
    model = DQN(
        "MlpPolicy",
        env,
        learning_starts=min(1000, options.steps // 4),
        exploration_fraction=0.5,
        seed=options.seed,
    )
    model.learn(options.steps)
    mean, deviation = evaluate_policy(model, env, n_eval_episodes=10)
    print(f"{options.steps} steps, return of 10 episodes {mean:.2f} +- {deviation:.2f}")
    env.close()
    return float(mean)


if __name__ == "__main__":
    main()
