"""Batched simulators. ``make_world`` picks the one a species lives in."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from animarl_envs.species import ChaseSpecies, SearchSpecies, Species

if TYPE_CHECKING:
    from animarl_envs.demos.demonstrations import Demonstrations
    from animarl_envs.scenario import Scenario
    from animarl_envs.worlds.base import World

__all__ = ["demonstration_observations", "make_world"]


def make_world(scenario: Scenario, num_copies: int = 1) -> World:
    """The world of the scenario's species, with so many copies."""
    if isinstance(scenario.species, SearchSpecies):
        from animarl_envs.worlds.search.world import SearchWorld

        return SearchWorld(scenario, num_copies)
    from animarl_envs.worlds.chase.world import ChaseWorld

    return ChaseWorld(scenario, num_copies)


def demonstration_observations(species: Species, demos: Demonstrations) -> NDArray[np.float32]:
    """Observations of all recorded frames ``(frames, K, n)``, as the world would give them."""
    if isinstance(species, SearchSpecies):
        from animarl_envs.worlds.search.world import demonstration_observations as observe_search

        return observe_search(species, demos)
    from animarl_envs.worlds.chase.world import observe

    assert isinstance(species, ChaseSpecies)
    return observe(species, demos.positions, demos.velocities())[0]
