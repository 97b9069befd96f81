"""Demonstrations as training sequences: whole episodes, or windows of them, maybe mirrored."""

import zlib
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import torch
from numpy.typing import DTypeLike, NDArray

from animarl_algos.losses.terms import Recipe, ScoredActionsTemporalDifference
from animarl_algos.networks.networks import StackedQNetwork
from animarl_algos.replay.store import Frames, SequenceBatch, Sequences, gather
from animarl_envs.array_types import Bools, Ints
from animarl_envs.errors import InputError
from animarl_envs.worlds import Mirror


def mirror_columns(batch: SequenceBatch, mirror: Mirror, chosen: torch.Tensor) -> SequenceBatch:
    """Return the batch with the ``chosen`` (K, B) columns mirrored; padding stays padding."""
    per_step = chosen.unsqueeze(1)
    order, actions = torch.from_numpy(mirror.order), torch.from_numpy(mirror.actions)
    table = torch.cat([actions, torch.tensor([len(actions), -1])])  # no action yet, and no label

    def images(numbers: torch.Tensor) -> torch.Tensor:
        return torch.where(per_step, table[numbers], numbers)

    def per_action(values: torch.Tensor | None) -> torch.Tensor | None:
        if values is None:
            return None
        return torch.where(per_step.unsqueeze(-1), values[..., actions], values)

    mirrored = batch.observations[..., order] * torch.from_numpy(mirror.sign)
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

    Raises InputError if shapes disagree, an action is missing within an episode, or a value is not
    finite.

    Parameters
    ----------
    observations, actions, rewards
        ``(frames, K, n)``, ``(frames, K)`` integer, -1 at each last frame, and ``(frames, K)``, by
        default zeros.
    lengths, terminated, condition
        ``(episodes,)``: frames; whether the last step terminated it, by default none did, so that
        the last step of each bootstraps; 0 or 1.
    action_penalties, label_shares
        ``(frames, K, num_actions)``: what each action would have been penalised with, and soft
        labels; by default the demonstrated action is the label.
    mirror
        Its mirror image is as likely as what was recorded: half of the windows are mirrored.
    warmup
        ``(frames,)`` bool, steps that enter no loss.
    names
        Of the individuals; they enter the shuffling. ``individuals`` are the names that were given.
    """

    def __init__(
        self,
        observations: NDArray[np.floating],
        actions: NDArray[np.integer],
        lengths: NDArray[np.integer],
        num_actions: int,
        *,
        rewards: NDArray[np.floating] | None = None,
        action_penalties: NDArray[np.floating] | None = None,
        label_shares: NDArray[np.floating] | None = None,
        mirror: Mirror | None = None,
        terminated: Bools | None = None,
        condition: NDArray[Any] | None = None,
        warmup: Bools | None = None,
        names: Sequence[str] | None = None,
        source: str = "demonstrations",
    ) -> None:
        self.source, self.num_actions = source, num_actions
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
        size: Ints = np.array(lengths, dtype=np.int64)
        if size.size == 0 or size.min() < 2 or size.sum() != frames:
            raise InputError(
                f"{source}: {size.size} episodes of {size.sum()} frames in all do not fit "
                f"{frames} observations: give at least two frames per episode, end to end"
            )
        first = np.cumsum(size) - size
        each, per_action = (len(size),), (frames, k, num_actions)
        labels = self._checked("actions", actions, np.int16, (frames, k))
        self._check_actions(labels, first, size)
        penalties = np.zeros((frames, k), np.float32)
        none = np.zeros((frames, k, 0), np.float32)
        scored = shares = none
        if action_penalties is not None:
            scored = self._checked("action_penalties", action_penalties, np.float32, per_action)
            taken = np.maximum(labels, 0).astype(np.int64)[..., None]
            penalties = np.take_along_axis(scored, taken, axis=2)[..., 0]
        if label_shares is not None:
            shares = self._checked("label_shares", label_shares, np.float32, per_action)
        self.mirror = mirror
        self._frames = Frames(
            observations=self._checked("observations", observations, np.float32, (frames, k, dim)),
            actions=labels,
            rewards=self._checked("rewards", rewards, np.float32, (frames, k)),
            penalties=penalties,
            labels=labels,
            warmup=self._checked("warmup", warmup, np.bool_, (frames,)),
            action_penalties=scored,
            label_shares=shares,
        )
        self._sequences = Sequences.zeros(len(size), k, 0)._replace(
            first=first,
            trained=size - 1,
            at_start=np.ones(each, dtype=np.bool_),
            terminated=self._checked("terminated", terminated, np.bool_, each),
            condition=self._checked("condition", condition, np.float32, each),
            frames=size,
        )
        # Steps at the start of each episode that enter no loss.
        warm = [np.append(self._frames.warmup[f : f + n - 1], False) for f, n in zip(first, size)]
        self._masked = np.array([int(np.argmin(steps)) for steps in warm], dtype=np.int64)
        self._episodes = np.flatnonzero(self._masked < size - 1)
        if not len(self._episodes):
            raise InputError(f"{source}: all episodes end within the warm-up: shorten the warm-up")

    def _checked(
        self, name: str, value: NDArray[Any] | None, dtype: DTypeLike, shape: tuple[int, ...]
    ) -> NDArray[Any]:
        """Copy ``value``, zeros if it is not given; finite and of this shape."""
        if value is None:
            return np.zeros(shape, dtype=dtype)
        array = np.array(value, dtype=dtype, order="C")
        if array.shape != shape:
            raise InputError(
                f"{self.source}: {name} have shape {array.shape}, not {shape}: "
                "make them from the same episodes"
            )
        if not np.isfinite(array).all():
            place = tuple(int(i) for i in np.argwhere(~np.isfinite(array))[0])
            raise InputError(
                f"{self.source}: {name} at {place} is not a finite number: "
                "look for a gap in the recording there"
            )
        return array

    def _check_actions(self, actions: NDArray[np.int16], first: Ints, lengths: Ints) -> None:
        """Every frame but each episode's last needs an action of each individual."""
        bad = (actions < 0) | (actions >= self.num_actions)
        bad[first + lengths - 1] = False
        if bad.any():
            frame, k = (int(i) for i in np.argwhere(bad)[0])
            episode = int(np.searchsorted(first, frame, side="right") - 1)
            raise InputError(
                f"{self.source}: episode {episode}, frame {frame - first[episode]}, "
                f"{self.names[k]}: action {actions[frame, k]} is not one of 0 .. "
                f"{self.num_actions - 1}: infer the actions of the recording first"
            )

    @property
    def num_episodes(self) -> int:
        """Episodes with at least one step that enters a loss."""
        return len(self._episodes)

    @property
    def num_steps(self) -> int:
        """Steps of all episodes, warm-up included."""
        return int(self._sequences.trained[self._episodes].sum())

    def _generators(self, root: np.random.Generator) -> list[np.random.Generator]:
        """Return a generator for each individual, seeded by a draw of ``root`` and its name.

        So individuals trained together see what each would see alone.
        """
        seed = int(root.integers(2**63))
        return [np.random.default_rng([seed, zlib.crc32(name.encode())]) for name in self.names]

    def batches(
        self, batch_size: int, generator: np.random.Generator | None = None
    ) -> Iterator[SequenceBatch]:
        """All episodes once, in minibatches; ``SequenceBatch.indices`` are episode numbers.

        ``generator`` shuffles, for each individual by itself. ``None``: longest first, the same
        episodes for every individual; for validation.
        """
        steps = self._sequences.trained
        if generator is None:
            longest = self._episodes[np.argsort(-steps[self._episodes], kind="stable")]
            order = np.tile(longest, (len(self.names), 1))
        else:
            own = self._generators(generator)
            order = np.stack([each.permutation(self._episodes) for each in own])
        for begin in range(0, order.shape[1], batch_size):
            chosen = order[:, begin : begin + batch_size]
            by_length = np.argsort(-steps[chosen], axis=1, kind="stable")
            chosen = np.take_along_axis(chosen, by_length, axis=1)
            yield self._gathered(self._sequences, chosen, chosen)

    def _gathered(self, sequences: Sequences, slots: Ints, indices: Ints) -> SequenceBatch:
        return gather(
            *(self._frames, sequences, slots), indices=indices, num_actions=self.num_actions
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

        Every step that enters a loss is as likely. A window has ``length`` trained steps, fewer at
        an episode's end, and up to ``burn_in`` steps before them that only rebuild a memory.
        ``generator`` as in :meth:`batches`; ``SequenceBatch.indices`` are episode numbers.
        """
        own = self._generators(generator)
        slots = np.arange(len(own) * batch_size).reshape(len(own), batch_size)
        for _ in range(count):
            drawn = [self._draw_windows(g, batch_size, length, burn_in) for g in own]
            windows = [np.concatenate(parts) for parts in zip(*(w for _, w in drawn), strict=True)]
            batch = self._gathered(
                Sequences(*windows), slots, np.stack([episodes for episodes, _ in drawn])
            )
            if self.mirror is not None:
                coins = np.stack([g.random(batch_size) < 0.5 for g in own])
                batch = mirror_columns(batch, self.mirror, torch.from_numpy(coins))
            yield batch

    def _draw_windows(
        self, generator: np.random.Generator, count: int, length: int, burn_in: int
    ) -> tuple[Ints, Sequences]:
        """Draw ``count`` windows of ``length`` steps, with up to ``burn_in`` steps before each.

        A window may hang over either end of its episode and is cut there, so that the first and
        the last steps are drawn as often as those between them; every window holds a step that
        enters a loss. Returns the episodes ``(count,)`` of the windows, in decreasing length.
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
        return episode, Sequences.zeros(count, 1, 0)._replace(
            first=whole.first[episode] + begin - prefix,
            prefix=prefix,
            trained=end - begin,
            at_start=begin == prefix,
            terminated=whole.terminated[episode] & (end == steps[episode]),
            condition=whole.condition[episode],
        )

    def input_statistics(self) -> tuple[torch.Tensor, torch.Tensor]:
        """Mean and standard deviation (K, n) of the observations of all steps that enter a loss.

        Where half of the windows are mirrored, of them and their mirror images.
        """
        entering = ~self._frames.warmup
        entering[self._sequences.first + self._sequences.frames - 1] = False
        seen = self._frames.observations[entering].astype(np.float64)
        if self.mirror is not None:
            seen = np.concatenate([seen, seen[..., self.mirror.order] * self.mirror.sign])
        mean, sd = seen.mean(axis=0), seen.std(axis=0)
        return torch.from_numpy(mean).float(), torch.from_numpy(sd).float()


def check_demonstrations(data: Any, recipe: Recipe, network: StackedQNetwork, env: Any) -> None:
    """Refuse demonstrations of other individuals, another observation or other actions."""
    if not (hasattr(data, "train") and hasattr(data, "val")):
        raise InputError(
            f"demonstrations is a {type(data).__name__}: give Demonstrations, or an object with "
            "the datasets train and val"
        )
    for name, dataset in (("training", data.train), ("validation", data.val)):
        batch = next(iter(dataset.batches(1)), None)
        if batch is None:
            raise InputError(
                f"the {name} split holds no demonstrated episode: split the data again"
            )
        mine = (len(network.individuals), network.input_mean.shape[-1])
        theirs = (batch.num_individuals, batch.observations.shape[-1])
        if mine != theirs:
            raise InputError(
                f"the {name} demonstrations have {theirs[0]} individuals with {theirs[1]} "
                f"observation components, the environment {mine[0]} with {mine[1]}: make them for "
                "this environment, or ask gym.make for observation='full'"
            )
        known = getattr(dataset, "individuals", None)  # of this package's datasets, if named
        placed = getattr(env, "individuals", None)  # of a VecEnv of slots
        if isinstance(known, tuple) and placed is not None and known != tuple(placed):
            raise InputError(
                f"the {name} demonstrations are of {', '.join(known)}, the environment's "
                f"individuals are {', '.join(network.individuals)}: make them for this environment"
            )
        scored = batch.action_penalties
        highest = int(batch.actions.max()) if scored is None else scored.shape[-1] - 1
        if highest >= network.num_actions:
            raise InputError(
                f"the {name} demonstrations hold action {highest}, the environment has "
                f"{network.num_actions}: make them for this environment"
            )
        scores = any(isinstance(t, ScoredActionsTemporalDifference) for t in recipe.offline)
        if scores and scored is None:
            raise InputError(
                f"the {name} demonstrations carry no penalties of all actions, which "
                f"{recipe.name} learns from offline: make the dataset with the fitted dynamics of "
                "their species"
            )
