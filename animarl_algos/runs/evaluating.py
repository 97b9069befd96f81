"""Runs rolled out, and compared with the recordings they share: tables, figures, a page.

Nothing is trained here.
"""

import shlex
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from animarl_algos.evaluation.acting_choice import MARGIN
from animarl_algos.evaluation.collect import Blindfolded, Cue, Policy, RandomPolicy
from animarl_algos.evaluation.comparison import TABLES, Evaluation, evaluate, write_tables
from animarl_algos.evaluation.rollouts import Rollouts
from animarl_algos.evaluation.verdict import Verdict
from animarl_algos.evaluation.verdict_rows import AS_BUILT, Questions
from animarl_algos.learner.checkpoint import summarise_error
from animarl_algos.learner.pretraining import few_or_count
from animarl_algos.learner.progress import progress_display
from animarl_algos.losses.terms import Selection
from animarl_algos.recipes.registry import named_recipe
from animarl_algos.report.inputs import ReportInputs
from animarl_algos.report.panels import SideBySide
from animarl_algos.report.run_page import run_page
from animarl_algos.runs import run_set
from animarl_algos.runs.run import Run, method_name
from animarl_algos.runs.run_files import write_json
from animarl_algos.runs.run_settings import BEHAVIOUR_CLONING
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.episode import SPLITS
from animarl_envs.demos.summary import unit_of
from animarl_envs.errors import InputError
from animarl_envs.files import all_files_or_none, read_json
from animarl_envs.fitting.result import doubts
from animarl_envs.fitting.tracking import track
from animarl_envs.scenario import Scenario
from animarl_envs.worlds import observation_components

ACTED = "acting.json"  # beside rollouts
UNTRAINED, RANDOM, BLIND = "untrained", "random", "blind"
INFORMATION = "offline/val/cross_entropy_minus_marginal"


# -- one run --------------------------------------------------------------------------------------


def roll_out(run: Run) -> dict[str, Rollouts]:
    """Roll out every method from each test start, with the true condition flag."""
    rollouts, folder = _rolled_out(run), run.path / "rollouts"
    for name, some in rollouts.items():
        some.save(folder / f"{name}.npz")
    for file in folder.glob("*.npz"):
        if file.stem not in rollouts:  # of a method that the run is no longer compared with
            file.unlink()
    write_json(folder / ACTED, {"acting": str(run.acting(run.settings.algo))})
    return rollouts


def acted_by(run: Run) -> str:
    """Return the acting rule of the run's rollouts, which may differ from its own rule."""
    return str(read_json(run.path / "rollouts" / ACTED)["acting"])


def _rolled_out(
    run: Run, scenario: Scenario | None = None, without: Collection[str] = ()
) -> dict[str, Rollouts]:
    """Return rollouts of the trained learner and of what it is compared with, if it is there.

    The methods named in ``without`` are left out.
    """
    settings, learner = run.settings, run.trained(run.settings.algo)
    cue: Cue | None = "actual" if learner.layout.condition_flag else None
    policies: dict[str, tuple[Policy, Cue | None]] = {method_name(settings.algo): (learner, cue)}
    for algo in settings.compared:
        if run.has_policy(algo) and method_name(algo) not in without:
            policies[method_name(algo)] = run.trained(algo), cue
    if settings.baselines and run.demos.is_group:
        policies[BLIND] = learner, cue
    if settings.baselines:
        untrained = run.untrained()
        policies[UNTRAINED] = untrained, cue
        policies[RANDOM] = RandomPolicy(settings.seed, untrained.policy.num_actions), None
    names = [one.name for one in observation_components(run.species)]
    rollouts = {}
    with progress_display("rollouts", "method", len(policies)) as bar:
        for name, (policy, cue) in policies.items():
            wrap = partial(Blindfolded, names=names) if name == BLIND else lambda policy: policy
            rollouts[name] = run.roll_out(policy, name, cue, scenario=scenario, wrap=wrap)
            bar.update()
    return rollouts


def missing_baselines(run: Run) -> list[str]:
    """Return the baselines that a run lacks, each with the command that adds it."""
    return [
        f"{run.path}: it has no trained {method_name(algo)} to compare with: add it with "
        f"'{run.suggested_command()}'"
        for algo in run.settings.compared
        if not run.has_policy(algo)
    ]


def uninformative_clones(run: Run) -> list[str]:
    """Return which clones are no better than predicting action frequencies, as one sentence."""
    algo = run.settings.algo
    cloning = run.record["learner"].get("offline_loss") == "cloning"
    if not cloning and named_recipe(algo).algorithm.recipe.selection is Selection.MEAN_RANK:
        return []  # its values are no logits
    tables = [pd.DataFrame()]
    for file in sorted((run.path / "logs" / algo).glob("*/progress.csv")):
        try:
            tables.append(pd.read_csv(file))
        except pd.errors.EmptyDataError:
            continue
        except (pd.errors.ParserError, UnicodeDecodeError) as error:
            raise InputError(
                f"{file}: the table cannot be read ({summarise_error(error)}): remove it, "
                "or train again"
            ) from None
    best = pd.concat(tables).filter(regex=f"^{INFORMATION}").min().sort_index()
    several = len(best) > 1
    names = [
        str(name).removeprefix(INFORMATION).removeprefix("/") or "all individuals"
        for name, value in best.items()
        if value >= 0 and not (several and name == INFORMATION)
    ]
    if not names:
        return []
    return [
        f"The clone of {few_or_count(names)} is no better than predicting action frequencies: give "
        "more demonstrations, more updates, or standardised inputs."
    ]


def far_acting_rules(run: Run) -> list[str]:
    """Return whether no acting rule came near the recordings, and whether the choice repeats."""
    file = run.acting_file(run.settings.algo)
    if not file.exists():
        return []
    choice, sentences = read_json(file), []
    if choice.get("short", 0.0) > MARGIN:  # models that were made before do not say
        sentences.append(
            "No candidate of the acting rules came as near to a recording as other recordings do "
            f"({choice['short']:.1f} standard errors short, on training and validation episodes): "
            "treat the simulator with care."
        )
    if not choice.get("repeats", True):
        sentences.append(
            "The choice of the acting rule did not repeat with other random numbers: candidates "
            "are as near, or there are too few recordings to tell."
        )
    return sentences


# -- several runs ---------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class EvaluatedRuns:
    """Runs, and their rollouts by method, beside the recordings that they are tested on.

    ``folds`` are those of a cross-validation, in which all recordings are tested; ``new`` are other
    recordings than those of the runs. ``seed`` is that of all resampling.
    """

    runs: run_set.RunSet
    rollouts: dict[str, Rollouts]
    folds: Sequence[Run] = ()
    new: Demonstrations | None = None
    seed: int = 0
    questions: Questions = AS_BUILT

    @property
    def learner(self) -> str:
        """The method that a page is about: that of the first run."""
        return next(iter(self.runs.methods))

    @cached_property
    def test(self) -> Demonstrations:
        """The recordings that rollouts are compared with."""
        if self.folds:
            return run_set.all_tested(self.runs.demos)
        return self.runs.demos.select(split="test") if self.new is None else self.new

    @cached_property
    def evaluation(self) -> Evaluation:
        """The rollouts measured and compared with the recordings.

        Beside them stand the recordings as the fitted locomotion follows them.
        """
        known, species = self.runs.demos, self.runs.species
        others: Demonstrations | None = known
        if self.folds:
            others, floor = None, run_set.joined_tracking(self.folds)
        else:
            floor = track(self.test, species.locomotion, species.arena)
            if self.new is None:
                others = known.select(episodes=np.flatnonzero(known.split != "test"))
        return evaluate(
            self.rollouts,
            self.test,
            seed=self.seed,
            floor=floor,
            learner=self.learner,
            references=others,
            questions=self.questions,
        )

    @cached_property
    def missing_baselines(self) -> list[str]:
        """Baselines that are missing, each with the command that adds it, in sentences."""
        baseline, sentences = method_name(BEHAVIOUR_CLONING), []
        if baseline not in self.rollouts:
            file = shlex.quote(self.runs.first.settings.file)
            sentences = [
                sentence for run in self.runs.runs for sentence in missing_baselines(run)
            ] or [
                f"There is no {baseline} to compare with: train it with 'animarl run {file} --algo "
                f"{BEHAVIOUR_CLONING} --out RUN' and name RUN too"
            ]
        if UNTRAINED not in self.rollouts:
            sentences.append(
                "There is no untrained network to compare with: 'animarl run' without "
                "--no-baselines rolls one out"
            )
        return sentences


def compare_runs(
    folders: Sequence[str | Path],
    *,
    demos: Demonstrations | None = None,
    questions: Questions = AS_BUILT,
) -> EvaluatedRuns:
    """Methods times seeds against the recordings of the test split that all started from.

    The methods are those of the runs; beside them stand those that the runs hold to compare with
    (BC, an untrained network, chance), as far as they are there.

    Parameters
    ----------
    folders
        Run folders, with their rollouts.
    demos
        Other recordings of the same animals to judge the trained policies on, which are then rolled
        out from all of their starts; by default the test split of the runs.
    questions
        Tolerances and primary measures of the user's choice.

    Raises
    ------
    InputError
        If a folder is no run or has no rollouts, the runs differ in what is compared, or ``demos``
        are of other individuals, another time step or another arena.
    """
    runs = run_set.RunSet.open(folders)
    new = None if demos is None else _new_recordings(runs, demos)
    folds = [run_set.trained_folds(run) if new is None else () for run in runs.runs]
    crossed = bool(folds[0]) and len({len(some) for some in folds}) == 1
    # A method that runs were made for is taken from these alone; of what several runs hold to
    # compare with, the first of each seed counts.
    parts: dict[str, dict[int, Rollouts]] = {name: {} for name in runs.methods}
    for run, own_folds in zip(runs.runs, folds):
        if crossed:
            rolled_out = run_set.joined_rollouts(own_folds)
        elif new is None:
            rolled_out = _stored_rollouts(run, runs)
        else:
            rolled_out = _rolled_out(
                run, run.starting_from("test", demos=new), without=runs.methods
            )
        own = method_name(run.settings.algo)
        for name, some in rolled_out.items():
            if name == own or name not in runs.methods:
                parts.setdefault(name, {}).setdefault(run.settings.seed, some)
    rollouts = {name: Rollouts.concatenate(list(p.values()), name) for name, p in parts.items()}
    return EvaluatedRuns(runs, rollouts, folds[0] if crossed else (), new, questions=questions)


def _new_recordings(runs: run_set.RunSet, demos: Demonstrations) -> Demonstrations:
    """Return recordings to judge runs on, all of them as a test split.

    Of the very set that the runs were trained on, only the test split is new.
    """
    known = runs.demos
    if len(demos) == len(known) and (
        replace(demos, split=known.split).fingerprint() == known.fingerprint()
    ):
        return known.select(split="test")
    for what, here, there in (
        ("individuals", demos.individuals, known.individuals),
        ("roles", demos.roles, known.roles),
        ("time step", demos.dt, known.dt),
        ("arena", demos.arena, known.arena),
        ("unit", unit_of(demos).name, unit_of(known).name),
    ):
        if here != there:
            raise InputError(
                f"--demos {demos.name}: its {what} ({here}) differs from that of the runs "
                f"({there}): give recordings of the same animals, imported in the same way"
            )
    return run_set.all_tested(demos)


def _stored_rollouts(run: Run, runs: run_set.RunSet) -> dict[str, Rollouts]:
    stored, tests = run.rollouts(), int((runs.demos.split == "test").sum())
    for rollouts in stored.values():
        if rollouts.individuals != runs.demos.individuals or int(rollouts.demo.max()) >= tests:
            raise InputError(
                f"{run.path}: its rollouts of {rollouts.method} are of other recordings: make "
                f"them again with 'animarl evaluate {run.path}'"
            )
    return stored


# -- pages ----------------------------------------------------------------------------------------


def evaluate_runs(
    folders: Sequence[str | Path],
    out: str | Path,
    *,
    demos: Demonstrations | None = None,
    questions: Questions = AS_BUILT,
) -> EvaluatedRuns:
    """Write the results of :func:`compare_runs` to ``out``: all of them or nothing.

    ``out`` gets every table of the evaluation as CSV and Parquet, ``figures/`` as SVG and
    ``report.html``. The same runs give the same bytes.

    Raises
    ------
    InputError
        As :func:`compare_runs`, or if ``out`` cannot be written or is a run folder.
    """
    refuse_run_folder(out)
    evaluated = compare_runs(folders, demos=demos, questions=questions)
    settings: dict[str, Any] = {}
    for name, some in evaluated.runs.methods.items():
        settings[f"{name} learner"] = some[0].record["learner"]
        settings[f"{name} acting"] = {
            f"seed {run.settings.seed}": str(run.acting(run.settings.algo))
            if evaluated.new is not None
            else acted_by(run)
            for run in some
        }
    evaluation, made_by = evaluated.evaluation, command("evaluate", folders)
    tables = {name: getattr(evaluation, name) for name in TABLES}
    with all_files_or_none(out) as part:
        evaluation.verdict.save(part)
        write_tables(tables | {"verdict": evaluation.verdict.table}, part)
        run_page(report_inputs(evaluated, evaluation, settings, made_by)).write(part)
    return evaluated


def figure_sides(run: Run) -> SideBySide:
    """Return recordings and rollouts of a run for its figures.

    These are its saved rollouts and verdict where it was evaluated; else it is simulated.
    """
    if not (run.path / "rollouts").is_dir():
        return SideBySide(run.demos.select(split="test"), run.simulate())
    folds = run_set.trained_folds(run)
    rollouts = run_set.joined_rollouts(folds) if folds else run.rollouts()
    runs = EvaluatedRuns(run_set.RunSet.of(run), rollouts, folds)
    verdict = None
    if (run.path / "evaluation" / "verdict.json").exists():
        verdict = Verdict.load(run.path / "evaluation")
    return SideBySide(runs.test, rollouts[runs.learner], verdict)


def report_inputs(
    evaluated: EvaluatedRuns,
    evaluation: Evaluation,
    settings: Mapping[str, Any],
    command: str,
    created: str = "",
) -> ReportInputs:
    """Return what a page shows; without its date it can be made again, byte for byte."""
    runs = evaluated.runs
    demos, known, warnings = runs.demos, runs.page_inputs(), []
    for run in runs.runs:  # the terminal says the same while a run is made
        warnings += doubts(run.fit, run.learnable_demos)
        warnings += [*uninformative_clones(run), *far_acting_rules(run)]
    return ReportInputs(
        title=f"{runs.species.title}: {', '.join(runs.methods)}",
        learner=evaluated.learner,
        demos=evaluated.test,
        rollouts=evaluated.rollouts,
        evaluation=evaluation,
        settings={"world": known["world"], "environment": known["environment"], **settings},
        seeds=tuple(sorted({run.settings.seed for run in runs.runs})),
        command=command,
        created=created,
        folds=len(evaluated.folds),
        episodes={split: int((demos.split == split).sum()) for split in SPLITS},
        warnings=tuple(warnings),
        **known,
    )


def command(name: str, folders: Sequence[str | Path], *more: str) -> str:
    """Return how a page of several runs is made again, wherever it is put."""
    return shlex.join(["animarl", name, *map(str, folders), *more, "--out", "OUT"])


def refuse_run_folder(out: str | Path) -> None:
    """Results of several runs are not mixed with those of one."""
    if (Path(out) / "settings.json").exists():
        raise InputError(f"{out}: it is a run folder: name another --out")
