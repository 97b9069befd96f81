"""How like the validation recordings a learner's rollouts are: what defaults are chosen by.

    python benchmarks/defaults.py fly --algo dqdil-pt --epsilon 0.5 --epsilon 0.1
    python benchmarks/defaults.py fly --set offline_epochs=30 --set offline_gamma=0.9

The test split is never touched.
"""

from __future__ import annotations

import time
from functools import partial
from typing import Annotated

import torch
import typer
from rich.console import Console
from rich.table import Table
from stable_baselines3.common.logger import Logger

from animarl_algos.commands.run import parse_settings
from animarl_algos.evaluation.collect import Policy, RandomPolicy, collect_rollouts
from animarl_algos.evaluation.distances import kde_distance
from animarl_algos.evaluation.metrics import measure, measure_recordings
from animarl_algos.presets import learner_preset
from animarl_algos.recipes import named_recipe
from animarl_algos.settings import constructed
from animarl_algos.vec_env import SlotVecEnv
from animarl_envs import environment_id
from animarl_envs.demos.packaged import load_packaged, packaged_names
from animarl_envs.demos.readers import read
from animarl_envs.scenario import make_scenario
from animarl_envs.species.custom import species_of
from animarl_envs.worlds import make_world


def main(
    demonstrations: Annotated[str, typer.Argument(help="A file, or agent, fly, newt, silkmoth.")],
    species: Annotated[str | None, typer.Option(help="Of a file.")] = None,
    algo: Annotated[str, typer.Option(help="The learner.")] = "dqdil-pt",
    settings: Annotated[list[str] | None, typer.Option("--set", help="KEY=VALUE.")] = None,
    steps: Annotated[int, typer.Option(help="Of the online phase.")] = 1,
    epsilon: Annotated[list[float] | None, typer.Option(help="When acting; repeatable.")] = None,
    repetitions: Annotated[int, typer.Option(help="Rollouts per start.")] = 5,
    seed: Annotated[int, typer.Option(help="Of all.")] = 0,
) -> None:
    """Train once with the default preset, then act from every validation start."""
    torch.set_num_threads(1)
    packaged = demonstrations in packaged_names()
    demos = load_packaged(demonstrations) if packaged else read(demonstrations, None)
    name = species or demos.species
    spec = species_of(demos, base=name)
    flagged = bool(spec.conditions) and len(set(demos.condition.tolist())) == 2
    preset = learner_preset(algo, environment_id(name), "default", parse_settings(settings))
    env = SlotVecEnv(spec, preset.n_envs, demos=demos, condition_flag=flagged)
    arguments = constructed(preset.arguments)
    model = named_recipe(algo).algorithm(env=env, seed=seed, device="cpu", **arguments)
    model.set_logger(Logger(folder=None, output_formats=[]))
    start = time.process_time()
    model.learn(steps, progress_bar=True)
    seconds = time.process_time() - start
    chosen = demos.select(split="val")
    recorded = measure_recordings(chosen)
    scenario = make_scenario(spec, demos=demos, split="val")
    table = Table(
        title=f"{demos.name}, val: {chosen.num_episodes} starts; {seconds:.0f} s to train"
    )
    headings = ("acting", "DTW", "path length", "KDE", "duration, s", "KDE", "reached")
    for heading in headings:
        table.add_column(heading, justify="left" if heading == "acting" else "right")
    means = recorded[["path_length", "duration", "return"]].mean()
    table.add_row(
        "recorded",
        "",
        f"{means.iloc[0]:.3g}",
        "",
        f"{means.iloc[1]:.3g}",
        "",
        f"{means.iloc[2]:.2f}",
    )
    acting: list[tuple[str, Policy, float]] = [("random", RandomPolicy(seed), 1.0)]
    acting += [(f"epsilon {e:g}", model, e) for e in epsilon or [0.1]]
    for label, policy, share in acting:
        model.policy.epsilon = share
        model.policy.seed(seed)
        told = "actual" if flagged and policy is model else None
        rollouts = collect_rollouts(
            partial(make_world, scenario),
            policy,
            method=label,
            seed=seed,
            repetitions=repetitions,
            cue=told,  # type: ignore[arg-type]
        )
        rows = measure(rollouts, chosen)
        cells = [f"{rows['dtw'].mean():.3g}"]
        for key in ("path_length", "duration"):
            distance = kde_distance(rows[key].to_numpy(), recorded[key].to_numpy())
            cells += [f"{rows[key].mean():.3g}", f"{distance:.2f}"]
        table.add_row(label, *cells, f"{rows['captured'].mean():.2f}")
    Console(width=100).print(table)


if __name__ == "__main__":
    typer.run(main)
