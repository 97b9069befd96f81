"""Many runs asked "what if": told the other condition, beside the truth and beside the untrained.

Policies of finished runs are loaded and rolled out from the test starts. Groups of recordings
differ by chance too, and a network learns that difference as it learns a true one. An interval over
rollouts does not know of it; runs trained with permuted conditions (:func:`permuted_runs`) do.
"""

from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from animarl_algos.evaluation import effects
from animarl_algos.evaluation.collect import Cue, Policy
from animarl_algos.evaluation.comparison import write_tables
from animarl_algos.evaluation.effects import FACTUAL, FLIPPED, UNTRAINED, ZEROED
from animarl_algos.evaluation.rollouts import Rollouts
from animarl_algos.evaluation.teams import teams_of
from animarl_algos.recipes.registry import named_recipe
from animarl_algos.report.counterfactual_page import CounterfactualInputs, counterfactual_page
from animarl_algos.runs import pipeline
from animarl_algos.runs.evaluating import command, refuse_run_folder
from animarl_algos.runs.run import Run, method_name
from animarl_algos.runs.run_set import RunSet
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.errors import InputError
from animarl_envs.files import all_files_or_none
from animarl_envs.scenario import Condition

TEAM_SEED = 0


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
    parts: defaultdict[tuple[str, str], list[Rollouts]] = defaultdict(list)
    accuracy: defaultdict[str, list[float]] = defaultdict(list)
    for name, some in runs.methods.items():
        for run in some:
            for answer, made in _ask(run, test, repetitions).items():
                parts[name, answer].append(made)
            found = run.policy.demonstrated_values(run.policy.demonstration_data().val)
            if found.treatment_accuracy is not None:
                accuracy[name].append(float(found.treatment_accuracy.mean()))
    teams = _teams(runs, test, truth, repetitions or runs.first.settings.repetitions)
    answers = {of: Rollouts.concatenate(each, of[0]) for of, each in parts.items()}
    answers |= {(team.method, effects.TEAM): team for team in teams}
    episodes = effects.measured_answers(test, answers)
    recipes = {name: named_recipe(some[0].settings.algo) for name, some in runs.methods.items()}
    more = [] if truth is None else ["--truth", str(truth)]
    more += [] if repetitions is None else ["--repetitions", str(repetitions)]
    return CounterfactualInputs(
        demos=test,
        answers=answers,
        teams=[team.method for team in teams],
        episodes=episodes,
        effects=effects.cue_effects(
            episodes,
            {name: own.pretrained == species.pretrained_main for name, own in recipes.items()},
            teams=[team.method for team in teams],
            accuracy=accuracy,
            planned=species.planned_flip,
        ),
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
    tables = {
        "counterfactual": found.effects.table,
        "claims": found.effects.claims,
        "episodes": found.episodes,
    }
    with all_files_or_none(out) as part:
        write_tables(tables, part)
        counterfactual_page(found).write(part)
    return found


def _ask(run: Run, test: Demonstrations, repetitions: int | None) -> dict[str, Rollouts]:
    """Return what the policy of a run does from every start, by what it answers."""
    model = run.policy
    if not model.layout.condition_flag:
        raise InputError(
            f"{run.path}: {method_name(run.settings.algo)} was never told the condition, so it "
            "cannot be told another: leave it out"
        )
    untrained = run.untrained()
    asked: dict[str, tuple[Policy, Cue, int]] = {
        FACTUAL: (model, "actual", 0),
        FLIPPED: (model, "flipped", 0),
        UNTRAINED + FACTUAL: (untrained, "actual", 0),
        UNTRAINED + FLIPPED: (untrained, "flipped", 0),
        ZEROED + FACTUAL: (model, 0, 0),
        ZEROED + FLIPPED: (model, 0, 1),  # other draws: with the flag zeroed chance alone differs
    }
    answers = {
        answer: run.roll_out(policy, answer, cue, repetitions=repetitions, draws=draws)
        for answer, (policy, cue, draws) in asked.items()
    }
    if run.species.condition_is_sensed:
        worlds: list[Rollouts] = []
        conditions: tuple[Condition, ...] = (0, 1)
        for condition in conditions:  # every start, in the world of the other one, told so
            other = run.starting_from("test", condition)
            made = run.roll_out(
                model, effects.WORLD, "actual", scenario=other, repetitions=repetitions
            )
            worlds.append(made.select(test.condition[made.demo] != condition))
        answers[effects.WORLD] = Rollouts.concatenate(worlds)
    return answers


def _teams(
    runs: RunSet, test: Demonstrations, truth: Path | None, repetitions: int
) -> list[Rollouts]:
    """Return what the generating teams of both conditions do, where they are known."""
    species = runs.species
    if species.condition_is_sensed or any(run.settings.focal for run in runs.runs):
        if truth is not None:
            raise InputError(
                f"--truth {truth}: teams are the truth of chases in which everybody learned: "
                "leave it out"
            )
        return []
    return [
        team.roll_out(
            species, test, name=f"team: {condition}", seed=TEAM_SEED, repetitions=repetitions
        )
        for team, condition in zip(teams_of(test, truth) or (), species.conditions)
    ]


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
