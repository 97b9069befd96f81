"""What rewards for imitation pay for behaviours of known worth.

    python benchmarks/returns.py [FILE] [--species agent ...] [--episodes 15] [--repetitions 4]

From the first validation starts of each species, everybody acts alike: by the actions that track
the recording (on artificial agents, those that were recorded), with 1 % and 10 % of them random,
straight at the focus, coasting, out of the arena, or tracking until somebody ends the episode. A
reward fit for imitation ranks the first three above all others, and in their order. Printed are
mean returns of episodes and individuals, task reward included with alpha 1.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from numpy.typing import NDArray
from rich.console import Console
from rich.table import Table

from animarl_envs.demos.packaged import packaged_names
from animarl_envs.dtw import DTWTracker
from animarl_envs.fitting.result import fit_locomotion
from animarl_envs.importing.readers import load_readers, read
from animarl_envs.scenario import Scenario, make_scenario
from animarl_envs.species import get_species
from animarl_envs.species.options import with_options
from animarl_envs.worlds.base import World

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from behaviours import FAITHFUL, UNFAITHFUL, MakeTracker, returns, shipped

COURSES = FAITHFUL | UNFAITHFUL


class ClosedEnd(DTWTracker):
    """The increment, and at a termination what is left to the closed end, W(T, m)."""

    def stepped(self, world: World) -> None:  # type: ignore[override]
        super().stepped(world)
        demos = world.demos
        assert demos is not None
        last = (demos.lengths[world.demo] - 1)[:, None, None]
        left = np.take_along_axis(self.rows, last, axis=2)[..., 0] - self.row_minimum
        self.penalty = self.penalty + np.where(world.terminated[:, None], left, 0.0)


class OpenCloseness(DTWTracker):
    """exp(-c / scale) of the increment with free warping, for as long as it lasts."""

    def stepped(self, world: World) -> None:  # type: ignore[override]
        super().stepped(world)
        self.penalty = -np.exp(-self.penalty / self.scale)


class Potential(DTWTracker):
    """Shaping by the potential -min_j W(t, j), zero where an episode has terminated."""

    gamma = 1.0

    def stepped(self, world: World) -> None:  # type: ignore[override]
        before = self.row_minimum.copy()
        super().stepped(world)
        after = np.where(world.terminated[:, None], 0.0, self.row_minimum)
        self.penalty = self.gamma * after - before


class UntilLeft(DTWTracker):
    """1 a step until the recorded position of the same step is farther than ``scale``."""

    def started(self, world: World, mask: NDArray[np.bool_]) -> None:  # type: ignore[override]
        super().started(world, mask)
        self._follows = np.ones(self.penalty.shape, dtype=bool)

    def stepped(self, world: World) -> None:  # type: ignore[override]
        super().stepped(world)
        demos = world.demos
        assert demos is not None
        recorded = demos.positions[
            demos.offsets[world.demo] + np.minimum(world.step_count, demos.lengths[world.demo] - 1)
        ]
        self._follows &= np.linalg.norm(world.position - recorded, axis=-1) < self.scale
        self._follows &= (world.step_count < demos.lengths[world.demo])[:, None]
        self.penalty = -self._follows.astype(np.float64)


def tried(kind: type[DTWTracker]) -> MakeTracker:
    """A reward that is not the package's."""

    def make(world: World, gamma: float) -> DTWTracker:
        everyone = np.arange(world.num_individuals)
        scale = world.scenario.species.contact_radius
        tracker = kind(world.demos, world.num_copies, everyone, scale, "increment")
        if isinstance(tracker, Potential):
            tracker.gamma = gamma
        return tracker

    return make


REWARDS: dict[str, MakeTracker] = {
    "closeness": shipped("closeness"),
    "increment": shipped("increment"),
    "cumulative (paper)": shipped("cumulative"),
    "increment, end closed": tried(ClosedEnd),
    "closeness, free warping": tried(OpenCloseness),
    "potential-based": tried(Potential),
    "until left": tried(UntilLeft),
}


def scenarios(file: Path | None, species: list[str], episodes: int) -> dict[str, Scenario]:
    """By heading; chases in dishes and boxes with walls, the others as they are."""
    if file is not None:
        load_readers(Path(__file__).with_name("paper_readers.py"))
        demos = read(file, None)
        spec = with_options(
            get_species(species[0]), individuals=demos.individuals, dt=demos.dt, arena=demos.arena,
            time_limit=int(demos.lengths.max()) - 1,
            locomotion=fit_locomotion(demos, seed=0).locomotion,
        )  # fmt: skip
        chosen = demos.select(split="val")
        few = chosen.select(episodes=range(min(episodes, len(chosen))))
        return {demos.name: make_scenario(spec, demos=few, split=None)}
    found = {}
    for name in species:
        walls = {"rebound": True} if name in ("fly", "newt") else {}
        whole = make_scenario(name, split="val", **walls)
        assert whole.demos is not None
        few = whole.demos.select(episodes=range(min(episodes, len(whole.demos))))
        heading = f"{name} (synthetic{', walls' if walls else ''})"
        found[heading] = make_scenario(whole.species, demos=few, split=None)
    return found


def ranks(mean: NDArray[np.float64]) -> str:
    """Whether returns of all courses, ``(courses, K)``, fall as they should."""
    faithful, unfaithful = mean[: len(FAITHFUL)], mean[len(FAITHFUL) :]
    right = (np.diff(faithful, axis=0) < 0).all(0) & (faithful[-1] > unfaithful).all(0)
    return f"{right.sum()} of {len(right)}"


def main(
    file: Annotated[Path | None, typer.Argument(help="Recorded episodes.")] = None,
    species: Annotated[list[str] | None, typer.Option(help="Whose world.")] = None,
    episodes: Annotated[int, typer.Option(help="Starts.")] = 15,
    repetitions: Annotated[int, typer.Option(help="Rollouts from each.")] = 4,
    seed: Annotated[int, typer.Option(help="Of the random actions.")] = 0,
) -> None:
    """Returns of behaviours under rewards for imitation."""
    named = species or (["agent"] if file is not None else sorted(packaged_names()))
    for heading, scenario in scenarios(file, named, episodes).items():
        for gamma in (1.0, 0.99):
            table = Table(title=f"{heading}, discount {gamma:g}")
            table.add_column("reward")
            for name in COURSES:
                table.add_column(name, justify="right")
            table.add_column("individuals in order", justify="right")
            mean = np.stack(
                [
                    returns(
                        scenario,
                        course,
                        list(REWARDS.values()),
                        gamma,
                        repetitions=repetitions,
                        seed=seed,
                    ).mean(axis=1)
                    for course in COURSES.values()
                ],
                axis=1,
            )  # fmt: skip  (rewards, courses, K)
            for name, row in zip(REWARDS, mean, strict=True):
                table.add_row(name, *(f"{value:.1f}" for value in row.mean(axis=1)), ranks(row))
            Console(width=150).print(table)


if __name__ == "__main__":
    typer.run(main)
