"""Batched simulators. ``make_world`` picks the one a species lives in."""

from __future__ import annotations

from typing import TYPE_CHECKING

from animarl_envs.species import SearchSpecies

if TYPE_CHECKING:
    from animarl_envs.scenario import Scenario
    from animarl_envs.worlds.base import World

__all__ = ["make_world"]


def make_world(scenario: Scenario, num_copies: int = 1) -> World:
    """The world of the scenario's species, with so many copies."""
    if isinstance(scenario.species, SearchSpecies):
        from animarl_envs.worlds.search import SearchWorld

        return SearchWorld(scenario, num_copies)
    from animarl_envs.worlds.chase import ChaseWorld

    return ChaseWorld(scenario, num_copies)
