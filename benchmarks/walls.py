"""How animals move along walls, recorded and simulated, in files of demonstrations.

    python benchmarks/walls.py termites.npz flies.npz

Near the wall means within 5 % of the arena's size. Simulated: the recorded actions (by inverse
dynamics, under the joint fit) from the recorded starts, with walls and without.
"""

from __future__ import annotations

import argparse
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from animarl_envs.arena import Arena
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.fitting.custom_species import species_of
from animarl_envs.fitting.transitions import demonstrated_actions
from animarl_envs.scenario import make_scenario
from animarl_envs.worlds import make_world

NEAR = 0.05  # of the arena's size


def wall_figures(
    position: NDArray[np.float64], velocity: NDArray[np.float64], arena: Arena
) -> list[float]:
    """Of steps ``(steps, 2)``: share near the wall, share beyond it, tangential over total speed.

    The last is the median over moving steps near the wall or beyond it.
    """
    if arena.shape == "disc":
        out = np.linalg.norm(position, axis=1)
        normal = position / np.maximum(out, 1e-12)[:, None]
    else:
        out = np.abs(position).max(axis=1)
        normal = (np.abs(position) == out[:, None]).astype(float)
    speed = np.linalg.norm(velocity, axis=1)
    near = out > (1.0 - NEAR) * arena.size
    moving = near & (speed > 0)
    along = np.abs(velocity[:, 0] * normal[:, 1] - velocity[:, 1] * normal[:, 0])[moving]
    ratio = float(np.median(along / speed[moving])) if moving.any() else float("nan")
    return [float(near.mean()), float((out > arena.size + 1e-9).mean()), ratio]


def simulated(demos: Demonstrations, rebound: bool) -> list[float]:
    """The figures of the recorded actions in the fitted world."""
    species = species_of(demos)
    options: dict[str, Any] = {"contact_radius": 1e-9, "rebound": rebound, "boundary": 1e6}
    world = make_world(make_scenario(species, demos=demos, split=None, **options), len(demos))
    world.reset(demo=np.arange(len(demos)))
    actions = demonstrated_actions(demos, species.locomotion)
    positions, velocities = [], []
    for t in range(int(demos.lengths.max()) - 1):
        running = demos.lengths > t + 1
        asked = np.zeros(actions[: len(demos)].shape, dtype=np.int64)
        asked[running] = np.maximum(actions[(demos.offsets[:-1] + t)[running]], 0)
        world.step(asked)
        positions.append(world.position[running].reshape(-1, 2).copy())
        velocities.append(world.velocity[running].reshape(-1, 2).copy())
    return wall_figures(np.concatenate(positions), np.concatenate(velocities), species.arena)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n", maxsplit=1)[0])
    parser.add_argument("files", nargs="+", help="files of demonstrations in an arena with walls")
    table = Table(title=f"Steps within {NEAR:.0%} of the arena's size from its edge")
    for heading in ("file", "what", "near or beyond", "beyond", "tangential / total speed"):
        table.add_column(heading, justify="left" if heading in ("file", "what") else "right")
    for file in parser.parse_args().files:
        demos = Demonstrations.load(file)
        flat = (demos.positions.reshape(-1, 2), demos.velocities().reshape(-1, 2))
        for what, figures in (
            ("recorded", wall_figures(*flat, demos.arena)),
            ("recorded actions, walls", simulated(demos, True)),
            ("recorded actions, no walls", simulated(demos, False)),
        ):
            table.add_row(file, what, *(f"{figure:.3f}" for figure in figures))
    Console(width=110).print(table)


if __name__ == "__main__":
    main()
