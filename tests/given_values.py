"""Action values that a test makes up, in the place of a network's."""

from dataclasses import dataclass

import torch

from animarl_algos.losses.values import take_action


@dataclass(frozen=True)
class GivenValues:
    """See :class:`animarl_algos.losses.terms.ActionValues`; ``values`` (K, T + 1, B, A, Q)."""

    values: torch.Tensor

    @property
    def q_values(self) -> torch.Tensor:
        return self.values.mean(-1)

    def of_actions(self, actions: torch.Tensor) -> torch.Tensor:
        return take_action(self.values, actions)
