"""Generators of the packaged demonstrations, and the plume's calibration."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.species import Species


def demonstrations_of(
    species: Species,
    paths: Sequence[NDArray[np.float64]],
    signals: Mapping[str, Sequence[NDArray[Any]]],
    **more: Any,
) -> Demonstrations:
    """Return episodes of all individuals of a species.

    ``paths`` are ``(frames, individuals, 2)`` of each episode [arena unit], ``signals`` by name
    ``(frames, ...)`` of each, ``more`` the other fields; by default everybody starts at rest.
    """
    at_rest = np.zeros((len(paths), species.num_individuals, 2))
    return Demonstrations(
        species=species.name,
        individuals=species.individuals,
        roles=species.roles,
        dt=species.dt,
        arena=species.arena,
        positions=np.concatenate(paths),
        lengths=np.array([len(path) for path in paths]),
        signals={name: np.concatenate(series) for name, series in signals.items()},
        **{"initial_velocity": at_rest} | more,
    )
