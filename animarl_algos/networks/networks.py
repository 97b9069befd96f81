"""K independent recurrent dueling Q-networks, one per individual, held as stacked parameters.

Architecture (the paper, "Neural network architectures"), all of H = 32 units, for each individual::

    o = clip((observation - mean) / sd, limit)        the identity until statistics are set
    x = relu(Linear(relu(Linear([o, one-hot previous action]))))
    h = GRU(x, h)                                     left out in the feed-forward twin
    V = Linear(relu(Linear([h, c])))                  c, the condition flag, where there is one
    A = Linear(relu(Linear([h, c])))
    Q = V + A - mean over actions of A
    logit of c = Linear(relu(Linear(reversal(h))))    treatment head of DQCIL, 8 units

The number of layers of x, their width and what the heads see ([x, h] with a skip) are settings;
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

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Any, Literal

import numpy as np
import torch
from annotated_types import Ge, Le
from numpy.typing import NDArray
from torch import nn

from animarl_algos.losses.values import reverse_gradient, take_action
from animarl_algos.networks.kernels import WeightViews, chosen_values, runs_compiled
from animarl_algos.networks.layers import (
    DuelingHead,
    Packing,
    StackedGRU,
    StackedLinear,
    individual_generators,
)
from animarl_envs.errors import InputError
from animarl_envs.settings import Checked, NotNegative

TREATMENT_UNITS = 8
INPUT_LIMIT = 6.0
"""Standardised inputs are clipped at this many standard deviations: a simulation may go where no
recording has been."""


@dataclass(frozen=True, kw_only=True)
class NetworkSettings(Checked):
    """Shape of the networks; the defaults are the paper's."""

    hidden: Annotated[int, Ge(1), Le(8192)] = 32
    """Width of every hidden layer."""
    depth: Annotated[int, Ge(1), Le(100)] = 2
    """Layers before the GRU."""
    head_layers: Annotated[int, Ge(0), Le(1)] = 1
    """Hidden layers of the dueling head; 0: V and A are linear in what the head sees."""
    n_quantiles: Annotated[int, Ge(2)] | None = None
    """Quantiles per action (QR-DQN); None for expected values (DQN)."""
    skip: bool = False
    """Whether the heads see the encoded observation beside the GRU's state."""
    dropout: Annotated[float, Ge(0), Le(0.95)] = 0.0
    """Share of the hidden units (encoder and GRU) that are left out in the offline phase."""
    previous_action: bool | None = None
    """Whether the previous action is an input; None: for a network with a memory."""
    condition_input: Literal["head", "encoder"] = "head"
    """Where the condition flag enters: ``"head"`` bypasses encoder and GRU, which stay blind to it,
    and ``"encoder"`` does not; a network with a treatment head needs ``"head"``."""
    reversal: NotNegative = 1.0
    """Strength of the gradient reversal."""
    shared: bool = False
    """Whether all individuals have the same weights and statistics of inputs (parameter sharing:
    Gupta, Egorov & Kochenderfer 2017). Biases stay their own; in the first layer they act as an
    input that names the individual. Training averages the gradients of these weights
    (:func:`animarl_algos.losses.values.share_gradients`)."""


@dataclass(frozen=True)
class QOutput:
    """What a network says about a batch of sequences; zero where the packing computed nothing.

    Values are computed when asked for: of a quantile network's many outputs few are.
    """

    features: torch.Tensor  # (K, row, H), what the heads see: hidden states, or encoded inputs
    initial_state: torch.Tensor | None  # (K, B, H), before the first step
    packing: Packing  # of the features
    recurrent: bool  # whether the features are states
    treatment_logits: torch.Tensor | None  # (K, T, B), of treatment 1, through gradient reversal
    dueling: DuelingHead
    units: torch.Tensor  # (K, row, 2H), of the head, or what it sees

    @cached_property
    def head(self) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Units of the head, and weight and bias from them to the values."""
        return self.units, *self.dueling.combined()

    @cached_property
    def _values(self) -> torch.Tensor:
        """Quantiles of all action values, (K, row, actions, quantiles)."""
        if self.dueling.num_quantiles == 1 and self.dueling.hidden is None:
            return self.dueling.expected_values(self.units).unsqueeze(-1)
        units, weight, bias = self.head
        return self._per_action(torch.baddbmm(bias, units, weight))

    def _per_action(self, flat: torch.Tensor) -> torch.Tensor:
        return flat.view(*flat.shape[:-1], self.dueling.num_actions, -1)

    @cached_property
    def values(self) -> torch.Tensor:
        """Quantiles of all action values, (K, T, B, actions, quantiles).

        One "quantile" where the expected value is learned.
        """
        return self.packing.unpack(self._values)

    @cached_property
    def q_values(self) -> torch.Tensor:
        """Expected values of all actions, (K, T, B, actions)."""
        if self.dueling.num_quantiles == 1:
            return self.packing.unpack(self._values.squeeze(-1))
        weight, bias = (self._per_action(each).mean(-1) for each in self.head[1:])
        return self.packing.unpack(torch.baddbmm(bias, self.head[0], weight))

    def of_actions(self, actions: torch.Tensor) -> torch.Tensor:
        """Quantiles of one action's value at each step: (K, T, B) to (K, T, B, quantiles)."""
        packed = self.packing.pack(actions)
        if self.dueling.num_quantiles == 1 or not runs_compiled(self.features):
            return self.packing.unpack(take_action(self._values, packed))
        return self.packing.unpack(chosen_values(*self.head, packed, self.dueling.num_quantiles))

    @property
    def hidden(self) -> torch.Tensor:
        """The features of each step, (K, T, B, H)."""
        return self.packing.unpack(self.features)

    @property
    def final_state(self) -> torch.Tensor:
        """Hidden state after each sequence's last valid step, (K, B, H)."""
        assert self.initial_state is not None
        if not self.recurrent:
            return self.initial_state
        return self.packing.final(self.features, self.initial_state)


class StackedQNetwork(nn.Module):
    """Recurrent (or feed-forward) dueling Q-networks, one per named individual.

    An individual's initial weights depend on its (distinct) name and the ``seed`` only.
    ``observation_size`` counts components of one flattened observation, the condition flag
    included: the last one, where there is a ``condition_flag``. As a previous action,
    ``num_actions`` stands for "none yet". Not ``recurrent``, there is no GRU and the state is
    passed through untouched. ``treatment_head``: predict the treatment through gradient reversal
    (DQCIL). ``settings`` are those of :class:`NetworkSettings`. Buffers, saved with the weights,
    are ``input_mean`` and ``input_sd`` ``(K, 1, n)`` and ``input_limit`` ``(K, 1, 1)``; see
    :meth:`standardise_inputs`.
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
        recurrent: bool = True,
        condition_flag: bool = False,
        treatment_head: bool = False,
        seed: int = 0,
        **settings: Any,
    ) -> None:
        super().__init__()
        network = NetworkSettings(**settings)
        encoded_flag = network.condition_input == "encoder"
        if not individuals or len(set(individuals)) != len(individuals):
            raise InputError(f"individuals={tuple(individuals)}: give one or more distinct names")
        if condition_flag and observation_size < 2:
            raise InputError(
                "condition_flag=True needs an observation of at least two components, the last of "
                f"them the flag, but there is {observation_size}: use the condition-flag wrapper"
            )
        if network.skip and not recurrent:
            raise InputError(
                "skip=True leads past a memory and this network has none: use GruPolicy, or leave "
                "skip out"
            )
        if treatment_head and encoded_flag:
            raise InputError(
                "condition_input is 'encoder' and gradient reversal makes the memory blind to the "
                "condition, which the encoder would tell it: set condition_input to 'head'"
            )
        self.individuals = tuple(individuals)
        self.num_actions = num_actions
        self.num_quantiles = network.n_quantiles or 1
        self.units, self.depth = units, depth = network.hidden, network.depth
        self.recurrent = recurrent
        self.skip, self.dropout, self.shared = network.skip, network.dropout, network.shared
        sees_previous = recurrent if network.previous_action is None else network.previous_action
        self.previous_action = sees_previous
        self.flag_in_head = condition_flag and not encoded_flag
        self.reversal = network.reversal
        self.sensed = observation_size - self.flag_in_head
        named = [individuals[0]] * len(individuals) if network.shared else individuals
        generators = individual_generators(named, seed)
        encoder_inputs = self.sensed + (num_actions if sees_previous else 0)
        for layer in range(depth):
            inputs = units if layer else encoder_inputs
            self.add_module(f"encoder_{layer + 1}", StackedLinear(inputs, units, generators))
        self.gru = StackedGRU(units, units, generators) if recurrent else None
        seen = units * (1 + network.skip)
        self.gated = self.flag_in_head and not network.head_layers
        read = seen * (1 + self.gated) + self.flag_in_head
        self.dueling = DuelingHead(
            read, units * network.head_layers, num_actions, self.num_quantiles, generators
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

    @cached_property
    def encoder(self) -> list[StackedLinear]:
        """The layers before the GRU."""
        return [self.get_submodule(f"encoder_{i + 1}") for i in range(self.depth)]  # type: ignore[misc]

    @torch.no_grad()
    def standardise_inputs(
        self, mean: torch.Tensor, sd: torch.Tensor, limit: float = INPUT_LIMIT
    ) -> None:
        """See observations as ``clip((o - mean) / sd)`` from now on, but for a flag in the head.

        ``mean`` and ``sd`` (K, n) are of each individual's observation components, the flag's own
        included (and not used if it enters the head). A component that does not vary (sd 0) keeps
        its scale. A shared network takes mean and sd over all individuals. ``limit`` clips what
        lies farther from the mean [sd].
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
        self.__dict__.pop("standardised", None)

    @cached_property
    def standardised(self) -> bool:
        """Whether the statistics change inputs."""
        limited = torch.isfinite(self.input_limit).any()
        return bool(limited or self.input_mean.any() or (self.input_sd != 1.0).any())

    @torch.no_grad()
    def amplify_inputs(self, components: Sequence[int], gains: NDArray[np.floating]) -> None:
        """See these components of the observation ``gains`` times as far from their mean."""
        self.input_sd[:, :, list(components)] /= torch.as_tensor(gains).to(self.input_sd)
        self.__dict__.pop("standardised", None)

    def _encode(
        self,
        observations: torch.Tensor,
        previous_actions: torch.Tensor,
        packing: Packing,
        masks: torch.Tensor | None,
    ) -> torch.Tensor:
        """Return features (K, row, H).

        Observations (K, row, n) are packed, previous actions (K, T, B) are not.
        """
        inputs = observations[..., : self.sensed] if self.flag_in_head else observations
        if self.previous_action:
            previous_actions = packing.pack(previous_actions)
            # One column more than there are actions: "none yet" falls there and is cut off.
            shape = (*previous_actions.shape, self.num_actions + 1)
            one_hot = inputs.new_zeros(shape).scatter_(-1, previous_actions.unsqueeze(-1), 1.0)
            inputs = torch.cat((inputs, one_hot[..., : self.num_actions]), dim=-1)
        for number, layer in enumerate(self.encoder):
            inputs = torch.relu(layer(inputs))
            if masks is not None:
                inputs = inputs * packing.repeat_per_row(masks[number])
        return inputs

    def forward(
        self,
        observations: torch.Tensor,
        previous_actions: torch.Tensor | None = None,
        state: torch.Tensor | None = None,
        packing: Packing | None = None,
        masks: torch.Tensor | None = None,
    ) -> QOutput | torch.Tensor:
        """Run whole sequences: observations ``(K, T, B, n)``, previous actions ``(K, T, B)`` int64.

        A previous action is the one taken before each observation, ``num_actions`` for none.
        ``state`` ``(K, B, H)`` is that before the first step, by default zeros; ``packing`` says
        which rows to compute, by default all; ``masks`` ``(layers, K, B, H)`` are factors of hidden
        units, for training (:class:`.layers.DropoutDraws`). Without previous actions, observations
        ``(S, n)`` of all slots give expected values ``(S, actions)`` at the start of an episode,
        as the networks of stable-baselines3 do.
        """
        if previous_actions is None:
            return self._first_values(observations)
        _, time, batch, _ = observations.shape
        if packing is None:
            packing = Packing.full(time, batch, observations.device)
        if state is None and self.gru is not None:
            state = self.initial_state(batch)
        observed, limit = packing.pack(observations), self.input_limit
        if self.standardised:
            observed = torch.clamp((observed - self.input_mean) / self.input_sd, -limit, limit)
        features = seen = self._encode(observed, previous_actions, packing, masks)
        if self.gru is not None and state is not None:
            encoded, features = seen, self.gru(seen, state, packing)
            seen = features
            if masks is not None:
                seen = features * packing.repeat_per_row(masks[self.depth])
            if self.skip:
                seen = torch.cat((encoded, seen), dim=-1)
        units = self.dueling.units(self._with_flag(seen, observed))
        logits = None
        if self.treatment is not None:
            logits = packing.unpack(self.treatment(reverse_gradient(seen, self.reversal))[..., 0])
        return QOutput(features, state, packing, self.recurrent, logits, self.dueling, units)

    def _first_values(self, observations: torch.Tensor) -> torch.Tensor:
        """Return expected values (S, actions) of observations (S, n) at the start of episodes."""
        individuals, size = self.input_mean.shape[0], self.input_mean.shape[2]
        stacked = observations.reshape(-1, individuals, 1, size).permute(1, 2, 0, 3)
        none = torch.full(stacked.shape[:3], self.num_actions, device=stacked.device)
        values: torch.Tensor = self(stacked.float(), none).q_values[:, 0]
        return values.transpose(0, 1).flatten(0, 1)

    @cached_property
    def weights(self) -> WeightViews:
        """Weights and biases of all layers in the order of the equations, the GRU's last.

        Those of a layer that is not there are empty.
        """
        none = torch.zeros((0, 0, 0))
        dueling = self.dueling
        layers = [*self.encoder, dueling.hidden, dueling.value, dueling.advantage]
        linear = [(none, none) if one is None else (one.weight, one.bias) for one in layers]
        gru = 4 * (none,) if self.gru is None else self.gru.weights
        return WeightViews([*(array for pair in linear for array in pair), *gru])

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
        """Return the dueling head's inputs: features, flag and, if gated, flag times features."""
        if not self.flag_in_head:
            return features
        flag = observations[..., self.sensed :]
        gated = (flag * features,) if self.gated else ()
        return torch.cat((features, flag, *gated), dim=-1)

    @torch.no_grad()
    def step(
        self, observations: torch.Tensor, previous_actions: torch.Tensor, state: torch.Tensor
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """One decision, without gradient: expected values (K, B, actions) and next state (K, B, H).

        ``observations`` are (K, B, n), ``previous_actions`` (K, B) int64.
        """
        output = self(observations.unsqueeze(1), previous_actions.unsqueeze(1), state)
        return output.q_values[:, 0], output.final_state


def _look_parameters_up_anew(network: StackedQNetwork, _: Any) -> None:
    """After ``load_state_dict`` the statistics are other ones, with ``assign=True`` all tensors."""
    for name in ("weights", "all_parameters", "shared_parameters", "standardised"):
        network.__dict__.pop(name, None)
