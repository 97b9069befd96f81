"""Slots of a vectorised environment: their observations and memories, dealt to individuals.

With K individuals slot s is of copy ``s // K`` and individual ``s % K``.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from animarl_algos.networks.networks import StackedQNetwork
from animarl_envs.errors import InputError

State = tuple[NDArray[np.float32], NDArray[np.int64]]
"""Hidden state (S, H) and previous action (S,)."""
GONE = np.iinfo(np.int64).min
"""In the place of a previous action: this slot's episode is over, nothing is worked out for it."""


def flattened(
    observation: NDArray[Any] | dict[str, NDArray[Any]],
    shape: tuple[int, ...] | None,
    individuals: tuple[str, ...],
) -> tuple[NDArray[np.float32], bool]:
    """Observations (S, n) of all slots, and whether there was one bare slot of that shape."""
    observation = np.asarray(observation)
    single = observation.shape == shape
    slots = 1 if single else len(observation)
    if not single and observation.shape[1:] != shape:
        raise InputError(
            f"observation of shape {observation.shape} does not fit the observation space: "
            f"give {shape}, or (slots, *{shape})"
        )
    if slots % len(individuals):
        raise InputError(
            f"{slots} slots cannot be dealt to the {len(individuals)} individuals "
            f"{individuals}: give the observations of all of them, copy by copy"
        )
    return np.ascontiguousarray(observation.reshape(slots, -1), dtype=np.float32), single


def remembered(
    state: tuple[NDArray[Any], ...],
    episode_start: NDArray[Any] | None,
    slots: int,
    units: int,
    num_actions: int,
) -> State:
    """A copy of the memory, without that of slots whose episode begins."""
    hidden = np.array(state[0], dtype=np.float32, order="C")
    previous = np.array(state[1], dtype=np.int64, order="C")
    if hidden.shape != (slots, units) or previous.shape != (slots,):
        raise InputError(
            f"a state of shapes {hidden.shape} and {previous.shape} does not fit {slots} slots "
            f"of {units} units: give the one that the last call returned"
        )
    told = previous[previous != GONE]
    if len(told) and not 0 <= told.min() <= told.max() <= num_actions:
        raise InputError(
            f"previous actions run from {told.min()} to {told.max()}: they must lie in "
            f"0 .. {num_actions - 1}, or be {num_actions} for none"
        )
    if episode_start is not None:
        begins = np.asarray(episode_start, dtype=bool)
        hidden[begins], previous[begins] = 0.0, num_actions
    return hidden, previous


def decide_on_device(
    network: StackedQNetwork,
    observation: NDArray[np.float32],
    previous: NDArray[np.int64],
    hidden: NDArray[np.float32],
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Q-values (S, actions) and next hidden state (S, H), where the network is not on the CPU."""
    individuals, device = len(network.individuals), network.input_mean.device

    def stacked(array: NDArray[Any]) -> torch.Tensor:
        shaped = array.reshape(-1, individuals, *array.shape[1:])
        return torch.from_numpy(shaped).to(device).transpose(0, 1)

    def slots(tensor: torch.Tensor) -> NDArray[Any]:
        array: NDArray[Any] = tensor.transpose(0, 1).flatten(0, 1).cpu().numpy()
        return array

    some = np.where(previous == GONE, 0, previous)
    q_values, state = network.step(stacked(observation), stacked(some), stacked(hidden))
    return slots(q_values), slots(state)
