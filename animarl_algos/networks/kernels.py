"""Compiled loops for float32 on the CPU: the GRU, and the last layer for one action a row.

At 32 units an update through tensor operations spends most of its time starting them; these loops
run the same equations (see :mod:`animarl_algos.networks.layers`) step by step, everything in cache,
with a product of the BLAS for all rows of a step.
"""

from collections.abc import Sequence
from typing import Any

import numba as nb
import numpy as np
import torch
from numpy.typing import NDArray

from animarl_envs.array_types import Ints
from animarl_envs.compiling import jit


def runs_compiled(tensor: torch.Tensor) -> bool:
    """Whether compiled loops (float32 on the CPU alone) can work on the tensor."""
    return tensor.dtype == torch.float32 and tensor.device.type == "cpu"


def as_arrays(*tensors: torch.Tensor) -> list[NDArray[Any]]:
    """Return contiguous arrays of the tensors, without copying those that are contiguous."""
    return [tensor.detach().contiguous().numpy() for tensor in tensors]


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


# -- the GRU's recurrence -------------------------------------------------------------------------

# tanh as a quotient of polynomials in x^2, the approximation of Eigen and XLA, within a few float32
# roundings of the true value and free of branches, so that compilers vectorise it.
_TANH_LIMIT = np.float32(7.90531110763549805)
_P1 = np.float32(4.89352455891786e-03)
_P3 = np.float32(6.37261928875436e-04)
_P5 = np.float32(1.48572235717979e-05)
_P7 = np.float32(5.12229709037114e-08)
_P9 = np.float32(-8.60467152213735e-11)
_P11 = np.float32(2.00018790482477e-13)
_P13 = np.float32(-2.76076847742355e-16)
_Q0 = np.float32(4.89352518554385e-03)
_Q2 = np.float32(2.26843463243900e-03)
_Q4 = np.float32(1.18534705686654e-04)
_Q6 = np.float32(1.19825839466702e-06)
_HALF = np.float32(0.5)
_ONE = np.float32(1.0)
_ZERO = np.float32(0.0)


@nb.njit(inline="always", error_model="numpy")
def tanh_float32(x):  # type: ignore[no-untyped-def]
    """Hyperbolic tangent of a float32."""
    x = min(max(x, -_TANH_LIMIT), _TANH_LIMIT)
    s = x * x
    p = x * (_P1 + s * (_P3 + s * (_P5 + s * (_P7 + s * (_P9 + s * (_P11 + s * _P13))))))
    return p / (_Q0 + s * (_Q2 + s * (_Q4 + s * _Q6)))


@nb.njit(inline="always", error_model="numpy")
def sigmoid_float32(x):  # type: ignore[no-untyped-def]
    """Logistic function of a float32, sigmoid(x) = (1 + tanh(x / 2)) / 2."""
    return _HALF + _HALF * tanh_float32(_HALF * x)


@jit(fastmath={"contract", "nsz"})
def _forward(gates, hidden_n, hidden, state, weight, bias, active, scratch):  # type: ignore[no-untyped-def]
    individuals, _, units = hidden.shape
    for k in range(individuals):
        start, before = 0, state[k]
        for rows in active:
            from_state = scratch[:rows]
            np.dot(before[:rows], weight[k], from_state)
            for b in range(rows):
                gate = gates[k, start + b]
                for j in range(2 * units):
                    gate[j] = sigmoid_float32(gate[j] + (from_state[b, j] + bias[k, 0, j]))
                for j in range(units):
                    h_n = from_state[b, 2 * units + j] + bias[k, 0, 2 * units + j]
                    n = tanh_float32(gate[2 * units + j] + gate[j] * h_n)
                    z = gate[units + j]
                    gate[2 * units + j] = n
                    hidden_n[k, start + b, j] = h_n
                    hidden[k, start + b, j] = n + z * (before[b, j] - n)
            before = hidden[k, start : start + rows]
            start += rows


@jit(fastmath={"contract", "nsz"})
def _backward(  # type: ignore[no-untyped-def]
    grad_hidden,
    gates,
    hidden_n,
    hidden,
    state,
    weight_back,
    active,
    grad_gates,
    grad_from_state,
    carried,
    scratch,
):
    individuals, end_of_all, units = hidden.shape
    for k in range(individuals):
        end = end_of_all
        for t in range(len(active) - 1, -1, -1):
            rows = active[t]
            start = end - rows
            start_before = start - active[t - 1] if t > 0 else 0
            for b in range(rows):
                row = start + b
                before = state[k, b] if t == 0 else hidden[k, start_before + b]
                to_gate, to_state = grad_gates[k, row], grad_from_state[k, row]
                for j in range(units):
                    r = gates[k, row, j]
                    z = gates[k, row, units + j]
                    n = gates[k, row, 2 * units + j]
                    total = grad_hidden[k, row, j] + carried[k, b, j]
                    d_n = total * (_ONE - z) * (_ONE - n * n)
                    d_r = d_n * hidden_n[k, row, j] * r * (_ONE - r)
                    d_z = total * (before[j] - n) * z * (_ONE - z)
                    to_gate[j] = to_state[j] = d_r
                    to_gate[units + j] = to_state[units + j] = d_z
                    to_gate[2 * units + j] = d_n
                    to_state[2 * units + j] = d_n * r
                    carried[k, b, j] = total * z
            np.dot(grad_from_state[k, start:end], weight_back[k], scratch[:rows])
            for b in range(rows):
                for j in range(units):
                    carried[k, b, j] += scratch[b, j]
            end = start


def gru(
    inputs: torch.Tensor,
    state: torch.Tensor,
    weights: Sequence[torch.Tensor],
    active: Ints,
    previous: torch.Tensor | None,
) -> torch.Tensor:
    """Hidden states (K, row, H) of K GRUs over packed sequences, float32 on the CPU.

    ``inputs`` are (K, row, I), ``state`` (K, batch, H) before the first step; ``weights`` of input
    and state are (K, I, 3H) and (K, H, 3H), then the biases (K, 1, 3H), gates in the order r, z, n.
    ``active`` (steps,) are the rows computed at each step; ``previous`` (rows - active[0],) is the
    row of the step before, for rows from the second step on, None where all rows are computed.
    """
    hidden: torch.Tensor = _GRU.apply(inputs, state, *weights, active, previous)  # type: ignore[no-untyped-call]
    return hidden


class _GRU(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any,
        inputs: torch.Tensor,
        state: torch.Tensor,
        weight_input: torch.Tensor,
        weight_hidden: torch.Tensor,
        bias_input: torch.Tensor,
        bias_hidden: torch.Tensor,
        active: Ints,
        previous: torch.Tensor | None,
    ) -> torch.Tensor:
        gates = torch.baddbmm(bias_input, inputs, weight_input)
        rows = (*gates.shape[:2], state.shape[-1])
        hidden_n, hidden = gates.new_empty(rows), gates.new_empty(rows)
        given = as_arrays(gates, hidden_n, hidden, state, weight_hidden, bias_hidden)
        _forward(*given, active, np.empty((state.shape[1], gates.shape[-1]), dtype=np.float32))
        ctx.save_for_backward(inputs, state, weight_input, weight_hidden, gates, hidden_n, hidden)
        ctx.active, ctx.previous = active, previous
        return hidden

    @staticmethod
    @torch.autograd.function.once_differentiable  # type: ignore[misc]
    def backward(ctx: Any, *grad_outputs: torch.Tensor) -> tuple[torch.Tensor | None, ...]:
        inputs, state, weight_input, weight_hidden, gates, hidden_n, hidden = ctx.saved_tensors
        grad_gates, grad_from_state = torch.empty_like(gates), torch.empty_like(gates)
        grad_state = torch.zeros_like(state, memory_format=torch.contiguous_format)
        back = weight_hidden.transpose(1, 2)
        given = as_arrays(grad_outputs[0], gates, hidden_n, hidden, state, back)
        grads = as_arrays(grad_gates, grad_from_state, grad_state)
        _backward(*given, ctx.active, *grads, np.empty(state.shape[1:], dtype=np.float32))
        first = int(ctx.active[0]) if len(ctx.active) else 0
        if ctx.previous is None:
            later = hidden[:, : hidden.shape[1] - first]
        else:
            later = hidden.index_select(1, ctx.previous)
        before = torch.cat((state[:, :first], later), dim=1)
        return (
            grad_gates @ weight_input.transpose(1, 2) if ctx.needs_input_grad[0] else None,
            grad_state if ctx.needs_input_grad[1] else None,
            inputs.transpose(1, 2) @ grad_gates,
            before.transpose(1, 2) @ grad_from_state,
            grad_gates.sum(1, keepdim=True),
            grad_from_state.sum(1, keepdim=True),
            None,
            None,
        )


# -- the last layer for one action a row ----------------------------------------------------------
#
# A quantile network has quantiles times actions outputs, but a temporal-difference error needs
# those of one action. Computing only them spares nine tenths of the layer's work.


def chosen_values(
    units: torch.Tensor,
    weight: torch.Tensor,
    bias: torch.Tensor,
    actions: torch.Tensor,
    quantiles: int,
) -> torch.Tensor:
    """``units @ weight + bias`` at the columns of each row's action, (K, row, quantiles).

    ``units`` are (K, row, units) float32, ``weight`` (K, units, actions * quantiles), ``bias``
    (K, 1, actions * quantiles), ``actions`` (K, row) int64.
    """
    values: torch.Tensor = _ChosenValues.apply(  # type: ignore[no-untyped-call]
        units, weight, bias, actions, quantiles
    )
    return values


class _ChosenValues(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any,
        units: torch.Tensor,
        weight: torch.Tensor,
        bias: torch.Tensor,
        actions: torch.Tensor,
        quantiles: int,
    ) -> torch.Tensor:
        values = units.new_empty((*units.shape[:2], quantiles))
        _forward_chosen(*as_arrays(units, weight, bias, actions, values))
        ctx.save_for_backward(units, weight, actions)
        return values

    @staticmethod
    @torch.autograd.function.once_differentiable  # type: ignore[misc]
    def backward(ctx: Any, *grad_outputs: torch.Tensor) -> tuple[torch.Tensor | None, ...]:
        units, weight, actions = ctx.saved_tensors
        weight_back = weight.transpose(1, 2).contiguous()
        grad_units = torch.zeros_like(units, memory_format=torch.contiguous_format)
        grad_weight = torch.zeros_like(weight_back)
        grad_bias = weight.new_zeros((weight.shape[0], 1, weight.shape[2]))
        _backward_chosen(
            *as_arrays(grad_outputs[0], units, weight_back, actions),
            *as_arrays(grad_units, grad_weight, grad_bias),
        )
        return grad_units, grad_weight.transpose(1, 2), grad_bias, None, None


@jit(fastmath={"contract", "nsz"})
def _forward_chosen(units, weight, bias, actions, values):  # type: ignore[no-untyped-def]
    individuals, rows, quantiles = values.shape
    for k in range(individuals):
        for n in range(rows):
            first = actions[k, n] * quantiles
            value = values[k, n]
            for q in range(quantiles):
                value[q] = bias[k, 0, first + q]
            for i in range(units.shape[2]):
                unit = units[k, n, i]
                row = weight[k, i, first : first + quantiles]
                for q in range(quantiles):
                    value[q] += unit * row[q]


@jit(fastmath={"contract", "nsz"})
def _backward_chosen(  # type: ignore[no-untyped-def]
    grad, units, weight_back, actions, grad_units, grad_weight, grad_bias
):
    """``weight_back`` and ``grad_weight`` are (K, actions * quantiles, units)."""
    individuals, rows, quantiles = grad.shape
    for k in range(individuals):
        for n in range(rows):
            first = actions[k, n] * quantiles
            unit, grad_unit = units[k, n], grad_units[k, n]
            for q in range(quantiles):
                slope = grad[k, n, q]
                if slope == _ZERO:  # padding and steps that enter no loss
                    continue
                weights, grad_weights = weight_back[k, first + q], grad_weight[k, first + q]
                for i in range(len(unit)):
                    grad_unit[i] += slope * weights[i]
                    grad_weights[i] += slope * unit[i]
                grad_bias[k, 0, first + q] += slope
