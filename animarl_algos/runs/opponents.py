"""Individuals that nobody controls, driven by the network that comes with the package."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np

from animarl_algos.networks.policies import FINISHED, CompiledActor
from animarl_algos.runs.pretrained import load_run, pretrained_names
from animarl_algos.runs.run import Run
from animarl_envs.array_types import Ints
from animarl_envs.errors import InputError
from animarl_envs.scenario import Scenario
from animarl_envs.species import SPECIES
from animarl_envs.worlds.base import World
from animarl_envs.worlds.chase.world import ChaseWorld, observing_world
from animarl_envs.worlds.streams import draw_uniforms


class PackagedOpponents:
    """Drives individuals of all copies of a world by the packaged network of its species.

    They observe what the network learned from, whatever the others observe, without noise or
    delay. Every action is drawn by the model's acting rule with a number of its copy's random
    stream, and no network remembers, so that a copy does the same alone as among others.

    Parameters
    ----------
    scenario, num_copies
        What the world is made of.
    driven
        Indices of the individuals.

    Raises
    ------
    InputError
        If the package has no network of the species, or of individuals with these senses.
    """

    def __init__(self, scenario: Scenario, num_copies: int, driven: Collection[int]) -> None:
        self._made_of = scenario, num_copies, driven
        species = scenario.species
        run = _load_packaged(species.name)
        policy = run.policy.policy
        learned: Any = run.policy.get_env()
        assert not (policy.recurrent or policy.q_net.previous_action)
        arena = replace(species.arena, rebound=run.species.arena.rebound)
        seen: Any = replace(species, observation=run.species.observation, arena=arena)
        count = species.num_individuals
        self._senses = observing_world(seen, num_copies, driven)
        if _interface(self._senses) != _interface(learned.world):
            raise InputError(
                f"others='packaged' drives {', '.join(run.species.individuals)} as they come with "
                f"the package, but options changed {species.name}'s individuals, their actions or "
                "senses: leave these options out, or choose 'scripted' or a function"
            )
        self._flagged = learned.condition_flag
        self._actor = CompiledActor(policy.q_net)
        self._driven = sorted(driven)
        temperature = np.broadcast_to(policy.acting.temperature, count)[self._driven]
        self._acting = replace(policy.acting, temperature=tuple(temperature.tolist()))
        previous = np.full((num_copies, count), FINISHED)  # slots that cost nothing
        previous[:, self._driven] = policy.num_actions
        self._previous = previous.ravel()
        self._hidden = np.zeros((previous.size, policy.q_net.units), dtype=np.float32)

    def act(self, world: ChaseWorld, actions: Ints) -> None:
        """Write the next actions of the driven individuals into ``actions``, ``(B, K)``."""
        self._senses.look_at(world)
        seen = self._senses.observation
        if self._flagged:
            flag = np.broadcast_to(world.condition[:, None, None], (*actions.shape, 1))
            seen = np.concatenate([seen, flag], axis=2, dtype=np.float32)
        values = self._actor.decide(
            np.ascontiguousarray(seen.reshape(actions.size, -1)), self._previous, self._hidden
        )
        own = values.reshape(*actions.shape, -1)[:, self._driven]
        draws = np.empty(own.shape[:2])
        draw_uniforms(world.random_state, draws)
        chosen = self._acting.choose(own.reshape(draws.size, -1), draws.ravel(), len(self._driven))
        actions[:, self._driven] = chosen.reshape(draws.shape)

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle and copy what it is made of: it has no state."""
        return type(self), self._made_of


@cache
def _load_packaged(species: str) -> Run:
    """Load the packaged model of a species that has several individuals."""
    known = pretrained_names()
    models = [name for name in SPECIES if name in known and SPECIES[name].num_individuals > 1]
    if species not in models:
        raise InputError(
            f"others is 'packaged', but no network of {species} comes with the package, only of "
            f"{', '.join(models)}: choose 'replay', 'scripted', 'coast' or a function"
        )
    return load_run(species)


def _interface(world: World) -> tuple[Any, ...]:
    """Return what a network of the world's individuals depends on."""
    species = world.scenario.species
    names = [component.name for component in world.observation_components]
    return species.individuals, species.roles, world.num_actions, names
