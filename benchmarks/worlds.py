"""Speed of the worlds, their views and the DTW, beside peers, in one run and one thread.

    python benchmarks/worlds.py [--seconds 1.0] [--rounds 1]

A figure is the best of many short repeats in processor time, the least disturbed one on a shared
machine; the median stands beside it and says how disturbed the machine was. Several rounds measure
everything again in turn and keep the best. Peers: MPE2's simple_tag (PettingZoo, same
dictionaries), the same step in NumPy arrays, and dtaidistance (C) for the DTW; for those that do
not install beside this project see ``benchmarks/peers.py``.
"""

from __future__ import annotations

import argparse
import os
import platform
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

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
from animarl_envs.tasks import find_task
from animarl_envs.worlds import make_world

EPISODE = 25  # steps of a repeat of a single environment: an episode of simple_tag
# Aims of a world are in times the NumPy step, and the chases' also in times MPE2; of the parallel
# view in times MPE2; of gym.make in steps per second where MPE2 makes 4 thousand.
NUMPY_AIMS = {"agent": 5.0, "fly": 5.0, "newt": 5.0, "silkmoth": 3.0}
MPE2_WORLD_AIM, PARALLEL_AIM, MAKE_AIM = 5_000.0, 22.0, 120_000 / 4_000
PACKAGED_AIM = 1.0  # microseconds of a copy and step of all opponents


class Rate(NamedTuple):
    """Units per second."""

    best: float
    median: float


def rate(
    act: Callable[[], Any], units: int, seconds: float, between: Callable[[], Any] | None = None
) -> Rate:
    """Units per second of ``act``, which does ``units`` of them; ``between`` is not timed."""
    act()
    took, until = [], time.perf_counter() + seconds
    while time.perf_counter() < until:
        start = time.process_time()
        act()
        spent = time.process_time() - start
        if spent > 0.0:  # the clock of a virtual machine stood still once
            took.append(spent)
        if between is not None:
            between()
    return Rate(units / min(took), units / float(np.median(took)))


class NumPyChase:
    """The chase step and its compact observation as NumPy array operations, for comparison.

    As NumPy is quickest: copies last, results into arrays that are there, no angles.
    """

    def __init__(self, copies: int) -> None:
        rng = np.random.default_rng(0)
        self.position = rng.uniform(-0.5, 0.5, (3, 2, copies))
        self.velocity, self.focus, self.push, self.scratch = np.zeros((4, 3, 2, copies))
        self.observation = np.zeros((3, 15, copies), dtype=np.float32)
        self.ahead, self.left, self.product = np.zeros((3, 3, copies))
        self.apart, self.distance = np.zeros((3, 2, copies)), np.zeros((3, copies))
        self.pushes = np.ascontiguousarray(ACTION_VECTORS.T)
        self._look()

    def step(self, actions: NDArray[np.int64]) -> NDArray[np.float32]:
        """Return observations ``(3, 15, copies)`` after actions ``(3, copies)``."""
        focus, push = self.focus, self.push
        np.take(self.pushes[0], actions, out=self.ahead)
        np.take(self.pushes[1], actions, out=self.left)
        np.multiply(self.ahead, focus[:, 0], out=push[:, 0])
        np.multiply(self.left, focus[:, 1], out=self.product)
        push[:, 0] -= self.product
        np.multiply(self.ahead, focus[:, 1], out=push[:, 1])
        np.multiply(self.left, focus[:, 0], out=self.product)
        push[:, 1] += self.product
        self.velocity *= 0.75
        np.multiply(push, 0.3, out=self.scratch)
        self.velocity += self.scratch
        np.multiply(self.velocity, 0.1, out=self.scratch)
        self.position += self.scratch
        self._look()
        return self.observation

    def _look(self) -> None:
        position, velocity, focus, seen = self.position, self.velocity, self.focus, self.observation
        apart, distance = self.apart, self.distance  # 0 to 2, 1 to 2 and 0 to 1
        for row, (i, j) in enumerate(((0, 2), (1, 2), (0, 1))):
            np.subtract(position[j], position[i], out=apart[row])
            np.einsum("xb,xb->b", apart[row], apart[row], out=distance[row])
        np.sqrt(distance, out=distance)
        np.divide(apart[0], distance[0], out=focus[0])
        np.divide(apart[1], distance[1], out=focus[1])
        nearer = distance[1] < distance[0]
        np.negative(focus[0], out=focus[2])
        np.copyto(focus[2], -focus[1], where=nearer)
        self._ego(velocity, seen[:, 0:2])
        self._ego(self.push, seen[:, 2:4])
        self._ego(position, seen[:, 13:15])
        for i, (first, second, way) in enumerate(((2, 1, 2), (2, 0, 2), (0, 1, 0))):
            np.subtract(velocity[first], velocity[i], out=self.scratch[0])
            self._ego(self.scratch[:1], seen[i : i + 1, 4:6], focus[i : i + 1])
            np.subtract(position[second], position[i], out=self.scratch[0])
            self._ego(self.scratch[:1], seen[i : i + 1, 7:9], focus[i : i + 1])
            np.subtract(velocity[second], velocity[i], out=self.scratch[0])
            self._ego(self.scratch[:1], seen[i : i + 1, 9:11], focus[i : i + 1])
            seen[i, 6] = distance[i if i < 2 else 0]
            seen[i, 11] = distance[way]
        np.abs(position, out=self.scratch)
        np.maximum(self.scratch[:, 0], self.scratch[:, 1], out=self.product)
        np.subtract(1.0, self.product, out=seen[:, 12], casting="same_kind")

    def _ego(self, vector: Any, out: Any, focus: Any = None) -> None:
        """Write ``vector`` ahead and left of the focus."""
        focus = self.focus if focus is None else focus
        product, sums = self.product[: len(vector)], self.ahead[: len(vector)]
        for row, (x, y, sign) in enumerate(((0, 1, np.add), (1, 0, np.subtract))):
            np.multiply(vector[:, x], focus[:, 0], out=sums)
            np.multiply(vector[:, y], focus[:, 1], out=product)
            sign(sums, product, out=out[:, row], casting="same_kind")


def world_rate(name: str, copies: int, seconds: float, observation: str) -> Rate:
    """World steps with observations; ended episodes start anew between repeats."""
    world = make_world(make_scenario(name, observation=observation), copies)
    world.reset()
    actions = np.random.default_rng(0).integers(13, size=(copies, world.num_individuals))
    return rate(
        lambda: world.step(actions),
        copies,
        seconds,
        lambda: world.reset(world.terminated | world.truncated),
    )


def fastest(name: str) -> dict[str, Any]:
    """Return id and options of a species: its task, or its world where it has none, compact."""
    task = f"{name}Task"
    id_ = animarl_envs.environment_id(name if find_task(task) is None else task)
    return {"id": id_, "observation": "compact"}


def vector_rate(name: str, copies: int, seconds: float, **options: Any) -> Rate:
    """Steps through the VectorEnv, the resets of ended copies included."""
    env = gym.make_vec(**fastest(name), num_envs=copies, **options)
    env.reset(seed=0)
    actions = np.random.default_rng(0).integers(13, size=copies)
    return rate(lambda: env.step(actions), copies, seconds)


def single_rate(env: gym.Env[Any, Any], seconds: float) -> Rate:
    """Steps of one environment, resets included."""

    def episode() -> None:
        env.reset(seed=0)
        for k in range(EPISODE):
            _, _, terminated, truncated, _ = env.step(k % 13)
            if terminated or truncated:
                env.reset()

    return rate(episode, EPISODE, seconds)


def parallel_rate(env: Any, seconds: float) -> Rate:
    """Steps of all individuals with PettingZoo dictionaries, resets included."""

    def episode() -> None:
        env.reset(seed=0)
        for k in range(EPISODE):
            if not env.agents:
                env.reset()
            env.step(dict.fromkeys(env.agents, k % 5))

    return rate(episode, EPISODE, seconds)


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


def machine() -> str:
    """Processor, load and versions, on one line."""
    cpuinfo = Path("/proc/cpuinfo")
    lines = cpuinfo.read_text().splitlines() if cpuinfo.exists() else []
    named = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    processor = named[0] if named else platform.processor()
    load = f"{os.getloadavg()[0]:.1f}" if hasattr(os, "getloadavg") else "unknown"
    versions = f"Python {platform.python_version()}, NumPy {np.__version__}"
    return f"{processor}, {os.cpu_count()} cores, load {load}, {versions}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n", maxsplit=1)[0])
    parser.add_argument("--seconds", type=float, default=1.0, help="time for each figure")
    parser.add_argument("--rounds", type=int, default=1, help="how often, in turn")
    arguments = parser.parse_args()
    seconds = arguments.seconds
    warnings.simplefilter("ignore")
    console = Console()
    console.width = max(console.width, 140)
    console.print(f"Before: {machine()}")

    simple_tag = simple_tag_v3.parallel_env(num_good=1, num_adversaries=2)
    plain = NumPyChase(1024)
    actions = np.random.default_rng(0).integers(13, size=(3, 1024))
    mpe, in_numpy = Rate(0.0, 0.0), Rate(0.0, 0.0)
    best: dict[str, Rate] = {}
    aims: dict[str, dict[str, float]] = {}

    def keep(what: str, figure: Rate, aim: dict[str, float]) -> None:
        best[what], aims[what] = max(figure, best.get(what, figure)), aim

    for name in [*SPECIES] * arguments.rounds:
        # The peers again beside each species, and their best: the load of a machine changes.
        mpe = max(mpe, parallel_rate(simple_tag, seconds))
        in_numpy = max(in_numpy, rate(lambda: plain.step(actions), 1024, seconds))
        wanted = NUMPY_AIMS.get(name)
        for observation in ("compact", "full"):
            for copies in (1, 64, 1024, 8192):
                aim: dict[str, float] = {}
                if copies == 1024 and observation == "compact" and wanted:
                    aim = {"NumPy": wanted}
                    aim |= {} if name == "silkmoth" else {"MPE2": MPE2_WORLD_AIM}
                what = f"{name} world, {observation}, {copies} copies"
                keep(what, world_rate(name, copies, seconds, observation), aim)
        for copies in (1024, 4096):
            keep(f"{name} gym.make_vec, {copies} copies", vector_rate(name, copies, seconds), {})
        env = gym.make(**fastest(name))
        one = {"MPE2": MAKE_AIM} if wanted else {}
        keep(f"{name} gym.make", single_rate(env, seconds), one)
        keep(f"{name} gym.make(...).unwrapped", single_rate(env.unwrapped, seconds), {})
        everyone, all_of = (
            animarl_envs.parallel_env(fastest(name)["id"], observation="compact"),
            {"MPE2": PARALLEL_AIM},
        )
        rate_of_all = parallel_rate(everyone, seconds)
        keep(f"{name} PettingZoo, all", rate_of_all, all_of if wanted else {})

    table = Table(title="Environment steps per second, one thread, one run")
    table.add_column("what")
    for heading in ("best", "median", "against MPE2", "against NumPy", "aim", "met"):
        table.add_column(heading, justify="right")
    in_table = {
        "MPE2 simple_tag, dictionaries, 3 bodies": mpe,
        "the chase step in NumPy, 1024 copies": in_numpy,
    } | best
    peers = {"MPE2": mpe.best, "NumPy": in_numpy.best}
    for what, figure in in_table.items():
        aim = aims.get(what, {})
        met = all(figure.best >= times * peers[peer] for peer, times in aim.items())
        wanted_text = ", ".join(f"{times:,.0f} x {peer}" for peer, times in aim.items())
        table.add_row(
            what,
            f"{figure.best:,.0f}",
            f"{figure.median:,.0f}",
            f"{figure.best / mpe.best:,.1f} x",
            f"{figure.best / in_numpy.best:.2f} x",
            wanted_text,
            ("yes" if met else "no") if aim else "",
        )
    console.print(table)

    table = Table(title="Opponents in 1,024 copies of gym.make_vec, microseconds a copy and step")
    for heading in ("task", "scripted", "packaged", "aim", "met"):
        table.add_column(heading, justify="right" if heading != "task" else "left")
    for name in ("agent", "fly", "newt"):
        scripted, packaged = (
            1e6 / vector_rate(name, 1024, seconds, others=rule).best
            for rule in ("scripted", "packaged")
        )
        met = "yes" if packaged - scripted <= PACKAGED_AIM else "no"
        aim = f"{scripted + PACKAGED_AIM:.2f}"
        table.add_row(name, f"{scripted:.2f}", f"{packaged:.2f}", aim, met)
    console.print(table)

    table = Table(title="DTW of two paths of 150 points")
    table.add_column("what")
    table.add_column("ms", justify="right")
    table.add_column("against dtaidistance", justify="right")
    rng = np.random.default_rng(0)
    x, y = rng.normal(size=(150, 2)), rng.normal(size=(150, 2))
    c = 1e3 / rate(lambda: dtw_ndim.distance_fast(x, y, inner_dist="euclidean"), 1, seconds).best
    for what, ms in (
        ("dtaidistance, C", c),
        ("NumPy", 1e3 / rate(lambda: textbook(x, y), 1, seconds).best),
        ("here, numba", 1e3 / rate(lambda: dtw_distance(x, y), 1, seconds).best),
    ):
        table.add_row(what, f"{ms:.3f}", f"{c / ms:.2f} x as fast")
    console.print(table)
    console.print(f"After: {machine()}")


if __name__ == "__main__":
    main()
