"""What a network says about a batch, worked out as far as it is asked for."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import torch

from animarl_algos.losses.values import take_action
from animarl_algos.networks.gru import Packing
from animarl_algos.networks.kernels import chosen_head
from animarl_algos.networks.kernels.compiled import runs_compiled


class Head(Protocol):
    """What the dueling head says about packed rows."""

    def values(self) -> torch.Tensor:
        """Quantiles of all action values, (K, row, actions, quantiles)."""
        ...

    def means(self) -> torch.Tensor:
        """Expected values of all actions, (K, row, actions)."""
        ...

    def of_actions(self, actions: torch.Tensor) -> torch.Tensor:
        """Quantiles of one action's value in each row: (K, row) to (K, row, quantiles)."""
        ...


@dataclass(frozen=True)
class HeadUnits:
    """A quantile network's head, known by its hidden units: of its many outputs few are asked for.

    Attributes
    ----------
    units : Tensor (K, row, 2H)
    weight, bias : Tensor (K, 2H, actions * quantiles), (K, 1, actions * quantiles)
        From them to the values.
    num_actions
    """

    units: torch.Tensor
    weight: torch.Tensor
    bias: torch.Tensor
    num_actions: int

    @property
    def num_quantiles(self) -> int:
        return self.weight.shape[-1] // self.num_actions

    def values(self) -> torch.Tensor:
        return self._per_action(torch.baddbmm(self.bias, self.units, self.weight))

    def means(self) -> torch.Tensor:
        weight, bias = (self._per_action(t).mean(-1) for t in (self.weight, self.bias))
        return torch.baddbmm(bias, self.units, weight)

    def of_actions(self, actions: torch.Tensor) -> torch.Tensor:
        if not runs_compiled(self.units):
            return take_action(self.values(), actions)
        return chosen_head.chosen_values(
            self.units, self.weight, self.bias, actions, self.num_quantiles
        )

    def _per_action(self, flat: torch.Tensor) -> torch.Tensor:
        return flat.view(*flat.shape[:-1], self.num_actions, self.num_quantiles)


@dataclass(frozen=True)
class HeadValues:
    """A head known by its values, (K, row, actions, quantiles)."""

    known: torch.Tensor

    def values(self) -> torch.Tensor:
        return self.known

    def means(self) -> torch.Tensor:
        return self.known.squeeze(-1) if self.known.shape[-1] == 1 else self.known.mean(-1)

    def of_actions(self, actions: torch.Tensor) -> torch.Tensor:
        return take_action(self.known, actions)


@dataclass(frozen=True)
class QOutput:
    """What a network says about a batch of sequences; zero where the packing computed nothing.

    Attributes
    ----------
    treatment_logits : Tensor (K, T, B) or None
        Logit of treatment 1, predicted from the hidden state through gradient reversal.
    features : Tensor (K, row, H)
        What the heads see, packed: the hidden states, without a GRU the encoded observations.
    initial_state : Tensor (K, B, H)
        Hidden state before the first step.
    packing
        Of the features.
    recurrent
        Whether the features are states.
    head
        Of the values of the packed rows.
    """

    treatment_logits: torch.Tensor | None
    features: torch.Tensor
    initial_state: torch.Tensor
    packing: Packing
    recurrent: bool
    head: Head

    @cached_property
    def values(self) -> torch.Tensor:
        """Quantiles of all action values, (K, T, B, actions, quantiles).

        One "quantile" where the expected value is learned.
        """
        return self.packing.unpack(self.head.values())

    @cached_property
    def q_values(self) -> torch.Tensor:
        """Expected values of all actions, (K, T, B, actions)."""
        return self.packing.unpack(self.head.means())

    def of_actions(self, actions: torch.Tensor) -> torch.Tensor:
        """Quantiles of one action's value at each step: (K, T, B) to (K, T, B, quantiles)."""
        return self.packing.unpack(self.head.of_actions(self.packing.pack(actions)))

    @property
    def hidden(self) -> torch.Tensor:
        """The features of each step, (K, T, B, H)."""
        return self.packing.unpack(self.features)

    @property
    def final_state(self) -> torch.Tensor:
        """Hidden state after each sequence's last valid step, (K, B, H)."""
        if not self.recurrent:
            return self.initial_state
        return self.packing.final(self.features, self.initial_state)
