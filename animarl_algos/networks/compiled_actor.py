"""One decision of every slot as a compiled loop, for float32 on the CPU.

The same equations as ``StackedQNetwork.step``, slot by slot; a decision through tensor operations
spends most of its time starting them.
"""

from __future__ import annotations

import numba as nb
import numpy as np
from numpy.typing import NDArray

from animarl_algos.networks.kernels import sigmoid_float32, tanh_float32
from animarl_algos.networks.networks import StackedQNetwork
from animarl_envs.compiling import jit

_ZERO = np.float32(0.0)


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
def head_units(features, flag, flagged, weight, bias, head):  # type: ignore[no-untyped-def]
    """The dueling head's hidden layer for one row; the treatment flag is its last input."""
    affine(head, features, weight, bias)
    if flagged:
        for j in range(len(head)):
            head[j] += flag * weight[len(features), j]
    rectify(head)


@jit(fastmath={"contract", "nsz"})
def _decide(  # type: ignore[no-untyped-def]
    observation, previous_action, hidden, q_values,
    settings, statistics, encoder_weights, encoder_biases, dueling, gru, scratch,
):  # fmt: skip
    """Fill ``q_values`` (S, actions), overwrite ``hidden`` (S, H); slot s is individual s mod K.

    Where the previous action is below zero, values are zero and the hidden state stays.
    """
    flagged, sees_previous, recurrent, skip, hidden_head = settings
    mean, sd, limit = statistics
    weight_head, bias_head, weight_value, bias_value, weight_advantage, bias_advantage = dueling
    weight_input, weight_hidden, bias_input, bias_hidden = gru
    inputs, first, second, from_input, from_state, seen, head, value, advantage = scratch
    slots, actions = q_values.shape
    individuals = len(mean)
    units = hidden.shape[1]
    quantiles = len(value)
    for s in range(slots):
        if previous_action[s] < 0:
            q_values[s] = 0.0
            continue
        k = s % individuals
        h = hidden[s]
        for i in range(len(inputs)):
            scaled = (observation[s, i] - mean[k, i]) / sd[k, i]
            if scaled > limit[k, 0]:
                scaled = limit[k, 0]
            elif scaled < -limit[k, 0]:
                scaled = -limit[k, 0]
            inputs[i] = scaled
        encoded, other = first, second
        affine(encoded, inputs, encoder_weights[0][k], encoder_biases[0][k])
        if sees_previous and previous_action[s] < actions:
            for j in range(units):
                encoded[j] += encoder_weights[0][k, len(inputs) + previous_action[s], j]
        rectify(encoded)
        for layer in range(1, len(encoder_weights)):
            affine(other, encoded, encoder_weights[layer][k], encoder_biases[layer][k])
            rectify(other)
            encoded, other = other, encoded
        if recurrent:
            affine(from_input, encoded, weight_input[k], bias_input[k])
            affine(from_state, h, weight_hidden[k], bias_hidden[k])
            for j in range(2 * units):
                from_input[j] = sigmoid_float32(from_input[j] + from_state[j])
            for j in range(units):
                r, z = from_input[j], from_input[units + j]
                n = tanh_float32(from_input[2 * units + j] + r * from_state[2 * units + j])
                h[j] = n + z * (h[j] - n)
            seen[len(seen) - units :] = h
            if skip:
                seen[:units] = encoded
        else:
            seen[:] = encoded
        if hidden_head:
            head_units(seen, observation[s, -1], flagged, weight_head[k], bias_head[k], head)
            affine(value, head[:units], weight_value[k], bias_value[k])
            affine(advantage, head[units:], weight_advantage[k], bias_advantage[k])
        else:
            head[: len(seen)] = seen
            read = len(seen)
            flag = observation[s, -1]
            if flagged and flag != 0:  # else the rest of the head's inputs is zero
                head[read] = flag
                for j in range(read):
                    head[read + 1 + j] = flag * seen[j]
                read = len(head)
            affine(value, head[:read], weight_value[k], bias_value[k])
            affine(advantage, head[:read], weight_advantage[k], bias_advantage[k])
        state_value = value.mean()
        centre = advantage.mean()
        for a in range(actions):
            q_values[s, a] = (
                state_value + advantage[a * quantiles : (a + 1) * quantiles].mean() - centre
            )


class CompiledActor:
    """Acts with a network on the CPU, sharing the memory of its parameters.

    They are read anew at every decision and may be trained meanwhile.
    """

    def __init__(self, network: StackedQNetwork) -> None:
        units, quantiles = network.units, network.num_quantiles
        hidden_head = network.dueling.hidden is not None
        seen = units * (1 + network.skip)
        gated = seen + network.flag_in_head * (1 + seen)
        head = 2 * units if hidden_head else gated
        sizes = (
            *(network.sensed, units, units, 3 * units, 3 * units),
            *(seen, head, quantiles, network.num_actions * quantiles),
        )
        self._network = network
        self._scratch = tuple([np.empty(size, dtype=np.float32) for size in sizes])
        self._settings = (
            int(network.flag_in_head),
            network.previous_action,
            network.gru is not None,
            network.skip,
            hidden_head,
        )

    def decide(
        self,
        observations: NDArray[np.float32],
        previous_actions: NDArray[np.int64],
        hidden: NDArray[np.float32],
    ) -> NDArray[np.float32]:
        """Q-values (S, actions); ``hidden`` (S, H) becomes the next state. All are C-contiguous."""
        q_values = np.empty((len(observations), self._network.num_actions), dtype=np.float32)
        weights, layers = self._network.weights.arrays(), 2 * self._network.depth
        _decide(
            *(observations, previous_actions, hidden, q_values),
            *(self._settings, self._network.input_statistics()),
            *(weights[0:layers:2], weights[1:layers:2]),
            *(weights[layers : layers + 6], weights[layers + 6 :], self._scratch),
        )
        return q_values
