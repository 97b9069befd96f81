"""Several runs as one experiment: methods times seeds, in one world, on the same recordings."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from animarl_algos.runs.machine import wall_times
from animarl_algos.runs.run import Run, method_name
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

        Raises
        ------
        InputError
            If a folder is no run, or two runs are of different species, recordings, splits or
            worlds, or the same method with different settings or with the same seed.
        """
        if not folders:
            raise InputError("there is no run to look at: name one run folder or more")
        runs = [Run(Path(folder)) for folder in folders]
        methods: dict[str, list[Run]] = {}
        for run in runs:
            _check_same_experiment(run, runs[0])
            before = methods.setdefault(method_name(run.settings.algo), [])
            for other in before:
                _check_same_method(run, other)
            before.append(run)
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
    def seeds(self) -> tuple[int, ...]:
        """Training seeds of all, each once."""
        return tuple(sorted({run.settings.seed for run in self.runs}))

    @property
    def machine(self) -> dict[str, str]:
        """Commit, system, processor and accelerator; several where runs differ."""
        told: dict[str, list[str]] = {}
        for run in self.runs:
            for what, value in run.record["machine"].items():
                told.setdefault(what, []).append(str(value))
        return {what: "; ".join(dict.fromkeys(values)) for what, values in told.items()}

    @property
    def wall_time(self) -> dict[str, float]:
        """Seconds by stage, over all runs."""
        total: dict[str, float] = {}
        for run in self.runs:
            for stage, seconds in wall_times(run.path).items():
                total[stage] = total.get(stage, 0.0) + seconds
        return total


def _check_same_experiment(one: Run, other: Run) -> None:
    """Refuse runs of different species, animals, recordings, splits or worlds."""
    same_file = "train them on the same file"
    for what, fix, of in (
        ("species", "compare runs of one species", lambda run: run.settings.species),
        ("individuals", "compare runs of the same animals",
         lambda run: ", ".join(run.demos.individuals)),
        ("recordings", same_file, _recordings),
        ("split", same_file, _split),
    ):  # fmt: skip
        if of(one) != of(other):
            raise _refused(one, other, what, of(one), of(other), fix)
    _check_same_entries(one, other, _world, "world ({})", "train them in the same world")


def _check_same_method(one: Run, other: Run) -> None:
    """Refuse runs of one method with the same seed, or with different settings."""
    method, seed = method_name(one.settings.algo), one.settings.seed
    if seed == other.settings.seed:
        raise InputError(
            f"{one.path} and {other.path} are both {method} with seed {seed}: name each training "
            "once"
        )
    fix = "seeds of one method must have the same settings"
    _check_same_entries(one, other, _method, f"settings of {method} ({{}})", fix)


def _check_same_entries(
    one: Run, other: Run, of: Callable[[Run], Mapping[str, object]], named: str, fix: str
) -> None:
    """Refuse the first entry that is not the same here and there."""
    here, there = of(one), of(other)
    for key in {**here, **there}:
        if here.get(key) != there.get(key):
            raise _refused(one, other, named.format(key), here.get(key), there.get(key), fix)


def _refused(one: Run, other: Run, what: str, here: object, there: object, fix: str) -> InputError:
    return InputError(
        f"{one.path} and {other.path} do not share their {what}: "
        f"{_short(here)} and {_short(there)}: {fix}"
    )


def _recordings(run: Run) -> str:
    """A digest of everything but the split, with the number of episodes to show."""
    plain = replace(run.demos, split=np.full(run.demos.num_episodes, SPLITS[0]))
    return f"{run.demos.num_episodes} episodes, fingerprint {plain.fingerprint()}"


def _split(run: Run) -> str:
    counts = ", ".join(f"{split} {int((run.demos.split == split).sum())}" for split in SPLITS)
    return f"{counts} (fingerprint {run.demos.fingerprint()})"


def _world(run: Run) -> dict[str, Any]:
    named = {f.name for f in fields(run.species)} - set(METHOD_FIELDS)
    world = {name: getattr(run.species, name) for name in sorted(named)}
    replaying = {"who learned": run.settings.focal or "all"}
    everything = world | run.world_options | replaying
    return {key.replace("_", " "): value for key, value in everything.items()}


def _method(run: Run) -> dict[str, Any]:
    own = {"steps": run.settings.steps, "acting": run.settings.acting}
    learner: dict[str, Any] = run.record["learner"]
    return own | learner


def _short(value: object) -> str:
    text = str(value)
    return text if len(text) <= 90 else f"{text[:87]}..."
