"""``animarl paper``: the tables and figures of the paper, made anew."""

import shutil
from pathlib import Path

import typer
from rich.table import Table

from animarl_algos.benchmark.matrix import Plan, claim_folder
from animarl_algos.benchmark.paper import LEARNERS, SETTINGS, SPECIES, Scope
from animarl_algos.benchmark.paper_page import RESULTS, estimate, write_page
from animarl_algos.benchmark.paper_tables import Findings
from animarl_algos.benchmark.pieces import perform_all
from animarl_algos.cli.benchmark import StageBars
from animarl_algos.cli.shared import PlainConsole, with_help
from animarl_envs.errors import InputError

KEPT = Path("docs") / RESULTS


@with_help(
    out="Folder of the page and its cells; finished cells in it are kept, also those of 'animarl "
    "benchmark'.",
    species=f"Only these: {', '.join(SPECIES)}; repeatable.",
    only=f"Only these learners: {', '.join(LEARNERS)}; repeatable.",
    setting=f"Only these: {', '.join(SETTINGS)} (two worlds, clones that adapt, "
    "departures from published settings); repeatable.",
    seed="Training seeds; repeatable; default 0, 1, 2.",
    steps="Steps of the online phase in both worlds; by default the paper's.",
    processes="Number of processes, one thread each.",
    hours="Refuse to begin if it would take longer.",
    quick="A try of some minutes: few episodes and steps, one seed.",
    kept="Folder of committed records, which stand for cells that are not in --out.",
    docs="Folder to copy page, tables, figures and records to, such as docs.",
    show=typer.Option("--list", help="List cells and estimate, and stop."),
    page=typer.Option("--page", help="Write the page of what is there; train nothing."),
)
def paper_command(
    out: Path = Path("out/paper"),
    species: list[str] | None = None,
    only: list[str] | None = None,
    setting: list[str] | None = None,
    seed: list[int] | None = None,
    steps: int | None = None,
    processes: int = 1,
    hours: float | None = None,
    quick: bool = False,
    kept: Path = KEPT,
    docs: Path | None = None,
    show: bool = False,
    page: bool = False,
) -> None:
    """Make the paper's tables and figures anew, beside its published values.

    Given again, the same command goes on; Ctrl-C loses nothing. Cells are those of 'animarl
    benchmark' with preset paper.

    Examples:

      animarl paper --quick --out out/quick

      animarl paper --out out/paper --processes 2

      animarl paper --species silkmoth --setting onset --list

      animarl paper --page --docs docs
    """
    if processes < 1:
        raise InputError(f"processes is {processes}: it must be at least 1")
    scope = Scope(
        species=tuple(species or SPECIES),
        learners=tuple(only or LEARNERS),
        settings=tuple(setting or SETTINGS),
        seeds=tuple(seed or ((0,) if quick else (0, 1, 2))),
        steps=steps,
        quick=quick,
    )
    claim_folder(out, mark=not show)
    console = PlainConsole(least_width=100)
    there = [(one, *one.find_record(out, kept)) for one in scope.cells]
    left = [one for one, record, _ in there if record is None]
    seconds = estimate(left) / processes
    console.print(
        f"{len(there) - len(left)} of {len(there)} cells are there; the rest takes about "
        f"{seconds / 60:.0f} minutes with --processes {processes}."
    )
    if show:
        table = Table("cell", "steps", "state")
        for one, record, was_kept in there:
            state = "to do" if record is None else "kept" if was_kept else "finished"
            table.add_row(one.name, f"{one.steps:,}", state)
        console.print(table)
        return
    if hours is not None and not page and seconds > 3600 * hours:
        raise InputError(
            f"--hours {hours:g}: the cells take about {seconds / 3600:.1f} hours: give more, or "
            "fewer --species, --only, --setting, --seed or --steps"
        )
    failed = []
    if left and not page:
        worlds = {world.key: world for one in left for world in one.plan.worlds}
        cells = tuple(one.cell for one in left)
        remaining = Plan(left[0].plan.matrix, tuple(worlds.values()), cells, ())
        bars = StageBars(remaining, out, console)
        with bars.progress:
            for piece, error in perform_all(remaining.stages, out, processes):
                bars.update(piece, error)
        failed = bars.failed
        there = [(one, *one.find_record(out, kept)) for one in scope.cells]
    for piece, error in failed:
        console.print(f"\n{piece.name} failed: {error}")
    findings = Findings(scope, there)
    written = write_page(findings, out)
    if docs is not None:
        write_page(findings, docs)
        for one, record, was_kept in there:
            if record is not None and not was_kept:
                shutil.copyfile(one.record_file(out), docs / RESULTS / f"{one.name}.npz")
    console.print(f"\nOpen {written}")
    if failed:
        raise typer.Exit(1)
