"""Counterfactuals with a truth: the recorded agents of both conditions, learners times seeds.

    python benchmarks/counterfactual.py --estimate
    python benchmarks/counterfactual.py --seed 0 --seed 1 --seed 2
    python benchmarks/counterfactual.py --seed 0 --seed 1 --seed 2 --steps 200000
    python benchmarks/counterfactual.py --species silkmoth --only dqdil --only dqcil-pt
    python benchmarks/counterfactual.py --tiny --cells out/tiny --out out/tiny/results

Every cell (learner and seed) is fitted and trained as ``animarl train`` does, in a run
folder of its own under ``--cells``; one that was killed goes on, a finished one is not made again.
Then all are asked about the other condition, as ``animarl counterfactual`` does. The truth is what
the published teams of the other condition do from the same starts. Recordings and weights lie in
$ANIMARL_DATA (by default ../shared/data). Silkmoths are the packaged (synthetic) ones, full against
reduced senses; beside them stands what the same network does with the other senses.
"""

from __future__ import annotations

import os
import shlex
import shutil
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import pandas as pd
import torch
import typer
from rich.console import Console

from animarl_algos.evaluation import counterfactual_runs
from animarl_algos.evaluation import effects as of
from animarl_algos.evaluation.statistics import interval
from animarl_algos.recipes.registry import named_recipe
from animarl_algos.report.counterfactual_page import CounterfactualInputs
from animarl_algos.report.words import with_interval
from animarl_algos.runs import pipeline
from animarl_algos.runs.run import Run
from animarl_algos.runs.run_files import versions
from animarl_algos.runs.run_settings import RunSettings, pipeline_settings
from animarl_envs import environment_id
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.joining import join
from animarl_envs.demos.packaged import load_packaged
from animarl_envs.demos.summary import unit_of
from animarl_envs.files import all_files_or_none
from animarl_envs.fitting.result import LocomotionFit, fit_locomotion
from animarl_envs.importing.readers import read
from animarl_envs.scenario import PACKAGED

DATA = Path(os.environ.get("ANIMARL_DATA", Path(__file__).parents[2] / "shared" / "data"))
FOLDER = DATA / "agents_collab_hunting"
FILES = ("episodes_c2ae_indiv_slow2.4.npz", "episodes_c2ae_share_slow2.4.npz")
ALGOS = ("dqcil-pt", "dqdil-pt", "bc", "soft-bc")
SPECIES, MOTH = "agent", "silkmoth"
TINY = {"offline_epochs": 1, "policy_kwargs": {"hidden": 32}}
SHOWN = (of.PREDICTED, of.TRUE, of.MISSED, of.UNTRAINED_SHIFT, of.BLIND, of.ERROR)
PROBE_STEPS = (4000, 12_000)  # both beyond the first updates; what differs is learning as usual
PAGE = "all"  # below the cells: the page, every table and figure
KEPT = ("counterfactual.csv", "claims.csv")  # that is small enough


def recorded(tiny: bool = False) -> Demonstrations:
    """Both conditions of the recorded agents, with the splits of their reader."""
    both = join([read(FOLDER / name, "agents") for name in FILES], "recorded agents")
    if not tiny:
        return both
    chosen: list[int] = []
    for split, count in (("train", 10), ("val", 4), ("test", 5)):
        for condition in (0, 1):
            here = (both.split == split) & (both.condition == condition)
            chosen += here.nonzero()[0][:count].tolist()
    return both.select(episodes=chosen)


def asked_for(
    algo: str,
    seed: int,
    steps: int | None,
    overrides: dict[str, Any],
    share: float = 1.0,
    species: str = SPECIES,
) -> RunSettings:
    """The default preset, with other steps for learners that adapt online, or fewer epochs."""
    settings = RunSettings(
        file=", ".join(FILES) if species == SPECIES else PACKAGED, species=species, algo=algo,
        steps=1, seed=seed, baselines=False, overrides=overrides,
        **pipeline_settings(environment_id(species), "default"),
    )  # fmt: skip
    preset = settings.learner()
    if share < 1.0:
        epochs = max(1, round(share * int(preset.arguments["offline_epochs"])))
        settings = settings.changed(overrides=overrides | {"offline_epochs": epochs})
    online = bool(named_recipe(algo).algorithm.recipe.online)
    wanted = preset.n_timesteps if steps is None or not online else steps
    return settings.changed(steps=wanted, copies=preset.n_envs)


def cell(
    demos: Demonstrations, folder: Path, settings: RunSettings, fits: dict[int, LocomotionFit]
) -> Run:
    """Train what is not there yet; all learners of a seed have one fit, kept in ``fits``."""
    run = pipeline.open_run(settings, folder, shlex.join(["python", *sys.argv]), demos)
    file = run.path / "locomotion.json"
    if settings.seed in fits and not file.exists():
        fits[settings.seed].save(file)
    fits[settings.seed] = pipeline.fit(run)
    pipeline.learn(run, settings.algo, progress_bar=False)
    return run


def seconds(
    demos: Demonstrations, fitted: LocomotionFit, algo: str, steps: int, epochs: int
) -> float:
    """Processor time of learning so many steps and epochs, in a folder that is removed."""
    settings = asked_for(algo, 0, steps, {"offline_epochs": epochs}).changed(
        steps=steps, acting="greedy"
    )
    with tempfile.TemporaryDirectory() as folder:
        run = pipeline.open_run(settings, Path(folder) / "cell", "an estimate", demos)
        fitted.save(run.path / "locomotion.json")
        began = time.process_time()
        pipeline.learn(run, algo, progress_bar=False)
        return time.process_time() - began


def seconds_a_step(demos: Demonstrations, fitted: LocomotionFit, algo: str) -> float:
    """Processor time of one online step, from two lengths in both of which it learns."""
    short, long = PROBE_STEPS
    taken = seconds(demos, fitted, algo, long, 1) - seconds(demos, fitted, algo, short, 1)
    if taken <= 0:
        raise RuntimeError(
            f"{long} steps of {algo} took no longer than {short}: the machine is too busy to "
            "estimate by"
        )
    return taken / (long - short)


def estimate(
    demos: Demonstrations, algos: Sequence[str], steps: int | None, seeds: int, console: Console
) -> None:
    """Processor time of the whole, from two epochs and a few steps of every learner."""
    began = time.process_time()
    fitted = fit_locomotion(demos, "joint", seed=0)
    fit = time.process_time() - began
    total = 0.0
    for algo in algos:
        whole = asked_for(algo, 0, steps, {})
        epochs = int(whole.learner().arguments["offline_epochs"])
        online = bool(named_recipe(algo).algorithm.recipe.online)
        seconds(demos, fitted, algo, 1, 1)  # what is compiled and loaded once is not counted
        one, three = (seconds(demos, fitted, algo, 1, number) for number in (1, 3))
        epoch = max(0.0, three - one) / 2
        step = seconds_a_step(demos, fitted, algo) if online else 0.0
        need = fit + one + (epochs - 1) * epoch + step * whole.steps
        total += seeds * need
        console.print(
            f"{algo}: {fit + one - epoch:.0f} s around it, {epoch:.1f} s an epoch ({epochs} at "
            f"most), {1e3 * step:.1f} s for 1,000 of "
            f"{whole.steps if online else 0:,} steps: {need / 60:.0f} min a seed"
        )
    console.print(
        f"{len(algos)} learners, {seeds} seeds: about {total / 3600:.1f} hours of one core"
    )


def main(
    seed: Annotated[list[int] | None, typer.Option(help="Repeatable; default 0, 1, 2.")] = None,
    only: Annotated[list[str] | None, typer.Option(help="These learners; repeatable.")] = None,
    species: Annotated[str, typer.Option(help=f"Recorded {SPECIES}s or a packaged set.")] = SPECIES,
    steps: Annotated[
        int | None, typer.Option(help="Online steps; by default the preset's.")
    ] = None,
    share: Annotated[
        float, typer.Option(help="Of the preset's offline epochs, for less time.", min=0, max=1)
    ] = 1.0,
    repetitions: Annotated[int, typer.Option(help="Rollouts from each start.")] = 5,
    tiny: Annotated[bool, typer.Option(help="Few episodes, one epoch: only to try it.")] = False,
    estimated: Annotated[
        bool, typer.Option("--estimate", help="Say how long the whole takes, and stop.")
    ] = False,
    cells: Annotated[Path, typer.Option(help="Run folders, and the page.")] = Path(
        "out/counterfactual"
    ),
    out: Annotated[Path, typer.Option(help="The tables and a figure.")] = Path(
        "docs/results/counterfactual"
    ),
) -> None:
    """Train every cell, then ask all of them."""
    torch.set_num_threads(1)
    console = Console(width=128)
    seeds, learners, truth = seed or [0, 1, 2], only or ALGOS, None
    if species == SPECIES:
        if not FOLDER.is_dir():
            raise typer.BadParameter(f"the recorded agents are not in {DATA}: set ANIMARL_DATA")
        demos, truth = recorded(tiny), FOLDER / "weights"
    else:
        demos = load_packaged(species)
    if estimated:
        estimate(demos, learners, steps, len(seeds), console)
        return
    fits: dict[int, LocomotionFit] = {}
    for s in seeds:
        for algo in learners:
            began = time.process_time()
            settings = asked_for(algo, s, steps, TINY if tiny else {}, share, species)
            run = cell(demos, cells / f"{species}-{algo}-{s}", settings, fits)
            console.print(f"{run.path}: {time.process_time() - began:.0f} s")
    folders = [cells / f"{species}-{algo}-{s}" for algo in learners for s in seeds]
    page = cells / f"{species}-{PAGE}"
    found = counterfactual_runs(folders, page, truth=truth, repetitions=repetitions)
    text = markdown(found)
    with all_files_or_none(out) as part:
        (part / "README.md").write_text(text)
        for name in KEPT:
            shutil.copyfile(page / name, part / name)
    console.print(text, markup=False, highlight=False, soft_wrap=True)


def markdown(found: CounterfactualInputs) -> str:
    """The table of shifts with their truth, and what may be claimed."""
    effects, conditions = found.effects, found.species.conditions
    table = effects.table[effects.table["counting"] == "all"]
    moths = found.species.name == MOTH
    who, walked = ("silkmoths (synthetic)", "moth") if moths else ("recorded agents", "predators")
    unit = unit_of(found.demos).name if moths else "arena units"
    truth = "" if moths else (
        " The truth: what the published teams of the other condition do from the same starts."
    )  # fmt: skip
    lines = [
        f"# Counterfactuals: the {who}",
        "",
        f"    {shlex.join(['python', *sys.argv])}",
        "",
        f"{', '.join(f'{name} {number}' for name, number in versions().items())}.",
        "",
        f"Mean path length of the {walked} [{unit}], 95 % intervals, all episodes.{truth}",
        "",
        f"| method | variant | flip | seeds | {' | '.join(SHOWN)} |",
        f"|{'---|' * (4 + len(SHOWN))}",
    ]
    predicted = table[table["quantity"] == of.PREDICTED]
    for _, row in predicted.iterrows():
        own = table[(table["method"] == row["method"]) & (table["condition"] == row["condition"])]
        cells = [_cell(own, quantity) for quantity in SHOWN]
        flip = f"{conditions[row['condition']]} to {conditions[row['told']]}"
        head = [str(row["method"]), str(row["variant"]), flip, str(row["seeds"])]
        lines.append(f"| {' | '.join(head + cells)} |")
    lines += ["", "| difference of signed errors | condition | value |", "|---|---|---|"]
    for _, row in table[table["quantity"] == of.ERROR_DIFFERENCE].iterrows():
        value = with_interval(interval(row))
        lines.append(f"| {row['method']} | {conditions[row['condition']]} | {value} |")
    accuracy = table[table["quantity"] == of.ACCURACY].dropna(subset="value")
    lines += ["", *(f"Treatment accuracy of {r['method']}: {r['value']:.2f} (0.5: blind)."
                    for _, r in accuracy.iterrows())]  # fmt: skip
    lines += [""]
    for _, row in effects.claims.iterrows():
        if (row["condition"], row["told"]) != found.species.planned_flip:
            continue
        own = table[(table["method"] == row["method"]) & (table["condition"] == row["condition"])]
        shift, missed = _cell(own, of.PREDICTED), _cell(own, of.MISSED)
        said = f"told apart from zero and from untrained networks: predicted {shift}"
        if not row["worded"]:
            said = f"no effect of the cue is claimed, for {row['reason']} (predicted {shift})"
        flip = f"{conditions[row['condition']]} to {conditions[row['told']]}"
        lines.append(f"- {row['method']}, {flip}, planned: {said}; predicted minus true {missed}.")
    return "\n".join(lines) + "\n"


def _cell(rows: pd.DataFrame, quantity: str) -> str:
    chosen = rows[rows["quantity"] == quantity]
    return "" if chosen.empty else with_interval(interval(chosen.iloc[0]))


if __name__ == "__main__":
    typer.run(main)
