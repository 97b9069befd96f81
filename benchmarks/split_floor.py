"""How far a test split is from the recordings that a simulator may learn from.

    python benchmarks/split_floor.py

By measure of the verdict, the mean over the packaged test episodes and over all others, the
difference in percent of the first, and in standard errors of it. A simulator that moves like what
it was shown is as far from the test episodes as these others are, and no nearer but by chance.
"""

from __future__ import annotations

from typing import Annotated

import numpy as np
import typer
from rich.console import Console
from rich.table import Table

from animarl_algos.evaluation.metrics import judged_metrics, measures
from animarl_algos.evaluation.prepared import Prepared, comparison_smoothing
from animarl_algos.evaluation.rollouts import Rollouts
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.packaged import load_packaged
from animarl_envs.demos.splits import learnable
from animarl_envs.species import SPECIES


def split_rows(demos: Demonstrations) -> list[tuple[str, float, float, float]]:
    """Measure, mean over the test episodes, over the others, and difference [standard errors]."""
    test = demos.select(split="test")
    prepared = Prepared(test, comparison_smoothing(test))
    own = measures(prepared, prepared.recorded)
    others = prepared.filtered(Rollouts.from_demonstrations(learnable(demos)))
    beside = measures(prepared, others)
    rows = []
    for measure in judged_metrics(prepared):
        a, b = own[measure.key], beside[measure.key]
        error = float(np.hypot(*(x.std(ddof=1) / np.sqrt(len(x)) for x in (a, b))))
        if error > 0:
            rows.append((measure.label, a.mean(), b.mean(), (b.mean() - a.mean()) / error))
    return rows


def main(
    species: Annotated[list[str] | None, typer.Option(help="Packaged sets; repeatable.")] = None,
) -> None:
    """Print a table for each set."""
    console = Console(width=100)
    for name in species or list(SPECIES):
        demos = load_packaged(name)
        tested = int((demos.split == "test").sum())
        table = Table(title=f"{name}: {tested} test episodes and {len(demos) - tested} others")
        for heading in ("measure", "test", "others", "difference", "standard errors"):
            table.add_column(heading, justify="left" if heading == "measure" else "right")
        for label, own, beside, errors in split_rows(demos):
            share = f"{beside / own - 1:+.0%}" if own else ""
            table.add_row(label, f"{own:.3g}", f"{beside:.3g}", share, f"{errors:+.1f}")
        console.print(table)


if __name__ == "__main__":
    typer.run(main)
