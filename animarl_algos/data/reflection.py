"""Minibatches seen in a mirror: an animal that turns left there turns right here."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray

from animarl_algos.replay.batch import SequenceBatch
from animarl_envs.errors import InputError


class Mirror(Protocol):
    """How observations and actions look in a mirror; see ``animarl_envs.worlds.mirror``."""

    @property
    def order(self) -> ArrayLike: ...

    @property
    def sign(self) -> ArrayLike: ...

    @property
    def actions(self) -> ArrayLike: ...


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
        """From a world's mirror; ``flag`` adds the condition flag, which is the same in it."""
        order, sign = np.asarray(mirror.order), np.asarray(mirror.sign)
        if flag:
            order, sign = np.append(order, len(order)), np.append(sign, 1.0)
        return cls(order, sign, np.asarray(mirror.actions))

    def observations(self, seen: NDArray[np.floating]) -> NDArray[np.floating]:
        """Mirrored observations ``(..., n)``."""
        mirrored: NDArray[np.floating] = seen[..., self.order] * self.sign
        return mirrored

    def some_of(self, batch: SequenceBatch, chosen: torch.Tensor) -> SequenceBatch:
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
