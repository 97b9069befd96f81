"""Cross-validation of a run with few test recordings: each recording is tested once.

The simulator of a fold is trained without its test recordings, exactly as the run's own. All folds
together make one evaluation. The run's own simulator, which is what one goes on with, is another
training of the same kind.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from animarl_algos.evaluation.rollouts import Rollouts
from animarl_algos.evaluation.verdict import FEWEST
from animarl_algos.runs.run import DEMONSTRATIONS, Run
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.splits import cross_validated
from animarl_envs.errors import InputError
from animarl_envs.fitting.tracking import Tracking, track

FOLDS = 5
FOLDER = "folds"


def number_of_folds(demos: Demonstrations, asked: int | None = None) -> int:
    """Return into how many folds a run is cross-validated, 0 for none.

    By default only where that makes a verdict possible: the test split has too few recordings, and
    all splits together have enough. Raises InputError if ``asked`` are fewer than three folds, or
    more than there are recordings.
    """
    tested = np.unique(demos.recording[demos.split == "test"])
    if asked is None:
        asked = FOLDS if len(tested) < FEWEST <= len(np.unique(demos.recording)) else 0
    if asked:
        next(cross_validated(demos, asked))
    return asked


def begin_folds(run: Run, folds: int) -> tuple[Run, ...]:
    """Make the folders of the folds within that of a run, or find them again.

    Raises InputError if the run is cross-validated already, in another number of folds.
    """
    there = {file.name.partition("-of-")[2] for file in (run.path / FOLDER).glob("*-of-*")}
    if there - {str(folds)}:
        raise InputError(
            f"{run.path}: it is cross-validated in {there.pop()} folds already: give --folds "
            "accordingly, or another --out"
        )
    found = []
    given = Demonstrations.load(run.path / DEMONSTRATIONS)
    for number, demos in enumerate(cross_validated(given, folds), 1):
        fold = Run(run.path / FOLDER / f"{number}-of-{folds}", run.acting_rule)
        fold.path.mkdir(parents=True, exist_ok=True)
        fold.start(run.settings, demos, run.record["command"], run.record.get("reasons"))
        found.append(fold)
    return tuple(found)


def trained_folds(run: Run) -> tuple[Run, ...]:
    """Return the folds of a run that was cross-validated, in order; none of another run."""
    folders = sorted((run.path / FOLDER).glob("*-of-*"), key=lambda path: _number(path)[0])
    folds = [Run(folder, run.acting_rule) for folder in folders]
    whole = bool(folders) and len(folders) == _number(folders[0])[1]
    algos = (run.settings.algo, *run.settings.compared)
    trained = whole and all(fold.has_policy(algo) for fold in folds for algo in algos)
    return tuple(folds) if trained else ()


def _number(folder: Path) -> tuple[int, int]:
    """Return which fold it is, from 1, and of how many."""
    number, _, folds = folder.name.partition("-of-")
    return int(number), int(folds)


def all_tested(demos: Demonstrations) -> Demonstrations:
    """Return the same recordings, all of them in the test split."""
    return replace(demos, split=np.full(len(demos), "test"))


def joined_rollouts(folds: Sequence[Run]) -> dict[str, Rollouts]:
    """Return the rollouts of all folds by method, from the starts of all recordings."""
    parts: dict[str, list[Rollouts]] = {}
    for fold in folds:
        tested = np.flatnonzero(fold.demos.split == "test")
        for name, rollouts in fold.rollouts().items():
            parts.setdefault(name, []).append(replace(rollouts, demo=tested[rollouts.demo]))
    return {name: Rollouts.concatenate(some) for name, some in parts.items()}


def joined_tracking(folds: Sequence[Run]) -> Tracking:
    """Follow every recording by the locomotion that was fitted without it."""
    demos = folds[0].demos
    paths, speeds = np.empty_like(demos.positions), np.empty_like(demos.positions)
    actions = np.empty(demos.positions.shape[:2], dtype=np.int64)
    for fold in folds:
        own, species = fold.demos, fold.species
        frames = np.repeat(own.split == "test", own.lengths)
        found = track(own.select(split="test"), species.locomotion, species.arena)
        paths[frames], speeds[frames], actions[frames] = (
            found.positions, found.velocities, found.actions
        )  # fmt: skip
    return Tracking(paths, speeds, actions)
