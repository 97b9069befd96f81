"""The layers of the stacked networks; every parameter has a leading axis of individuals."""

from __future__ import annotations

import math
import zlib
from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from torch import nn

from animarl_algos.networks.gru import Packing, stacked_gru


def individual_generators(individuals: Sequence[str], seed: int) -> list[torch.Generator]:
    """One generator per individual, from the seed and the individual's name alone."""
    generators = []
    for name in individuals:
        words = np.random.SeedSequence([seed, zlib.crc32(name.encode())]).generate_state(2)
        generators.append(torch.Generator().manual_seed(int(words[0]) << 31 | int(words[1]) >> 1))
    return generators


def _uniform(
    shape: tuple[int, ...], bound: float, generators: list[torch.Generator]
) -> nn.Parameter:
    """(K, *shape) drawn from [-bound, bound), each individual from its own generator."""
    draws = [torch.empty(shape).uniform_(-bound, bound, generator=g) for g in generators]
    return nn.Parameter(torch.stack(draws))


class StackedLinear(nn.Module):
    """K independent affine maps; ``weight`` (K, in, out), ``bias`` (K, 1, out).

    Initialised like :class:`torch.nn.Linear`.
    """

    def __init__(self, inputs: int, outputs: int, generators: list[torch.Generator]) -> None:
        super().__init__()
        bound = 1 / math.sqrt(inputs)
        self.weight = _uniform((inputs, outputs), bound, generators)
        self.bias = _uniform((1, outputs), bound, generators)

    def forward(self, inputs: torch.Tensor) -> torch.Tensor:
        """(K, row, in) to (K, row, out)."""
        return torch.baddbmm(self.bias, inputs, self.weight)


class StackedGRU(nn.Module):
    """K independent one-layer GRUs; weights (K, in, 3H), (K, H, 3H), gates r, z, n.

    Initialised like :class:`torch.nn.GRU`.
    """

    def __init__(self, inputs: int, units: int, generators: list[torch.Generator]) -> None:
        super().__init__()
        bound = 1 / math.sqrt(units)
        self.weight_input = _uniform((inputs, 3 * units), bound, generators)
        self.weight_hidden = _uniform((units, 3 * units), bound, generators)
        self.bias_input = _uniform((1, 3 * units), bound, generators)
        self.bias_hidden = _uniform((1, 3 * units), bound, generators)

    def forward(self, inputs: torch.Tensor, state: torch.Tensor, packing: Packing) -> torch.Tensor:
        """Hidden states (K, row, H) of packed inputs (K, row, in)."""
        return stacked_gru(
            inputs,
            state,
            self.weight_input,
            self.weight_hidden,
            self.bias_input,
            self.bias_hidden,
            packing,
        )


class _FoldedDueling(torch.autograd.Function):
    """One node with its gradient in closed form; as a dozen nodes it outweighs a small update."""

    @staticmethod
    def forward(
        ctx: Any,
        value_weight: torch.Tensor,
        value_bias: torch.Tensor,
        advantage_weight: torch.Tensor,
        advantage_bias: torch.Tensor,
        num_actions: int,
    ) -> tuple[torch.Tensor, torch.Tensor]:
        individuals, units, quantiles = value_weight.shape
        ctx.shape = (individuals, -1, num_actions, quantiles)
        weight = value_weight.new_empty((individuals, 2 * units, num_actions, quantiles))
        weight[:, :units] = value_weight.unsqueeze(2)
        advantage = advantage_weight.view(ctx.shape)
        torch.sub(advantage, advantage.mean(2, keepdim=True), out=weight[:, units:])
        advantage = advantage_bias.view(ctx.shape)
        bias = advantage - advantage.mean(2, keepdim=True) + value_bias.unsqueeze(2)
        return weight.flatten(2), bias.flatten(2)

    @staticmethod
    @torch.autograd.function.once_differentiable  # type: ignore[misc]
    def backward(ctx: Any, *grad_outputs: torch.Tensor) -> tuple[torch.Tensor | None, ...]:
        # V enters every action alike; centring is its own transpose.
        weight, bias = (gradient.reshape(ctx.shape) for gradient in grad_outputs)
        to_value, to_advantage = weight.chunk(2, dim=1)
        return (
            to_value.sum(2),
            bias.sum(2),
            (to_advantage - to_advantage.mean(2, keepdim=True)).flatten(2),
            (bias - bias.mean(2, keepdim=True)).flatten(2),
            None,
        )


class DuelingHead(nn.Module):
    """Q = V + A - mean over actions of A, per quantile.

    V and A each have a hidden layer of their own (``hidden`` holds V's units first, then A's). The
    combination is linear in those units, so it is folded into one weight matrix instead of being
    spelt out for every row. With ``units`` 0 there is no hidden layer: V and A are both linear in
    the inputs.
    """

    def __init__(
        self,
        inputs: int,
        units: int,
        num_actions: int,
        num_quantiles: int,
        generators: list[torch.Generator],
    ) -> None:
        super().__init__()
        self.num_actions = num_actions
        self.num_quantiles = num_quantiles
        self.hidden = StackedLinear(inputs, 2 * units, generators) if units else None
        read = units or inputs
        self.value = StackedLinear(read, num_quantiles, generators)
        self.advantage = StackedLinear(read, num_actions * num_quantiles, generators)

    def combined(self) -> tuple[torch.Tensor, torch.Tensor]:
        """Weight (K, 2H, actions * quantiles) and bias (K, 1, same) from hidden units to Q.

        Without a hidden layer the weight is (K, inputs, actions * quantiles).
        """
        value, advantage = self.value, self.advantage
        if self.hidden is None:
            return self._sum(value.weight, advantage.weight), self._sum(value.bias, advantage.bias)
        folded: tuple[torch.Tensor, torch.Tensor] = _FoldedDueling.apply(  # type: ignore[no-untyped-call]
            value.weight, value.bias, advantage.weight, advantage.bias, self.num_actions
        )
        return folded

    def _sum(self, value: torch.Tensor, advantage: torch.Tensor) -> torch.Tensor:
        """V + A - mean over actions of A, of weights or biases: (K, in, Q), (K, in, A Q)."""
        shaped = advantage.view(*advantage.shape[:2], self.num_actions, self.num_quantiles)
        summed: torch.Tensor = shaped - shaped.mean(2, keepdim=True) + value.unsqueeze(2)
        return summed.flatten(2)

    def units(self, inputs: torch.Tensor) -> torch.Tensor:
        """Hidden units (K, row, 2H), V's first; without a hidden layer the inputs."""
        return inputs if self.hidden is None else torch.relu(self.hidden(inputs))
