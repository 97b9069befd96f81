"""``animarl run``, ``train``, ``evaluate`` and ``report``: from recordings to a page."""

from __future__ import annotations

import shlex
import sys
from pathlib import Path
from typing import Annotated, Any

import typer
import yaml
from rich.console import Console

from animarl_algos import pipeline
from animarl_algos.commands.fit import format_fit_table
from animarl_algos.evaluation.evaluation import Evaluation
from animarl_algos.evaluation.terminal import evaluation_table
from animarl_algos.presets import read_section
from animarl_algos.run_folder import RunFolder, RunSettings
from animarl_envs.errors import InputError

File = Annotated[
    str, typer.Argument(help="Recorded episodes, or 'packaged' for those of the species.")
]
SourceOption = Annotated[
    str | None, typer.Option(help="Reader; by default found by a look at the file.")
]
SpeciesOption = Annotated[str, typer.Option(help="agent, fly, newt or silkmoth.")]
AlgoOption = Annotated[
    str, typer.Option(help="dqn, bc, dqaas, dqdil, dqdil-pt, dqcil, dqcil-pt, or a qr- twin.")
]
StepsOption = Annotated[int, typer.Option(help="Environment steps of the online phase.")]
SeedOption = Annotated[int, typer.Option(help="Root of all randomness.")]
OutOption = Annotated[Path, typer.Option(help="Run folder; made if absent, continued if killed.")]
CopiesOption = Annotated[int, typer.Option(help="Worlds simulated side by side.")]
SetOption = Annotated[
    list[str] | None,
    typer.Option("--set", help="A setting of the learner, KEY=VALUE; may be repeated."),
]


def run_command(
    file: File = "packaged",
    species: SpeciesOption = "agent",
    algo: AlgoOption = "dqdil-pt",
    steps: StepsOption = 100_000,
    seed: SeedOption = 0,
    out: OutOption = Path("runs/run"),
    source: SourceOption = None,
    copies: CopiesOption = 16,
    repetitions: Annotated[int, typer.Option(help="Rollouts per test demonstration.")] = 5,
    baselines: Annotated[
        bool, typer.Option(help="Also train BC and evaluate an untrained network and chance.")
    ] = True,
    settings: SetOption = None,
) -> None:
    """Fit, pretrain, adapt, evaluate and report: recordings in, simulator and page out.

    A run that was killed goes on when the same command is given again.

    Examples:

      animarl run packaged --steps 20000 --out runs/first

      animarl run episodes_share.npz --species agent --algo dqdil-pt --seed 0 --out runs/agents

      animarl run demos.npz --species fly --set learning_rate=0.0003 --set alpha=0.5
    """
    console = _console()
    run = _open(
        file, species, algo, steps, seed, out, source, copies, settings,
        repetitions=repetitions, baselines=baselines,
    )  # fmt: skip
    _say(console, "1/4", "fitting locomotion")
    console.print(format_fit_table(pipeline.fit(run), run.demos))
    _say(console, "2/4", f"training {algo.upper()}")
    pipeline.train(run, algo)
    _say(console, "3/4", "evaluating on the test split")
    evaluation = pipeline.evaluate_run(run)
    console.print(evaluation_table(evaluation))
    _say(console, "4/4", "writing the report")
    page = pipeline.report(run)
    console.print(f"\nOpen [bold]{page}[/bold]", soft_wrap=True, highlight=False)


def train_command(
    file: File = "packaged",
    species: SpeciesOption = "agent",
    algo: AlgoOption = "dqdil-pt",
    steps: StepsOption = 100_000,
    seed: SeedOption = 0,
    out: OutOption = Path("runs/run"),
    resume: Annotated[
        Path | None, typer.Option(help="Continue this run folder, up to --steps.")
    ] = None,
    source: SourceOption = None,
    copies: CopiesOption = 16,
    settings: SetOption = None,
) -> None:
    """Train only: fit the locomotion and learn.

    Examples:

      animarl train packaged --algo dqdil --steps 20000 --seed 1 --out runs/second

      animarl train --resume runs/second --steps 40000
    """
    console = _console()
    if resume is not None:
        run = RunFolder(resume)
        run.extend(steps)
    else:
        run = _open(file, species, algo, steps, seed, out, source, copies, settings)
    pipeline.train(run, run.settings.algo)
    console.print(f"Trained: {run.path}", soft_wrap=True, highlight=False)


def evaluate_command(
    run: Annotated[Path, typer.Argument(help="A run folder that was trained.")],
) -> None:
    """Roll out on the test split and compare with the recordings.

    Example:

      animarl evaluate runs/agents
    """
    _console().print(evaluation_table(pipeline.evaluate_run(RunFolder(run))))


def report_command(
    run: Annotated[Path, typer.Argument(help="A run folder that was evaluated.")],
) -> None:
    """Write the report of a run again.

    Example:

      animarl report runs/agents
    """
    folder = RunFolder(run)
    Evaluation.load(folder.path / "evaluation")
    _console().print(f"Open {pipeline.report(folder)}", soft_wrap=True, highlight=False)


def parse_settings(given: list[str] | None) -> dict[str, Any]:
    """``KEY=VALUE`` pairs; values are read as YAML data.

    Raises
    ------
    InputError
        If there is no ``=`` or the value is not valid YAML.
    """
    settings: dict[str, Any] = {}
    for pair in given or []:
        key, equals, value = pair.partition("=")
        if not equals or not key:
            raise InputError(f"--set {pair}: write KEY=VALUE")
        try:
            settings[key] = yaml.safe_load(value)
        except yaml.YAMLError as error:
            raise InputError(f"--set {pair}: the value is not valid ({error})") from error
    return settings


def _open(
    file: str,
    species: str,
    algo: str,
    steps: int,
    seed: int,
    out: Path,
    source: str | None,
    copies: int,
    settings: list[str] | None,
    **more: Any,
) -> RunFolder:
    asked = RunSettings(
        file=file,
        source=source,
        species=species,
        algo=algo,
        steps=steps,
        seed=seed,
        copies=copies,
        test_epsilon=float(read_section("evaluation", species)["test_epsilon"]),
        overrides=parse_settings(settings),
        **more,
    )
    return pipeline.open_run(asked, out, shlex.join(["animarl", *sys.argv[1:]]))


def _console() -> Console:
    console = Console()
    console.width = max(console.width, 100)
    return console


def _say(console: Console, number: str, what: str) -> None:
    console.print(f"\n[bold]{number}[/bold] {what}")
