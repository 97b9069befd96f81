"""Many runs against the recordings they share: tables, figures, a page. Nothing is trained."""

from __future__ import annotations

import shlex
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from animarl_algos.evaluation.collect import Cue
from animarl_algos.evaluation.decisions import Decisions
from animarl_algos.evaluation.rollouts import Rollouts
from animarl_algos.evaluation.statistics import RESAMPLES
from animarl_algos.evaluation.tables import TABLES, Evaluation
from animarl_algos.evaluation.tidy import write_tables
from animarl_algos.learner.algorithm import SequenceQLearning
from animarl_algos.report.inputs import ReportInputs
from animarl_algos.report.run_page import run_page
from animarl_algos.runs.rolling_out import (
    DECISIONS,
    RANDOM,
    UNTRAINED,
    evaluate_rollouts,
    lacking,
    stored_rollouts,
    test_policies,
)
from animarl_algos.runs.run import Run, method_name
from animarl_algos.runs.run_set import RunSet
from animarl_algos.runs.run_settings import BEHAVIOUR_CLONING
from animarl_algos.runs.run_warnings import run_warnings
from animarl_algos.runs.run_world import world_in_words
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.episode import SPLITS
from animarl_envs.demos.units import unit_of
from animarl_envs.errors import InputError
from animarl_envs.files import all_files_or_none

PAGE = "report.html"


@dataclass(frozen=True, eq=False)
class EvaluatedRuns:
    """An evaluation of many runs, what it was made from, and what the runs lack, in sentences."""

    runs: RunSet
    rollouts: dict[str, Rollouts]
    evaluation: Evaluation
    lacking: tuple[str, ...]


def compare_runs(
    folders: Sequence[str | Path],
    *,
    demos: Demonstrations | None = None,
    resamples: int = RESAMPLES,
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

    Raises
    ------
    InputError
        If a folder is no run or has no rollouts, the runs differ in what is compared, or ``demos``
        are of other individuals, another time step or another arena.
    """
    runs = RunSet.open(folders)
    test = None if demos is None else new_recordings(runs, demos)
    rollouts = joined_rollouts(runs) if test is None else rolled_out_on(runs, test)
    learner = next(iter(runs.methods))
    evaluation = evaluate_rollouts(
        runs.first, rollouts, learner=learner, seed=0, demos=test, resamples=resamples
    )
    return EvaluatedRuns(runs, rollouts, evaluation, tuple(_absent(runs, rollouts)))


def new_recordings(runs: RunSet, demos: Demonstrations) -> Demonstrations:
    """Return recordings to judge runs on, all of them as a test split.

    Of the very set that the runs were trained on, only the test split is new.

    Raises
    ------
    InputError
        If they are of other individuals, another time step or another arena than the runs.
    """
    known = runs.demos
    if demos.fingerprint() == known.fingerprint():
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
    return replace(demos, split=np.full(demos.num_episodes, "test"))


def rolled_out_on(runs: RunSet, test: Demonstrations) -> dict[str, Rollouts]:
    """Return rollouts of every method of the runs from all starts of other recordings."""
    parts: dict[str, list[Rollouts]] = {name: [] for name in runs.methods}
    for run in runs.runs:
        own = method_name(run.settings.algo)
        policies = test_policies(run)
        learner = policies[own]
        assert isinstance(learner, SequenceQLearning)
        for name, policy in policies.items():
            if name == own or name not in runs.methods:
                flagged = learner.layout.condition_flag and name != RANDOM
                scenario = run.starting_from("test", demos=test)
                cue: Cue | None = "actual" if flagged else None
                made = run.roll_out(policy, name, cue, scenario=scenario)
                parts.setdefault(name, []).append(made)
    return {name: Rollouts.concatenate(some, name) for name, some in parts.items()}


def evaluate_runs(
    folders: Sequence[str | Path], out: str | Path, *, demos: Demonstrations | None = None
) -> EvaluatedRuns:
    """What :func:`compare_runs` finds, written to ``out``: all of it or nothing.

    ``out`` gets every table of the evaluation as CSV and Parquet, ``figures/`` as SVG, PNG and PDF,
    and ``report.html``. The same runs give the same bytes.

    Raises
    ------
    InputError
        As :func:`compare_runs`, or if ``out`` cannot be written or is a run folder.
    """
    refuse_run_folder(out)
    found = compare_runs(folders, demos=demos)
    records = {
        f"{name} {key}": value
        for name, some in found.runs.methods.items()
        for key, value in (("learner", some[0].record["learner"]), ("acting", _acting(some)))
    }
    inputs = report_inputs(
        found.runs,
        found.rollouts,
        found.evaluation,
        records,
        command("evaluate", folders),
        test=None if demos is None else new_recordings(found.runs, demos),
    )
    page = run_page(inputs)
    evaluation = found.evaluation
    tables = {name: getattr(evaluation, name) for name in TABLES}
    with all_files_or_none(out) as part:
        evaluation.verdict.save(part)
        write_tables(tables | {"verdict": evaluation.verdict.table}, part)
        page.write(part)
    return found


def joined_rollouts(runs: RunSet) -> dict[str, Rollouts]:
    """By method, all seeds joined: those of the runs first, then what these compare with.

    A method that a run was made for is taken from such runs alone; of what several runs hold to
    compare with, the first of each seed counts.
    """
    parts: dict[str, list[Rollouts]] = {name: [] for name in runs.methods}
    beside: dict[str, dict[int, Rollouts]] = {}
    for run in runs.runs:
        own = method_name(run.settings.algo)
        for name, rollouts in stored_rollouts(run).items():
            _refuse_stale(run, rollouts, runs)
            if name == own:
                parts[name].append(rollouts)
            elif name not in runs.methods:
                beside.setdefault(name, {}).setdefault(run.settings.seed, rollouts)
    joined = {name: Rollouts.concatenate(some, name) for name, some in parts.items()}
    return joined | {
        name: Rollouts.concatenate(list(some.values()), name) for name, some in beside.items()
    }


def report_inputs(
    runs: RunSet,
    rollouts: dict[str, Rollouts],
    evaluation: Evaluation,
    settings: Mapping[str, Any],
    command: str,
    created: str = "",
    test: Demonstrations | None = None,
) -> ReportInputs:
    """Return what a page shows; without its date it can be made again, byte for byte."""
    demos, species, first = runs.demos, runs.species, runs.first
    along = first.path / DECISIONS
    return ReportInputs(
        title=f"{species.title}: {', '.join(runs.methods)}",
        learner=next(iter(runs.methods)),
        demos=demos.select(split="test") if test is None else test,
        rollouts=rollouts,
        evaluation=evaluation,
        species=species,
        fit=first.fit,
        decisions=Decisions.load(along) if test is None and along.exists() else None,
        learning_curves=pd.concat([run.learning_curves() for run in runs.runs], ignore_index=True),
        settings={
            "world": world_in_words(species),
            "environment": first.environment_options,
            **settings,
        },
        seeds=runs.seeds,
        versions=first.record["versions"],
        command=command,
        created=created,
        episodes={split: int((demos.split == split).sum()) for split in SPLITS},
        environment=first.environment_options,
        machine=runs.machine,
        wall_time=runs.wall_time,
        warnings=tuple(sentence for run in runs.runs for sentence in run_warnings(run)),
    )


def command(name: str, folders: Sequence[str | Path], *more: str) -> str:
    """How a page of several runs is made again, wherever it is put."""
    return shlex.join(["animarl", name, *map(str, folders), *more, "--out", "OUT"])


def refuse_run_folder(out: str | Path) -> None:
    """Results of several runs are not mixed with those of one."""
    if (Path(out) / "settings.json").exists():
        raise InputError(f"{out}: it is a run folder: name another --out")


def _absent(runs: RunSet, rollouts: dict[str, Rollouts]) -> Iterator[str]:
    """What there is nothing of to compare with, each with what adds it."""
    baseline = method_name(BEHAVIOUR_CLONING)
    if baseline not in rollouts:
        asked = [sentence for run in runs.runs for sentence in lacking(run)]
        file = shlex.quote(runs.first.settings.file)
        yield from asked or [
            f"There is no {baseline} to compare with: train it with 'animarl run {file} --algo "
            f"{BEHAVIOUR_CLONING} --out RUN' and name RUN too"
        ]
    if UNTRAINED not in rollouts:
        yield (
            "There is no untrained network to compare with: 'animarl run' without --no-baselines "
            "rolls one out"
        )


def _acting(runs: Sequence[Run]) -> dict[str, str]:
    return {
        f"seed {run.settings.seed}": str(run.acting(run.settings.algo))
        for run in runs
        if run.has_policy(run.settings.algo)
    }


def _refuse_stale(run: Run, rollouts: Rollouts, runs: RunSet) -> None:
    tests = int((runs.demos.split == "test").sum())
    if rollouts.individuals != runs.demos.individuals or int(rollouts.demo.max()) >= tests:
        raise InputError(
            f"{run.path}: its rollouts of {rollouts.method} are of other recordings: make them "
            f"again with 'animarl evaluate {run.path}'"
        )
