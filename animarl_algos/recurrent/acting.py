"""One decision of every slot as a compiled loop, for float32 on the CPU.

The same equations as ``StackedQNetwork.step``, slot by slot; a decision through tensor operations
spends most of its time starting them.
"""

from __future__ import annotations

import numba as nb
import numpy as np
import torch
from numpy.typing import NDArray

from animarl_algos.recurrent.gru_kernels import sigmoid_float32, tanh_float32
from animarl_algos.recurrent.networks import StackedQNetwork

_ZERO = np.float32(0.0)
_ONE = np.float32(1.0)


@nb.njit(inline="always")
def _affine(out, inputs, weight, bias):  # type: ignore[no-untyped-def]
    for j in range(len(out)):
        out[j] = bias[0, j]
    for i in range(len(inputs)):
        for j in range(len(out)):
            out[j] += inputs[i] * weight[i, j]


@nb.njit(inline="always")
def _rectify(x):  # type: ignore[no-untyped-def]
    for j in range(len(x)):
        x[j] = max(x[j], _ZERO)


@nb.njit(cache=True, error_model="numpy", fastmath={"contract", "nsz"})
def _decide(  # type: ignore[no-untyped-def]
    observation, previous_action, hidden, q_values, flagged, sees_previous, recurrent,
    weight_1, bias_1, weight_2, bias_2,
    weight_input, weight_hidden, bias_input, bias_hidden,
    weight_head, bias_head, weight_value, bias_value, weight_advantage, bias_advantage,
    first, second, from_input, from_state, head, value, advantage,
):  # fmt: skip
    """Fill ``q_values`` (S, actions), overwrite ``hidden`` (S, H); slot s is individual s mod K."""
    slots, actions = q_values.shape
    individuals = len(weight_1)
    units = hidden.shape[1]
    quantiles = len(value)
    for s in range(slots):
        k = s % individuals
        h = hidden[s]
        sensed = observation.shape[1] - flagged
        _affine(first, observation[s, :sensed], weight_1[k], bias_1[k])
        if sees_previous and previous_action[s] < actions:
            for j in range(units):
                first[j] += weight_1[k, sensed + previous_action[s], j]
        _rectify(first)
        _affine(second, first, weight_2[k], bias_2[k])
        _rectify(second)
        if recurrent:
            _affine(from_input, second, weight_input[k], bias_input[k])
            _affine(from_state, h, weight_hidden[k], bias_hidden[k])
            for j in range(2 * units):
                from_input[j] = sigmoid_float32(from_input[j] + from_state[j])
            for j in range(units):
                r, z = from_input[j], from_input[units + j]
                n = tanh_float32(from_input[2 * units + j] + r * from_state[2 * units + j])
                h[j] = n + z * (h[j] - n)
            features = h
        else:
            features = second
        _affine(head, features, weight_head[k], bias_head[k])
        if flagged:
            for j in range(2 * units):
                head[j] += observation[s, sensed] * weight_head[k, units, j]
        _rectify(head)
        _affine(value, head[:units], weight_value[k], bias_value[k])
        _affine(advantage, head[units:], weight_advantage[k], bias_advantage[k])
        state_value = value.mean()
        centre = advantage.mean()
        for a in range(actions):
            q_values[s, a] = (
                state_value + advantage[a * quantiles : (a + 1) * quantiles].mean() - centre
            )


class CompiledActor:
    """Acts with a network on the CPU, sharing the memory of its parameters.

    Parameters
    ----------
    network
        Its parameters are read anew at every decision; they may be trained meanwhile.
    """

    def __init__(self, network: StackedQNetwork) -> None:
        units, outputs = network.units, network.num_actions * network.num_quantiles
        self._network = network
        self._parameters = self._collect()
        self._addresses: tuple[int, ...] = ()
        self._weights: list[NDArray[np.float32]] = []
        self._scratch = [
            np.empty(size, dtype=np.float32)
            for size in (
                units,
                units,
                3 * units,
                3 * units,
                2 * units,
                network.num_quantiles,
                outputs,
            )
        ]
        self._settings = (
            int(network.condition_flag),
            network.previous_action,
            network.gru is not None,
        )

    def _collect(self) -> list[torch.Tensor]:
        network, dueling = self._network, self._network.dueling
        empty = torch.zeros((0, 0, 0))
        gru = network.gru
        recurrent = (
            [gru.weight_input, gru.weight_hidden, gru.bias_input, gru.bias_hidden]
            if gru is not None
            else [empty] * 4
        )
        layers = [dueling.hidden, dueling.value, dueling.advantage]
        return [
            *(network.encoder_1.weight, network.encoder_1.bias),
            *(network.encoder_2.weight, network.encoder_2.bias),
            *recurrent,
            *(tensor for layer in layers for tensor in (layer.weight, layer.bias)),
        ]

    def decide(
        self,
        observations: NDArray[np.float32],
        previous_actions: NDArray[np.int64],
        hidden: NDArray[np.float32],
    ) -> NDArray[np.float32]:
        """Q-values (S, actions); ``hidden`` (S, H) becomes the next state. All are C-contiguous."""
        addresses = tuple([p.data_ptr() for p in self._parameters])
        if addresses != self._addresses:  # the parameters were moved, not merely changed
            self._weights = [p.detach().numpy() for p in self._parameters]
            self._addresses = addresses
        q_values = np.empty((len(observations), self._network.num_actions), dtype=np.float32)
        _decide(
            observations,
            previous_actions,
            hidden,
            q_values,
            *self._settings,
            *self._weights,
            *self._scratch,
        )
        return q_values
