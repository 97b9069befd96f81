"""Slots of a VecEnv: which individual each holds, and the feedback that comes with a step."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv, VecNormalize, is_vecenv_wrapped

from animarl_envs.errors import InputError
from animarl_envs.worlds.base import World


def refuse_other_actions(learned: int, here: int) -> None:
    """Refuse a world with another number of actions than the learner has values for."""
    if learned != here:
        raise InputError(
            f"Action spaces do not match, {learned} actions learned and {here} here: give the "
            "environment it was trained in, of animals with the same thrust magnitudes"
        )


def observed_components(world: World) -> tuple[str, ...]:
    """Return the species of ``world``, then the names of the observed components in order."""
    return (world.scenario.species.name, *(one.name for one in world.observation_components))


def refuse_other_observation(learned: tuple[str, ...], here: tuple[str, ...]) -> None:
    """Refuse an observation other than the one that was learned from, of the same size or not.

    Where one of the two is not known, as of environments of other packages, nothing is compared.
    """
    if not learned or not here or learned == here:
        return
    if learned[0] != here[0]:
        what = f"is of the species {here[0]}, this learner of {learned[0]}"
    elif new := [name for name in here if name not in learned]:
        what = f"shows {new[0]!r}, which this learner has not learned from"
    elif gone := [name for name in learned if name not in here]:
        what = f"does not show {gone[0]!r}, which this learner has learned from"
    else:
        what = "shows what this learner has learned from in another order"
    raise InputError(f"the environment {what}: give the one it was trained in")


@dataclass(frozen=True)
class SlotLayout:
    """Slot ``s`` of a VecEnv is individual ``s % K`` of copy ``s // K`` of the world.

    A VecEnv without the attributes ``num_copies`` and ``individuals`` (any ordinary Gymnasium
    environment) has one individual per copy, called ``agent``. All slots of a copy end together.
    """

    num_copies: int
    individuals: tuple[str, ...]  # the K names
    condition_flag: bool  # the last observation component is the experimental condition
    observed: tuple[str, ...] = ()  # as observed_components has it; empty where nobody says

    @property
    def num_individuals(self) -> int:
        return len(self.individuals)

    @classmethod
    def of(cls, env: VecEnv) -> SlotLayout:
        if is_vecenv_wrapped(env, VecNormalize):
            raise InputError(
                "VecNormalize is not supported by sequence replay (its statistics would change "
                "under stored sequences): scale the observations in the environment instead"
            )
        individuals = tuple(getattr(env, "individuals", ("agent",)))
        num_copies = int(getattr(env, "num_copies", env.num_envs))
        if num_copies * len(individuals) != env.num_envs:
            raise InputError(
                f"the environment has {env.num_envs} slots, not {num_copies} copies of "
                f"{len(individuals)} individuals: make num_copies and individuals agree"
            )
        observed = getattr(env, "observed", ())
        known = observed if isinstance(observed, tuple) else ()  # another's word for something else
        return cls(num_copies, individuals, bool(_declared(env, "condition_flag")), known)


def refuse_other_slots(there: SlotLayout, here: SlotLayout) -> None:
    """Refuse the slots of an environment that are not those a learner was made for."""
    if _described(there) != _described(here):
        raise InputError(
            f"the environment has {_described(there)}, this learner {_described(here)}: give "
            "one with the same individuals"
        )
    refuse_other_observation(here.observed, there.observed)


def _described(layout: SlotLayout) -> str:
    flag = "a" if layout.condition_flag else "no"
    return f"the individuals {', '.join(layout.individuals)} and {flag} condition flag"


def provided(env: VecEnv) -> tuple[str, ...]:
    """Return what comes with each step beside the reward, as the environment's ``feedback`` says.

    ``dtw_penalty`` is the distance to a demonstration, ``aligned_action`` the demonstrated action
    aligned with each state.
    """
    return tuple(_declared(env, "feedback") or ())


def _declared(env: VecEnv, name: str) -> Any:
    """An attribute of the VecEnv or of its environments, None if neither has it."""
    if hasattr(env, name):
        return getattr(env, name)
    return env.get_attr(name, indices=0)[0] if env.has_attr(name) else None


class Feedback:
    """Per-slot values that accompany a step, as arrays ``(slots,)``.

    Read from the array attribute ``extras`` of the VecEnv where it has one (fast), otherwise from
    the per-slot ``infos``.
    """

    def __init__(self, env: VecEnv) -> None:
        self._env = env
        self._has_extras = hasattr(env, "extras")
        self._infos: list[dict[str, Any]] = []

    def update(self, infos: list[dict[str, Any]]) -> None:
        """Take in the ``infos`` of the step just done."""
        self._infos = infos

    def get(self, name: str) -> NDArray[Any] | None:
        """The values called ``name`` of the last step, or None if the environment gives none."""
        if self._has_extras:
            found = self._env.extras.get(name)  # type: ignore[attr-defined]
            return None if found is None else np.asarray(found).reshape(-1)
        if name not in self._infos[0]:
            return None
        return np.array([info[name] for info in self._infos])

    def executed(self, actions: NDArray[np.integer]) -> NDArray[np.integer]:
        """The actions ``(slots,)`` of the last step: a warm-up replays others than asked for."""
        replayed = self.get("executed")
        return actions if replayed is None else replayed


class MixedMeansWarning(UserWarning):
    """Returns of different individuals are about to be averaged."""


def warn_of_mixed_means(individuals: Sequence[str]) -> None:
    """Warn that stable-baselines3 is about to average over the individuals.

    Its evaluation is the only caller that asks a VecEnv whether it is wrapped in a ``Monitor``.
    """
    warnings.warn(
        f"evaluate_policy, EvalCallback and VecMonitor average over {', '.join(individuals)}: use "
        "animarl_algos.evaluate_individuals and EvaluateIndividuals for each by itself",
        MixedMeansWarning,
        stacklevel=4,
    )


def focal_drivers(names: tuple[str, ...], focal: str | None) -> dict[str, str]:
    """Return drivers by which all but ``focal`` replay their demonstration; none without focal."""
    return {name: "replay" for name in names if focal not in (None, name)}


class FocalPolicy:
    """``predict`` for all slots of a world from a policy that knows one individual.

    ``policy`` has stable-baselines3's ``predict``, its slots are the copies; it drives ``focal``
    among all individuals of the world, whose ``names`` are given.
    """

    def __init__(self, policy: Any, names: Sequence[str], focal: str) -> None:
        self.policy = policy
        self.observation_space = policy.observation_space
        self.action_space = policy.action_space
        self.individuals = len(names)
        self.index = tuple(names).index(focal)

    def predict(
        self,
        observation: NDArray[Any],
        state: Any = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = False,
    ) -> tuple[NDArray[np.int64], Any]:
        """Actions ``(slots,)`` of slots ``copy * individuals + individual``; 0 for the others."""
        own = slice(self.index, None, self.individuals)
        actions = np.zeros(len(observation), dtype=np.int64)
        actions[own], state = self.policy.predict(
            observation[own],
            state,
            None if episode_start is None else episode_start[own],
            deterministic,
        )
        return actions, state

    def remember(self, state: Any, executed: NDArray[np.integer]) -> Any:
        """See :meth:`GruPolicy.remember`; ``executed`` of all slots."""
        return self.policy.remember(state, executed[self.index :: self.individuals])

    def leave_out(self, state: Any, over: NDArray[np.bool_]) -> Any:
        """See :meth:`GruPolicy.leave_out`; ``over`` of all slots. Foreign policies have none."""
        leave_out = getattr(self.policy, "leave_out", None)
        return (
            state if leave_out is None else leave_out(state, over[self.index :: self.individuals])
        )
