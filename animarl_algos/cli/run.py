"""``animarl run``, ``train`` and ``report``: from recordings to a page.

What learns and draws is imported when a command runs: its help waits for none of it.
"""

from __future__ import annotations

import inspect
import math
import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, get_origin, get_type_hints

import typer
from rich.text import Text

from animarl_algos.cli import shared
from animarl_algos.cli.evaluate import DETAILS, MEASURE, PRIMARY, TOLERANCE
from animarl_algos.runs.run_settings import RunSettings, pipeline_settings, species_of_options
from animarl_envs import environment_id
from animarl_envs.errors import InputError
from animarl_envs.scenario import PACKAGED
from animarl_envs.settings import describe_fields, field_types
from animarl_envs.species import CUSTOM, SPECIES

if TYPE_CHECKING:
    from animarl_algos.runs.run import Run

WIDTH = 128
SET_BY_PRESET = ("species", "steps", "copies", "device", "fit_method", "thrusts", "acting")
"""Options that are None where they are not given."""
QUICK = {"thrusts": "1", "acting": "boltzmann:1"}
QUICK_EPOCHS = 6
OTHERS = {
    "choose_by": shared.option(
        "choose_by",
        list[str] | None,
        None,
        "FILE.py:FUNCTION as --measure; the choice of acting judges rollouts by it, too. "
        "Repeatable.",
    ),
    "context": shared.CONTEXT,
    "details": shared.option("details", bool, False, DETAILS),
    "env": shared.option(
        "env",
        str | None,
        None,
        "Environment id, such as AnimaRL/Fly-v0: learn in this world as it is, with the "
        "locomotion of its species; --species fits the locomotion to FILE.",
    ),
    "folds": shared.option(
        "folds",
        int | None,
        None,
        typer.Option(
            min=0,
            help="Cross-validate in so many folds, 0: never; by default in 3 where FILE is your "
            "own, its test split has fewer than 20 recordings, and all splits have 10 or more.",
        ),
    ),
    "measure": shared.option("measure", list[str] | None, None, MEASURE),
    "neighbours": shared.option(
        "neighbours",
        int | None,
        None,
        "Of a group without a target: how many of the others each one sees, the nearest.",
    ),
    "out": shared.option(
        "out",
        Path,
        Path("runs/run"),
        "Run folder; an unfinished run in it is continued.",
    ),
    "policy": shared.option(
        "policy",
        str | None,
        None,
        "GruPolicy (with a memory) or MlpPolicy (without); by default the preset's.",
    ),
    "primary": shared.option("primary", list[str] | None, None, PRIMARY),
    "processes": shared.option(
        "processes",
        int | None,
        None,
        typer.Option(
            min=1,
            help="Folds that are trained at once, and acting rules that are tried at once, by "
            "default one for each core; the results do not depend on it.",
        ),
    ),
    "quick": shared.option(
        "quick",
        bool,
        False,
        typer.Option(
            "--quick",
            help="A first answer in about a minute: one thrust magnitude, a fifth of the epochs, "
            "a fixed acting rule, no folds, nothing to compare with. Trust the full run alone.",
        ),
    ),
    "resume": shared.option(
        "resume",
        Path | None,
        None,
        "Continue this run folder, up to --steps.",
    ),
    "settings": shared.option(
        "settings",
        list[str] | None,
        None,
        typer.Option(
            "--set",
            help="A setting of the learner, KEY=VALUE, such as learning_rate=0.001; may be "
            "repeated. Names: docs/learners.md.",
        ),
    ),
    "tolerance": shared.option("tolerance", list[str] | None, None, TOLERANCE),
}
"""Options that are no field of :class:`RunSettings`."""


def _options(names: str) -> list[inspect.Parameter]:
    """Return the options of a command; those of :class:`RunSettings` are made from its fields."""
    parameters = []
    kinds, prose = get_type_hints(RunSettings), describe_fields(RunSettings, ranges=False)
    for name in names.split():
        if name in OTHERS:
            parameters.append(OTHERS[name])
            continue
        kind: Any = str if get_origin(kinds[name]) is Literal else kinds[name]
        default = getattr(RunSettings, name, None)
        if name in SET_BY_PRESET:
            kind, default = kind | None, None
        info = typer.Argument if name == "file" else typer.Option
        parameters.append(shared.option(name, kind, default, info(help=prose[name])))
    return parameters


@shared.with_options(
    _options(
        "file env species algo preset steps seed out source copies focal neighbours policy device "
        "config cloning fit_method thrusts acting repetitions folds processes baselines quick "
        "tolerance primary measure choose_by details settings"
    )
)
def run_command(**given: Any) -> None:
    """Build a simulator from recordings: fit, train, evaluate, report.

    To continue a run that was stopped, give the same command again.

    Examples:

      animarl run packaged --steps 20000 --out runs/first

      animarl run demos.npz --quick --out runs/quick

      animarl run packaged --species agent --algo dqdil --preset paper --out runs/paper

      animarl run episodes_share.npz --algo dqdil-pt --seed 0 --out runs/agents

      animarl run demos.npz --species fly --set learning_rate=0.0003 --set alpha=0.5
    """
    import joblib

    from animarl_algos.cli.fit import format_fit_table
    from animarl_algos.evaluation.headline import list_implausible
    from animarl_algos.evaluation.own_measures import register_measures
    from animarl_algos.evaluation.verdict_rows import Questions
    from animarl_algos.report.inputs import duration
    from animarl_algos.report.verdict_section import evaluation_table, verdict_lines, verdict_table
    from animarl_algos.report.words import Words
    from animarl_algos.runs import pipeline
    from animarl_algos.runs.evaluating import far_acting_rules
    from animarl_algos.runs.run_set import ENOUGH_TESTED
    from animarl_algos.runs.run_world import CELLS
    from animarl_envs.fitting.result import doubts

    console = shared.PlainConsole(WIDTH)

    def begin(number: str, what: str) -> None:
        console.print(Text.assemble("\n", (number, "bold"), f" {what}"))

    def warn(sentences: list[str]) -> None:
        for sentence in sentences:
            console.print(f"WARNING: {sentence}", style="bold yellow")

    register_measures(given["measure"])
    register_measures(given["choose_by"], chooses=True)
    questions = Questions.parse(given["tolerance"] or (), given["primary"] or ())
    run, folds = _open(given)
    questions.check(run.demos)
    begin("1/4", "fitting locomotion")
    fit = pipeline.fit(run)
    console.print(format_fit_table(fit, run.demos))
    warn(doubts(fit, run.demos))
    begin("2/4", f"training {run.settings.algo.upper()}")
    if reason := run.record.get("reasons", {}).get("cloning"):
        console.print(f"recipe {run.settings.cloning} (another: --cloning): {reason}")
    processes = given["processes"] or joblib.cpu_count()
    pipeline.learn_all(run, processes=processes)
    tested = "the test split"
    if folds:
        processes = min(processes, folds - 1)
        tested = f"all recordings, each by a simulator that was trained without it ({folds} folds)"
        if given["folds"] is None:
            training = sum(s for stage, s in run.wall_times().items() if "training" in stage)
            left = duration(math.ceil((folds - 1) / processes) * training)
            console.print(
                f"The file's test split has fewer than {ENOUGH_TESTED} recordings, too few for a "
                f"verdict: the run tests a third of all recordings; {folds - 1} more trainings, "
                f"about {left}, test the others (--folds 0: keep the file's split)"
            )
        pipeline.cross_validate(run, folds, processes=processes)
    begin("3/4", f"evaluating on {tested}")
    evaluation, words = pipeline.evaluate_run(run, questions), Words.of(run.demos)
    judged = evaluation.verdict
    off = list_implausible(judged.rows(), judged.worse_than_untrained)
    warn([*off, *far_acting_rules(run)])
    if given["details"]:
        console.print(evaluation_table(evaluation, words=words))
        console.print(verdict_table(judged, words))
    begin("4/4", "writing the report")
    page = pipeline.report(run)
    for line in verdict_lines(judged, words):
        console.print(line)
    console.print(f"Open {page}")
    if given["quick"]:
        console.print("This was a quick look: for a verdict to trust, run without --quick")
    folder, cells = shlex.quote(str(run.path)), run.environment_options.get(CELLS)
    sliders = f"the same with sliders: animarl page {folder}; "
    what, sliders = ("speed", "") if cells else ("thrust", sliders)
    console.print(
        f"Next: animarl whatif {folder} --change {what}=x1.2; {sliders}"
        f"for a paper: animarl figure {folder}"
    )


@shared.with_options(
    _options(
        "context file env species algo preset steps seed out resume source copies focal neighbours "
        "policy device config cloning fit_method thrusts acting choose_by settings"
    )
)
def train_command(context: typer.Context, **given: Any) -> None:
    """Fit the locomotion and train; the same command continues a run that was stopped.

    Examples:

      animarl train packaged --algo dqdil --steps 20000 --seed 1 --out runs/second

      animarl train --resume runs/second --steps 40000

      animarl train packaged --species agent --algo qr-dqcil-pt --preset paper --steps 20000

      animarl train --env AnimaRL/Agent-v0 --algo dqn --focal prey --policy MlpPolicy
    """
    from animarl_algos.evaluation.own_measures import register_measures
    from animarl_algos.runs import pipeline
    from animarl_algos.runs.run import Run

    register_measures(given["choose_by"], chooses=True)
    if given["resume"] is not None:
        _refuse_beside_resume(context)
        run = Run(given["resume"])
        run.extend(given["steps"], given["device"])
    else:
        run, _ = _open(given)
    pipeline.learn(run, run.settings.algo)
    shared.PlainConsole(WIDTH).print(f"Trained: {run.path}")


@shared.with_help(run="A run folder that was evaluated.")
def report_command(run: Path) -> None:
    """Write the report of a run again.

    Example:

      animarl report runs/agents
    """
    from animarl_algos.runs import pipeline
    from animarl_algos.runs.run import Run

    shared.PlainConsole(WIDTH).print(f"Open {pipeline.report(Run(run))}")


def _open(given: dict[str, Any]) -> tuple[Run, int]:
    """Return the run folder that a command's options ask for, and its number of folds.

    Whatever does not fit is refused before the folder is made.
    """
    from animarl_algos.recipes.registry import named_recipe
    from animarl_algos.runs import pipeline
    from animarl_algos.runs.run_set import number_of_folds

    species = species_of_options(given["env"], given["species"])
    with shared.suggest_import_on_error(given["file"], takes=(shared.SOURCE,)):
        demos = pipeline.load_demonstrations(given["file"], given["source"], species)
    # Packaged recordings keep the split that the packaged models know; so does 'train'.
    wanted = given.get("folds", 0)
    if wanted is None and (given["file"] == PACKAGED or given.get("quick")):
        wanted = 0
    folds = number_of_folds(demos, wanted)
    if species is None:
        species = demos.species if demos.species in SPECIES else CUSTOM
    overrides = shared.parse_settings(given["settings"])
    if given["neighbours"] is not None:
        worlds = overrides.setdefault("env_kwargs", {})
        overrides["env_kwargs"] = {**worlds, "neighbours": given["neighbours"]}
    if given["policy"] is not None:
        overrides["policy"] = given["policy"]
    stated = {k: v for k, v in given.items() if k in field_types(RunSettings) and v is not None}
    if given.get("quick"):
        given["folds"] = given["folds"] or 0
        stated |= {key: value for key, value in QUICK.items() if key not in stated}
        stated["baselines"] = False
        if named_recipe(given["algo"]).pretrained:
            overrides.setdefault("offline_epochs", QUICK_EPOCHS)
    stated |= {"species": species, "overrides": overrides}
    if given["env"] is not None and species != CUSTOM:
        stated.setdefault("fit_method", "species")
    learner = RunSettings.of({"steps": 1} | stated).learner()
    preset = pipeline_settings(environment_id(species), given["preset"])
    preset |= {"steps": learner.n_timesteps, "copies": learner.n_envs}
    run = pipeline.open_run(
        RunSettings.of(preset | stated), given["out"], shared.command_line(), demos, folds
    )
    return run, folds


def _refuse_beside_resume(context: typer.Context) -> None:
    """Refuse options that would change the settings of the run that ``--resume`` goes on with."""
    written = {"file": "FILE", "settings": "--set"}
    for name in context.params:
        source = context.get_parameter_source(name)
        given = source is not None and source.name == "COMMANDLINE"
        if given and name not in ("resume", "steps", "device", "choose_by"):
            flag = written.get(name, f"--{name.replace('_', '-')}")
            raise InputError(
                f"{flag} does not go with --resume, which keeps the settings of the run: "
                "give --steps only"
            )
