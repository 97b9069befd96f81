"""What a step costs with many animals: 2 to 50 pursuers, 25 to 10,000 animals without a target.

    python benchmarks/crowds.py [--seconds 1.0]

An open arena without contacts, so that no episode ends. ``gym.make`` and ``gym.make_vec`` hand out
the observation of one individual, which sees each of the others once; in a world of which all
individuals are asked, K of them see K - 1 each. Animals of a shoal see their nearest few, and the
shoal is as dense whatever its size. A figure is the best of many short repeats, in processor time,
so that other work on the machine counts less.
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable
from typing import Annotated, Any

import gymnasium as gym
import numpy as np
import typer
from rich.console import Console
from rich.table import Table

import animarl_envs
from animarl_envs.scenario import make_scenario
from animarl_envs.worlds import make_world

PURSUERS = (2, 10, 50)
COPIES = (16, 256)
ANIMALS, NEIGHBOURS = (25, 100, 400, 2_500, 10_000), (0, 4, 8)
SINGLE_STEPS = 20  # of a repeat of one copy, between resets that are not timed


def main(seconds: Annotated[float, typer.Option(help="For each figure.")] = 1.0) -> None:
    """Print env steps per second, and what a step costs per animal and per pair."""
    warnings.simplefilter("ignore")
    table = Table(title="Chase of agents, one thread, processor time")
    for heading in ("what", "pursuers", "steps / s", "of 2's", "ns / animal", "ns / pair seen"):
        table.add_column(heading, justify="right")
    for what, make, seen_by_all in kinds():
        least = 0.0
        for pursuers in PURSUERS:
            step, between, steps = make(pursuers)
            rate = steps / quickest(step, between, seconds)
            least = least or rate
            animals = pursuers + 1
            pairs = animals * pursuers if seen_by_all else pursuers
            table.add_row(
                what, f"{pursuers}", f"{rate:,.0f}", f"1/{least / rate:.1f}",
                f"{1e9 / rate / animals:.1f}", f"{1e9 / rate / pairs:.1f}",
            )  # fmt: skip
    Console(width=110).print(table)
    for copies in (1, 16):
        title = f"Shoals, copies: {copies}, one thread: ns of processor time per animal and step"
        table = Table(title=title)
        table.add_column("animals", justify="right")
        for seen in NEIGHBOURS:
            table.add_column(f"{seen} neighbours", justify="right")
        table.add_column("4, paid for company", justify="right")
        for animals in ANIMALS if copies == 1 else ANIMALS[:3]:
            costs = []
            for seen, paid in [*((seen, False) for seen in NEIGHBOURS), (4, True)]:
                step, between, steps = shoal(animals, seen, copies, shoaling_reward=paid)
                costs.append(1e9 * quickest(step, between, seconds) / steps / animals)
            table.add_row(f"{animals:,}", *(f"{cost:,.0f}" for cost in costs))
        Console(width=110).print(table)


Made = tuple[Callable[[], Any], Callable[[], Any], int]


def kinds() -> list[tuple[str, Callable[[int], Made], bool]]:
    """Name, maker of (steps, what comes between, number of steps), and whether all observe."""
    return [
        ("gym.make", single, False),
        *((f"gym.make_vec, {n}", lambda p, n=n: vector(p, n), False) for n in COPIES),
        *((f"world, all, {n}", lambda p, n=n: world(p, n), True) for n in COPIES),
    ]


def options(pursuers: int) -> dict[str, Any]:
    """Nobody touches anybody, nobody leaves."""
    world = {"demos": None, "num_pursuers": pursuers, "arena": "open", "contact_radius": 1e-9}
    return world | {"observation": "compact"}


def single(pursuers: int) -> Made:
    """One focal individual, the others by their script."""
    env = gym.make(animarl_envs.environment_id("agent"), **options(pursuers))

    def steps() -> None:
        for k in range(SINGLE_STEPS):
            env.step(k % 13)

    env.reset(seed=0)
    return steps, lambda: env.reset(seed=0), SINGLE_STEPS


def vector(pursuers: int, copies: int) -> Made:
    """The same in so many copies."""
    env = gym.make_vec(animarl_envs.environment_id("agent"), num_envs=copies, **options(pursuers))
    env.reset(seed=0)
    actions = np.random.default_rng(0).integers(13, size=copies)
    return lambda: env.step(actions), lambda: None, copies


def world(pursuers: int, copies: int) -> Made:
    """All individuals act and observe."""
    made = make_world(make_scenario("agent", **options(pursuers)), copies)
    made.reset()
    actions = np.random.default_rng(0).integers(13, size=(copies, pursuers + 1))
    return lambda: made.step(actions), lambda: None, copies


def shoal(animals: int, neighbours: int, copies: int, **options: Any) -> Made:
    """Animals without a target, as dense as twelve in the shoal's tank, all of whom act."""
    size = float((animals / 12) ** 0.5)
    made = make_world(
        make_scenario(
            "shoal", demos=None, num_pursuers=animals, neighbours=neighbours, arena=size,
            start_half_side=0.5 * size, **options,
        ),
        copies,
    )  # fmt: skip
    made.seed(np.arange(copies))
    made.reset()
    actions = np.random.default_rng(0).integers(13, size=(copies, animals))
    return lambda: made.step(actions), made.reset, copies


def quickest(act: Callable[[], Any], between: Callable[[], Any], seconds: float) -> float:
    """Processor time of the quickest repeat [s]; ``between`` is not timed."""
    act()
    best, until = float("inf"), time.perf_counter() + seconds
    while time.perf_counter() < until or best == float("inf"):
        between()
        began = time.process_time()
        act()
        best = min(best, time.process_time() - began)
    return best


if __name__ == "__main__":
    typer.run(main)
