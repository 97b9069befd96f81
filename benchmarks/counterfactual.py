"""Counterfactuals with a truth: the recorded agents of both conditions, learners times seeds.

    python benchmarks/counterfactual.py --estimate
    python benchmarks/counterfactual.py --seed 0 --seed 1 --seed 2
    python benchmarks/counterfactual.py --seed 0 --seed 1 --seed 2 --steps 200000
    python benchmarks/counterfactual.py --species silkmoth --only dqdil --only dqcil-pt
    python benchmarks/counterfactual.py --tiny --cells out/tiny --out out/tiny/results

Every cell (learner and seed) is fitted and trained as ``animarl train`` does, in a run
folder of its own under ``--cells``; one that was killed goes on, a finished one is not made again.
Then every learner is asked about the other condition, as ``animarl whatif --change condition=NAME
--truth ... --permutations N`` does. The truth is what the published teams of the other condition do
from the same starts. Recordings and weights lie in $ANIMARL_DATA (by default ../shared/data).
Silkmoths are the packaged (synthetic) ones, full against reduced senses; their truth is the
recordings of the other condition.
"""

from __future__ import annotations

import os
import shlex
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pandas as pd
import torch
import typer
from rich.console import Console

from animarl_algos import load_run
from animarl_algos.evaluation.statistics import Interval
from animarl_algos.recipes.registry import named_recipe
from animarl_algos.report.words import with_interval
from animarl_algos.runs import pipeline
from animarl_algos.runs.permuted import permuted_runs
from animarl_algos.runs.run import Run, method_name
from animarl_algos.runs.run_files import versions
from animarl_algos.runs.run_settings import RunSettings, pipeline_settings
from animarl_algos.whatif.answer import ask
from animarl_algos.whatif.answer_page import save_answers
from animarl_algos.whatif.truth import RECORDINGS, RecordedConditions, TeamTruth, find_truth
from animarl_envs import environment_id
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.joining import join
from animarl_envs.demos.packaged import load_packaged
from animarl_envs.drawing import markdown_table
from animarl_envs.files import all_files_or_none
from animarl_envs.fitting.result import LocomotionFit, fit_locomotion
from animarl_envs.importing.readers import load_readers, read
from animarl_envs.scenario import PACKAGED

DATA = Path(os.environ.get("ANIMARL_DATA", Path(__file__).parents[2] / "shared" / "data"))
FOLDER = DATA / "agents_collab_hunting"
FILES = ("episodes_c2ae_indiv_slow2.4.npz", "episodes_c2ae_share_slow2.4.npz")
ALGOS = ("dqcil-pt", "dqdil-pt", "bc", "soft-bc")
SPECIES = "agent"
TINY = {"offline_epochs": 1, "policy_kwargs": {"hidden": 32}}
PATH = "path length"
PROBE_STEPS = (4000, 12_000)  # both beyond the first updates; what differs is learning as usual


def recorded(tiny: bool = False) -> Demonstrations:
    """Both conditions of the recorded agents, with the splits of their reader."""
    load_readers(Path(__file__).with_name("paper_readers.py"))
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
    permutations: Annotated[
        int,
        typer.Option(min=0, help="Networks of permuted conditions per learner: the null."),
    ] = 0,
    tiny: Annotated[bool, typer.Option(help="Few episodes, one epoch: only to try it.")] = False,
    estimated: Annotated[
        bool, typer.Option("--estimate", help="Say how long the whole takes, and stop.")
    ] = False,
    cells: Annotated[Path, typer.Option(help="Run folders and pages.")] = Path(
        "out/counterfactual"
    ),
    out: Annotated[Path, typer.Option(help="The tables.")] = Path("docs/results/counterfactual"),
) -> None:
    """Train every cell, then ask all of them."""
    torch.set_num_threads(1)
    console = Console(width=128)
    seeds, learners, truth = seed or [0, 1, 2], only or ALGOS, RECORDINGS
    if species == SPECIES:
        if not FOLDER.is_dir():
            raise typer.BadParameter(f"the recorded agents are not in {DATA}: set ANIMARL_DATA")
        demos, truth = recorded(tiny), str(FOLDER / "weights")
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
    table = shifts(cells, species, learners, seeds, truth, repetitions, permutations)
    text = markdown(table, load_run(cells / f"{species}-{learners[0]}-{seeds[0]}"))
    with all_files_or_none(out) as part:
        (part / "README.md").write_text(text)
        table.to_csv(part / "counterfactual.csv", index=False, float_format="%.6g")
    console.print(text, markup=False, highlight=False, soft_wrap=True)


def shifts(
    cells: Path,
    species: str,
    learners: Sequence[str],
    seeds: Sequence[int],
    truth: str,
    repetitions: int,
    permutations: int,
) -> pd.DataFrame:
    """Return what every learner predicts beside the truth: the table of what-if, by ``method``.

    Each learner also gets a folder with tables, figures and the page.
    """
    parts = []
    for algo in learners:
        runs = [load_run(cells / f"{species}-{algo}-{seed}") for seed in seeds]
        nulls: list[Run] = []
        if permutations:
            folder = cells / f"{species}-{algo}-permuted"
            nulls = permuted_runs(runs[0], folder, permutations)
        found = ask(
            runs,
            [f"condition={name}" for name in runs[0].species.conditions],
            repetitions=repetitions,
            separately=True,
            permuted=nulls,
            truth=find_truth(truth, runs[0], repetitions),
        )
        save_answers(found, cells / f"{species}-{algo}-page")
        table = found.table.assign(seeds=len(runs))
        table.insert(0, "method", method_name(algo))
        parts.append(table)
    return pd.concat(parts, ignore_index=True)


def markdown(table: pd.DataFrame, run: Run) -> str:
    """Return the shifts of the path length with their truth, as a page."""
    agents = run.species.name == SPECIES
    source = (TeamTruth if agents else RecordedConditions).description
    who = "recorded agents" if agents else f"packaged {run.species.name} (synthetic)"
    rows = [
        (
            row["method"], row["scenario"].partition("=")[2], str(row["seeds"]),
            *(_with_interval(row, key) for key in ("shift", "true", "miss")),
            "" if np.isnan(row["p"]) else f"{row['p']:.2g}", row["judged"],
        )
        for row in table[table["quantity"] == PATH].to_dict("records")
    ]  # fmt: skip
    columns = ("method", "told", "seeds", "predicted shift", "true shift", "predicted - true", "p",
               "the shift is")  # fmt: skip
    return "\n".join(
        [
            f"# Counterfactuals: the {who}",
            "",
            f"    {shlex.join(['python', *sys.argv])}",
            "",
            f"{', '.join(f'{name} {number}' for name, number in versions().items())}.",
            "",
            f"Mean path length [{table.loc[table['quantity'] == PATH, 'unit'].iloc[0]}], 95 % "
            f"intervals, from starts of the other condition. {source}",
            "",
            markdown_table(columns, rows),
            "",
        ]
    )


def _with_interval(row: dict[Any, Any], key: str) -> str:
    ends = ("low", "high") if key == "shift" else (f"{key}_low", f"{key}_high")
    return with_interval(Interval(row[key], *(row[end] for end in ends)))


if __name__ == "__main__":
    typer.run(main)
