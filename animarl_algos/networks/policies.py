"""Stable-baselines3 policies around the stacked Q-networks: memory of slots and choice of actions.

A vectorised environment with S = copies * K slots has copy ``s // K`` and individual ``s % K`` in
slot s; each slot is routed to the network of its individual. Between calls a slot's memory is its
hidden state and its previous action.
"""

from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import numba as nb
import numpy as np
import torch
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3.common.policies import BasePolicy
from stable_baselines3.common.type_aliases import PyTorchObs, Schedule

from animarl_algos.losses.values import ValueDistribution
from animarl_algos.networks.acting_rule import Acting
from animarl_algos.networks.kernels import sigmoid_float32, tanh_float32
from animarl_algos.networks.networks import NetworkSettings, StackedQNetwork
from animarl_envs.array_types import Bools, Ints
from animarl_envs.compiling import jit
from animarl_envs.errors import InputError
from animarl_envs.settings import field_types

State = tuple[NDArray[np.float32], Ints]
"""Hidden state (S, H) and previous action (S,)."""
FINISHED = np.iinfo(np.int64).min
"""In the place of a previous action: the slot's episode is over, so nothing is computed for it."""


@dataclass(frozen=True, kw_only=True)
class PolicySettings(NetworkSettings):
    """What ``policy_kwargs`` may say."""

    td_loss: Literal["squared", "huber"] = "squared"
    """Of expected values: the temporal-difference error squared (the paper), or by Huber's loss
    with threshold 1 (stable-baselines3)."""
    optimizer_class: Any = None
    """As in stable-baselines3; None: Adam."""
    optimizer_kwargs: dict[str, Any] | None = None
    """As in stable-baselines3; those of Adam are ``fused=True`` where they say nothing else."""


class GruPolicy(BasePolicy):  # type: ignore[misc]
    """Recurrent dueling Q-networks, one per individual, with their target networks and optimiser.

    Observations are a Box, flattened to a vector, actions Discrete from 0; ``individuals`` names
    the K individuals in slot order. ``acting``, how actions are chosen, may be set at any time and
    holds from the next prediction on. ``seed`` is that of the initial weights and of the acting
    draws; for ``condition_flag`` and ``treatment_head`` see
    :class:`~animarl_algos.networks.networks.StackedQNetwork`. ``settings`` are those of
    :class:`PolicySettings`.
    """

    recurrent: ClassVar[bool] = True
    q_net: StackedQNetwork
    q_net_target: StackedQNetwork

    def __init__(
        self,
        observation_space: spaces.Space[Any],
        action_space: spaces.Space[Any],
        lr_schedule: Schedule,
        *,
        individuals: tuple[str, ...] = ("agent",),
        condition_flag: bool = False,
        treatment_head: bool = False,
        acting: Acting | None = None,
        seed: int = 0,
        **settings: Any,
    ) -> None:
        if not isinstance(observation_space, spaces.Box):
            raise InputError(
                f"observation space {observation_space} is not a Box: flatten it to a vector first"
            )
        if not isinstance(action_space, spaces.Discrete) or action_space.start != 0:
            raise InputError(
                f"action space {action_space} is not Discrete starting at 0: these learners choose "
                "among numbered actions"
            )
        own = PolicySettings(**settings)
        optimizer_class = own.optimizer_class or torch.optim.Adam
        fused = {"fused": True} if own.optimizer_class is None else {}  # in one call
        super().__init__(
            observation_space,
            action_space,
            optimizer_class=optimizer_class,
            optimizer_kwargs=fused | (own.optimizer_kwargs or {}),
        )
        self.individuals = tuple(individuals)
        self.num_actions = int(action_space.n)
        self.distribution = ValueDistribution(own.n_quantiles, own.td_loss)
        self.acting = acting or Acting.epsilon_greedy(0.0)
        self._arguments = {
            "individuals": self.individuals,
            "condition_flag": condition_flag,
            "treatment_head": treatment_head,
            "seed": seed,
            **settings,
        }
        self.seed(seed)
        self.q_net, self.q_net_target = self.make_q_net(), self.make_q_net()
        self.q_net_target.load_state_dict(self.q_net.state_dict())
        self.q_net_target.requires_grad_(False)
        self._actor = CompiledActor(self.q_net)
        self._first_rate = lr_schedule(1)
        self._optimizer: torch.optim.Optimizer | None = None
        usual = optimizer_class is torch.optim.Adam and self._first_rate >= 0
        if not usual or self.optimizer_kwargs.keys() - {"fused"}:
            _ = self.optimizer  # refuses arguments that do not fit, now

    @property
    def optimizer(self) -> torch.optim.Optimizer:  # type: ignore[override]
        """Return the optimiser of ``q_net``, made when first asked for.

        Acting needs none, and the first one of a process takes seconds to import.
        """
        if self._optimizer is None:
            try:
                self.reset_optimizer(self._first_rate)
            except (TypeError, ValueError) as error:
                raise InputError(
                    f"optimizer_class and optimizer_kwargs do not fit: {error}"
                ) from error
        assert self._optimizer is not None
        return self._optimizer

    def reset_optimizer(self, learning_rate: float) -> None:
        """Make a new optimiser, with nothing accumulated."""
        self._optimizer = self.optimizer_class(
            self.q_net.parameters(),
            lr=learning_rate,  # type: ignore[call-arg]
            **self.optimizer_kwargs,
        )

    def make_q_net(self) -> StackedQNetwork:
        """Return a freshly initialised network of the constructor's arguments."""
        network = {k: v for k, v in self._arguments.items() if k not in TRAINING_ONLY_SETTINGS}
        return StackedQNetwork(
            network.pop("individuals"),
            int(np.prod(self.observation_space.shape or ())),
            self.num_actions,
            recurrent=self.recurrent,
            **network,
        )

    @property
    def acting(self) -> Acting:
        """The acting rule; one with temperatures of other individuals is refused."""
        return self._acting

    @acting.setter
    def acting(self, rule: Acting) -> None:
        self._acting = rule.checked(len(self.individuals), self.num_actions)

    def seed(self, seed: int) -> None:
        """Seed the generator of the acting draws."""
        self.generator = np.random.default_rng(seed)

    @property
    def random_state(self) -> dict[str, Any]:
        """State of the acting generator, to be stored with a checkpoint; assignable."""
        return dict(self.generator.bit_generator.state)

    @random_state.setter
    def random_state(self, state: dict[str, Any]) -> None:
        self.generator.bit_generator.state = state

    def initial_state(self, slots: int) -> State:
        """Memory of fresh episodes: zeros (S, H) and ``num_actions`` (S,), no previous action."""
        return (
            np.zeros((slots, self.q_net.units), dtype=np.float32),
            np.full(slots, self.num_actions, dtype=np.int64),
        )

    def predict(
        self,
        observation: NDArray[Any] | dict[str, NDArray[Any]],
        state: tuple[NDArray[Any], ...] | None = None,
        episode_start: NDArray[Any] | None = None,
        deterministic: bool = False,
    ) -> tuple[Ints, State]:
        """Choose an action per slot; return them, ``(S,)`` or ``()`` for the only slot, and memory.

        ``observation`` is ``(S, *shape)`` of all slots, or ``(*shape)`` of the only one. ``state``
        is the memory that the last call returned, hidden ``(S, H)`` float32 and previous action
        ``(S,)`` int64; it is not changed, and None starts fresh episodes. Where other actions than
        the returned ones are executed, see :meth:`remember`. ``episode_start`` ``(S,)`` bool: slots
        whose memory is forgotten first. ``deterministic``: the greedy action (ties: the lowest
        index) and no random draw; else by the acting rule, with one draw per slot.
        """
        q_values, hidden, single = self.advance(observation, state, episode_start)
        actions = self.choose(q_values, deterministic)
        return (actions[0] if single else actions), (hidden, actions.copy())

    def remember(self, state: State, executed: NDArray[np.integer]) -> State:
        """Return the ``state`` after a step that executed actions (S,) of another's choice."""
        return state[0], executed.astype(np.int64)

    def leave_out(self, state: State, over: Bools) -> State:
        """Return the ``state`` in which slots whose episode is ``over`` (S,) cost nothing.

        They still draw an action, so that the other slots' random numbers do not shift.
        """
        return state[0], np.where(over, FINISHED, state[1])

    def advance(
        self,
        observation: NDArray[Any] | dict[str, NDArray[Any]],
        state: tuple[NDArray[Any], ...] | None,
        episode_start: NDArray[Any] | None,
    ) -> tuple[NDArray[np.float32], NDArray[np.float32], bool]:
        """Q-values (S, actions), next hidden state (S, H), and whether there was one bare slot."""
        flat, single = self._flatten(observation)
        hidden, previous = self._copy_memory(state, episode_start, len(flat))
        if self.q_net.input_mean.is_cpu:  # self.device would walk all parameters
            return self._actor.decide(flat, previous, hidden), hidden, single
        return *decide_on_device(self.q_net, flat, previous, hidden), single

    def _flatten(
        self, observation: NDArray[Any] | dict[str, NDArray[Any]]
    ) -> tuple[NDArray[np.float32], bool]:
        """Observations (S, n) of all slots, and whether there was one bare slot."""
        observation, shape = np.asarray(observation), self.observation_space.shape
        single = observation.shape == shape
        slots = 1 if single else len(observation)
        if not single and observation.shape[1:] != shape:
            raise InputError(
                f"observation of shape {observation.shape} does not fit the observation space: "
                f"give {shape}, or (slots, *{shape})"
            )
        if slots % len(self.individuals):
            raise InputError(
                f"{slots} slots cannot be dealt to the {len(self.individuals)} individuals "
                f"{self.individuals}: give the observations of all of them, copy by copy"
            )
        return np.ascontiguousarray(observation.reshape(slots, -1), dtype=np.float32), single

    def _copy_memory(
        self,
        state: tuple[NDArray[Any], ...] | None,
        episode_start: NDArray[Any] | None,
        slots: int,
    ) -> State:
        """Copy the memory, without that of slots whose episode begins."""
        if state is None:
            return self.initial_state(slots)
        units, none = self.q_net.units, self.num_actions
        hidden = np.array(state[0], dtype=np.float32, order="C")
        previous = np.array(state[1], dtype=np.int64, order="C")
        if hidden.shape != (slots, units) or previous.shape != (slots,):
            raise InputError(
                f"a state of shapes {hidden.shape} and {previous.shape} does not fit {slots} slots "
                f"of {units} units: give the one that the last call returned"
            )
        given = previous[previous != FINISHED]
        if len(given) and not 0 <= given.min() <= given.max() <= none:
            raise InputError(
                f"previous actions run from {given.min()} to {given.max()}: they must lie in "
                f"0 .. {none - 1}, or be {none} for none"
            )
        if episode_start is not None:
            begins = np.asarray(episode_start, dtype=bool)
            hidden[begins], previous[begins] = 0.0, none
        return hidden, previous

    def choose(self, q_values: NDArray[np.float32], deterministic: bool) -> Ints:
        """Actions (S,) for Q-values (S, actions): greedy, or by the acting rule, one draw each."""
        if deterministic:
            greedy: Ints = q_values.argmax(1)
            return greedy
        draw = self.generator.random(len(q_values))
        return self.acting.choose(q_values, draw, len(self.individuals))

    def _predict(self, observation: PyTorchObs, deterministic: bool = True) -> torch.Tensor:
        """Actions at the start of an episode, for observations (S, *shape)."""
        assert isinstance(observation, torch.Tensor)
        q_values, _, _ = self.advance(observation.cpu().numpy(), None, None)
        return torch.from_numpy(self.choose(q_values, deterministic))

    forward = _predict

    def _get_constructor_parameters(self) -> dict[str, Any]:
        spaces_ = {"observation_space": self.observation_space, "action_space": self.action_space}
        rule = {"lr_schedule": self._dummy_schedule, "acting": self.acting}
        return spaces_ | rule | self._arguments


TRAINING_ONLY_SETTINGS = field_types(PolicySettings).keys() - field_types(NetworkSettings).keys()


class MlpPolicy(GruPolicy):
    """The feed-forward twin of :class:`GruPolicy`: the same layers without the GRU.

    It reacts to the present observation alone unless ``previous_action=True``.
    """

    recurrent: ClassVar[bool] = False


def decide_on_device(
    network: StackedQNetwork,
    observation: NDArray[np.float32],
    previous: Ints,
    hidden: NDArray[np.float32],
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Q-values (S, actions) and next hidden state (S, H), where the network is not on the CPU."""
    individuals, device = len(network.individuals), network.input_mean.device

    def stacked(array: NDArray[Any]) -> torch.Tensor:
        shaped = array.reshape(-1, individuals, *array.shape[1:])
        return torch.from_numpy(shaped).to(device).transpose(0, 1)

    some = np.where(previous == FINISHED, 0, previous)
    results = network.step(stacked(observation), stacked(some), stacked(hidden))
    q_values, state = (each.transpose(0, 1).flatten(0, 1).cpu().numpy() for each in results)
    return q_values, state


@torch.no_grad()
def zero_value_stream(network: StackedQNetwork) -> None:
    """Set V of the dueling head to 0, which leaves the policy ``softmax Q`` unchanged.

    V adds the same to all actions, so cloning leaves it arbitrary (-100 has been seen). Temporal
    differences that start from there go into V and spoil the policy: call this between cloning and
    the first of them.
    """
    value = network.dueling.value
    value.weight.zero_()
    value.bias.zero_()


# -- one decision of every slot as a compiled loop, for float32 on the CPU ------------------------
#
# The same equations as ``StackedQNetwork.step``, slot by slot; a decision through tensor operations
# spends most of its time starting them.

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
    """Compute the dueling head's hidden layer for one row; the treatment flag is its last input."""
    affine(head, features, weight, bias)
    if flagged:
        for j in range(len(head)):
            head[j] += flag * weight[len(features), j]
    rectify(head)


@jit(fastmath={"contract", "nsz"})
def _decide(  # type: ignore[no-untyped-def]
    observation,
    previous_action,
    hidden,
    q_values,
    settings,
    statistics,
    encoder_weights,
    encoder_biases,
    dueling,
    gru,
    scratch,
):
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
        previous_actions: Ints,
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
