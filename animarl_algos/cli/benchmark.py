"""``animarl benchmark``: every method, every species, every seed, and a leaderboard."""

from pathlib import Path

import typer
from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TaskID,
    TextColumn,
    TimeRemainingColumn,
)
from rich.table import Table

from animarl_algos.benchmark.leaderboard import titles, write_leaderboard
from animarl_algos.benchmark.matrix import (
    Plan,
    claim_folder,
    matrix_file,
    plan,
    read_matrix,
)
from animarl_algos.benchmark.methods import parse_method
from animarl_algos.benchmark.pieces import Cell, Clone, Piece, perform_all
from animarl_algos.benchmark.scores import score_submission
from animarl_algos.cli.shared import PlainConsole, command_line, helps
from animarl_algos.evaluation.statistics import interval
from animarl_algos.report.words import number, with_interval
from animarl_envs.errors import InputError
from animarl_envs.species import species_name

STAGES = ("worlds", "clones", "cells", "scores")
MOST_NAMES = 4  # of pieces that run, in a line

app = typer.Typer(invoke_without_command=True, rich_markup_mode="markdown")


@app.callback()
@helps(
    preset="smoke (minutes), short (default trainings) or paper.",
    config="A YAML file of your own instead of a preset.",
    out="Folder of the results; finished pieces in it are kept.",
    species="Only these of the matrix; repeatable.",
    only="Only these rows or cells, such as 'agent/soft-bc' or '*/dqn/0'.",
    method="Your own method, NAME=module:factory; repeatable.",
    processes="Number of processes, one thread each.",
    show=typer.Option("--list", help="List what would be done, and stop."),
)
def benchmark_command(
    context: typer.Context,
    preset: str = "smoke",
    config: Path | None = None,
    out: Path = Path("out/benchmark"),
    species: list[str] | None = None,
    only: list[str] | None = None,
    method: list[str] | None = None,
    processes: int = 1,
    show: bool = False,
) -> None:
    """Train, roll out and score every method on every species with every seed.

    The same command continues a benchmark that was stopped; finished cells are not run again. Given
    on several machines that share --out, they share the work. If something failed, the exit code is
    1, and the leaderboard is written without it.

    Examples:

      animarl benchmark --preset smoke --out out/bench --processes 2

      animarl benchmark --preset short --species agent --list

      animarl benchmark --preset short --only 'fly/*' --method mine=my_module:make

      animarl benchmark score mine.npz --species agent
    """
    if context.invoked_subcommand is not None:
        return
    if processes < 1:
        raise InputError(f"processes is {processes}: it must be at least 1")
    matrix = read_matrix(preset, config)
    species = [one if one in matrix.files else species_name(one) for one in species or []]
    for name in species:
        if name not in (*matrix.species, *matrix.files):
            known = ", ".join((*matrix.species, *matrix.files))
            raise InputError(f"--species {name}: it is not in the matrix: choose among {known}")
    if species:
        matrix = matrix.changed(
            species=tuple(s for s in matrix.species if s in species),
            files={name: file for name, file in matrix.files.items() if name in species},
        )
    methods = dict(parse_method(given) for given in method or [])
    whole = plan(matrix, methods, matrix_file(preset, config))
    asked = whole.only(only or [])
    claim_folder(out, mark=not show)
    console = PlainConsole(least_width=100)
    if show:
        console.print(_listing(asked, out))
        return
    shown = Shown(asked, out, console)
    with shown.progress:
        for piece, error in perform_all(asked.pieces, out, processes):
            shown.tell(piece, error)
    for name, cause in shown.causes():
        console.print(f"\n{name} failed: {cause}")
    page = write_leaderboard(whole, out, command_line())
    console.print(f"\nOpen {page}")
    if shown.failed:
        raise typer.Exit(1)


@app.command("score")
@helps(
    file="A file of rollouts, .npz.",
    species=typer.Option(help="The packaged species that was rolled out."),
)
def score_command(file: Path, species: str) -> None:
    """Check and score a file of rollouts; no code of its author is run.

    Example:

      animarl benchmark score runs/mine/rollouts/BC.npz --species agent
    """
    found = score_submission(file, species)
    console = PlainConsole(least_width=100)
    table = Table(title=f"{found.method} on {found.data}: {found.words}")
    for heading in ("measure", "value [95 % interval]", "null", "remark"):
        table.add_column(heading)
    for key, title in titles(found).items():
        row = found.by_measure[key]
        table.add_row(title, with_interval(interval(row)), number(row["null"]), row["reason"])
    console.print(table)
    console.print(
        f"{found.rollouts} rollouts from {found.starts} test starts; intervals cover "
        f"{found.covers}."
    )


class Shown:
    """How far each stage is, what failed, what runs, and about how long it will take."""

    def __init__(self, asked: Plan, out: Path, console: Console) -> None:
        self.failed: list[tuple[Piece, str]] = []
        self.progress = Progress(
            "{task.description}", BarColumn(20), MofNCompleteColumn(), TimeRemainingColumn(),
            TextColumn("{task.fields[said]}", markup=False), console=console,
        )  # fmt: skip
        self._stages: dict[str, TaskID] = {}
        for title, stage in zip(STAGES, asked.stages):
            there = sum(piece.finished(out) for piece in stage)
            task = self.progress.add_task(title, total=len(stage), completed=there, said="")
            self._stages |= {piece.name: task for piece in stage}
        self._running: dict[str, Piece] = {}

    def tell(self, piece: Piece, error: str | None) -> None:
        """A piece begins (None), or has ended with an error or an empty one."""
        self._running.pop(piece.name, None)
        task = self._stages[piece.name]
        if error is None:
            self._running[piece.name] = piece
        elif error:
            self.failed.append((piece, error))
        else:
            self.progress.advance(task)
        failed = sum(self._stages[other.name] == task for other, _ in self.failed)
        running = [name for name in self._running if self._stages[name] == task]
        said = ", ".join([f"{failed} failed"] * bool(failed) + running[:MOST_NAMES])
        self.progress.update(task, said=said)

    def causes(self) -> list[tuple[str, str]]:
        """What failed by itself, not for want of what failed before it."""
        names = {piece.name for piece, _ in self.failed}
        return [(p.name, error) for p, error in self.failed if names.isdisjoint(p.needs)]


def _listing(asked: Plan, out: Path) -> Table:
    table = Table("cell", "kind", "key", "state")
    listed: list[Clone | Cell] = [*asked.clones, *asked.cells]
    for one in listed:
        state = "finished" if one.finished(out) else one.error(out) or "to do"
        table.add_row(one.name, one.kind, one.key, state)
    return table
