"""Layers of the stacked networks: linear maps, GRUs, dueling heads, dropout, packed sequences.

Every parameter has a leading axis of individuals and is stored (individual, in, out). The GRU's
equations are PyTorch's, per individual, with x the input and h the hidden state::

    r = sigmoid(x W_ir + b_ir + h W_hr + b_hr)
    z = sigmoid(x W_iz + b_iz + h W_hz + b_hz)
    n = tanh(x W_in + b_in + r (h W_hn + b_hn))
    h' = (1 - z) n + z h
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from animarl_algos.networks.kernels import gru, runs_compiled
from animarl_envs.array_types import Ints


@dataclass(frozen=True)
class Packing:
    """Which rows of a padded (time, batch) rectangle are computed.

    At step t these are the first ``active[t]`` rows of the batch, the same for every individual.
    Nothing but padding is left out, and little is left in if rows are sorted by decreasing length;
    in any other order the result is the same and only the saving smaller.
    """

    time: int
    batch: int
    active: Ints  # (steps,), rows of each step, not increasing; others have none
    lengths: Ints | None  # (individuals or 1, batch), valid steps; None: all
    device: torch.device  # where the index tensors live

    @classmethod
    @lru_cache(maxsize=64)
    def full(cls, time: int, batch: int, device: torch.device | str = "cpu") -> Packing:
        """Every row of every step."""
        return cls(time, batch, np.full(time, batch, dtype=np.int64), None, torch.device(device))

    @classmethod
    def from_lengths(
        cls, lengths: NDArray[Any], time: int, device: torch.device | str = "cpu"
    ) -> Packing:
        """Return the rows that sequences of these lengths fill; lengths (batch,) or (K, batch)."""
        lengths = np.atleast_2d(np.asarray(lengths, dtype=np.int64))
        # A row is computed while it or a later one still runs: running maximum from the right.
        reach = np.maximum.accumulate(lengths.max(axis=0)[::-1])[::-1]
        active = np.searchsorted(-reach, -np.arange(time), side="left").astype(np.int64)
        return cls(time, lengths.shape[1], active[active > 0], lengths, torch.device(device))

    @cached_property
    def offsets(self) -> Ints:
        """Packed row of each step's first batch row; the last entry is the number of rows."""
        return np.concatenate(([0], np.cumsum(self.active)))

    @cached_property
    def is_full(self) -> bool:
        """Whether no row is padding."""
        return int(self.offsets[-1]) == self.time * self.batch

    @cached_property
    def rows(self) -> torch.Tensor:
        """(rows,) index of every packed row in the flattened (time * batch) rectangle."""
        steps = np.repeat(np.arange(len(self.active)), self.active)
        within = np.arange(self.offsets[-1]) - self.offsets[steps]
        return torch.from_numpy(steps * self.batch + within).to(self.device)

    @cached_property
    def previous(self) -> torch.Tensor:
        """(rows - active[0],) packed row of the step before, for rows from the second step on."""
        steps = np.repeat(np.arange(1, len(self.active)), self.active[1:])
        within = np.arange(len(steps)) + self.offsets[1] - self.offsets[steps]
        return torch.from_numpy(self.offsets[steps - 1] + within).to(self.device)

    def pack(self, padded: torch.Tensor) -> torch.Tensor:
        """(individual, time, batch, ...) to (individual, row, ...)."""
        flat = padded.flatten(1, 2)
        return flat if self.is_full else flat.index_select(1, self.rows)

    def unpack(self, packed: torch.Tensor) -> torch.Tensor:
        """(individual, row, ...) to (individual, time, batch, ...), zero where not computed."""
        individuals, _, *features = packed.shape
        if not self.is_full:
            padded = packed.new_zeros((individuals, self.time * self.batch, *features))
            packed = padded.index_copy_(1, self.rows, packed)
        return packed.view(individuals, self.time, self.batch, *features)

    def repeat_per_row(self, of_sequence: torch.Tensor) -> torch.Tensor:
        """(individual, batch, ...) of each sequence to (individual, row, ...)."""
        if self.is_full:
            return of_sequence.repeat(1, self.time, 1)
        return of_sequence.index_select(1, self.rows % self.batch)

    def final(self, hidden: torch.Tensor, state: torch.Tensor) -> torch.Tensor:
        """State after each sequence's last valid step, from hidden (K, row, H) and first state."""
        if self.lengths is None:
            return hidden[:, -self.batch :] if self.time else state
        individuals, _, units = hidden.shape
        lengths = np.broadcast_to(self.lengths, (individuals, self.batch))
        last = self.offsets[np.maximum(lengths - 1, 0)] + np.arange(self.batch)
        last = np.where(lengths > 0, last, 0)
        index = torch.from_numpy(last).to(self.device)[..., None].expand(-1, -1, units)
        empty = torch.from_numpy(lengths == 0).to(self.device)[..., None]
        return torch.where(empty, state, hidden.gather(1, index))


class DropoutDraws:
    """Draws the factors of hidden units, a ``share`` of them 0.

    Each individual's come from its own generator, of ``seeds`` (whole numbers) and its name.
    """

    def __init__(self, share: float, seeds: Sequence[int], individuals: Sequence[str]) -> None:
        self.share = share
        self._generators = [
            np.random.default_rng([*seeds, zlib.crc32(name.encode())]) for name in individuals
        ]

    def masks(self, layers: int, batch: int, units: int) -> torch.Tensor | None:
        """Draw factors (layers, K, batch, units), 0 or ``1 / (1 - share)``; None if share is 0."""
        if not self.share:
            return None
        shape = (layers, batch, units)
        kept = np.stack(
            [g.random(shape, dtype=np.float32) >= self.share for g in self._generators], axis=1
        )
        return torch.from_numpy(kept).float().div_(1.0 - self.share)


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
        # The kernels' products run in it; limits of threads reach what is loaded before them.
        import scipy.linalg.cython_blas  # noqa: F401

        super().__init__()
        bound = 1 / math.sqrt(units)
        self.weight_input = _uniform((inputs, 3 * units), bound, generators)
        self.weight_hidden = _uniform((units, 3 * units), bound, generators)
        self.bias_input = _uniform((1, 3 * units), bound, generators)
        self.bias_hidden = _uniform((1, 3 * units), bound, generators)

    @property
    def weights(self) -> tuple[torch.Tensor, ...]:
        """Weights of input and state, biases of input and state."""
        return self.weight_input, self.weight_hidden, self.bias_input, self.bias_hidden

    def forward(self, inputs: torch.Tensor, state: torch.Tensor, packing: Packing) -> torch.Tensor:
        """Hidden states (K, row, H) of packed inputs (K, row, in), from (K, batch, H)."""
        active = packing.active
        if runs_compiled(inputs):
            previous = None if packing.is_full else packing.previous
            return gru(inputs, state, self.weights, active, previous)
        first, sizes = int(active[0]) if len(active) else 0, torch.from_numpy(active)
        hidden = []
        with torch.backends.cudnn.flags(enabled=False):  # whose rounding differs between runs
            for k, (weight_input, weight_hidden, *biases) in enumerate(zip(*self.weights)):
                weights = [weight_input.T, weight_hidden.T, *(bias[0] for bias in biases)]
                before = state[k : k + 1, :first].contiguous()
                one, _ = torch.gru(inputs[k], sizes, before, weights, True, 1, 0.0, False, False)
                hidden.append(one)
        return torch.stack(hidden)


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
        own_units: bool,
    ) -> tuple[torch.Tensor, torch.Tensor]:
        individuals, units, quantiles = value_weight.shape
        ctx.shape, ctx.own_units = (individuals, -1, num_actions, quantiles), own_units
        advantage = advantage_weight.view(ctx.shape)
        if own_units:  # V reads the first half of the hidden units, A the second
            weight = value_weight.new_empty((individuals, 2 * units, num_actions, quantiles))
            weight[:, :units] = value_weight.unsqueeze(2)
            torch.sub(advantage, advantage.mean(2, keepdim=True), out=weight[:, units:])
        else:
            weight = advantage - advantage.mean(2, keepdim=True) + value_weight.unsqueeze(2)
        advantage = advantage_bias.view(ctx.shape)
        bias = advantage - advantage.mean(2, keepdim=True) + value_bias.unsqueeze(2)
        return weight.flatten(2), bias.flatten(2)

    @staticmethod
    @torch.autograd.function.once_differentiable  # type: ignore[misc]
    def backward(ctx: Any, *grad_outputs: torch.Tensor) -> tuple[torch.Tensor | None, ...]:
        # V enters every action alike; centring is its own transpose.
        weight, bias = (gradient.reshape(ctx.shape) for gradient in grad_outputs)
        to_value, to_advantage = weight.chunk(2, dim=1) if ctx.own_units else (weight, weight)
        return (
            to_value.sum(2),
            bias.sum(2),
            (to_advantage - to_advantage.mean(2, keepdim=True)).flatten(2),
            (bias - bias.mean(2, keepdim=True)).flatten(2),
            None,
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
        folded: tuple[torch.Tensor, torch.Tensor] = _FoldedDueling.apply(  # type: ignore[no-untyped-call]
            value.weight,
            value.bias,
            advantage.weight,
            advantage.bias,
            self.num_actions,
            self.hidden is not None,
        )
        return folded

    def expected_values(self, inputs: torch.Tensor) -> torch.Tensor:
        """Return Q (K, row, actions) of a head without hidden layer and quantiles."""
        advantages = self.advantage(inputs)
        values: torch.Tensor = advantages - advantages.mean(-1, keepdim=True) + self.value(inputs)
        return values

    def units(self, inputs: torch.Tensor) -> torch.Tensor:
        """Hidden units (K, row, 2H), V's first; without a hidden layer the inputs."""
        return inputs if self.hidden is None else torch.relu(self.hidden(inputs))
