"""``animarl whatif`` and ``animarl page``: trained runs in a changed world."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from animarl_algos.cli.shared import helps
from animarl_envs.errors import InputError
from animarl_envs.scenario import PACKAGED

if TYPE_CHECKING:
    import pandas as pd
    from rich.console import Console

    from animarl_algos.runs.run import Run
    from animarl_algos.whatif.answer import Answer

COLOURS = {"none": "none", "some": "yellow", "red": "red"}


@helps(
    runs="Run folders (training seeds of one learner), or 'fly'.",
    change=typer.Option(help="NAME=VALUE, such as prey.speed=+20%; repeatable, applied together."),
    out="Folder for tables, figures and text.",
    repetitions=typer.Option(min=1, help="Rollouts from each start."),
    separately=typer.Option("--separately", help="Apply each change by itself."),
    permutations=typer.Option(
        min=0, help="For a condition: train this many networks with shuffled conditions, as a null."
    ),
    knows=typer.Option(
        "--knows", help="Individuals perceive their changed body; by default they act as before."
    ),
)
def whatif_command(
    runs: list[Path],
    change: list[str] | None = None,
    out: Path = Path("out/whatif"),
    repetitions: int = 5,
    separately: bool = False,
    permutations: int = 0,
    knows: bool = False,
) -> None:
    """Predict what would happen in a changed world.

    The policies are not trained again. Every answer is a difference from the unchanged world with
    a 95 % interval, and a warning if inputs leave the range of training.

    What can be changed: speed, thrust, damping and start of an individual (prey.speed), of a kind
    (predators.thrust) or of all (all.damping); arena, contact and time_limit; condition=NAME, if
    the run learned from several; remove=predator_1; start=uniform; of a moth plume, wind, odour and
    the numbers of its senses. Without --change the names of this run are listed.

    Values: a factor (x1.2), a change (+20%), a value with its unit (60s, 0.15), or a sweep
    (-20%..+20%/5). Speed is the achieved mean speed: the thrust for it is found and printed.
    An answer in grey is no finding: its interval holds zero, it is smaller than the gap between the
    unchanged simulation and the recordings, or a red warning says that it is a guess. A condition
    is a finding only with --permutations 20.

    Examples:

      animarl whatif runs/first --change prey.speed=+20% --out out/faster-prey

      animarl whatif runs/s0 runs/s1 runs/s2 --change arena=x1.5 --change prey.thrust=x1.2

      animarl whatif runs/first --change prey.thrust=x0.8..x1.2/5

      animarl whatif runs/both --change condition=shared --permutations 20
    """
    from rich.console import Console

    from animarl_algos.runs.pretrained import load_run
    from animarl_algos.runs.run_files import versions
    from animarl_algos.whatif.answer import ask
    from animarl_algos.whatif.answer_page import save_answers
    from animarl_algos.whatif.changes import CONDITION, parse_scenarios

    console, change = Console(), change or []
    loaded = [load_run(run) for run in runs]
    nulls: list[Run] = []
    if permutations:
        if not any(text.partition("=")[0].strip() == CONDITION for text in change):
            raise InputError(
                "--permutations is the null of a condition and none is changed: leave it out"
            )
        from animarl_algos.runs.counterfactual import permuted_runs

        parse_scenarios(change, loaded[0].scenario.species, separately=separately)
        nulls = permuted_runs(
            loaded[0],
            out.with_name(f"{out.name}-permuted"),
            permutations,
            lambda done: console.print(f"{done} of {permutations} networks of permuted conditions"),
        )
    found = ask(
        loaded,
        change,
        permuted=nulls,
        repetitions=repetitions,
        reading="knows" if knows else "habit",
        separately=separately,
        on_baseline=lambda table: _print_unchanged(console, table),
        on_answer=lambda answer: _print(console, answer),
    )
    given = {"--repetitions": repetitions, "--permutations": permutations}
    command = [
        "animarl", "whatif", *map(str, runs), *(f"--change={text}" for text in change),
        *(f"{name}={value}" for name, value in given.items()),
        *["--separately"] * separately, *["--knows"] * knows,
    ]  # fmt: skip
    save_answers(found, out, command=shlex.join(command), versions=versions())
    console.print(f"Tables, text, figures and the page report.html: {out}", highlight=False)


@helps(
    run="A run folder, a packaged model ('fly'), or 'packaged'.",
    out="The HTML file.",
    species="With 'packaged': agent, fly, newt or silkmoth.",
)
def page_command(run: Path, out: Path = Path("what-if.html"), species: str | None = None) -> None:
    """Write one HTML file that simulates the run's animals in a browser, offline.

    Sliders change thrusts, arena, contact radius, condition and temperature; animals can be dragged
    and steered; 200 rollouts stand beside the recordings.

    Examples:

      animarl page runs/first --out what-if.html

      animarl page packaged --species agent --out what-if.html
    """
    from rich.console import Console

    from animarl_algos.runs.pretrained import load_run
    from animarl_algos.whatif.live_page import write_page

    packaged = str(run) == PACKAGED and not run.exists()
    if species is not None and not packaged:
        raise InputError(f"--species {species} goes with 'packaged': leave it out for {run}")
    file = write_page(load_run((species or "agent") if packaged else run), out)
    Console().print(f"{file}: open it in a browser", highlight=False)


def _print_unchanged(console: Console, unchanged: pd.DataFrame) -> None:
    """Print how far the unchanged simulation is from the recordings, before any answer is ready."""
    from rich.table import Table

    table = Table(title="unchanged world", title_justify="left", box=None)
    table.add_column("quantity", no_wrap=True)
    for column in ("recorded", "baseline", "gap"):
        table.add_column(column, justify="right")
    for _, row in unchanged.iterrows():
        numbers = (f"{row['recorded']:.3g}", f"{row['baseline']:.3g}", f"{row['gap']:+.3g}")
        table.add_row(f"{row['quantity']} \\[{row['unit']}]", *numbers)
    console.print(table)


def _print(console: Console, answer: Answer) -> None:
    """Print one answer as it is ready."""
    from rich.table import Table

    from animarl_algos.whatif.answer_page import asides

    table = Table(title=answer.scenario.name, title_justify="left", box=None)
    table.add_column("quantity", no_wrap=True)
    for column in ("recorded", "baseline", "changed"):
        table.add_column(column, justify="right")
    table.add_column("shift \\[95 % interval]")
    for _, row in answer.table.iterrows():
        style = "" if row["finding"] else "dim"
        table.add_row(
            row["quantity"], *(f"{row[key]:.3g}" for key in ("recorded", "baseline", "changed")),
            f"{row['shift']:+.3g} \\[{row['low']:.3g}, {row['high']:.3g}] {row['unit']}",
            style=style,
        )  # fmt: skip
    console.print(table)
    for sentence in asides(answer):
        console.print(sentence, style=COLOURS[answer.warning], highlight=False, markup=False)
