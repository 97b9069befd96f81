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

from collections.abc import Sequence
from functools import cached_property
from typing import Any

import torch
from torch import nn

from animarl_algos.losses.gradient_reversal import reverse_gradient
from animarl_algos.networks.gru import Packing
from animarl_algos.networks.kernels import feed_forward
from animarl_algos.networks.kernels.feed_forward import WeightViews
from animarl_algos.networks.layers import (
    DuelingHead,
    StackedGRU,
    StackedLinear,
    individual_generators,
)
from animarl_algos.networks.output import Head, HeadUnits, HeadValues, QOutput
from animarl_envs.errors import InputError

TREATMENT_UNITS = 8


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
        self.register_load_state_dict_post_hook(_look_parameters_up_anew)  # type: ignore[no-untyped-call]

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
        observed, previous = packing.pack(observations), packing.pack(previous_actions)
        head: Head
        if self.gru is None and feed_forward.usable(observed):
            features, values = feed_forward.features_and_values(
                observed,
                previous,
                self.weights,
                self.num_actions,
                flagged=self.condition_flag,
                sees_previous=self.previous_action,
            )
            head = HeadValues(values)
        else:
            features = self._encode(observed, previous)
            if self.gru is not None:
                features = self.gru(features, state, packing)
            head = self._head(self._with_flag(features, observed))
        logits = None
        if self.treatment is not None:
            logits = packing.unpack(
                self.treatment(reverse_gradient(features, self.reversal))[..., 0]
            )
        return QOutput(
            treatment_logits=logits,
            features=features,
            initial_state=state,
            packing=packing,
            recurrent=self.recurrent,
            head=head,
        )

    def _head(self, inputs: torch.Tensor) -> Head:
        weight, bias = self.dueling.combined()
        units = self.dueling.units(inputs)
        if self.num_quantiles > 1:
            return HeadUnits(units, weight, bias, self.num_actions)
        return HeadValues(torch.baddbmm(bias, units, weight).unsqueeze(-1))

    @cached_property
    def weights(self) -> WeightViews:
        """Weights and biases of all layers in the order of the equations, but the GRU's."""
        dueling = self.dueling
        layers = (
            *(self.encoder_1, self.encoder_2),
            *(dueling.hidden, dueling.value, dueling.advantage),
        )
        return WeightViews([p for layer in layers for p in (layer.weight, layer.bias)])

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
        output = self(observations.unsqueeze(1), previous_actions.unsqueeze(1), state)
        return output.q_values[:, 0], output.final_state


def _look_parameters_up_anew(network: StackedQNetwork, _: Any) -> None:
    """After ``load_state_dict(assign=True)`` the parameters are other ones."""
    for name in ("weights", "gru_weights", "all_parameters"):
        network.__dict__.pop(name, None)
