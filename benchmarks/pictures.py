"""Cost of a picture (``render_mode="rgb_array"``) beside MPE2's, in one run and one thread.

    python benchmarks/pictures.py [--pictures 60]

Each environment takes random actions; a picture is drawn after every step and only the drawing is
timed, in processor time: best and median of all. The time of a picture depends on what there is to
see, so the trails are of 60 steps and more; ``silkmoth, long`` is a search of over 500 steps.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable
from typing import Any

import gymnasium as gym
import numpy as np
from mpe2 import simple_tag_v3
from rich.console import Console
from rich.table import Table

import animarl_envs
from animarl_envs.species import SPECIES


def timed(step: Callable[[], Any], draw: Callable[[], Any], first: int, count: int) -> list[float]:
    """Milliseconds of ``count`` pictures, one after each step from the ``first`` on."""
    for _ in range(first):
        step()
    draw()
    took = []
    for _ in range(count):
        step()
        start = time.process_time()
        draw()
        took.append(1e3 * (time.process_time() - start))
    return took


def ours(name: str, first: int, count: int) -> list[float]:
    """Pictures of ``gym.make``."""
    env = gym.make(animarl_envs.environment_id(name), render_mode="rgb_array")
    env.action_space.seed(0)
    seed = iter(range(10**6))
    env.reset(seed=next(seed))

    def step() -> None:
        _, _, terminated, truncated, _ = env.step(env.action_space.sample())
        if terminated or truncated:
            env.reset(seed=next(seed))

    return timed(step, env.render, first, count)


def mpe2(count: int) -> list[float]:
    """Pictures of simple_tag."""
    env = simple_tag_v3.parallel_env(render_mode="rgb_array")
    env.reset(seed=0)

    def step() -> None:
        if not env.agents:
            env.reset()
        env.step({agent: env.action_space(agent).sample() for agent in env.agents})

    return timed(step, env.render, 60, count)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--pictures", type=int, default=60)
    count = parser.parse_args().pictures
    table = Table(title="One picture, rgb_array, one thread")
    for heading in ("what", "best, ms", "median, ms", "times MPE2"):
        table.add_column(heading, justify="left" if heading == "what" else "right")
    peer = mpe2(count)
    rows = [(name, ours(name, 60, count)) for name in SPECIES]
    rows.append(("silkmoth, long", ours("silkmoth", 500, count)))
    peer = min(peer, mpe2(count), key=np.median)
    for name, took in [*rows, ("MPE2 simple_tag", peer)]:
        ratio = np.median(took) / np.median(peer)
        table.add_row(name, f"{min(took):.1f}", f"{np.median(took):.1f}", f"{ratio:.2f}")
    console = Console()
    console.print(table)
    console.print(f"load {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores")


if __name__ == "__main__":
    main()
