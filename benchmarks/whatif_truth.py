"""What-if answers beside their truth: what made the recordings, in the changed world.

    python benchmarks/whatif_truth.py --quick
    python benchmarks/whatif_truth.py --out docs/results/whatif
    python benchmarks/whatif_truth.py --only agent --seed 0
    python benchmarks/whatif_truth.py --only newt --change female.thrust=x2 --planning
    python benchmarks/whatif_truth.py --only agent --method my_module:make --out out/mine
    python benchmarks/whatif_truth.py --only larvae --out docs/results/whatif
    python benchmarks/whatif_truth.py --only recorded-agents --seed 0 --permutations 20

A clone is asked with ``animarl whatif``'s code. The truth is known where a program or a trained
team made the recordings: the packaged agents (their teams), flies and newts (their courtship),
moths (their search), and the published artificial agents, if $ANIMARL_DATA has them. What made
them acts in the changed world and perceives it as the clone does, by habit or knowing its new body.
``--method`` enters somebody else's simulator, made as for ``animarl benchmark``, in the clone's
place. With ``--planning`` flies, newts and moths choose their pushes with their new thrust, but
keep the speeds that they want: a third truth, beside what clones answer by habit.

As ``animarl whatif`` does, a second simulator with other inputs, of the first training seed, is
asked the same of every changed world (``second_shift``; not with ``--quick`` and ``--method``).

One row is one quantity of one change. ``miss`` is predicted minus true, paired by start, with an
interval over starts and training seeds. An answer counts as wrong where its miss is clear of zero
and larger than half of the true shift. Rows whose true shift is not clear of zero have no sign and
no relative error. Clones are trained on training and validation episodes, and both sides start from
test episodes; the thresholds of the warning were chosen elsewhere.

``larvae`` is a treatment of real animals, fed against protein-deprived. Half of the animals of each
group are kept aside. A clone of the others is told the other condition from starts of those kept
aside, and the shift stands beside the true difference of these. The null is the shift of clones
that learned from permuted conditions.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pandas as pd
import typer
from rich.console import Console
from rich.table import Table

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # for benchmarks and tools

from animarl_algos import load_run
from animarl_algos.benchmark.methods import (
    CheckedPolicy,
    MethodSetting,
    ProgrammedPolicy,
    errors_as_input_errors,
    load_factory,
)
from animarl_algos.evaluation import Rollouts, collect_rollouts
from animarl_algos.evaluation.teams import teams_of
from animarl_algos.runs.permuted import permuted_runs, second_run
from animarl_algos.runs.run import Run
from animarl_algos.whatif.absent import Present
from animarl_algos.whatif.answer import Answer, ask
from animarl_algos.whatif.changes import ChangedWorld, parse_scenarios
from animarl_algos.whatif.quantities import quantities_of
from animarl_algos.whatif.shifts import FALLS, RISES, judge, mean_over_starts, share_as_large
from animarl_algos.whatif.truth import SimulatedTruth, TeamTruth, Truth, mean_by_start
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.joining import join
from animarl_envs.demos.summary import unit_of
from animarl_envs.importing.readers import load_readers, read
from animarl_envs.scenario import make_scenario
from animarl_envs.species import SPECIES, SearchSpecies, Species
from animarl_envs.species.base import Reading
from animarl_envs.species.options import change_world
from animarl_envs.worlds import make_world
from benchmarks.true_programs import Courtship
from benchmarks.whatif_bars import RECORDED, bars, held_out_rules, page, summary, warned

DATA = Path(os.environ.get("ANIMARL_DATA", Path(__file__).parents[2] / "shared" / "data"))
LARVAE = "larvae"
FOOD = ("fed", "deprived")
ANIMARL = (sys.executable, "-m", "animarl_algos.cli.main")
TRUE_REPETITIONS = 10
WRONG = 0.5  # of the true shift
BESIDE = ("second_shift", "second_low", "second_high", "second_gap")  # not of every change

# From mild to absurd; ``inside`` are those whose inputs stay near what was recorded.
COURTSHIP = (
    "female.thrust=x0.8", "female.thrust=x1.2", "female.thrust=x2", "males.thrust=x0.8",
    "males.thrust=x1.2", "males.thrust=x2", "arena=x0.8", "arena=x1.2", "arena=x3",
    "contact=x0.5", "contact=x0.7", "contact=x1.5", "all.damping=x2", "remove=male_1",
    "start=uniform",
)  # fmt: skip
CHASE = (
    "prey.thrust=x0.8", "prey.thrust=x1.2", "prey.thrust=x2", "predators.thrust=x0.8",
    "predators.thrust=x1.2", "predators.thrust=x2", "arena=x0.8", "arena=x1.2", "arena=x3",
    "contact=x0.5", "contact=x0.7", "contact=x1.5", "all.damping=x2", "condition=individual",
    "condition=shared", "start=uniform",
)  # fmt: skip
SEARCH = (
    "moth.thrust=x0.8", "moth.thrust=x1.2", "moth.thrust=x2", "contact=x0.5", "contact=x2",
    "antenna_radius=x2", "antenna_radius=x5", "moth.damping=x2", "plume=off", "plume=continuous",
    "wind=x0.5", "wind=x1.5", "odour=x0.5", "odour=x2",
)  # fmt: skip
CHANGES = {
    "agent": CHASE, "fly": COURTSHIP, "newt": COURTSHIP, "silkmoth": SEARCH, RECORDED: CHASE,
}  # fmt: skip
QUICK = {"agent": ("prey.thrust=x1.2", "contact=x0.7", "arena=x3"), "fly": ("female.thrust=x1.2",)}


@dataclass(frozen=True, eq=False)
class Answered:
    """One change of one set, its truth, and both in the unchanged world."""

    reading: Reading
    answer: Answer
    baseline: Rollouts
    usual: Rollouts


class ProgramTruth(SimulatedTruth):
    """The program that made the recordings of a run, in any world."""

    description = "The true shift is that of the program that made the recordings."

    def __init__(self, run: Run, repetitions: int, planning: bool = False) -> None:
        self.test, self.planning = run.demos.select(split="test"), planning
        self.unit, self.repetitions = unit_of(run.demos), repetitions
        self.species: Species = SPECIES[run.species.name]

    def check(self, scenario: ChangedWorld) -> None:
        """Accept every change."""

    def simulate(self, scenario: ChangedWorld, reading: Reading) -> Rollouts:
        """Return what the program does from the test starts in one world."""
        species = change_world(self.species, reading, **scenario.options(self.species, self.unit))
        test = scenario.move_starts(self.test, species)
        if scenario.removed:
            left = Present.without(species, scenario.removed)
            species, test = left.species, test.of_individuals(left.own)
        return self._program(species, test, 0)

    def _program(self, species: Species, test: Demonstrations, seed: int) -> Rollouts:
        world = make_scenario(species, demos=test, split=None)
        policy: Any
        if isinstance(species, SearchSpecies):
            plans_with = species if self.planning else self.species
            assert isinstance(plans_with, SearchSpecies)
            policy, make = ProgrammedPolicy(plans_with, seed), partial(make_world, world)
        else:
            policy = Courtship(world, seed, species.locomotion if self.planning else None)
            make = policy.make_world
        return collect_rollouts(
            make, policy, method="truth", seed=seed, repetitions=self.repetitions
        )


def trained_runs(name: str, seeds: list[int], cells: Path, settings: list[str]) -> list[Run]:
    """Train a clone for each seed by the command line, unless its folder is there already."""
    runs = []
    for seed in seeds:
        folder = cells / f"{name}-{seed}"
        if not (folder / "policies").exists():
            what = ["packaged", "--species", name]
            if name == LARVAE:
                what = [str(halved_larvae(cells))]
            if name == RECORDED:
                what = [str(cells / f"{name}.npz")]
                cells.mkdir(parents=True, exist_ok=True)
                recorded_agents().save(what[0])
            command = [*ANIMARL, "train", *what, "--seed", str(seed), "--out", str(folder)]
            command += [part for one in settings for part in ("--set", one)]
            subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
        runs.append(load_run(folder))
    return runs


def recorded_agents() -> Demonstrations:
    """Return both conditions of the published agents, with the splits of their reader."""
    load_readers(Path(__file__).with_name("paper_readers.py"))
    files = sorted((DATA / "agents_collab_hunting").glob("episodes_*.npz"))
    return join([read(file, "agents") for file in files], "recorded agents")


def entered_run(name: str, method: str, seed: int) -> Run:
    """Return a packaged world in which somebody else's method (``module:factory``) acts.

    Raises
    ------
    InputError
        If there is no such factory, or it raises.
    """
    run, factory = load_run(name), load_factory(method)
    with errors_as_input_errors(f"method {method}: its factory raised"):
        made = factory(MethodSetting.of(run, seed))
    entered = CheckedPolicy(method, made, run.species.num_actions)
    vars(entered)["layout"] = run.policy.layout  # whether it is told conditions, as the clone is
    vars(run)["policy"] = entered
    return run


def halved_larvae(cells: Path) -> Path:
    """Import fed and deprived larvae, with half of each group kept aside as test episodes."""
    file, everybody = cells / "larvae.npz", cells / "all-larvae.npz"
    if not file.exists():
        tables = sorted(map(str, (DATA / "larvae_fed_deprived").glob("*.csv.gz")))
        pattern = f"(?P<condition>{'|'.join(FOOD)})"
        command = [*ANIMARL, "import", *tables, "--target", "none", "--name-pattern", pattern]
        subprocess.run([*command, "--out", str(everybody)], check=True, stdout=subprocess.DEVNULL)
        demos, rng = Demonstrations.load(everybody), np.random.default_rng(0)
        split = demos.split.copy()
        for condition in (0, 1):
            test, rest = np.array_split(
                rng.permutation(np.flatnonzero(demos.condition == condition)), 2
            )
            split[test], split[rest], split[rest[::10]] = "test", "train", "val"
        replace(demos, split=split).save(file)
    return file


def permuted(name: str, run: Run, cells: Path, count: int) -> list[Run]:
    """Return clones of a set that learned from permuted conditions."""
    folder = cells / f"{name}-permuted"
    return permuted_runs(run, folder, count, lambda done: print(f"permuted: {done}", flush=True))


def false_claims(name: str, nulls: list[Run], repetitions: int) -> pd.DataFrame:
    """Return how many clones of permuted conditions claim a shift: ``set, told, quantity, ...``.

    ``by rollouts`` counts intervals over rollouts that are clear of zero, ``by the null`` findings
    of ``animarl whatif --permutations``, each clone beside the others. The last row of each
    condition counts clones that claim anything.
    """
    changes = [f"condition={one}" for one in nulls[0].scenario.species.conditions]
    tables = [
        ask([one], changes, repetitions=repetitions, separately=True, family=False).table.set_index(
            ["scenario", "quantity"]
        )
        for one in nulls
    ]
    found = []
    for told, of_one in tables[0].groupby(level="scenario", sort=False):
        quantities = of_one.index.get_level_values("quantity")
        shifts = np.array([table.loc[told, "shift"] for table in tables])
        claims = np.zeros((2, *shifts.shape), dtype=bool)
        for k, table in enumerate(tables):
            by_chance = share_as_large(shifts[k], np.delete(shifts, k, axis=0))
            for column, row in enumerate(table.loc[told].to_dict("records")):
                beside = {**row, "p": by_chance[column]}
                claims[0, k, column] = row["low"] > 0 or row["high"] < 0
                claims[1, k, column] = judge(beside, of_a_cue=True) in (RISES, FALLS)
        for quantity, counts in [
            *zip(quantities, claims.sum(axis=1).T, strict=True),
            ("any of them", claims.any(axis=2).sum(axis=1)),
        ]:
            found.append(
                {"set": name, "told": str(told).partition("=")[2], "quantity": quantity,
                 "clones": len(nulls), "by rollouts": counts[0], "by the null": counts[1]}
            )  # fmt: skip
    return pd.DataFrame(found)


def larvae(runs: list[Run], nulls: list[Run]) -> pd.DataFrame:
    """Return the shift of a flipped cue beside the difference of animals kept aside [% of it]."""
    changes, permutations = [f"condition={name}" for name in FOOD], len(nulls)
    found = ask(runs, changes, repetitions=1, separately=True, permuted=nulls)
    (speed,) = quantities_of(runs[0].scenario.species, unit_of(runs[0].demos))
    names = runs[0].scenario.species.conditions
    parts = []
    for told, answer in zip(FOOD, found.answers, strict=True):
        (row,) = answer.table.to_dict("records")
        part = {"told": told, "seeds": len(runs), "permutations": permutations}
        for key in ("shift", "low", "high", "null_low", "null_high"):
            part[key] = 100 * row[key] / row["baseline"]
        part["p"] = row["p"]
        for where in ("test", "train"):
            demos = runs[0].demos.select(split=where)
            values = speed.values(Rollouts.from_demonstrations(demos))
            groups = [
                values[(demos.condition == names.index(told)) == own] for own in (True, False)
            ]
            true = np.mean(groups[0]) - np.mean(groups[1])
            error = np.sqrt(sum(np.var(one, ddof=1) / len(one) for one in groups))
            for key, value in (
                ("", true),
                ("_low", true - 1.96 * error),
                ("_high", true + 1.96 * error),
            ):
                part[f"true_{where}{key}"] = 100 * value / np.mean(groups[1])
        parts.append(part)
    return pd.DataFrame(parts)


def truth_of(run: Run, folder: Path | None, repetitions: int, planning: bool = False) -> Truth:
    """Return the teams that made the recordings of a run, or else their program."""
    if folder is not None or teams_of(run.demos) is not None:
        return TeamTruth(run, folder, repetitions)
    return ProgramTruth(run, repetitions, planning)


def answered(
    runs: list[Run],
    changes: tuple[str, ...],
    repetitions: int,
    truth_folder: Path | None,
    planning: bool = False,
    second: Run | None = None,
) -> Iterator[Answered]:
    """Ask the clones and what made their recordings; changes of bodies in both readings.

    A ``second`` simulator is asked too.
    """
    truth = truth_of(runs[0], truth_folder, max(repetitions, TRUE_REPETITIONS), planning)
    readings: tuple[Reading, ...] = ("habit",) if planning else ("habit", "knows")
    for reading in readings:
        scenarios = parse_scenarios(changes, runs[0].scenario.species, separately=True)
        asked = [s for s in scenarios if reading == "habit" or s.moves_bodies]
        if not asked:
            continue
        texts = [scenario.name for scenario in asked]
        found = ask(
            runs, texts, repetitions=repetitions, reading=reading, separately=True, family=False,
            truth=truth, second=second,
        )  # fmt: skip
        usual = truth.roll_out(ChangedWorld(()), reading)[0]
        for answer in found.answers:
            yield Answered(reading, answer, found.baseline, usual)


def rows(name: str, runs: list[Run], one: Answered) -> Iterator[dict[str, Any]]:
    """One row per quantity of a change."""
    species, test = runs[0].scenario.species, runs[0].demos.select(split="test")
    scenario, counts = one.answer.scenario, np.ones(len(test), dtype=bool)
    if scenario.condition is not None:
        counts = test.condition != species.conditions.index(scenario.condition)
    measures = {q.name: q.values for q in quantities_of(species, unit_of(runs[0].demos))}
    for row in one.answer.table.to_dict("records"):
        values, demo = measures[row["quantity"]], one.baseline.demo
        usual = mean_by_start(one.usual, values(one.usual), len(test))
        gap = mean_over_starts(
            values(one.baseline) - usual[demo], demo, runs=len(runs), test=test,
            rng=np.random.default_rng(0), counts=counts[demo],
        )  # fmt: skip
        clear = row["true_low"] > 0 or row["true_high"] < 0
        missed = row["miss_low"] > 0 or row["miss_high"] < 0
        yield {
            "set": name, "change": scenario.name, "reading": one.reading,
            "quantity": row["quantity"], "unit": row["unit"], "seeds": len(runs),
            **{key: row[key] for key in ("true", "true_low", "true_high")},
            "predicted": row["shift"], "low": row["low"], "high": row["high"],
            **{key: row[key] for key in ("miss", "miss_low", "miss_high")},
            "gap": gap.estimate, "gap_low": gap.low, "gap_high": gap.high,
            **{key: row[key] for key in ("seeds_low", "seeds_high", "other_reading", "beyond")},
            **{key: row.get(key, np.nan) for key in BESIDE},
            "clear": clear, "covered": not missed,
            "sign_right": bool(row["shift"] * row["true"] > 0) if clear else None,
            "wrong": missed and abs(row["miss"]) > WRONG * abs(row["true"]),
            "warning": row["warning"],
        }  # fmt: skip


def main(
    only: Annotated[list[str] | None, typer.Option(help="Sets; repeatable.")] = None,
    seed: Annotated[list[int] | None, typer.Option(help="Training seeds; repeatable.")] = None,
    cells: Annotated[Path, typer.Option(help="Run folders, made once.")] = Path("out/whatif"),
    repetitions: Annotated[int, typer.Option(help="Rollouts a start and run.")] = 5,
    quick: Annotated[
        bool, typer.Option("--quick", help="Packaged models, few changes, nothing trained.")
    ] = False,
    change: Annotated[list[str] | None, typer.Option(help="Only these; repeatable.")] = None,
    permutations: Annotated[
        int | None, typer.Option(help="Of the conditions of larvae (default 20) or agents.")
    ] = None,
    set_: Annotated[
        list[str] | None,
        typer.Option("--set", help="KEY=VALUE of `animarl train`; give new --cells with it."),
    ] = None,
    method: Annotated[
        str | None, typer.Option(help="module:factory of your own simulator, in packaged worlds.")
    ] = None,
    planning: Annotated[
        bool, typer.Option("--planning", help="The third truth: programs plan with their new body.")
    ] = False,
    out: Annotated[Path | None, typer.Option(help="Folder for the tables.")] = None,
) -> None:
    """Print what was predicted beside what is true."""
    console = Console(width=110)
    if only == [LARVAE] or (only == [RECORDED] and permutations):
        runs = trained_runs(only[0], seed or [0, 1, 2], cells, set_ or [])
        nulls = permuted(only[0], runs[0], cells, 20 if permutations is None else permutations)
        tables = {}
        if nulls:
            claimed = false_claims(only[0], nulls, 1 if only == [LARVAE] else repetitions)
            tables[f"false_claims_{only[0]}"] = claimed
            console.print(claimed.to_string(index=False))
        if only == [LARVAE]:
            tables[LARVAE] = larvae(runs, nulls)
            console.print(tables[LARVAE].T.to_string(float_format=lambda value: f"{value:.2f}"))
        for name, table in tables.items() if out is not None else ():
            out.mkdir(parents=True, exist_ok=True)
            table.assign(commit=commit()).to_csv(
                out / f"{name}.csv", index=False, float_format="%.4g"
            )
        return
    agents = DATA / "agents_collab_hunting"
    changes = QUICK if quick else CHANGES
    parts: list[dict[str, Any]] = []
    for name in only or changes:
        if name == RECORDED and (method is not None or not agents.exists()):
            console.print(f"{RECORDED}: no recordings in {DATA}, or a method of others: left out")
            continue
        seeds = [0] if quick else seed or [0, 1, 2]
        if method is not None:
            runs = [entered_run(name, method, one) for one in seeds]
        else:
            runs = [load_run(name)] if quick else trained_runs(name, seeds, cells, set_ or [])
        asked, alone = tuple(change or changes[name]), quick or method is not None
        second = None if alone else second_run(runs[0], asked, console.print)
        folder = agents / "weights" if name == RECORDED else None
        for one in answered(runs, asked, 2 if quick else repetitions, folder, planning, second):
            found = list(rows(name, runs, one))
            parts += found
            _print(console, name, one, found)
    table = pd.DataFrame(parts).assign(commit=commit())
    published = None if out is None else out / "whatif_truth.csv"
    if published is not None and published.exists():  # what was not asked anew stays
        kept = pd.read_csv(published, dtype={"commit": str})
        asked = set(zip(table["set"], table["change"], strict=True))
        stays = [pair not in asked for pair in zip(kept["set"], kept["change"], strict=True)]
        table = pd.concat([kept[stays], table]).sort_values(
            "set", key=lambda names: names.map(list(CHANGES).index), kind="stable"
        )
    short, held = summary(table), bars(table)
    console.print(short.to_string(index=False, float_format=lambda value: f"{value:.2f}"))
    console.print(held.to_string(index=False))
    console.print(warned(table))
    if table["set"].nunique() > 1:
        console.print(held_out_rules(table).to_string(index=False))
    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
        table.to_csv(out / "whatif_truth.csv", index=False, float_format="%.4g")
        short.to_csv(out / "summary.csv", index=False, float_format="%.4g")
        held.to_csv(out / "bars.csv", index=False)
        (out / "README.md").write_text(page(table, short, held), encoding="utf-8")


def commit() -> str:
    """Return the commit of this code."""
    command = ["git", "-C", str(Path(__file__).parent), "rev-parse", "--short", "HEAD"]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()


def _print(console: Console, name: str, one: Answered, found: list[dict[str, Any]]) -> None:
    title = f"{name}: {one.answer.scenario.name} ({one.reading}), warning: {one.answer.warning}"
    table = Table(title=title, title_justify="left", box=None)
    for column in ("quantity", "true", "predicted", "predicted - true", ""):
        table.add_column(column, justify="left" if column in ("quantity", "") else "right")
    for row in found:
        table.add_row(
            row["quantity"], *(
                f"{row[key]:+.3g} \\[{row[low]:.3g}, {row[high]:.3g}]"
                for key, low, high in (
                    ("true", "true_low", "true_high"), ("predicted", "low", "high"),
                    ("miss", "miss_low", "miss_high"),
                )
            ), "wrong" if row["wrong"] else "",
        )  # fmt: skip
    console.print(table)


if __name__ == "__main__":
    typer.run(main)
