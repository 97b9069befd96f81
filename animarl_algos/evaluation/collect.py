"""Collecting rollouts: policies drive every individual from each demonstration's start."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, Literal, Protocol

import numpy as np
from gymnasium.spaces import Discrete
from numpy.typing import NDArray

from animarl_algos.data.slot_layout import refuse_other_actions
from animarl_algos.evaluation.rollouts import NO_CUE, Rollouts
from animarl_envs.array_types import Ints
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.episode import Resolution, rounded
from animarl_envs.errors import InputError
from animarl_envs.locomotion import NUM_ACTIONS
from animarl_envs.worlds.base import World

MAX_COPIES = 512
Cue = Literal["actual", "flipped", 0, 1]


class Policy(Protocol):
    """What acts: anything with stable-baselines3's ``predict``, a state per slot included.

    It is asked by ``observation, state, episode_start, deterministic``.
    """

    @property
    def predict(self) -> Callable[..., tuple[Any, Any]]: ...


class MemorylessPolicy(ABC):
    """A policy that acts on the present observation alone."""

    @abstractmethod
    def act(self, observation: Any) -> Ints:
        """Return one action per slot."""

    def predict(self, observation: Any, state: Any = None, **_: Any) -> tuple[Any, Any]:
        """Return :meth:`act`'s actions, and the state as it is."""
        return self.act(observation), state


class RandomPolicy(MemorylessPolicy):
    """Uniformly random actions from a seeded generator: the floor any learner must leave."""

    def __init__(self, seed: int, num_actions: int = NUM_ACTIONS) -> None:
        self._rng = np.random.default_rng(seed)
        self._num_actions = num_actions

    def act(self, observation: NDArray[np.floating] | Mapping[str, Any]) -> Ints:
        return self._rng.integers(self._num_actions, size=len(observation))


class WrappedPolicy:
    """A policy that does what the one within does, but for what a subclass changes."""

    def __init__(self, policy: Policy) -> None:
        self.policy = policy

    def __getattr__(self, name: str) -> Any:
        return getattr(self.policy, name)


class Blindfolded(WrappedPolicy):
    """A policy shown, in the place of each animal's neighbours, those of another animal.

    What it is shown moves as neighbours do, and has nothing to do with the animal: whoever reacts
    to its neighbours loses them. The other one is of the next individual and, where there are
    several copies, of another episode.
    """

    def __init__(self, policy: Policy, names: Sequence[str]) -> None:
        super().__init__(policy)
        self._seen = np.array([name.startswith("other ") for name in names])

    def predict(self, observation: NDArray[Any], *more: Any, **known: Any) -> tuple[Any, Any]:
        """Return the policy's actions and state."""
        exchanged, seen = observation.copy(), np.flatnonzero(self._seen)
        exchanged[:, seen] = np.roll(observation[:, seen], len(observation) // 2 + 1, axis=0)
        return self.policy.predict(exchanged, *more, **known)


def collect_rollouts(
    make_world: Callable[[int], World],
    policy: Policy,
    *,
    method: str,
    seed: int,
    repetitions: int = 5,
    cue: Cue | None = None,
    resolution: Resolution | Literal["recorded"] | None = "recorded",
    reseed: Callable[[int], None] | None = None,
) -> Rollouts:
    """Let ``policy`` drive all individuals from the start of every demonstration of the world.

    Raises InputError if the world has no demonstrations to start from, ``repetitions`` is not
    positive, or the policy learned in a world of other thrust magnitudes.

    Parameters
    ----------
    make_world
        Makes a world of so many copies, paired with the demonstrations to evaluate on, such as
        ``partial(ChaseWorld, scenario)``. Warm-up steps are replayed by the world.
    policy
        Asked for all individuals of all copies at once: observations ``(slots, n)`` with slot =
        copy * individuals + individual. Its own randomness is its owner's to seed.
    method, seed
        Name and training seed that the rollouts carry; the seed also starts the world's streams.
    repetitions
        Rollouts from each start.
    cue
        ``None``: no condition flag. Otherwise the flag is appended to every observation as its
        last component: the world's condition, its opposite, or a constant. The world itself is
        never changed by it.
    resolution
        The grid to which positions of finished rollouts are rounded, by default that of the world's
        demonstrations; ``None``: they stay as simulated. The simulation itself is never rounded.
    reseed
        Seeds the policy's own randomness before each batch of rollouts, from ``seed`` and the batch
        alone: the same policy then meets the same random numbers whatever it is told, so that two
        answers differ by the cue and by nothing else.
    """
    if repetitions < 1:
        raise InputError(f"repetitions is {repetitions}: collect at least one rollout per start")
    probe = make_world(1)
    demos = probe.demos
    if demos is None or not probe.scenario.paired:
        raise InputError(
            "rollouts start from demonstrations but the world has none: "
            "give demos= and start='demo'"
        )
    learned = getattr(policy, "action_space", None)
    if isinstance(learned, Discrete):
        refuse_other_actions(int(learned.n), probe.num_actions)
    tasks = np.indices((demos.num_episodes, repetitions)).reshape(2, -1).T
    grid = demos.resolution() if resolution == "recorded" else resolution
    parts = []
    for first in range(0, len(tasks), MAX_COPIES):
        batch = tasks[first : first + MAX_COPIES]
        world = make_world(len(batch))
        world.seed([_stream_seed(np.uint64, seed, *task) for task in batch.tolist()])
        if reseed is not None:
            reseed(_stream_seed(np.uint32, seed, first))
        parts.append(_run_batch(world, policy, demos, batch, method, seed, cue))
    made = Rollouts.concatenate(parts)
    return replace(made, positions=rounded(made.positions, grid))


def _run_batch(
    world: World,
    policy: Policy,
    demos: Demonstrations,
    tasks: Ints,
    method: str,
    seed: int,
    cue: Cue | None,
) -> Rollouts:
    copies, num = world.num_copies, world.num_individuals
    world.reset(demo=tasks[:, 0].copy())
    if cue not in (None, "actual", "flipped", 0, 1):
        raise InputError(f"cue is {cue!r}: choose 'actual', 'flipped', 0 or 1")
    flag, condition = None, world.condition
    if cue is not None:
        flags = {"actual": condition.copy(), "flipped": 1 - condition}.get(str(cue), cue)
        flag = np.broadcast_to(np.asarray(flags, dtype=np.int8), condition.shape)
    frames = [world.position.copy()]
    components = np.zeros_like(world.components)
    length = np.zeros(copies, dtype=np.int64)
    outcome = np.zeros(copies, dtype=np.int8)
    running = np.ones(copies, dtype=bool)
    starts = np.ones(copies * num, dtype=bool)
    state: Any = None
    leave_out = getattr(policy, "leave_out", None)  # policies of other libraries have none
    while running.any():
        observation = world.observation.reshape(copies * num, -1)
        if flag is not None:
            column = np.repeat(flag, num)[:, None].astype(observation.dtype)
            observation = np.concatenate([observation, column], axis=1)
        actions, state = policy.predict(
            observation, state=state, episode_start=starts, deterministic=False
        )
        wanted = np.asarray(actions).reshape(copies, num)
        executed = world.executed(wanted)
        state = remembered(policy, state, wanted, executed)
        if leave_out is not None and not running.all():
            state = leave_out(state, np.repeat(~running, num))
        world.step(wanted)
        starts = np.zeros_like(starts)
        frames.append(world.position.copy())
        components[running] += world.components[running]
        ended = running & (world.terminated | world.truncated)
        length[ended], outcome[ended] = len(frames), world.outcome[ended]
        running &= ~ended
    stacked = np.stack(frames)
    return Rollouts(
        method=method,
        individuals=demos.individuals,
        roles=demos.roles,
        dt=demos.dt,
        positions=np.concatenate([stacked[: length[b], b] for b in range(copies)]),
        lengths=length,
        outcome=outcome,
        condition=world.condition,
        cue=np.full(copies, NO_CUE) if flag is None else flag,
        demo=tasks[:, 0],
        seed=np.full(copies, seed),
        repetition=tasks[:, 1],
        component_names=world.reward_components,
        components=components,
    )


def remembered(
    policy: Policy, state: Any, wanted: NDArray[np.integer], executed: NDArray[np.integer]
) -> Any:
    """The policy's state if a world executes other actions than those asked for, ``(B, K)``.

    Policies without a method ``remember``, those of other libraries, see no previous action.
    """
    remember = getattr(policy, "remember", None)
    if executed is wanted or remember is None:
        return state
    return remember(state, executed.ravel())


def _stream_seed(kind: type, seed: int, *place: int) -> int:
    """One stream per rollout, whatever the number of copies."""
    sequence = np.random.SeedSequence([seed % 2**63, *place])
    return int(sequence.generate_state(1, kind)[0])
