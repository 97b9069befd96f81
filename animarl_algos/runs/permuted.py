"""Runs that learn from permuted conditions: the null of a condition's shift in a what-if."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from animarl_algos.runs import pipeline
from animarl_algos.runs.run import Run
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.errors import InputError


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
        else:  # one recording holds both conditions: permute its episodes
            condition[here] = rng.permutation(own)
    return replace(demos, condition=condition)


def permuted_runs(
    run: Run, folder: Path, count: int, on_trained: Callable[[int], None] | None = None
) -> list[Run]:
    """Train a run's learner ``count`` times on permuted conditions; finished ones are kept.

    Groups of recordings differ by chance too, and a network learns that difference as it learns a
    true one. An interval over rollouts does not show it; the shifts of these runs do.

    Parameters
    ----------
    folder
        Gets a run folder for each.
    on_trained
        Called with the number of runs that are trained.

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
