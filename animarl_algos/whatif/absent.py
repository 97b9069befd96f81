"""Removed pursuers: the world without them, as policies perceive it that learned with them.

A trained network has inputs for each of the others. It perceives a removed pursuer far away: beyond
the pursuer nearest to the target, farther from the target than 95 % of the pursuers in training,
and moving as the nearest does. So a removed pursuer drives nobody, and the inputs stay near the
training range. The warning says how near.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, TypeGuard

import numpy as np
from numpy.typing import NDArray

from animarl_algos.evaluation.collect import Cue, Policy, WrappedPolicy
from animarl_algos.evaluation.rollouts import Rollouts
from animarl_envs.array_types import Bools, Floats, Ints
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.errors import InputError
from animarl_envs.focus import FALLBACK
from animarl_envs.scenario import Condition, Scenario
from animarl_envs.species import ChaseSpecies, Species
from animarl_envs.species.base import Reading
from animarl_envs.species.options import change_world
from animarl_envs.worlds.chase.world import ChaseWorld, observing_world

DISTANCE_QUANTILE = 0.95  # quantile of the distances of pursuers from the target in training
# Times the distance of the nearest pursuer: at the same distance, rounding would order the two.
DISTANCE_FACTOR_OF_REMOVED = 1.05
# From the nearest pursuer: training has nobody exactly behind another, and that alone would be new.
ANGLE_OF_REMOVED = np.deg2rad(20.0)


@dataclass(frozen=True)
class Present:
    """The individuals of a species that are left (``own``) among ``everybody``."""

    everybody: ChaseSpecies
    own: tuple[int, ...]

    @classmethod
    def without(cls, species: Species, absent: Sequence[str]) -> Present:
        """Return those that are left when some are removed.

        Raises
        ------
        InputError
            If one that is removed is not a pursuer of a single target, or no pursuer is left.
        """
        names = species.individuals
        pursuers = [n for n, role in zip(names, species.roles, strict=True) if role == "pursuer"]
        left = [name for name in pursuers if name not in absent]
        if not _one_target(species) or not set(absent) <= set(pursuers) or not left:
            raise InputError(
                f"{', '.join(absent)} cannot be removed: only a pursuer of one target can, and one "
                "must be left; train a run without it"
            )
        if species.has_headings:
            raise InputError(
                f"{', '.join(absent)} cannot be removed, because headings of the others are "
                "perceived: train a run without it"
            )
        return cls(species, tuple(i for i, name in enumerate(names) if name not in absent))

    @property
    def species(self) -> ChaseSpecies:
        """Species of the individuals that are left."""
        return self.everybody.of_individuals(self.own)


def _one_target(species: Species) -> TypeGuard[ChaseSpecies]:
    return isinstance(species, ChaseSpecies) and not (species.free or species.lone_pursuer)


def can_remove(species: Species) -> bool:
    """Return whether some of the pursuers of a species can be removed."""
    several = species.roles.count("pursuer") > 1
    return several and _one_target(species) and not species.has_headings


def simulate_from(
    run: Any,
    demos: Demonstrations,
    absent: Sequence[str] = (),
    *,
    reading: Reading,
    flag: Cue = "actual",
    condition: Condition = "demo",
    repetitions: int = 5,
    wrap: Callable[[Policy], Policy] = lambda policy: policy,
    **options: Any,
) -> Rollouts:
    """Return rollouts as :meth:`animarl_algos.runs.run.Run.simulate` does, from other starts.

    ``demos`` have the starts; the individuals ``absent`` are removed.
    """
    species, make, act = change_world(run.scenario.species, reading, **options), None, wrap
    if absent:
        present = Present.without(species, absent)
        demos, species = demos.of_individuals(present.own), present.species
        farthest = farthest_pursuer(run.demos.select(split="train"))

        def act(policy: Policy) -> Policy:
            return wrap(SubsetPolicy(policy, present))

    scenario = run.starting_from(None, condition, demos=demos, species=species)
    if absent:
        make = partial(FewerWorld, scenario, present=present, farthest=farthest)
    rollouts: Rollouts = run.roll_out(
        run.policy,
        "what if",
        flag if run.has_condition_flag else None,
        scenario=scenario,
        repetitions=repetitions,
        wrap=act,
        make=make,
    )
    return rollouts


def farthest_pursuer(demos: Demonstrations) -> float:
    """Return the distance from the target that counts as far for pursuers [arena unit]."""
    apart = np.linalg.norm(demos.positions[:, :-1] - demos.positions[:, -1:], axis=-1)
    return float(np.quantile(apart, DISTANCE_QUANTILE))


class FewerWorld(ChaseWorld):
    """A chase of the individuals that are left; observations have inputs for all.

    Parameters
    ----------
    scenario
        Of the individuals that are left.
    present
        Which ones these are.
    farthest
        Least distance from the target at which removed ones are perceived [arena unit].
    """

    def __init__(
        self, scenario: Scenario, num_copies: int, present: Present, farthest: float
    ) -> None:
        super().__init__(scenario, num_copies)
        if self._disturbed:
            raise InputError("somebody is removed, but senses are noisy or late: leave one out")
        number, self._farthest = present.everybody.num_individuals, farthest
        self._own = list(present.own)
        self._absent = [i for i in range(number) if i not in self._own]
        self._everybody = observing_world(present.everybody, num_copies, self._own)

    def _start(self, mask: Bools) -> None:
        super()._start(mask)
        self._show()

    def _advance(self, actions: NDArray[np.integer], observed: bool) -> None:
        super()._advance(actions, observed)
        self._show()

    def _show(self) -> None:
        """Make the observations of those that are left, with the removed ones far away."""
        nearest, place = self._place_of_absent()
        whole, copies = self._everybody, np.arange(self.num_copies)
        whole.position[:, self._own] = self.position
        whole.velocity[:, self._own] = self.velocity
        whole.acceleration[:, self._own] = self.acceleration
        whole.past[:, :, self._own] = self.past
        whole.position[:, self._absent] = place[:, None]
        whole.velocity[:, self._absent] = self.velocity[copies, nearest][:, None]
        whole.step_count[:] = self.step_count
        whole._look()
        self.observation = np.ascontiguousarray(whole.observation[:, self._own])

    def _place_of_absent(self) -> tuple[Ints, Floats]:
        """Return the pursuer nearest to the target in each copy, and the place beyond it."""
        target = self._position[-1]
        away = self._position[:-1] - target
        apart = np.linalg.norm(away, axis=1)
        nearest, copies = apart.argmin(axis=0), np.arange(self.num_copies)
        ahead, length = away[nearest, :, copies], apart[nearest, copies][:, None]
        direction = np.where(length > 0, ahead / np.maximum(length, 1e-12), FALLBACK)
        cosine, sine = np.cos(ANGLE_OF_REMOVED), np.sin(ANGLE_OF_REMOVED)
        turn = np.array([[cosine, sine], [-sine, cosine]])
        distance = np.maximum(DISTANCE_FACTOR_OF_REMOVED * length, self._farthest)
        return nearest, target.T + direction @ turn * distance


class SubsetPolicy(WrappedPolicy):
    """A policy for all individuals, asked for those that are left.

    Removed ones still draw actions, so that the others' random streams do not shift.
    """

    def __init__(self, policy: Policy, present: Present) -> None:
        super().__init__(policy)
        self.own = np.array(present.own)
        self.source = np.zeros(present.everybody.num_individuals, dtype=np.int64)
        self.source[self.own] = np.arange(len(self.own))

    def _for_all(self, of_own: Any) -> Any:
        slots = np.asarray(of_own)
        each = slots.reshape(-1, len(self.own), *slots.shape[1:])
        return np.ascontiguousarray(each[:, self.source]).reshape(-1, *slots.shape[1:])

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, **known: Any
    ) -> tuple[Any, Any]:
        """Return the actions of those that are left, and the state of all."""
        started = self._for_all(episode_start)
        actions, state = self.policy.predict(self._for_all(observation), state, started, **known)
        return np.asarray(actions).reshape(-1, len(self.source))[:, self.own].ravel(), state

    def remember(self, state: Any, executed: NDArray[np.integer]) -> Any:
        """Return the state with the executed actions."""
        inner = getattr(self.policy, "remember", None)
        return state if inner is None else inner(state, self._for_all(executed))

    def leave_out(self, state: Any, over: Bools) -> Any:
        """Return the state without the slots of ended episodes."""
        inner = getattr(self.policy, "leave_out", None)
        return state if inner is None else inner(state, self._for_all(over))
