"""Teams that made demonstrations: what artificial agents of either condition do from any start.

For artificial agents a counterfactual has a truth: the networks that were trained under the other
condition, let loose from the same starts. Those of the packaged chases come with the package. Those
of the public recordings (Tsutsui et al. 2024, eLife) are read from the folder of their weights.
What these see is their authors' own: every relative position and every velocity is turned by the
angle of the individual's own position vector; partner and opponent follow, each with its position,
relative position and velocity. They act greedily.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from gymnasium.spaces import Box, Discrete
from numpy.typing import NDArray
from torch import nn

from animarl_algos.evaluation.collect import MemorylessPolicy, Policy, collect_rollouts
from animarl_algos.evaluation.rollouts import Rollouts
from animarl_algos.learner.checkpoint import load_tensors, summarise_error
from animarl_algos.networks.acting_rule import Acting
from animarl_algos.networks.policies import MlpPolicy
from animarl_envs.array_types import Floats, Ints
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.errors import InputError
from animarl_envs.files import read_npz
from animarl_envs.locomotion import Locomotion
from animarl_envs.scenario import make_scenario
from animarl_envs.species import AGENT, ChaseSpecies, Species
from animarl_envs.species.options import with_options
from animarl_envs.worlds import make_world
from animarl_envs.worlds.chase.layout import PAPER, observation_components

META = "meta"
FOLDERS = ("indiv", "share")  # of the published weights, by condition
FILES = ("p1_2.4.pth", "p2_2.4.pth", "e_2.4.pth")  # the two predators and the prey
SEEN = (
    "own position x",
    "own velocity x",
    "other 1 position x",
    "other 1 velocity x",
    "other 2 position x",
    "other 2 velocity x",
)


@dataclass(frozen=True, eq=False, kw_only=True)
class Team:
    """All individuals of one condition as they were trained.

    ``policy`` moves everybody with the ``locomotion`` that they were trained with, one per
    individual; it sees the ``"full"`` or the ``"paper"`` observation. ``reseed`` seeds its own
    randomness; None for one that has none.
    """

    policy: Policy
    locomotion: tuple[Locomotion, ...]
    observation: str
    reseed: Callable[[int], None] | None = None

    def embody(self, species: Species) -> Species:
        """Return a species with the locomotion and the observation of the team."""
        return replace(species, locomotion=self.locomotion, observation=self.observation)

    def roll_out(
        self, species: Species, demos: Demonstrations, *, name: str, seed: int, repetitions: int
    ) -> Rollouts:
        """Return rollouts from every start of ``demos`` in the world of an embodied species.

        A team without randomness of its own repeats itself, so it is simulated once.
        """
        return collect_rollouts(
            partial(make_world, make_scenario(species, demos=demos, split=None)),
            self.policy,
            method=name,
            seed=seed,
            repetitions=1 if self.reseed is None else repetitions,
            reseed=self.reseed,
        )


def roll_out_teams(
    teams: tuple[Team, Team],
    species: Species,
    demos: Demonstrations,
    *,
    name: str,
    seed: int,
    repetitions: int,
    condition: int | None = None,
) -> Rollouts:
    """Return rollouts of the team of each start's condition, or of one condition.

    ``species`` has the locomotion and the observation of the teams (:meth:`Team.embody`).
    """
    parts = []
    for own in np.unique(demos.condition).tolist():
        starts = np.flatnonzero(demos.condition == own)
        made = teams[own if condition is None else condition].roll_out(
            species,
            demos.select(episodes=starts),
            name=name,
            seed=seed,
            repetitions=repetitions,
        )
        parts.append(replace(made, demo=starts[made.demo]))
    return Rollouts.concatenate(parts, name)


def teams_of(demos: Demonstrations, folder: Path | None = None) -> tuple[Team, Team] | None:
    """The teams of condition 0 and 1 behind demonstrations; None where they are not known.

    ``folder`` has the weights of the recorded agents, ``indiv/p1_2.4.pth`` and so on; without it
    the packaged teams, if the demonstrations say that they were made by these.

    Raises InputError if a file is missing, damaged, or of other networks, or the weights are of
    other agents.
    """
    if folder is not None:
        locomotion = _stated_locomotion(demos)
        made = [
            Team(
                policy=PublishedTeam.load(folder / name), locomotion=locomotion, observation="full"
            )
            for name in FOLDERS
        ]
        return made[0], made[1]
    from animarl_envs.demos.packaged import packaged_team

    packaged = [load_weights(packaged_team(name)) for name in AGENT.conditions]
    made_by = demos.provenance.get("trained")
    if made_by != dict(zip(AGENT.conditions, (meta for _, meta in packaged))):
        return None
    epsilon = float(demos.provenance["epsilon"])
    policies = [make_policy(weights, epsilon=epsilon, seed=0) for weights, _ in packaged]
    first, second = (
        Team(policy=one, locomotion=AGENT.locomotion, observation=PAPER, reseed=one.seed)
        for one in policies
    )
    return first, second


# -- the packaged ones ----------------------------------------------------------------------------


def trained_species(pursuers: int = 2) -> ChaseSpecies:
    """The species that the packaged teams were trained as, or one of so many pursuers."""
    species = with_options(AGENT, observation=PAPER, num_pursuers=pursuers)
    assert isinstance(species, ChaseSpecies)
    return species


def load_weights(file: Path) -> tuple[dict[str, NDArray[np.float32]], dict[str, object]]:
    """Weights by the name of their layer, each ``(individuals, ...)``, and how they were made."""
    arrays = read_npz(file)
    try:
        meta = json.loads(str(arrays.pop(META)))
    except (KeyError, ValueError):
        raise InputError(
            f"{file}: it holds no weights of trained agents: make them with "
            "python -m tools.packaged_data.trained_chase make"
        ) from None
    return arrays, dict(meta)


def make_policy(
    weights: dict[str, NDArray[np.float32]] | None, *, epsilon: float, seed: int, pursuers: int = 2
) -> MlpPolicy:
    """The networks of all individuals, epsilon-greedy; untrained where no weights are given."""
    species = trained_species(pursuers)
    size = len(observation_components(species))
    policy = MlpPolicy(
        Box(-np.inf, np.inf, (size,), np.float32),
        Discrete(species.num_actions),
        lambda _: 1.0,
        individuals=species.individuals,
        acting=Acting.epsilon_greedy(epsilon),
        seed=seed,
    )
    if weights is not None:
        # Files of weights hold none of the input's scales: these networks take inputs as they are.
        given = {name: torch.from_numpy(value) for name, value in weights.items()}
        scales = {k: v for k, v in policy.q_net.state_dict().items() if k.startswith("input_")}
        try:
            policy.q_net.load_state_dict(scales | given)
        except (RuntimeError, TypeError) as error:
            first = str(error).splitlines()[0]
            raise InputError(f"the weights do not fit the agents' networks ({first})") from None
    return policy


# -- the published ones ---------------------------------------------------------------------------


class PublishedNetwork(nn.Module):
    """Duelling network of 18 inputs and 13 actions, its layers named as in the published files."""

    def __init__(self) -> None:
        super().__init__()
        self.fc_common = _two_layers(18, 64, 64)
        self.fc_state, self.fc_advantage = _two_layers(64, 32, 1), _two_layers(64, 32, 13)
        self.double()

    def forward(self, inputs: torch.Tensor) -> torch.Tensor:
        """Action values ``(rows, 13)``."""
        shared = torch.relu(self.fc_common(inputs))
        advantage = self.fc_advantage(shared)
        values: torch.Tensor = self.fc_state(shared) + advantage - advantage.mean(1, keepdim=True)
        return values


def _two_layers(inputs: int, units: int, outputs: int) -> nn.Sequential:
    return nn.Sequential(nn.Linear(inputs, units), nn.ReLU(), nn.Linear(units, outputs))


@dataclass(frozen=True, eq=False)
class PublishedTeam(MemorylessPolicy):
    """Two predators and their prey."""

    networks: tuple[PublishedNetwork, ...]

    @classmethod
    def load(cls, folder: Path) -> PublishedTeam:
        """Read ``p1_2.4.pth``, ``p2_2.4.pth`` and ``e_2.4.pth``, or raise InputError."""
        return cls(tuple(_load_network(folder / name) for name in FILES))

    def act(self, observation: NDArray[np.floating]) -> Ints:
        """Greedy actions ``(slots,)`` from the full observations of a chase ``(slots, n)``."""
        components = observation_components(AGENT)
        if observation.shape[-1] != len(components):
            raise InputError(
                f"the published networks need the {len(components)} components of the full "
                f"observation of two predators and a prey, not {observation.shape[-1]}"
            )
        named = {c.name: i for i, c in enumerate(components) if c.frame == "arena"}
        first = np.array([named[name] for name in SEEN])
        seen = observation[:, first[:, None] + np.arange(2)].astype(np.float64)
        actions = np.empty(len(seen), dtype=np.int64)
        for k, network in enumerate(self.networks):
            own = slice(k, None, len(self.networks))
            with torch.no_grad():
                values = network(torch.from_numpy(_inputs(seen[own], prey=k == 2)))
            actions[own] = values.argmax(dim=1).numpy()
        return actions


def _inputs(seen: Floats, *, prey: bool) -> Floats:
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


def _load_network(file: Path) -> PublishedNetwork:
    network = PublishedNetwork()
    try:
        loaded = load_tensors(file)
        for name, own in network.state_dict().items():
            if loaded[name].shape != own.shape or not loaded[name].isfinite().all():
                shapes = f"has shape {tuple(loaded[name].shape)}, not {tuple(own.shape)}"
                raise ValueError(f"{name} {shapes}, or a weight is not finite")
            own.copy_(loaded[name])
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
    return network


def _stated_locomotion(demos: Demonstrations) -> tuple[Locomotion, ...]:
    """The exact locomotion that the recorded agents' files state."""
    meta: Any = _stated(demos.provenance)
    try:
        damping = float(meta["damping"])
        speeds = (meta["speed_pred"], meta["speed_pred"], meta["speed_prey"])
        return tuple(Locomotion(damping, float(speed)) for speed in speeds)
    except (KeyError, TypeError, ValueError):
        raise InputError(
            f"{demos.name}: it does not say by which agents it was made: these weights belong to "
            "recordings read from episodes_*.npz of collaborative hunting"
        ) from None


def _stated(provenance: Any) -> Any:
    """The ``meta`` of the agents' reader, also within what several files were joined from."""
    if isinstance(provenance, Mapping):
        if isinstance(meta := provenance.get("meta"), Mapping) and "speed_pred" in meta:
            return meta
        provenance = list(provenance.values())
    if isinstance(provenance, list | tuple):
        return next((team for one in provenance if (team := _stated(one)) is not None), None)
    return None
