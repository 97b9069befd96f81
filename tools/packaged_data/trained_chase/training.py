"""Two predators and a prey, trained from scratch by this project's own independent DQN.

Each individual has its own feed-forward dueling network and learns from the task reward alone, in
the Agent world with its true d = 0.25 and u = 3.0, from uniform starts, without demonstrations.
Both reward conditions get the same settings, seed and number of steps. The last weights are kept:
no checkpoint is chosen by what the chases look like.
"""

from __future__ import annotations

import json
from contextlib import closing
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from stable_baselines3.common.logger import configure

from animarl_algos.data.vec_env import SlotVecEnv
from animarl_algos.evaluation.teams import META, load_weights, trained_species
from animarl_algos.learner.callbacks import CheckpointCallback
from animarl_algos.learner.checkpoint import latest_checkpoint, load_checkpoint
from animarl_algos.recipes.registry import DQN
from animarl_envs.demos.packaged import packaged_team
from animarl_envs.errors import InputError
from animarl_envs.files import write_then_rename
from animarl_envs.species import AGENT

PACKAGED_WEIGHTS = packaged_team(AGENT.conditions[0]).parent


@dataclass(frozen=True, kw_only=True)
class ChaseTraining:
    """How the agents are trained; steps are steps of the world."""

    steps: int = 600_000
    copies: int = 32
    learning_rate: float = 1e-3  # of Adam, falling linearly to zero
    gamma: float = 0.95  # per step of 0.1 s
    exploration_initial_eps: float = 0.5
    exploration_final_eps: float = 0.1
    exploration_steps: int = 100_000
    buffer_size: int = 400_000
    sequence_length: int = 8  # steps per replayed piece
    batch_size: int = 32  # pieces per individual and update
    steps_per_round: int = 4  # of every copy, before ...
    updates_per_round: int = 8
    target_update_interval: int = 5_000
    checkpoint_every: int = 100_000

    def __post_init__(self) -> None:
        if self.steps < 1:
            raise InputError(f"steps is {self.steps}: it must be at least 1")


def weights_file(folder: Path, condition: int) -> Path:
    """Where the weights of a condition lie in a folder."""
    return folder / f"{AGENT.conditions[condition]}.npz"


def make_learner(condition: int, seed: int, training: ChaseTraining, pursuers: int = 2) -> DQN:
    """An untrained learner in its environment; condition 1 shares the reward of a capture."""
    species = trained_species(pursuers)
    env = SlotVecEnv(species, training.copies, demos=None, condition=condition, dtw=None)
    return DQN(
        "MlpPolicy",
        env,
        learning_rate=lambda remaining: training.learning_rate * remaining,
        buffer_size=training.buffer_size,
        batch_size=training.batch_size,
        gamma=training.gamma,
        target_update_interval=training.target_update_interval,
        train_freq=(training.steps_per_round, "step"),
        gradient_steps=training.updates_per_round,
        exploration_initial_eps=training.exploration_initial_eps,
        exploration_final_eps=training.exploration_final_eps,
        exploration_steps=training.exploration_steps,
        sequence_length=training.sequence_length,
        prioritized=False,
        seed=seed,
        device="cpu",
    )


def train(
    condition: int,
    seed: int,
    training: ChaseTraining,
    folder: Path,
    *,
    pursuers: int = 2,
    progress_bar: bool = True,
) -> Path:
    """Train one condition and write its weights; go on from the last checkpoint, or do nothing.

    Parameters
    ----------
    condition
        0: a predator is rewarded for its own captures; 1: for both predators'.
    folder
        Gets ``<condition>.npz`` with the last weights, ``checkpoints/`` and ``logs/``.

    Raises
    ------
    InputError
        If ``folder`` holds weights of other settings or another seed.
    """
    file = weights_file(folder, condition)
    meta: dict[str, Any] = {"condition": condition, "seed": seed, "training": asdict(training)}
    if pursuers != 2:  # the packaged weights, of two, do not say it
        meta["pursuers"] = pursuers
    if file.exists():
        _refuse_other_settings(file, meta)
        return file
    torch.set_num_threads(1)
    model = make_learner(condition, seed, training, pursuers)
    name = AGENT.conditions[condition]
    checkpoints = folder / "checkpoints" / name
    resumed = latest_checkpoint(checkpoints) is not None
    if resumed:
        load_checkpoint(model, checkpoints)
    sessions = len(list((folder / "logs").glob(f"{name}-*")))
    with closing(configure(str(folder / "logs" / f"{name}-{sessions:03d}"), ["csv"])) as logger:
        model.set_logger(logger)
        model.learn(
            training.steps - model.num_timesteps if resumed else training.steps,
            callback=CheckpointCallback(checkpoints, training.checkpoint_every),
            reset_num_timesteps=not resumed,
            progress_bar=progress_bar,
        )
    arrays = {key: value.numpy() for key, value in model.policy.q_net.state_dict().items()}
    arrays[META] = np.array(json.dumps(meta))
    with write_then_rename(file) as part:
        np.savez_compressed(part, **arrays)  # type: ignore[arg-type]
    return file


def _refuse_other_settings(file: Path, meta: dict[str, Any]) -> None:
    _, stored = load_weights(file)
    if stored != json.loads(json.dumps(meta)):
        raise InputError(
            f"{file}: it was trained with other settings or another seed: "
            "choose another folder or remove it"
        )


def mixed_weights(
    sources: dict[str, dict[str, NDArray[np.float32]]],
) -> dict[str, NDArray[np.float32]]:
    """Networks of individuals that were not trained together: the source of each, by its name."""
    parts = [sources[name] for name in AGENT.individuals]
    return {key: np.stack([part[key][k] for k, part in enumerate(parts)]) for key in parts[0]}
