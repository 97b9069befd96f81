"""How often the programs that made the packaged sets meet the bars that their clones are held to.

    python -m benchmarks.true_programs
    python -m benchmarks.true_programs --species newt --seeds 20

Nothing can move more like demonstrations than what made them: the trained teams of the agents,
the courtship of flies and newts, the programmed moth. From the starts of the packaged test episodes
each is rolled out and judged as a learner is, with other random numbers each time: by row of the
verdict, the share of times that its bar was met (inside its null or within a tenth; the classifier
at most .65), and how often all of them were.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Annotated, Any

import numpy as np
import pandas as pd
import typer
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from animarl_algos.benchmark.methods import ProgrammedPolicy, expert_rollouts
from animarl_algos.evaluation import Rollouts, Verdict, collect_rollouts, verdict
from animarl_algos.evaluation.collect import MemorylessPolicy
from animarl_algos.evaluation.teams import teams_of
from animarl_envs.demos.packaged import load_packaged, packaged_names
from animarl_envs.locomotion import Locomotion
from animarl_envs.scenario import Scenario, make_scenario
from animarl_envs.species import SPECIES, SearchSpecies
from animarl_envs.worlds import make_world
from animarl_envs.worlds.chase.world import ChaseWorld
from benchmarks.faithful import PACKAGED, ROLLOUTS
from tools.packaged_data.courtship_behaviour import CourtshipPolicy
from tools.packaged_data.courtship_published import BEHAVIOURS


@dataclass
class Courtship(MemorylessPolicy):
    """The program of flies and newts as a policy: it looks at the world itself, not at what is seen
    of it. ``believed`` is the locomotion that it plans with, by default that of the senses' scales.
    """

    scenario: Scenario
    seed: int
    believed: tuple[Locomotion, ...] | None = None

    def make_world(self, copies: int) -> ChaseWorld:
        """The world that it acts in from now on."""
        world = ChaseWorld(self.scenario, copies)
        behaviour = BEHAVIOURS[self.scenario.species.name]
        rng = np.random.default_rng([self.seed, copies])
        self._acting = CourtshipPolicy(world, behaviour, rng, self.believed)
        return world

    def act(self, observation: Any) -> NDArray[np.int64]:
        return self._acting.act().ravel()


def rolled_out(species: str, seed: int, rollouts: int) -> Rollouts:
    """At least so many rollouts of what made a packaged set, from its test starts."""
    demos = load_packaged(species)
    repetitions = -(-rollouts // int((demos.split == "test").sum()))
    if teams_of(demos) is not None:
        return expert_rollouts(demos, SPECIES[species], seed, repetitions)
    scenario = make_scenario(species, demos=demos, split="test")
    collect = partial(collect_rollouts, method="true program", seed=seed, repetitions=repetitions)
    if species in BEHAVIOURS:
        program = Courtship(scenario, seed)
        return collect(program.make_world, program)
    assert isinstance(scenario.species, SearchSpecies)
    return collect(partial(make_world, scenario), ProgrammedPolicy(scenario.species, seed))


def judged(species: str, seed: int, rollouts: int = ROLLOUTS) -> Verdict:
    """The verdict on them."""
    demos = load_packaged(species)
    others = demos.select(episodes=np.flatnonzero(demos.split != "test"))
    made = rolled_out(species, seed, rollouts)
    return verdict(demos.select(split="test"), made, seed=seed, references=others)


def bars_met(found: Verdict) -> dict[str, bool]:
    """By row of the verdict, whether its bar was not missed; what is not known misses none."""
    met = {}
    for bar in PACKAGED:
        row = bar.row(found, np.nan)
        if row is not None:
            met[str(row["label"])] = bar.met(found, row) is not False
    return met


def main(
    species: Annotated[list[str] | None, typer.Option(help="Packaged sets; repeatable.")] = None,
    seeds: Annotated[int, typer.Option(help="How often it is rolled out.")] = 20,
    rollouts: Annotated[int, typer.Option(help="Each time.")] = ROLLOUTS,
) -> None:
    """Print a table for each species."""
    console = Console(width=100)
    for name in species or packaged_names():
        found = [judged(name, seed, rollouts) for seed in range(seeds)]
        met = pd.DataFrame([bars_met(one) for one in found])
        met = met.where(met.notna(), True).astype(bool)  # an ending that neither side knows
        table = Table(title=f"{name}: what made it, rolled out {seeds} times")
        for heading in ("bar", "recorded", "mean", "met"):
            table.add_column(heading, justify="left" if heading == "bar" else "right")
        rows = pd.concat([one.table for one in found]).groupby("label")
        for label in met:
            own = rows.get_group(label)
            recorded, mean = own["recorded"].mean(), own["simulated"].mean()
            table.add_row(label, f"{recorded:.3g}", f"{mean:.3g}", f"{met[label].mean():.0%}")
        table.add_row("all of them", "", "", f"{met.all(axis=1).mean():.0%}")
        console.print(table)


if __name__ == "__main__":
    typer.run(main)
