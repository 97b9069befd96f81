"""TorchRL: its Gymnasium wrapper, its checks, and double DQN on it.

python examples/torchrl_env.py --steps 20000
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence

import torch
from tensordict.nn import TensorDictSequential
from torchrl.collectors import Collector
from torchrl.data import LazyTensorStorage, ReplayBuffer
from torchrl.envs import GymEnv, RewardSum, StepCounter, TransformedEnv, check_env_specs
from torchrl.modules import MLP, EGreedyModule, QValueActor
from torchrl.objectives import DQNLoss, SoftUpdate

import animarl_envs  # noqa: F401  (registers the AnimaRL ids)

BATCH = 100  # steps per round


def main(arguments: Sequence[str] | None = None) -> float:
    """Train, and return the last loss."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=20_000)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args(arguments)
    torch.manual_seed(options.seed)

    env = TransformedEnv(GymEnv("AnimaRL/AgentTask-v0", categorical_action_encoding=True))
    env.append_transform(StepCounter())
    env.append_transform(RewardSum())
    env.set_seed(options.seed)
    check_env_specs(env)

    n = env.observation_spec["observation"].shape[-1]
    network = MLP(in_features=n, out_features=env.action_spec.space.n, num_cells=[64, 64])
    actor = QValueActor(network, in_keys=["observation"], spec=env.action_spec)
    explore = EGreedyModule(env.action_spec, annealing_num_steps=max(1, options.steps // 2))
    collector = Collector(
        env,
        TensorDictSequential(actor, explore),
        frames_per_batch=BATCH,
        total_frames=options.steps,
    )
    memory = ReplayBuffer(storage=LazyTensorStorage(options.steps), batch_size=64)
    loss_module = DQNLoss(actor, double_dqn=True, action_space=env.action_spec)
    loss_module.make_value_estimator(gamma=0.99)
    target = SoftUpdate(loss_module, eps=0.99)
    optimiser = torch.optim.Adam(loss_module.parameters(), lr=5e-4)

    loss, returns = torch.zeros(()), []
    for batch in collector:
        memory.extend(batch)
        ended = batch["next", "done"].squeeze(-1)
        returns += batch["next", "episode_reward"][ended].flatten().tolist()
        for _ in range(4):
            loss = loss_module(memory.sample())["loss"]
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
            target.step()
        explore.step(batch.numel())
    collector.shutdown()
    mean = sum(returns[-20:]) / max(1, len(returns[-20:]))
    print(f"{options.steps} steps, {len(returns)} episodes, return of the last {mean:.2f}")
    return float(loss.detach())


if __name__ == "__main__":
    main()
