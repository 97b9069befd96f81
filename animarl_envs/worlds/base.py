"""The base of both worlds: buffers, seeding, episode bookkeeping, noisy and late senses.

A world simulates ``copies`` episodes side by side. It knows nothing of Gymnasium: it is reset and
stepped, and its arrays, which it owns and overwrites in place, are read.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping
from functools import cached_property
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from animarl_envs.array_types import Bools, Floats, Ints
from animarl_envs.compiling import jit
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.episode import TIME_OUT
from animarl_envs.errors import InputError
from animarl_envs.fitting.transitions import demonstrated_actions
from animarl_envs.scenario import DRIVERS, Scenario
from animarl_envs.worlds.streams import next_below, next_normal, seed_streams

LARGEST = 1e30  # observations are float32


class ObservationComponent(NamedTuple):
    """One entry of an observation vector, for spaces, documentation and mirror images.

    In a world mirrored about the x axis it is ``sign`` times the component named ``mirror``, its
    own by default. ``description`` says in a few words what a value [below|above] the usual ones
    means; ``{2}`` stands for the second of the other individuals.
    """

    name: str
    frame: str
    unit: str
    low: float
    high: float
    sign: float = 1.0
    mirror: str = ""
    description: str = ""


class FlatDemos(NamedTuple):
    """Demonstrations as kernels read them; empty arrays where there are none."""

    position: Floats  # (frames, K, 2)
    velocity: Floats  # (frames, K, 2)
    start: Ints  # (episodes + 1,)
    condition: NDArray[np.int8]  # (episodes,)


class World(ABC):
    """Batched simulator. Shapes: B copies, K individuals, n observation components.

    Attributes
    ----------
    position, velocity
        ``(B, K, 2)`` float64, arena frame [arena unit; arena unit / s].
    observation
        ``(B, K, n)`` float32, as ``observation_components`` documents.
    components, reward
        ``(B, K, C)`` and ``(B, K)`` float64: reward components (``reward_components`` names them)
        of the last step, and their sum.
    terminated, truncated
        ``(B,)`` bool. A time limit truncates and never terminates.
    outcome
        ``(B,)`` int8, codes of :mod:`animarl_envs.demos.episode`.
    step_count, demo, condition
        ``(B,)``: steps since the start, paired demonstration (-1 without), experimental condition.
    warming
        ``(B,)`` bool: the next step is a warm-up step, replayed from the demonstration.
    observers
        ``(K,)`` bool: whose observations are made. Those of others stay zero; nothing else differs.
    trackers
        Objects that follow the episodes, as :class:`animarl_envs.dtw.DTWTracker` does: they are
        called at every start and step, and saved and restored with the world.
    """

    reward_components: tuple[str, ...]
    _describe: ClassVar[Callable[..., tuple[ObservationComponent, ...]]]
    _state_names: tuple[str, ...] = (
        "position",
        "velocity",
        "sensed",
        "components",
        "reward",
        "terminated",
        "truncated",
        "outcome",
        "step_count",
        "demo",
        "condition",
        "warming",
        "random_state",
    )

    def __init__(
        self, scenario: Scenario, num_copies: int, observers: Iterable[int] | None = None
    ) -> None:
        if num_copies < 1:
            raise InputError(f"num_copies is {num_copies}: it must be at least 1")
        self.scenario, self.num_copies = scenario, num_copies
        species, demos = scenario.species, scenario.demos
        self.num_individuals, self.num_actions = species.num_individuals, species.num_actions
        B, K = num_copies, species.num_individuals
        empty = np.zeros((0, K, 2))
        recorded: Any = (empty, empty, np.array([0]), np.zeros(0, np.int8))
        if demos is not None:
            recorded = (demos.positions, demos.velocities(), demos.offsets, demos.condition)
        self._demos = FlatDemos(*(np.ascontiguousarray(one) for one in recorded))
        for array in self._demos:  # one type for kernels, which are compiled anew for another
            array.setflags(write=False)
        # The fastest [arena unit / s] and the farthest [arena unit] that was recorded.
        fastest = float(np.linalg.norm(self._demos.velocity, axis=-1).max(initial=0.0))
        farthest = float(np.abs(self._demos.position).max(initial=0.0))
        self.observation_components = type(self)._describe(species, fastest, farthest)
        self._check_ranges()
        C, n = len(self.reward_components), len(self.observation_components)
        self.observers = np.full(K, observers is None)
        if observers is not None:
            self.observers[list(observers)] = True
        # Kernels see the copy as the last, contiguous axis, so that their loops over copies
        # compile to vector instructions; everybody else sees it first.
        self._position = np.zeros((K, 2, B))
        self._velocity = np.zeros((K, 2, B))
        self._sensed = np.zeros((K, n, B), dtype=np.float32)
        self._components = np.zeros((K, C, B))
        self._reward = np.zeros((K, B))
        self.position = self._position.transpose(2, 0, 1)
        self.velocity = self._velocity.transpose(2, 0, 1)
        self.sensed = self._sensed.transpose(2, 0, 1)
        self.components = self._components.transpose(2, 0, 1)
        self.reward = self._reward.T
        self.terminated = np.zeros(B, dtype=bool)
        self.truncated = np.zeros(B, dtype=bool)
        self.outcome = np.zeros(B, dtype=np.int8)
        self.step_count = np.zeros(B, dtype=np.int64)
        self.demo = np.full(B, -1)
        self.condition = np.zeros(B, dtype=np.int8)
        self.warming = np.zeros(B, dtype=bool)
        self.random_state = np.zeros(B, dtype=np.uint64)

        delay = scenario.observation_delay
        self._history = np.zeros((delay + 1 if delay else 0, B, K, n), dtype=np.float32)
        self._disturbed = delay > 0 or scenario.observation_noise > 0
        self.observation = np.zeros_like(self.sensed) if self._disturbed else self.sensed

        self._drivers = np.array([DRIVERS[d] for d in scenario.drivers], dtype=np.int8)
        self._warmup = species.warmup if scenario.paired else 0
        self.trackers: list[Any] = []
        self._everywhere = np.ones(B, dtype=bool)
        self._any_demo = np.full(B, -1)
        self.seed(np.arange(B))

    def _check_ranges(self) -> None:
        """Refuse worlds whose observations or their noise do not fit into float32."""
        for one in self.observation_components:
            if not max(abs(one.low), abs(one.high)) <= LARGEST:
                raise InputError(
                    f"{self.scenario.species.name}: observation {one.name!r} could lie anywhere "
                    f"between {one.low:.3g} and {one.high:.3g}, which float32 cannot hold: choose "
                    "less extreme locomotion, arena, dt or time_limit"
                )
        if not self.scenario.observation_noise <= LARGEST:
            raise InputError(
                f"observation_noise is {self.scenario.observation_noise:.3g}, which float32 cannot "
                "hold: choose a smaller one"
            )

    def _shared_state(self) -> dict[str, Any]:
        """Return the fields that the state of every world's kernels has, by name."""
        species = self.scenario.species
        own = ("demo", "terminated", "truncated", "outcome", "step_count", "warming")
        return {
            "demos": self._demos,
            "contact_radius": species.contact_radius,
            "time_limit": species.time_limit,
            "warmup": self._warmup,
            "random": self.random_state,
            **{name: getattr(self, name) for name in own},
        }

    @property
    def demos(self) -> Demonstrations | None:
        """Demonstrations of the scenario, if it has any."""
        return self.scenario.demos

    def seed(self, seeds: ArrayLike) -> None:
        """Start the random stream of copy ``b`` from ``seeds[b]`` (any non-negative integers)."""
        seed_streams(np.asarray(seeds, dtype=np.uint64), self.random_state)

    def reset(self, mask: Bools | None = None, demo: Ints | None = None) -> None:
        """Start new episodes in the copies where ``mask`` is true (in all, by default).

        ``demo`` ``(B,)`` names the demonstration to pair each with; -1 draws one at random.
        """
        mask = self._everywhere if mask is None else mask
        _begin(
            mask,
            self._any_demo if demo is None else demo,
            len(self._demos.start) - 1 if self.scenario.paired else 0,
            self._demos.condition,
            -1 if self.scenario.condition == "demo" else self.scenario.condition,
            self._warmup > 0,
            self.random_state,
            self.demo,
            self.condition,
            self.step_count,
            self.terminated,
            self.truncated,
            self.outcome,
            self.warming,
            self._components,
            self._reward,
        )
        self._start(mask)
        if self._disturbed:
            self._history[:, mask] = self.sensed[mask]
            self._disturb(mask)
        for tracker in self.trackers:
            tracker.started(self, mask)

    def step(self, actions: NDArray[np.integer], observed: bool = True) -> None:
        """Advance every copy by one decision step; ``actions`` is ``(B, K)``, 0 to 12 M.

        A copy whose episode has ended is advanced as well: reset it first. Without ``observed`` the
        observations may be left as they were, for callers that reset some copies next.
        """
        # One type and layout of actions, or numba would compile a kernel for each.
        self._advance(np.asarray(actions, np.int64, order="C"), observed or self._disturbed)
        if self._disturbed:
            self._disturb(self._everywhere)
        for tracker in self.trackers:
            tracker.stepped(self)

    @abstractmethod
    def _start(self, mask: Bools) -> None:
        """Set the first state of new episodes and sense it."""

    @abstractmethod
    def _advance(self, actions: NDArray[np.integer], observed: bool) -> None:
        """Advance all copies by one step: move, decide the episode's end, reward, sense."""

    def observations_of(self, i: int) -> NDArray[np.float32]:
        """Return a copy of what individual ``i`` observes, ``(B, n)``, by columns in memory."""
        return self.observation[:, i].copy(order="F")

    def executed(self, actions: NDArray[np.integer]) -> NDArray[np.integer]:
        """Return the actions ``(B, K)`` that the next step executes when given ``actions``.

        These are the demonstrated actions in copies that are warming up. A policy that sees its
        previous action must see what was done, in a simulator as in demonstrations.
        """
        if not self._warmup or not self.warming.any():
            return actions
        if self.num_copies == 1:  # the same with less work, for views of one copy
            only = self._demos.start.item(self.demo.item()) + self.step_count.item()
            return self._demonstrated[only : only + 1]
        frame = self._demos.start[self.demo] + self.step_count
        recorded = self._demonstrated[np.where(self.warming, frame, 0)]
        return np.where(self.warming[:, None], recorded, actions)

    @cached_property
    def _demonstrated(self) -> Ints:
        """The actions of all recorded frames, ``(frames, K)``; computed when first needed."""
        assert self.demos is not None
        recorded = demonstrated_actions(self.demos, self.scenario.species.locomotion).astype(
            np.int64
        )
        recorded.flags.writeable = False
        return recorded

    def _disturb(self, mask: Bools) -> None:
        """Apply observation delay and noise."""
        seen = self.sensed
        if len(self._history):
            self._history[:-1, mask] = self._history[1:, mask]
            self._history[-1, mask] = self.sensed[mask]
            seen = self._history[0]
        _add_noise(mask, seen, self.scenario.observation_noise, self.random_state, self.observation)

    # -- state ------------------------------------------------------------------------------------

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle and copy by value: rebuild from the scenario, then restore the state."""
        made_of = self.scenario, self.num_copies, np.flatnonzero(self.observers)
        return type(self), made_of, (self.trackers, self.get_state())

    def __setstate__(self, saved: tuple[list[Any], dict[str, NDArray[Any]]]) -> None:
        self.trackers, state = saved
        self.set_state(state)

    def get_state(self) -> dict[str, NDArray[Any]]:
        """Return copies of all arrays that decide the future, for :meth:`set_state`."""
        state = {name: getattr(self, name).copy() for name in self._state_names}
        state["history"] = self._history.copy()
        state["observation"] = self.observation.copy()
        for tracker in self.trackers:
            state |= tracker.get_state()
        return state

    def set_state(self, state: Mapping[str, NDArray[Any]]) -> None:
        """Continue from what :meth:`get_state` gave, in a world of the same scenario."""
        for name in self._state_names:
            current = getattr(self, name)
            if name not in state or state[name].shape != current.shape:
                raise InputError(
                    f"the saved world has another shape ({name}): use the same settings"
                )
            current[...] = state[name]
        self._history[...] = state["history"]
        self.observation[...] = state["observation"]
        for tracker in self.trackers:
            tracker.set_state(dict(state))

    def scene_details(self, copy: int) -> dict[str, Any]:
        """Return what pictures of a copy show beside positions, by the names of a scene."""
        return {}


@jit
def _begin(  # type: ignore[no-untyped-def]
    mask,
    wanted,
    count,
    demo_condition,
    fixed,
    warms_up,
    random,
    demo,
    condition,
    step_count,
    terminated,
    truncated,
    outcome,
    warming,
    components,
    reward,
):
    """Draw demonstration and condition of new episodes; nothing has happened in them yet."""
    K, C, B = components.shape
    for b in range(B):
        if not mask[b]:
            continue
        demo[b] = -1
        if count > 0:
            demo[b] = next_below(random, b, count)  # drawn even if not wanted: equal streams
            if wanted[b] >= 0:
                demo[b] = wanted[b]
        condition[b] = 0
        if fixed >= 0:
            condition[b] = fixed
        elif demo[b] >= 0:
            condition[b] = demo_condition[demo[b]]
        step_count[b] = 0
        terminated[b] = False
        truncated[b] = False
        outcome[b] = TIME_OUT
        warming[b] = warms_up
        for i in range(K):
            reward[i, b] = 0.0
            for c in range(C):
                components[i, c, b] = 0.0


@jit
def _add_noise(mask, seen, deviation, random, observation):  # type: ignore[no-untyped-def]
    B, K, n = seen.shape
    for b in range(B):
        if mask[b]:
            for i in range(K):
                for c in range(n):
                    observation[b, i, c] = seen[b, i, c]
                    if deviation > 0.0:
                        observation[b, i, c] += deviation * next_normal(random, b)
