"""How like the validation demonstrations a learner's rollouts are: what defaults are chosen by.

    python benchmarks/defaults.py fly --algo dqdil-pt --epsilon 0.5 --epsilon 0.1
    python benchmarks/defaults.py fly --set offline_epochs=30 --set offline_gamma=0.9
    python benchmarks/defaults.py silkmoth --algo dqn --steps 100000 --seed 0 --seed 1 --seed 2

The test split is never touched.
"""

from __future__ import annotations

import sys
import time
from functools import partial
from pathlib import Path
from typing import Annotated

import pandas as pd
import torch
import typer
from rich.console import Console
from rich.table import Table
from stable_baselines3.common.logger import Logger

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # for benchmarks and tools

from animarl_algos.benchmark.paper_tables import kde_distance
from animarl_algos.cli.shared import parse_settings
from animarl_algos.data.vec_env import SlotVecEnv
from animarl_algos.evaluation.collect import RandomPolicy, collect_rollouts
from animarl_algos.evaluation.metrics import measure, measure_recordings
from animarl_algos.learner.presets import learner_preset
from animarl_algos.networks.acting_rule import Acting
from animarl_algos.recipes.registry import named_recipe
from animarl_envs import environment_id
from animarl_envs.demos.packaged import load_packaged, packaged_names
from animarl_envs.fitting.custom_species import species_of
from animarl_envs.importing.readers import read
from animarl_envs.scenario import make_scenario
from animarl_envs.worlds import make_world


def main(
    demonstrations: Annotated[str, typer.Argument(help="A file, or agent, fly, newt, silkmoth.")],
    species: Annotated[str | None, typer.Option(help="Of a file.")] = None,
    algo: Annotated[str, typer.Option(help="The learner.")] = "dqdil-pt",
    settings: Annotated[list[str] | None, typer.Option("--set", help="KEY=VALUE.")] = None,
    steps: Annotated[int, typer.Option(help="Of the online phase; 1: the offline one alone.")] = 1,
    epsilon: Annotated[list[float] | None, typer.Option(help="When acting; repeatable.")] = None,
    repetitions: Annotated[int, typer.Option(help="Rollouts per start.")] = 5,
    seed: Annotated[list[int] | None, typer.Option(help="Of all; repeatable.")] = None,
) -> None:
    """Train with the default preset, once per seed, then act from every validation start."""
    torch.set_num_threads(1)
    packaged = demonstrations in packaged_names()
    demos = load_packaged(demonstrations) if packaged else read(demonstrations, None)
    name = species or demos.species
    spec = species_of(demos, base=name)
    flagged = bool(spec.conditions) and len(set(demos.condition.tolist())) == 2
    preset = learner_preset(algo, environment_id(name), "default", parse_settings(settings))
    chosen = demos.select(split="val")
    recorded = measure_recordings(chosen)
    scenario = make_scenario(spec, demos=demos, split="val")
    world = partial(make_world, scenario)
    means = recorded[["path_length", "duration", "reached"]].mean()
    kind = "demonstrated (synthetic)" if demos.synthetic else "recorded"
    lines = [[kind, "", f"{means.iloc[0]:.3g}", "", f"{means.iloc[1]:.3g}", ""]]
    lines[0].append(f"{means.iloc[2]:.2f}")
    seeds = seed or [0]
    random = RandomPolicy(seeds[0], spec.num_actions)
    rollouts = collect_rollouts(
        world, random, method="random", seed=seeds[0], repetitions=repetitions
    )
    lines.append(["random", *_cells(measure(rollouts, chosen), recorded)])
    seconds = 0.0
    for number in seeds:
        env = SlotVecEnv(spec, preset.n_envs, demos=demos, condition_flag=flagged)
        settings_ = preset.settings
        model = named_recipe(algo).algorithm(env=env, seed=number, device="cpu", settings=settings_)
        model.set_logger(Logger(folder=None, output_formats=[]))
        start = time.process_time()
        model.learn(steps, progress_bar=True)
        seconds += time.process_time() - start
        for share in epsilon or [0.1]:
            model.policy.acting = Acting.epsilon_greedy(share)
            model.policy.seed(number)
            rollouts = collect_rollouts(
                world,
                model,
                method="trained",
                seed=number,
                repetitions=repetitions,
                cue="actual" if flagged else None,
            )
            label = f"seed {number}, epsilon {share:g}"
            lines.append([label, *_cells(measure(rollouts, chosen), recorded)])
    table = Table(
        title=f"{demos.name}, val: {chosen.num_episodes} starts; "
        f"{seconds / len(seeds):.0f} s of processor time to train"
    )
    headings = ("acting", "DTW", "path length", "KDE", "duration, s", "KDE", "reached")
    for heading in headings:
        table.add_column(heading, justify="left" if heading == "acting" else "right")
    for line in lines:
        table.add_row(*line)
    Console(width=100).print(table)


def _cells(rows: pd.DataFrame, recorded: pd.DataFrame) -> list[str]:
    """DTW, path length and duration, each with its distance to the demonstrated, then reached."""
    cells = [f"{rows['dtw'].mean():.3g}"]
    for key in ("path_length", "duration"):
        distance = kde_distance(rows[key].to_numpy(), recorded[key].to_numpy())
        cells += [f"{rows[key].mean():.3g}", f"{distance:.2f}"]
    return [*cells, f"{rows['captured'].mean():.2f}"]


if __name__ == "__main__":
    typer.run(main)
