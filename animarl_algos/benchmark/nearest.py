"""Replaying the nearest recorded segment: the simulator that learns nothing and forgets nothing.

Every individual looks up, among the training frames of its own and of the episode's condition, one
of the ``NEIGHBOURS`` whose observations are nearest to what it sees, and does for ``SEGMENT``
seconds what was done from there.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.errors import InputError
from animarl_envs.fitting.transitions import demonstrated_actions
from animarl_envs.species import Species
from animarl_envs.worlds import demonstration_observations

SEGMENT = 1.0  # [s]
NEIGHBOURS = 5  # one of them is drawn, so that rollouts of a start differ


class Library(NamedTuple):
    """The frames of one individual and condition.

    ``frames`` ``(n,)`` are their places among all, ``scale`` ``(components,)`` makes what is
    observed comparable.
    """

    tree: cKDTree
    frames: NDArray[np.int64]
    scale: NDArray[np.float64]


class NearestSegment:
    """A policy of stable-baselines3's ``predict``; observations end with the condition.

    Parameters
    ----------
    species
        Its locomotion tells the recorded actions.
    demos
        With their splits; those of the split train are looked up.
    seed
        Of the draws among neighbours.
    """

    def __init__(self, species: Species, demos: Demonstrations, seed: int) -> None:
        train = demos.select(split="train")
        seen = demonstration_observations(species, train).astype(np.float64)
        self._actions = demonstrated_actions(train, species.locomotion).astype(np.int64)
        going = self._actions[:, 0] >= 0  # no last frame
        condition = np.repeat(train.condition, train.lengths)
        self._libraries: dict[tuple[int, int], Library] = {}
        for who in range(seen.shape[1]):
            spread = seen[going, who].std(axis=0)
            scale = np.divide(1.0, spread, out=np.zeros_like(spread), where=spread > 0)
            for of in np.unique(condition).tolist():
                frames = np.flatnonzero(going & (condition == of))
                tree = cKDTree(seen[frames, who] * scale)
                self._libraries[who, of] = Library(tree, frames, scale)
        self._name, self._individuals = demos.name, seen.shape[1]
        self._rng = np.random.default_rng(seed)
        self._steps = max(1, round(SEGMENT / species.dt))

    def predict(
        self,
        observation: NDArray[np.floating],
        state: tuple[NDArray[np.int64], NDArray[np.int64]] | None = None,
        episode_start: Any = None,
        deterministic: bool = False,
    ) -> tuple[NDArray[np.int64], tuple[NDArray[np.int64], NDArray[np.int64]]]:
        """One action per slot; the state is the frame that each is at and the steps left of it."""
        slots = len(observation)
        who = np.arange(slots) % self._individuals
        if state is None:
            frame, left = np.zeros(slots, dtype=np.int64), np.zeros(slots, dtype=np.int64)
        else:
            frame, left = state[0] + 1, state[1] - 1
        anew = (left == 0) | (self._actions[frame, who] < 0)
        if episode_start is not None:
            anew |= np.asarray(episode_start, dtype=bool)
        condition = observation[:, -1].astype(np.int64)
        for own, of in {(int(w), int(c)) for w, c in zip(who[anew], condition[anew])}:
            asking = np.flatnonzero(anew & (who == own) & (condition == of))
            frame[asking] = self._looked_up(own, of, observation[asking, :-1])
            left[asking] = self._steps
        return self._actions[frame, who], (frame, left)

    def _looked_up(self, who: int, condition: int, seen: NDArray[np.floating]) -> Any:
        """A frame for each row of observations."""
        if (who, condition) not in self._libraries:
            raise InputError(
                f"{self._name}: no training episode is of condition {condition}: deal the splits "
                "anew, or leave 'nearest' out of the references"
            )
        tree, frames, scale = self._libraries[who, condition]
        among = min(NEIGHBOURS, len(frames))
        near = np.reshape(tree.query(seen * scale, k=among)[1], (len(seen), among))
        drawn = self._rng.integers(among, size=len(seen))
        return frames[near[np.arange(len(seen)), drawn]]
