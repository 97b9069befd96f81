"""One decision of every slot as a compiled loop, for float32 on the CPU.

The same equations as ``StackedQNetwork.step``, slot by slot; a decision through tensor operations
spends most of its time starting them.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from animarl_algos.networks.kernels.feed_forward import affine, encode, head_units
from animarl_algos.networks.kernels.gru_kernels import sigmoid_float32, tanh_float32
from animarl_algos.networks.networks import StackedQNetwork
from animarl_envs.compiling import jit


@jit(fastmath={"contract", "nsz"})
def _decide(  # type: ignore[no-untyped-def]
    observation, previous_action, hidden, q_values, flagged, sees_previous, recurrent,
    weight_1, bias_1, weight_2, bias_2,
    weight_head, bias_head, weight_value, bias_value, weight_advantage, bias_advantage,
    weight_input, weight_hidden, bias_input, bias_hidden,
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
        encode(
            observation[s, :sensed], previous_action[s], actions, sees_previous,
            weight_1[k], bias_1[k], weight_2[k], bias_2[k], first, second,
        )  # fmt: skip
        if recurrent:
            affine(from_input, second, weight_input[k], bias_input[k])
            affine(from_state, h, weight_hidden[k], bias_hidden[k])
            for j in range(2 * units):
                from_input[j] = sigmoid_float32(from_input[j] + from_state[j])
            for j in range(units):
                r, z = from_input[j], from_input[units + j]
                n = tanh_float32(from_input[2 * units + j] + r * from_state[2 * units + j])
                h[j] = n + z * (h[j] - n)
            features = h
        else:
            features = second
        head_units(features, observation[s, -1], flagged, weight_head[k], bias_head[k], head)
        affine(value, head[:units], weight_value[k], bias_value[k])
        affine(advantage, head[units:], weight_advantage[k], bias_advantage[k])
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

    def decide(
        self,
        observations: NDArray[np.float32],
        previous_actions: NDArray[np.int64],
        hidden: NDArray[np.float32],
    ) -> NDArray[np.float32]:
        """Q-values (S, actions); ``hidden`` (S, H) becomes the next state. All are C-contiguous."""
        q_values = np.empty((len(observations), self._network.num_actions), dtype=np.float32)
        _decide(
            observations,
            previous_actions,
            hidden,
            q_values,
            *self._settings,
            *self._network.weights.arrays(),
            *self._network.gru_weights.arrays(),
            *self._scratch,
        )
        return q_values
