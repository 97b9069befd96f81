"""What the benchmark costs, on this machine and on others: ``python benchmarks/scale.py``.

First slopes are measured, in processor seconds of short trainings on one thread: how the cost grows
with updates, width, episodes and individuals, and what a world step and an epoch cost each recipe.
Then the whole matrix of a preset is simulated with these on workers that take one cell after the
other, as the runner does it.

python benchmarks/scale.py --slopes --rates --simulate --species agent --out out/scale
python benchmarks/scale.py --simulate --costs out/bench/costs.csv
"""

from __future__ import annotations

import argparse
import csv
import heapq
import json
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from animarl_algos.benchmark.matrix import Plan, plan, read_matrix
from animarl_algos.benchmark.pieces import Cell
from animarl_algos.recipes.registry import named_recipe
from animarl_algos.runs import pipeline
from animarl_algos.runs.run_files import write_json
from animarl_algos.runs.run_settings import RunSettings
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.packaged import load_packaged
from animarl_envs.fitting.result import fit_locomotion

STEPS = 600  # of the world, at least, and three times as many: the difference is the slope
EPOCHS = (1, 2)
FIXED: dict[str, Any] = {"thrusts": "1", "acting": "boltzmann:1"}
MACHINES = {"2 cores": 2, "workstation, 16 cores": 16, "cluster, 100 nodes of 16 cores": 1600}
START = 4.2  # a worker's start [s], see benchmarks/runner.py


# -- slopes ---------------------------------------------------------------------------------------


def training_time(settings: RunSettings, demos: Demonstrations, fit: Any) -> float:
    """Processor seconds of one training, its environment and data included."""
    with tempfile.TemporaryDirectory() as folder:
        run = pipeline.open_run(settings, Path(folder) / "run", "benchmarks/scale.py", demos)
        fit.save(run.path / "locomotion.json")
        begun = time.process_time()
        pipeline.learn(run, settings.algo, progress_bar=False)
        return time.process_time() - begun


def cloning(demos: Demonstrations, updates: int = 40, **changed: Any) -> RunSettings:
    """A short soft-bc of the preset's own size; ``changed`` goes over it."""
    matrix = read_matrix("short")
    asked = matrix.run_settings(demos.species, demos, "soft-bc", 0)
    offline = {"updates_per_epoch": updates, "warm_up": 1}
    over = {"offline_epochs": 1, "offline_kwargs": offline} | changed
    return asked.changed(overrides=over, **FIXED)


def growth(species: str) -> Iterator[tuple[str, list[tuple[float, float]]]]:
    """Processor seconds of a short clone beside what was varied."""
    demos = load_packaged(species)
    fit = fit_locomotion(demos, bootstrap=0)
    training_time(cloning(demos), demos, fit)  # compiles

    def seconds(settings: RunSettings, on: Demonstrations = demos, of: Any = fit) -> float:
        return min(training_time(settings, on, of) for _ in range(2))

    yield "updates", [(n, seconds(cloning(demos, n))) for n in (20, 40, 80, 160)]
    widths = (64, 128, 256, 512)
    yield "width", [(w, seconds(cloning(demos, policy_kwargs={"hidden": w}))) for w in widths]
    train = np.flatnonzero(demos.split == "train")
    rest = np.flatnonzero(demos.split != "train")
    some = []
    for share in (0.25, 0.5, 1.0):
        kept = demos.select(episodes=np.sort(np.r_[train[: int(share * len(train))], rest]))
        some.append((float(len(train) * share), seconds(cloning(kept, 5), kept)))
    yield "training episodes, 5 updates", some
    if demos.num_individuals == 3:
        one = {"num_pursuers": 1}
        asked = cloning(demos, env_kwargs=one)
        first = replace(fit, individuals=(fit.individuals[0], fit.individuals[2]))
        yield "individuals", [(2, seconds(asked, of=first)), (3, seconds(cloning(demos)))]


def rates(cells: Mapping[str, Cell], say: Callable[[str], None]) -> dict[str, dict[str, float]]:
    """Of each recipe of one species: seconds at the smallest size, per step, and per epoch."""
    found = {}
    first = next(iter(cells.values()))
    demos = load_packaged(first.data)
    fit = fit_locomotion(demos, bootstrap=0)
    for algo, cell in cells.items():
        assert cell.settings is not None
        recipe = named_recipe(algo).algorithm.recipe
        over = dict(cell.settings.overrides)
        offline = cell.settings.learner().arguments.get("offline_epochs", 0) > 0
        small = over | ({"offline_epochs": EPOCHS[0]} if offline else {})
        steps = few_steps(cell.settings) if recipe.online else (1, 1)
        base = cell.settings.changed(steps=steps[0], overrides=small, **FIXED)
        least = min(training_time(base, demos, fit) for _ in range(2))  # the first may compile
        per_step = per_epoch = 0.0
        if recipe.online:
            more = training_time(base.changed(steps=steps[1]), demos, fit)
            per_step = max(0.0, more - least) / (steps[1] - steps[0])
        if offline:
            twice = base.changed(overrides=over | {"offline_epochs": EPOCHS[1]})
            per_epoch = max(0.0, training_time(twice, demos, fit) - least)
        found[algo] = {
            "least": least,
            "steps": steps[0],
            "per_step": per_step,
            "per_epoch": per_epoch,
        }
        say(f"| {first.data} | {algo} | {least:.2f} | {1000 * per_step:.3f} | {per_epoch:.2f} |")
    return found


def few_steps(settings: RunSettings) -> tuple[int, int]:
    """Two sizes of a training, in whole rounds where it goes by rounds."""
    learner = settings.learner()
    every, unit = learner.settings.train_freq
    one = 1 if unit == "episode" else every * learner.n_envs
    least = -(-STEPS // one) * one
    return least, 3 * least


# -- simulation -----------------------------------------------------------------------------------


def projected(cell: Cell, rate: Mapping[str, float], around: float) -> float:
    """Processor seconds of a cell; ``around`` the training: choosing how to act, rolling out."""
    assert cell.settings is not None
    epochs = cell.settings.learner().arguments.get("offline_epochs", 0)
    steps = max(0, cell.settings.steps - rate["steps"]) if rate["per_step"] else 0
    return (
        rate["least"] + rate["per_step"] * steps
        + rate["per_epoch"] * max(0, epochs - EPOCHS[0]) + around
    )  # fmt: skip


def makespan(seconds: list[float], workers: int) -> float:
    """Wall time of cells that are taken in their order by whoever is free."""
    free = [START] * min(workers, len(seconds))
    heapq.heapify(free)
    for cost in seconds:
        heapq.heappush(free, heapq.heappop(free) + cost)
    return max(free)


def simulate(preset: str, found: Mapping[str, Any]) -> Iterator[str]:
    """The trained cells of those species of a preset whose rates were measured."""
    measured = found["rates"][preset]
    asked: Plan = plan(read_matrix(preset))
    costs = [
        projected(cell, measured[cell.data][cell.method], found["around"][cell.data])
        for cell in asked.cells
        if cell.settings is not None and cell.method in measured.get(cell.data, {})
    ]
    return on_machines(f"{preset} ({', '.join(measured)})", costs)


def on_machines(what: str, costs: list[float]) -> Iterator[str]:
    """One row per machine: cells of so many processor seconds."""
    total, longest = sum(costs), max(costs)
    for name, workers in MACHINES.items():
        wall = makespan(costs, workers)
        busy = total / (wall * min(workers, len(costs)))
        yield (
            f"| {what} | {len(costs)} | {total / 60:.1f} | {name} | {wall / 60:.1f} | "
            f"{longest / 60:.2f} | {busy:.0%} |"
        )


def around_training(cell: Cell, out: Path) -> float:
    """Processor seconds of a default cell beside its training: a cell with next to none of it."""
    assert cell.settings is not None
    settings = cell.settings.changed(overrides=cloning(load_packaged(cell.data), 5).overrides)
    demos = load_packaged(cell.data)
    run = pipeline.open_run(settings, out / cell.data, "benchmarks/scale.py", demos)
    pipeline.fit(run)
    begun = time.process_time()
    model = pipeline.learn(run, settings.algo, progress_bar=False)
    cue = "actual" if model.layout.condition_flag else None
    run.roll_out(model, settings.algo, cue)
    return time.process_time() - begun


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--slopes", action="store_true")
    parser.add_argument("--rates", action="store_true")
    parser.add_argument("--simulate", action="store_true")
    parser.add_argument("--costs", type=Path, help="simulate also the cells of a costs.csv")
    parser.add_argument("--species", action="append", help="by default all packaged")
    parser.add_argument("--preset", action="append", help="by default short and paper")
    parser.add_argument("--out", type=Path, default=Path("out/scale"))
    given = parser.parse_args()
    torch.set_num_threads(1)
    file = given.out / "scale.json"
    found: dict[str, Any] = {"slopes": {}, "rates": {}, "around": {}}
    if file.exists():
        found = json.loads(file.read_text())
    names = given.species or list(read_matrix("short").species)
    if given.slopes:
        print("| species | varied | at | processor seconds | exponent |\n|---|---|---|---|---|")
        for species in names:
            for varied, pairs in growth(species):
                x, y = np.log([p[0] for p in pairs]), np.log([p[1] for p in pairs])
                exponent = float(np.polyfit(x, y, 1)[0])
                at, took = (", ".join(f"{p[i]:.3g}" for p in pairs) for i in (0, 1))
                print(f"| {species} | {varied} | {at} | {took} | {exponent:.2f} |", flush=True)
                found["slopes"].setdefault(species, {})[varied] = pairs
        write_json(file, found)
    if given.rates:
        print(
            "| species | recipe | smallest (s) | ms per step | s per epoch |\n|---|---|---|---|---|"
        )
        for preset in given.preset or ["short", "paper"]:
            for species in names:
                seed = read_matrix(preset).seeds[0]
                cells = {
                    c.method: c for c in plan(read_matrix(preset)).cells
                    if c.data == species and c.seed == seed and c.settings is not None
                }  # fmt: skip
                found["rates"].setdefault(preset, {})[species] = rates(
                    cells, lambda line: print(line, flush=True)
                )
                if species not in found["around"]:
                    clone = plan(read_matrix("short")).only([f"{species}/soft-bc/0"]).cells[0]
                    with tempfile.TemporaryDirectory() as folder:
                        found["around"][species] = around_training(clone, Path(folder))
                    print(f"{species}: {found['around'][species]:.1f} s around a training")
                write_json(file, found)
    if given.simulate:
        print(
            "| cells of | number | processor minutes | machine | minutes | longest cell | busy |\n"
            "|---|---|---|---|---|---|---|"
        )
        if given.costs is not None:
            with given.costs.open(encoding="utf-8") as lines:
                measured = [float(row["processor_seconds"]) for row in csv.DictReader(lines)]
            for line in on_machines(str(given.costs), measured):
                print(line)
        for preset in given.preset or ["short", "paper"]:
            if preset in found["rates"]:
                for line in simulate(preset, found):
                    print(line)


if __name__ == "__main__":
    main()
