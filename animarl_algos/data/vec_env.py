"""A world as a stable-baselines3 VecEnv: every individual of every copy is one slot.

Slot ``s`` is individual ``s % K`` of copy ``s // K``. All slots of a copy end together and are
reset within the same step, as SB3 expects.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import (
    DummyVecEnv,
    VecEnv,
    VecEnvWrapper,
    unwrap_vec_normalize,
)

from animarl_algos.data.species_data import SpeciesDemonstrations, check_labels
from animarl_algos.losses.terms import Recipe
from animarl_envs import environment_id
from animarl_envs.array_types import Bools, Ints
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.splits import learnable
from animarl_envs.dtw import DTWTracker
from animarl_envs.errors import InputError, also_list_options_of
from animarl_envs.fitting.transitions import demonstrated_actions
from animarl_envs.scenario import Demos, make_scenario, refuse_other_species
from animarl_envs.species import Species, get_species
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
LABEL_OPTIONS = ("labels", "label_width", "label_horizon")
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


def refuse_other_actions(learned: int, here: int) -> None:
    """Refuse a world with another number of actions than the learner has values for."""
    if learned != here:
        raise InputError(
            f"Action spaces do not match, {learned} actions learned and {here} here: give the "
            "environment it was trained in, of animals with the same thrust magnitudes"
        )


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
    observed: tuple[str, ...] = ()  # the species, then the names of components, if anybody says

    @property
    def num_individuals(self) -> int:
        """Number of individuals of a copy, K."""
        return len(self.individuals)

    @classmethod
    def of(cls, env: VecEnv) -> SlotLayout:
        """Return the layout that an environment declares, or that of a single agent."""
        scaled = unwrap_vec_normalize(env)
        if scaled is not None and scaled.norm_obs:
            raise InputError(
                "VecNormalize would change the scale of observations that the replay memory holds: "
                "give the learner standardise_inputs=True instead"
            )
        if scaled is not None and scaled.norm_reward:
            raise InputError(
                "VecNormalize would change the scale of rewards that the replay memory holds: give "
                "it norm_reward=False"
            )
        individuals = tuple(getattr(env, "individuals", ("agent",)))
        num_copies = int(getattr(env, "num_copies", env.num_envs))
        if num_copies * len(individuals) != env.num_envs:
            raise InputError(
                f"the environment has {env.num_envs} slots, not {num_copies} copies of "
                f"{len(individuals)} individuals: make num_copies and individuals agree"
            )
        flagged = bool(declared(env, "condition_flag"))
        if flagged and not is_observed_as_declared(env, "condition_flag"):
            raise InputError(
                "a wrapper around the condition flag changes the observation, whose last component "
                "must be the flag: put the condition flag outermost, or leave that wrapper out"
            )
        observed = getattr(env, "observed", ())
        known = observed if isinstance(observed, tuple) else ()  # another's word for something else
        return cls(num_copies, individuals, flagged, known)


def check_observation(space: gym.Space[Any]) -> None:
    """Refuse an observation that is no array of numbers."""
    if not isinstance(space, gym.spaces.Box):
        raise InputError(
            f"observations are {type(space).__name__} and the networks take numbers in a Box: wrap "
            "the environment in gymnasium.wrappers.FlattenObservation"
        )


def check_environment_supports(
    recipe: Recipe, env: VecEnv, layout: SlotLayout, alpha: float
) -> None:
    """Refuse an environment that does not give what a recipe learns from.

    Or that weighs the distance by another ``alpha`` than the learner.
    """
    given = declared_feedback(env)
    for needed, name, words in (
        (recipe.needs_distance, "dtw_penalty", "the distance to a demonstration"),
        (recipe.needs_alignment, "aligned_action", "aligned demonstrated actions"),
    ):
        if needed and name not in given:
            raise InputError(
                f"recipe {recipe.name} needs {words} and the environment declares none ({name!r} "
                f"in its attribute feedback): learn in {_suggested_slots(env, recipe)}"
            )
    if recipe.needs_distance and (own := declared(env, "alpha")) not in (None, alpha):
        raise InputError(
            f"alpha is {own} of the environment's DTW reward and {alpha} of the learner, which "
            "weighs the distance by its own: give both the same"
        )
    if recipe.needs_condition and not layout.condition_flag:
        raise InputError(
            f"recipe {recipe.name} needs the condition flag as the last observation component and "
            f"the environment has none: learn in {_suggested_slots(env, recipe)}, or wrap it in "
            "the condition-flag wrapper"
        )


def _suggested_slots(env: VecEnv, recipe: Recipe) -> str:
    """Return the lines that make an environment for a recipe, of the species of ``env`` if any."""
    scenario, focal = declared(env, "scenario"), declared(env, "focal_index")
    species = "agent" if scenario is None else scenario.species.name
    flag = ", condition_flag=True" if recipe.needs_condition else ""
    every = f'SlotVecEnv("{species}"{flag})'
    if scenario is None or focal is None or len(scenario.names) == 1:
        return every
    one = f'SlotVecEnv("{species}", focal="{scenario.names[focal]}"{flag})'
    return f"{every}, or for one individual in {one}"


def demonstrations_in(
    env: VecEnv, demos: Demonstrations, layout: SlotLayout, **labels: Any
) -> SpeciesDemonstrations:
    """Return the splits of ``demos`` that training may see, in the terms of ``env``.

    Raises
    ------
    InputError
        If they are of other animals or another time step, or ``env`` is of another package.
    """
    scenario, focal = declared(env, "scenario"), declared(env, "focal_index")
    if scenario is None:
        raise InputError(
            f"{demos.name}: the environment is none of AnimaRL's, which demonstrations of animals "
            "fit: learn in one, or give datasets as attributes train and val"
        )
    refuse_other_species(demos, scenario.species.name)
    known = learnable(demos)
    replace(scenario, demos=known)  # refuses others
    learners = layout.individuals if focal is None else (scenario.names[focal],)
    if (own := getattr(env, "labels", None)) is not None:
        labels = dict(zip(LABEL_OPTIONS, own, strict=True))
    return SpeciesDemonstrations(scenario.species, known, learners, layout.condition_flag, **labels)


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


def declared(env: Any, name: str) -> Any:
    """Return an attribute of an environment, a VecEnv or its environments; None if none has it."""
    if isinstance(env, gym.Env):
        return env.get_wrapper_attr(name) if env.has_wrapper_attr(name) else None
    if not isinstance(env, VecEnv) or hasattr(env, name):
        return getattr(env, name, None)
    return env.get_attr(name, indices=0)[0] if env.has_attr(name) else None


def is_observed_as_declared(env: VecEnv, name: str) -> bool:
    """Whether no wrapper around what has the attribute ``name`` has another observation space."""
    layer: Any = env
    while name not in vars(layer) and not hasattr(type(layer), name):
        if isinstance(layer, VecEnvWrapper):
            layer = layer.venv
        elif isinstance(layer, DummyVecEnv):
            layer = layer.envs[0]
        elif isinstance(layer, gym.Wrapper):
            layer = layer.env
        else:
            break  # in another process
    return bool(layer.observation_space == env.observation_space)


def declared_feedback(env: VecEnv) -> tuple[str, ...]:
    """Return the names of what an environment says that it hands out beside the reward."""
    names = declared(env, "feedback")
    return tuple(names) if isinstance(names, tuple | list) else ()  # another's word


def feedback_of(
    env: VecEnv, names: tuple[str, ...], infos: list[dict[str, Any]]
) -> dict[str, NDArray[Any]]:
    """Return what came with the last step, ``(slots,)`` each, without what the environment lacks.

    Of the ``names`` that the environment declares. It is the attribute ``extras`` of the VecEnv
    where there is one (fast), otherwise in ``infos``. Where a warm-up replays other actions than
    were asked for, they are ``executed``.
    """
    values = getattr(env, "extras", None)
    if values is None:
        present = [name for name in names if name in infos[0]]
        values = {name: [info[name] for info in infos] for name in present}
    return {name: np.asarray(values[name]).reshape(-1) for name in names if name in values}


def longest_episode(env: Any, given: int | None) -> int | None:
    """Return the time limit [steps]: as ``given``, or as the environment declares it.

    Raises InputError if it declares none.
    """
    if given is not None or env is None:
        return given
    limit = declared_limit(env)
    if limit is None:
        raise InputError(
            "the environment does not say how long an episode can last: give max_episode_steps, or "
            "wrap it in gymnasium.wrappers.TimeLimit"
        )
    return limit


def check_episodes_fit(env: VecEnv, given: int | None, held: int | None) -> None:
    """Refuse an environment whose episodes may last longer than a replay memory holds [steps]."""
    limit = given or declared_limit(env)
    if limit is not None and held is not None and limit > held:
        raise InputError(
            f"its episodes last up to {limit} steps and the replay memory holds {held}: "
            "give one with a shorter time limit"
        )


def declared_limit(env: VecEnv) -> int | None:
    """Return the time limit [steps] that an environment tells of itself, if any.

    That is ``max_episode_steps`` of the VecEnv or of its environments, ``time_limit`` of AnimaRL's,
    or what the Gymnasium specs say; of several the longest.
    """
    # The last is that of Gymnasium's TimeLimit, around an environment without a spec.
    for name in ("max_episode_steps", "time_limit", "_max_episode_steps"):
        if name == "time_limit" and declared(env, "scenario") is None:
            continue  # another package's, maybe in seconds
        limit = getattr(env, name, None)
        if limit is None and env.has_attr(name):
            each = env.get_attr(name)
            limit = None if None in each else max(each)
        if limit is not None:
            return int(limit)
    limits = [spec.max_episode_steps for spec in env.get_attr("spec") if spec is not None]
    return max(map(int, limits)) if limits and all(limits) else None


def make_environment(env: str, demonstrations: Any) -> tuple[Any, Any]:
    """Return an environment of AnimaRL by its id or name, with demonstrations put into it.

    Other ids, and other demonstrations, are returned as they are.
    """
    env_id = environment_id(env)
    if "AnimaRL/" not in env and (env in gym.registry or env_id not in gym.registry):
        return env, demonstrations
    if env_id not in gym.registry:
        get_species(env)  # refuses it
    if isinstance(demonstrations, Demonstrations):
        return gym.make(env_id, demos=demonstrations), None
    return gym.make(env_id), demonstrations


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
