"""Searches in numbers: how often, how long, how far, how fast, and how sharply turned.

Recorded and simulated searches go through the same functions, at the decision rate of 2 Hz. The
heading of a simulated moth is its direction of travel, so turning is that of the direction of
travel for both, between steps at which it moves faster than ``MOVING``.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.errors import InputError
from animarl_envs.species import SearchSpecies
from animarl_envs.worlds.search.programmed_moth import MothProgramme
from tools.packaged_data.moth_searches import Searches, search

MOVING = 0.001  # slower than this a direction of travel is noise [m / s]
RESTING = 0.002  # a moth slower than this rests [m / s]
QUARTILES = (0.25, 0.5, 0.75)
SPEED_QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95, 0.99)
TURNING_QUANTILES = (0.25, 0.5, 0.75, 0.9)


@dataclass(frozen=True, eq=False)
class SearchStatistics:
    """What is compared of ``n`` searches.

    Attributes
    ----------
    reached
        ``(n,)`` bool.
    duration
        ``(n,)`` [s]; the time limit where the source was not reached.
    path
        ``(n,)``, way walked [m], at one sample per decision step.
    speed
        ``(steps,)`` of all searches [m / s].
    turning
        ``(m,)``, absolute rate of turning of the direction of travel while moving [rad / s].
    """

    reached: NDArray[np.bool_]
    duration: NDArray[np.float64]
    path: NDArray[np.float64]
    speed: NDArray[np.float64]
    turning: NDArray[np.float64]

    @property
    def rate(self) -> float:
        """Share of searches that reached the source."""
        return float(self.reached.mean())

    @property
    def resting(self) -> float:
        """Share of steps slower than ``RESTING``."""
        return float((self.speed < RESTING).mean())

    def interval(self) -> tuple[float, float]:
        """95 % Wilson interval of the rate."""
        n, p, z = len(self.reached), self.rate, 1.96
        middle = (p + z * z / (2 * n)) / (1 + z * z / n)
        half = z / (1 + z * z / n) * math.sqrt(p * (1 - p) / n + z * z / (4 * n * n))
        return middle - half, middle + half


def describe(
    tracks: Sequence[NDArray[np.float64]], reached: NDArray[np.bool_], dt: float
) -> SearchStatistics:
    """Statistics of searches along ``tracks``, each ``(frames, 2)`` [m], ``dt`` apart [s]."""
    speeds, turning = [], []
    for track in tracks:
        velocity = np.diff(track, axis=0) / dt
        speed = np.linalg.norm(velocity, axis=1)
        angle = np.diff(np.arctan2(velocity[:, 1], velocity[:, 0]))
        moving = (speed[1:] > MOVING) & (speed[:-1] > MOVING)
        speeds.append(speed)
        turning.append(np.abs((angle[moving] + np.pi) % (2 * np.pi) - np.pi) / dt)
    return SearchStatistics(
        np.asarray(reached, dtype=bool),
        np.array([(len(track) - 1) * dt for track in tracks]),
        np.array([speed.sum() * dt for speed in speeds]),
        np.concatenate(speeds),
        np.concatenate(turning),
    )


def of_searches(searches: Searches) -> SearchStatistics:
    """Statistics of simulated searches."""
    return describe(searches.tracks(), searches.reached, searches.dt)


def search_statistics(
    species: SearchSpecies,
    condition: int,
    *,
    episodes: int,
    seed: int | list[int],
    programme: MothProgramme | None = None,
) -> SearchStatistics:
    """How programmed moths fare in the plumes of ``species.train_plumes``."""
    return of_searches(
        search(species, condition, episodes=episodes, seed=seed, programme=programme)
    )


def of_demonstrations(demos: Demonstrations) -> SearchStatistics:
    """Statistics of demonstrations of one searcher."""
    tracks = [episode.positions[:, 0] for episode in demos]
    return describe(tracks, demos.outcome == 1, demos.dt)


def recorded_moths(folder: Path) -> Demonstrations:
    """The recorded runs in ``folder/raw``, imported as ``animarl import --source mothvr`` does."""
    from animarl_envs.importing.readers import default_recipe, follow, get_reader

    files = sorted((folder / "raw").glob("*.csv"))
    if not files:
        raise InputError(f"{folder}: it holds no raw/*.csv: name the folder of recorded moths")
    return follow(default_recipe(get_reader("mothvr")), files)


def recorded_statistics(folder: Path) -> SearchStatistics:
    """Statistics of the recorded runs in ``folder/raw``."""
    return of_demonstrations(recorded_moths(folder))


def wasserstein(one: NDArray[np.float64], other: NDArray[np.float64]) -> float:
    """Wasserstein distance of two samples, in their unit."""
    shares = (np.arange(1000) + 0.5) / 1000
    return float(np.abs(np.quantile(one, shares) - np.quantile(other, shares)).mean())
