"""The policies of a run, rolled out on its test split. Nothing is trained here."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from animarl_algos.evaluation.collect import Cue, Policy, RandomPolicy
from animarl_algos.evaluation.decisions import decide_along
from animarl_algos.evaluation.rollouts import Rollouts
from animarl_algos.evaluation.statistics import RESAMPLES
from animarl_algos.evaluation.tables import Evaluation, evaluate
from animarl_algos.learner.algorithm import SequenceQLearning
from animarl_algos.runs.run import Run, method_name
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.errors import InputError
from animarl_envs.fitting.tracking import track

DECISIONS = Path("rollouts", "decisions.npz")
UNTRAINED, RANDOM = "untrained", "random"


def lacking(run: Run) -> list[str]:
    """What the run was asked for but does not have, each in a sentence with what adds it."""
    return [
        f"{run.path}: it has no trained {method_name(algo)} to compare with: add it with "
        f"'{run.suggested_command()}'"
        for algo in run.settings.compared
        if not run.has_policy(algo)
    ]


def test_policies(run: Run) -> dict[str, Policy]:
    """The trained learner and what it is compared with, as far as the run has it."""
    settings = run.settings
    policies: dict[str, Policy] = {
        method_name(algo): run.trained(algo)
        for algo in (settings.algo, *settings.compared)
        if algo == settings.algo or run.has_policy(algo)
    }
    if settings.baselines:
        policies[UNTRAINED] = untrained_network = run.untrained()
        policies[RANDOM] = RandomPolicy(settings.seed, untrained_network.policy.num_actions)
    return policies


def roll_out(run: Run) -> dict[str, Rollouts]:
    """Every method from each test demonstration's start, and what the learner values.

    Where the learners see the condition, trained ones are also told the other one, in the same
    world: the counterfactual.
    """
    settings, demos = run.settings, run.demos
    policies = test_policies(run)
    learner = policies[method_name(settings.algo)]
    assert isinstance(learner, SequenceQLearning)
    flagged = learner.layout.condition_flag
    test = demos.select(split="test")
    along = decide_along(
        learner.policy, run.species, test, condition_flag=flagged, focal=settings.focal
    )
    along.save(run.path / DECISIONS)
    rollouts = {}
    for name, policy in policies.items():
        cues: tuple[Cue | None, ...] = (None,)
        if flagged and name != RANDOM:
            cues = ("actual",) if name == UNTRAINED else ("actual", "flipped")
        rollouts[name] = Rollouts.concatenate([run.roll_out(policy, name, cue) for cue in cues])
        rollouts[name].save(run.path / "rollouts" / f"{name}.npz")
    return rollouts


def stored_rollouts(run: Run) -> dict[str, Rollouts]:
    """By method, the run's own learner first.

    Raises
    ------
    InputError
        If the run has no rollouts yet, or a file is damaged.
    """
    own = method_name(run.settings.algo)
    files = [f for f in sorted((run.path / "rollouts").glob("*.npz")) if f.name != DECISIONS.name]
    if own not in {file.stem for file in files}:
        raise InputError(
            f"{run.path}: it has no rollouts yet: add them with 'animarl evaluate {run.path}'"
        )
    files.sort(key=lambda file: file.stem != own)
    return {file.stem: Rollouts.load(file) for file in files}


def evaluate_rollouts(
    run: Run,
    rollouts: dict[str, Rollouts],
    *,
    learner: str,
    seed: int,
    demos: Demonstrations | None = None,
    resamples: int = RESAMPLES,
) -> Evaluation:
    """Return rollouts measured and compared with the test recordings of a run.

    Beside them stand the recordings as the fitted locomotion follows them, as they are and with one
    action in ten at random. ``demos`` are others to compare with, whose starts ``rollouts`` had.
    """
    known, species = run.demos, run.species
    test = known.select(split="test") if demos is None else demos
    others = (
        known if demos is not None else known.select(episodes=np.flatnonzero(known.split != "test"))
    )
    moving = test, species.locomotion, species.arena
    return evaluate(
        rollouts,
        test,
        seed=seed,
        planned_flip=species.planned_flip,
        floor=track(*moving),
        perturbed=track(*moving, random_share=0.1, seed=seed),
        learner=learner,
        references=others,
        resamples=resamples,
    )
