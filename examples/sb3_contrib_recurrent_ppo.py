"""sb3-contrib RecurrentPPO searches an odour source: a task that needs memory.

python examples/sb3_contrib_recurrent_ppo.py --steps 50000
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence

from sb3_contrib import RecurrentPPO
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.evaluation import evaluate_policy

import animarl_envs  # noqa: F401  (registers the AnimaRL ids)


def main(arguments: Sequence[str] | None = None) -> float:
    """Train, evaluate on 2 episodes, and return their mean return."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=50_000)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args(arguments)

    venv = make_vec_env(
        "AnimaRL/SilkmothTask-v0", n_envs=2, seed=options.seed, env_kwargs={"condition": 0}
    )
    model = RecurrentPPO(
        "MlpLstmPolicy",
        venv,
        n_steps=min(256, max(16, options.steps // 2)),
        policy_kwargs={"lstm_hidden_size": 32},
        seed=options.seed,
    )
    model.learn(options.steps)
    mean, deviation = evaluate_policy(model, venv, n_eval_episodes=2)
    print(f"{options.steps} steps, return of 2 episodes {mean:.2f} +- {deviation:.2f}")
    venv.close()
    return float(mean)


if __name__ == "__main__":
    main()
