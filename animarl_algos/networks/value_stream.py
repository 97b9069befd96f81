"""Between cloning and learning online: what the dueling head's values begin as."""

from __future__ import annotations

import torch

from animarl_algos.networks.networks import StackedQNetwork
from animarl_algos.networks.policies import GruPolicy


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


@torch.no_grad()
def into_logits(policy: GruPolicy) -> None:
    """Divide the action values by the temperatures of ``policy``, which are 1 from then on.

    It acts as before: ``softmax Q``, for learners to whom action values are the policy's logits.
    Individuals that share a network are divided by the mean of their temperatures.
    """
    fitted = torch.tensor(policy.acting.temperature).view(-1, 1, 1)
    if policy.q_net.shared:
        fitted = fitted.mean(0, keepdim=True)
    for network in (policy.q_net, policy.q_net_target):
        for layer in (network.dueling.value, network.dueling.advantage):
            for parameter in (layer.weight, layer.bias):
                parameter.div_(fitted.to(parameter))
    policy.temperature = 1.0
