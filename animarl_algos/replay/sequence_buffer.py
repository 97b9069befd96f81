"""Prioritised replay of whole episodes, or of pieces with a burn-in prefix, for K individuals.

Schaul et al. 2016, "Prioritized experience replay"; burn-in and stored states after Kapturowski et
al. 2019, "Recurrent experience replay in distributed reinforcement learning".
"""

import enum
import math
import os
import zlib
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray

from animarl_algos.replay.store import Frames, SequenceBatch, Sequences, gather
from animarl_algos.replay.sum_trees import SumTrees, draw_stratified
from animarl_envs.array_types import Bools, Floats, Ints
from animarl_envs.errors import InputError
from animarl_envs.settings import Checked, Count, NotNegative


class StateMode(enum.StrEnum):
    """The choices; see Kapturowski et al. 2019, section 3."""

    RECOMPUTE = "recompute"  # zeros before the burn-in prefix, which then rebuilds it
    STORED = "stored"  # the acting network's state before the prefix
    ZERO = "zero"  # zeros at the first trained step; no prefix


BETA = (0.4, 1.0)  # exponent of the importance weights at the start of training and at its end
PRIORITY_FLOOR = 1e-6  # keeps every sequence drawable (Schaul et al. 2016, the small epsilon)


@dataclass(frozen=True, kw_only=True)
class ReplaySettings(Checked):
    """Settings in ``replay_buffer_kwargs``."""

    alpha: NotNegative = 0.6
    """Exponent of the priorities."""
    max_episodes: Count | None = None
    """Most episodes kept, however short; None: as many as the memory holds."""


def check_state_mode(mode: str, sequence_length: int | None, burn_in: int) -> None:
    """Refuse settings of a piece that do not fit each other."""
    if mode not in list(StateMode):
        raise InputError(f"state_mode {mode!r} is unknown: choose one of {', '.join(StateMode)}")
    if sequence_length is None:
        if burn_in or mode != StateMode.RECOMPUTE:
            raise InputError(
                f"burn_in {burn_in} and state_mode {str(mode)!r} are for pieces: "
                "set sequence_length, or leave them out for whole episodes"
            )
    elif not 0 <= burn_in < sequence_length:
        raise InputError(
            f"burn_in {burn_in} does not fit sequence_length {sequence_length}: "
            "it must be at least 0 and smaller"
        )
    if mode == StateMode.ZERO and burn_in:
        raise InputError(
            f"state_mode 'zero' starts without a prefix but burn_in is {burn_in}: set it to 0"
        )


GIB = 2**30


def available_memory() -> float:
    """Return the bytes that can be allocated without swapping, infinity if unknown."""
    with suppress(OSError):
        for line in Path("/proc/meminfo").read_text().splitlines():
            if line.startswith("MemAvailable:"):
                return 1024.0 * int(line.split()[1])
    names = getattr(os, "sysconf_names", {})
    if "SC_AVPHYS_PAGES" in names and "SC_PAGE_SIZE" in names:
        return float(os.sysconf("SC_AVPHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))
    return math.inf


def check_memory(arrays: Sequence[Any], setting: str) -> None:
    """Refuse arrays, still untouched, that need more bytes than are available.

    ``setting`` names what asks for so much, such as ``"buffer_size 1000000"``.
    """
    available, nbytes = available_memory(), sum(array.nbytes for array in arrays)
    if nbytes > available:
        raise InputError(
            f"the replay memory for {setting} needs {nbytes / GIB:.1f} GiB but "
            f"{available / GIB:.1f} GiB are available: lower it"
        )


_SETTINGS = (
    "buffer_size",
    "observation_dim",
    "num_individuals",
    "num_actions",
    "max_episode_steps",
    "stride",
    "burn_in",
    "state_size",
    "prioritized",
    "max_episodes",
)
"""What must be equal for a saved state to fit a memory."""
_CURSOR = ("oldest_serial", "next_serial", "next_row", "rows_used", "num_episodes")
"""Where the ring stands, as a saved state has it."""


class SequenceReplayBuffer:
    """A ring of episodes; an episode is K timelines that start and end together.

    Steps of running episodes wait in a staging area, one per copy of the world; a finished episode
    moves to the ring and evicts the oldest ones. Each individual draws its own batches by its own
    priorities and its own random stream, which depends on the seed and its name only: K individuals
    in one buffer draw exactly what they would draw from K buffers of their own.

    Raises InputError if a setting is out of range, an episode cannot fit, or memory does not
    suffice.

    Parameters
    ----------
    buffer_size
        Rows of the ring: steps of the world, plus one per episode for its last observation.
    sequence_length
        ``None``: sequences are whole episodes. Else pieces of at most this many steps, burn-in
        included: trained parts of ``sequence_length - burn_in`` steps lie end to end, so each step
        of an episode is trained in exactly one piece, and up to ``burn_in`` steps precede each.
    state_mode
        See :class:`StateMode`; the recurrent state's ``state_size`` is read for ``"stored"``.
    prioritized
        ``False``: uniform draws, weights 1.
    seed, names
        Roots of the random streams; names default to ``individual_0`` and so on.
    settings
        Those of :class:`ReplaySettings`.
    """

    def __init__(
        self,
        buffer_size: int,
        observation_dim: int,
        num_individuals: int,
        num_actions: int,
        max_episode_steps: int,
        num_copies: int = 1,
        *,
        sequence_length: int | None = None,
        burn_in: int = 0,
        state_mode: str = StateMode.RECOMPUTE,
        state_size: int = 0,
        prioritized: bool = True,
        seed: int = 0,
        names: Sequence[str] | None = None,
        device: torch.device | str = "cpu",
        **settings: Any,
    ) -> None:
        self.names = tuple(names or (f"individual_{k}" for k in range(num_individuals)))
        if buffer_size < max_episode_steps + 1:
            raise InputError(
                f"buffer_size {buffer_size} cannot hold an episode of {max_episode_steps} steps "
                f"and its last observation: set it to {max_episode_steps + 1} or more"
            )
        check_state_mode(state_mode, sequence_length, burn_in)
        self.settings = ReplaySettings(**settings)
        self.max_episodes = self.settings.max_episodes or buffer_size
        self.stride = max_episode_steps if sequence_length is None else sequence_length - burn_in
        self.buffer_size = buffer_size
        self.observation_dim = observation_dim
        self.num_individuals = num_individuals
        self.num_actions = num_actions
        self.max_episode_steps = max_episode_steps
        self.burn_in = burn_in
        self.state_size = state_size if state_mode == StateMode.STORED else 0
        self.prioritized = prioritized
        self.device = torch.device(device)
        # An episode of T steps takes T + 1 rows and ceil(T / stride) slots.
        slots = buffer_size if self.stride == 1 else buffer_size // 2 + 1
        try:
            self.frames = Frames.zeros(buffer_size, num_individuals, observation_dim)
            self.sequences = Sequences.zeros(slots, num_individuals, self.state_size)
            self.trees = SumTrees(num_individuals, slots if prioritized else 0)
        except MemoryError:
            raise InputError(
                f"buffer_size {buffer_size} does not fit the memory: lower it"
            ) from None
        check_memory(
            (*self.frames, *self.sequences, self.trees.nodes), f"buffer_size {buffer_size}"
        )
        # Sequences are numbered by a serial number that never repeats; the slot is that modulo the
        # number of slots, so that a number still says whether its sequence has been evicted.
        self.oldest_serial = self.next_serial = self.next_row = self.rows_used = 0
        self.num_episodes = 0  # finished ones in the ring
        self.max_priority = np.ones(num_individuals)  # so far, before the exponent
        self.streams = np.empty(num_individuals, dtype=np.uint64)
        for k, name in enumerate(self.names):
            root = np.random.SeedSequence([seed, zlib.crc32(name.encode())])
            self.streams[k] = root.generate_state(1, np.uint64)[0]
        self.allocate_staging(num_copies)

    # -- what is in it ----------------------------------------------------------------------------

    @property
    def num_sequences(self) -> int:
        """Sequences that can be drawn."""
        return self.next_serial - self.oldest_serial

    def size(self) -> int:
        """Return the steps of the world in the ring, under stable-baselines3's name for it."""
        return self.num_steps

    @property
    def num_steps(self) -> int:
        """Steps of the world in the ring."""
        return self.rows_used - self.num_episodes

    def moments(self) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Mean and standard deviation ``(K, n)`` of each individual's observations in the ring."""
        observed = self.frames.observations[np.sort(self._used_rows())].astype(np.float64)
        return observed.mean(0).astype(np.float32), observed.std(0).astype(np.float32)

    @property
    def nbytes(self) -> int:
        """Bytes of ring, sequences, priorities and staging area."""
        arrays: list[Any] = [*self.frames, *self.sequences, self.trees.nodes]
        return sum(array.nbytes for array in (*arrays, *self.staged, self.staged_state))

    def _used_rows(self) -> Ints:
        """Rows in use, from the oldest episode's first on."""
        return np.arange(self.next_row - self.rows_used, self.next_row) % self.buffer_size

    def _used_slots(self) -> Ints:
        """Slots in use, from the oldest sequence on."""
        return self._slots(np.arange(self.oldest_serial, self.next_serial))

    def _slots(self, serials: ArrayLike) -> Ints:
        return np.asarray(serials) % len(self.sequences.first)

    # -- adding -----------------------------------------------------------------------------------

    def add(
        self,
        *,
        next_observations: NDArray[np.floating],
        terminated: Bools,
        truncated: Bools | None = None,
        hidden: NDArray[np.floating] | None = None,
        condition: NDArray[Any] | None = None,
        **frames: Any,
    ) -> None:
        """Add one step of every copy, whose ``frames`` are parts of :class:`.store.Frames`.

        What is None or left out is zero, labels -1. Where a copy is done, ``next_observations`` is
        its terminal observation, not the first one of the next episode; it is read only there.
        ``hidden``, the acting network's state before the step, is read with ``state_mode="stored"``
        only, ``condition`` at an episode's last step.

        Raises InputError if an action does not fit, or an episode outgrows ``max_episode_steps``.
        """
        steps, actions = self.step_count, np.asarray(frames["actions"])
        if steps.max() == self.max_episode_steps:
            raise InputError(
                f"copy {steps.argmax()} is past {self.max_episode_steps} steps "
                "without an end: raise max_episode_steps or give the environment a time limit"
            )
        if actions.min() < 0 or actions.max() >= self.num_actions:
            raise InputError(
                f"actions run from {actions.min()} to {actions.max()}: they must lie in "
                f"0 .. {self.num_actions - 1}"
            )
        rows = np.arange(self.num_copies) * (self.max_episode_steps + 1) + steps
        self.staged.write(rows, frames)
        if self.state_size and hidden is not None:
            # Pieces whose first step, prefix included, is this one.
            copies, pieces = np.nonzero(steps[:, None] == self.begins)
            self.staged_state[copies, pieces] = hidden[copies]
        steps += 1
        over = np.flatnonzero(terminated if truncated is None else terminated | truncated)
        if len(over):
            last = np.reshape(next_observations, (self.num_copies, -1))[over]
            self.staged.write(rows[over] + 1, {"observations": last})
        for copy in over.tolist():
            flag = 0.0 if condition is None else float(condition[copy])
            self._commit(copy, bool(terminated[copy]), flag)
            steps[copy] = 0

    def _commit(self, copy: int, terminated: bool, condition: float) -> None:
        """Move the finished episode of a copy from the staging rows to the ring.

        Its trained parts are [0, stride), [stride, 2 stride), ...; those of warm-up steps alone are
        left out, and so is an episode without any other.
        """
        steps, first = int(self.step_count[copy]), copy * (self.max_episode_steps + 1)
        begin = np.arange(0, steps, self.stride)
        warming = self.staged.warmup[first : first + steps]
        begin = begin[~np.logical_and.reduceat(warming, begin)]
        if not len(begin):
            return
        while (
            self.rows_used + steps + 1 > self.buffer_size
            or self.num_sequences + len(begin) > len(self.sequences.first)
            or self.num_episodes >= self.max_episodes
        ):
            self._evict_oldest()
        rows = (self.next_row + np.arange(steps + 1)) % self.buffer_size
        staged = self.staged._asdict().items()
        self.frames.write(rows, {name: of[first : first + steps + 1] for name, of in staged})
        slots = self._slots(self.next_serial + np.arange(len(begin)))
        prefix, end = np.minimum(self.burn_in, begin), np.minimum(begin + self.stride, steps)
        episode = {
            "first": rows[begin - prefix],
            "prefix": prefix,
            "trained": end - begin,
            "at_start": prefix == begin,
            "terminated": terminated & (end == steps),
            "condition": condition,
            "frames": np.where(begin == begin[-1], steps + 1, 0),
            "initial_state": self.staged_state[copy, begin // self.stride],
        }
        for name, held in self.sequences._asdict().items():
            held[slots] = episode[name]
        if self.prioritized:
            self.trees.set(slots, self.max_priority[:, None], self.settings.alpha)
        self.next_serial += len(begin)
        self.next_row = int(rows[-1] + 1) % self.buffer_size
        self.rows_used += steps + 1
        self.num_episodes += 1

    def _evict_oldest(self) -> None:
        """Forget the oldest episode with all its sequences."""
        slots = self._slots(self.oldest_serial + np.arange(self.staged_state.shape[1]))
        episode = slots[: np.flatnonzero(self.sequences.frames[slots])[0] + 1]
        if self.prioritized:
            self.trees.set(episode, 0.0)
        self.oldest_serial += len(episode)
        self.rows_used -= int(self.sequences.frames[episode[-1]])
        self.num_episodes -= 1

    def drop_running(self) -> None:
        """Forget the unfinished episodes of all copies, as when every copy is reset."""
        self.step_count[:] = 0

    # -- drawing ----------------------------------------------------------------------------------

    def sample(self, batch_size: int, progress: float = 0.0) -> SequenceBatch:
        """``batch_size`` sequences for each individual, drawn with replacement.

        ``progress`` is the share of training that is over, 0 to 1; it anneals the importance
        weights.
        """
        if self.num_sequences == 0:
            raise InputError("the replay memory holds no finished episode yet: collect one first")
        shares = np.empty((self.num_individuals, batch_size))
        draw_stratified(self.streams, shares)
        if self.prioritized:
            slots = self.trees.find(shares)
        else:
            place = (shares * self.num_sequences).astype(np.int64)
            slots = self._slots(self.oldest_serial + np.minimum(place, self.num_sequences - 1))
        order = np.argsort(-self.sequences.trained[slots], axis=1, kind="stable")
        slots = slots[np.arange(len(slots))[:, None], order]
        batch = gather(
            *(self.frames, self.sequences, slots),
            indices=self.oldest_serial + self._slots(slots - self.oldest_serial),
            num_actions=self.num_actions,
            weights=self._weights(slots, progress) if self.prioritized else None,
        )
        return batch if self.device.type == "cpu" else batch.to(self.device)

    def _weights(self, slots: Ints, progress: float) -> NDArray[np.float32]:
        """Return w_i = (N P(i))^-beta over the largest of its individual, P(i) = p_i / sum p."""
        start, end = BETA
        beta = start + min(max(progress, 0.0), 1.0) * (end - start)
        priorities = self.trees.priorities[np.arange(len(slots))[:, None], slots]
        weights = (self.num_sequences * priorities / self.trees.nodes[:, 1:2]) ** -beta
        scaled: Floats = weights.astype(np.float32) / weights.max(1, keepdims=True)
        return scaled.astype(np.float32)

    def update_priorities(self, indices: Ints, errors: ArrayLike) -> None:
        """Set the priorities of drawn sequences to ``(|error| + 1e-6) ** alpha``.

        ``indices`` and ``errors`` are (K, B). Sequences evicted since the draw are passed over; of
        one drawn twice the last error counts.
        """
        if not self.prioritized:
            return
        errors = np.asarray(errors, dtype=np.float64)
        if errors.shape != indices.shape or not np.isfinite(errors).all():
            raise InputError(
                f"priority errors of shape {errors.shape} for sequences {indices.shape}: give one "
                "finite number per sequence"
            )
        held = (self.oldest_serial <= indices) & (indices < self.next_serial)
        priorities = np.abs(errors) + PRIORITY_FLOOR
        largest = np.where(held, priorities, 0.0).max(axis=1)
        self.max_priority = np.maximum(self.max_priority, largest)
        self.trees.set(np.where(held, self._slots(indices), -1), priorities, self.settings.alpha)

    # -- saving ----------------------------------------------------------------------------------

    def _used(self) -> dict[str, tuple[NDArray[Any], Ints]]:
        """Arrays with the part of them that is in use, as the cursor and the step counts say."""
        first = np.arange(self.num_copies) * (self.max_episode_steps + 1)
        running = np.concatenate([f + np.arange(n) for f, n in zip(first, self.step_count)])
        used: dict[str, Any] = {
            "streams": (self.streams, np.arange(self.num_individuals)),
            "max_priority": (self.max_priority, np.arange(self.num_individuals)),
            "staged_state": (self.staged_state, np.arange(self.num_copies)),
        }
        for prefix, arrays, part in (
            ("ring", self.frames, self._used_rows()),
            ("sequence", self.sequences, self._used_slots()),
            ("staging", self.staged, running),
        ):
            named = arrays._asdict().items()
            used |= {f"{prefix}_{name}": (array, part) for name, array in named if array.size}
        return used

    def state(self) -> dict[str, Any]:
        """Return arrays (copies) and plain numbers from which an interrupted run goes on exactly.

        They are the used part of the ring and the running episodes.
        """
        state: dict[str, Any] = {name: getattr(self, name) for name in _SETTINGS}
        state["num_copies"] = self.num_copies
        state["cursor"] = np.array([getattr(self, name) for name in _CURSOR])
        slots = self._used_slots() if self.prioritized else np.zeros(0, dtype=np.int64)
        state["priorities"] = self.trees.priorities[:, slots]
        state["step_count"] = self.step_count.copy()
        return state | {name: array[part] for name, (array, part) in self._used().items()}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Go on from the :meth:`state` of a memory with the same settings."""
        for name in _SETTINGS:
            if name not in state:
                raise InputError(f"the saved replay memory lacks {name!r}: start the run anew")
            if state[name] != getattr(self, name):
                raise InputError(
                    f"the saved replay memory has {name} {state[name]}, this run has "
                    f"{getattr(self, name)}: resume with the settings it was saved with"
                )
        try:
            vars(self).update(zip(_CURSOR, state["cursor"].tolist(), strict=True))
            self.allocate_staging(int(state["num_copies"]))
            self.step_count[:] = state["step_count"]
            for name, (array, part) in self._used().items():
                array[part] = state[name]
            if self.prioritized:
                self.trees.restore(self._used_slots(), state["priorities"])
        except InputError:
            raise
        except (KeyError, IndexError, TypeError, ValueError) as error:
            raise InputError(
                f"the saved replay memory is damaged ({type(error).__name__}: {error}): "
                "start the run anew"
            ) from error

    # -- inside -----------------------------------------------------------------------------------

    def allocate_staging(self, copies: int) -> None:
        """Make room for the running episodes of so many copies, none of them begun."""
        k, steps = self.num_individuals, self.max_episode_steps
        self.num_copies, pieces = copies, math.ceil(steps / self.stride)
        self.staged = Frames.zeros(copies * (steps + 1), k, self.observation_dim)
        self.step_count = np.zeros(copies, dtype=np.int64)
        # The first step of each piece, prefix included, and the recurrent state before it.
        self.begins = np.maximum(np.arange(0, steps, self.stride) - self.burn_in, 0)
        self.staged_state = np.zeros((copies, pieces, k, self.state_size), dtype=np.float32)
        arrays = (*self.staged, self.staged_state)
        check_memory(arrays, f"{copies} copies of max_episode_steps {steps}")
