"""What the three views of a world share: options, spaces, infos, checks of actions."""

import copy
import json
import warnings
from collections.abc import Callable, Mapping
from dataclasses import replace
from importlib import import_module
from importlib.util import find_spec
from operator import index
from typing import Any

import numpy as np
from gymnasium import spaces
from gymnasium.envs.registration import EnvSpec
from numpy.typing import NDArray

from animarl_envs.array_types import Ints
from animarl_envs.drawing.render import RENDER_MODES, Pictures
from animarl_envs.errors import (
    InputError,
    MissingExtraError,
    also_list_options_of,
    require_extra,
)
from animarl_envs.focus import first_pursuer
from animarl_envs.scenario import DRIVERS, PACKAGED, Scenario, make_scenario
from animarl_envs.settings import is_whole, plain
from animarl_envs.species import SearchSpecies, Species
from animarl_envs.tasks import find_task
from animarl_envs.worlds import make_world
from animarl_envs.worlds.base import World

PolicyFunction = Callable[[NDArray[np.float32]], NDArray[np.integer]]
"""From observations ``(B, n)`` of one individual to its actions ``(B,)``."""

OPPONENTS = ("animarl_algos.runs.opponents", "PackagedOpponents")
"""Module and class of what drives others by packaged networks, loaded where it is asked for."""

Others = str | PolicyFunction | Mapping[str, "str | PolicyFunction"] | None


class View:
    """A view of a world: its pictures, its actions, and what its infos say.

    Attributes
    ----------
    scenario, world
        What the view was made of, and the batched simulator that it shows.
    """

    scenario: Scenario
    world: World
    metadata: dict[str, Any]

    def _build(
        self, scenario: Scenario, num_copies: int, render_mode: str | None, observers: Any = None
    ) -> None:
        self.scenario, self.render_mode = scenario, render_mode
        if render_mode not in (None, *self.metadata["render_modes"]):
            fix = "choose 'human' or 'rgb_array'"
            if render_mode in RENDER_MODES:
                fix = "choose 'rgb_array' or None for many copies, or show one with gym.make"
            raise InputError(f"render_mode is {render_mode!r}: {fix}")
        self.world = make_world(scenario, num_copies, observers)
        self._pictures = Pictures(self.world, render_mode)
        self.metadata = {**self.metadata, "render_fps": self._pictures.frame_rate}
        if find_spec("pygame") is None:
            if render_mode is not None:
                raise MissingExtraError("drawing", "render")
            self.metadata["render_modes"] = []  # or Gymnasium's checker would ask for pictures
        self._description = json.dumps(scenario_as_data(scenario))  # each reset says it anew
        self._actions = np.zeros((num_copies, self.world.num_individuals), dtype=np.int64)
        self._started = False

    def render(self) -> Any:
        """Return the present scene as ``(height, width, 3)`` uint8, or show it in a window."""
        drawn = self._pictures.draw()
        return drawn[0] if drawn else None

    def close(self) -> None:
        """Close the window, if any."""
        self._pictures.close()

    def _restart(self, seed: int | None, fresh: Any, options: Any, *, strict: bool = True) -> None:
        """Begin an episode of a single copy; ``fresh`` draws the first seed where none is given."""
        given = reset_options(options, "demo", strict=strict)
        if seed is not None:
            self.world.seed([stream_seed(seed)])
        elif not self._started:
            self.world.seed(fresh())
        self._started = True
        self.world.reset(demo=chosen_demos(given.get("demo"), self.scenario, 1))
        self._pictures.follow([True])

    def _shared_info(self, warming: bool) -> dict[str, Any]:
        """Return the entries that the infos of all individuals of a single copy share."""
        world = self.world
        return {
            "demo": world.demo.item(),
            "condition": world.condition.item(),
            "step": world.step_count.item(),
            "warmup": warming,
            "outcome": world.outcome.item(),
        }


class FocalView(View):
    """A view in which one individual acts; with Gymnasium's spec, which says the time limit."""

    _spec: EnvSpec | None = None

    def _build_focal(
        self,
        species: Species | str,
        num_copies: int,
        focal: str | None,
        others: Others,
        render_mode: str | None,
        options: dict[str, Any],
    ) -> None:
        """Make the world, in which the others replay, follow a rule, or a policy of their own."""
        if "drivers" in options:
            raise InputError(
                "drivers is an option of parallel_env: say with focal who acts and with others "
                "what moves the rest"
            )
        with also_list_options_of(type(self).__init__, without=("drivers",)):
            scenario = make_scenario(species, **options)
        names = scenario.names
        focal = names[first_pursuer(scenario.species.roles)] if focal is None else focal
        if focal not in names:
            raise InputError(f"focal is {focal!r}: choose one of {', '.join(names)}")
        rest = [name for name in names if name != focal]
        if others == PACKAGED and not rest:
            raise InputError(f"others is 'packaged', but {focal} is alone: leave others out")
        replayed = scenario.paired and find_task(species) is None
        usual: Any = "replay" if replayed else "scripted"
        rules: dict[str, Any] = dict.fromkeys(rest, usual if others is None else others)
        if isinstance(others, Mapping):
            unknown = sorted(set(others) - set(rest))
            if unknown:
                raise InputError(f"others names {unknown[0]!r}: choose among {', '.join(rest)}")
            rules = dict.fromkeys(rest, usual) | dict(others)
        drivers, packaged = list(scenario.drivers), set[int]()
        self.focal_index, self._policies = names.index(focal), dict[int, PolicyFunction]()
        for name, rule in rules.items():
            i = names.index(name)
            if callable(rule):
                self._policies[i] = rule
            elif rule == PACKAGED:
                packaged.add(i)
            elif rule in DRIVERS and rule != "action":
                drivers[i] = rule
            else:
                raise InputError(
                    f"others gives {name} the rule {rule!r}: choose 'replay', 'scripted', "
                    "'packaged', 'coast' or a function from observations to actions"
                )
        scenario = replace(scenario, drivers=tuple(drivers))
        self._opponents: Any = None
        if packaged:
            with require_extra("others='packaged'", "algos"):
                opponents = getattr(import_module(OPPONENTS[0]), OPPONENTS[1])
            self._opponents = opponents(scenario, num_copies, packaged)
        self._build(scenario, num_copies, render_mode, {self.focal_index, *self._policies})

    def _drive_others(self) -> None:
        """Write the next actions of individuals that policies or packaged networks drive."""
        for i, policy in self._policies.items():
            self._actions[:, i] = np.asarray(policy(self.world.observation[:, i].copy()))
        if self._opponents is not None:
            self._opponents.act(self.world, self._actions)

    @property
    def time_limit(self) -> int:
        """Longest episode [steps], which truncates it."""
        return int(self.scenario.species.time_limit)

    @property
    def spec(self) -> EnvSpec | None:
        """How Gymnasium made the environment; ``max_episode_steps`` is the time limit.

        Gymnasium's registry cannot say it, since its time limit would hold for every
        ``time_limit`` that is given as an option.
        """
        return self._spec

    @spec.setter
    def spec(self, spec: EnvSpec | None) -> None:
        limit = self.time_limit
        if spec is not None and (spec.max_episode_steps or limit + 1) > limit:
            spec = copy.copy(spec)
            spec.max_episode_steps = limit
        self._spec = spec


# -- spaces and what is handed in -----------------------------------------------------------------


def observation_space(world: World) -> spaces.Box:
    """Return the space of one individual's vector: ranges of its components, none if noisy."""
    if world.scenario.observation_noise > 0:
        return spaces.Box(-np.inf, np.inf, (len(world.observation_components),), dtype=np.float32)
    low = np.array([c.low for c in world.observation_components], dtype=np.float32)
    high = np.array([c.high for c in world.observation_components], dtype=np.float32)
    rounding = 1e-5 * np.maximum(1.0, np.abs(high))
    return spaces.Box(low - rounding, high + rounding, dtype=np.float32)


def checked_limit(name: str, most: Any) -> int | None:
    """Check the most steps of an episode that a library asks for beside the options, if any."""
    if most is None or (is_whole(most) and most >= 1):
        return None if most is None else int(most)
    raise InputError(f"{name} is {most!r}: give a whole number of steps, at least 1")


def cut_after(world: World, most: int | None) -> None:
    """Truncate the episodes of ``world`` that have lasted ``most`` steps, warm-up included."""
    if most is not None:
        world.truncated |= (world.step_count >= most) & ~world.terminated


def check_action(action: Any, num_actions: int, of_individual: str = "") -> int:
    """Return one individual's action as Python's own whole number, of whatever integer type.

    Raises InputError if it is no whole number, or out of range.
    """
    try:
        number = index(action)
    except TypeError:
        number = -1
        wrong = "no whole number"
    else:
        wrong = "out of range"
    if not 0 <= number < num_actions:
        raise InputError(
            f"action {action!r}{of_individual} is {wrong}: choose 0 to {num_actions - 1}"
        )
    return number


def check_actions(actions: Any, shape: tuple[int, ...], num_actions: int) -> Ints:
    """Return actions as an integer array of that shape.

    Raises InputError if the shape is wrong, a number is not whole, or an action is out of range.
    """
    array = np.asarray(actions)
    if array.shape != shape:
        raise InputError(f"actions have shape {array.shape}: give {shape}, one per copy")
    if array.dtype.kind not in "iu":
        raise InputError(f"actions are {array.dtype}: give whole numbers, 0 to {num_actions - 1}")
    whole = array.astype(np.int64, copy=False)
    if np.maximum.reduce(whole.view(np.uint64)) >= num_actions:  # negative ones are large, too
        worst = array.max() if array.max() >= num_actions else array.min()
        raise InputError(f"action {worst} is out of range: choose 0 to {num_actions - 1}")
    return whole


def chosen_demos(wanted: Any, scenario: Scenario, num_copies: int) -> Ints | None:
    """Return the option ``demo`` of ``reset``, one number for each copy (-1: any).

    Raises InputError if a demonstration does not exist.
    """
    if wanted is None:
        return None
    count = len(scenario.demos) if scenario.demos is not None and scenario.paired else 0
    array = np.asarray(wanted)
    if array.dtype.kind not in "iu" or array.shape not in ((), (num_copies,)):
        raise InputError(f"demo is {wanted!r}: give a whole number, or {num_copies} of them")
    lowest = -1 if array.ndim else 0
    if array.min() < lowest or array.max() >= count:
        worst = array.max() if array.max() >= count else array.min()
        there = f"choose 0 to {count - 1}" if count else "episodes start without any"
        raise InputError(f"demo {worst} does not exist: {there}")
    return np.array(np.broadcast_to(array, (num_copies,)), dtype=np.int64)


def reset_options(options: Any, *known: str, strict: bool = True) -> Mapping[str, Any]:
    """Check the options of ``reset``; warn of unknown ones instead where not ``strict``."""
    if options is None:
        return {}
    if not isinstance(options, Mapping):
        raise InputError(
            f"options of reset are {options!r}: give a dictionary, such as {{'demo': 0}}"
        )
    for name in set(options) - set(known):
        unknown = f"reset has no option {name!r}: it knows {', '.join(known)}"
        if strict:
            raise InputError(unknown)
        warnings.warn(unknown, stacklevel=3)
    return options


def stream_seed(seed: int) -> np.uint64:
    """Return the seed of a world's random stream; all bits count, also beyond 64.

    Raises InputError if it is negative or no whole number.
    """
    try:
        number = index(seed)
    except TypeError:
        raise InputError(f"seed is {seed!r}: give a whole number") from None
    if number < 0:
        raise InputError(f"seed is {number}: give zero or more")
    if number < 2**64:
        return np.uint64(number)
    return np.uint64(np.random.SeedSequence(number).generate_state(1, np.uint64)[0])


# -- what is said at reset ------------------------------------------------------------------------


def scenario_as_data(scenario: Scenario) -> dict[str, Any]:
    """Return the scenario as plain data, for ``info["scenario"]`` at reset.

    All numbers of the species under their names (``species`` is its name), and the options of
    :class:`Scenario`; what is infinite or cannot be written as plain data is a text.
    """
    spec, demos = scenario.species, scenario.demos
    numbers: dict[str, Any] = plain(spec)
    if isinstance(spec, SearchSpecies) and not isinstance(spec.plume, str):
        numbers["plume"] = {"kind": type(spec.plume).__name__} | numbers["plume"]
    del numbers["name"], numbers["version_history"]
    for own in numbers["locomotion"]:
        own.pop("steps", None)  # thousands of recorded velocities
    return numbers | {
        "species": spec.name,
        "drivers": list(scenario.drivers),
        "condition": scenario.condition,
        "start": plain(scenario.start),
        "demonstrations": None if demos is None else demos.name,
        "episodes": 0 if demos is None else len(demos),
        "split": scenario.split,
        "observation_noise": scenario.observation_noise,
        "observation_delay": scenario.observation_delay,
    }
