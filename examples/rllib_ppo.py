"""RLlib: PPO of Ray with its own runners around AnimaRL's Gymnasium environment.

    python examples/rllib_ppo.py --steps 20000

RLlib asks for versions of its own (Gymnasium's among them), so it is installed apart:
``pip install animarl 'ray[rllib]' torch``.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from typing import Any

import gymnasium as gym
import ray
from ray.rllib.algorithms.ppo import PPOConfig
from ray.tune.registry import register_env

NAME = "animarl-agent"


def make(options: dict[str, Any]) -> gym.Env[Any, Any]:
    """One predator among replayed animals; registered where RLlib makes it, in any process."""
    import animarl_envs  # noqa: F401  (registers the AnimaRL ids)

    return gym.make("AnimaRL/Agent-v0", **options)


def main(arguments: Sequence[str] | None = None) -> float:
    """Train, and return the mean return of the episodes of the last iteration (0 if none ended)."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=20_000)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args(arguments)
    register_env(NAME, make)
    ray.init(num_cpus=1, include_dashboard=False, log_to_driver=False)
    batch = min(options.steps, 2_000)
    config = (
        PPOConfig()
        .environment(NAME)
        .env_runners(num_env_runners=0, num_envs_per_env_runner=2)
        .training(train_batch_size_per_learner=batch, minibatch_size=min(batch, 200), num_epochs=4)
        .debugging(seed=options.seed, log_level="ERROR")
    )
    algorithm = config.build_algo()
    steps, mean = 0, math.nan
    try:
        while steps < options.steps:
            found = algorithm.train()["env_runners"]
            steps += batch
            mean = float(found.get("episode_return_mean", math.nan))
    finally:
        algorithm.stop()
        ray.shutdown()
    mean = 0.0 if math.isnan(mean) else mean
    print(f"{options.steps} steps, mean return of the last episodes {mean:.2f}")
    return mean


if __name__ == "__main__":
    main()
