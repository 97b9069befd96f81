"""How turns follow each other, and how much animals differ, recorded and simulated.

    python benchmarks/faithful.py --test --only moths --seed 0 --out out/moths
    python benchmarks/order.py out/moths/cells/*

A cell of ``benchmarks/faithful.py`` holds recordings and the rollouts from their starts. Printed of
each are the autocorrelation of signed turns at some lags, windings a minute, and the standard
deviation between animals of the mean speed and of the mean turning: of the recordings, and of one
rollout of every recording, the mean over such choices. Means are over recordings, of rollouts over
the recordings that they started from.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from animarl_algos.evaluation.order_in_time import order_measures
from animarl_algos.evaluation.prepared import resting_step
from animarl_algos.evaluation.rollouts import Rollouts
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.summary import unit_of

LAGS = (1.0, 3.0, 5.0, 10.0)  # [s]


def measured(
    rollouts: Rollouts, seconds: list[float], rest: NDArray[np.float64]
) -> dict[str, float]:
    """What the table shows of one side, of the first individual."""
    lags = tuple(round(lag / rollouts.dt) for lag in seconds)
    found = order_measures(rollouts, lags, rest)
    own = dict(zip(found.names, found.values.T))
    starts = [np.flatnonzero(rollouts.demo == demo) for demo in np.unique(rollouts.demo)]
    times = min(map(len, starts))

    def mean(name: str) -> float:
        return float(np.mean([np.nanmean(own[name][of]) for of in starts]))

    def between(name: str) -> float:
        chosen = [[own[name][of[i]] for of in starts] for i in range(times)]
        return float(np.mean(np.std(chosen, axis=1, ddof=1)))

    turns = {f"turns at {lag:g} s": mean(f"turn autocorrelation at {lag:g} s") for lag in seconds}
    return turns | {
        "windings a minute": 60 * mean("windings"),
        "sd of speed": between("speed"),
        "sd of turning": between("turning"),
    }


def main(
    cells: Annotated[list[Path], typer.Argument(help="Folders that faithful.py has written.")],
    lag: Annotated[list[float] | None, typer.Option(help="In seconds; repeatable.")] = None,
) -> None:
    """Print recorded and simulated values of every cell."""
    table = Table(title="Order in time, and spread between animals")
    for cell in cells:
        demos = Demonstrations.load(cell / "recorded.npz")
        true, made = Rollouts.from_demonstrations(demos), Rollouts.load(cell / "rollouts.npz")
        unit, rest = unit_of(demos), resting_step(true)
        for side, rollouts in (("recorded", true), (cell.name, made)):
            found = measured(rollouts, lag or list(LAGS), rest)
            found["sd of speed"] *= unit.per_arena_unit
            if not table.columns:
                for name in ("", *found):
                    table.add_column(f"{name} ({unit.name}/s)" if name == "sd of speed" else name)
            table.add_row(side, *(f"{value:.3g}" for value in found.values()))
    Console(width=128).print(table)


if __name__ == "__main__":
    typer.run(main)
