"""Further runs that a what-if asks, beside the run it is about.

Those that learn from permuted conditions are the null of a condition's shift. One with other inputs
is a second specification: what is the same in every recording, such as the arena, can be learned in
several ways, and only a change of it tells them apart.
"""

import math
import shutil
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np

from animarl_algos.report.inputs import duration
from animarl_algos.runs import pipeline
from animarl_algos.runs.pretrained import FOLDER as PACKAGED_MODELS
from animarl_algos.runs.run import Run
from animarl_algos.whatif.changes import CONDITION
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.summary import LEARNED_FROM
from animarl_envs.errors import InputError
from animarl_envs.importing.sets import cache_folder
from animarl_envs.species.options import with_options
from animarl_envs.worlds import observation_components

LOCOMOTION = "locomotion.json"
OTHER_INPUTS = "paper"  # the observation of a second simulator


def second_folder(run: Run) -> Path:
    """Return where the second specification of a run lies: in it; of packaged ones in the cache."""
    name = f"second-{run.path.name}-{run.record['fingerprint']}"
    return cache_folder() / name if run.path.parent == PACKAGED_MODELS else run.path / "second"


def second_run(run: Run, changes: Iterable[str], on_begin: Callable[[str], None]) -> Run | None:
    """Train a run's learner on the paper's inputs, at half the cost; a finished one is kept.

    ``on_begin`` is called before a training with a sentence: what is trained, where, how long.
    Returns None if the ``changes`` are of conditions alone, the run itself has these inputs, its
    animals have no others, or it came without the recordings that it learned from.
    """
    of_conditions = all(text.partition("=")[0].strip() == CONDITION for text in changes)
    if of_conditions or LEARNED_FROM in run.demos.provenance:
        return None
    inputs = [
        [one.name for one in observation_components(species)]
        for species in (run.species, with_options(run.species, observation=OTHER_INPUTS))
    ]
    if inputs[0] == inputs[1]:
        return None
    folder, given = second_folder(run), run.settings
    if not Run(folder).has_policy(given.algo):
        seconds = sum(took for stage, took in run.wall_times().items() if "training" in stage)
        about = f", about {duration(math.ceil(seconds / 2))}" if seconds else ""
        on_begin(
            f"A second simulator, whose animals perceive other things (observation: "
            f"{OTHER_INPUTS}), is trained once{about}: {folder}"
        )
    worlds = {**given.overrides.get("env_kwargs", {}), "observation": OTHER_INPUTS}
    overrides = {**given.overrides, "env_kwargs": worlds}
    if epochs := run.record["learner"].get("offline_epochs"):
        overrides["offline_epochs"] = max(1, epochs // 2)
    settings = given.changed(
        baselines=False, acting=str(run.acting(given.algo)), overrides=overrides,
        steps=max(1, given.steps // 2),
    )  # fmt: skip
    second = pipeline.open_run(settings, folder, "second specification", run.demos)
    if not (folder / LOCOMOTION).exists():
        shutil.copyfile(run.path / LOCOMOTION, folder / LOCOMOTION)
    pipeline.learn(second, settings.algo, progress_bar=False)
    return second


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
