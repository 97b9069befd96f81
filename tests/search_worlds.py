"""Odour-search worlds, walks through them, and recordings to start them from."""

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from recordings import recordings_of

from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.scenario import Scenario
from animarl_envs.species import SILKMOTH
from animarl_envs.worlds.search.world import SearchWorld

ODOUR, FLOW, WIND = slice(3, 5), 5, slice(6, 10)
STRAIGHT_UPWIND, DOWNWIND = 0, 6


def search_world(copies: int = 1, *, start: Any = "uniform", **options: Any) -> SearchWorld:
    """A world that was reset; ``condition``, ``demos``, and fields of the species."""
    condition = options.pop("condition", 0)
    demos = options.pop("demos", None)
    species = replace(SILKMOTH, **options)
    scenario = Scenario(
        species=species, start="demo" if demos else start, condition=condition, demos=demos,
        drivers=("action",),
    )  # fmt: skip
    world = SearchWorld(scenario, copies)
    world.reset()
    return world


def rollout(world: SearchWorld, actions: NDArray[np.integer]) -> NDArray[np.float32]:
    """Observations ``(steps + 1, copies, n)`` under actions ``(steps, copies)``."""
    seen = [world.observation[:, 0].copy()]
    for row in actions:
        world.step(row[:, None])
        seen.append(world.observation[:, 0].copy())
    return np.stack(seen)


def random_actions(steps: int, copies: int, seed: int = 0) -> NDArray[np.int64]:
    """Runs of equal actions, so that speed builds up."""
    rng = np.random.default_rng(seed)
    return np.repeat(rng.integers(13, size=(steps // 4 + 1, copies)), 4, axis=0)[:steps]


def recorded(**signals: Any) -> Demonstrations:
    """Six walks of 40 frames with the odour that was met, in a plume that is not known."""
    walks = recordings_of("silkmoth")
    odour = {name: walks.signals[name] for name in ("odour_left", "odour_right")}
    return replace(walks, signals=odour | signals)
