"""K independent recurrent dueling Q-networks, one per individual, held as stacked parameters.

Architecture (the paper, "Neural network architectures"), all of H = 32 units, for each individual::

    x = relu(Linear(relu(Linear([observation, one-hot previous action]))))
    h = GRU(x, h)                                     left out in the feed-forward twin
    V = Linear(relu(Linear([h, c])))                  c, the treatment flag, where there is one
    A = Linear(relu(Linear([h, c])))
    Q = V + A - mean over actions of A
    logit of c = Linear(relu(Linear(reversal(h))))    treatment head of DQCIL, 8 units

Every parameter has a leading axis of individuals; nothing is shared, so that training K individuals
together is training each alone. Axes: (individual, time, batch, feature).
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import torch
from torch import nn

from animarl_algos.gradient_reversal import reverse_gradient
from animarl_algos.recurrent import chosen_head
from animarl_algos.recurrent.gru import Packing, stacked_gru
from animarl_algos.values import take_action
from animarl_envs.errors import InputError

TREATMENT_UNITS = 8


@dataclass(frozen=True)
class QOutput:
    """What a network says about a batch of sequences; zero where the packing computed nothing.

    Attributes
    ----------
    treatment_logits : Tensor (K, T, B) or None
        Logit of treatment 1, predicted from the hidden state through gradient reversal.
    features : Tensor (K, row, H)
        What the heads see, packed: the hidden states, without a GRU the encoded observations.
    initial_state : Tensor (K, B, H)
        Hidden state before the first step.
    packing
        Of the features.
    recurrent
        Whether the features are states.
    head_units : Tensor (K, row, 2H)
        The dueling head's hidden units, packed.
    head_weight, head_bias : Tensor (K, 2H, actions * quantiles), (K, 1, actions * quantiles)
        From them to the values.
    num_actions
    """

    treatment_logits: torch.Tensor | None
    features: torch.Tensor
    initial_state: torch.Tensor
    packing: Packing
    recurrent: bool
    head_units: torch.Tensor
    head_weight: torch.Tensor
    head_bias: torch.Tensor
    num_actions: int

    @property
    def num_quantiles(self) -> int:
        return self.head_weight.shape[-1] // self.num_actions

    @cached_property
    def values(self) -> torch.Tensor:
        """Quantiles of all action values, (K, T, B, actions, quantiles).

        One "quantile" where the expected value is learned.
        """
        flat = torch.baddbmm(self.head_bias, self.head_units, self.head_weight)
        padded = self.packing.unpack(flat)
        return padded.view(*padded.shape[:-1], self.num_actions, self.num_quantiles)

    @cached_property
    def q_values(self) -> torch.Tensor:
        """Expected values of all actions, (K, T, B, actions)."""
        if self.num_quantiles == 1:
            return self.values.squeeze(-1)
        weight, bias = (
            tensor.view(*tensor.shape[:-1], self.num_actions, self.num_quantiles).mean(-1)
            for tensor in (self.head_weight, self.head_bias)
        )
        return self.packing.unpack(torch.baddbmm(bias, self.head_units, weight))

    def of_actions(self, actions: torch.Tensor) -> torch.Tensor:
        """Quantiles of one action's value at each step: (K, T, B) to (K, T, B, quantiles)."""
        if self.num_quantiles == 1 or not chosen_head.usable(self.head_units):
            return take_action(self.values, actions)
        return self.packing.unpack(
            chosen_head.chosen_values(
                self.head_units,
                self.head_weight,
                self.head_bias,
                self.packing.pack(actions),
                self.num_quantiles,
            )
        )

    @property
    def hidden(self) -> torch.Tensor:
        """The features of each step, (K, T, B, H)."""
        return self.packing.unpack(self.features)

    @property
    def final_state(self) -> torch.Tensor:
        """Hidden state after each sequence's last valid step, (K, B, H)."""
        if not self.recurrent:
            return self.initial_state
        return self.packing.final(self.features, self.initial_state)


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
    spelt out for every row.
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
        self.hidden = StackedLinear(inputs, 2 * units, generators)
        self.value = StackedLinear(units, num_quantiles, generators)
        self.advantage = StackedLinear(units, num_actions * num_quantiles, generators)

    def combined(self) -> tuple[torch.Tensor, torch.Tensor]:
        """Weight (K, 2H, actions * quantiles) and bias (K, 1, same) from hidden units to Q."""
        value, advantage = self.value, self.advantage
        folded: tuple[torch.Tensor, torch.Tensor] = _FoldedDueling.apply(  # type: ignore[no-untyped-call]
            value.weight, value.bias, advantage.weight, advantage.bias, self.num_actions
        )
        return folded

    def forward(self, inputs: torch.Tensor) -> torch.Tensor:
        """(K, row, in) to (K, row, actions * quantiles)."""
        weight, bias = self.combined()
        return torch.baddbmm(bias, self.units(inputs), weight)

    def units(self, inputs: torch.Tensor) -> torch.Tensor:
        """Hidden units (K, row, 2H), V's first."""
        return torch.relu(self.hidden(inputs))


class StackedQNetwork(nn.Module):
    """Recurrent (or feed-forward) dueling Q-networks, one per named individual.

    Parameters
    ----------
    individuals
        Names, distinct. An individual's initial weights depend on its name and the seed only.
    observation_size
        Components of one flattened observation, the treatment flag included where there is one.
    num_actions
        Discrete actions; as a previous action, ``num_actions`` stands for "none yet".
    num_quantiles
        1 for expected values.
    units
        Width of every hidden layer.
    recurrent
        False leaves the GRU out; the state is then passed through untouched.
    previous_action
        Whether the previous action is an input.
    condition_flag
        Whether the last observation component is the treatment flag. It bypasses encoder and GRU
        and enters the dueling head beside the hidden state.
    treatment_head
        Whether to predict the treatment through gradient reversal (DQCIL).
    reversal
        Strength of the gradient reversal.
    seed
        Of the initial weights.
    """

    def __init__(
        self,
        individuals: Sequence[str],
        observation_size: int,
        num_actions: int,
        *,
        num_quantiles: int = 1,
        units: int = 32,
        recurrent: bool = True,
        previous_action: bool = True,
        condition_flag: bool = False,
        treatment_head: bool = False,
        reversal: float = 1.0,
        seed: int = 0,
    ) -> None:
        super().__init__()
        if not individuals or len(set(individuals)) != len(individuals):
            raise InputError(f"individuals={tuple(individuals)}: give one or more distinct names")
        if condition_flag and observation_size < 2:
            raise InputError(
                "condition_flag=True needs an observation of at least two components, the last of "
                f"them the flag, but there is {observation_size}: use the condition-flag wrapper"
            )
        self.individuals = tuple(individuals)
        self.num_actions = num_actions
        self.num_quantiles = num_quantiles
        self.units = units
        self.recurrent = recurrent
        self.previous_action = previous_action
        self.condition_flag = condition_flag
        self.reversal = reversal
        self.sensed = observation_size - condition_flag
        generators = individual_generators(individuals, seed)
        encoder_inputs = self.sensed + (num_actions if previous_action else 0)
        self.encoder_1 = StackedLinear(encoder_inputs, units, generators)
        self.encoder_2 = StackedLinear(units, units, generators)
        self.gru = StackedGRU(units, units, generators) if recurrent else None
        self.dueling = DuelingHead(
            units + condition_flag, units, num_actions, num_quantiles, generators
        )
        self.treatment: nn.Sequential | None = None
        if treatment_head:
            self.treatment = nn.Sequential(
                StackedLinear(units, TREATMENT_UNITS, generators),
                nn.ReLU(),
                StackedLinear(TREATMENT_UNITS, 1, generators),
            )

    def initial_state(self, batch: int) -> torch.Tensor:
        """Zeros (K, batch, H): nothing remembered."""
        weight = self.encoder_1.weight
        return weight.new_zeros((len(self.individuals), batch, self.units))

    def _encode(self, observations: torch.Tensor, previous_actions: torch.Tensor) -> torch.Tensor:
        """Packed observations (K, row, n) and previous actions (K, row) to features (K, row, H)."""
        inputs = observations[..., : self.sensed]
        if self.previous_action:
            # One column more than there are actions: "none yet" falls there and is cut off.
            shape = (*previous_actions.shape, self.num_actions + 1)
            one_hot = inputs.new_zeros(shape).scatter_(-1, previous_actions.unsqueeze(-1), 1.0)
            inputs = torch.cat((inputs, one_hot[..., : self.num_actions]), dim=-1)
        return torch.relu(self.encoder_2(torch.relu(self.encoder_1(inputs))))

    def forward(
        self,
        observations: torch.Tensor,
        previous_actions: torch.Tensor,
        state: torch.Tensor | None = None,
        packing: Packing | None = None,
    ) -> QOutput:
        """Run whole sequences.

        Parameters
        ----------
        observations : Tensor (K, T, B, n)
        previous_actions : Tensor (K, T, B) int64
            Action taken before each observation; ``num_actions`` for none.
        state : Tensor (K, B, H), optional
            Hidden state before the first step; zeros by default.
        packing : Packing, optional
            Rows to compute; by default all.
        """
        _, time, batch, _ = observations.shape
        if packing is None:
            packing = Packing.full(time, batch, observations.device)
        if state is None:
            state = self.initial_state(batch)
        packed = packing.pack(observations)
        features = self._encode(packed, packing.pack(previous_actions))
        if self.gru is not None:
            features = self.gru(features, state, packing)
        logits = None
        if self.treatment is not None:
            logits = packing.unpack(
                self.treatment(reverse_gradient(features, self.reversal))[..., 0]
            )
        weight, bias = self.dueling.combined()
        return QOutput(
            treatment_logits=logits,
            features=features,
            initial_state=state,
            packing=packing,
            recurrent=self.recurrent,
            head_units=self.dueling.units(self._with_flag(features, packed)),
            head_weight=weight,
            head_bias=bias,
            num_actions=self.num_actions,
        )

    def _with_flag(self, features: torch.Tensor, observations: torch.Tensor) -> torch.Tensor:
        if not self.condition_flag:
            return features
        return torch.cat((features, observations[..., self.sensed :]), dim=-1)

    @torch.no_grad()
    def step(
        self, observations: torch.Tensor, previous_actions: torch.Tensor, state: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """One decision, without gradient.

        Parameters
        ----------
        observations : Tensor (K, B, n)
        previous_actions : Tensor (K, B) int64
        state : Tensor (K, B, H)

        Returns
        -------
        q_values : Tensor (K, B, actions)
            Mean over the quantiles.
        state : Tensor (K, B, H)
        """
        features = self._encode(observations, previous_actions)
        if self.gru is not None:
            state = self.gru(features, state, Packing.full(1, observations.shape[1], state.device))
            features = state
        values = self.dueling(self._with_flag(features, observations))
        if self.num_quantiles > 1:
            values = values.view(*values.shape[:-1], self.num_actions, self.num_quantiles).mean(-1)
        return values, state


def dueling_parts(values: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """State value and centred advantage of Q-values.

    The centred advantages sum to zero over actions, so V is the mean of Q over actions.

    Parameters
    ----------
    values : Tensor (..., actions, quantiles)

    Returns
    -------
    state_value : Tensor (..., quantiles)
    advantage : Tensor (..., actions, quantiles)
        A - mean over actions of A.
    """
    state_value = values.mean(-2)
    return state_value, values - state_value.unsqueeze(-2)
