"""Several runs as one experiment: methods times seeds, in one world, on the same recordings."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from animarl_algos.runs.run import Run, method_name
from animarl_algos.runs.run_world import SENSES, world_in_words
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.episode import SPLITS
from animarl_envs.errors import InputError
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

    @property
    def runs(self) -> Iterator[Run]:
        for some in self.methods.values():
            yield from some

    @cached_property
    def first(self) -> Run:
        return next(self.runs)

    @property
    def demos(self) -> Demonstrations:
        """The recordings of all, every split."""
        return self.first.demos

    @property
    def species(self) -> Species:
        """The world of all; what is observed in it is that of the first run."""
        return self.first.species

    @property
    def seeds(self) -> dict[str, tuple[int, ...]]:
        """Training seeds by method."""
        return {name: tuple(r.settings.seed for r in some) for name, some in self.methods.items()}

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
        "recordings", f"{demos.num_episodes} episodes, fingerprint {plain.fingerprint()}", same_file
    )  # fmt: skip
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
