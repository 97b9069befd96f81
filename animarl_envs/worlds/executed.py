"""Which actions a world executes: during its warm-up the demonstrated ones, whatever is asked."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from animarl_envs.fitting.transitions import demonstrated_actions
from animarl_envs.worlds.base import World


class ExecutedActions:
    """The executed actions of one world; call it before the step that executes them.

    A policy that sees its previous action must see what was done, in a simulator as in
    demonstrations: a step of the warm-up is replayed, so the action asked for was never executed.
    """

    def __init__(self, world: World) -> None:
        self._world = world
        scenario = world.scenario
        self._replays = world.demos is not None and scenario.paired and scenario.species.warmup > 0

    @cached_property
    def _demonstrated(self) -> NDArray[np.int64]:
        """The actions of all recorded frames, ``(frames, K)``; computed when first needed."""
        assert self._world.demos is not None
        acted = demonstrated_actions(self._world.demos, self._world.scenario.species.locomotion)
        return acted.astype(np.int64)

    def __call__(self, actions: NDArray[np.integer]) -> NDArray[np.integer]:
        """Return ``actions`` ``(B, K)``, the demonstrated ones in copies that are warming up."""
        warming = self._world.warming
        if not self._replays or not warming.any():
            return actions
        assert self._world.demos is not None
        frame = self._world.demos.offsets[:-1][self._world.demo] + self._world.step_count
        shown = self._demonstrated[np.where(warming, frame, 0)]
        return np.where(warming[:, None], shown, actions)
