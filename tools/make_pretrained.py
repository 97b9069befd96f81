"""The trained models that come with the package: ``python -m tools.make_pretrained``.

The recipes of the benchmark's preset ``short`` are trained on the packaged demonstrations with its
seeds (what is finished in ``--out`` is kept). For each species the cell whose rollouts from
validation starts are most like the validation recordings is evaluated on the test split and
exported. ``--living SET`` does the same with runs of published recordings (``animarl data get``),
whose tracks stay out of the model. ``--judge`` trains nothing: it evaluates the models of packaged
demonstrations that are there once more and writes their cards anew.
"""

from __future__ import annotations

import argparse
import json
import shlex
import shutil
import subprocess
import sys
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from animarl_algos.benchmark.matrix import claim_folder, plan, read_matrix
from animarl_algos.benchmark.pieces import Cell, perform_all
from animarl_algos.evaluation.collect import collect_rollouts
from animarl_algos.evaluation.prepared import Prepared
from animarl_algos.evaluation.realism import Likelihood
from animarl_algos.runs.pipeline import evaluate_run
from animarl_algos.runs.pretrained import FOLDER, METRICS, export_run
from animarl_algos.runs.run import Run
from animarl_envs.demos.packaged import packaged_names
from animarl_envs.errors import InputError
from animarl_envs.worlds import make_world

PRESET = "short"
REPETITIONS = 5


def validation_mismatch(run: Run) -> float:
    """How unlikely the validation recordings are under rollouts from their starts."""
    algo = run.settings.algo
    model = run.trained(algo)
    model.policy.seed(run.settings.seed)
    rollouts = collect_rollouts(
        partial(make_world, run.starting_from("val")),
        model,
        method=algo,
        seed=run.settings.seed,
        repetitions=REPETITIONS,
        cue="actual" if model.layout.condition_flag else None,
    )
    realism = Likelihood.of(Prepared(run.demos.select(split="val")))
    return -float(np.nanmean(realism.total(realism.components(rollouts))))


def make(
    out: Path, names: Sequence[str], recipes: Sequence[str], seeds: Sequence[int], processes: int
) -> None:
    """Train, choose, evaluate and export one model for each species."""
    wanted = [f"{name}/{r}/{seed}" for name in names for r in recipes for seed in seeds]
    asked = plan(read_matrix(PRESET)).only(wanted)
    claim_folder(out)
    failed = []
    for piece, error in perform_all(asked.stages, out, processes):
        print(f"{piece.name}: {error or 'finished'}", flush=True)
        failed += [error] if error else []
    if failed:
        raise InputError(failed[0])
    by_species: dict[str, list[Cell]] = {}
    for cell in asked.cells:
        by_species.setdefault(cell.data, []).append(cell)
    for species, cells in by_species.items():
        runs = {f"{c.method}, seed {c.seed}": Run(c.folder(out) / "run") for c in cells}
        given = [f"--species {species}", *(f"--recipe {recipe}" for recipe in recipes)]
        export_best(species, runs, [*given, *(f"--seed {seed}" for seed in seeds)])


def make_living(
    out: Path, names: Sequence[str], seeds: Sequence[int], settings: Sequence[str], processes: int
) -> None:
    """Run published sets, and export for each the model of one seed, without recorded tracks."""
    for name in names:
        runs = {f"seed {seed}": Run(out / f"{name}-{seed}") for seed in seeds}
        for seed, run in zip(seeds, runs.values()):
            words = ["run", name, "--seed", seed, "--out", run.path, "--processes", processes]
            words += [f"--set={one}" for one in settings]
            command = [sys.executable, "-m", "animarl_algos.cli.main", *map(str, words)]
            subprocess.run(command, check=True)
        given = [f"--living {name}", *(f"--seed {seed}" for seed in seeds)]
        given += [f"--set {shlex.quote(one)}" for one in settings]
        export_best(name, runs, given, simulated=True)


def export_best(
    name: str, runs: Mapping[str, Run], given: Sequence[str], *, simulated: bool = False
) -> None:
    """Evaluate and export the run whose rollouts are most like the validation recordings."""
    chosen = {label: validation_mismatch(run) for label, run in runs.items()}
    best = runs[min(chosen, key=lambda label: chosen[label])]
    print(name, ", ".join(f"{label}: {value:.3f}" for label, value in chosen.items()))
    if not simulated:  # which ``animarl run`` evaluated
        evaluate_run(best)
    command = " ".join(["python -m tools.make_pretrained", *given])
    shutil.rmtree(FOLDER / name, ignore_errors=True)
    export_run(best, FOLDER / name, simulated=simulated, made_by=command, chosen=chosen)


def judge(names: Sequence[str]) -> None:
    """Evaluate packaged models on the test split and write their cards and metrics anew."""
    for species in names:
        model = FOLDER / species
        chosen = json.loads((model / METRICS).read_text())["chosen_by_validation"]
        with TemporaryDirectory() as place:
            run = Run(Path(shutil.copytree(model, Path(place) / species)))
            print(species, evaluate_run(run).verdict.headline, flush=True)
            export_run(run, model, chosen=chosen)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    by_default, preset = f"by default all of preset {PRESET}", read_matrix(PRESET)
    parser.add_argument("--out", type=Path, default=Path("out/bench-short"), help="keeps runs")
    parser.add_argument("--species", action="append", help="by default all packaged; repeatable")
    parser.add_argument("--living", action="append", help="a published set; repeatable")
    parser.add_argument("--set", action="append", default=[], help="of --living; repeatable")
    parser.add_argument("--recipe", action="append", help=f"{by_default}; repeatable")
    parser.add_argument("--seed", action="append", type=int, help=f"{by_default}; repeatable")
    parser.add_argument("--processes", type=int, default=1)
    parser.add_argument("--judge", action="store_true", help="only evaluate them once more")
    given = parser.parse_args()
    if given.judge:
        own = {file.parent.name for file in FOLDER.glob(f"*/{METRICS}")} & {*packaged_names()}
        return judge(given.species or sorted(own))
    if given.living:
        seeds = given.seed or [0]
        return make_living(given.out, given.living, seeds, given.set, given.processes)
    names = given.species or packaged_names()
    recipes, seeds = given.recipe or preset.recipes, given.seed or preset.seeds
    make(given.out, names, recipes, seeds, given.processes)


if __name__ == "__main__":
    main()
