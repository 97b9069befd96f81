"""What would animals do under the other condition? Predicted for animals that were kept aside.

    python benchmarks/treatments.py --quick
    python benchmarks/treatments.py --splits 20 --out docs/results/treatments

Recordings of living animals under a real treatment are split anew for every row, and whole animals
are kept aside. A simulator learns from the others under both conditions and is asked, as
``animarl whatif --change condition=NAME`` asks, what the treatment would do to those aside.
Beside its shift, and that which is corrected by what the simulator misses of the others
(``calibrated``), stand the true one, which their own recordings show, and the trivial answer: the
mean shift of the animals that were learned from. Termites: the same female before she was
paired and after her partner was taken away. Larvae: fed and deprived of protein, other animals
each. Gray bats: a free channel and obstacles in it, alone and in company, other flights each. The
recordings lie in $ANIMARL_DATA (by default ../shared/data). Finished splits are kept.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pandas as pd
import torch
import typer
from rich.console import Console

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # for benchmarks

from animarl_algos.evaluation.statistics import Interval
from animarl_algos.runs import pipeline
from animarl_algos.runs.run_settings import RunSettings, pipeline_settings
from animarl_algos.whatif.answer import ask
from animarl_algos.whatif.truth import RECORDINGS, find_truth, subtract
from animarl_envs import environment_id
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.splits import Splitting, deal
from animarl_envs.files import write_then_rename
from animarl_envs.species import CUSTOM
from benchmarks.faithful import DATA, DataSet, commit

FRACTIONS = (0.65, 0.13, 0.22)  # of animals: to learn from, to choose by, and kept aside
MEASURES = ("slow_steps", "turning", "rests", "bouts")
LARVAE = 40  # of each condition


@dataclass(frozen=True)
class Treatment:
    """A published set under two conditions.

    ``name`` is its own in tables, ``treated`` the condition that is asked for, and ``animal`` a
    pattern that finds the animal in the name of a recording. ``first`` recordings of each
    condition are used. ``measures`` are asked beside the speed.
    """

    name: str
    published: str
    treated: str
    animal: str = r"(.+)"
    first: int | None = None
    measures: tuple[str, ...] = MEASURES

    @property
    def recordings(self) -> DataSet:
        """The set of the table of living animals."""
        return DataSet(self.name, (), published=self.published, first=self.first)


TREATMENTS = (
    Treatment("termites", "termites_alone", "after", r"(.+)_(?:before|after)$"),
    Treatment("larvae", "larvae", "deprived", first=LARVAE),
    # Bats do not rest, and are filmed for as long as they cross the view.
    Treatment("bats, obstacles", "bats_obstacles", "obstacles", measures=("turning",)),
    Treatment("bats, company", "bats_company", "company", measures=("turning",)),
)
QUICK_EPOCHS = 2


def trained(demos: Demonstrations, folder: Path, seed: int, quick: bool) -> Any:
    """Return a finished run on the training animals of a split."""
    wanted = RunSettings(
        file=demos.name, species=CUSTOM, steps=1, seed=seed, baselines=False,
        overrides={"offline_epochs": QUICK_EPOCHS} if quick else {},
        **pipeline_settings(environment_id(CUSTOM), "default"),
    )  # fmt: skip
    preset = wanted.learner()
    wanted = wanted.changed(steps=preset.n_timesteps, copies=preset.n_envs)
    run = pipeline.open_run(wanted, folder, "benchmarks/treatments.py", demos)
    pipeline.learn(run, wanted.algo, progress_bar=False)
    return run


def split_rows(
    treatment: Treatment, demos: Demonstrations, split: int, out: Path, quick: bool
) -> Any:
    """Return a table of the answers about the animals that a split keeps aside."""
    name = f"{treatment.name.replace(', ', '-')}-{split}{'-quick' * quick}"
    file = out / "cells" / f"{name}.csv"
    if file.exists():
        return pd.read_csv(file)
    by_animal = Splitting(by="group", pattern=treatment.animal, fractions=FRACTIONS, seed=split)
    aside = deal(demos, by_animal)
    run = trained(aside, out / "runs" / name, split, quick)
    truth = find_truth(RECORDINGS, run, repetitions=1)
    change = f"condition={treatment.treated}"
    table = ask([run], [change], truth=truth, measures=treatment.measures).answers[0].table
    table = table.rename(columns={"trained_shift": "trivial"})
    table = table.assign(set=treatment.name, split=split, commit=commit())
    file.parent.mkdir(parents=True, exist_ok=True)
    with write_then_rename(file) as part:
        table.to_csv(part, index=False)
    return table


def summary(table: pd.DataFrame) -> pd.DataFrame:
    """Return a row for each quantity of a set: coverage, and errors beside the trivial answer's.

    ``predicted`` is calibrated, ``simulated`` is not. ``covered`` is the share of
    splits in which the calibrated interval and that of the true shift, which is of few animals,
    hold one value; ``strictly`` that in which the calibrated interval holds the true shift itself,
    ``by the plain interval`` the plain one. In ``nearer`` splits the prediction is nearer to the
    truth than the mean shift of those learned from.
    """

    def hold(some: pd.DataFrame, low: str, high: str) -> float:
        return float(some["true"].between(some[low], some[high]).mean())

    rows = []
    for (name, quantity, unit), some in table.groupby(["set", "quantity", "unit"], sort=False):
        misses = [
            subtract(*(Interval(row[key], row[f"{end}_low"], row[f"{end}_high"])
                       for key, end in (("calibrated", "calibrated"), ("true", "true"))))
            for row in some.to_dict("records")
        ]  # fmt: skip
        answers = some[["calibrated", "trivial", "shift"]]
        errors = answers.sub(some["true"], axis=0).abs()
        rows.append({
            "set": name, "quantity": quantity, "unit": unit, "splits": len(some),
            "true shift": some["true"].mean(), "predicted": some["calibrated"].mean(),
            "simulated": some["shift"].mean(), "trivial": some["trivial"].mean(),
            "error": errors["calibrated"].mean(),
            "error of the trivial answer": errors["trivial"].mean(),
            "error of the simulated shift": errors["shift"].mean(),
            "nearer": (errors["calibrated"] < errors["trivial"]).sum(),
            "covered": np.mean([not miss.excludes_zero for miss in misses]),
            "strictly": hold(some, "calibrated_low", "calibrated_high"),
            "by the plain interval": hold(some, "low", "high"),
        })  # fmt: skip
    return pd.DataFrame(rows)


def totals(found: pd.DataFrame) -> str:
    """Return in words what the rows of :func:`summary` are together."""

    def rows_of(name: str) -> str:
        return f"{round((found[name] * found['splits']).sum())}"

    smaller = [
        (found["error"] < found[f"error of the {other}"]).sum()
        for other in ("trivial answer", "simulated shift")
    ]
    return (
        f"Of {found['splits'].sum()} rows {rows_of('covered')} are covered, {rows_of('strictly')} "
        f"strictly, {rows_of('by the plain interval')} by the plain interval, and in "
        f"{found['nearer'].sum()} the prediction is nearer than the trivial answer. Of "
        f"{len(found)} mean errors {smaller[0]} are smaller than the trivial answer's, and "
        f"{smaller[1]} than those of the simulated shift."
    )


def main(
    only: Annotated[list[str] | None, typer.Option(help="Such as termites.")] = None,
    splits: Annotated[int, typer.Option(help="Of the animals, each with its own training.")] = 20,
    quick: Annotated[bool, typer.Option(help="Termites, one split, two epochs.")] = False,
    out: Annotated[Path, typer.Option(help="Where cells and tables go.")] = Path("out/treatments"),
) -> None:
    """Train, ask about the animals kept aside, and print one table."""
    torch.set_num_threads(1)
    console = Console(width=160)
    tables = []
    known = {one.name: one for one in TREATMENTS}
    for name in only or (["termites"] if quick else list(known)):
        if name not in known:
            raise typer.BadParameter(f"{name!r} is unknown: choose among {'; '.join(known)}")
        recordings = known[name].recordings
        if not recordings.there:
            console.print(f"{name}: its recordings are not in {DATA}: left out")
            continue
        demos = recordings.load(out)
        for split in range(1 if quick else splits):
            tables.append(split_rows(known[name], demos, split, out, quick))
            console.print(f"{name}: split {split + 1} is made", highlight=False)
    if not tables:
        return
    table = pd.concat(tables, ignore_index=True)
    for file, made in (("treatments.csv", table), ("summary.csv", summary(table))):
        with write_then_rename(out / file) as part:
            made.to_csv(part, index=False)
    found = summary(table).round(3).to_markdown(index=False)
    console.print(found, soft_wrap=True, highlight=False, markup=False)
    console.print(totals(summary(table)), soft_wrap=True, highlight=False)


if __name__ == "__main__":
    typer.run(main)
