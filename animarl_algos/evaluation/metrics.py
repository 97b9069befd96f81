"""What is measured of each episode: return, path length, duration, and DTW to the demonstration."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from animarl_algos.evaluation.rollouts import Rollouts
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.dtw import dtw_distance
from animarl_envs.errors import InputError

if TYPE_CHECKING:
    import pandas as pd

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Metric:
    """A column of the metrics table, as figures and tables name it."""

    key: str
    label: str
    unit: str
    of_recordings: bool = True  # False: a comparison with them, which they lack themselves

    @property
    def axis(self) -> str:
        return f"{self.label} ({self.unit})" if self.unit else self.label


RETURN = Metric("return", "Target reached", "share of episodes")
PATH_LENGTH = Metric("path_length", "Path length", "arena units")
DURATION = Metric("duration", "Duration", "s")
DTW = Metric("dtw", "DTW distance", "arena units", of_recordings=False)
DTW_PER_STEP = Metric("dtw_per_step", "DTW distance per step", "arena units", of_recordings=False)
METRICS = (RETURN, PATH_LENGTH, DURATION, DTW, DTW_PER_STEP)


def path_lengths(rollouts: Rollouts) -> Floats:
    """Distance travelled by each individual, ``(rollouts, individuals)`` [arena unit]."""
    step = np.zeros(rollouts.positions.shape[:2])
    step[1:] = np.linalg.norm(np.diff(rollouts.positions, axis=0), axis=-1)
    step[rollouts.offsets[:-1]] = 0.0  # no step leads from one episode to the next
    return np.asarray(np.add.reduceat(step, rollouts.offsets[:-1], axis=0))


def dtw_distances(rollouts: Rollouts, demos: Demonstrations) -> Floats:
    """DTW distance of each individual's whole path to its demonstration's.

    Closed at both ends, Euclidean local cost, summed along the best warping path.

    Returns
    -------
    ``(rollouts, individuals)`` [arena unit].
    """
    offsets, out = demos.offsets, np.empty((len(rollouts), len(rollouts.individuals)))
    for i, demo in enumerate(rollouts.demo.tolist()):
        path = rollouts.path(i)
        recorded = demos.positions[offsets[demo] : offsets[demo + 1]]
        for k in range(out.shape[1]):
            out[i, k] = dtw_distance(
                np.ascontiguousarray(path[:, k]), np.ascontiguousarray(recorded[:, k])
            )
    return out


def measure(rollouts: Rollouts, demos: Demonstrations) -> pd.DataFrame:
    """One row per rollout, one column per metric.

    Parameters
    ----------
    rollouts
        Of one method; ``rollouts.demo`` counts the episodes of ``demos``.
    demos
        The evaluated set, the test split as a rule.

    Returns
    -------
    Columns ``method, seed, demo, repetition, condition, cue, outcome, captured`` and

    - ``return``: 1 if a pursuer reached the target (the moth the source), else 0;
    - ``path_length`` [arena unit]: mean over the pursuers, or the moth's;
    - ``duration`` [s];
    - ``dtw`` [arena unit]: mean over the pursuers of the DTW distance to the same individual of the
      demonstration; zero for the recordings;
    - ``dtw_per_step`` [arena unit]: ``dtw`` over the frames of the longer of the two paths, about
      the mean distance between aligned positions.

    Raises
    ------
    InputError
        If the rollouts are not of these demonstrations.
    """
    import pandas as pd

    if rollouts.individuals != demos.individuals or rollouts.demo.max() >= demos.num_episodes:
        raise InputError(
            f"the rollouts of {rollouts.method} were not made from {demos.name}: "
            "evaluate them against the demonstrations they started from"
        )
    movers = rollouts.movers
    dtw = dtw_distances(rollouts, demos)[:, movers].mean(axis=1)
    return pd.DataFrame(
        {
            "method": rollouts.method,
            "seed": rollouts.seed,
            "demo": rollouts.demo,
            "repetition": rollouts.repetition,
            "condition": rollouts.condition,
            "cue": rollouts.cue,
            "outcome": rollouts.outcome,
            "captured": rollouts.captured,
            RETURN.key: rollouts.captured.astype(float),
            PATH_LENGTH.key: path_lengths(rollouts)[:, movers].mean(axis=1),
            DURATION.key: (rollouts.lengths - 1) * rollouts.dt,
            DTW.key: dtw,
            DTW_PER_STEP.key: dtw / np.maximum(rollouts.lengths, demos.lengths[rollouts.demo]),
        }
    )


def measure_recordings(demos: Demonstrations) -> pd.DataFrame:
    """The same table for the recordings themselves, in the order of the episodes."""
    return measure(Rollouts.from_demonstrations(demos), demos)
