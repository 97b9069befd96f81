"""How far the inputs of policies leave the range of training.

The share of an individual's steps with any input beyond the central 99.8 % of its training inputs
separates wrong from right predictions with an AUC of .86 over 61 changes with a known truth. It
does not see changed dynamics that leave the inputs alone (damping x 2), so two readings are
compared too.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

import numpy as np

from animarl_algos.evaluation.collect import Policy, WrappedPolicy
from animarl_envs.array_types import Bools, Floats
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.focus import is_free
from animarl_envs.species import Species
from animarl_envs.worlds import demonstration_observations, observation_components
from animarl_envs.worlds.base import ObservationComponent

TAIL = 0.001  # of the training inputs, on either side
YELLOW, RED = 0.05, 0.25  # more steps beyond than in the unchanged world
# Of 39 changes below YELLOW 3 were predicted wrongly, of 11 above RED 8.
PAIR = r"\[(.*?)\|(.*?)\]"  # [below|above] in a component's description


def describe_departures(component: ObservationComponent) -> tuple[str, str]:
    """Return what an input below its training range means to an individual, and one above it.

    ``{2}`` stands for the second of the others, as :func:`others_in_order` names them.
    """
    text = component.description or f"{component.name} is [lower|higher]"
    below, above = (f"{re.sub(PAIR, end, text)} than ever in training" for end in (r"\1", r"\2"))
    return below, above


def others_in_order(species: Species, individual: int) -> list[str]:
    """Return the others in the order in which an individual perceives them.

    The last individual, which all others face, comes first; several others are ordered by distance.
    """
    names = species.individuals
    faced = not is_free(species.roles) and individual < len(names) - 1
    first = [names[-1]] * faced
    rest = [name for name in names if name not in (names[individual], *first)]
    if len(rest) > 1:
        ordinals = ["", "second ", "third ", *(f"{k}th " for k in range(4, len(rest) + 1))]
        rest = [f"the {ordinals[k]}nearest other" for k in range(len(rest))]
    return [*first, *rest]


class Caution(StrEnum):
    """Warning of an answer whose inputs leave the range of training."""

    NONE = "none"
    SOME = "some"
    RED = "red"


@dataclass(frozen=True)
class InputRange:
    """The central range of training inputs.

    Parameters
    ----------
    low, high
        ``(individuals, components)`` each.
    words
        Description of every component below its range, and then above it
        (:func:`describe_departures`).
    others
        Names of the others in the words of each individual.
    """

    low: Floats
    high: Floats
    words: tuple[str, ...]
    others: tuple[Sequence[str], ...]

    @classmethod
    def of(cls, species: Species, training: Demonstrations) -> InputRange:
        """Return the range of what individuals observed along recordings."""
        seen = demonstration_observations(species, training)
        low, high = np.quantile(seen, [TAIL, 1.0 - TAIL], axis=0)
        margin = 1e-6 * (1.0 + np.abs(high - low))
        below, above = zip(*map(describe_departures, observation_components(species)), strict=True)
        others = tuple(others_in_order(species, i) for i in range(len(species.individuals)))
        return cls(low - margin, high + margin, below + above, others)

    def of_individuals(self, own: Sequence[int]) -> InputRange:
        """Return the range of some of the individuals."""
        others = tuple(self.others[i] for i in own)
        return InputRange(self.low[own], self.high[own], self.words, others)

    def what(self, individual: int, side: int) -> str:
        """Return what leaves the range in words, as :class:`WatchedPolicy` counts it."""
        return self.words[side].format("", *self.others[individual])


class WatchedPolicy(WrappedPolicy):
    """A policy that acts as before, and counts how often its inputs leave their range.

    Attributes
    ----------
    steps, beyond
        ``(individuals,)`` steps, and those with any input beyond its range.
    sides
        ``(individuals, 2 components)`` steps with this input below its range, then above it.
    """

    def __init__(self, policy: Policy, inputs: InputRange) -> None:
        super().__init__(policy)
        self.inputs = inputs
        individuals, components = inputs.low.shape
        self.steps, self.beyond = np.zeros((2, individuals))
        self.sides = np.zeros((individuals, 2 * components))
        self._pending: Bools | None = None

    def rewrap(self, policy: Policy) -> WatchedPolicy:
        """Wrap another policy, and count into the same record."""
        self.policy = policy
        return self

    def predict(self, observation: Any, *more: Any, **known: Any) -> tuple[Any, Any]:
        """Ask the policy, and remember which inputs were beyond their range."""
        self.finish()
        individuals, components = self.inputs.low.shape
        seen = observation[:, :components].reshape(-1, individuals, components)
        sides = (seen < self.inputs.low, seen > self.inputs.high)
        self._pending = np.concatenate(sides, axis=2)
        self._alive = np.ones(self._pending.shape[:2], dtype=bool)
        return self.policy.predict(observation, *more, **known)

    def leave_out(self, state: Any, ended: Bools) -> Any:
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
        self.sides += beyond.sum(axis=0)
        self._pending = None

    def shares(self) -> tuple[Floats, Floats]:
        """Return the shares of steps beyond: of any input, and of each below and above."""
        self.finish()
        steps = np.maximum(self.steps, 1.0)
        return self.beyond / steps, self.sides / steps[:, None]
