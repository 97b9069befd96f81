"""Batched simulators by the name that a species has for its world."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from animarl_envs.array_types import Ints
from animarl_envs.species import Species

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
    """Return the world of the scenario's species, with so many copies.

    ``observers`` are the individuals whose observations are wanted, by default all.
    """
    name = WORLDS[scenario.species.world][1]
    world: World = getattr(_module(scenario.species), name)(scenario, num_copies, observers)
    return world


def demonstration_observations(species: Species, demos: Demonstrations) -> NDArray[np.float32]:
    """Return observations of all recorded frames ``(frames, K, n)``, as its world gives them."""
    seen: NDArray[np.float32] = _module(species).demonstration_observations(species, demos)
    return seen


def observation_components(species: Species) -> tuple[ObservationComponent, ...]:
    """Return what each entry of the species' observation means, in order."""
    components: tuple[ObservationComponent, ...] = _module(species).observation_components(species)
    return components


def _module(species: Species) -> Any:
    return import_module(WORLDS[species.world][0])


@dataclass(frozen=True)
class Mirror:
    """Observations and actions of a world, seen in a mirror along the x axis of the arena frame."""

    # The mirrored observation has component order[c] times sign[c] in place c.
    order: Ints  # (n,)
    sign: NDArray[np.float32]  # (n,), 1 or -1
    actions: Ints  # (actions,), the mirrored action of each

    def observation(self, seen: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return mirrored observations ``(..., n)``."""
        return seen[..., self.order] * self.sign


def mirror(species: Species) -> Mirror:
    """Return how the species' world looks mirrored about the x axis of the arena frame."""
    components, vectors = observation_components(species), species.locomotion[0].action_vectors
    place = {component.name: c for c, component in enumerate(components)}
    order = [place[component.mirror or component.name] for component in components]
    apart = np.linalg.norm(vectors[:, None] * [1.0, -1.0] - vectors[None], axis=2)
    sign = np.array([component.sign for component in components], dtype=np.float32)
    return Mirror(np.array(order, dtype=np.int64), sign, np.argmin(apart, axis=1))
