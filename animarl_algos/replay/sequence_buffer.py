"""Prioritised replay of whole episodes, or of pieces with a burn-in prefix, for K individuals.

Schaul et al. 2016, "Prioritized experience replay"; burn-in and stored states after Kapturowski et
al. 2019, "Recurrent experience replay in distributed reinforcement learning".
"""

from __future__ import annotations

import enum
import math
import os
import zlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import ArrayLike, DTypeLike, NDArray

from animarl_algos.checked import COUNT_OR_NONE, NOT_NEGATIVE, PROBABILITY
from animarl_algos.replay import sequence_kernels as kernels
from animarl_algos.replay.sequence_kernels import SumTrees
from animarl_algos.replay.store import (
    EPISODES,
    NEXT,
    NEXT_ROW,
    NO_LABEL,
    OLDEST,
    ROWS_USED,
    BatchBuffers,
    Frames,
    Layout,
    Ring,
    SequenceBatch,
    Sequences,
    Staging,
    bytes_of_row,
    frame_layout,
    sequence_layout,
    zeros,
)
from animarl_envs.errors import InputError


class StateMode(enum.StrEnum):
    """The choices; see Kapturowski et al. 2019, section 3."""

    RECOMPUTE = "recompute"  # zeros before the burn-in prefix, which then rebuilds it
    STORED = "stored"  # the acting network's state before the prefix
    ZERO = "zero"  # zeros at the first trained step; no prefix


def check_state_mode(
    mode: StateMode | str, sequence_length: int | None, burn_in: int, state_size: int
) -> StateMode:
    """Return the mode if it fits the other settings of a piece."""
    try:
        mode = StateMode(mode)
    except ValueError:
        raise InputError(
            f"state_mode {mode!r} is unknown: choose one of {', '.join(StateMode)}"
        ) from None
    if sequence_length is None:
        if burn_in or mode is not StateMode.RECOMPUTE:
            raise InputError(
                f"burn_in {burn_in} and state_mode {mode.value!r} are for pieces: "
                "set sequence_length, or leave them out for whole episodes"
            )
    elif not 0 <= burn_in < sequence_length:
        raise InputError(
            f"burn_in {burn_in} does not fit sequence_length {sequence_length}: "
            "it must be at least 0 and smaller"
        )
    if mode is StateMode.ZERO and burn_in:
        raise InputError(
            f"state_mode 'zero' starts without a prefix but burn_in is {burn_in}: set it to 0"
        )
    if mode is StateMode.STORED and state_size < 1:
        raise InputError("state_mode 'stored' needs state_size, the size of the recurrent state")
    return mode


_MEMINFO = Path("/proc/meminfo")
_GIB = 2**30


def available_memory() -> int | None:
    """Return the bytes that can be allocated without swapping, ``None`` if unknown."""
    if _MEMINFO.is_file():
        for line in _MEMINFO.read_text().splitlines():
            if line.startswith("MemAvailable:"):
                return int(line.split()[1]) * 1024
    names = getattr(os, "sysconf_names", {})
    if "SC_AVPHYS_PAGES" in names and "SC_PAGE_SIZE" in names:
        return os.sysconf("SC_AVPHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    return None


def check_memory(nbytes: int, setting: str) -> None:
    """Refuse an allocation of more ``nbytes`` than are available.

    ``setting`` names what asks for so much, such as ``"buffer_size 1000000"``.
    """
    available = available_memory()
    if available is not None and nbytes > available:
        raise InputError(
            f"the replay memory for {setting} needs {nbytes / _GIB:.1f} GiB but "
            f"{available / _GIB:.1f} GiB are available: lower it"
        )


class Step(NamedTuple):
    """One step of every copy, as the kernels want it."""

    observations: NDArray[np.float32]  # (copies, K, n)
    actions: NDArray[np.int64]  # (copies, K)
    rewards: NDArray[np.float32]  # (copies, K)
    next_observations: NDArray[np.float32]  # (copies, K, n)
    terminated: NDArray[np.bool_]  # (copies,)
    truncated: NDArray[np.bool_]  # (copies,)
    penalties: NDArray[np.float32]  # (copies, K)
    labels: NDArray[np.int64]  # (copies, K)
    warmup: NDArray[np.bool_]  # (copies,)
    hidden: NDArray[np.float32]  # (copies, K, H)
    condition: NDArray[np.float32]  # (copies,)


def fit(name: str, value: Any, dtype: DTypeLike, shape: tuple[int, ...]) -> NDArray[Any]:
    """``value`` as the kernels want it: contiguous, writeable, of this type and shape."""
    array = np.ascontiguousarray(value, dtype=dtype)
    if array.shape != shape:
        raise InputError(
            f"{name} of a step have shape {array.shape}, this memory wants {shape}: "
            "make the memory for this environment"
        )
    return array if array.flags.writeable else array.copy()


_SETTINGS = (
    "buffer_size", "observation_dim", "num_individuals", "num_actions", "max_episode_steps",
    "stride", "burn_in", "state_size", "prioritized", "max_episodes",
)  # fmt: skip
"""What must be equal for a saved state to fit a memory."""


class SequenceReplayBuffer:
    """A ring of episodes; an episode is K timelines that start and end together.

    Steps of running episodes wait in a staging area, one per copy of the world; a finished episode
    moves to the ring and evicts the oldest ones. Each individual draws its own batches by its own
    priorities and its own random stream, which depends on the seed and its name only: K individuals
    in one buffer draw exactly what they would draw from K buffers of their own.

    Parameters
    ----------
    buffer_size
        Rows of the ring: steps of the world, plus one per episode for its last observation.
    observation_dim, num_individuals, num_actions
        ``n``, ``K`` and the number of actions.
    max_episode_steps
        Longest episode.
    sequence_length
        ``None``: sequences are whole episodes. Else pieces of at most this many steps, burn-in
        included: trained parts of ``sequence_length - burn_in`` steps lie end to end, so each step
        of an episode is trained in exactly one piece, and up to ``burn_in`` steps precede each.
    state_mode
        See :class:`StateMode`.
    state_size
        Size H of the recurrent state; needed for ``"stored"`` only.
    prioritized
        ``False``: uniform draws, weights 1.
    stratified
        One draw from each of B equal parts of the priority mass instead of independent draws.
    alpha
        Exponent of the priorities.
    beta_start, beta_end
        Exponent of the importance weights at progress 0 and 1.
    seed, names
        Roots of the random streams; names default to ``individual_0`` and so on.
    device
        Where batches go.
    max_episodes
        Most episodes kept, however short; ``None``: as many as the rows hold.
    num_copies
        Copies of the world; ``None``: as many as the first ``add`` shows.

    Raises
    ------
    InputError
        If a setting is out of range, an episode cannot fit, or memory does not suffice.
    """

    def __init__(
        self,
        buffer_size: int,
        observation_dim: int,
        num_individuals: int,
        num_actions: int,
        max_episode_steps: int,
        *,
        sequence_length: int | None = None,
        burn_in: int = 0,
        state_mode: StateMode | str = StateMode.RECOMPUTE,
        state_size: int = 0,
        prioritized: bool = True,
        stratified: bool = True,
        alpha: float = 0.6,
        beta_start: float = 0.4,
        beta_end: float = 1.0,
        seed: int = 0,
        names: Sequence[str] | None = None,
        device: torch.device | str = "cpu",
        max_episodes: int | None = None,
        num_copies: int | None = None,
    ) -> None:
        self.names = tuple(names or (f"individual_{k}" for k in range(num_individuals)))
        if len(set(self.names)) != num_individuals:
            raise InputError(f"names {self.names} do not name {num_individuals} individuals")
        if max_episode_steps < 1 or buffer_size < max_episode_steps + 1:
            raise InputError(
                f"buffer_size {buffer_size} cannot hold an episode of {max_episode_steps} steps "
                f"and its last observation: set it to {max(max_episode_steps, 1) + 1} or more"
            )
        max_episodes = COUNT_OR_NONE.check("max_episodes", max_episodes)
        NOT_NEGATIVE.check("alpha of the replay memory", alpha)
        PROBABILITY.check("beta_start", beta_start)
        PROBABILITY.check("beta_end", beta_end)
        self.max_episodes = buffer_size if max_episodes is None else max_episodes
        self.state_mode = check_state_mode(state_mode, sequence_length, burn_in, state_size)
        self.stride = max_episode_steps if sequence_length is None else sequence_length - burn_in
        self.buffer_size = buffer_size
        self.observation_dim = observation_dim
        self.num_individuals = num_individuals
        self.num_actions = num_actions
        self.max_episode_steps = max_episode_steps
        self.burn_in = burn_in
        self.state_size = state_size if self.state_mode is StateMode.STORED else 0
        self.prioritized = prioritized
        self.stratified = stratified
        self.alpha = alpha
        self.beta_start, self.beta_end = beta_start, beta_end
        self.device = torch.device(device)

        # An episode of T steps takes T + 1 rows and ceil(T / stride) slots.
        self.num_slots = buffer_size if self.stride == 1 else buffer_size // 2 + 1
        tree_nodes = SumTrees.num_nodes(self.num_slots) if prioritized else 0
        sequence = sequence_layout(num_individuals, self.state_size)
        check_memory(
            buffer_size * bytes_of_row(frame_layout(num_individuals, observation_dim))
            + self.num_slots * bytes_of_row(sequence)
            + 8 * num_individuals * tree_nodes,
            f"buffer_size {buffer_size}",
        )
        self.trees = SumTrees(num_individuals, self.num_slots if prioritized else 0)
        self.ring = Ring(
            Frames.allocate(buffer_size, num_individuals, observation_dim),
            Sequences(**zeros(sequence, self.num_slots)),
            cursor=np.zeros(5, dtype=np.int64),
            trees=self.trees.nodes,
            max_priority=np.ones(num_individuals),
        )
        self.streams = np.empty(num_individuals, dtype=np.uint64)
        self.seed(seed)
        self._batch = BatchBuffers(
            num_individuals,
            observation_dim,
            num_actions,
            self.state_size,
            0,
            pinned=self.device.type == "cuda",
        )
        self._unscored = np.zeros((0, num_individuals, 0), dtype=np.float32)
        self.num_copies = 0
        if num_copies is not None:
            self.allocate_staging(num_copies)

    def seed(self, seed: int) -> None:
        """Start all random streams anew, from ``seed`` and each individual's name."""
        for k, name in enumerate(self.names):
            root = np.random.SeedSequence([seed, zlib.crc32(name.encode())])
            self.streams[k] = root.generate_state(1, np.uint64)[0]

    # -- what is in it ----------------------------------------------------------------------------

    @property
    def num_sequences(self) -> int:
        """Sequences that can be drawn."""
        return int(self.ring.cursor[NEXT] - self.ring.cursor[OLDEST])

    @property
    def num_episodes(self) -> int:
        """Finished episodes in the ring."""
        return int(self.ring.cursor[EPISODES])

    def size(self) -> int:
        """Steps of the world in the ring, under stable-baselines3's name for it."""
        return self.num_steps

    @property
    def num_steps(self) -> int:
        """Steps of the world in the ring."""
        return int(self.ring.cursor[ROWS_USED]) - self.num_episodes

    def moments(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Mean and standard deviation ``(K, n)`` of each individual's observations in the ring."""
        used, rows = int(self.ring.cursor[ROWS_USED]), np.arange(self.buffer_size)
        held = (int(self.ring.cursor[NEXT_ROW]) - 1 - rows) % self.buffer_size < used
        observed = self.ring.frames.observations[held].astype(np.float64)
        return observed.mean(0).astype(np.float32), observed.std(0).astype(np.float32)

    @property
    def nbytes(self) -> int:
        """Return the bytes of ring, sequences, priorities, staging area and minibatch."""
        arrays: list[NDArray[Any]] = [
            *self.ring.frames,
            *self.ring.sequences,
            self.ring.trees,
        ]
        if self.num_copies:
            arrays += [*self.staging.frames, self.staging.state]
        return sum(array.nbytes for array in arrays) + self._batch.nbytes

    # -- adding -----------------------------------------------------------------------------------

    def add(
        self,
        observations: NDArray[np.floating],
        actions: NDArray[np.integer],
        rewards: NDArray[np.floating],
        next_observations: NDArray[np.floating],
        terminated: NDArray[np.bool_],
        truncated: NDArray[np.bool_],
        *,
        penalties: NDArray[np.floating] | None = None,
        labels: NDArray[np.integer] | None = None,
        warmup: NDArray[np.bool_] | None = None,
        hidden: NDArray[np.floating] | None = None,
        condition: NDArray[Any] | None = None,
    ) -> None:
        """Add one step of every copy.

        Parameters
        ----------
        observations, next_observations
            ``(copies, K, n)``; where a copy is done, ``next_observations`` is its terminal
            observation, not the first one of the next episode. It is read only there.
        actions, rewards
            ``(copies, K)``.
        terminated, truncated
            ``(copies,)`` bool.
        penalties
            ``(copies, K)``, DTW penalties; ``None``: zeros.
        labels
            ``(copies, K)``, aligned demonstrated actions, -1 where there is none; ``None``: none.
        warmup
            ``(copies,)`` bool, steps that enter no loss; ``None``: no step.
        hidden
            ``(copies, K, H)``, the acting network's state before this step; read with
            ``state_mode="stored"`` only.
        condition
            ``(copies,)``, the episode's condition, read at its last step; ``None``: 0.

        Raises
        ------
        InputError
            If a shape or an action does not fit, or an episode outgrows ``max_episode_steps``.
        """
        if self.num_copies == 0:
            self.allocate_staging(len(observations))
        if self.state_size and hidden is None:
            raise InputError("state_mode 'stored' needs the recurrent state: pass hidden to add")
        given = (
            *(observations, actions, rewards, next_observations, terminated, truncated),
            *(penalties, labels, warmup, hidden if self.state_size else None, condition),
        )
        step = Step(
            *[
                self._not_given[name]
                if value is None
                else fit(name, value, dtype, (self.num_copies, *shape))
                for value, (name, (dtype, shape)) in zip(
                    given, self._step_layout.items(), strict=True
                )
            ]
        )
        cut = (self.stride, self.burn_in)
        ended = kernels.stage_steps(self.staging, step, *cut, self.num_actions)
        if ended == kernels.BAD_ACTION:
            raise InputError(
                f"actions run from {step.actions.min()} to {step.actions.max()}: they must lie in "
                f"0 .. {self.num_actions - 1}"
            )
        if ended == kernels.TOO_LONG:
            raise InputError(
                f"copy {self.staging.step_count.argmax()} is past {self.max_episode_steps} steps "
                "without an end: raise max_episode_steps or give the environment a time limit"
            )
        if ended:
            kernels.commit_ended(self.staging, step, self.ring, self.alpha, *cut, self.max_episodes)

    def drop_running(self) -> None:
        """Forget the unfinished episodes of all copies, as when every copy is reset."""
        if self.num_copies:
            self.staging.step_count[:] = 0

    # -- drawing ----------------------------------------------------------------------------------

    def beta(self, progress: float) -> float:
        """Exponent of the importance weights when a share ``progress`` of training is over."""
        return self.beta_start + min(max(progress, 0.0), 1.0) * (self.beta_end - self.beta_start)

    def sample(self, batch_size: int, progress: float = 0.0) -> SequenceBatch:
        """``batch_size`` sequences for each individual, drawn with replacement.

        The batch's tensors are overwritten by the next call: ``clone`` it to keep it.

        Parameters
        ----------
        progress
            Share of training that is over, 0 to 1; it anneals the importance weights.
        """
        if self.num_sequences == 0:
            raise InputError("the replay memory holds no finished episode yet: collect one first")
        shape = (self.num_individuals, batch_size)
        serials, slots = np.empty(shape, dtype=np.int64), np.empty(shape, dtype=np.int64)
        weights = np.empty(shape, dtype=np.float32)
        kernels.choose(
            *(self.ring, self.streams, self.beta(progress), self.stratified),
            *(serials, slots, weights),
        )
        batch = self._batch.fill(
            *(self.ring.frames, self._unscored, self.ring.sequences, slots, serials, weights)
        )
        return batch if self.device.type == "cpu" else batch.to(self.device)

    def update_priorities(self, indices: NDArray[np.int64], errors: ArrayLike) -> None:
        """Set the priorities of drawn sequences to ``(|error| + 1e-6) ** alpha``.

        Sequences evicted since the draw are passed over; of one drawn twice the last error counts.

        Parameters
        ----------
        indices, errors
            ``(K, B)``: ``SequenceBatch.indices``, and one error per sequence.
        """
        if not self.prioritized:
            return
        errors = np.asarray(errors, dtype=np.float64)
        if errors.shape != indices.shape or not np.isfinite(errors).all():
            raise InputError(
                f"priority errors of shape {errors.shape} for sequences {indices.shape}: give one "
                "finite number per sequence"
            )
        kernels.update_priorities(self.ring, self.alpha, indices, errors)

    # -- saving ----------------------------------------------------------------------------------

    def _used(self) -> dict[str, tuple[NDArray[Any], NDArray[np.int64]]]:
        """Arrays with the part of them that is in use, as the cursor and the step counts say."""
        ring, each = self.ring, np.arange(self.num_individuals)
        used = {
            "streams": (self.streams, each),
            "max_priority": (ring.max_priority, each),
            **{f"ring_{n}": (a, ring.used_rows) for n, a in ring.frames._asdict().items()},
            **{f"sequence_{n}": (a, ring.used_slots) for n, a in ring.sequences._asdict().items()},
        }
        if self.num_copies:
            staged, running = self.staging.frames._asdict(), self.staging.used_rows
            used["staged_state"] = (self.staging.state, np.arange(self.num_copies))
            used |= {f"staging_{name}": (array, running) for name, array in staged.items()}
        return used

    def state(self) -> dict[str, Any]:
        """Return arrays (copies) and plain numbers from which an interrupted run goes on exactly.

        They are the used part of the ring and the running episodes.
        """
        slots = self.ring.used_slots if self.prioritized else np.zeros(0, dtype=np.int64)
        state: dict[str, Any] = {name: getattr(self, name) for name in _SETTINGS}
        state |= {"num_copies": self.num_copies, "cursor": self.ring.cursor.copy()}
        state["priorities"] = self.trees.priorities[:, slots]
        if self.num_copies:
            state["step_count"] = self.staging.step_count.copy()
        return state | {name: array[part] for name, (array, part) in self._used().items()}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Go on from the :meth:`state` of a memory with the same settings.

        Raises
        ------
        InputError
            If a setting differs or the state is damaged.
        """
        for name in _SETTINGS:
            if name not in state:
                raise InputError(f"the saved replay memory lacks {name!r}: start the run anew")
            if state[name] != getattr(self, name):
                raise InputError(
                    f"the saved replay memory has {name} {state[name]}, this run has "
                    f"{getattr(self, name)}: resume with the settings it was saved with"
                )
        try:
            self.ring.cursor[:] = state["cursor"]
            if copies := int(state["num_copies"]):
                self.allocate_staging(copies)
                self.staging.step_count[:] = state["step_count"]
            for name, (array, part) in self._used().items():
                array[part] = state[name]
            if self.prioritized:
                self.trees.restore(self.ring.used_slots, state["priorities"])
        except (KeyError, IndexError, TypeError, ValueError) as error:
            if isinstance(error, InputError):
                raise
            raise InputError(
                f"the saved replay memory is damaged ({type(error).__name__}: {error}): "
                "start the run anew"
            ) from error

    # -- inside -----------------------------------------------------------------------------------

    def allocate_staging(self, copies: int) -> None:
        """Make room for the running episodes of so many copies, none of them begun."""
        k, rows = self.num_individuals, copies * (self.max_episode_steps + 1)
        pieces = math.ceil(self.max_episode_steps / self.stride)
        check_memory(
            rows * bytes_of_row(frame_layout(k, self.observation_dim))
            + 4 * copies * pieces * k * self.state_size,
            f"{copies} copies of max_episode_steps {self.max_episode_steps}",
        )
        self.num_copies = copies
        self.staging = Staging(
            Frames.allocate(rows, k, self.observation_dim),
            step_count=np.zeros(copies, dtype=np.int64),
            state=np.zeros((copies, pieces, k, self.state_size), dtype=np.float32),
        )
        observed, pair = (np.float32, (k, self.observation_dim)), (k,)
        self._step_layout: Layout = {
            **{"observations": observed, "actions": (np.int64, pair)},
            **{"rewards": (np.float32, pair), "next_observations": observed},
            **dict.fromkeys(("terminated", "truncated"), (np.bool_, ())),
            **{"penalties": (np.float32, pair), "labels": (np.int64, pair)},
            **{"warmup": (np.bool_, ()), "hidden": (np.float32, (k, self.state_size))},
            "condition": (np.float32, ()),
        }
        self._not_given = zeros(self._step_layout, copies)
        self._not_given["labels"][:] = NO_LABEL
