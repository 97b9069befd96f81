"""One individual's network and the losses of its values, by their equations, as plain functions."""

import torch
from torch.nn import functional

from animarl_algos.networks.networks import StackedQNetwork

Weights = dict[str, torch.Tensor]


def layer(weights: Weights, name: str, inputs: torch.Tensor) -> torch.Tensor:
    return inputs @ weights[f"{name}.weight"] + weights[f"{name}.bias"][0]


def run_network(
    net: StackedQNetwork,
    weights: Weights,
    observations: torch.Tensor,
    previous: list[int],
    state: torch.Tensor,
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Values ``(T, A, Q)``, memories after each of T observations, features ``(T, H)``."""
    units, actions = net.units, net.num_actions
    inputs = observations[:, : net.sensed]
    if net.previous_action:
        one_hot = torch.eye(actions + 1, dtype=torch.float64)[previous][:, :actions]
        inputs = torch.cat([inputs, one_hot], dim=1)
    encoded = torch.relu(layer(weights, "encoder_1", inputs))
    features = torch.relu(layer(weights, "encoder_2", encoded))
    states = state.expand(len(features), -1)
    if net.recurrent:
        remembered = []
        for row in features:
            given = row @ weights["gru.weight_input"] + weights["gru.bias_input"][0]
            own = state @ weights["gru.weight_hidden"] + weights["gru.bias_hidden"][0]
            reset, keep = torch.sigmoid(given[: 2 * units] + own[: 2 * units]).chunk(2)
            new = torch.tanh(given[2 * units :] + reset * own[2 * units :])
            state = (1 - keep) * new + keep * state
            remembered.append(state)
        features = states = torch.stack(remembered)
    flag = observations[:, net.sensed :]  # empty without one
    hidden = torch.relu(layer(weights, "dueling.hidden", torch.cat([features, flag], dim=1)))
    value = layer(weights, "dueling.value", hidden[:, :units]).unsqueeze(1)
    advantage = layer(weights, "dueling.advantage", hidden[:, units:])
    advantage = advantage.view(len(hidden), actions, -1)
    return value + advantage - advantage.mean(1, keepdim=True), states, features


def td_loss(value: torch.Tensor, target: torch.Tensor) -> torch.Tensor:
    """Squared error of one number, quantile Huber loss of several."""
    if len(value) == 1:
        return (target - value).square().sum()
    tau = (torch.arange(len(value)) + 0.5) / len(value)
    delta = target[None, :] - value[:, None]
    huber = torch.where(delta.abs() <= 1, 0.5 * delta**2, delta.abs() - 0.5)
    return ((tau[:, None] - (delta < 0).double()).abs() * huber).sum(0).mean()


def treatment_loss(
    weights: Weights, features: torch.Tensor, condition: float, reversal: float
) -> torch.Tensor:
    """Through the reversal: the value of ``features``, minus their gradient."""
    inputs = (1 + reversal) * features.detach() - reversal * features
    logit = layer(weights, "treatment.2", torch.relu(layer(weights, "treatment.0", inputs)))
    return functional.binary_cross_entropy_with_logits(logit, torch.full_like(logit, condition))
