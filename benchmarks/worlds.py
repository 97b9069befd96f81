"""Speed of the worlds, their views and the DTW, beside peers, in one run and one thread.

    python benchmarks/worlds.py [--seconds 1.0]

A figure is the best of many short repeats, which is the least disturbed one on a shared machine.
Peers: MPE2's simple_tag (PettingZoo, same dictionaries), the same step in NumPy arrays, and
dtaidistance (C) for the DTW.
"""

from __future__ import annotations

import argparse
import time
import warnings
from collections.abc import Callable
from typing import Any

import gymnasium as gym
import numpy as np
from dtaidistance import dtw_ndim
from mpe2 import simple_tag_v3
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

import animarl_envs
from animarl_envs.dtw import dtw_distance
from animarl_envs.locomotion import ACTION_VECTORS
from animarl_envs.scenario import make_scenario
from animarl_envs.species import SPECIES
from animarl_envs.worlds import make_world


def rate(act: Callable[[], Any], units: int, seconds: float) -> float:
    """Units per second of ``act``, which does ``units`` of them: the best of many repeats."""
    act()
    best, until = float("inf"), time.perf_counter() + seconds
    while time.perf_counter() < until:
        start = time.perf_counter()
        act()
        best = min(best, time.perf_counter() - start)
    return units / best


class NumPyChase:
    """The chase step and its observations as NumPy array operations, for comparison."""

    def __init__(self, copies: int) -> None:
        rng = np.random.default_rng(0)
        self.position = rng.uniform(-0.5, 0.5, (copies, 3, 2))
        self.velocity = np.zeros((copies, 3, 2))

    def step(self, actions: NDArray[np.int64]) -> NDArray[np.float32]:
        position, velocity = self.position, self.velocity
        aim = position[:, [2, 2, 0]] - position
        nearer = np.linalg.norm(position[:, 1] - position[:, 2], axis=1) < np.linalg.norm(
            position[:, 0] - position[:, 2], axis=1
        )
        aim[nearer, 2] = (position[:, 1] - position[:, 2])[nearer]
        focus = aim / np.linalg.norm(aim, axis=2, keepdims=True)
        ego = ACTION_VECTORS[actions]
        side = np.stack([-focus[..., 1], focus[..., 0]], axis=2)
        velocity *= 0.75
        velocity += 0.3 * (ego[..., :1] * focus + ego[..., 1:] * side)
        position += 0.1 * velocity
        rows = [position, self._ego(velocity, focus, side), focus]
        for shift in (1, 2):
            apart = np.roll(position, shift, axis=1) - position
            drift = np.roll(velocity, shift, axis=1) - velocity
            turned = self._ego(apart, focus, side)
            rows += [turned, self._ego(drift, focus, side)]
            rows.append(np.linalg.norm(apart, axis=2, keepdims=True))
            rows.append(np.arctan2(turned[..., 1:], turned[..., :1]))
        return np.concatenate(rows, axis=2).astype(np.float32)

    @staticmethod
    def _ego(vector: Any, focus: Any, side: Any) -> Any:
        return np.stack([(vector * focus).sum(2), (vector * side).sum(2)], axis=2)


def world_rate(name: str, copies: int, seconds: float) -> float:
    """World steps per second with observations; ended episodes start anew between repeats."""
    world = make_world(make_scenario(name), copies)
    world.reset()
    actions = np.random.default_rng(0).integers(13, size=(copies, world.num_individuals))
    world.step(actions)
    best, until = float("inf"), time.perf_counter() + seconds
    while time.perf_counter() < until:
        start = time.perf_counter()
        world.step(actions)
        best = min(best, time.perf_counter() - start)
        world.reset(world.terminated | world.truncated)
    return copies / best


def vector_rate(name: str, copies: int, seconds: float) -> float:
    env = gym.make_vec(animarl_envs.environment_id(name), num_envs=copies)
    env.reset(seed=0)
    actions = np.random.default_rng(0).integers(13, size=copies)
    return rate(lambda: env.step(actions), copies, seconds)


def single_rate(name: str, seconds: float) -> float:
    env = gym.make(animarl_envs.environment_id(name))

    def hundred() -> None:
        env.reset(seed=0)
        for k in range(100):
            _, _, terminated, truncated, _ = env.step(k % 13)
            if terminated or truncated:
                env.reset()

    return rate(hundred, 100, seconds)


def parallel_rate(env: Any, seconds: float) -> float:
    def hundred() -> None:
        env.reset(seed=0)
        for k in range(100):
            if not env.agents:
                env.reset()
            env.step(dict.fromkeys(env.agents, k % 5))

    return rate(hundred, 100, seconds)


def textbook(x: NDArray[np.float64], y: NDArray[np.float64]) -> float:
    """DTW row by row in NumPy, the inner recursion in Python."""
    cost = np.linalg.norm(x[:, None] - y[None], axis=2)
    row = np.cumsum(cost[0])
    for t in range(1, len(x)):
        best = np.minimum(row, np.concatenate([[np.inf], row[:-1]]))
        left = np.inf
        for j in range(len(y)):
            left = cost[t, j] + min(best[j], left)
            row[j] = left
    return float(row[-1])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n", maxsplit=1)[0])
    parser.add_argument("--seconds", type=float, default=1.0, help="time for each figure")
    seconds = parser.parse_args().seconds
    warnings.simplefilter("ignore")

    table = Table(title="Environment steps per second, one thread, one run")
    table.add_column("what")
    for heading in ("steps / s", "against MPE2", "against NumPy, 1024"):
        table.add_column(heading, justify="right")
    mpe = parallel_rate(simple_tag_v3.parallel_env(num_good=1, num_adversaries=2), seconds)
    plain = NumPyChase(1024)
    actions = np.random.default_rng(0).integers(13, size=(1024, 3))
    numpy_rate = rate(lambda: plain.step(actions), 1024, seconds)

    def row(what: str, figure: float) -> None:
        table.add_row(
            what, f"{figure:,.0f}", f"{figure / mpe:,.0f} x", f"{figure / numpy_rate:.2f} x"
        )

    row("MPE2 simple_tag, dictionaries, 3 individuals", mpe)
    row("the chase step in NumPy, 1024 copies", numpy_rate)
    for name in SPECIES:
        for copies in (1, 64, 1024, 8192):
            row(f"{name} world, {copies} copies", world_rate(name, copies, seconds))
        row(f"{name} gym.make_vec, 1024 copies", vector_rate(name, 1024, seconds))
        row(f"{name} gym.make", single_rate(name, seconds))
        row(f"{name} PettingZoo, all", parallel_rate(animarl_envs.parallel_env(name), seconds))
    console = Console()
    console.width = max(console.width, 100)
    console.print(table)

    table = Table(title="DTW of two paths of 150 points")
    table.add_column("what")
    table.add_column("ms", justify="right")
    table.add_column("against dtaidistance", justify="right")
    rng = np.random.default_rng(0)
    x, y = rng.normal(size=(150, 2)), rng.normal(size=(150, 2))
    c = 1e3 / rate(lambda: dtw_ndim.distance_fast(x, y, inner_dist="euclidean"), 1, seconds)
    for what, ms in (
        ("dtaidistance, C", c),
        ("NumPy", 1e3 / rate(lambda: textbook(x, y), 1, seconds)),
        ("here, numba", 1e3 / rate(lambda: dtw_distance(x, y), 1, seconds)),
    ):
        table.add_row(what, f"{ms:.3f}", f"{c / ms:.2f} x as fast")
    console.print(table)


if __name__ == "__main__":
    main()
