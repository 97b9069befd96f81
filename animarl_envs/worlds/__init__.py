"""Batched simulators by the name that a species has for its world."""

from __future__ import annotations

from collections.abc import Iterable
from importlib import import_module
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from animarl_envs.species import Species
from animarl_envs.worlds.mirror import Mirror, mirror_of

if TYPE_CHECKING:
    from animarl_envs.demos.demonstrations import Demonstrations
    from animarl_envs.scenario import Scenario
    from animarl_envs.worlds.base import ObservationComponent, World

__all__ = ["Mirror", "demonstration_observations", "make_world", "mirror", "observation_components"]

WORLDS = {
    "chase": ("animarl_envs.worlds.chase.world", "ChaseWorld"),
    "search": ("animarl_envs.worlds.search.world", "SearchWorld"),
}
"""Module and class of each world. The module also defines ``observation_components(species)`` and
``demonstration_observations(species, demos)``."""


def make_world(
    scenario: Scenario, num_copies: int = 1, observers: Iterable[int] | None = None
) -> World:
    """The world of the scenario's species, with so many copies.

    ``observers`` are the individuals whose observations are wanted, by default all.
    """
    module, name = WORLDS[scenario.species.world]
    world: World = getattr(import_module(module), name)(scenario, num_copies, observers)
    return world


def demonstration_observations(species: Species, demos: Demonstrations) -> NDArray[np.float32]:
    """Observations of all recorded frames ``(frames, K, n)``, as the world would give them."""
    seen: NDArray[np.float32] = _module(species).demonstration_observations(species, demos)
    return seen


def observation_components(species: Species) -> tuple[ObservationComponent, ...]:
    """What each entry of the species' observation means, in order."""
    components: tuple[ObservationComponent, ...] = _module(species).observation_components(species)
    return components


def mirror(species: Species) -> Mirror:
    """How the species' world looks mirrored about the x axis of the arena frame (y to -y)."""
    return mirror_of(observation_components(species), species.locomotion[0].action_vectors)


def _module(species: Species) -> Any:
    return import_module(WORLDS[species.world][0])
