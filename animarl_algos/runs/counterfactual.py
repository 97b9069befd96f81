"""Many runs asked "what if": told the other condition, beside the truth and beside the untrained.

Nothing is trained: policies of finished runs are loaded and rolled out from the test starts.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import pandas as pd

from animarl_algos.evaluation.collect import Policy
from animarl_algos.evaluation.effects import Answers, Asked, Effects, cue_effects
from animarl_algos.evaluation.metrics import measure, measure_recordings
from animarl_algos.evaluation.rollouts import Rollouts
from animarl_algos.evaluation.statistics import RESAMPLES
from animarl_algos.evaluation.teams import teams_of
from animarl_algos.evaluation.tidy import write_tables
from animarl_algos.learner.algorithm import SequenceQLearning
from animarl_algos.recipes.registry import named_recipe
from animarl_algos.report.counterfactual_page import counterfactual_page
from animarl_algos.report.inputs import CounterfactualInputs
from animarl_algos.runs.evaluating import command, refuse_run_folder
from animarl_algos.runs.run import Run
from animarl_algos.runs.run_set import RunSet
from animarl_algos.runs.run_world import world_in_words
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.errors import InputError
from animarl_envs.files import all_files_or_none
from animarl_envs.scenario import Condition
from animarl_envs.species import Species

TEAM_SEED = 0
OTHER_DRAWS = 1


@dataclass(frozen=True, eq=False)
class CounterfactualRuns:
    """What the runs answered, and what comes of it."""

    runs: RunSet
    asked: dict[str, Asked]
    teams: tuple[Rollouts, Rollouts] | None
    effects: Effects


def ask_runs(
    folders: Sequence[str | Path],
    *,
    truth: Path | None = None,
    repetitions: int | None = None,
    resamples: int = RESAMPLES,
) -> CounterfactualRuns:
    """Ask trained runs about the other condition from every test start.

    Parameters
    ----------
    folders
        Folders of runs that were trained on demonstrations of both conditions.
    truth
        Folder of the recorded agents' weights (:func:`animarl_algos.evaluation.teams.teams_of`).
        The packaged agents' truth is known without it, and that of a searcher is its own search in
        the changed world.
    repetitions
        Rollouts from each start; by default as the runs say.

    Raises
    ------
    InputError
        If the runs differ in what is compared, are not trained, or do not know conditions.
    """
    runs = RunSet.open(folders)
    test = runs.demos.select(split="test")
    if not runs.species.conditions or len(set(test.condition.tolist())) < 2:
        raise InputError(
            f"{runs.first.path}: its test recordings are all of one condition: a counterfactual "
            "needs both"
        )
    asked = {
        name: _ask(some, test, runs.species, repetitions) for name, some in runs.methods.items()
    }
    teams = _teams(runs, test, truth, repetitions or runs.first.settings.repetitions)
    effects = cue_effects(
        asked, test, teams=teams, planned=runs.species.planned_flip, resamples=resamples
    )
    return CounterfactualRuns(runs, asked, teams, effects)


def counterfactual_runs(
    folders: Sequence[str | Path],
    out: str | Path,
    *,
    truth: Path | None = None,
    repetitions: int | None = None,
) -> CounterfactualRuns:
    """What :func:`ask_runs` finds, written to ``out``: all of it or nothing.

    ``out`` gets ``counterfactual``, ``claims`` and ``episodes`` as CSV and Parquet, ``figures/``
    as SVG, PNG and PDF, and ``report.html``. The same runs give the same bytes.
    """
    refuse_run_folder(out)
    found = ask_runs(folders, truth=truth, repetitions=repetitions)
    runs = found.runs
    test = runs.demos.select(split="test")
    more = [] if truth is None else ["--truth", str(truth)]
    more += [] if repetitions is None else ["--repetitions", str(repetitions)]
    inputs = CounterfactualInputs(
        demos=test,
        species=runs.species,
        asked=found.asked,
        teams=found.teams,
        effects=found.effects,
        seeds={name: tuple(r.settings.seed for r in some) for name, some in runs.methods.items()},
        world=world_in_words(runs.species),
        environment=runs.first.environment_options,
        machine=runs.machine,
        wall_time=runs.wall_time,
        settings={name: some[0].record["learner"] for name, some in runs.methods.items()},
        versions=runs.first.record["versions"],
        command=command("counterfactual", folders, *more),
    )
    page = counterfactual_page(inputs)
    tables = {
        "counterfactual": found.effects.table,
        "claims": found.effects.claims,
        "episodes": episode_table(found, test),
    }
    with all_files_or_none(out) as part:
        write_tables(tables, part)
        page.write(part)
    return found


def episode_table(found: CounterfactualRuns, test: Demonstrations) -> pd.DataFrame:
    """Every episode with what is measured of it; ``answer`` says what was asked."""
    parts = [measure_recordings(test).assign(answer="recorded")]

    def add(rollouts: Rollouts | None, method: str, answer: str) -> None:
        if rollouts is not None:
            parts.append(measure(rollouts, test).assign(method=method, answer=answer))

    for name, one in found.asked.items():
        for kind, answers in (
            ("", one.trained), ("untrained, ", one.untrained), ("flag zeroed, ", one.blind)
        ):  # fmt: skip
            if answers is not None:
                add(answers.factual, name, f"{kind}factual")
                add(answers.flipped, name, f"{kind}flipped")
        add(one.world, name, "other world")
    for team in found.teams or ():
        add(team, team.method, "truth")
    return pd.concat(parts, ignore_index=True)


def _ask(
    runs: Sequence[Run], test: Demonstrations, species: Species, repetitions: int | None
) -> Asked:
    """One method over its seeds."""
    trained: list[Answers] = []
    untrained: list[Answers] = []
    blind: list[Answers] = []
    worlds: list[Rollouts] = []
    accuracy: dict[int, float] = {}
    name = runs[0].settings.algo.upper()
    for run in runs:
        model = run.policy
        if not model.layout.condition_flag:
            raise InputError(
                f"{run.path}: {name} was never told the condition, so it cannot be told another: "
                "leave it out"
            )
        trained.append(_both_cues(run, model, name, repetitions))
        untrained.append(_both_cues(run, run.untrained(), "untrained", repetitions))
        zeroed = [
            run.roll_out(model, "flag zeroed", 0, repetitions=repetitions, draws=draws)
            for draws in (0, OTHER_DRAWS)
        ]
        blind.append(Answers(*zeroed))
        if species.condition_is_sensed:
            worlds.append(_other_world(run, model, name, test, repetitions))
        found = model.demonstrated_values(model.demonstration_data().val).treatment_accuracy
        if found is not None:
            accuracy[run.settings.seed] = float(found.mean())
    algo = runs[0].settings.algo
    return Asked(
        trained=_joined(trained, name),
        untrained=_joined(untrained, "untrained"),
        blind=_joined(blind, "flag zeroed"),
        world=Rollouts.concatenate(worlds, name) if worlds else None,
        accuracy=accuracy,
        main=named_recipe(algo).pretrained == species.pretrained_main,
    )


def _both_cues(run: Run, policy: Policy, name: str, repetitions: int | None) -> Answers:
    return Answers(
        run.roll_out(policy, name, "actual", repetitions=repetitions),
        run.roll_out(policy, name, "flipped", repetitions=repetitions),
    )


def _other_world(
    run: Run,
    model: SequenceQLearning,
    name: str,
    test: Demonstrations,
    repetitions: int | None,
) -> Rollouts:
    """From every start, in the world of the other condition, told so."""
    parts = []
    worlds: tuple[Condition, ...] = (0, 1)
    for world in worlds:
        scenario = run.starting_from("test", world)
        everywhere = run.roll_out(model, name, "actual", scenario=scenario, repetitions=repetitions)
        parts.append(everywhere.select(test.condition[everywhere.demo] != world))
    return Rollouts.concatenate(parts)


def _joined(seeds: Sequence[Answers], name: str) -> Answers:
    return Answers(
        Rollouts.concatenate([one.factual for one in seeds], name),
        Rollouts.concatenate([one.flipped for one in seeds], name),
    )


def _teams(
    runs: RunSet, test: Demonstrations, truth: Path | None, repetitions: int
) -> tuple[Rollouts, Rollouts] | None:
    """What the generating teams of both conditions do, where they are known."""
    if runs.species.condition_is_sensed or any(run.settings.focal for run in runs.runs):
        if truth is not None:
            raise InputError(
                f"--truth {truth}: teams are the truth of chases in which everybody learned: "
                "leave it out"
            )
        return None
    teams = teams_of(test, truth)
    if teams is None:
        return None
    first, second = (
        team.roll_out(
            runs.species, test, name=f"team: {condition}", seed=TEAM_SEED, repetitions=repetitions
        )
        for team, condition in zip(teams, runs.species.conditions)
    )
    return first, second
