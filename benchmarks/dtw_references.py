"""What a DTW distance to the recordings means: known behaviours measured with the same ruler.

    python benchmarks/dtw_references.py FILE [--split val] [--repetitions 5] [--seed 0]

From each recorded start: the recorded actions with a share of them replaced by random ones,
individuals that only coast, and other recordings of the same condition in place of rollouts.
"""

from __future__ import annotations

from functools import partial
from typing import Annotated, Any

import numpy as np
import pandas as pd
import typer
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from animarl_algos.evaluation.collect import MemorylessPolicy, collect_rollouts
from animarl_algos.evaluation.comparison import comparison_table
from animarl_algos.evaluation.metrics import measure, measure_recordings
from animarl_algos.evaluation.prepared import dtw_alignments
from animarl_algos.evaluation.rollouts import Rollouts
from animarl_algos.evaluation.statistics import interval
from animarl_algos.report.words import number, with_interval
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.fitting.result import fit_locomotion
from animarl_envs.fitting.transitions import demonstrated_actions
from animarl_envs.importing.readers import read
from animarl_envs.locomotion import COAST, NUM_ACTIONS
from animarl_envs.scenario import make_scenario
from animarl_envs.species import get_species
from animarl_envs.species.options import with_options
from animarl_envs.worlds import make_world

SHARES = (0.0, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1.0)


class RecordedActions(MemorylessPolicy):
    """The recorded actions, open loop, each replaced by a random one with probability ``share``."""

    def __init__(
        self, actions: NDArray[np.integer], demos: Demonstrations, repetitions: int, share: float
    ) -> None:
        self._actions, self._share = actions, share
        self._first = np.repeat(demos.offsets[:-1], repetitions)
        self._steps = np.repeat(demos.lengths - 1, repetitions)
        self._rng = np.random.default_rng(0)
        self._t = 0

    def act(self, observation: Any) -> NDArray[np.int64]:
        """One action per slot; after the recording's end, coasting."""
        row = self._actions[self._first + np.minimum(self._t, self._steps - 1)]
        chosen = np.where((self._t < self._steps)[:, None], row, COAST)
        random = self._rng.integers(NUM_ACTIONS, size=chosen.shape)
        self._t += 1
        return np.where(self._rng.random(chosen.shape) < self._share, random, chosen).ravel()


def other_recordings(demos: Demonstrations, rng: np.random.Generator) -> pd.DataFrame:
    """Every recording measured against another one of its condition, drawn at random."""
    rollouts = Rollouts.from_demonstrations(demos)
    other = np.empty(demos.num_episodes, dtype=np.int64)
    for condition in np.unique(demos.condition):
        among = np.flatnonzero(demos.condition == condition)
        other[rng.permutation(among)] = np.roll(among, 1)
    table = measure(rollouts, demos).assign(method="other recordings")
    order = demos.select(episodes=other)
    table["dtw"] = dtw_alignments(rollouts, order)[0][:, rollouts.movers].mean(axis=1)
    table["dtw_per_step"] = table["dtw"] / np.maximum(demos.lengths, order.lengths)
    return table


def main(
    file: Annotated[str, typer.Argument(help="Recorded episodes of a chase.")],
    split: Annotated[str, typer.Option(help="Which episodes to start from.")] = "val",
    repetitions: Annotated[int, typer.Option(help="Rollouts per start; 512 at most in all.")] = 5,
    species: Annotated[str, typer.Option(help="agent, fly or newt.")] = "agent",
    seed: Annotated[int, typer.Option(help="Of replacements and resampling.")] = 0,
) -> None:
    """DTW distance of known behaviours to the recordings they start from."""
    demos = read(file, None)
    fit = fit_locomotion(demos, seed=seed)
    base = get_species(species)
    spec = with_options(
        base, individuals=demos.individuals, dt=demos.dt, arena=demos.arena,
        locomotion=fit.locomotion, time_limit=max(base.time_limit, int(demos.lengths.max()) - 1),
    )  # fmt: skip
    chosen = demos.select(split=split)
    actions = demonstrated_actions(chosen, spec.locomotion)
    scenario = make_scenario(spec, demos=demos, split=split)
    tables = [measure_recordings(chosen), other_recordings(chosen, np.random.default_rng(seed))]
    behaviours = {f"recorded actions, {share:.0%} random": share for share in SHARES}
    for name, share in behaviours.items():
        policy = RecordedActions(actions, chosen, repetitions, share)
        rollouts = collect_rollouts(
            partial(make_world, scenario), policy, method=name, seed=seed, repetitions=repetitions
        )
        tables.append(measure(rollouts, chosen))
    still = collect_rollouts(
        partial(make_world, scenario),
        RecordedActions(np.full_like(actions, COAST), chosen, 1, 0.0),
        method="coasting",
        seed=seed,
        repetitions=1,
    )
    tables.append(measure(still, chosen))
    metrics = pd.concat(tables, ignore_index=True)
    compared = comparison_table(
        metrics, np.arange(chosen.num_episodes), np.random.default_rng(seed)
    )
    table = Table(title=f"{demos.name}, {split}: {chosen.num_episodes} starts")
    for heading in ("behaviour", "DTW distance", "per step", "duration, s"):
        table.add_column(heading, justify="left" if heading == "behaviour" else "right")
    for name in metrics["method"].unique():
        rows = compared[(compared["method"] == name) & (compared["counting"] == "all")]
        row = {line["measure"]: line for line in rows.to_dict("records")}
        table.add_row(
            name,
            *(
                with_interval(interval(row[metric])) if metric in row else ""
                for metric in ("dtw", "dtw_per_step")
            ),
            number(row["duration"]["value"]),
        )
    Console(width=110).print(table)


if __name__ == "__main__":
    typer.run(main)
