"""sb3-contrib QRDQN drives a male newt, with a time limit of 20 s instead of 50 s.

python examples/sb3_contrib_qrdqn.py --steps 20000
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence

import gymnasium as gym
from sb3_contrib import QRDQN
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.monitor import Monitor

import animarl_envs  # noqa: F401  (registers the AnimaRL ids)


def main(arguments: Sequence[str] | None = None) -> float:
    """Train, evaluate on 5 episodes, and return their mean return."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=20_000)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args(arguments)

    env = Monitor(gym.make("AnimaRL/NewtTask-v0", time_limit=200))
    model = QRDQN(
        "MlpPolicy",
        env,
        learning_starts=min(1000, options.steps // 4),
        policy_kwargs={"n_quantiles": 25},
        seed=options.seed,
    )
    model.learn(options.steps)
    mean, deviation = evaluate_policy(model, env, n_eval_episodes=5)
    print(f"{options.steps} steps, return of 5 episodes {mean:.2f} +- {deviation:.2f}")
    env.close()
    return float(mean)


if __name__ == "__main__":
    main()
