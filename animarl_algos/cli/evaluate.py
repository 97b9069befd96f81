"""What is made of trained runs: ``animarl evaluate``, ``whatif`` and others.

What they look with is imported when they run: their help waits for none of it.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from typer import Option

from animarl_algos.cli.shared import PlainConsole, command_line, load, with_help
from animarl_envs.errors import InputError
from animarl_envs.scenario import PACKAGED

if TYPE_CHECKING:
    from animarl_algos.runs.run import Run
    from animarl_algos.whatif.answer import Answer

WIDTH = 128
RUNS = "Run folders, of methods and seeds."
OUT = "Folder for tables, figures and report.html."
TOLERANCE = Option(
    help="NAME=NUMBER: how much of this measure may differ and still count as alike; repeatable."
)
PRIMARY = Option(help="A measure chosen before looking, tested at a level of its own; repeatable.")
MEASURE = Option(
    help="FILE.py:FUNCTION, a measure of your own of positions, dt and roles; the file is run. "
    "Repeatable."
)
DETAILS = Option("--details", help="Print the tables.")
COLOURS = {"none": "none", "some": "yellow", "red": "red"}


@with_help(
    runs=RUNS,
    out=OUT,
    acting="Without --out: acting rule, greedy, boltzmann:TEMPERATURE or epsilon:SHARE; by "
    "default the run's.",
    demos="With --out: other recordings of the same animals to evaluate on, an .npz of 'animarl "
    "import' or the name of a packaged set.",
    tolerance=TOLERANCE,
    primary=PRIMARY,
    measure=MEASURE,
    details=DETAILS,
)
def evaluate_command(
    runs: list[Path],
    out: Path | None = None,
    acting: str | None = None,
    demos: str | None = None,
    tolerance: list[str] | None = None,
    primary: list[str] | None = None,
    measure: list[str] | None = None,
    details: bool = False,
) -> None:
    """Compare trained runs with their recordings and with each other.

    With --out, the saved rollouts of all runs are compared, and the runs are not changed. Without
    it, one run is rolled out again on its test split and evaluated in its own folder, with its
    page. Nothing is
    trained: if a run lacks something, the command that adds it is printed.

    Examples:

      animarl evaluate runs/agents

      animarl evaluate runs/bc-0 runs/bc-1 runs/dqdil-pt-0 runs/dqdil-pt-1 --out out/eval

      animarl evaluate runs/agents --demos later.npz --out out/later

      animarl evaluate runs/agents --primary speed --tolerance turning=0.2 --details
    """
    from animarl_algos.evaluation.own_measures import register_measures
    from animarl_algos.evaluation.verdict_rows import Questions
    from animarl_algos.report.page import PAGE_FILE
    from animarl_algos.report.verdict_section import evaluation_table, verdict_lines, verdict_table
    from animarl_algos.report.words import Words
    from animarl_algos.runs import pipeline
    from animarl_algos.runs.evaluating import evaluate_runs, missing_baselines
    from animarl_algos.runs.run import Run

    missing: Sequence[str]
    register_measures(measure)
    questions = Questions.parse(tolerance or (), primary or ())
    if out is not None:
        if acting is not None:
            raise InputError(
                "--acting does not go with --out, which compares rollouts that are there: give it "
                "to 'animarl evaluate RUN'"
            )
        new = None if demos is None else load(demos)
        evaluated = evaluate_runs(runs, out, demos=new, questions=questions)
        evaluation, missing = evaluated.evaluation, evaluated.missing_baselines
        words, page = Words.of(evaluated.test), out / PAGE_FILE
    else:
        if demos is not None:
            raise InputError("--demos needs --out: name a folder for the new evaluation")
        if len(runs) > 1:
            raise InputError(f"{len(runs)} runs are to be compared: name a folder with --out")
        run = Run(runs[0], acting)
        evaluation = pipeline.evaluate_run(run, questions)
        missing, words = missing_baselines(run), Words.of(run.demos)
        page = pipeline.report(run)
    console = PlainConsole(WIDTH)
    if details:
        console.print(evaluation_table(evaluation, words))
        console.print(verdict_table(evaluation.verdict, words))
    for line in verdict_lines(evaluation.verdict, words):
        console.print(line)
    for sentence in missing:
        console.print(sentence)
    console.print(f"Open {page}")


@with_help(
    run="Run folder, trained and evaluated.",
    out=Option(help="Folder of the model."),
    demonstrations=Option(
        "--with-demonstrations",
        help="Include the recordings; without tracks a model cannot be loaded.",
    ),
    simulated=Option(
        "--simulated", help="Include tracks that it simulates, in the place of the recordings."
    ),
)
def export_command(
    run: Path, out: Path, demonstrations: bool = False, simulated: bool = False
) -> None:
    """Export a trained policy with a model card; weights are safetensors, the rest is JSON.

    The folder loads like the run: animarl watch --model FOLDER, or in Python
    animarl_algos.load_pretrained(FOLDER). Where the recordings may not be given away, --simulated
    makes it load without them.

    Example:

      animarl export out/demo --out out/agent-model
    """
    from animarl_algos.runs.pretrained import CARD, export_run
    from animarl_algos.runs.run import Run

    folder = export_run(Run(run), out, with_demonstrations=demonstrations, simulated=simulated)
    size = sum(file.stat().st_size for file in folder.rglob("*") if file.is_file()) / 1e6
    PlainConsole(WIDTH).print(f"Wrote {folder} ({size:.2f} MB); read {folder / CARD}")


@with_help(
    runs="Run folders (training seeds of one learner), or 'fly'.",
    change=Option(help="NAME=VALUE, such as prey.speed=+20%; repeatable, applied together."),
    out="Folder for tables, figures and text.",
    repetitions=Option(min=1, help="Rollouts from each start."),
    fold=Option(
        min=1,
        help="Of a cross-validated run, ask the simulator of this fold alone; 1 is the run itself, "
        "which its page asks. By default all.",
    ),
    separately=Option("--separately", help="Apply each change by itself."),
    permutations=Option(
        min=0, help="For a condition: train this many networks with shuffled conditions, as a null."
    ),
    truth="What made the recordings, to show the true shift too: teams (of the packaged agents), a "
    "folder of the published agents' weights (indiv/p1_2.4.pth, ...), or recordings (of the other "
    "condition).",
    knows=Option(
        "--knows", help="Individuals perceive their changed body; by default they act as before."
    ),
    second=Option(
        "--second/--no-second", help="Ask a second simulator, whose animals perceive other things."
    ),
    measure="A measure of the verdict that the table has too, such as share_at_rest, or all; or "
    "FILE.py:FUNCTION, a measure of your own (the file is run). Repeatable.",
)
def whatif_command(
    runs: list[Path],
    change: list[str] | None = None,
    out: Path = Path("out/whatif"),
    repetitions: int = 5,
    fold: int | None = None,
    separately: bool = False,
    permutations: int = 0,
    truth: str | None = None,
    knows: bool = False,
    second: bool = True,
    measure: list[str] | None = None,
) -> None:
    """Predict what would happen in a changed world.

    The policies are not trained again. Of a run that was cross-validated, the policies of all folds
    answer together. Every answer is a difference from the unchanged world with a 95 % interval, and
    a warning if inputs leave the range of training. A second simulator, whose animals perceive
    other things, is trained once and asked the same: where both disagree, the recordings cannot
    tell.

    What can be changed: speed, thrust, damping and start of an individual (prey.speed), of a kind
    (predators.thrust) or of all (all.damping); arena, contact and time_limit; condition=NAME, if
    the run learned from several; remove=predator_1; obstacle=0.3,0,0.1 (x, y and radius);
    start=uniform; of a moth plume, wind, odour and the numbers of its senses. Without --change the
    names of this run are listed.

    Values: a factor (x1.2), a change (+20%), a value with its unit (60s, 0.15), or a sweep
    (-20%..+20%/5). Speed is the achieved mean speed: the thrust for it is found and printed.
    An answer in grey is no finding: its interval holds zero, it is smaller than the gap between the
    unchanged simulation and the recordings, or a red warning says that it is a guess. A condition
    is a finding only with --permutations 20.

    Examples:

      animarl whatif runs/first --change prey.speed=+20% --out out/faster-prey

      animarl whatif runs/s0 runs/s1 runs/s2 --change arena=x1.5 --change prey.thrust=x1.2

      animarl whatif runs/first --change prey.thrust=x0.8..x1.2/5

      animarl whatif runs/both --change condition=shared --permutations 20 --truth recordings
    """
    from animarl_algos.evaluation.own_measures import register_measures
    from animarl_algos.report.verdict_section import terminal_table
    from animarl_algos.report.words import Words
    from animarl_algos.runs import run_set
    from animarl_algos.runs.permuted import permuted_runs, second_run
    from animarl_algos.runs.pretrained import load_run
    from animarl_algos.runs.run_files import versions
    from animarl_algos.whatif.answer import ask, check_changes
    from animarl_algos.whatif.answer_page import (
        cut_note,
        measures_note,
        rollouts_note,
        save_answers,
        unchanged_table,
    )
    from animarl_algos.whatif.changes import CONDITION
    from animarl_algos.whatif.truth import find_truth
    from animarl_envs.demos.summary import stand_in_note

    own = [name for name in measure or () if ":" in name]
    register_measures(own)
    verdict_measures = [name for name in measure or () if name not in own]
    console, change = PlainConsole(WIDTH), change or []
    loaded = [load_run(run) for run in runs]
    recorded = Words.of(loaded[0].demos).adapt("recorded")
    if len(loaded) == 1:
        loaded = run_set.ensemble(loaded[0], fold)
        if len(loaded) > 1:
            console.print(
                f"The simulators of all {len(loaded)} folds answer; the page of 'animarl page' "
                "asks that of fold 1 alone, as --fold 1 does here"
            )
    elif fold is not None:
        raise InputError("--fold chooses among the folds of one run: give one run, or leave it out")
    known = None if truth is None else find_truth(truth, loaded[0], repetitions)
    check_changes(loaded, change, separately=separately, truth=known, measures=verdict_measures)
    nulls: list[Run] = []
    if permutations:
        if not any(text.partition("=")[0].strip() == CONDITION for text in change):
            raise InputError(
                "--permutations is the null of a condition and none is changed: leave it out"
            )
        nulls = permuted_runs(
            loaded[0],
            out.with_name(f"{out.name}-permuted"),
            permutations,
            lambda done: console.print(f"{done} of {permutations} networks of permuted conditions"),
        )
    other = second_run(loaded[0], change, console.print) if second else None
    answers = ask(
        loaded,
        change,
        permuted=nulls,
        second=other,
        truth=known,
        repetitions=repetitions,
        reading="knows" if knows else "habit",
        separately=separately,
        measures=verdict_measures,
        on_baseline=lambda table: console.print(
            terminal_table(unchanged_table(table, recorded), "unchanged world", wrapped=True)
        ),
        on_answer=lambda answer: _print(console, answer),
    )
    sentences = [
        *answers.unmet.values(),
        f"Each mean is of {rollouts_note(answers)}; ± is the 95 % error of their chance",
        cut_note(answers),
        stand_in_note(answers.demos),
        measures_note(answers),
    ]
    for sentence in filter(None, sentences):
        console.print(sentence)
    save_answers(answers, out, command=command_line(), versions=versions())
    console.print(f"Tables, text, figures and the page report.html: {out}")


@with_help(
    run="A run folder, a packaged model ('fly'), or 'packaged'.",
    out="The HTML file.",
    species="With 'packaged': agent, fly, newt, ...",
)
def page_command(run: Path, out: Path = Path("what-if.html"), species: str | None = None) -> None:
    """Write one HTML file that simulates the run's animals in a browser, offline.

    Sliders change thrusts, arena, contact radius, condition and temperature; animals can be dragged
    and steered; 200 rollouts stand beside the recordings.

    Examples:

      animarl page runs/first --out what-if.html

      animarl page packaged --species agent --out what-if.html
    """
    from animarl_algos.runs.pretrained import load_run
    from animarl_algos.runs.run_set import ensemble
    from animarl_algos.whatif.live_page import write_page

    packaged = str(run) == PACKAGED and not run.exists()
    if species is not None and not packaged:
        raise InputError(f"--species {species} goes with 'packaged': leave it out for {run}")
    loaded = load_run((species or "agent") if packaged else run)
    file = write_page(loaded, out, folds=len(ensemble(loaded)))
    PlainConsole().print(f"{file}: open it in a browser")


def _print(console: PlainConsole, answer: Answer) -> None:
    """Print one answer as it is ready."""
    from animarl_algos.report.verdict_section import terminal_table
    from animarl_algos.whatif.answer_page import answer_table, asides

    table = answer_table(answer, gap=False)
    console.print(terminal_table(table, answer.scenario.name, wrapped=True))
    for sentence in asides(answer):
        console.print(sentence, style=COLOURS[answer.warning])
