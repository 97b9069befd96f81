"""All animals share one SB3 DQN: PettingZoo ParallelEnv -> SuperSuit -> stable-baselines3.

    python examples/pettingzoo_supersuit_sb3.py --steps 20000

SuperSuit's SB3 wrapper has no ``seed()``, so the copies beneath it are seeded by a reset, the
first random actions by the action space, and the network by ``set_random_seed``. Time-outs arrive
in the replay buffer as time-outs, so that they are bootstrapped; the script counts them.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence

import supersuit
from stable_baselines3 import DQN
from stable_baselines3.common.utils import set_random_seed

from animarl_envs import parallel_env


def main(arguments: Sequence[str] | None = None) -> tuple[int, int]:
    """Train; return how many stored transitions end by time-out and how many end in all."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=20_000, help="over all animals and copies")
    parser.add_argument("--copies", type=int, default=2)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args(arguments)

    env = parallel_env("AgentTask", time_limit=50)
    venv = supersuit.pettingzoo_env_to_vec_env_v1(env)
    venv = supersuit.concat_vec_envs_v1(venv, options.copies, base_class="stable_baselines3")
    venv.venv.reset(seed=options.seed)
    venv.action_space.seed(options.seed)
    set_random_seed(options.seed)
    model = DQN(
        "MlpPolicy", venv, buffer_size=options.steps, learning_starts=min(1000, options.steps // 4)
    )
    model.learn(options.steps)
    memory = model.replay_buffer
    ends, time_outs = int(memory.dones.sum()), int(memory.timeouts.sum())
    print(f"{options.steps} steps, {ends} transitions end an episode, {time_outs} by time-out")
    venv.close()
    return time_outs, ends


if __name__ == "__main__":
    main()
