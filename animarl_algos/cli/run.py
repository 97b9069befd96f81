"""``animarl run``, ``train`` and ``report``: from recordings to a page.

What learns and draws is imported when a command runs: its help waits for none of it.
"""

from __future__ import annotations

import shlex
import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
import yaml
from rich.text import Text

from animarl_algos.cli.reading import SOURCE, said_with_import
from animarl_algos.cli.run_options import with_run_options
from animarl_algos.cli.screen import PlainConsole
from animarl_envs.errors import InputError

if TYPE_CHECKING:
    from animarl_algos.runs.run_folder import RunFolder


@with_run_options(before="settings")
def run_command(
    context: typer.Context,
    repetitions: Annotated[int, typer.Option(help="Rollouts per test demonstration.")] = 5,
    baselines: Annotated[
        bool, typer.Option(help="Also train BC and evaluate an untrained network and chance.")
    ] = True,
) -> None:
    """Fit, pretrain, adapt, evaluate and report: recordings in, simulator and page out.

    A run that was killed goes on when the same command is given again.

    Examples:

      animarl run packaged --steps 20000 --out runs/first

      animarl run --env AnimaRL/Agent-v0 --algo dqdil --preset paper --out runs/paper

      animarl run episodes_share.npz --algo dqdil-pt --seed 0 --out runs/agents

      animarl run demos.npz --species fly --set learning_rate=0.0003 --set alpha=0.5
    """
    from animarl_algos.cli.fit import format_fit_table
    from animarl_algos.evaluation.plausibility import implausible
    from animarl_algos.report.terminal import evaluation_table
    from animarl_algos.report.verdict_section import verdict_table
    from animarl_algos.report.words import Words
    from animarl_algos.runs import pipeline
    from animarl_algos.runs.run_warnings import far_acting_rules
    from animarl_envs.fitting.doubts import doubts

    console = _console()
    run = _open(context.params)
    _say(console, "1/4", "fitting locomotion")
    fit = pipeline.fit(run)
    console.print(format_fit_table(fit, run.demos))
    for sentence in doubts(fit, run.demos):
        _warn(console, sentence)
    _say(console, "2/4", f"training {run.settings.algo.upper()}")
    pipeline.learn_all(run)
    _say(console, "3/4", "evaluating on the test split")
    evaluation = pipeline.evaluate_run(run)
    for sentence in [*implausible(evaluation.verdict), *far_acting_rules(run)]:
        _warn(console, sentence)
    console.print(evaluation_table(evaluation))
    _say(console, "4/4", "writing the report")
    page = pipeline.report(run)
    console.print(verdict_table(evaluation.verdict, Words.of(run.demos)))
    console.print(f"\nOpen {page}", soft_wrap=True, highlight=False)


@with_run_options(before="source")
def train_command(
    context: typer.Context,
    resume: Annotated[
        Path | None, typer.Option(help="Continue this run folder, up to --steps.")
    ] = None,
) -> None:
    """Train only: fit the locomotion and learn. A run that was killed is resumed exactly.

    Examples:

      animarl train packaged --algo dqdil --steps 20000 --seed 1 --out runs/second

      animarl train --resume runs/second --steps 40000

      animarl train --algo qr-dqcil-pt --env AnimaRL/Agent-v0 --preset paper --steps 20000

      animarl train --env AnimaRL/Agent-v0 --algo dqn --focal prey --policy MlpPolicy
    """
    from animarl_algos.runs import pipeline
    from animarl_algos.runs.run_folder import RunFolder

    console = _console()
    if resume is not None:
        _refuse_beside_resume(context)
        run = RunFolder(resume)
        run.extend(context.params["steps"], context.params["device"])
    else:
        run = _open(context.params)
    pipeline.learn(run, run.settings.algo)
    console.print(f"Trained: {run.path}", soft_wrap=True, highlight=False)


def report_command(
    run: Annotated[Path, typer.Argument(help="A run folder that was evaluated.")],
) -> None:
    """Write the report of a run again.

    Example:

      animarl report runs/agents
    """
    from animarl_algos.runs import pipeline
    from animarl_algos.runs.run_folder import RunFolder

    _console().print(f"Open {pipeline.report(RunFolder(run))}", soft_wrap=True, highlight=False)


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


def _open(given: dict[str, Any]) -> RunFolder:
    """The run folder that a command's parameters ask for; refused before it is made."""
    from animarl_algos.runs import pipeline
    from animarl_algos.runs.run_settings import RunSettings, asked_species, pipeline_settings
    from animarl_envs import environment_id
    from animarl_envs.species import CUSTOM, SPECIES

    file, source = given["file"], given["source"]
    species = asked_species(given["env"], given["species"])
    with said_with_import(file, takes=(SOURCE,)):
        demos = pipeline.load_demonstrations(file, source, species)
    if species is None:
        species = demos.species if demos.species in SPECIES else CUSTOM
    overrides = parse_settings(given["settings"])
    if given["policy"] is not None:
        overrides["policy"] = given["policy"]
    asked = RunSettings(
        file=file,
        source=source,
        species=species,
        algo=given["algo"],
        preset=given["preset"],
        config=None if given["config"] is None else str(given["config"]),
        steps=1 if given["steps"] is None else given["steps"],
        seed=given["seed"],
        copies=1 if given["copies"] is None else given["copies"],
        focal=given["focal"],
        device=given["device"] or "cpu",
        overrides=overrides,
        repetitions=given.get("repetitions", 5),
        baselines=given.get("baselines", True),
    )
    learner = asked.learner()
    around = pipeline_settings(environment_id(species), asked.preset)
    around |= {key: given[key] for key in around if given[key] is not None}
    asked = replace(
        asked,
        steps=learner.n_timesteps if given["steps"] is None else asked.steps,
        copies=learner.n_envs if given["copies"] is None else asked.copies,
        **around,
    )
    return pipeline.open_run(asked, given["out"], shlex.join(["animarl", *sys.argv[1:]]), demos)


def _refuse_beside_resume(context: typer.Context) -> None:
    """A resumed run has its settings: only ``--steps`` and ``--device`` go with ``--resume``."""
    for name in context.params:
        source = context.get_parameter_source(name)
        set_here = source is not None and source.name == "COMMANDLINE"
        if set_here and name not in ("resume", "steps", "device"):
            written = {"file": "FILE", "settings": "--set", "fit_method": "--fit-method"}
            option = written.get(name, f"--{name}")
            raise InputError(
                f"{option} does not go with --resume, which keeps the settings of the run: "
                "give --steps only"
            )


def _console() -> PlainConsole:
    return PlainConsole(least_width=128)


def _warn(console: PlainConsole, sentence: str) -> None:
    console.print(f"WARNING: {sentence}", style="bold yellow", soft_wrap=True, highlight=False)


def _say(console: PlainConsole, number: str, what: str) -> None:
    console.print(Text.assemble("\n", (number, "bold"), f" {what}"))
