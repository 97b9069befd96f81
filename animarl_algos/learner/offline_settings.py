"""How the offline phase draws its minibatches, steps, and what it keeps."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from animarl_algos.ranges import (
    COUNT_OR_NONE,
    NOT_NEGATIVE,
    POSITIVE_OR_NONE,
    WHOLE,
    Range,
    refuse_unknown,
)
from animarl_envs.errors import InputError


@dataclass(frozen=True, kw_only=True)
class OfflineSettings:
    """Settings of the offline phase beside its length, rate and loss; the defaults are the paper's.

    Attributes
    ----------
    sequence_length
        None: minibatches of whole episodes, each once an epoch. A number: of windows of so many
        steps, drawn independently with replacement; 1 for networks without a memory.
    burn_in
        Steps before each window that only rebuild the memory.
    updates_per_epoch
        Updates between two looks at the validation split; by default one pass over the steps.
        The offline phase is ``offline_epochs`` times as long.
    passes_per_epoch
        With ``updates_per_epoch``: no more of them than are so many passes over the steps. Few
        demonstrations are known by heart before many updates are over.
    warm_up
        Updates over which the learning rate rises linearly to ``offline_learning_rate``.
    anneal
        Whether it then falls to 0 over the whole phase, as half a cosine (Loshchilov & Hutter
        2017).
    weight_decay
        Share of each weight that an update takes away, per unit of the learning rate (decoupled,
        as in AdamW: Loshchilov & Hutter 2019).
    average
        Largest decay d of the moving average of the weights, ``min(d, (1 + t) / (10 + t))`` after t
        updates, which then is what is validated, kept and used; 0: the weights themselves.
    standardise
        Whether observations are standardised by the mean and sd of the training split within the
        network.

    Raises
    ------
    InputError
        If a number is out of its range, or one makes another useless.
    """

    sequence_length: int | None = None
    burn_in: int = 0
    updates_per_epoch: int | None = None
    passes_per_epoch: float | None = None
    warm_up: int = 0
    anneal: bool = False
    weight_decay: float = 0.0
    average: float = 0.0
    standardise: bool = False

    def __post_init__(self) -> None:
        ranges = {
            "sequence_length": COUNT_OR_NONE,
            "burn_in": WHOLE,
            "updates_per_epoch": COUNT_OR_NONE,
            "passes_per_epoch": POSITIVE_OR_NONE,
            "warm_up": WHOLE,
            "weight_decay": NOT_NEGATIVE,
            "average": Range(most=1.0 - 1e-9),
        }
        for name, numbers in ranges.items():
            checked = numbers.check(f"offline_kwargs: {name}", getattr(self, name))
            object.__setattr__(self, name, checked)
        for name in ("anneal", "standardise"):
            if not isinstance(getattr(self, name), bool):
                raise InputError(
                    f"offline_kwargs: {name} is {getattr(self, name)!r}: give true or false"
                )
        if self.sequence_length is None and (self.burn_in or self.updates_per_epoch):
            raise InputError(
                "offline_kwargs: burn_in and updates_per_epoch are for windows: give "
                "sequence_length, or leave them out for whole episodes"
            )
        if self.passes_per_epoch is not None and self.updates_per_epoch is None:
            raise InputError(
                "offline_kwargs: passes_per_epoch limits updates_per_epoch: give both, or neither"
            )

    @classmethod
    def of(cls, given: Mapping[str, Any]) -> OfflineSettings:
        """From a learner's ``offline_kwargs``.

        Raises
        ------
        InputError
            If one is unknown, too.
        """
        refuse_unknown("offline_kwargs", given, cls)
        return cls(**given)

    def updates(self, steps: int, batch_size: int) -> int:
        """Updates in an epoch with minibatches of windows of a split that has so many steps."""
        assert self.sequence_length is not None
        whole_pass = steps / (batch_size * self.sequence_length)
        asked = whole_pass if self.updates_per_epoch is None else self.updates_per_epoch
        if self.passes_per_epoch is not None:
            asked = min(asked, self.passes_per_epoch * whole_pass)
        return max(1, round(asked))

    def rate_factor(self, update: int, updates: int) -> float:
        """Factor of the learning rate at an update (the first is 0) of so many."""
        factor = min(1.0, (update + 1) / self.warm_up) if self.warm_up else 1.0
        if self.anneal:
            factor *= 0.5 * (1.0 + math.cos(math.pi * update / updates))
        return factor

    def average_decay(self, updates: int) -> float:
        """Decay of the moving average after so many updates."""
        return min(self.average, (1 + updates) / (10 + updates))
