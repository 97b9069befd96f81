"""Join sets of demonstrations, and leave individuals of a set out."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.errors import InputError
from animarl_envs.settings import is_whole

ALIKE = ("species", "individuals", "roles", "dt", "arena")
BY_RECORDING = ("scales", "cleaning")  # entries of the provenance
COUNTS = {"num_pursuers": "pursuer", "num_targets": "target"}
"""Options that say how many take part, and of which role."""


def join(parts: Sequence[Demonstrations], name: str = "joined") -> Demonstrations:
    """Return all episodes one after the other, each with its condition, split and recording.

    The provenance is that of the first, with those of all under ``joined`` and with the scales and
    the cleaning of all recordings. Recordings of several sets that have one name get that of their
    set before it. Raises InputError if there is none, two hold the same episodes, or differ in
    species, individuals, time step, arena, unit or signals.
    """
    if not parts:
        raise InputError("there are no demonstrations to join: give one set or more")
    first = parts[0]
    for part in parts[1:]:
        _refuse_unlike(first, part)
    once: dict[str, str] = {}
    for part in parts:
        twin = once.setdefault(part.fingerprint(), part.name)
        if twin != part.name or Counter(one.name for one in parts)[part.name] > 1:
            raise InputError(f"{part.name} and {twin} hold the same episodes: give each file once")
    names = _recording_names(parts)
    recording = [
        new.get(one, one)
        for part, new in zip(parts, names, strict=True)
        for one in part.recording.tolist()
    ]
    provenance: dict[str, Any] = {
        **first.provenance,
        "joined": [dict(part.provenance) for part in parts],
    }
    for key in BY_RECORDING:
        known = [
            (new.get(recording, recording), entry)
            for part, new in zip(parts, names, strict=True)
            for recording, entry in dict(part.provenance.get(key) or {}).items()
        ]
        if known:
            provenance[key] = dict(known)
    changes = Demonstrations.joined_arrays(parts) | {"recording": np.array(recording)}
    signals = {k: np.concatenate([part.signals[k] for part in parts]) for k in first.signals}
    return replace(first, signals=signals, provenance=provenance, name=name, **changes)


def _refuse_unlike(first: Demonstrations, part: Demonstrations) -> None:
    for key in ALIKE:
        if getattr(part, key) != getattr(first, key):
            raise InputError(
                f"{part.name} and {first.name} differ in {key}: join recordings of the same "
                "animals in the same arena"
            )
    units = [one.provenance.get("unit") for one in (part, first)]
    if units[0] != units[1]:
        raise InputError(
            f"{part.name} is in {units[0]}, {first.name} in {units[1]}: import both with "
            "--px-per-cm, or neither"
        )
    if set(part.signals) != set(first.signals):
        raise InputError(
            f"{part.name} and {first.name} hold different signals: join sets with the same"
        )
    for key, value in part.signals.items():
        if value.shape[1:] != first.signals[key].shape[1:]:
            raise InputError(
                f"signal {key!r} has shape {value.shape} in {part.name} and "
                f"{first.signals[key].shape} in {first.name}: give both as many columns"
            )


def _recording_names(parts: Sequence[Demonstrations]) -> list[Mapping[str, str]]:
    """Return new names of recordings whose name occurs in several sets."""
    sets = Counter(name for part in parts for name in np.unique(part.recording).tolist())
    stems = [Path(part.name).stem for part in parts]
    if len(set(stems)) < len(stems):
        stems = [f"{stem}_{i}" for i, stem in enumerate(stems)]
    return [
        {name: f"{stem}/{name}" for name in np.unique(part.recording).tolist() if sets[name] > 1}
        for part, stem in zip(parts, stems, strict=True)
    ]


def first_of_role(demos: Demonstrations, option: str, count: int) -> Demonstrations:
    """Return the recordings of the first ``count`` individuals of a role and of all others.

    ``option``, of :data:`COUNTS`, names the role. An episode that ended by the contact of one who
    is left out is unfinished. Raises InputError if fewer were recorded.
    """
    role = COUNTS[option]
    recorded = demos.roles.count(role)
    if recorded == 0:
        nobody = "nobody pursues" if role == "pursuer" else "nobody is pursued"
        raise InputError(f"{option} does not apply to {demos.name}, where {nobody}: drop it")
    if not is_whole(count):
        raise InputError(f"{option} is {count!r}: it must be a whole number, 1 or more")
    if not 1 <= count <= recorded:
        raise InputError(
            f"{option} is {count} but {demos.name} holds {recorded} {role}"
            f"{'s' * (recorded != 1)}: choose at most {recorded}, or start='uniform', where nobody "
            f"follows a demonstration and more {role}s move like those recorded"
        )
    if count == recorded:
        return demos
    # several of a role come first
    return demos.of_individuals([*range(count), *range(recorded, demos.num_individuals)])
