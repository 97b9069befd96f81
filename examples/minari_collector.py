"""Minari's collector records steps of an AnimaRL environment as a dataset, which is read again.

python examples/minari_collector.py --steps 2000
"""

from __future__ import annotations

import argparse
import os
import tempfile
from collections.abc import Sequence

import gymnasium as gym
import minari
import numpy as np

import animarl_envs  # noqa: F401  (registers the AnimaRL ids)

DATASET = "animarl/agent/random-v0"


def main(arguments: Sequence[str] | None = None) -> float:
    """Collect random steps in a folder that is deleted; the mean return of the episodes."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=2_000)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args(arguments)
    before = os.environ.get("MINARI_DATASETS_PATH")
    with tempfile.TemporaryDirectory() as folder:
        os.environ["MINARI_DATASETS_PATH"] = folder
        try:
            return collect(options.steps, options.seed)
        finally:
            if before is None:
                del os.environ["MINARI_DATASETS_PATH"]
            else:
                os.environ["MINARI_DATASETS_PATH"] = before


def collect(steps: int, seed: int) -> float:
    """Into a dataset and out of it."""
    collector = minari.DataCollector(gym.make("AnimaRL/Agent-v0"), record_infos=False)
    collector.action_space.seed(seed)
    collector.reset(seed=seed)
    for _ in range(steps):
        _, _, terminated, truncated, _ = collector.step(collector.action_space.sample())
        if terminated or truncated:
            collector.reset()
    collector.create_dataset(DATASET, algorithm_name="random", author="AnimaRL")
    collector.close()

    dataset = minari.load_dataset(DATASET)
    returns = [float(np.sum(episode.rewards)) for episode in dataset.iterate_episodes()]
    assert dataset.total_steps == steps
    assert dataset.recover_environment().observation_space == dataset.observation_space
    print(
        f"{steps} steps, {dataset.total_episodes} episodes read again, "
        f"mean return {np.mean(returns):.2f}"
    )
    return float(np.mean(returns))


if __name__ == "__main__":
    main()
