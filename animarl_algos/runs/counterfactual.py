"""Many runs asked "what if": told the other condition, beside the truth and beside the untrained.

Policies of finished runs are loaded and rolled out from the test starts. Groups of recordings
differ by chance too, and a network learns that difference as it learns a true one. An interval over
rollouts does not know of it; runs trained with permuted conditions (:func:`permuted_runs`) do.
"""

from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd

from animarl_algos.evaluation.comparison import write_tables
from animarl_algos.evaluation.effects import Answers, Asked, cue_effects
from animarl_algos.evaluation.metrics import measure, measure_recordings
from animarl_algos.evaluation.rollouts import Rollouts
from animarl_algos.evaluation.teams import teams_of
from animarl_algos.recipes.registry import named_recipe
from animarl_algos.report.counterfactual_page import CounterfactualInputs, counterfactual_page
from animarl_algos.runs import pipeline
from animarl_algos.runs.evaluating import UNTRAINED, command, refuse_run_folder
from animarl_algos.runs.run import Run, method_name
from animarl_algos.runs.run_set import RunSet
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.errors import InputError
from animarl_envs.files import all_files_or_none
from animarl_envs.scenario import Condition
from animarl_envs.species import Species

TEAM_SEED = 0
BLIND = "flag zeroed"


def ask_runs(
    folders: Sequence[str | Path],
    *,
    truth: Path | None = None,
    repetitions: int | None = None,
) -> CounterfactualInputs:
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
    test, species = runs.demos.select(split="test"), runs.species
    if not species.conditions or len(set(test.condition.tolist())) < 2:
        raise InputError(
            f"{runs.first.path}: its test recordings are all of one condition: a counterfactual "
            "needs both"
        )
    asked = {name: _ask(some, test, species, repetitions) for name, some in runs.methods.items()}
    teams = _teams(runs, test, truth, repetitions or runs.first.settings.repetitions)
    more = [] if truth is None else ["--truth", str(truth)]
    more += [] if repetitions is None else ["--repetitions", str(repetitions)]
    return CounterfactualInputs(
        demos=test,
        asked=asked,
        teams=teams,
        effects=cue_effects(asked, test, teams=teams, planned=species.planned_flip),
        seeds=runs.seeds,
        settings={name: some[0].record["learner"] for name, some in runs.methods.items()},
        command=command("counterfactual", folders, *more),
        **runs.page_inputs(),
    )


def counterfactual_runs(
    folders: Sequence[str | Path],
    out: str | Path,
    *,
    truth: Path | None = None,
    repetitions: int | None = None,
) -> CounterfactualInputs:
    """What :func:`ask_runs` finds, written to ``out``: all of it or nothing.

    ``out`` gets ``counterfactual``, ``claims`` and ``episodes`` as CSV and Parquet, ``figures/``
    as SVG, PNG and PDF, and ``report.html``. The same runs give the same bytes.
    """
    refuse_run_folder(out)
    found = ask_runs(folders, truth=truth, repetitions=repetitions)
    effects = found.effects
    tables = {"counterfactual": effects.table, "claims": effects.claims}
    with all_files_or_none(out) as part:
        tables["episodes"] = episode_table(found)
        write_tables(tables, part)
        counterfactual_page(found).write(part)
    return found


def episode_table(found: CounterfactualInputs) -> pd.DataFrame:
    """Return a row per rollout and recording, measured; ``answer`` says what was asked."""
    test = found.demos
    parts = [measure_recordings(test).assign(answer="recorded")]
    for name, one in found.asked.items():
        told = {"": one.trained, "untrained, ": one.untrained, "flag zeroed, ": one.blind}
        answers = {
            f"{kind}{what}": rollouts
            for kind, pair in told.items()
            if pair is not None
            for what, rollouts in pair._asdict().items()
        }
        if one.world is not None:
            answers["other world"] = one.world
        for answer, rollouts in answers.items():
            parts.append(measure(rollouts, test).assign(method=name, answer=answer))
    parts += [measure(team, test).assign(answer="truth") for team in found.teams or ()]
    return pd.concat(parts, ignore_index=True)


def _ask(
    runs: Sequence[Run], test: Demonstrations, species: Species, repetitions: int | None
) -> Asked:
    """Ask one method over its seeds."""
    parts: defaultdict[str, list[tuple[Rollouts, Rollouts]]] = defaultdict(list)
    worlds: list[Rollouts] = []
    accuracy: dict[int, float] = {}
    algo = runs[0].settings.algo
    name = method_name(algo)
    for run in runs:
        model = run.policy
        if not model.layout.condition_flag:
            raise InputError(
                f"{run.path}: {name} was never told the condition, so it cannot be told another: "
                "leave it out"
            )
        ask = partial(run.roll_out, repetitions=repetitions)
        parts[name].append((ask(model, name, "actual"), ask(model, name, "flipped")))
        untrained = run.untrained()
        parts[UNTRAINED].append(
            (ask(untrained, UNTRAINED, "actual"), ask(untrained, UNTRAINED, "flipped"))
        )
        # With the flag zeroed chance alone differs.
        parts[BLIND].append((ask(model, BLIND, 0), ask(model, BLIND, 0, draws=1)))
        if species.condition_is_sensed:
            conditions: tuple[Condition, ...] = (0, 1)
            for condition in conditions:  # every start, in the world of the other one, told so
                scenario = run.starting_from("test", condition)
                all_ = ask(model, name, "actual", scenario=scenario)
                worlds.append(all_.select(test.condition[all_.demo] != condition))
        found = model.demonstrated_values(model.demonstration_data().val).treatment_accuracy
        if found is not None:
            accuracy[run.settings.seed] = float(found.mean())
    answers = {
        kind: Answers(*(Rollouts.concatenate(told, kind) for told in zip(*pairs)))
        for kind, pairs in parts.items()
    }
    return Asked(
        trained=answers[name],
        untrained=answers[UNTRAINED],
        blind=answers[BLIND],
        world=Rollouts.concatenate(worlds, name) if worlds else None,
        accuracy=accuracy,
        main=named_recipe(algo).pretrained == species.pretrained_main,
    )


def _teams(
    runs: RunSet, test: Demonstrations, truth: Path | None, repetitions: int
) -> tuple[Rollouts, Rollouts] | None:
    """Return what the generating teams of both conditions do, where they are known."""
    species = runs.species
    if species.condition_is_sensed or any(run.settings.focal for run in runs.runs):
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
            species, test, name=f"team: {condition}", seed=TEAM_SEED, repetitions=repetitions
        )
        for team, condition in zip(teams, species.conditions)
    )
    return first, second


def permute_conditions(demos: Demonstrations, rng: np.random.Generator) -> Demonstrations:
    """Return demonstrations with conditions permuted among the recordings of each split."""
    condition = demos.condition.copy()
    for split in np.unique(demos.split):
        here = np.flatnonzero(demos.split == split)
        names, first, member = np.unique(
            demos.recording[here], return_index=True, return_inverse=True
        )
        own = condition[here]
        if len(names) > 1 and (own == own[first][member]).all():
            condition[here] = rng.permutation(own[first])[member]
        else:  # one recording holds both conditions: episodes are dealt
            condition[here] = rng.permutation(own)
    return replace(demos, condition=condition)


def permuted_runs(
    run: Run, folder: Path, count: int, on_trained: Callable[[int], None] | None = None
) -> list[Run]:
    """Train a run's learner ``count`` times on permuted conditions; finished ones are taken up.

    Parameters
    ----------
    folder
        Gets a run folder for each.
    on_trained
        Is told how many are trained.

    Raises
    ------
    InputError
        If the conditions change what is sensed: then they cannot be permuted.
    """
    if run.species.condition_is_sensed:
        raise InputError(
            f"the conditions of {run.species.name} change what is sensed, so recordings cannot "
            "change theirs: leave --permutations out"
        )
    settings = run.settings.changed(baselines=False, acting=str(run.acting(run.settings.algo)))
    trained = []
    for number in range(count):
        demos = permute_conditions(run.demos, np.random.default_rng([settings.seed, number]))
        own = pipeline.open_run(
            settings, folder / f"permuted-{number}", "permuted conditions", demos
        )
        pipeline.learn(own, settings.algo, progress_bar=False)
        trained.append(own)
        if on_trained is not None:
            on_trained(number + 1)
    return trained
