"""Several sets of demonstrations as one: the same animals in the same arena, several recordings."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.errors import InputError

ALIKE = ("species", "individuals", "roles", "dt", "arena")
BY_RECORDING = ("scales", "cleaning")  # entries of the provenance


def join(parts: Sequence[Demonstrations], name: str = "joined") -> Demonstrations:
    """All episodes one after the other, each with its condition, split and recording.

    The provenance is that of the first, with those of all under ``joined`` and with the scales and
    the cleaning of all recordings. Recordings of several sets that have one name get that of their
    set before it.

    Raises
    ------
    InputError
        If there is none, two hold the same episodes, or differ in species, individuals, time step,
        arena, unit or signals.
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
    renamed = [_renamed(part.recording, new) for part, new in zip(parts, names, strict=True)]
    provenance: dict[str, Any] = {
        **first.provenance, "joined": [dict(part.provenance) for part in parts]
    }  # fmt: skip
    for key in BY_RECORDING:
        known = [
            (new.get(recording, recording), entry)
            for part, new in zip(parts, names, strict=True)
            for recording, entry in dict(part.provenance.get(key) or {}).items()
        ]
        if known:
            provenance[key] = dict(known)
    changes = Demonstrations.joined_arrays(parts) | {"recording": np.concatenate(renamed)}
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
    """New names of the recordings of each set, where several sets have one of that name."""
    sets = Counter(name for part in parts for name in np.unique(part.recording).tolist())
    stems = [Path(part.name).stem for part in parts]
    if len(set(stems)) < len(stems):
        stems = [f"{stem}_{i}" for i, stem in enumerate(stems)]
    return [
        {name: f"{stem}/{name}" for name in np.unique(part.recording).tolist() if sets[name] > 1}
        for part, stem in zip(parts, stems, strict=True)
    ]


def _renamed(recording: NDArray[np.str_], new: Mapping[str, str]) -> NDArray[np.str_]:
    return np.array([new.get(name, name) for name in recording.tolist()])
