"""The networks of Tsutsui et al. (2024, eLife), as published with their recorded agents.

Duelling networks of torch state dicts, read with ``weights_only=True``: ``fc_common`` 18 to 64 to
64 units, ``fc_state`` and ``fc_advantage`` over 32 units each, ReLU. What they see is their
authors' own: every relative position and every velocity is turned by the angle of the individual's
own position vector; partner and opponent follow, each with its position, relative position and
velocity. They act greedily.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from animarl_algos.learner.checkpoint import load_tensors, summarise_error
from animarl_envs.errors import InputError
from animarl_envs.species import AGENT
from animarl_envs.worlds.chase.layout import observation_components

Floats = NDArray[np.float64]

FILES = ("p1", "p2", "e")  # the two predators and the prey
SPEED = "2.4"
INPUTS, UNITS, STREAM, ACTIONS = 18, 64, 32, 13
SHAPES = {
    "fc_common.0": (UNITS, INPUTS), "fc_common.2": (UNITS, UNITS),
    "fc_state.0": (STREAM, UNITS), "fc_state.2": (1, STREAM),
    "fc_advantage.0": (STREAM, UNITS), "fc_advantage.2": (ACTIONS, STREAM),
}  # fmt: skip
SEEN = (
    "own position x", "own velocity x",
    "other 1 position x", "other 1 velocity x", "other 2 position x", "other 2 velocity x",
)  # fmt: skip
PREDATORS = 2


@dataclass(frozen=True, eq=False)
class PublishedTeam:
    """Two predators and their prey; ``networks`` holds the weights of each by layer."""

    networks: tuple[dict[str, Floats], ...]

    @classmethod
    def load(cls, folder: Path) -> PublishedTeam:
        """Read ``p1_2.4.pth``, ``p2_2.4.pth`` and ``e_2.4.pth``.

        Raises
        ------
        InputError
            If a file is missing, damaged, or holds anything but such a network.
        """
        return cls(tuple(_network(folder / f"{name}_{SPEED}.pth") for name in FILES))

    def predict(
        self,
        observation: NDArray[np.floating],
        state: Any = None,
        episode_start: Any = None,
        deterministic: bool = False,
    ) -> tuple[NDArray[np.int64], Any]:
        """Greedy actions ``(slots,)`` from the full observations of a chase ``(slots, n)``."""
        seen = _in_the_arena(np.asarray(observation, dtype=np.float64))
        actions = np.empty(len(seen), dtype=np.int64)
        for k, network in enumerate(self.networks):
            own = slice(k, None, len(self.networks))
            values = action_values(network, inputs(seen[own], prey=k == PREDATORS))
            actions[own] = values.argmax(axis=1)
        return actions, state


def action_values(network: dict[str, Floats], inputs: Floats) -> Floats:
    """Q-values ``(rows, 13)`` for inputs ``(rows, 18)``."""

    def layer(name: str, x: Floats) -> Floats:
        return np.asarray(x @ network[f"{name}.weight"].T + network[f"{name}.bias"])

    def relu(x: Floats) -> Floats:
        return np.maximum(x, 0.0)

    shared = relu(layer("fc_common.2", relu(layer("fc_common.0", inputs))))
    state = layer("fc_state.2", relu(layer("fc_state.0", shared)))
    advantage = layer("fc_advantage.2", relu(layer("fc_advantage.0", shared)))
    return np.asarray(state + advantage - advantage.mean(axis=1, keepdims=True))


def inputs(seen: Floats, *, prey: bool) -> Floats:
    """The 18 inputs of the published networks, ``(rows, 18)``.

    ``seen`` is ``(rows, 6, 2)``, arena frame: own position and velocity, then position and velocity
    of the focus and of the third. A predator's partner comes before its opponent, the prey; of the
    prey the nearer predator comes first.
    """
    place, velocity = seen[:, 0], seen[:, 1]
    focus, third = (seen[:, 2], seen[:, 3]), (seen[:, 4], seen[:, 5])
    angle = np.arctan2(place[:, 1], place[:, 0])
    cosine, sine = np.cos(angle), np.sin(angle)

    def turned(v: Floats) -> Floats:
        return np.stack(
            [cosine * v[:, 0] - sine * v[:, 1], sine * v[:, 0] + cosine * v[:, 1]], axis=1
        )

    parts = [place, turned(velocity), turned(velocity)]
    for where, moving in (focus, third) if prey else (third, focus):
        parts += [where, turned(where - place), turned(moving)]
    return np.concatenate(parts, axis=1)


def _in_the_arena(observation: Floats) -> Floats:
    """Positions and velocities of full observations, ``(rows, 6, 2)``, arena frame."""
    components = observation_components(AGENT)
    if observation.shape[-1] != len(components):
        raise InputError(
            f"the published networks need the {len(components)} components of the full "
            f"observation of two predators and a prey, not {observation.shape[-1]}"
        )
    named = {(c.name, c.frame): i for i, c in enumerate(components) if c.frame == "arena"}
    first = np.array([named[name, "arena"] for name in SEEN])
    return observation[:, first[:, None] + np.arange(2)]


def _network(file: Path) -> dict[str, Floats]:
    try:
        loaded = load_tensors(file)
        return {
            f"{name}.{part}": _checked(loaded, f"{name}.{part}", shape)
            for name, whole in SHAPES.items()
            for part, shape in (("weight", whole), ("bias", whole[:1]))
        }
    except OSError:
        raise InputError(
            f"{file}: it cannot be read: give the folder of the published weights, with "
            "indiv/p1_2.4.pth and so on"
        ) from None
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise InputError(
            f"{file}: it is no network of the recorded agents ({summarise_error(error)}): "
            "copy it again"
        ) from None


def _checked(loaded: Any, name: str, shape: tuple[int, ...]) -> Floats:
    values = np.asarray(loaded[name].numpy(), dtype=np.float64)
    if values.shape != shape or not np.isfinite(values).all():
        raise ValueError(f"{name} has shape {values.shape}, not {shape}")
    return values
