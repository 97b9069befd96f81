"""``animarl evaluate``, ``counterfactual``, ``inspect``, ``export``: what is made of trained runs.

What they look with is imported when they run: their help waits for none of it.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from typer import Option

from animarl_algos.cli.shared import PlainConsole, helps
from animarl_envs.errors import InputError

WIDTH = 128
RUNS = "Run folders, of methods and seeds."
OUT = "Folder for tables, figures and report.html."


@helps(
    runs=RUNS,
    out=OUT,
    acting="Without --out: acting rule, greedy, boltzmann:TEMPERATURE or epsilon:SHARE; by "
    "default the run's.",
    demos="With --out: other recordings of the same animals to evaluate on, an .npz of 'animarl "
    "import' or the name of a packaged set.",
)
def evaluate_command(
    runs: list[Path],
    out: Path | None = None,
    acting: str | None = None,
    demos: str | None = None,
) -> None:
    """Compare trained runs with their recordings and with each other.

    With --out, the saved rollouts of all runs are compared, and the runs are not changed. Without
    it, one run is rolled out again on its test split and evaluated in its own folder. Nothing is
    trained: if a run lacks something, the command that adds it is printed.

    Examples:

      animarl evaluate runs/agents

      animarl evaluate runs/bc-0 runs/bc-1 runs/dqdil-pt-0 runs/dqdil-pt-1 --out out/eval

      animarl evaluate runs/agents --demos later.npz --out out/later
    """
    from animarl_algos.report.verdict_section import evaluation_table, verdict_table
    from animarl_algos.runs import pipeline
    from animarl_algos.runs.evaluating import evaluate_runs, lacking
    from animarl_algos.runs.run import Run
    from animarl_envs.demos.demonstrations import Demonstrations
    from animarl_envs.demos.packaged import load_packaged, packaged_names

    missing: Sequence[str]
    if out is not None:
        if acting is not None:
            raise InputError(
                "--acting does not go with --out, which compares rollouts that are there: give it "
                "to 'animarl evaluate RUN'"
            )
        given = None
        if demos is not None:
            packaged = demos in packaged_names()
            given = load_packaged(demos) if packaged else Demonstrations.load(demos)
        found = evaluate_runs(runs, out, demos=given)
        evaluation, missing = found.evaluation, found.lacking
    else:
        if demos is not None:
            raise InputError("--demos needs --out: name a folder for the new evaluation")
        if len(runs) > 1:
            raise InputError(f"{len(runs)} runs are to be compared: name a folder with --out")
        run = Run(runs[0], acting)
        evaluation, missing = pipeline.evaluate_run(run), lacking(run)
    console = PlainConsole(WIDTH)
    console.print(evaluation_table(evaluation))
    console.print(verdict_table(evaluation.verdict))
    for sentence in missing:
        console.print(sentence)
    if out is not None:
        _say_page(out)


@helps(
    runs=RUNS,
    out=OUT,
    truth="Folder of the published agents' weights (indiv/p1_2.4.pth, ...), to compute the true "
    "effect; not needed for the packaged agents.",
    repetitions=Option(min=1, help="Rollouts from each start; by default the runs'."),
)
def counterfactual_command(
    runs: list[Path],
    out: Path = Path("out/counterfactual"),
    truth: Path | None = None,
    repetitions: int | None = None,
) -> None:
    """Predict the effect of the condition, and compare it with the true effect and with chance.

    Every policy gets the other condition as input, in the same world. The true effect of a chase
    is what teams trained under the other condition do. That of a search is what the same policy
    does with the other senses.

    Example:

      animarl counterfactual runs/dqcil-pt-0 runs/dqdil-pt-0 --out out/cf
    """
    from animarl_algos.runs.counterfactual import counterfactual_runs

    found = counterfactual_runs(runs, out, truth=truth, repetitions=repetitions)
    for _, row in found.effects.claims.iterrows():
        names = found.species.conditions
        said = "an effect of the cue" if row["worded"] else f"nothing is claimed: {row['reason']}"
        flip = f"{names[row['condition']]} -> {names[row['told']]}"
        PlainConsole(WIDTH).print(f"{row['method']}, {flip}: {said}")
    _say_page(out)


@helps(
    run="A run folder that was evaluated.",
    episode=Option(min=0, help="Number of the demonstration in the test split, from 0."),
    out=OUT,
)
def inspect_command(run: Path, episode: int, out: Path = Path("out/inspect")) -> None:
    """Show one test recording beside rollouts from its start, with the action values.

    Example:

      animarl inspect runs/agents --episode 3 --out out/inspect
    """
    from animarl_algos.runs.inspecting import inspect_run

    inspect_run(run, episode, out)
    _say_page(out)


@helps(
    run="Run folder, trained and evaluated.",
    out=Option(help="Folder of the model."),
    demonstrations=Option(
        "--with-demonstrations",
        help="Include the recordings; a model cannot be loaded without them.",
    ),
)
def export_command(run: Path, out: Path, demonstrations: bool = False) -> None:
    """Export a trained policy with a model card; weights are safetensors, the rest is JSON.

    The folder loads like the run: animarl watch --model FOLDER, or in Python
    animarl_algos.load_pretrained(FOLDER).

    Example:

      animarl export out/demo --out out/agent-model
    """
    from animarl_algos.runs.pretrained import CARD, export_run
    from animarl_algos.runs.run import Run

    folder = export_run(Run(run), out, with_demonstrations=demonstrations)
    size = sum(file.stat().st_size for file in folder.rglob("*") if file.is_file()) / 1e6
    PlainConsole(WIDTH).print(f"Wrote {folder} ({size:.2f} MB); read {folder / CARD}")


def _say_page(out: Path) -> None:
    from animarl_algos.report.page import PAGE_FILE

    PlainConsole(WIDTH).print(f"Open {out / PAGE_FILE}")
