"""Demonstrations as training sequences: whole episodes, or windows of them, maybe mirrored."""

from __future__ import annotations

import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
import torch
from numpy.typing import DTypeLike, NDArray

from animarl_algos.replay.store import BatchBuffers, Frames, SequenceBatch, Sequences
from animarl_envs.errors import InputError
from animarl_envs.worlds import Mirror


def checked_array(
    source: str, name: str, value: NDArray[Any] | None, dtype: DTypeLike, shape: tuple[int, ...]
) -> NDArray[Any]:
    """``value`` as the kernels want it, zeros if it is not given; finite and of this shape."""
    if value is None:
        return np.zeros(shape, dtype=dtype)
    array = np.ascontiguousarray(value, dtype=dtype)
    if array.shape != shape:
        raise InputError(
            f"{source}: {name} have shape {array.shape}, not {shape}: "
            "make them from the same episodes"
        )
    if not np.isfinite(array).all():
        place = tuple(int(i) for i in np.argwhere(~np.isfinite(array))[0])
        raise InputError(
            f"{source}: {name} at {place} is not a finite number: "
            "look for a gap in the recording there"
        )
    return array if array.flags.writeable else array.copy()


def check_actions(
    source: str,
    names: Sequence[str],
    actions: NDArray[np.int16],
    first: NDArray[np.int64],
    lengths: NDArray[np.int64],
    num_actions: int,
) -> None:
    """Every frame but each episode's last needs an action of each individual."""
    bad = (actions < 0) | (actions >= num_actions)
    bad[first + lengths - 1] = False
    if bad.any():
        frame, k = (int(i) for i in np.argwhere(bad)[0])
        episode = int(np.searchsorted(first, frame, side="right") - 1)
        raise InputError(
            f"{source}: episode {episode}, frame {frame - first[episode]}, "
            f"{names[k]}: action {actions[frame, k]} is not one of 0 .. "
            f"{num_actions - 1}: infer the actions of the recording first"
        )


def leading_warmup(
    warmup: NDArray[np.bool_], first: NDArray[np.int64], lengths: NDArray[np.int64]
) -> NDArray[np.int64]:
    """Count the steps at the start of each episode that enter no loss, at most all of them."""
    counted = [np.append(warmup[f : f + n - 1], False) for f, n in zip(first, lengths, strict=True)]
    return np.array([int(np.argmin(steps)) for steps in counted], dtype=np.int64)


@dataclass(frozen=True, eq=False)
class Reflection:
    """Mirrors minibatches.

    Parameters
    ----------
    order, sign
        ``(n,)``: the mirrored observation has component ``order[c]``, times ``sign[c]``, in place
        c.
    actions
        ``(actions,)``, the mirror image of each action.

    Raises
    ------
    InputError
        If mirroring twice does not give back what was there.
    """

    order: NDArray[np.int64]
    sign: NDArray[np.float32]
    actions: NDArray[np.int64]

    def __post_init__(self) -> None:
        for key, dtype in (("order", np.int64), ("sign", np.float32), ("actions", np.int64)):
            object.__setattr__(self, key, np.array(getattr(self, key), dtype=dtype))
        n, a = np.arange(len(self.order)), np.arange(len(self.actions))
        once = len(self.sign) == len(n) and np.array_equal(np.sort(self.order), n)
        if not (
            once
            and np.array_equal(self.order[self.order], n)
            and np.allclose(self.sign[self.order] * self.sign, 1.0)
            and np.array_equal(np.sort(self.actions), a)
            and np.array_equal(self.actions[self.actions], a)
        ):
            raise InputError(
                "the mirror image of the mirror image is another: give order, sign and actions of "
                "one reflection"
            )

    @classmethod
    def of(cls, mirror: Mirror, *, flag: bool = False) -> Reflection:
        """Return a world's mirror as a reflection; ``flag`` adds the condition, which stays."""
        order, sign = np.asarray(mirror.order), np.asarray(mirror.sign)
        if flag:
            order, sign = np.append(order, len(order)), np.append(sign, 1.0)
        return cls(order, sign, np.asarray(mirror.actions))

    def observations(self, seen: NDArray[np.floating]) -> NDArray[np.floating]:
        """Mirrored observations ``(..., n)``."""
        mirrored: NDArray[np.floating] = seen[..., self.order] * self.sign
        return mirrored

    def mirror_columns(self, batch: SequenceBatch, chosen: torch.Tensor) -> SequenceBatch:
        """The batch with the ``chosen`` (K, B) columns mirrored; padding stays padding."""
        per_step = chosen.unsqueeze(1)
        order, actions = torch.from_numpy(self.order), torch.from_numpy(self.actions)
        none = len(actions)
        table = torch.cat([actions, torch.tensor([none, -1])])  # no action yet, and no label

        def images(numbers: torch.Tensor) -> torch.Tensor:
            return torch.where(per_step, table[numbers], numbers)

        def per_action(values: torch.Tensor | None) -> torch.Tensor | None:
            if values is None:
                return None
            return torch.where(per_step.unsqueeze(-1), values[..., actions], values)

        mirrored = batch.observations[..., order] * torch.from_numpy(self.sign)
        return replace(
            batch,
            observations=torch.where(per_step.unsqueeze(-1), mirrored, batch.observations),
            previous_actions=images(batch.previous_actions),
            actions=images(batch.actions),
            labels=images(batch.labels),
            action_penalties=per_action(batch.action_penalties),
            label_shares=per_action(batch.label_shares),
        )


class OfflineDataset:
    """Recorded episodes of K individuals, handed out as minibatches of episodes or of windows.

    Per-frame arrays lay the episodes end to end, as :class:`Demonstrations` does. An episode of T
    steps has T + 1 frames; what belongs to a step stands at the frame it starts from, and the
    entries of the last frame are not read.

    Parameters
    ----------
    observations
        ``(frames, K, n)``.
    actions
        ``(frames, K)`` integer, the demonstrated actions; -1 at each last frame.
    lengths
        ``(episodes,)``, frames per episode.
    num_actions
        Number of actions.
    rewards, penalties
        ``(frames, K)``; ``None``: zeros. ``penalties`` default to those of the demonstrated action
        if ``action_penalties`` are given.
    action_penalties
        ``(frames, K, num_actions)``, what each action would have been penalised with.
    label_shares
        ``(frames, K, num_actions)``, soft labels; ``None``: the demonstrated action is the label.
    reflection
        Its mirror image is as likely as what was recorded: half of the windows are mirrored.
    terminated
        ``(episodes,)`` bool, the last step terminated the episode; ``None``: none did, so that the
        last step of each bootstraps.
    condition
        ``(episodes,)``; ``None``: 0.
    warmup
        ``(frames,)`` bool, steps that enter no loss; ``None``: none.
    names
        Names of the individuals; they enter the shuffling. Default ``individual_0`` and so on.
    device
        Where batches go.
    source
        For messages: where the demonstrations come from.

    Attributes
    ----------
    individuals
        The ``names`` that were given, ``None`` if none were: whose demonstrations they are.

    Raises
    ------
    InputError
        If shapes disagree, an action is missing within an episode, or a value is not finite.
    """

    def __init__(
        self,
        observations: NDArray[np.floating],
        actions: NDArray[np.integer],
        lengths: NDArray[np.integer],
        num_actions: int,
        *,
        rewards: NDArray[np.floating] | None = None,
        penalties: NDArray[np.floating] | None = None,
        action_penalties: NDArray[np.floating] | None = None,
        label_shares: NDArray[np.floating] | None = None,
        reflection: Reflection | None = None,
        terminated: NDArray[np.bool_] | None = None,
        condition: NDArray[Any] | None = None,
        warmup: NDArray[np.bool_] | None = None,
        names: Sequence[str] | None = None,
        device: torch.device | str = "cpu",
        source: str = "demonstrations",
    ) -> None:
        self.source = source
        if np.ndim(observations) != 3:
            raise InputError(
                f"{source}: observations have shape {np.shape(observations)}: give one vector per "
                "frame and individual, (frames, individuals, components)"
            )
        frames, k, dim = observations.shape
        self.individuals = tuple(names) if names else None
        self.names = tuple(names or (f"individual_{i}" for i in range(k)))
        if len(set(self.names)) != k:
            raise InputError(f"{source}: names {self.names} do not name {k} individuals")
        self.device = torch.device(device)
        size: NDArray[np.int64] = np.array(lengths, dtype=np.int64)
        if size.size == 0 or size.min() < 2 or size.sum() != frames:
            raise InputError(
                f"{source}: {size.size} episodes of {size.sum()} frames in all do not fit "
                f"{frames} observations: give at least two frames per episode, end to end"
            )
        first = np.cumsum(size) - size
        checked = partial(checked_array, source)
        labels = checked("actions", actions, np.int16, (frames, k))
        check_actions(source, self.names, labels, first, size, num_actions)
        each, flat = (len(size),), (frames, k)
        scored = checked(
            "action_penalties",
            action_penalties,
            np.float32,
            (frames, k, 0 if action_penalties is None else num_actions),
        )
        if penalties is None and action_penalties is not None:
            taken = np.maximum(labels, 0).astype(np.int64)[..., None]
            penalties = np.take_along_axis(scored, taken, axis=2)[..., 0]
        shares = checked(
            "label_shares",
            label_shares,
            np.float32,
            (frames, k, 0 if label_shares is None else num_actions),
        )
        self._num_scored, self.soft = scored.shape[2], label_shares is not None
        self._per_action = np.concatenate([scored, shares], axis=2)
        if reflection is not None and (
            (len(reflection.order), len(reflection.actions)) != (dim, num_actions)
        ):
            raise InputError(
                f"{source}: the reflection is of {len(reflection.order)} components and "
                f"{len(reflection.actions)} actions, not of {dim} and {num_actions}: make it for "
                "this world"
            )
        self.reflection = reflection
        self._frames = Frames(
            observations=checked("observations", observations, np.float32, (*flat, dim)),
            actions=labels,
            rewards=checked("rewards", rewards, np.float32, flat),
            penalties=checked("penalties", penalties, np.float32, flat),
            labels=labels,
            warmup=checked("warmup", warmup, np.bool_, (frames,)),
        )
        self._sequences = Sequences(
            first=first,
            prefix=np.zeros(each, dtype=np.int64),
            trained=size - 1,
            at_start=np.ones(each, dtype=np.bool_),
            terminated=checked("terminated", terminated, np.bool_, each),
            condition=checked("condition", condition, np.float32, each),
            frames=size,
            initial_state=np.zeros((len(size), k, 0), dtype=np.float32),
        )
        self._masked = leading_warmup(self._frames.warmup, first, size)
        self._episodes = np.flatnonzero(self._masked < size - 1)
        if not len(self._episodes):
            raise InputError(f"{source}: all episodes end within the warm-up: shorten the warm-up")
        self._batch = BatchBuffers(
            k, dim, num_actions, 0, self._per_action.shape[2], pinned=self.device.type == "cuda"
        )

    @property
    def num_individuals(self) -> int:
        return len(self.names)

    @property
    def num_episodes(self) -> int:
        """Episodes with at least one step that enters a loss."""
        return len(self._episodes)

    @property
    def num_steps(self) -> int:
        """Steps of all episodes, warm-up included."""
        return int(self._sequences.trained[self._episodes].sum())

    @property
    def nbytes(self) -> int:
        """Bytes of the frames and of the minibatch."""
        arrays: list[NDArray[Any]] = [*self._frames, *self._sequences, self._per_action]
        return sum(array.nbytes for array in arrays) + self._batch.nbytes

    def batches(
        self, batch_size: int, generator: np.random.Generator | None = None
    ) -> Iterator[SequenceBatch]:
        """All episodes once, in minibatches; each batch is overwritten by the next one.

        ``SequenceBatch.indices`` are episode numbers.

        Parameters
        ----------
        generator
            Shuffles. One number is drawn from it; with that and its name each individual gets an
            order of its own, so that individuals trained together see what each would see alone.
            ``None``: longest first, the same episodes for every individual; for validation.
        """
        order = np.empty((self.num_individuals, self.num_episodes), dtype=np.int64)
        if generator is None:
            steps = self._sequences.trained[self._episodes]
            order[:] = self._episodes[np.argsort(-steps, kind="stable")]
        else:
            seed = int(generator.integers(2**63))
            for k, name in enumerate(self.names):
                own = np.random.default_rng([seed, zlib.crc32(name.encode())])
                order[k] = own.permutation(self._episodes)
        return self._batches(order, batch_size)

    def _batches(self, order: NDArray[np.int64], batch_size: int) -> Iterator[SequenceBatch]:
        for begin in range(0, order.shape[1], batch_size):
            chosen = order[:, begin : begin + batch_size]
            by_length = np.argsort(-self._sequences.trained[chosen], axis=1, kind="stable")
            chosen = np.take_along_axis(chosen, by_length, axis=1)
            yield self._filled(self._sequences, chosen, chosen).to(self.device)

    def _filled(
        self, sequences: Sequences, slots: NDArray[np.int64], indices: NDArray[np.int64]
    ) -> SequenceBatch:
        batch = self._batch.fill(
            self._frames,
            self._per_action,
            sequences,
            slots,
            indices,
            np.ones(slots.shape, dtype=np.float32),
        )
        both = batch.action_penalties
        if both is None:
            return batch
        return replace(
            batch,
            action_penalties=both[..., : self._num_scored] if self._num_scored else None,
            label_shares=both[..., self._num_scored :] if self.soft else None,
        )

    def windows(
        self,
        batch_size: int,
        count: int,
        generator: np.random.Generator,
        *,
        length: int,
        burn_in: int = 0,
    ) -> Iterator[SequenceBatch]:
        """``count`` minibatches of windows, drawn independently and with replacement.

        Every step that enters a loss is as likely. Each batch is overwritten by the next one;
        ``SequenceBatch.indices`` are episode numbers.

        Parameters
        ----------
        batch_size
            Windows of each individual.
        generator
            As in :meth:`batches`: individuals trained together draw what each would draw alone.
        length
            Trained steps of a window, fewer at an episode's end; 1 draws single steps.
        burn_in
            Steps before them that only rebuild a memory, as many as the episode has.
        """
        seed = int(generator.integers(2**63))
        own = [np.random.default_rng([seed, zlib.crc32(name.encode())]) for name in self.names]
        slots = np.arange(len(own) * batch_size).reshape(len(own), batch_size)
        for _ in range(count):
            drawn = [self._draw_windows(g, batch_size, length, burn_in) for g in own]
            windows = [np.concatenate(parts) for parts in zip(*(w for _, w in drawn), strict=True)]
            batch = self._filled(
                Sequences(*windows), slots, np.stack([episodes for episodes, _ in drawn])
            )
            if self.reflection is not None:
                coins = np.stack([g.random(batch_size) < 0.5 for g in own])
                batch = self.reflection.mirror_columns(batch, torch.from_numpy(coins))
            yield batch.to(self.device)

    def _draw_windows(
        self, generator: np.random.Generator, count: int, length: int, burn_in: int
    ) -> tuple[NDArray[np.int64], Sequences]:
        """Draw ``count`` windows of ``length`` steps, with up to ``burn_in`` steps before each.

        A window may hang over either end of its episode and is cut there, so that the first and
        the last steps are drawn as often as those between them; every window holds a step that
        enters a loss.

        Returns
        -------
        episodes : ndarray (count,)
            Where each window lies.
        windows : Sequences
            In decreasing length.
        """
        whole, masked = self._sequences, self._masked
        steps = whole.trained
        places = np.where(steps > masked, steps - masked + length - 1, 0)
        ends = np.cumsum(places)
        drawn = generator.integers(ends[-1], size=count)
        episode = np.searchsorted(ends, drawn, side="right")
        begin = drawn - (ends - places)[episode] + masked[episode] - (length - 1)
        end = np.minimum(begin + length, steps[episode])
        begin = np.maximum(begin, 0)
        order = np.argsort(begin - end, kind="stable")
        episode, begin, end = episode[order], begin[order], end[order]
        prefix = np.minimum(burn_in, begin)
        return episode, Sequences(
            first=whole.first[episode] + begin - prefix,
            prefix=prefix,
            trained=end - begin,
            at_start=begin == prefix,
            terminated=whole.terminated[episode] & (end == steps[episode]),
            condition=whole.condition[episode],
            frames=np.zeros(count, dtype=np.int64),
            initial_state=np.zeros((count, 1, 0), dtype=np.float32),
        )

    def input_statistics(self) -> tuple[torch.Tensor, torch.Tensor]:
        """Mean and standard deviation (K, n) of the observations of all steps that enter a loss.

        Where half of the windows are mirrored, of them and their mirror images.
        """
        entering = ~self._frames.warmup
        entering[self._sequences.first + self._sequences.frames - 1] = False
        seen = self._frames.observations[entering].astype(np.float64)
        if self.reflection is not None:
            seen = np.concatenate([seen, self.reflection.observations(seen)])
        mean, sd = seen.mean(axis=0), seen.std(axis=0)
        return torch.from_numpy(mean).float(), torch.from_numpy(sd).float()
