"""Small learners of the pair of :mod:`toys`, with its demonstrations, for tests of learning."""

import os
import signal
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
import toys

from animarl_algos.data.dataset import OfflineDataset
from animarl_algos.learner.algorithm import SequenceQLearning
from animarl_algos.learner.callbacks import CheckpointCallback
from animarl_algos.learner.updates import minibatch_values
from animarl_algos.losses.terms import MinibatchValues
from animarl_algos.recipes.registry import named_recipe
from animarl_algos.replay.store import SequenceBatch

SETTINGS: dict[str, Any] = {
    "learning_rate": 1e-3, "buffer_size": 2000, "batch_size": 4,
    "target_update_interval": (5, "episode"), "exploration_steps": 200,
    "exploration_initial_eps": 0.5, "exploration_final_eps": 0.3, "offline_batch_size": 8,
    "offline_gamma": 0.99, "offline_alpha": 10.0, "offline_scaled_penalties": False,
    "offline_loss": "recipe", "exploration": "epsilon", "offline_kwargs": None,
    "offline_patience": None,
    "policy_kwargs": {"hidden": 8, "depth": 2, "head_layers": 1, "dropout": 0.0}, "seed": 3,
    "device": "cpu",
}  # fmt: skip
EPISODES = 48


class FlaggedPair(toys.Pair):
    """The pair, with the number of its copy modulo two as experimental condition."""

    num_observations = 5
    condition_flag = True

    def observe(self) -> Any:
        flag = np.broadcast_to(
            (np.arange(self.num_copies) % 2)[:, None, None], (self.num_copies, 2, 1)
        )
        return np.concatenate([super().observe(), flag], axis=-1)


@dataclass(frozen=True)
class Split:
    """Demonstrations as the learners take them: to learn from, and to choose the epoch by."""

    train: OfflineDataset
    val: OfflineDataset


def demonstrations(
    flag: bool = False, individuals: tuple[str, ...] = toys.Pair.individuals
) -> Split:
    """Random episodes in which the demonstrated action can be told from the observation."""
    data = []
    for seed in (0, 1):
        rng = np.random.default_rng(seed)
        lengths = rng.integers(4, 9, size=EPISODES)
        frames, k = int(lengths.sum()), len(toys.Pair.individuals)
        observations = rng.normal(size=(frames, k, 4 + flag))
        actions = observations[..., :3].argmax(-1)
        actions[np.cumsum(lengths) - 1] = -1
        condition = np.arange(EPISODES) % 2
        if flag:
            observations[..., -1] = np.repeat(condition, lengths)[:, None]
        own = [toys.Pair.individuals.index(name) for name in individuals]
        data.append(
            OfflineDataset(
                observations[:, own], actions[:, own], lengths, 3,
                rewards=0.1 * rng.normal(size=(frames, k))[:, own],
                action_penalties=(np.arange(3) != actions[..., None]).astype(float)[:, own],
                terminated=np.ones(EPISODES, dtype=bool), condition=condition, names=individuals,
            )
        )  # fmt: skip
    return Split(*data)


def make_pair_learner(name: str, policy: str = "GruPolicy", **more: Any) -> SequenceQLearning:
    """Recipe ``name`` on the pair, with demonstrations where it needs them."""
    named = named_recipe(name)
    flag = named.algorithm.recipe.needs_condition
    settings = SETTINGS | more
    if named.pretrained:
        settings = {"demonstrations": demonstrations(flag), "offline_epochs": 2} | settings
    return named.algorithm(policy, FlaggedPair(2) if flag else toys.Pair(2), **settings)


class Interrupt(CheckpointCallback):
    """Sends this process a signal at a world step: that of Ctrl-C, or another."""

    def __init__(self, folder: Path, step: int, number: int = signal.SIGINT) -> None:
        super().__init__(folder, every=10_000)
        self.step, self.number = step, number

    def _on_step(self) -> bool:
        if self.model.num_timesteps == self.step:
            os.kill(os.getpid(), self.number)
        return True


def weights(model: SequenceQLearning) -> torch.Tensor:
    """All weights of the online and the target network, in one row."""
    nets = (model.policy.q_net, model.policy.q_net_target)
    return torch.cat([p.detach().flatten() for net in nets for p in net.parameters()])


def evaluated(
    model: SequenceQLearning, batch: SequenceBatch, *, needs_target: bool = True
) -> MinibatchValues:
    """What the online loss terms of ``model`` see of a minibatch."""
    phase = model.settings.phase("online")
    return minibatch_values(model.policy, batch, phase, needs_target=needs_target)
