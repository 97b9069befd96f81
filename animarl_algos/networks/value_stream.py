"""Between cloning and temporal differences: forget the state values, keep the policy."""

from __future__ import annotations

import torch

from animarl_algos.networks.networks import StackedQNetwork


@torch.no_grad()
def zero_value_stream(network: StackedQNetwork) -> None:
    """Set V of the dueling head to 0, which leaves the policy ``softmax Q`` as it is.

    Cloning says nothing about V, as it adds the same to all actions: -100 has been seen. Temporal
    differences begun from there spend themselves on V and spoil the policy, so call this before the
    first one after cloning.
    """
    value = network.dueling.value
    value.weight.zero_()
    value.bias.zero_()
