"""Which recipe of cloning demonstrations ask for: found by looking at them, not by a name.

A recipe is a section of ``zoo_configs/cloning.yml``: labels, size of the networks, whether they are
shared, dropout, updates. Two things decide. First how exact the demonstrated actions are: how far
the best of them misses the next recorded position under the fitted locomotion, in units of the way
that one thrust moves the animal in a step. Programs act exactly, animals do not. Recorded animals
get a recurrent clone. For groups (a recorded shoal gained nothing by it) and synthetic animals, the
number of steps to learn from decides.
"""

from functools import lru_cache
from typing import NamedTuple

import numpy as np

from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.splits import learnable, training_episodes
from animarl_envs.fitting.custom_species import fitted_locomotion
from animarl_envs.fitting.odour import shows_odour
from animarl_envs.fitting.tracking import one_step_misses
from animarl_envs.fitting.transitions import step_frames

EXACT = 0.003
"""Misses of programs that were stored with 4 digits or more; root mean square."""
NEARLY = 0.1
"""Another direction misses by half a thrust or more, which is then five times as far."""
FRAMES = 200_000
"""Of all animals, that are looked at."""
FEW_EXACT, FEW_STEPS = 20_000, 35_000
"""Steps of an individual, exact or not, below which they are soon known by heart without dropout,
or with little."""
SEEN_SELDOM = 200_000
"""Steps of a recorded individual of which each is seen fewer than six times in 30 epochs."""
EXACTLY, FEW, ALMOST = "exact", "exact-few", "nearly-exact"
RECURRENT, SEARCH, REMEMBERED = "recurrent", "search", "search-remembered"
BY_CELLS = "cells"
RECORDED, FEW_RECORDED, MANY_RECORDED = "recorded", "recorded-few", "recorded-many"
CLONINGS = (
    *(EXACTLY, FEW, ALMOST, RECURRENT, BY_CELLS, RECORDED, FEW_RECORDED, MANY_RECORDED),
    *(SEARCH, REMEMBERED),
)
"""Their names."""


class RecipeChoice(NamedTuple):
    """A section of ``cloning.yml``, and what decided, in a few words."""

    name: str
    reason: str


@lru_cache(maxsize=8)  # a benchmark asks for every cell
def choose_recipe(demos: Demonstrations) -> RecipeChoice:
    """Return the recipe for demonstrations, by their training episodes (all, if there are none)."""
    demos = learnable(demos)
    if "searcher" in demos.roles:
        if shows_odour(demos):
            return RecipeChoice(REMEMBERED, "the searcher's inputs hold what was smelled before")
        return RecipeChoice(SEARCH, "a search goes by what was smelled before")
    miss, steps = action_miss(demos)
    reason = f"actions miss by {miss:.2g} thrusts, {steps} steps of each individual"
    if miss >= NEARLY:
        reason += f": not exact (from {NEARLY:g})"
        if not (demos.synthetic or demos.is_group):
            return RecipeChoice(RECURRENT, f"{reason}, and animals go by what they just did")
        if steps < FEW_STEPS:
            return RecipeChoice(FEW_RECORDED, f"{reason}, few (below {FEW_STEPS})")
        if steps < SEEN_SELDOM:
            return RecipeChoice(RECORDED, reason)
        return RecipeChoice(MANY_RECORDED, f"{reason}, many (from {SEEN_SELDOM})")
    if miss >= EXACT:
        return RecipeChoice(ALMOST, f"{reason}: nearly exact (from {EXACT:g} to {NEARLY:g})")
    if steps < FEW_EXACT:
        return RecipeChoice(FEW, f"{reason}: exact (below {EXACT:g}), few (below {FEW_EXACT})")
    return RecipeChoice(EXACTLY, f"{reason}: exact (below {EXACT:g})")


def action_miss(demos: Demonstrations) -> tuple[float, int]:
    """Return by how much the nearest actions miss, and how many steps each individual has.

    The miss is the root mean square over the steps of the individual of whom it is largest, in
    units of ``u dt^2``, the way that one thrust makes in a step.
    """
    seen = training_episodes(demos)
    steps, locomotion = len(step_frames(seen)), fitted_locomotion(demos)
    every = 1 + seen.positions[..., 0].size // FRAMES
    some = seen.select(episodes=range(0, seen.num_episodes, every))
    misses = one_step_misses(some, locomotion).min(axis=2)[step_frames(some)]
    thrusts = np.array([own.thrust for own in locomotion]) * some.dt**2
    return float((np.sqrt((misses**2).mean(axis=0)) / thrusts).max()), steps
