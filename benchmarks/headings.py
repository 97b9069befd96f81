"""How well headings are foretold by a fitted turning, in files of demonstrations that have some.

    python benchmarks/headings.py clip.npz

Five-fold cross-validation over episodes: absolute errors [rad], median and 90 % quantile, of the
next heading from the recorded state (one step), and of all headings of an episode from the first
one and the recorded path (free running). All steps, and those of the faster half.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.errors import InputError
from animarl_envs.fitting.turning import along_travel, fit_turning, heading_misses
from animarl_envs.species.turning import Turning

FOLDS = 5
HELD = Turning(persistence=0.0, gain=1e-12, slip=0.0, speed=1.0)


def held_out_misses(demos: Demonstrations, individual: int) -> dict[str, NDArray[np.float64]]:
    """By rule, one-step and free-running errors ``(2, steps)`` of episodes not fitted to."""
    found: dict[str, list[NDArray[np.float64]]] = {}
    fold_of = np.arange(len(demos)) % FOLDS
    for fold in range(min(FOLDS, len(demos))):
        seen = demos.select(episodes=np.flatnonzero(fold_of != fold))
        unseen = demos.select(episodes=np.flatnonzero(fold_of == fold))
        travel = along_travel(unseen, individual)
        own = fit_turning(seen, individual)
        rules = {"held": HELD, "along travel": travel, "fitted": travel if own is None else own}
        for name, rule in rules.items():
            found.setdefault(name, []).append(heading_misses(unseen, rule, individual))
    return {name: np.concatenate(parts, axis=1) for name, parts in found.items()}


def speeds(demos: Demonstrations, individual: int) -> NDArray[np.float64]:
    """Of the same steps in the same order, ``(steps,)``."""
    fold_of = np.arange(len(demos)) % FOLDS
    parts = []
    for fold in range(min(FOLDS, len(demos))):
        unseen = demos.select(episodes=np.flatnonzero(fold_of == fold))
        parts.append(np.linalg.norm(unseen.velocities()[unseen.steps() > 0, individual], axis=1))
    return np.concatenate(parts)


def rows(demos: Demonstrations) -> Iterator[list[str]]:
    """Lines of the table."""
    for i, name in enumerate(demos.individuals):
        speed = speeds(demos, i)
        for which, chosen in (("all", speed >= 0.0), ("fast", speed > np.median(speed))):
            for rule, misses in held_out_misses(demos, i).items():
                figures = np.quantile(misses[:, chosen], [0.5, 0.9], axis=1).T.ravel()
                yield [name, which, rule, *(f"{figure:.3f}" for figure in figures)]


def main() -> None:
    parser = argparse.ArgumentParser(description="How well headings are foretold.")
    parser.add_argument("demonstrations", nargs="+")
    for path in parser.parse_args().demonstrations:
        demos = Demonstrations.load(path)
        if demos.headings() is None:
            raise InputError(f"{path}: it has no headings: import it with --heading REAR,FRONT")
        table = Table(title=path)
        for column in ("individual", "steps", "rule", "one step", "90 %", "free running", "90 %"):
            table.add_column(column)
        for row in rows(demos):
            table.add_row(*row)
        console = Console()
        console.print(table)
        for i, name in enumerate(demos.individuals):
            console.print(f"{name}, fitted to all episodes: {fit_turning(demos, i)}")


if __name__ == "__main__":
    main()
