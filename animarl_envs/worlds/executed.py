"""Which actions a world executes: during its warm-up the demonstrated ones, whatever is asked."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from animarl_envs.fitting.transitions import demonstrated_actions
from animarl_envs.worlds.base import World


class ExecutedActions:
    """Of one world; to be asked before the step that executes them.

    A policy that sees its previous action must see what was done, in a simulator as in
    demonstrations: a step of the warm-up is replayed, so the action asked for was never executed.
    """

    def __init__(self, world: World) -> None:
        self._world = world
        demos, species = world.demos, world.scenario.species
        self._demonstrated: NDArray[np.int64] | None = None
        if demos is not None and world.scenario.paired and species.warmup > 0:
            self._demonstrated = demonstrated_actions(demos, species.locomotion).astype(np.int64)
            self._first = demos.offsets[:-1]

    def __call__(self, actions: NDArray[np.integer]) -> NDArray[np.integer]:
        """``actions`` ``(B, K)``, with the demonstrated ones in copies that are warming up."""
        warming = self._world.warming
        if self._demonstrated is None or not warming.any():
            return actions
        frame = self._first[self._world.demo] + self._world.step_count
        shown = self._demonstrated[np.where(warming, frame, 0)]
        return np.where(warming[:, None], shown, actions)
