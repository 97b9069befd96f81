"""RLlib PPO: a network for the predators and one for the prey, on PettingZoo's parallel view.

    python examples/rllib_ppo.py --steps 100000

RLlib's wrapper wants every individual from the start to the end of an episode, which is how a chase
is: all end together. A time limit is told as ``truncated``, so RLlib bootstraps from it.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence

import ray
from ray.rllib.algorithms.ppo import PPOConfig
from ray.rllib.env.wrappers.pettingzoo_env import ParallelPettingZooEnv
from ray.tune.registry import register_env

import animarl_envs

BATCH = 200  # steps of the environment between updates


def policy_of(individual: str, episode: object) -> str:
    """The name of the network that acts for an individual."""
    return individual.partition("_")[0]


def main(arguments: Sequence[str] | None = None) -> float:
    """Train, and return the mean length of the last episodes [steps]."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=100_000)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args(arguments)
    register_env("chase", lambda _: ParallelPettingZooEnv(animarl_envs.parallel_env("AgentTask")))
    config = (
        PPOConfig()
        .environment("chase")
        .env_runners(num_env_runners=0)
        .multi_agent(policies={"predator", "prey"}, policy_mapping_fn=policy_of)
        .training(train_batch_size=BATCH, minibatch_size=100, num_epochs=2)
        .debugging(seed=options.seed)
    )
    ray.init(include_dashboard=False, num_cpus=1, log_to_driver=False)
    algorithm = config.build_algo()
    steps, length = 0, float("nan")
    while steps < options.steps:
        found = algorithm.train()["env_runners"]
        steps += int(found["num_env_steps_sampled"])
        length = float(found.get("episode_len_mean", length))
    algorithm.stop()
    ray.shutdown()
    print(f"{steps} steps, mean length of the last episodes {length:.1f} steps")
    return length


if __name__ == "__main__":
    main()
