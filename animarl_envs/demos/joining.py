"""Several sets of demonstrations as one: the same animals in the same arena, several recordings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.errors import InputError

ALIKE = ("species", "individuals", "roles", "dt", "arena")
PER_EPISODE = ("lengths", "initial_velocity", "condition", "outcome", "split", "recording")


def join(parts: Sequence[Demonstrations], name: str = "joined") -> Demonstrations:
    """All episodes one after the other, each with its condition, split and recording.

    The provenance is that of the first, with those of all under ``joined``.

    Raises
    ------
    InputError
        If there is none, or two differ in species, individuals, time step, arena or signals.
    """
    if not parts:
        raise InputError("there are no demonstrations to join: give one set or more")
    first = parts[0]
    for part in parts[1:]:
        for key in ALIKE:
            if getattr(part, key) != getattr(first, key):
                raise InputError(
                    f"{part.name} and {first.name} differ in {key}: join recordings of the same "
                    "animals in the same arena"
                )
        if set(part.signals) != set(first.signals):
            raise InputError(
                f"{part.name} and {first.name} hold different signals: join sets with the same"
            )
    episodes: dict[str, Any] = {
        key: np.concatenate([getattr(part, key) for part in parts]) for key in PER_EPISODE
    }
    return replace(
        first,
        positions=np.concatenate([part.positions for part in parts]),
        signals={k: np.concatenate([part.signals[k] for part in parts]) for k in first.signals},
        provenance={**first.provenance, "joined": [dict(part.provenance) for part in parts]},
        name=name,
        **episodes,
    )
