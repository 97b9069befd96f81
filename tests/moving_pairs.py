"""A synthetic pair of animals of known statistics; simulators of it, a true one and bad ones."""

from typing import Any

import numpy as np
from recordings import episodes_along

from animarl_algos.evaluation.headline import list_implausible
from animarl_algos.evaluation.rollouts import Rollouts
from animarl_algos.evaluation.verdict import Verdict
from animarl_envs.arena import Arena
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.episode import PURSUER_OUT, TIME_OUT

STARTS = 30
ARENA = Arena("square", 1.0, 1.1)


def pair_path(rng: np.random.Generator, start: np.ndarray, kind: str) -> np.ndarray:
    """``(frames, 2, 2)``: velocities forget themselves within half a second, walls reflect."""
    frames = {"dead": 2, "uniform": 51}.get(kind, int(rng.integers(22, 80)))
    speed = {"still": 0.0, "slow": 0.25}.get(kind, 1.0)
    position, path = start.copy(), [start.copy()]
    velocity = rng.normal(0.0, 0.4, (2, 2))
    for _ in range(frames - 1):
        velocity = 0.8 * velocity + rng.normal(0.0, 0.24, (2, 2))
        position = position + 0.1 * speed * velocity
        if kind == "leaving":
            position[0] *= 1.03
        else:
            velocity = np.where(np.abs(position) > 1.0, -velocity, velocity)
            position = np.clip(position, -1.0, 1.0)
        path.append(position)
        if np.abs(position).max() > ARENA.boundary:
            break
    return np.stack(path)


def rollouts_along(
    paths: list[np.ndarray], demos: Demonstrations, demo: Any, **more: Any
) -> Rollouts:
    """Rollouts of the starts ``demo`` along given paths, told no condition."""
    count = len(paths)
    given: dict[str, Any] = {
        "method": "BC", "individuals": demos.individuals, "roles": demos.roles, "dt": demos.dt,
        "positions": np.concatenate(paths), "lengths": [len(path) for path in paths],
        "outcome": np.ones(count), "condition": demos.condition[demo], "demo": demo,
        "cue": np.full(count, -1), "seed": np.zeros(count), "repetition": np.zeros(count),
    }  # fmt: skip
    return Rollouts(**given | more)


def recorded_pairs(seed: int = 0) -> Demonstrations:
    rng = np.random.default_rng(seed)
    paths = [pair_path(rng, rng.uniform(-0.8, 0.8, (2, 2)), "true") for _ in range(STARTS)]
    ends = [1 if len(path) < 50 else TIME_OUT for path in paths]
    return episodes_along(
        paths, species="custom", individuals=("male", "female"), roles=("pursuer", "target"),
        arena=ARENA, outcome=ends,
    )  # fmt: skip


def simulated_pairs(demos: Demonstrations, kind: str, each: int = 2, seed: int = 1) -> Rollouts:
    rng = np.random.default_rng(seed)
    demo = np.repeat(np.arange(demos.num_episodes), each)
    paths = [pair_path(rng, demos.episode(i).positions[0], kind) for i in demo.tolist()]
    out = [np.abs(path[-1]).max() > ARENA.boundary for path in paths]
    ends = [PURSUER_OUT if o else 1 if len(p) < 50 else TIME_OUT for o, p in zip(out, paths)]
    repetition = np.tile(np.arange(each), demos.num_episodes)
    return rollouts_along(paths, demos, demo, method=kind, outcome=ends, repetition=repetition)


def implausible(found: Verdict) -> list[str]:
    return list_implausible(found.rows(), found.worse_than_untrained)
