"""DQN in one file, in the manner of CleanRL, on the native vector environment.

    python examples/cleanrl_style_dqn.py --steps 50000

Two points are worth a look. The vector environment resets itself in the step *after* an episode's
end (Gymnasium's NEXT_STEP mode): that step's transition leads from one episode into the next and is
not stored. And a time limit truncates: only ``terminated`` stops the bootstrap.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence

import gymnasium as gym
import numpy as np
import torch
from torch import nn

import animarl_envs  # noqa: F401  (registers the AnimaRL ids)

COPIES = 8
GAMMA = 0.99
BATCH = 128
BUFFER = 100_000
TARGET_EVERY = 500  # updates


def q_network(observations: int, actions: int) -> nn.Module:
    return nn.Sequential(
        nn.Linear(observations, 64), nn.ReLU(), nn.Linear(64, 64), nn.ReLU(), nn.Linear(64, actions)
    )


def main(arguments: Sequence[str] | None = None) -> float:
    """Train, and return the mean return of the last 20 episodes (0 if none has ended)."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=50_000)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args(arguments)
    rng = np.random.default_rng(options.seed)
    torch.manual_seed(options.seed)

    envs = gym.make_vec("AnimaRL/AgentTask-v0", num_envs=COPIES)
    n = envs.single_observation_space.shape[0]
    num_actions = int(envs.single_action_space.n)
    online, target = q_network(n, num_actions), q_network(n, num_actions)
    target.load_state_dict(online.state_dict())
    optimiser = torch.optim.Adam(online.parameters(), lr=5e-4)

    size = min(BUFFER, options.steps)
    seen = np.zeros((size, n), dtype=np.float32)
    seen_next = np.zeros((size, n), dtype=np.float32)
    taken = np.zeros(size, dtype=np.int64)
    earned = np.zeros(size, dtype=np.float32)
    final = np.zeros(size, dtype=np.float32)
    stored = updates = 0

    observation, _ = envs.reset(seed=options.seed)
    resetting = np.zeros(COPIES, dtype=bool)
    returns, running = [], np.zeros(COPIES)
    for step in range(options.steps // COPIES):
        epsilon = max(0.05, 1.0 - 2.0 * step * COPIES / options.steps)
        with torch.no_grad():
            actions = online(torch.from_numpy(observation)).argmax(dim=1).numpy()
        explore = rng.random(COPIES) < epsilon
        actions[explore] = rng.integers(num_actions, size=int(explore.sum()))
        following, reward, terminated, truncated, _ = envs.step(actions)

        running += reward
        for b in np.flatnonzero(~resetting):
            row = stored % size
            seen[row], seen_next[row], taken[row] = observation[b], following[b], actions[b]
            earned[row], final[row] = reward[b], terminated[b]
            stored += 1
        resetting = terminated | truncated
        returns += running[resetting].tolist()
        running[resetting] = 0.0
        observation = following

        if stored >= BATCH:
            rows = rng.integers(min(stored, size), size=BATCH)
            with torch.no_grad():
                ahead = target(torch.from_numpy(seen_next[rows])).max(dim=1).values
                goal = torch.from_numpy(earned[rows]) + GAMMA * ahead * torch.from_numpy(
                    1.0 - final[rows]
                )
            q = online(torch.from_numpy(seen[rows]))
            q = q.gather(1, torch.from_numpy(taken[rows])[:, None]).squeeze(1)
            loss = nn.functional.smooth_l1_loss(q, goal)
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
            updates += 1
            if updates % TARGET_EVERY == 0:
                target.load_state_dict(online.state_dict())
    envs.close()
    mean = float(np.mean(returns[-20:])) if returns else 0.0
    print(f"{options.steps} steps, {updates} updates, return of the last episodes {mean:.2f}")
    return mean


if __name__ == "__main__":
    main()
