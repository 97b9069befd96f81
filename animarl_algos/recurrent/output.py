"""What a network says about a batch, worked out as far as it is asked for."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import torch

from animarl_algos.recurrent import chosen_head
from animarl_algos.recurrent.gru import Packing
from animarl_algos.values import take_action


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
    head_units : Tensor (K, row, 2H)
        The dueling head's hidden units, packed.
    head_weight, head_bias : Tensor (K, 2H, actions * quantiles), (K, 1, actions * quantiles)
        From them to the values.
    num_actions
    """

    treatment_logits: torch.Tensor | None
    features: torch.Tensor
    initial_state: torch.Tensor
    packing: Packing
    recurrent: bool
    head_units: torch.Tensor
    head_weight: torch.Tensor
    head_bias: torch.Tensor
    num_actions: int

    @property
    def num_quantiles(self) -> int:
        return self.head_weight.shape[-1] // self.num_actions

    @cached_property
    def values(self) -> torch.Tensor:
        """Quantiles of all action values, (K, T, B, actions, quantiles).

        One "quantile" where the expected value is learned.
        """
        flat = torch.baddbmm(self.head_bias, self.head_units, self.head_weight)
        padded = self.packing.unpack(flat)
        return padded.view(*padded.shape[:-1], self.num_actions, self.num_quantiles)

    @cached_property
    def q_values(self) -> torch.Tensor:
        """Expected values of all actions, (K, T, B, actions)."""
        if self.num_quantiles == 1:
            return self.values.squeeze(-1)
        weight, bias = (
            tensor.view(*tensor.shape[:-1], self.num_actions, self.num_quantiles).mean(-1)
            for tensor in (self.head_weight, self.head_bias)
        )
        return self.packing.unpack(torch.baddbmm(bias, self.head_units, weight))

    def of_actions(self, actions: torch.Tensor) -> torch.Tensor:
        """Quantiles of one action's value at each step: (K, T, B) to (K, T, B, quantiles)."""
        if self.num_quantiles == 1 or not chosen_head.usable(self.head_units):
            return take_action(self.values, actions)
        return self.packing.unpack(
            chosen_head.chosen_values(
                self.head_units,
                self.head_weight,
                self.head_bias,
                self.packing.pack(actions),
                self.num_quantiles,
            )
        )

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


def dueling_parts(values: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """State value and centred advantage of Q-values.

    The centred advantages sum to zero over actions, so V is the mean of Q over actions.

    Parameters
    ----------
    values : Tensor (..., actions, quantiles)

    Returns
    -------
    state_value : Tensor (..., quantiles)
    advantage : Tensor (..., actions, quantiles)
        A - mean over actions of A.
    """
    state_value = values.mean(-2)
    return state_value, values - state_value.unsqueeze(-2)
