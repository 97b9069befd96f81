"""Several runs as one experiment: methods times seeds, in one world, on the same recordings."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from animarl_algos.runs.machine import wall_times
from animarl_algos.runs.rolling_out import method_name
from animarl_algos.runs.run_folder import RunFolder
from animarl_algos.runs.run_world import in_the_world
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.episode import SPLITS
from animarl_envs.errors import InputError
from animarl_envs.species import Species

TOLD = ("observation", "source", "title", "version_history", "mirror_symmetric", "bodies")
"""Fields of a species that a method may have its own way: what it sees, and names."""


@dataclass(frozen=True, eq=False)
class RunSet:
    """Runs that may be compared, by method in the order in which they were named.

    Made by :meth:`open`, which refuses runs that differ in what is compared.
    """

    methods: Mapping[str, tuple[RunFolder, ...]]

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
        runs = [RunFolder(Path(folder)) for folder in folders]
        first = _Compared(runs[0])
        methods: dict[str, list[_Compared]] = {}
        for run in runs:
            one = first if run is runs[0] else _Compared(run)
            one.refuse_other_experiment(first)
            before = methods.setdefault(method_name(run.settings.algo), [])
            for other in before:
                one.refuse_other_method(other)
            before.append(one)
        return cls({name: tuple(one.run for one in some) for name, some in methods.items()})

    @property
    def runs(self) -> Iterator[RunFolder]:
        for some in self.methods.values():
            yield from some

    @cached_property
    def first(self) -> RunFolder:
        return next(self.runs)

    @cached_property
    def demos(self) -> Demonstrations:
        """The recordings of all, every split."""
        return self.first.demos

    @cached_property
    def species(self) -> Species:
        """The world of all; what is observed in it is that of the first run."""
        return self.first.species(self.demos, self.first.fit)

    @property
    def seeds(self) -> tuple[int, ...]:
        """Training seeds of all, each once."""
        return tuple(sorted({run.settings.seed for run in self.runs}))

    @property
    def machine(self) -> dict[str, str]:
        """Commit, system, processor and accelerator; several where runs differ."""
        told: dict[str, list[str]] = {}
        for run in self.runs:
            for what, value in run.record.get("machine", {}).items():
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


class _Compared:
    """What must be alike in two runs, read once."""

    def __init__(self, run: RunFolder) -> None:
        self.run, self.settings = run, run.settings
        self.demos = run.demos
        self.species = run.species(self.demos, run.fit)

    def refuse_other_experiment(self, other: _Compared) -> None:
        for what, mend, here, there in (
            ("species", "compare runs of one species", *_both(self, other, _species)),
            ("individuals", "compare runs of the same animals", *_both(self, other, _names)),
            ("recordings", "train them on the same file", *_both(self, other, _recordings)),
            ("split", "train them on the same file", *_both(self, other, _split)),
        ):
            if here != there:
                raise self._refused(other, what, here, there, mend)
        mend = "train them in the same world"
        self._refuse_differing(other, *_both(self, other, _world), "world ({})", mend)

    def refuse_other_method(self, other: _Compared) -> None:
        if self.settings.seed == other.settings.seed:
            raise InputError(
                f"{self.run.path} and {other.run.path} are both "
                f"{method_name(self.settings.algo)} with seed {self.settings.seed}: name each "
                "training once"
            )
        named = f"settings of {method_name(self.settings.algo)} ({{}})"
        mend = "seeds of one method must have the same settings"
        self._refuse_differing(other, *_both(self, other, _method), named, mend)

    def _refuse_differing(
        self,
        other: _Compared,
        here: Mapping[str, object],
        there: Mapping[str, object],
        named: str,
        mend: str,
    ) -> None:
        """Refuse the first entry that is not the same here and there."""
        for key in {**here, **there}:
            if here.get(key) != there.get(key):
                what = named.format(key)
                raise self._refused(other, what, here.get(key), there.get(key), mend)

    def _refused(
        self, other: _Compared, what: str, here: object, there: object, mend: str
    ) -> InputError:
        return InputError(
            f"{self.run.path} and {other.run.path} do not share their {what}: "
            f"{_short(here)} and {_short(there)}: {mend}"
        )


def _both(one: _Compared, other: _Compared, of: Any) -> tuple[Any, Any]:
    return of(one), of(other)


def _species(one: _Compared) -> str:
    return one.settings.species


def _names(one: _Compared) -> str:
    return ", ".join(one.demos.individuals)


def _recordings(one: _Compared) -> str:
    """A digest of everything but the split, with the number of episodes to show."""
    demos = one.demos
    plain = replace(demos, split=np.full(demos.num_episodes, SPLITS[0]))
    return f"{demos.num_episodes} episodes, fingerprint {plain.fingerprint()}"


def _split(one: _Compared) -> str:
    counts = ", ".join(f"{split} {int((one.demos.split == split).sum())}" for split in SPLITS)
    return f"{counts} (fingerprint {one.demos.fingerprint()})"


def _world(one: _Compared) -> dict[str, Any]:
    named = {f.name for f in fields(one.species)} - set(TOLD)
    world = {name: getattr(one.species, name) for name in sorted(named)}
    replaying = {"who learned": one.settings.focal or "all"}
    everything = world | in_the_world(one.run.environment_options) | replaying
    return {key.replace("_", " "): value for key, value in everything.items()}


def _method(one: _Compared) -> dict[str, Any]:
    settings = one.settings
    own = {"steps": settings.steps, "acting": settings.acting}
    learner: dict[str, Any] = one.run.record["learner"]
    return own | learner


def _short(value: object) -> str:
    text = str(value)
    return text if len(text) <= 90 else f"{text[:87]}..."
