"""The offline phase that several cells of a benchmark begin with, done once.

Recipes that clone soft labels differ in what follows: where the settings that cloning hangs on are
the same, so are networks, labels and draws, and the phase gives the same weights to the bit.
"""

from __future__ import annotations

import shutil
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from animarl_algos.benchmark.pieces import cost, write_cost
from animarl_algos.learner.presets import constructed
from animarl_algos.losses.terms import OfflineLoss
from animarl_algos.recipes.registry import SoftBC, named_recipe
from animarl_algos.runs import pipeline
from animarl_algos.runs.run import Run
from animarl_algos.runs.run_settings import RunSettings

if TYPE_CHECKING:
    from animarl_algos.benchmark.cells import Cell

COMMAND = "animarl benchmark"
DETERMINING = (
    "policy", "policy_kwargs", "offline_epochs", "offline_patience", "offline_learning_rate",
    "offline_batch_size", "offline_max_grad_norm", "offline_kwargs",
)  # fmt: skip
"""Settings of a learner that cloning hangs on; weights of other loss terms are none of them."""
ONLINE_ONLY = ("dtw",)
"""Options of its environment that nothing offline reads."""


@dataclass(frozen=True, kw_only=True)
class Clone:
    """The run that these cells begin with, each as if it were its own.

    A cell that finds it unfinished trains by itself, to the same bytes.
    """

    cells: tuple[Cell, ...]
    method = kind = "clone"

    @property
    def data(self) -> str:
        return self.cells[0].data

    @property
    def seed(self) -> int:
        return self.cells[0].seed

    @property
    def fold(self) -> int | None:
        return self.cells[0].fold

    @property
    def name(self) -> str:
        return self.cells[0].clone_name

    @property
    def key(self) -> str:
        return str(self.cells[0].clone)

    def folder(self, out: Path) -> Path:
        return self.cells[0].clone_folder(out)

    def finished(self, out: Path) -> bool:
        """Also where no cell is left that would begin with it."""
        return bool(self.cost(out)) or all(cell.finished(out) for cell in self.cells)

    @property
    def needs(self) -> tuple[str, ...]:
        return (self.cells[0].world_name,)

    def lacks(self, out: Path) -> str:
        return self.cells[0].lacks(out)

    def perform(self, out: Path) -> None:
        began, settings = time.process_time(), self.cells[0].cloning
        assert settings is not None
        run = opened(settings, self.folder(out), self.cells[0].world_folder(out))
        model = pipeline.learn(run, settings.algo, progress_bar=False)
        write_cost(self.folder(out), began, model.policy.q_net.num_parameters)

    def cost(self, out: Path) -> dict[str, Any]:
        return cost(self.folder(out))


def opened(settings: RunSettings, folder: Path, world: Run) -> Run:
    """The run of a piece, in a world that is fitted."""
    run = pipeline.open_run(settings, folder / "run", COMMAND, world.demos)
    shutil.copyfile(world.path / "locomotion.json", run.path / "locomotion.json")
    return run


def cloning(settings: RunSettings) -> RunSettings | None:
    """The run of soft-label cloning alone that a training begins with.

    Two trainings begin alike if these are equal and the world is; None: it begins otherwise.
    """
    algorithm = named_recipe(settings.algo).algorithm
    own, determining = algorithm.recipe, _determining(settings)
    if settings.learner().arguments.get("offline_loss") == OfflineLoss.CLONING:
        own = own.cloning()
    alike = own.offline == SoftBC.recipe.offline and own.selection is SoftBC.recipe.selection
    if not (alike and determining["offline_epochs"]):
        return None
    alone = settings.changed(
        algo="qr-soft-bc" if algorithm.quantiles else "soft-bc", preset="default",
        config=None, overrides=determining, steps=1, copies=1, repetitions=1, acting="greedy",
    )  # fmt: skip
    return alone if _determining(alone) == determining else None


def _determining(settings: RunSettings) -> dict[str, Any]:
    asked = settings.learner()
    whole = constructed(asked.arguments)
    seen = {key: value for key, value in asked.env_kwargs.items() if key not in ONLINE_ONLY}
    return {key: whole[key] for key in DETERMINING} | {"env_kwargs": seen}
