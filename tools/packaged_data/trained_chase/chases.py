"""Chases of trained agents, from uniform starts, as demonstrations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import animarl_envs
from animarl_algos.evaluation.teams import load_weights, make_policy, trained_species
from animarl_algos.networks.policies import MlpPolicy
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.episode import SPLITS
from animarl_envs.errors import InputError
from animarl_envs.files import write_then_rename
from animarl_envs.scenario import make_scenario
from animarl_envs.species import AGENT
from animarl_envs.worlds.chase.world import ChaseWorld
from tools.packaged_data import demonstrations_of
from tools.packaged_data.trained_chase.training import weights_file

EPSILON = 0.1  # of the paper's tests of agents
SPLIT_SHARES = (0.8, 0.1, 0.1)


@dataclass(frozen=True, eq=False)
class Chases:
    """Episodes of one condition: paths ``(frames, K, 2)`` [arena unit], actions ``(frames, K)``
    with -1 at the last frame, and outcome codes ``(episodes,)``."""

    paths: list[NDArray[np.float64]]
    actions: list[NDArray[np.int8]]
    outcome: NDArray[np.int8]


def chase(policy: MlpPolicy, condition: int, episodes: int, seed: int) -> Chases:
    """Let ``policy`` move everybody from uniform starts at rest until each episode's own end."""
    if episodes < 1:
        raise InputError(f"episodes is {episodes}: it must be at least 1")
    species = trained_species(len(policy.individuals) - 1)
    scenario = make_scenario(species, demos=None, condition=condition)  # type: ignore[arg-type]
    world = ChaseWorld(scenario, episodes)
    streams = np.random.SeedSequence([seed, condition])
    world.seed(streams.generate_state(episodes, np.uint64))
    policy.seed(int(streams.spawn(1)[0].generate_state(1)[0]))
    world.reset()
    slots, num = episodes * world.num_individuals, world.num_individuals
    state = policy.initial_state(slots)
    positions, actions = [world.position.copy()], []
    frames = np.zeros(episodes, dtype=np.int64)
    outcome = np.zeros(episodes, dtype=np.int8)
    while not frames.all():
        chosen, state = policy.predict(world.observation.reshape(slots, -1), state)  # type: ignore[assignment]
        world.step(chosen.reshape(episodes, num))
        positions.append(world.position.copy())
        actions.append(chosen.reshape(episodes, num).astype(np.int8))
        over = (frames == 0) & (world.terminated | world.truncated)
        frames[over], outcome[over] = len(positions), world.outcome[over]
    everywhere = np.stack(positions)
    acted = np.stack([*actions, np.full((episodes, num), -1, dtype=np.int8)])
    paths, steps = [], []
    for e, length in enumerate(frames.tolist()):
        paths.append(everywhere[:length, e].copy())
        steps.append(acted[:length, e].copy())
        steps[-1][-1] = -1
    return Chases(paths, steps, outcome)


def generate(folder: Path, seed: int, episodes: int, epsilon: float = EPSILON) -> Demonstrations:
    """So many chases per reward condition, from the weights in ``folder``, as demonstrations.

    Within each condition, episodes are split 80 / 10 / 10 in their (random) order.
    """
    parts, training = [], {}
    for c, name in enumerate(AGENT.conditions):
        weights, training[name] = load_weights(weights_file(folder, c))
        policy = make_policy(weights, epsilon=epsilon, seed=seed)
        parts.append(chase(policy, c, episodes, seed))
    condition = np.repeat(np.arange(len(parts), dtype=np.int8), episodes)
    return demonstrations_of(
        AGENT,
        paths=[path for part in parts for path in part.paths],
        signals={"actions": [acted for part in parts for acted in part.actions]},
        condition=condition,
        outcome=np.concatenate([part.outcome for part in parts]),
        split=np.tile(_splits(episodes), len(parts)),
        recording=np.array(
            [f"{AGENT.conditions[c]} {e:04d}" for c in range(len(parts)) for e in range(episodes)]
        ),
        provenance={
            "source": "trajectories of trained artificial agents (two predators and a prey, "
            "independent DQN of this project), made by python -m tools.packaged_data.trained_chase",
            "command": f"python -m tools.packaged_data.trained_chase make --seed {seed} "
            f"--episodes {episodes} --epsilon {epsilon}",
            "licence": "MIT",
            "synthetic": True,
            "kind": "artificial agents",
            "seed": seed,
            "epsilon": epsilon,
            "episodes_per_condition": episodes,
            "trained": training,
            "version": animarl_envs.__version__,
        },
        name="trained chases",
    )


def write_csv(chases: Chases, individuals: Sequence[str], file: Path) -> None:
    """Write a table as a stranger's tracker would: recording, frame, individual, x, y."""
    with write_then_rename(file) as part, part.open("w") as table:
        table.write("recording,frame,individual,x,y\n")
        for number, path in enumerate(chases.paths):
            for frame, places in enumerate(path.tolist()):
                for name, (x, y) in zip(individuals, places, strict=True):
                    table.write(f"chase {number:04d},{frame},{name},{x:.6f},{y:.6f}\n")


def _splits(episodes: int) -> NDArray[np.str_]:
    """Episodes are independent and in random order already, so the first 80 % are for training."""
    edges = np.round(np.cumsum(SPLIT_SHARES) * episodes).astype(int)
    return np.repeat(SPLITS, np.diff(edges, prepend=0))
