"""A world as a stable-baselines3 VecEnv: every individual of every copy is one slot.

Slot ``s`` is individual ``s % K`` of copy ``s // K``. All slots of a copy end together and are
reset within the same step, as SB3 expects.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import VecEnv

from animarl_algos.data.species_data import (
    LABEL_OPTIONS,
    SpeciesDemonstrations,
    check_labels,
)
from animarl_envs.array_types import Bools, Ints
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.splits import learnable
from animarl_envs.dtw import DTWTracker
from animarl_envs.errors import InputError, also_list_options_of
from animarl_envs.fitting.transitions import demonstrated_actions
from animarl_envs.scenario import Demos, make_scenario
from animarl_envs.species import Species
from animarl_envs.tasks import find_task
from animarl_envs.views.common import (
    check_actions,
    chosen_demos,
    observation_space,
    reset_options,
)
from animarl_envs.views.single import AnimalEnv
from animarl_envs.worlds import make_world
from animarl_envs.wrappers import Cue, check_cue, cue_of, with_flag

SCENARIO_OPTIONS = ("condition", "observation_noise", "observation_delay")
OWN_OPTIONS = ("split", "focal", "condition_flag", "cue", "dtw", *LABEL_OPTIONS)
"""Options of :class:`SlotVecEnv`: the scenario's, and its own."""


class SlotVecEnv(VecEnv):
    """Copies of a world in which all individuals learn, each in its own slots.

    Parameters
    ----------
    species
        A species, or the name or id of one or of a task (:mod:`animarl_envs.tasks`).
    num_copies
        Copies of the world, ``n``; there are ``n K`` slots.
    demos, split
        Demonstrations with their splits, and the split that episodes start from (``None``: train
        and val). Test episodes are dropped before anything looks at them.
    focal
        Only this individual learns; the others do as in ``gym.make``: they replay their
        demonstration, or follow their script in a task. By default all learn.
    condition_flag, cue
        Whether the condition is the last observation component (``None``: if the species has
        conditions and the demonstrations hold both), and what is told of it.
    dtw
        ``"closeness"``, ``"increment"``, ``"cumulative"`` or ``None``: the penalty handed out as
        ``dtw_penalty`` (:mod:`animarl_envs.dtw`), and with it the demonstrated action aligned with
        each state, as ``aligned_action``. The reward itself stays the task's; weighting is the
        recipe's business.
    labels, label_width
        Of the offline phase; see :class:`animarl_algos.data.species_data.SpeciesDemonstrations`.
    label_horizon
        Of tracking labels; see :func:`animarl_envs.fitting.tracking.track`.
    options
        Of :func:`animarl_envs.scenario.make_scenario`.

    Attributes
    ----------
    extras
        Arrays ``(slots,)`` that came with the last step: ``task_reward``, ``warmup``, ``demo``,
        ``condition``, where a copy warms up ``executed`` (its demonstrated actions, the others'
        as given), and with ``dtw`` also ``dtw_penalty``, ``dtw_refund`` and ``aligned_action``.
    """

    render_mode = None

    def __init__(
        self,
        species: Species | str,
        num_copies: int = 16,
        *,
        demos: Demos = "packaged",
        split: str = "train",
        focal: str | None = None,
        condition_flag: bool | None = False,
        cue: Cue = "actual",
        dtw: str | None = "closeness",
        labels: str = "hard",
        label_width: float = 0.35,
        label_horizon: float = 1.0,
        **options: Any,
    ) -> None:
        if split == "test":
            raise InputError("split is 'test': learners are never given the test split")
        check_labels(labels, label_width, label_horizon)
        with also_list_options_of(SlotVecEnv.__init__, without=("drivers",)):
            full = make_scenario(species, demos=demos, split=None, **options)
        everyone = full.names
        if focal is not None and focal not in everyone:
            raise InputError(f"focal is {focal!r}: choose one of {', '.join(everyone)}")
        self.individuals = everyone if focal is None else (focal,)
        self._learners = np.array([everyone.index(name) for name in self.individuals])
        known = None if full.demos is None else learnable(full.demos)
        replayed = full.paired and find_task(species) is None
        self.demos: Demonstrations | None = known
        self.scenario = make_scenario(
            full.species,
            demos=known,
            split=split if known is not None else None,
            start=full.start,
            drivers=focal_drivers(everyone, focal, "replay" if replayed else "scripted"),
            **{k: v for k, v in options.items() if k in SCENARIO_OPTIONS},
        )
        if condition_flag is None:
            both = known is not None and len(set(known.condition)) == 2
            condition_flag = bool(full.species.conditions) and both
        if condition_flag:
            check_cue(cue, full.species.conditions, full.species.name)
        self.world = make_world(self.scenario, num_copies)
        components = self.world.observation_components
        self.observed = (full.species.name, *(one.name for one in components))
        self.num_copies = num_copies
        self.condition_flag, self.cue = condition_flag, cue
        self.max_episode_steps = full.species.time_limit
        space = observation_space(self.world)
        super().__init__(
            num_copies * len(self.individuals),
            with_flag(space) if condition_flag else space,
            gym.spaces.Discrete(self.world.num_actions),
        )
        self._tracker: DTWTracker | None = None
        if dtw is not None and self.scenario.paired and self.scenario.demos is not None:
            self._tracker = DTWTracker(
                self.scenario.demos, num_copies, self._learners, full.species.contact_radius, dtw
            )
            self.world.trackers.append(self._tracker)
            acted = demonstrated_actions(self.scenario.demos, full.species.locomotion)
            self._demonstrated = acted[:, self._learners].astype(np.int64)
            self._first_frame = self.scenario.demos.offsets[:-1]
        self.extras: dict[str, NDArray[Any]] = {}
        self._all_actions = np.zeros((num_copies, len(everyone)), dtype=np.int64)
        self._return = np.zeros((num_copies, len(self.individuals)))
        self._pending: Ints | None = None
        self._started = False
        self.labels = (labels, label_width, label_horizon)
        self._offline_data: SpeciesDemonstrations | None = None

    # -- stepping ---------------------------------------------------------------------------------

    def reset(self) -> NDArray[np.float32]:
        """Start new episodes in all copies; return observations ``(slots, n)``.

        The first seed is drawn anew where none was given. ``set_options({"demo": i})`` before it
        chooses the demonstration, as in other views.
        """
        given = [reset_options(one, "demo") for one in self._options[:: len(self.individuals)]]
        wanted = [one.get("demo", -1) for one in given] if any(given) else None
        demo = chosen_demos(wanted, self.scenario, self.num_copies)
        seed: Any = self._seeds[0]
        if seed is None and not self._started:
            seed = np.random.SeedSequence().entropy
        self._started = True
        if seed is not None:
            streams = np.random.SeedSequence(seed).generate_state(self.num_copies, np.uint64)
            self.world.seed(streams)
        self._reset_seeds()
        self._reset_options()
        self.world.reset(demo=demo)
        self._return[:] = 0.0
        return self._observation()

    def step_async(self, actions: NDArray[np.integer]) -> None:
        """Check the actions ``(slots,)`` of the next step and keep them."""
        self._pending = check_actions(actions, (self.num_envs,), self.world.num_actions)

    def step_wait(
        self,
    ) -> tuple[NDArray[np.float32], NDArray[np.float32], Bools, list[dict[str, Any]]]:
        """Take the step; copies whose episode ended begin a new one."""
        assert self._pending is not None
        world, K = self.world, len(self.individuals)
        self._all_actions[:, self._learners] = self._pending.reshape(self.num_copies, K)
        extras = {
            "warmup": np.repeat(world.warming, K),
            "demo": np.repeat(world.demo, K),
            "condition": np.repeat(world.condition, K),
        }
        if world.warming.any():
            extras["executed"] = world.executed(self._all_actions)[:, self._learners].ravel()
        if self._tracker is not None:
            # the demonstrated action at the step that each present state is aligned with
            frame = self._first_frame[world.demo][:, None] + self._tracker.aligned
            extras["aligned_action"] = self._demonstrated[frame, np.arange(K)].ravel()
        world.step(self._all_actions)
        reward = world.reward[:, self._learners]
        extras["task_reward"] = reward.astype(np.float32).ravel()
        if self._tracker is not None:
            extras["dtw_penalty"] = self._tracker.penalty.astype(np.float32).ravel()
            extras["dtw_refund"] = self._tracker.refund.astype(np.float32).ravel()
        self.extras = extras
        self._return += reward
        ended = world.terminated | world.truncated
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        if ended.any():
            self._finish(ended, infos)
            world.reset(ended)
            self._return[ended] = 0.0
        return self._observation(), extras["task_reward"].copy(), np.repeat(ended, K), infos

    def _finish(self, ended: Bools, infos: list[dict[str, Any]]) -> None:
        """Fill the infos that SB3 expects of ended episodes, slot by slot."""
        world, K = self.world, len(self.individuals)
        last = self._observation().reshape(self.num_copies, K, -1)
        for b in np.flatnonzero(ended):
            timeout = bool(world.truncated[b] and not world.terminated[b])
            for k in range(K):
                infos[b * K + k] = {
                    "terminal_observation": last[b, k],
                    "TimeLimit.truncated": timeout,
                    "outcome": int(world.outcome[b]),
                    "demo": int(world.demo[b]),
                }
            # one episode of the world: its return is the mean over the pursuers that learn
            pursuers = world.scenario.species.pursuing[self._learners]
            mean = self._return[b, pursuers if pursuers.any() else slice(None)].mean()
            infos[b * K]["episode"] = {"r": float(mean), "l": int(world.step_count[b]), "t": 0.0}

    def _observation(self) -> NDArray[np.float32]:
        observation = np.array(self.world.observation[:, self._learners], order="C")
        rows = observation.reshape(self.num_envs, -1)
        if not self.condition_flag:
            return rows
        flag = np.repeat(cue_of(self.world.condition, self.cue), len(self.individuals))
        return np.concatenate([rows, flag[:, None].astype(np.float32)], axis=1)

    # -- what learners ask ------------------------------------------------------------------------

    @property
    def feedback(self) -> tuple[str, ...]:
        """Names of what comes with a step beside the reward.

        ``dtw_penalty`` is the distance to a demonstration, ``dtw_refund`` what is taken back after
        its end, ``aligned_action`` the demonstrated action aligned with each state.
        """
        names = ("task_reward", *AnimalEnv.feedback)
        dtw = ("dtw_penalty", "dtw_refund", "aligned_action")
        return names if self._tracker is None else (*names, *dtw)

    def offline_data(self) -> SpeciesDemonstrations:
        """Return the train and val splits of the demonstrations, for the offline phase."""
        if self.demos is None:
            raise InputError("the environment has no demonstrations: give demos=")
        if self._offline_data is None:  # its splits are made when first looked at
            self._offline_data = SpeciesDemonstrations(
                *(self.scenario.species, self.demos, self.individuals, self.condition_flag),
                *self.labels,
            )
        return self._offline_data

    def get_state(self) -> dict[str, NDArray[Any]]:
        """All that decides the future, for exact resume."""
        return self.world.get_state() | {"return": self._return.copy()}

    def set_state(self, state: dict[str, NDArray[Any]]) -> None:
        """Continue from what :meth:`get_state` gave."""
        self.world.set_state(state)
        self._return[...] = state["return"]
        self._started = True

    # -- the rest of the interface ----------------------------------------------------------------

    def close(self) -> None:
        """Do nothing: there is nothing to close."""

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """Return the attribute once per slot."""
        value = getattr(self, attr_name)
        return [value] * len(list(self._get_indices(indices)))

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Refuse: slots share one world."""
        raise InputError("slots share one world: make a new SlotVecEnv with other options")

    def env_method(
        self, method_name: str, *method_args: Any, indices: Any = None, **method_kwargs: Any
    ) -> list[Any]:
        """Refuse: slots share one world."""
        raise InputError("slots share one world and have no methods of their own")

    def env_is_wrapped(
        self, wrapper_class: type[gym.Wrapper[Any, Any, Any, Any]], indices: Any = None
    ) -> list[bool]:
        """Return per slot whether it has such a wrapper."""
        if issubclass(wrapper_class, Monitor) and len(self.individuals) > 1:
            # stable-baselines3's evaluation is the only caller that asks for a Monitor.
            warnings.warn(
                "evaluate_policy, EvalCallback and VecMonitor average over "
                f"{', '.join(self.individuals)}: use animarl_algos.evaluate_individuals and "
                "EvaluateIndividuals for each by itself",
                MixedMeansWarning,
                stacklevel=3,
            )
        return [False] * len(list(self._get_indices(indices)))


class MixedMeansWarning(UserWarning):
    """Returns of different individuals are about to be averaged."""


def focal_drivers(
    names: tuple[str, ...], focal: str | None, rule: str = "replay"
) -> dict[str, str]:
    """Return drivers by which all but ``focal`` follow a rule; none without ``focal``."""
    return {name: rule for name in names if focal not in (None, name)}


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
        episode_start: Bools | None = None,
        deterministic: bool = False,
    ) -> tuple[Ints, Any]:
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

    def leave_out(self, state: Any, over: Bools) -> Any:
        """See :meth:`GruPolicy.leave_out`; ``over`` of all slots. Foreign policies have none."""
        leave_out = getattr(self.policy, "leave_out", None)
        return (
            state if leave_out is None else leave_out(state, over[self.index :: self.individuals])
        )
