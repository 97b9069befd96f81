"""What the online phase adds to the offline one: rollouts before and after it, and the recordings.

    python benchmarks/online.py agent --rate 1e-5 --rate 3e-5 --rate 1e-4 --seed 0 --seed 1
    python benchmarks/online.py fly newt silkmoth --seed 0 --seed 1
    python benchmarks/online.py termites.npz --algo dqaas

Each learner is pretrained once per seed and goes on from there at every rate. Before and after, it
is rolled out from the validation starts, sampled at the temperatures fitted anew on validation. The
test split is never touched.
"""

from __future__ import annotations

import tempfile
import time
from functools import partial
from typing import Annotated, Any

import numpy as np
import torch
import typer
from rich.console import Console
from rich.table import Table
from stable_baselines3.common.logger import Logger

from animarl_algos.cli.shared import parse_settings
from animarl_algos.data.vec_env import SlotVecEnv
from animarl_algos.evaluation.collect import collect_rollouts
from animarl_algos.evaluation.prepared import Prepared, path_lengths
from animarl_algos.evaluation.realism import WEIGHTS, Likelihood
from animarl_algos.evaluation.rollouts import Rollouts
from animarl_algos.learner.algorithm import SequenceQLearning
from animarl_algos.learner.checkpoint import load_checkpoint, save_checkpoint
from animarl_algos.learner.presets import learner_preset
from animarl_algos.networks.acting_rule import Acting
from animarl_algos.recipes.registry import named_recipe
from animarl_envs import environment_id
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.packaged import load_packaged, packaged_names
from animarl_envs.fitting.custom_species import species_of
from animarl_envs.scenario import Scenario, make_scenario
from animarl_envs.worlds import make_world

ROLLOUTS = 200
HEADINGS = ("", "duration, s", "reached", "path", "median speed", *WEIGHTS, "all")


def demonstrations(name: str) -> Demonstrations:
    """A packaged set, or a file."""
    return load_packaged(name) if name in packaged_names() else Demonstrations.load(name)


def learner(
    demos: Demonstrations, algo: str, seed: int, settings: dict[str, Any]
) -> SequenceQLearning:
    """As the default preset makes it, in its own training environment."""
    species = species_of(demos)
    preset = learner_preset(algo, environment_id(species.name), "default", settings)
    env = SlotVecEnv(
        species,
        preset.n_envs,
        demos=demos,
        condition_flag=None,
        **preset.env_kwargs,
    )
    model = named_recipe(algo).algorithm(env=env, seed=seed, device="cpu", settings=preset.settings)
    model.set_logger(Logger(folder=None, output_formats=[]))
    return model


def acted(model: SequenceQLearning, scenario: Scenario, seed: int) -> Rollouts:
    """Rollouts from all starts, sampled at temperatures that fit the model as it now is."""
    assert scenario.demos is not None
    model.policy.acting = Acting.boltzmann(model.fit_temperature(model.demonstration_data().val))
    model.policy.seed(seed)
    return collect_rollouts(
        partial(make_world, scenario),
        model,
        method="trained",
        seed=seed,
        repetitions=max(1, round(ROLLOUTS / scenario.demos.num_episodes)),
        cue="actual" if model.layout.condition_flag else None,
    )


def described(label: str, rollouts: Rollouts, realism: Likelihood | None = None) -> list[str]:
    """Means, then log likelihoods of the recordings, by which an acting rule is chosen."""
    means = (
        ((rollouts.lengths - 1) * rollouts.dt).mean(),
        (rollouts.outcome > 0).mean(),
        path_lengths(rollouts)[:, rollouts.movers].mean(),
        np.median(rollouts.speeds()),
    )
    cells = [label, *(f"{value:.3g}" for value in means)]
    if realism is None:
        return [*cells, *("" for _ in (*WEIGHTS, "all"))]
    found = realism.components(rollouts)
    kinds = realism.by_kind(found) | {"all": float(np.nanmean(realism.total(found)))}
    return [*cells, *(f"{kinds[kind]:.2f}" if kind in kinds else "" for kind in (*WEIGHTS, "all"))]


def main(
    species: Annotated[list[str], typer.Argument(help="Packaged sets, or files.")],
    algo: Annotated[str, typer.Option(help="The learner.")] = "dqdil-pt",
    settings: Annotated[list[str] | None, typer.Option("--set", help="KEY=VALUE.")] = None,
    steps: Annotated[int, typer.Option(help="Of the online phase.")] = 30_000,
    rate: Annotated[
        list[float] | None, typer.Option(help="Online; by default the preset's.")
    ] = None,
    seed: Annotated[list[int] | None, typer.Option(help="Of all; repeatable.")] = None,
) -> None:
    """Pretrain, act, adapt, act again."""
    torch.set_num_threads(1)
    for name in species:
        demos = demonstrations(name)
        scenario = make_scenario(species_of(demos), demos=demos, split="val")
        assert scenario.demos is not None
        realism = Likelihood.of(Prepared(scenario.demos))
        lines = [described("demonstrated", realism.prepared.recorded)]
        for number in seed or [0]:
            lines += before_and_after(
                demos, algo, number, parse_settings(settings), steps, rate, scenario, realism
            )
        table = Table(title=f"{algo}, {demos.name}, {steps} steps online")
        for heading in HEADINGS:
            table.add_column(heading, justify="right" if heading else "left")
        for line in lines:
            table.add_row(*line)
        Console(width=120).print(table)


def before_and_after(
    demos: Demonstrations,
    algo: str,
    seed: int,
    settings: dict[str, Any],
    steps: int,
    rates: list[float] | None,
    scenario: Scenario,
    realism: Likelihood,
) -> list[list[str]]:
    """A line for the offline phase, and one for each rate of the online phase after it."""
    lines = []
    with tempfile.TemporaryDirectory() as folder:
        begun = time.process_time()
        model = learner(demos, algo, seed, settings)
        model.pretrain()
        save_checkpoint(model, folder)
        label = f"seed {seed}: offline, {time.process_time() - begun:.0f} s"
        lines.append(described(label, acted(model, scenario, seed), realism))
        for rate in rates or [None]:
            begun = time.process_time()
            over = {} if rate is None else {"learning_rate": rate}
            model = learner(demos, algo, seed, settings | over)
            load_checkpoint(model, folder)
            model.learn(steps, reset_num_timesteps=False)
            label = f"seed {seed}: {model.learning_rate:g}, {time.process_time() - begun:.0f} s"
            lines.append(described(label, acted(model, scenario, seed), realism))
    return lines


if __name__ == "__main__":
    typer.run(main)
