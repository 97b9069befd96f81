"""How much tracking noise misleads fits of damping and thrust: bias and coverage on made walks.

    python benchmarks/tracking_noise.py --experiments 40

Three walkers with thrust 3 and a known damping keep an action for some steps, then draw another.
Noise is a share of their median step. The joint fit knows of no noise, the fit with noise does
(:mod:`animarl_envs.fitting.noise`); the truth should lie in 95 % of its 95 % intervals.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from rich.console import Console
from rich.progress import track
from rich.table import Table

from animarl_envs.fitting.joint import fit_joint
from animarl_envs.fitting.noise import fit_with_noise
from animarl_envs.fitting.transitions import transitions
from animarl_envs.locomotion import Locomotion

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from thrust_walks import walk

THRUST = 3.0


def main(
    experiments: Annotated[int, typer.Option(help="Walks per row.")] = 40,
    damping: Annotated[list[float] | None, typer.Option(help="True ones; repeatable.")] = None,
    share: Annotated[list[float] | None, typer.Option(help="Of a median step.")] = None,
    episodes: Annotated[int, typer.Option(help="Of 50 steps each.")] = 30,
) -> None:
    """Print medians of both fits, and how often intervals hold the truth."""
    table = Table(
        title=f"{experiments} walks of {episodes} episodes of 50 steps, thrust {THRUST:g}"
    )
    for heading in (
        "d", "noise", "joint: d", "u", "with noise: d", "u", "noise found", "d covered", "u covered"
    ):  # fmt: skip
        table.add_column(heading, justify="right")
    for true in damping or (0.2, 0.014):
        for part in share or (0.05, 0.1, 0.2):
            rows = [
                experiment(true, part, episodes, seed)
                for seed in track(range(experiments), f"d {true:g}, noise {part:g}")
            ]
            middle = np.median([row[:5] for row in rows], axis=0)
            covered = np.mean([row[5:] for row in rows], axis=0)
            table.add_row(
                f"{true:g}", f"{part:.0%}", f"{middle[0]:.4f}", f"{middle[1]:.3f}",
                f"{middle[2]:.4f}", f"{middle[3]:.3f}", f"{middle[4]:.1%}",
                *(f"{value:.2f}" for value in covered),
            )  # fmt: skip
    Console(width=110).print(table)


def experiment(damping: float, share: float, episodes: int, seed: int) -> tuple[float, ...]:
    """Both fits of one walker, the noise found (share of a step), and what was covered."""
    truth = (Locomotion(damping, THRUST),) * 3
    exact, _ = walk(truth, seed, episodes=episodes)
    step = float(np.median(np.linalg.norm(exact.velocities()[:, 0], axis=1))) * exact.dt
    demos, _ = walk(truth, seed, episodes=episodes, noise=share * step)
    joint, found = fit_joint(transitions(demos, 0)), fit_with_noise(demos, 0)
    covered = [
        float(interval is not None and interval[0] <= value <= interval[1])
        for interval, value in (
            (found.damping_interval, damping),
            (found.thrust_interval, THRUST),
        )
    ]
    estimates = joint.damping, joint.thrust, found.damping, found.thrust, found.noise / step
    return (*estimates, *covered)


if __name__ == "__main__":
    typer.run(main)
