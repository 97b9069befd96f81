"""How often the demonstrated action ranks in the top three after offline training.

    python benchmarks/ranks.py [FILE] [--species agent] [--seeds 3] [--set offline_epochs=15]

FILE is a file of recorded episodes; without one, the demonstrations packaged for the species.
Every learner runs its offline phase with the ``default`` preset on the training split and then
ranks the 13 actions at each step of the validation split, by its values of them. It keeps the
epoch that is best on that split, so the figures flatter it a little.

top 3      share of steps on which the demonstrated action is among the three of highest value.
           Chance is 3/13 = 0.231; below the table stands what always naming the three actions
           most frequent in training would reach.
mean rank  of the demonstrated action; 1 is best, 7 is chance.

A cell is the mean over seeds and individuals, with the smallest and the largest seed in brackets.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
import torch
import typer
from rich.console import Console
from rich.table import Table
from stable_baselines3.common.logger import Logger

from animarl_algos.cli.shared import parse_settings
from animarl_algos.data.vec_env import SlotVecEnv
from animarl_algos.learner.presets import LearnerPreset, learner_preset
from animarl_algos.learner.pretraining import Figures
from animarl_algos.recipes.registry import named_recipe
from animarl_envs import environment_id
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.packaged import load_packaged
from animarl_envs.fitting.custom_species import species_of
from animarl_envs.fitting.transitions import demonstrated_actions
from animarl_envs.importing.readers import read
from animarl_envs.locomotion import NUM_ACTIONS
from animarl_envs.species import Species

LEARNERS = ("bc", "dqaas", "dqdil-pt", "qr-bc", "qr-dqaas", "qr-dqdil-pt")
TOP = 3


def offline_figures(
    algo: str, preset: LearnerPreset, species: Species, demos: Demonstrations, seed: int
) -> Figures:
    """Validation figures of the epoch that is kept, and its number."""
    env = SlotVecEnv(species, 1, demos=demos, condition_flag=None, **preset.env_kwargs)
    settings = preset.settings.changed(buffer_size=2000)  # nothing is replayed
    model = named_recipe(algo).algorithm(env=env, seed=seed, device="cpu", settings=settings)
    model.set_logger(Logger(folder=None, output_formats=[]))
    progress = model.pretrain()
    return progress.history[progress.best_epoch - 1]


def most_frequent(species: Species, demos: Demonstrations) -> float:
    """Share of validation steps whose action is among the individual's ``TOP`` most frequent."""
    shares = []
    acted = {
        split: demonstrated_actions(demos.select(split=split), species.locomotion)
        for split in ("train", "val")
    }
    for k in range(demos.num_individuals):
        train, val = (acted[split][:, k] for split in ("train", "val"))
        frequent = np.bincount(train[train >= 0], minlength=NUM_ACTIONS).argsort()[-TOP:]
        shares.append(np.isin(val[val >= 0], frequent).mean())
    return float(np.mean(shares))


def cell(values: list[float]) -> str:
    return f"{np.mean(values):.3f} [{min(values):.3f}, {max(values):.3f}]"


def main(
    file: Annotated[str | None, typer.Argument(help="Recorded episodes; default packaged.")] = None,
    species: Annotated[str, typer.Option(help="agent, fly, newt or silkmoth.")] = "agent",
    algo: Annotated[list[str] | None, typer.Option(help="Learners; repeatable.")] = None,
    settings: Annotated[list[str] | None, typer.Option("--set", help="KEY=VALUE.")] = None,
    seeds: Annotated[int, typer.Option(help="Seeds 0, 1, ...")] = 3,
) -> None:
    """Share of validation steps on which the demonstrated action ranks in the top three."""
    torch.set_num_threads(1)
    demos = load_packaged(species) if file is None else read(file, None)
    spec = species_of(demos, base=species)
    validation = demos.select(split="val")
    steps = int((validation.lengths - 1).sum())
    table = Table(
        title=f"{Path(demos.name).name}: {validation.num_episodes} validation episodes of "
        f"{steps:,} steps, seeds: {seeds}"
    )
    for heading in ("learner", "top 3", "mean rank", "epoch kept"):
        table.add_column(heading, justify="left" if heading == "learner" else "right")
    for name in algo or LEARNERS:
        preset = learner_preset(name, environment_id(species), "default", parse_settings(settings))
        rows = [offline_figures(name, preset, spec, demos, seed) for seed in range(seeds)]
        table.add_row(
            name.upper(),
            cell([row[f"val/top_{TOP}"] for row in rows]),
            f"{np.mean([row['val/mean_rank'] for row in rows]):.2f}",
            ", ".join(f"{row['epoch']:.0f}" for row in rows),
        )
        print(".", end="", flush=True)
    console = Console(width=100)
    console.print(table)
    console.print(
        f"chance {TOP / NUM_ACTIONS:.3f}; the {TOP} actions most frequent in training "
        f"{most_frequent(spec, demos):.3f}"
    )


if __name__ == "__main__":
    typer.run(main)
