"""From recorded episodes to a report: fit, pretrain, adapt, evaluate, report.

Each stage writes its result into the run folder and is skipped if it is there, so that a run that
was killed goes on where it was.
"""

import time
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing
from datetime import UTC, datetime
from pathlib import Path

import torch
from joblib import Parallel, delayed
from stable_baselines3.common.logger import configure
from threadpoolctl import threadpool_limits

from animarl_algos.data.recipe_choice import choose_recipe
from animarl_algos.data.vec_env import SlotVecEnv
from animarl_algos.evaluation.comparison import Evaluation
from animarl_algos.evaluation.metrics import METRICS
from animarl_algos.evaluation.thrust_choice import choose_thrusts
from animarl_algos.evaluation.verdict_rows import AS_BUILT, Questions
from animarl_algos.learner.algorithm import SequenceQLearning
from animarl_algos.learner.callbacks import CheckpointCallback
from animarl_algos.learner.checkpoint import (
    latest_checkpoint,
    load_checkpoint,
    steps_done,
)
from animarl_algos.learner.progress import progress_display
from animarl_algos.networks.acting_rule import Acting
from animarl_algos.recipes.registry import named_recipe
from animarl_algos.report.page import PAGE_FILE
from animarl_algos.report.run_page import write_report
from animarl_algos.runs import run_set
from animarl_algos.runs.evaluating import EvaluatedRuns, acted_by, report_inputs, roll_out
from animarl_algos.runs.run import Run, method_name
from animarl_algos.runs.run_settings import AUTO, CHOSEN, RunSettings, checked_species
from animarl_algos.runs.run_world import CELLS
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.packaged import load_packaged
from animarl_envs.demos.splits import refuse_empty_splits, run_folds
from animarl_envs.demos.summary import LEARNED_FROM
from animarl_envs.errors import InputError
from animarl_envs.fitting.result import LocomotionFit, fit_locomotion
from animarl_envs.importing.sets import read_named
from animarl_envs.scenario import PACKAGED, SCALES_OF_CELLS, make_scenario

ACTING_BY_CELLS = "boltzmann:1"


def open_run(
    settings: RunSettings,
    out: Path,
    command: str,
    demos: Demonstrations | None = None,
    folds: int = 0,
) -> Run:
    """Start (or find again) the run folder; what does not fit together is refused before it.

    A run that will be cross-validated in so many ``folds`` has the split of the first.
    """
    if demos is None:
        demos = load_demonstrations(settings.file, settings.source, settings.species)
    demos = next(run_folds(demos, folds)) if folds else demos
    settings, reasons = with_recipe(settings, demos)
    check_run(settings, demos)
    out.mkdir(parents=True, exist_ok=True)
    with (run := Run(out)).lock():
        run.start(settings, demos, command, reasons, folds)
    return run


def with_recipe(settings: RunSettings, demos: Demonstrations) -> tuple[RunSettings, dict[str, str]]:
    """Return the settings with the recipe of the clone, and why it was chosen, if it was."""
    checked_species(settings, demos)
    reasons = {}
    if settings.cloning == CHOSEN and settings.clones:
        name, reasons["cloning"] = choose_recipe(demos)
        settings = settings.changed(cloning=name)
    if settings.acting == CHOSEN and settings.learner().env_kwargs.get(CELLS):
        settings = settings.changed(acting=ACTING_BY_CELLS)
        reasons["acting"] = "cells are drawn as often as the clone expects them"
    return settings, reasons


def check_run(settings: RunSettings, demos: Demonstrations) -> None:
    """Make the environment and the learners once, so that what does not fit is refused now.

    Raises InputError: whatever making them, or beginning to learn, would refuse.
    """
    species, wanted = checked_species(settings, demos), settings.learner()
    env = SlotVecEnv(
        species,
        settings.copies,
        demos=demos,
        focal=settings.focal,
        condition_flag=None,
        **wanted.env_kwargs,
    )
    env.offline_data().check_memory()
    if settings.acting != CHOSEN:
        Acting.parse(settings.acting).checked(len(env.individuals), env.world.num_actions)
    for algo in (settings.algo, *settings.compared):
        named_recipe(algo).algorithm(
            env=env, seed=settings.seed, device="cpu", settings=settings.learner(algo).settings
        )


def load_demonstrations(
    file: str, source: str | None = None, species: str | None = None
) -> Demonstrations:
    """Return those of a file or published set, or those packaged for a species (``packaged``)."""
    if file == PACKAGED:
        return load_packaged(species or "agent")
    demos = read_named(file, source)
    refuse_empty_splits(demos)  # now, not after an hour
    return demos


def fit(run: Run) -> LocomotionFit:
    """Stage 1: damping and thrust of every individual."""
    with run.lock():
        file, settings = run.path / "locomotion.json", run.settings
        if file.exists():
            return run.fit
        demos, method, thrusts = run.learnable_demos, settings.fit_method, 1
        cells = run.environment_options.get(CELLS) or 0
        if settings.thrusts != AUTO:
            thrusts = int(settings.thrusts)
        elif cells:
            thrusts = SCALES_OF_CELLS if method == "joint" else 1
        elif method == "joint":
            thrusts = choose_thrusts(demos, seed=settings.seed)[0]
        world = make_scenario(settings.species, demos=demos) if method == "species" else None
        result = fit_locomotion(
            demos,
            method,
            seed=settings.seed,
            thrusts=thrusts,
            known=() if world is None else world.species.locomotion,
            cells=cells,
        )
        result.save(file)
        return result


def learn(
    run: Run, algo: str, *, progress_bar: bool = True, processes: int = 1
) -> SequenceQLearning:
    """Stages 2 and 3: offline on the demonstrations, then online in the fitted world.

    Goes on from the last checkpoint, exactly. So many ``processes`` choose how to act.
    """
    torch.set_num_threads(1)
    with run.lock():
        fit(run)
        settings, logs = run.settings, run.path / "logs"
        checkpoints = run.path / "checkpoints" / algo
        model = run.learner(algo, run.environment(run.learnable_demos))
        latest, online = latest_checkpoint(checkpoints), model.recipe.online
        unfinished = latest is not None and online and steps_done(latest) < settings.steps
        if run.has_policy(algo) and not unfinished:
            run.load_policy(algo, model)
            return run.set_acting_rule(algo, model, processes)
        if latest is not None:
            load_checkpoint(model, checkpoints)
        session = logs / algo / f"{len(list((logs / algo).glob('[0-9]*'))):03d}"
        with (
            threadpool_limits(1),
            run.timed(f"training {method_name(algo)}"),
            closing(configure(str(session), ["csv", "tensorboard"])) as logger,
        ):
            model.set_logger(logger)
            done = 0 if latest is None else model.num_timesteps
            model.learn(
                max(0, settings.steps - done),
                callback=CheckpointCallback(checkpoints, settings.checkpoint_every),
                reset_num_timesteps=latest is None,
                progress_bar=progress_bar,
            )
        run.acting_file(algo).unlink(missing_ok=True)  # chosen for another policy
        run.amplify_trait_inputs(algo, model)
        run.save_policy(algo, model)
        return run.set_acting_rule(algo, model, processes)


def learn_all(run: Run, *, progress_bar: bool = True, processes: int = 1) -> None:
    """Stages 2 and 3 of the run's learner and of those that it is compared with."""
    for algo in (run.settings.algo, *run.settings.compared):
        learn(run, algo, progress_bar=progress_bar, processes=processes)


def cross_validate(run: Run, folds: int, *, processes: int = 1, progress_bar: bool = True) -> None:
    """Train the learners of a run anew for every other fold, without its test recordings.

    So many ``processes`` train a fold each, in one thread, so that their number changes no result.
    Measures of the user's own are known in this process alone, which trains all folds then.
    """
    if any(metric.own is not None for metric in METRICS):
        processes = 1
    begun = progress_display("cross-validation", "fold", folds - 1, disable=not progress_bar)
    with run.lock(), begun as bar:
        visible = progress_bar and processes == 1
        try:
            for number, seconds in Parallel(processes, return_as="generator", batch_size=1)(
                delayed(_learn_fold)(number, fold.path, fold.acting_rule, visible)
                for number, fold in enumerate(run_set.begin_folds(run, folds), 2)
            ):
                run.add_time(f"fold {number} of {folds}", seconds)
                bar.update()
        except BrokenProcessPool as error:
            raise InputError(
                f"{run.path}: a process died, probably for lack of memory: give fewer --processes; "
                "the same command goes on from what is finished"
            ) from error


def _learn_fold(
    number: int, folder: Path, acting_rule: str | None, progress_bar: bool
) -> tuple[int, float]:
    """Train the learners of a fold; return its number, and the seconds that this took."""
    begun = time.monotonic()
    with threadpool_limits(1):
        learn_all(Run(folder, acting_rule), progress_bar=progress_bar)
    return number, time.monotonic() - begun


def evaluate_run(run: Run, questions: Questions = AS_BUILT) -> Evaluation:
    """Stage 4: rollouts on the test split, measured and compared with the recordings.

    Of a run that was cross-validated, those of all folds are compared, with all recordings.

    Raises InputError if the run is a model that came without its recordings.
    """
    if LEARNED_FROM in run.demos.provenance:
        raise InputError(
            f"{run.path}: it has tracks of its own simulation, no recordings to compare it with: "
            "see its card, README.md, or give recordings by --demos and --out"
        )
    with run.lock(), run.timed("evaluation"):
        rollouts, folds = roll_out(run), run_set.trained_folds(run)
        for fold in folds[1:]:
            roll_out(fold)
        rollouts = run_set.joined_rollouts(folds) if folds else rollouts
        runs = run_set.RunSet.of(run)
        judged = EvaluatedRuns(runs, rollouts, folds, seed=run.settings.seed, questions=questions)
        evaluation = judged.evaluation
        evaluation.save(run.path / "evaluation")
    return evaluation


def report(run: Run) -> Path:
    """Stage 5: the page to show."""
    with run.lock():
        record, folds = run.record, run_set.trained_folds(run)
        rollouts = run_set.joined_rollouts(folds) if folds else run.rollouts()
        evaluated = EvaluatedRuns(run_set.RunSet.of(run), rollouts, folds)
        evaluation = Evaluation.load(run.path / "evaluation")
        acting = {"acting": acted_by(run)}
        settings = {"run": record["settings"] | acting, "learner": record["learner"]}
        settings |= {"reason": record.get("reasons", {})}
        made = datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC")
        inputs = report_inputs(evaluated, evaluation, settings, record["command"], made)
        return write_report(inputs, run.path / PAGE_FILE)
