"""How far what policies see leaves what they were trained on.

The share of an individual's steps with any input beyond the central 99.8 % of its training inputs
separates wrong from right predictions with an AUC of .86 over 61 changes with a known truth. It
does not see changed dynamics that leave the inputs alone (damping x 2), so two readings are
compared too.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from animarl_algos.evaluation.collect import Policy
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.species import Species
from animarl_envs.worlds import demonstration_observations, observation_components

Floats = NDArray[np.float64]

TAIL = 0.001  # of the training inputs, on either side
YELLOW, RED = 0.05, 0.25  # more steps beyond than in the unchanged world
# Of 39 changes below YELLOW 3 were predicted wrongly, of 11 above RED 8.


class Caution(StrEnum):
    """How far an answer is from what policies were trained on."""

    NONE = "none"
    SOME = "some"
    RED = "red"


@dataclass(frozen=True)
class InputRange:
    """The central range of training inputs, ``(individuals, components)`` each."""

    low: Floats
    high: Floats
    names: tuple[str, ...]

    @classmethod
    def of(cls, species: Species, training: Demonstrations) -> InputRange:
        """Return the range of what individuals observed along recordings."""
        seen = demonstration_observations(species, training)
        low, high = np.quantile(seen, [TAIL, 1.0 - TAIL], axis=0)
        margin = 1e-6 * (1.0 + np.abs(high - low))
        names = tuple(component.name for component in observation_components(species))
        return cls(low - margin, high + margin, names)


class WatchedPolicy:
    """A policy that acts as before, and counts how often its inputs leave their range.

    Attributes
    ----------
    steps, beyond
        ``(individuals,)`` steps, and those with any input beyond its range.
    components
        ``(individuals, components)`` steps with this input beyond its range.
    """

    def __init__(self, policy: Policy, inputs: InputRange) -> None:
        self.policy, self.inputs = policy, inputs
        individuals, components = inputs.low.shape
        self.steps, self.beyond = np.zeros((2, individuals))
        self.components = np.zeros((individuals, components))
        self._pending: NDArray[np.bool_] | None = None

    def __getattr__(self, name: str) -> Any:
        return getattr(self.policy, name)

    def predict(
        self,
        observation: Any,
        state: Any = None,
        episode_start: Any = None,
        deterministic: bool = False,
    ) -> tuple[Any, Any]:
        """Ask the policy, and remember which inputs were beyond their range."""
        self.finish()
        individuals, components = self.inputs.low.shape
        seen = observation[:, :components].reshape(-1, individuals, components)
        self._pending = (seen < self.inputs.low) | (seen > self.inputs.high)
        self._alive = np.ones(self._pending.shape[:2], dtype=bool)
        return self.policy.predict(observation, state, episode_start, deterministic)

    def leave_out(self, state: Any, ended: NDArray[np.bool_]) -> Any:
        """Do not count the slots of episodes that have ended."""
        self._alive &= ~ended.reshape(self._alive.shape)
        inner = getattr(self.policy, "leave_out", None)
        return state if inner is None else inner(state, ended)

    def finish(self) -> None:
        """Count the last step."""
        if self._pending is None:
            return
        beyond = self._pending & self._alive[..., None]
        self.steps += self._alive.sum(axis=0)
        self.beyond += beyond.any(axis=2).sum(axis=0)
        self.components += beyond.sum(axis=0)
        self._pending = None

    def shares(self) -> tuple[Floats, Floats]:
        """Return the shares of steps: of any input, and of each ``(individuals, components)``."""
        self.finish()
        steps = np.maximum(self.steps, 1.0)
        return self.beyond / steps, self.components / steps[:, None]
