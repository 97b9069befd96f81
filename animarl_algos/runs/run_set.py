"""Several runs as one experiment: methods times seeds on the same recordings, or folds of a run.

Cross-validation of a run with few test recordings: each recording is tested once.

The run is the first fold: its test split is that of this fold, and its simulator is what one goes
on with. The simulators of the other folds are trained in the same way, each without its own test
recordings. All folds together make one evaluation.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from animarl_algos.evaluation.rollouts import Rollouts
from animarl_algos.runs.run import DEMONSTRATIONS, Run, method_name
from animarl_algos.runs.run_settings import RunSettings
from animarl_algos.runs.run_world import SENSES, world_in_words
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.episode import SPLITS
from animarl_envs.demos.splits import run_folds
from animarl_envs.errors import InputError
from animarl_envs.fitting.tracking import Tracking, track
from animarl_envs.settings import field_types
from animarl_envs.species import Species

METHOD_FIELDS = ("observation", "source", "title", "version_history", "mirror_symmetric", "bodies")
"""Species fields that may differ between methods."""


@dataclass(frozen=True, eq=False)
class RunSet:
    """Runs that may be compared, by method in the order in which they were named.

    Made by :meth:`open`, which refuses runs that differ in what is compared.
    """

    methods: Mapping[str, tuple[Run, ...]]

    @classmethod
    def open(cls, folders: Sequence[str | Path]) -> RunSet:
        """Read run folders.

        Raises InputError if a folder is no run, or two runs are of different species, recordings,
        splits or worlds, or the same method with different settings or with the same seed.
        """
        if not folders:
            raise InputError("there is no run to look at: name one run folder or more")
        runs = [Run(Path(folder)) for folder in folders]
        methods: dict[str, list[Run]] = {}
        for run in runs:
            _check_same(run, runs[0], _experiment(run), _experiment(runs[0]))
            name = method_name(run.settings.algo)
            for other in methods.setdefault(name, []):
                if run.settings.seed == other.settings.seed:
                    raise InputError(
                        f"{run.path} and {other.path} are both {name} with seed "
                        f"{run.settings.seed}: name each training once"
                    )
                keys = run.record["learner"] | other.record["learner"]
                _check_same(run, other, _method(run, keys), _method(other, keys))
            methods[name].append(run)
        return cls({name: tuple(some) for name, some in methods.items()})

    @classmethod
    def of(cls, run: Run) -> RunSet:
        """Return one run by itself."""
        return cls({method_name(run.settings.algo): (run,)})

    @property
    def runs(self) -> Iterator[Run]:
        """All runs."""
        for some in self.methods.values():
            yield from some

    @cached_property
    def first(self) -> Run:
        """The first run, whose world and recordings are those of all."""
        return next(self.runs)

    @property
    def demos(self) -> Demonstrations:
        """The recordings of all, every split."""
        return self.first.demos

    @property
    def species(self) -> Species:
        """The world of all; what is observed in it is that of the first run."""
        return self.first.species

    def page_inputs(self) -> dict[str, Any]:
        """Return what every page says of its runs: species, world, machine, time and versions.

        What differs between runs is listed; seconds by stage are summed.
        """
        machine: dict[str, list[str]] = {}
        seconds: dict[str, float] = {}
        for run in self.runs:
            for what, value in run.record["machine"].items():
                machine.setdefault(what, []).append(str(value))
            for stage, took in run.wall_times().items():
                seconds[stage] = seconds.get(stage, 0.0) + took
        return {
            "species": self.species,
            "world": world_in_words(self.species),
            "environment": self.first.environment_options,
            "machine": {what: "; ".join(dict.fromkeys(all_)) for what, all_ in machine.items()},
            "wall_time": seconds,
            "versions": self.first.record["versions"],
        }


Facts = Iterator[tuple[str, object, str]]
"""What must be the same, its value, and what to do where it is not."""


def _check_same(one: Run, other: Run, here: Facts, there: Facts) -> None:
    for (what, mine, fix), (_, others, _) in zip(here, there):
        if mine != others:
            raise InputError(
                f"{one.path} and {other.path} do not share their {what}: {_short(mine)} and "
                f"{_short(others)}: {fix}"
            )


def _experiment(run: Run) -> Facts:
    """Yield species, animals, recordings, splits and world."""
    yield "species", run.settings.species, "compare runs of one species"
    demos, same_file = run.demos, "train them on the same file"
    yield "individuals", ", ".join(demos.individuals), "compare runs of the same animals"
    plain = replace(demos, split=np.full(demos.num_episodes, SPLITS[0]))
    yield (
        "recordings",
        f"{demos.num_episodes} episodes, fingerprint {plain.fingerprint()}",
        same_file,
    )
    counts = ", ".join(f"{split} {int((demos.split == split).sum())}" for split in SPLITS)
    yield "split", f"{counts} (fingerprint {demos.fingerprint()})", same_file
    named = {f.name for f in fields(run.species)} - set(METHOD_FIELDS)
    world = {name: getattr(run.species, name) for name in sorted(named)}
    senses = {name: run.world_options.get(name) for name in SENSES}
    for key, value in (world | senses | {"who learned": run.settings.focal or "all"}).items():
        yield f"world ({key.replace('_', ' ')})", value, "train them in the same world"


def _method(run: Run, keys: Iterable[str]) -> Facts:
    """Yield steps, acting and these settings of the learner."""
    own = {"steps": run.settings.steps, "acting": run.settings.acting} | run.record["learner"]
    name, fix = method_name(run.settings.algo), "seeds of one method must have the same settings"
    for key in ("steps", "acting", *keys):
        yield f"settings of {name} ({key})", own.get(key), fix


def _short(value: object) -> str:
    text = str(value)
    return text if len(text) <= 90 else f"{text[:87]}..."


FOLDS = 3
ENOUGH_TESTED = 20  # test recordings, from which on a run is not cross-validated by default
FEWEST_CROSSED = 10  # recordings of all splits; with fewer, folds make no verdict possible either
FOLDER = "folds"


def number_of_folds(demos: Demonstrations, wanted: int | None = None) -> int:
    """Return into how many folds a run is cross-validated, 0 for none.

    By default where the test split has too few recordings, and all splits together have enough.
    Raises InputError if ``wanted`` are fewer than three folds, or more than there are recordings.
    """
    tested, recordings = np.unique(demos.recording[demos.split == "test"]), demos.recording
    if wanted is None:
        enough = len(np.unique(recordings)) >= FEWEST_CROSSED
        wanted = FOLDS if enough and len(tested) < ENOUGH_TESTED else 0
    if wanted:
        next(run_folds(demos, wanted))
    return wanted


def begin_folds(run: Run, folds: int) -> tuple[Run, ...]:
    """Make the folders of the other folds within that of a run, or find them again."""
    begun = []
    given = Demonstrations.load(run.path / DEMONSTRATIONS)
    for number, demos in list(enumerate(run_folds(given, folds), 1))[1:]:
        fold = Run(run.path / FOLDER / f"{number}-of-{folds}", run.acting_rule)
        fold.path.mkdir(parents=True, exist_ok=True)
        reasons = run.record.get("reasons", {})
        chosen = {key: why for key, why in reasons.items() if key in field_types(RunSettings)}
        fold.start(run.settings, demos, run.record["command"], chosen)
        begun.append(fold)
    return tuple(begun)


def trained_folds(run: Run) -> tuple[Run, ...]:
    """Return the folds of a run that was cross-validated, in order; none of another run.

    The first is the run itself. (Older runs have a folder for each fold.)
    """
    folders = sorted((run.path / FOLDER).glob("*-of-*"), key=lambda path: _number(path)[0])
    folds = [Run(folder, run.acting_rule) for folder in folders]
    if folders and _number(folders[0])[0] == 2:
        folds = [run, *folds]
    whole = bool(folders) and len(folds) == _number(folders[0])[1]
    algos = (run.settings.algo, *run.settings.compared)
    trained = whole and all(fold.has_policy(algo) for fold in folds for algo in algos)
    return tuple(folds) if trained else ()


def ensemble(run: Run, fold: int | None = None) -> list[Run]:
    """Return a run and the other folds of it: simulators of the same animals to ask together.

    With ``fold``, return this one alone; the run itself is fold 1.

    Raises InputError if there is no such fold.
    """
    simulators = [run, *(other for other in trained_folds(run) if other.path != run.path)]
    if fold is None:
        return simulators
    if not 1 <= fold <= len(simulators):
        raise InputError(
            f"{run.path}: there is no fold {fold}: choose one of 1 to {len(simulators)}; the run "
            "itself is fold 1"
        )
    return [simulators[fold - 1]]


def _number(folder: Path) -> tuple[int, int]:
    """Return the number of a fold, from 1, and how many there are."""
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
        tracked = track(own.select(split="test"), species.locomotion, species.arena)
        paths[frames], speeds[frames], actions[frames] = (
            tracked.positions,
            tracked.velocities,
            tracked.actions,
        )
    return Tracking(paths, speeds, actions)
