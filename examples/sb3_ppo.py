"""stable-baselines3 PPO drives the female fly on four copies, chased by scripted males.

python examples/sb3_ppo.py --steps 50000
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence

from stable_baselines3 import PPO
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.evaluation import evaluate_policy

import animarl_envs  # noqa: F401  (registers the AnimaRL ids)


def main(arguments: Sequence[str] | None = None) -> float:
    """Train, evaluate on 10 episodes, and return their mean return."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=50_000)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args(arguments)

    venv = make_vec_env(
        "AnimaRL/FlyTask-v0",
        n_envs=4,
        seed=options.seed,
        env_kwargs={"focal": "female", "others": "scripted"},
    )
    model = PPO("MlpPolicy", venv, n_steps=min(256, max(8, options.steps // 4)), seed=options.seed)
    model.learn(options.steps)
    mean, deviation = evaluate_policy(model, venv, n_eval_episodes=10)
    print(f"{options.steps} steps, return of 10 episodes {mean:.2f} +- {deviation:.2f}")
    venv.close()
    return float(mean)


if __name__ == "__main__":
    main()
