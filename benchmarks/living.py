"""How alike are simulated and recorded living animals, by pushes and by cells? One table.

    python benchmarks/living.py --quick
    python benchmarks/living.py --seed 0 --seed 1 --seed 2 --out docs/results/living

Every cell of the table is a set of recordings, a recipe of the clone and a seed: imported, fitted,
trained and rolled out from the starts of the validation split as ``animarl run`` does, and judged
by the verdict. Cross-entropy is no measure here, since recipes have other actions. The recordings
lie in $ANIMARL_DATA (by default ../shared/data); sets that are not there are left out and named.
Finished cells are kept under ``--out``.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Annotated, Any

import pandas as pd
import torch
import typer
from rich.console import Console

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # for benchmarks

from animarl_algos.evaluation import Verdict
from animarl_algos.evaluation.classifier import AUC, SEQUENCE
from animarl_algos.evaluation.metrics import ORDER
from animarl_algos.evaluation.statistics import Interval
from benchmarks.faithful import DATA, DataSet, judged

MEASURES = (
    *(AUC, SEQUENCE, ORDER, "kinematic", "interactive", "mean_speed", "spread_of_mean_speed"),
    *("turning", "slow_steps", "rests", "bouts", "duration", "nearest"),
)
"""Rows of the verdict that the table has, where the set has them."""
RECIPES: dict[str, tuple[str, dict[str, Any]]] = {
    "recorded": ("recorded", {}),
    "recurrent": ("recurrent", {}),
    "cells-64": ("cells", {"env_kwargs": {"cells": 64}}),
    "cells-128": ("cells", {"env_kwargs": {"cells": 128}}),
}
"""Recipe of the clone and settings over it, by the name in the table."""
FIRST = 40  # larvae of each condition
ROLLOUTS, QUICK_ROLLOUTS, QUICK_EPOCHS = 120, 16, 2


SETS = (
    DataSet("larvae", (), published="larvae", first=FIRST),
    DataSet("termites_alone", (), published="termites_alone"),
    DataSet("bats", (), published="bats_obstacles"),
    DataSet("pairs", (), published="termite_pairs"),
    DataSet("termites", (), published="termites"),
    DataSet("fish15", (), published="fish15"),
)


def main(
    only: Annotated[list[str] | None, typer.Option(help="These sets; repeatable.")] = None,
    recipe: Annotated[list[str] | None, typer.Option(help="These recipes; repeatable.")] = None,
    seed: Annotated[list[int] | None, typer.Option(help="Repeatable.")] = None,
    quick: Annotated[bool, typer.Option(help="Larvae, two epochs, few rollouts.")] = False,
    out: Annotated[Path, typer.Option(help="Where cells and the table go.")] = Path("out/living"),
) -> None:
    """Import, fit, train, roll out, and print one table."""
    torch.set_num_threads(1)
    console = Console(width=160)
    names = ["larvae"] if quick else [one.name for one in SETS]
    lines: list[dict[str, Any]] = []
    for one in (each for each in SETS if each.name in (only or names)):
        if not one.there:
            console.print(f"{one.name}: its recordings are not in {DATA}: left out")
            continue
        for name in recipe or (["recurrent", "cells-128"] if quick else RECIPES):
            cloning, overrides = RECIPES[name]
            overrides = overrides | ({"offline_epochs": QUICK_EPOCHS} if quick else {})
            for s in seed or [0]:
                cell = out / "cells" / f"{one.name}-{name}-{s}{'-quick' * quick}"
                if not (cell / "cell.json").exists():
                    number = QUICK_ROLLOUTS if quick else ROLLOUTS
                    judged(one, out, "soft-bc", s, "val", number, cloning, overrides).save(cell)
                lines.append(row(cell) | {"set": one.name, "recipe": name, "seed": s})
    table = pd.DataFrame(lines).set_index(["set", "recipe", "seed"]).reset_index()
    table.to_csv(out / "living.csv", index=False)
    console.print(table.to_markdown(index=False), soft_wrap=True, highlight=False, markup=False)


def row(cell: Path) -> dict[str, Any]:
    """Return the findings of a finished cell: recorded and simulated, areas with intervals."""
    found, done = Verdict.load(cell), json.loads((cell / "cell.json").read_text())
    made: dict[str, Any] = {}
    for measure in MEASURES:
        if measure not in set(found.table["measure"]):
            continue
        one = found.row(measure)
        if measure in (AUC, SEQUENCE):
            areas = {"": Interval(one["value"], one["low"], one["high"])} | found.areas[measure]
            value = ", ".join(
                f"{name} {area.estimate:.2f} [{area.low:.2f}, {area.high:.2f}]".strip()
                for name, area in areas.items()
                if name in ("", "floor", "among")
            )
        else:
            value = f"{one['simulated']:.3g} (recorded {one['recorded']:.3g})"
        made[measure] = value
    return made | {"seconds": round(done["seconds"]), "commit": done["commit"]}


if __name__ == "__main__":
    typer.run(main)
