"""Synthetic demonstrations of a chase by simple rules, for the agents.

Predators run at the prey and waver. Under individual reward all aim at where the prey is; under
shared reward the second aims at where it will be, so that the two come from different sides. The
prey follows the rule of :mod:`animarl_envs.worlds.rules` and wavers too. The dynamics is that of
the Agent species, known exactly. Nothing here was recorded from animals or learnt.

    python -m animarl_envs.demos.scripted_chase --out agent.npz --episodes 250 --seed 1
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import animarl_envs
from animarl_envs.demos.demonstrations import UNFINISHED, Demonstrations
from animarl_envs.demos.splits import assign_splits
from animarl_envs.locomotion import COAST, NUM_ACTIONS
from animarl_envs.scenario import make_scenario
from animarl_envs.species import AGENT
from animarl_envs.worlds.chase import ChaseWorld
from animarl_envs.worlds.rules import scripted_actions

WAVER = 0.25  # share of steps with an action beside the intended one
PAUSE = (0.05, 0.05, 0.2)  # share of steps of coasting: the prey tires and can be caught
LEAD = 0.4  # how far ahead the second predator looks under shared reward [s]


def generate(episodes: int, seed: int) -> Demonstrations:
    """So many episodes per reward condition, split 80 / 10 / 10 within each."""
    parts = [_chases(condition, episodes, seed) for condition in (0, 1)]
    paths = [path for part in parts for path in part[0]]
    acted = [actions for part in parts for actions in part[1]]
    condition = np.repeat([0, 1], episodes)
    split = np.concatenate(
        [assign_splits([f"{c}-{e:04d}" for e in range(episodes)], seed + c) for c in (0, 1)]
    )
    return Demonstrations(
        species=AGENT.name,
        individuals=AGENT.individuals,
        roles=("pursuer",) * AGENT.num_pursuers + ("target",),
        dt=AGENT.dt,
        arena=AGENT.arena,
        positions=np.concatenate(paths),
        lengths=np.array([len(path) for path in paths]),
        initial_velocity=np.zeros((len(paths), AGENT.num_individuals, 2)),
        condition=condition,
        outcome=np.concatenate([part[2] for part in parts]),
        split=split,
        recording=np.array([f"seed {seed}, condition {c}" for c in condition]),
        signals={"actions": np.concatenate(acted)},
        provenance={
            "source": "scripted chase, made by python -m animarl_envs.demos.scripted_chase",
            "licence": "MIT",
            "synthetic": True,
            "seed": seed,
            "episodes_per_condition": episodes,
            "version": animarl_envs.__version__,
        },
        name="scripted chase",
    )


def _chases(
    condition: int, episodes: int, seed: int
) -> tuple[list[NDArray[np.float64]], list[NDArray[np.int8]], NDArray[np.int8]]:
    """Paths ``(frames, K, 2)``, actions ``(frames, K)`` and outcomes of one condition."""
    scenario = make_scenario(AGENT, demos=None, condition=condition)  # type: ignore[arg-type]
    world = ChaseWorld(scenario, episodes)
    rng = np.random.default_rng([seed, condition])
    world.seed(rng.integers(2**63, size=episodes))
    world.reset()
    positions, actions = [world.position.copy()], []
    length = np.zeros(episodes, dtype=np.int64)
    outcome = np.full(episodes, UNFINISHED, dtype=np.int8)
    while not length.all():
        chosen = _decide(world, condition, rng)
        world.step(chosen)
        positions.append(world.position.copy())
        actions.append(chosen)
        over = (length == 0) & (world.terminated | world.truncated)
        length[over], outcome[over] = len(positions), world.outcome[over]
    steps = np.stack([*actions, np.full_like(actions[0], -1)]).astype(np.int8)
    frames = np.stack(positions)
    paths, acted = [], []
    for e, n in enumerate(length):
        paths.append(frames[:n, e])
        acted.append(np.concatenate([steps[: n - 1, e], np.full((1, steps.shape[2]), -1, np.int8)]))
    return paths, acted, outcome


def _decide(world: ChaseWorld, condition: int, rng: np.random.Generator) -> NDArray[np.int64]:
    """One action per copy and individual, ``(B, K)``."""
    actions = scripted_actions(world)
    if condition == 1:
        aim = world.position[:, -1] + LEAD * world.velocity[:, -1] - world.position[:, 1]
        ahead = np.sum(aim * world.towards[:, 1], axis=1)
        left = aim[:, 1] * world.towards[:, 1, 0] - aim[:, 0] * world.towards[:, 1, 1]
        actions[:, 1] = np.round(-np.arctan2(left, ahead) / np.deg2rad(30.0)).astype(int) % 12
    draw = rng.random(actions.shape)
    beside = (actions + rng.choice([-1, 1], size=actions.shape)) % (NUM_ACTIONS - 1)
    actions = np.where((draw < WAVER) & (actions != COAST), beside, actions)
    return np.where(draw > 1.0 - np.array(PAUSE), COAST, actions)


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n", maxsplit=1)[0])
    parser.add_argument("--out", type=Path, default=Path("agent.npz"), help="file to write")
    parser.add_argument("--episodes", type=int, default=250, help="episodes per condition")
    parser.add_argument("--seed", type=int, default=1, help="root of all randomness")
    given = parser.parse_args()
    demos = generate(given.episodes, given.seed)
    demos.save(given.out, dtype=np.float32)
    for condition in (0, 1):
        part = demos.select(condition=condition)
        rates = [float((part.outcome == k).mean()) for k in (1, 2)]
        print(
            f"{AGENT.conditions[condition]:>10} reward: {part.num_episodes} synthetic episodes, "
            f"captured by predator_0 {rates[0]:.3f}, by predator_1 {rates[1]:.3f}, "
            f"mean {(part.lengths - 1).mean() * part.dt:.1f} s"
        )
    print(f"wrote {given.out} ({given.out.stat().st_size / 1e3:.0f} kB)")


if __name__ == "__main__":
    main()
