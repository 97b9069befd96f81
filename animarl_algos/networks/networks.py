"""K independent recurrent dueling Q-networks, one per individual, held as stacked parameters.

Architecture (the paper, "Neural network architectures"), all of H = 32 units, for each individual::

    o = clip((observation - mean) / sd, limit)        the identity until statistics are set
    x = relu(Linear(relu(Linear([o, one-hot previous action]))))
    h = GRU(x, h)                                     left out in the feed-forward twin
    V = Linear(relu(Linear([h, c])))                  c, the condition flag, where there is one
    A = Linear(relu(Linear([h, c])))
    Q = V + A - mean over actions of A
    logit of c = Linear(relu(Linear(reversal(h))))    treatment head of DQCIL, 8 units

The number of layers of x, their width and what the heads see ([x, h] with a skip) are arguments;
the paper's are the defaults.

The flag has to interact with the state: what the condition changes differs between states. Where
the head has no hidden layer, V and A are linear in [h, c, c h], so that each condition has a head
of its own; [h, c] alone would shift every action's value by the same amount in every state. With
``condition_input="encoder"`` the flag is an ordinary component of o, and the memory knows it.

Every parameter has a leading axis of individuals; nothing is shared, so that training K individuals
together is training each alone. With ``shared`` the weights of all individuals begin alike and are
kept so: one network that learns from all of them, in which an individual has but its biases.
Axes: (individual, time, batch, feature).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import cached_property
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from animarl_algos.losses.losses import reverse_gradient
from animarl_algos.losses.values import take_action
from animarl_algos.networks.kernels import chosen_head, feed_forward, runs_compiled
from animarl_algos.networks.kernels.feed_forward import WeightViews
from animarl_algos.networks.layers import (
    DropoutMasks,
    DuelingHead,
    Packing,
    StackedGRU,
    StackedLinear,
    individual_generators,
)
from animarl_envs.errors import InputError


@dataclass(frozen=True)
class HeadUnits:
    """A quantile network's head, known by its hidden units: of its many outputs few are asked for.

    Attributes
    ----------
    units : Tensor (K, row, 2H)
    weight, bias : Tensor (K, 2H, actions * quantiles), (K, 1, actions * quantiles)
        From them to the values.
    num_actions
    """

    units: torch.Tensor
    weight: torch.Tensor
    bias: torch.Tensor
    num_actions: int

    @property
    def num_quantiles(self) -> int:
        return self.weight.shape[-1] // self.num_actions

    def values(self) -> torch.Tensor:
        """Quantiles of all action values, (K, row, actions, quantiles)."""
        return self._per_action(torch.baddbmm(self.bias, self.units, self.weight))

    def means(self) -> torch.Tensor:
        """Expected values of all actions, (K, row, actions)."""
        weight, bias = (self._per_action(t).mean(-1) for t in (self.weight, self.bias))
        return torch.baddbmm(bias, self.units, weight)

    def of_actions(self, actions: torch.Tensor) -> torch.Tensor:
        """Quantiles of one action's value in each row: (K, row) to (K, row, quantiles)."""
        if not runs_compiled(self.units):
            return take_action(self.values(), actions)
        return chosen_head.chosen_values(
            self.units, self.weight, self.bias, actions, self.num_quantiles
        )

    def _per_action(self, flat: torch.Tensor) -> torch.Tensor:
        return flat.view(*flat.shape[:-1], self.num_actions, self.num_quantiles)


@dataclass(frozen=True)
class HeadValues:
    """A head known by its values, (K, row, actions, quantiles)."""

    known: torch.Tensor

    def values(self) -> torch.Tensor:
        return self.known

    def means(self) -> torch.Tensor:
        return self.known.squeeze(-1) if self.known.shape[-1] == 1 else self.known.mean(-1)

    def of_actions(self, actions: torch.Tensor) -> torch.Tensor:
        return take_action(self.known, actions)


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
    head
        Of the values of the packed rows.
    """

    treatment_logits: torch.Tensor | None
    features: torch.Tensor
    initial_state: torch.Tensor
    packing: Packing
    recurrent: bool
    head: HeadUnits | HeadValues

    @cached_property
    def values(self) -> torch.Tensor:
        """Quantiles of all action values, (K, T, B, actions, quantiles).

        One "quantile" where the expected value is learned.
        """
        return self.packing.unpack(self.head.values())

    @cached_property
    def q_values(self) -> torch.Tensor:
        """Expected values of all actions, (K, T, B, actions)."""
        return self.packing.unpack(self.head.means())

    def of_actions(self, actions: torch.Tensor) -> torch.Tensor:
        """Quantiles of one action's value at each step: (K, T, B) to (K, T, B, quantiles)."""
        return self.packing.unpack(self.head.of_actions(self.packing.pack(actions)))

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


TREATMENT_UNITS = 8
INPUT_LIMIT = 6.0
"""Standardised inputs are clipped at this many standard deviations: a simulation may go where no
recording has been."""


class ConditionInput(StrEnum):
    """Where the condition flag enters the network."""

    HEAD = "head"  # beside the hidden state, which stays blind to it
    ENCODER = "encoder"  # as any other component of the observation


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
    depth
        Number of layers before the GRU.
    head_layers
        Hidden layers of the dueling head, 1 or 0: V and A linear in what the head sees.
    recurrent
        False leaves the GRU out; the state is then passed through untouched.
    skip
        Whether the heads see the encoded observation beside the GRU's state.
    dropout
        Share of the hidden units (encoder and GRU) that are left out where masks are asked for;
        see :mod:`animarl_algos.networks.layers`.
    previous_action
        Whether the previous action is an input.
    condition_flag
        Whether the last observation component is the condition flag.
    condition_input
        Where the flag enters: ``"head"`` bypasses encoder and GRU, which stay blind to it, and
        ``"encoder"`` does not; a network with a treatment head needs ``"head"``.
    treatment_head
        Whether to predict the treatment through gradient reversal (DQCIL).
    reversal
        Strength of the gradient reversal.
    shared
        Whether all individuals have the same weights and statistics of inputs (parameter sharing:
        Gupta, Egorov & Kochenderfer 2017). Biases stay their own; in the first layer they act as an
        input that names the individual. Training averages the gradients of
        :attr:`shared_parameters` (:func:`animarl_algos.losses.losses.share_gradients`).
    seed
        Of the initial weights.

    Attributes
    ----------
    input_mean, input_sd : Tensor (K, 1, n)
    input_limit : Tensor (K, 1, 1)
        Buffers, saved with the weights; see :meth:`standardise_inputs`.
    """

    input_mean: torch.Tensor
    input_sd: torch.Tensor
    input_limit: torch.Tensor

    def __init__(
        self,
        individuals: Sequence[str],
        observation_size: int,
        num_actions: int,
        *,
        num_quantiles: int = 1,
        units: int = 32,
        depth: int = 2,
        head_layers: int = 1,
        recurrent: bool = True,
        skip: bool = False,
        dropout: float = 0.0,
        previous_action: bool = True,
        condition_flag: bool = False,
        condition_input: str = ConditionInput.HEAD,
        treatment_head: bool = False,
        reversal: float = 1.0,
        shared: bool = False,
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
        if skip and not recurrent:
            raise InputError(
                "skip=True leads past a memory and this network has none: use GruPolicy, or leave "
                "skip out"
            )
        if condition_input not in list(ConditionInput):
            raise InputError(
                f"condition_input is {condition_input!r}: choose {' or '.join(ConditionInput)}"
            )
        if treatment_head and condition_input == ConditionInput.ENCODER:
            raise InputError(
                "condition_input is 'encoder' and gradient reversal makes the memory blind to the "
                "condition, which the encoder would tell it: set condition_input to 'head'"
            )
        self.individuals = tuple(individuals)
        self.num_actions = num_actions
        self.num_quantiles = num_quantiles
        self.units = units
        self.depth = depth
        self.recurrent = recurrent
        self.skip = skip
        self.dropout = dropout
        self.previous_action = previous_action
        self.flag_in_head = condition_flag and condition_input == ConditionInput.HEAD
        self.reversal = reversal
        self.sensed = observation_size - self.flag_in_head
        self.shared = shared
        named = [individuals[0]] * len(individuals) if shared else individuals
        generators = individual_generators(named, seed)
        encoder_inputs = self.sensed + (num_actions if previous_action else 0)
        for layer in range(depth):
            inputs = units if layer else encoder_inputs
            self.add_module(f"encoder_{layer + 1}", StackedLinear(inputs, units, generators))
        self.gru = StackedGRU(units, units, generators) if recurrent else None
        seen = units * (1 + skip)
        self.gated = self.flag_in_head and not head_layers
        read = seen * (1 + self.gated) + self.flag_in_head
        self.dueling = DuelingHead(
            read, units * head_layers, num_actions, num_quantiles, generators
        )
        self.treatment: nn.Sequential | None = None
        if treatment_head:
            self.treatment = nn.Sequential(
                StackedLinear(seen, TREATMENT_UNITS, generators),
                nn.ReLU(),
                StackedLinear(TREATMENT_UNITS, 1, generators),
            )
        shape = (len(self.individuals), 1, observation_size)
        self.register_buffer("input_mean", torch.zeros(shape))
        self.register_buffer("input_sd", torch.ones(shape))
        self.register_buffer("input_limit", torch.full((shape[0], 1, 1), torch.inf))
        self.register_load_state_dict_post_hook(_look_parameters_up_anew)  # type: ignore[no-untyped-call]

    def initial_state(self, batch: int) -> torch.Tensor:
        """Zeros (K, batch, H): nothing remembered."""
        weight = self.encoder[0].weight
        return weight.new_zeros((len(self.individuals), batch, self.units))

    @property
    def encoder(self) -> list[StackedLinear]:
        """The layers before the GRU."""
        return [self.get_submodule(f"encoder_{i + 1}") for i in range(self.depth)]  # type: ignore[misc]

    @torch.no_grad()
    def standardise_inputs(
        self, mean: torch.Tensor, sd: torch.Tensor, limit: float = INPUT_LIMIT
    ) -> None:
        """See observations as ``clip((o - mean) / sd)`` from now on, but for a flag in the head.

        Parameters
        ----------
        mean, sd : Tensor (K, n)
            Of each individual's observation components, the flag's own included (and not used if
            it enters the head).
            A component that does not vary (sd 0) keeps its scale. A shared network takes mean and
            sd over all individuals.
        limit
            Clips what lies farther from the mean [sd].
        """
        if self.shared:
            sd = (sd.square() + (mean - mean.mean(0)).square()).mean(0).sqrt().expand_as(sd)
            mean = mean.mean(0).expand_as(mean)
        sd = torch.where(sd > 1e-6, sd, 1.0)
        if self.flag_in_head:
            mean, sd = mean.clone(), sd.clone()
            mean[:, -1], sd[:, -1] = 0.0, 1.0
        self.input_mean.copy_(mean.unsqueeze(1))
        self.input_sd.copy_(sd.unsqueeze(1))
        self.input_limit.fill_(limit)

    def _standardised(self, observations: torch.Tensor) -> torch.Tensor:
        """Packed observations (K, row, n) in units of their training spread."""
        limit = self.input_limit
        return torch.clamp((observations - self.input_mean) / self.input_sd, -limit, limit)

    def _encode(
        self,
        observations: torch.Tensor,
        previous_actions: torch.Tensor,
        packing: Packing,
        masks: DropoutMasks | None,
    ) -> torch.Tensor:
        """Packed observations (K, row, n) and previous actions (K, row) to features (K, row, H)."""
        inputs = observations[..., : self.sensed]
        if self.previous_action:
            # One column more than there are actions: "none yet" falls there and is cut off.
            shape = (*previous_actions.shape, self.num_actions + 1)
            one_hot = inputs.new_zeros(shape).scatter_(-1, previous_actions.unsqueeze(-1), 1.0)
            inputs = torch.cat((inputs, one_hot[..., : self.num_actions]), dim=-1)
        for number, layer in enumerate(self.encoder):
            inputs = torch.relu(layer(inputs))
            if masks is not None:
                inputs = masks.thin(inputs, number, packing)
        return inputs

    def forward(
        self,
        observations: torch.Tensor,
        previous_actions: torch.Tensor,
        state: torch.Tensor | None = None,
        packing: Packing | None = None,
        masks: DropoutMasks | None = None,
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
        masks : DropoutMasks, optional
            Units to leave out, for training; by default none.
        """
        _, time, batch, _ = observations.shape
        if packing is None:
            packing = Packing.full(time, batch, observations.device)
        if state is None:
            state = self.initial_state(batch)
        observed = self._standardised(packing.pack(observations))
        previous = packing.pack(previous_actions)
        head: HeadUnits | HeadValues
        if self.fits_loops and masks is None and feed_forward.usable(observed):
            features, values = feed_forward.features_and_values(
                observed,
                previous,
                self.weights,
                self.num_actions,
                flagged=self.flag_in_head,
                sees_previous=self.previous_action,
            )
            head, seen = HeadValues(values), features
        else:
            features = seen = self._encode(observed, previous, packing, masks)
            if self.gru is not None:
                encoded, features = seen, self.gru(seen, state, packing)
                seen = features if masks is None else masks.thin(features, self.depth, packing)
                if self.skip:
                    seen = torch.cat((encoded, seen), dim=-1)
            head = self._head(self._with_flag(seen, observed))
        logits = None
        if self.treatment is not None:
            logits = packing.unpack(self.treatment(reverse_gradient(seen, self.reversal))[..., 0])
        return QOutput(
            treatment_logits=logits,
            features=features,
            initial_state=state,
            packing=packing,
            recurrent=self.recurrent,
            head=head,
        )

    def _head(self, inputs: torch.Tensor) -> HeadUnits | HeadValues:
        weight, bias = self.dueling.combined()
        units = self.dueling.units(inputs)
        if self.num_quantiles > 1:
            return HeadUnits(units, weight, bias, self.num_actions)
        return HeadValues(torch.baddbmm(bias, units, weight).unsqueeze(-1))

    @property
    def fits_loops(self) -> bool:
        """Whether the feed-forward loops can compute a network of this shape."""
        return self.gru is None and self.depth == 2 and self.dueling.hidden is not None

    @property
    def hidden_layers(self) -> int:
        """Layers that dropout thins."""
        return self.depth + self.recurrent

    @cached_property
    def weights(self) -> WeightViews:
        """Weights and biases of all layers in the order of the equations, but the GRU's.

        The encoder's come first; the head's hidden layer is empty where there is none.
        """
        dueling = self.dueling
        hidden = [torch.zeros((0, 0, 0))] * 2
        if dueling.hidden is not None:
            hidden = [dueling.hidden.weight, dueling.hidden.bias]
        encoder = [p for layer in self.encoder for p in (layer.weight, layer.bias)]
        streams = [
            p for layer in (dueling.value, dueling.advantage) for p in (layer.weight, layer.bias)
        ]
        return WeightViews([*encoder, *hidden, *streams])

    @cached_property
    def gru_weights(self) -> WeightViews:
        """Weights and biases of the GRU, empty without one."""
        gru = self.gru
        if gru is None:
            return WeightViews([torch.zeros((0, 0, 0))] * 4)
        return WeightViews([gru.weight_input, gru.weight_hidden, gru.bias_input, gru.bias_hidden])

    @cached_property
    def all_parameters(self) -> list[nn.Parameter]:
        """Every parameter, found once: ``parameters()`` walks all modules anew."""
        return list(self.parameters())

    @property
    def num_parameters(self) -> int:
        """Numbers that are learned, of all individuals together."""
        return sum(parameter.numel() for parameter in self.all_parameters)

    @cached_property
    def shared_parameters(self) -> list[nn.Parameter]:
        """Parameters that are the same for all individuals."""
        named = self.named_parameters() if self.shared else ()
        return [parameter for name, parameter in named if "bias" not in name]

    def input_statistics(self) -> tuple[NDArray[np.float32], ...]:
        """Mean (K, n), standard deviation (K, n) and limit (K, 1) of the inputs, not copied."""
        buffers = (self.input_mean, self.input_sd, self.input_limit)
        return tuple([buffer[:, 0].numpy() for buffer in buffers])

    def _with_flag(self, features: torch.Tensor, observations: torch.Tensor) -> torch.Tensor:
        """Inputs of the dueling head: features, flag and, without a hidden layer, their product."""
        if not self.flag_in_head:
            return features
        flag = observations[..., self.sensed :]
        gated = (flag * features,) if self.gated else ()
        return torch.cat((features, flag, *gated), dim=-1)

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
        output = self(observations.unsqueeze(1), previous_actions.unsqueeze(1), state)
        return output.q_values[:, 0], output.final_state


def _look_parameters_up_anew(network: StackedQNetwork, _: Any) -> None:
    """After ``load_state_dict(assign=True)`` the parameters are other ones."""
    for name in ("weights", "gru_weights", "all_parameters", "shared_parameters"):
        network.__dict__.pop(name, None)
