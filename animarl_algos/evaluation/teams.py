"""Teams that made demonstrations: what artificial agents of either condition do from any start.

For artificial agents a counterfactual has a truth: the networks that were trained under the other
condition, let loose from the same starts. Those of the packaged chases come with the package. Those
of the public recordings (Tsutsui et al. 2024) are read from the folder of their weights.
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

from animarl_algos.evaluation.collect import Policy, collect_rollouts
from animarl_algos.evaluation.published_networks import PublishedTeam
from animarl_algos.evaluation.rollouts import Rollouts
from animarl_algos.networks.policies import MlpPolicy
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.errors import InputError
from animarl_envs.files import read_npz
from animarl_envs.locomotion import Locomotion
from animarl_envs.scenario import make_scenario
from animarl_envs.species import AGENT, ChaseSpecies, Species
from animarl_envs.worlds import make_world
from animarl_envs.worlds.chase.layout import PAPER, observation_components

META = "meta"
FOLDERS = ("indiv", "share")  # of the published weights, by condition


@dataclass(frozen=True, eq=False, kw_only=True)
class Team:
    """All individuals of one condition as they were trained.

    Parameters
    ----------
    policy
        Moves everybody.
    locomotion
        That they were trained with, one per individual.
    observation
        What the policy sees: ``"full"`` or ``"paper"``.
    reseed
        Seeds its own randomness; None for one that has none.
    """

    policy: Policy
    locomotion: tuple[Locomotion, ...]
    observation: str
    reseed: Callable[[int], None] | None = None

    def roll_out(
        self, species: Species, demos: Demonstrations, *, name: str, seed: int, repetitions: int
    ) -> Rollouts:
        """From every start of ``demos``, in the world of ``species`` with the team's locomotion.

        A team without randomness of its own does the same again and again, so it does it once.
        """
        world = replace(species, locomotion=self.locomotion, observation=self.observation)
        return collect_rollouts(
            partial(make_world, make_scenario(world, demos=demos, split=None)),
            self.policy,
            method=name,
            seed=seed,
            repetitions=1 if self.reseed is None else repetitions,
            reseed=self.reseed,
        )


def teams_of(demos: Demonstrations, folder: Path | None = None) -> tuple[Team, Team] | None:
    """The teams of condition 0 and 1 behind demonstrations; None where they are not known.

    Parameters
    ----------
    folder
        Weights of the recorded agents, ``indiv/p1_2.4.pth`` and so on; without it the packaged
        teams, if the demonstrations say that they were made by these.
    """
    if folder is not None:
        return _published(folder, demos)
    from animarl_envs.demos.packaged import packaged_team

    packaged = [load_weights(packaged_team(name)) for name in AGENT.conditions]
    made_by = demos.provenance.get("trained")
    if made_by != dict(zip(AGENT.conditions, (meta for _, meta in packaged))):
        return None
    epsilon = float(demos.provenance["epsilon"])
    first, second = (_packaged(weights, epsilon) for weights, _ in packaged)
    return first, second


# -- the packaged ones ----------------------------------------------------------------------------


def trained_species() -> ChaseSpecies:
    """The species that the packaged teams were trained as."""
    return replace(AGENT, observation=PAPER)


def load_weights(file: Path) -> tuple[dict[str, NDArray[np.float32]], dict[str, object]]:
    """Weights by the name of their layer, each ``(individuals, ...)``, and how they were made.

    Raises
    ------
    InputError
        If the file is missing, damaged or no file of weights.
    """
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
    weights: dict[str, NDArray[np.float32]] | None, *, epsilon: float, seed: int
) -> MlpPolicy:
    """The networks of all individuals, epsilon-greedy; untrained where no weights are given.

    Raises
    ------
    InputError
        If the weights do not fit the networks.
    """
    species = trained_species()
    size = len(observation_components(species))
    policy = MlpPolicy(
        Box(-np.inf, np.inf, (size,), np.float32),
        Discrete(species.num_actions),
        lambda _: 1.0,
        individuals=AGENT.individuals,
        epsilon=epsilon,
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


def _packaged(weights: dict[str, NDArray[np.float32]], epsilon: float) -> Team:
    policy = make_policy(weights, epsilon=epsilon, seed=0)
    return Team(policy=policy, locomotion=AGENT.locomotion, observation=PAPER, reseed=policy.seed)


# -- the published ones ---------------------------------------------------------------------------


def _published(folder: Path, demos: Demonstrations) -> tuple[Team, Team]:
    made: list[Team] = []
    locomotion = published_locomotion(demos)
    for condition in FOLDERS:
        policy = PublishedTeam.load(folder / condition)
        made.append(Team(policy=policy, locomotion=locomotion, observation="full"))
    return made[0], made[1]


def published_locomotion(demos: Demonstrations) -> tuple[Locomotion, ...]:
    """The exact locomotion that the recorded agents' files state.

    Raises
    ------
    InputError
        If the demonstrations were not read from such files.
    """
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
        return next((found for one in provenance if (found := _stated(one)) is not None), None)
    return None
