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

from animarl_algos.benchmark import challenge
from animarl_algos.benchmark.leaderboard import titles, write_leaderboard
from animarl_algos.benchmark.matrix import (
    Plan,
    claim_folder,
    matrix_file,
    plan,
    read_matrix,
)
from animarl_algos.benchmark.methods import parse_method
from animarl_algos.benchmark.pieces import BACKENDS, Piece, perform_all
from animarl_algos.benchmark.scores import score_submission
from animarl_algos.cli.evaluate import MEASURE
from animarl_algos.cli.shared import PlainConsole, command_line, with_help
from animarl_algos.evaluation.statistics import interval
from animarl_algos.report.words import number, with_interval
from animarl_envs.errors import InputError
from animarl_envs.species import species_name

STAGES = ("worlds", "cells", "scores")

app = typer.Typer(invoke_without_command=True, rich_markup_mode="markdown")


@app.callback()
@with_help(
    preset="smoke (minutes), short (default trainings) or paper.",
    config="A YAML file of your own instead of a preset.",
    out="Folder of the results; finished pieces in it are kept.",
    species="Only these of the matrix; repeatable.",
    only="Only these rows or cells, such as 'agent/soft-bc' or '*/dqn/0'.",
    method="Your own method, NAME=module:factory; repeatable.",
    measure=MEASURE,
    processes="Number of processes, one thread each.",
    backend="loky (processes of this machine) or ray (a Ray cluster that 'ray start' made).",
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
    measure: list[str] | None = None,
    processes: int = 1,
    backend: str = BACKENDS[0],
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
    if backend not in BACKENDS:
        raise InputError(f"--backend {backend}: choose {' or '.join(BACKENDS)}")
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
    if measure:
        matrix = matrix.changed(measures=(*matrix.measures, *measure))
    methods = dict(parse_method(given) for given in method or [])
    whole = plan(matrix, methods, matrix_file(preset, config))
    wanted = whole.only(only or [])
    claim_folder(out, mark=not show)
    console = PlainConsole(least_width=100)
    if show:
        console.print(_listing(wanted, out))
        return
    bars = StageBars(wanted, out, console)
    with bars.progress:
        for piece, error in perform_all(wanted.stages, out, processes, backend):
            bars.update(piece, error)
    for piece, error in bars.failed:
        console.print(f"\n{piece.name} failed: {error}")
    page = write_leaderboard(whole, out, command_line())
    console.print(f"\nOpen {page}")
    if bars.failed:
        raise typer.Exit(1)


@app.command("score")
@with_help(
    file="A file of rollouts, .npz.",
    species=typer.Option(
        "--species", "--set", help="The packaged species that was rolled out; with --row, the set."
    ),
    row="Check it as an entry of the challenge, and write its row into this CSV.",
    data="With --row, the demonstrations of a set of living animals, .npz.",
)
def score_command(
    file: Path, species: str, row: Path | None = None, data: Path | None = None
) -> None:
    """Check and score a file of rollouts; no code of its author is run.

    An entry of the challenge (docs/challenge.md) has 32 rollouts from every test start.

    Examples:

      animarl benchmark score runs/mine/rollouts/BC.npz --species agent

      animarl benchmark score mine.npz --set fly --row table.csv
    """
    if row is None and data is not None:
        raise InputError("--data is for entries of the challenge: give --row, too")
    if row is None:
        result = score_submission(file, species)
    else:
        result = challenge.score_entry(file, species, data)
        challenge.add_row(challenge.row_of(result, species, file), row)
    console = PlainConsole(least_width=100)
    table = Table(title=f"{result.method} on {result.data or species}: {result.words}")
    for heading in ("measure", "value [95 % interval]", "null", "remark"):
        table.add_column(heading)
    for key, title in titles(result).items():
        measured = result.by_measure[key]
        value = with_interval(interval(measured))
        table.add_row(title, value, number(measured["null"]), measured["reason"])
    console.print(table)
    console.print(
        f"{result.rollouts} rollouts from {result.starts} test starts; intervals cover "
        f"{result.covers}."
    )


@app.command("starts")
@with_help(
    name=typer.Argument(metavar="SET", help="A set of the challenge, such as fly."),
    out="The file to write, .csv.",
    data="The demonstrations of a set of living animals, .npz.",
)
def starts_command(name: str, out: Path = Path("starts.csv"), data: Path | None = None) -> None:
    """Write where the animals of a set of the challenge start in each test episode.

    Example:

      animarl benchmark starts fly --out starts.csv
    """
    challenge.write_starts(challenge.load_set(name, data), out)
    PlainConsole().print(f"Wrote {out}")


class StageBars:
    """Progress bars of the stages: finished pieces, failures, and about how long it will take."""

    def __init__(self, wanted: Plan, out: Path, console: Console) -> None:
        self.failed: list[tuple[Piece, str]] = []
        self.progress = Progress(
            "{task.description}",
            BarColumn(20),
            MofNCompleteColumn(),
            TimeRemainingColumn(),
            TextColumn("{task.fields[failures]}", markup=False),
            console=console,
        )
        self._tasks: dict[str, TaskID] = {}
        for title, stage in zip(STAGES, wanted.stages):
            finished = sum(piece.finished(out) for piece in stage)
            task = self.progress.add_task(title, total=len(stage), completed=finished, failures="")
            self._tasks |= {piece.name: task for piece in stage}

    def update(self, piece: Piece, error: str) -> None:
        """Count a piece that has ended, with an error or an empty one."""
        task = self._tasks[piece.name]
        if not error:
            self.progress.advance(task)
            return
        self.failed.append((piece, error))
        failures = sum(self._tasks[other.name] == task for other, _ in self.failed)
        self.progress.update(task, failures=f"{failures} failed")


def _listing(wanted: Plan, out: Path) -> Table:
    table = Table("cell", "kind", "key", "state")
    for cell in wanted.cells:
        state = "finished" if cell.finished(out) else cell.error(out) or "to do"
        table.add_row(cell.name, cell.kind, cell.key, state)
    return table
