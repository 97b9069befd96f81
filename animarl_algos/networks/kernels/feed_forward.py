"""The feed-forward network on a small batch, as one operation for float32 on the CPU.

The equations of :mod:`animarl_algos.networks.networks` without the GRU, row by row, forwards and
backwards. As some forty tensor operations an update on 32 transitions spends most of its time
starting them; where there are many rows, matrix products are faster.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numba as nb
import numpy as np
import torch
from numpy.typing import NDArray

from animarl_algos.networks.kernels import runs_compiled
from animarl_envs.compiling import jit

MOST_ROWS = 256
"""Rows (of all individuals together) up to which these loops are the faster way."""

_ZERO = np.float32(0.0)
_FASTMATH = {"contract", "nsz", "reassoc"}


def usable(rows: torch.Tensor) -> bool:
    """Whether these loops can compute ``rows`` (K, row, n) and are the faster way.

    They give no gradient with respect to the rows themselves.
    """
    few = rows.shape[0] * rows.shape[1] <= MOST_ROWS
    return few and runs_compiled(rows) and not rows.requires_grad


class WeightViews:
    """The memory of parameters as NumPy arrays, looked up anew when parameters are moved."""

    def __init__(self, parameters: Sequence[torch.Tensor]) -> None:
        self.parameters = tuple(parameters)
        self._addresses: tuple[int, ...] = ()
        self._arrays: tuple[NDArray[np.float32], ...] = ()

    def arrays(self) -> tuple[NDArray[np.float32], ...]:
        """Return the present values without copying them."""
        addresses = tuple([p.data_ptr() for p in self.parameters])
        if addresses != self._addresses:
            self._arrays = tuple(p.detach().numpy() for p in self.parameters)
            self._addresses = addresses
        return self._arrays


def features_and_values(
    observations: torch.Tensor,
    previous_actions: torch.Tensor,
    weights: WeightViews,
    num_actions: int,
    *,
    flagged: bool,
    sees_previous: bool,
) -> tuple[torch.Tensor, torch.Tensor]:
    """Encoded observations (K, row, H) and values of all actions (K, row, actions, quantiles).

    ``observations`` are (K, row, n), ``previous_actions`` (K, row) int64; ``weights`` are weight
    and bias of both encoder layers, the dueling head's hidden layer, value and advantage.
    ``flagged`` says whether the last observation component bypasses the encoder.
    """
    settings = (num_actions, int(flagged), sees_previous)
    outputs: tuple[torch.Tensor, torch.Tensor] = _FeedForward.apply(  # type: ignore[no-untyped-call]
        observations, previous_actions, weights, settings, *weights.parameters
    )
    return outputs


class _FeedForward(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any,
        observations: torch.Tensor,
        previous_actions: torch.Tensor,
        weights: WeightViews,
        settings: tuple[int, int, bool],
        *parameters: torch.Tensor,
    ) -> tuple[torch.Tensor, torch.Tensor]:
        arrays, (num_actions, flagged, sees_previous) = weights.arrays(), settings
        inputs = observations.contiguous().numpy(), previous_actions.contiguous().numpy()
        rows = inputs[0].shape[:2]
        units, quantiles = arrays[2].shape[-1], arrays[6].shape[-1]
        first, second, head = (
            np.empty((*rows, width), dtype=np.float32) for width in (units, units, 2 * units)
        )
        values = np.empty((*rows, num_actions, quantiles), dtype=np.float32)
        layers: list[Any] = [*inputs, flagged, sees_previous, *arrays, first, second, head]
        _forward(values, *layers)
        ctx.save_for_backward(*parameters)  # refuses parameters that were changed meanwhile
        ctx.layers, ctx.weights = layers, arrays
        return torch.from_numpy(second), torch.from_numpy(values)

    @staticmethod
    @torch.autograd.function.once_differentiable  # type: ignore[misc]
    def backward(ctx: Any, *grad_outputs: torch.Tensor) -> tuple[torch.Tensor | None, ...]:
        _ = ctx.saved_tensors
        slopes = [gradient.contiguous().numpy() for gradient in grad_outputs]
        gradients = [np.zeros_like(weight) for weight in ctx.weights]
        _backward(*slopes, *ctx.layers, *gradients)
        return None, None, None, None, *map(torch.from_numpy, gradients)


@nb.njit(inline="always")
def affine(out, inputs, weight, bias):  # type: ignore[no-untyped-def]
    """``out = inputs @ weight + bias[0]`` for one row, four inputs at once to load ``out`` less."""
    for j in range(len(out)):
        out[j] = bias[0, j]
    fours = len(inputs) // 4 * 4
    for i in range(0, fours, 4):
        a, b, c, d = inputs[i], inputs[i + 1], inputs[i + 2], inputs[i + 3]
        for j in range(len(out)):
            out[j] += (
                a * weight[i, j]
                + b * weight[i + 1, j]
                + c * weight[i + 2, j]
                + d * weight[i + 3, j]
            )
    for i in range(fours, len(inputs)):
        for j in range(len(out)):
            out[j] += inputs[i] * weight[i, j]


@nb.njit(inline="always")
def rectify(x):  # type: ignore[no-untyped-def]
    """``x = relu(x)`` for one row."""
    for j in range(len(x)):
        x[j] = max(x[j], _ZERO)


@nb.njit(inline="always")
def encode(  # type: ignore[no-untyped-def]
    observation, previous_action, num_actions, sees_previous,
    weight_1, bias_1, weight_2, bias_2, first, second,
):  # fmt: skip
    """Both encoder layers for one row."""
    affine(first, observation, weight_1, bias_1)
    if sees_previous and previous_action < num_actions:
        for j in range(len(first)):
            first[j] += weight_1[len(observation) + previous_action, j]
    rectify(first)
    affine(second, first, weight_2, bias_2)
    rectify(second)


@nb.njit(inline="always")
def head_units(features, flag, flagged, weight, bias, head):  # type: ignore[no-untyped-def]
    """The dueling head's hidden layer for one row; the treatment flag is its last input."""
    affine(head, features, weight, bias)
    if flagged:
        for j in range(len(head)):
            head[j] += flag * weight[len(features), j]
    rectify(head)


@jit(fastmath=_FASTMATH)
def _forward(  # type: ignore[no-untyped-def]
    values, observations, previous_actions, flagged, sees_previous,
    weight_1, bias_1, weight_2, bias_2,
    weight_head, bias_head, weight_value, bias_value, weight_advantage, bias_advantage,
    first, second, head,
):  # fmt: skip
    """Fill the three hidden layers' outputs and ``values`` (K, row, actions, quantiles)."""
    individuals, rows, actions, quantiles = values.shape
    units = second.shape[2]
    sensed = observations.shape[2] - flagged
    value = np.empty(quantiles, dtype=np.float32)
    advantage = np.empty(actions * quantiles, dtype=np.float32)
    for k in range(individuals):
        for n in range(rows):
            observation = observations[k, n]
            encode(
                observation[:sensed], previous_actions[k, n], actions, sees_previous,
                weight_1[k], bias_1[k], weight_2[k], bias_2[k], first[k, n], second[k, n],
            )  # fmt: skip
            h = head[k, n]
            flag = observation[-1]
            head_units(second[k, n], flag, flagged, weight_head[k], bias_head[k], h)
            affine(value, h[:units], weight_value[k], bias_value[k])
            affine(advantage, h[units:], weight_advantage[k], bias_advantage[k])
            for q in range(quantiles):
                centre = _ZERO
                for a in range(actions):
                    centre += advantage[a * quantiles + q]
                shift = value[q] - centre / np.float32(actions)
                for a in range(actions):
                    values[k, n, a, q] = advantage[a * quantiles + q] + shift


@nb.njit(inline="always")
def _affine_back(slope, inputs, weight, grad_inputs, grad_weight, grad_bias):  # type: ignore[no-untyped-def]
    """Gradients of :func:`affine`; ``grad_inputs`` is overwritten, the others are added to."""
    for j in range(len(slope)):
        grad_bias[0, j] += slope[j]
    for i in range(len(inputs)):
        total = _ZERO
        for j in range(len(slope)):
            total += slope[j] * weight[i, j]
            grad_weight[i, j] += inputs[i] * slope[j]
        grad_inputs[i] = total


@nb.njit(inline="always")
def _rectify_back(slope, output):  # type: ignore[no-untyped-def]
    for j in range(len(slope)):
        slope[j] = slope[j] if output[j] > _ZERO else _ZERO


@jit(fastmath=_FASTMATH)
def _backward(  # type: ignore[no-untyped-def]
    grad_features, grad_values, observations, previous_actions, flagged, sees_previous,
    weight_1, bias_1, weight_2, bias_2,
    weight_head, bias_head, weight_value, bias_value, weight_advantage, bias_advantage,
    first, second, head,
    to_weight_1, to_bias_1, to_weight_2, to_bias_2,
    to_weight_head, to_bias_head, to_weight_value, to_bias_value,
    to_weight_advantage, to_bias_advantage,
):  # fmt: skip
    """Add to the gradients ``to_...`` of the parameters; rows without a slope cost nothing."""
    individuals, rows, actions, quantiles = grad_values.shape
    units = second.shape[2]
    sensed = observations.shape[2] - flagged
    to_value = np.empty(quantiles, dtype=np.float32)
    to_advantage = np.empty(actions * quantiles, dtype=np.float32)
    to_head = np.empty(2 * units, dtype=np.float32)
    to_second = np.empty(units, dtype=np.float32)
    to_first = np.empty(units, dtype=np.float32)
    nothing = np.empty(sensed, dtype=np.float32)
    for k in range(individuals):
        for n in range(rows):
            if not (grad_values[k, n].any() or grad_features[k, n].any()):
                continue
            for q in range(quantiles):
                total = _ZERO
                for a in range(actions):
                    total += grad_values[k, n, a, q]
                to_value[q] = total
                for a in range(actions):
                    centred = grad_values[k, n, a, q] - total / np.float32(actions)
                    to_advantage[a * quantiles + q] = centred
            h = head[k, n]
            _affine_back(
                to_value, h[:units], weight_value[k],
                to_head[:units], to_weight_value[k], to_bias_value[k],
            )  # fmt: skip
            _affine_back(
                to_advantage, h[units:], weight_advantage[k],
                to_head[units:], to_weight_advantage[k], to_bias_advantage[k],
            )  # fmt: skip
            _rectify_back(to_head, h)
            _affine_back(
                to_head, second[k, n], weight_head[k],
                to_second, to_weight_head[k], to_bias_head[k],
            )  # fmt: skip
            if flagged:
                for j in range(2 * units):
                    to_weight_head[k, units, j] += observations[k, n, sensed] * to_head[j]
            for j in range(units):
                to_second[j] += grad_features[k, n, j]
            _rectify_back(to_second, second[k, n])
            _affine_back(
                to_second, first[k, n], weight_2[k], to_first, to_weight_2[k], to_bias_2[k]
            )
            _rectify_back(to_first, first[k, n])
            _affine_back(
                to_first, observations[k, n, :sensed], weight_1[k],
                nothing, to_weight_1[k], to_bias_1[k],
            )  # fmt: skip
            if sees_previous and previous_actions[k, n] < actions:
                for j in range(units):
                    to_weight_1[k, sensed + previous_actions[k, n], j] += to_first[j]
