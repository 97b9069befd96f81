"""What is measured of each episode, and where it is shown: all there is to say about a metric.

A new metric is one entry in ``METRICS``. The table of episodes, the comparison with the recordings,
the report's figures, tables and sentences and the table in the terminal all follow the entries.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from animarl_algos.evaluation.rollouts import Rollouts
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.dtw import dtw_alignment
from animarl_envs.errors import InputError

if TYPE_CHECKING:
    import pandas as pd

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Episodes:
    """What metrics are worked out from: rollouts and the demonstrations they started from."""

    rollouts: Rollouts
    demos: Demonstrations

    @cached_property
    def dtw(self) -> Floats:
        """``(rollouts,)``: mean DTW distance of those who move by themselves [arena unit]."""
        return self._mean_over_movers(self._alignments[0])

    @cached_property
    def dtw_per_step(self) -> Floats:
        """``(rollouts,)``: mean of those who move, of the distance of aligned positions."""
        distance, pairs = self._alignments
        return self._mean_over_movers(distance / pairs)

    @property
    def path_length(self) -> Floats:
        """``(rollouts,)``: mean over those who move by themselves [arena unit]."""
        return self._mean_over_movers(path_lengths(self.rollouts))

    @property
    def duration(self) -> Floats:
        """``(rollouts,)`` [s]."""
        return np.asarray((self.rollouts.lengths - 1) * self.rollouts.dt, dtype=np.float64)

    @cached_property
    def _alignments(self) -> tuple[Floats, Floats]:
        return dtw_alignments(self.rollouts, self.demos)

    def _mean_over_movers(self, values: Floats) -> Floats:
        return np.asarray(values[:, self.rollouts.movers].mean(axis=1))


@dataclass(frozen=True, kw_only=True)
class Metric:
    """One number per episode.

    Parameters
    ----------
    key
        Its column in ``metrics.csv`` and its name in the other tables.
    label, unit
        As figures, tables and sentences name it.
    measure
        ``(rollouts,)`` values of some episodes.
    share
        It is 0 or 1: shown in percent, without distribution, and over all episodes alone.
    of_recordings
        Recordings have it too, so that it can be compared with theirs. False: it is itself a
        comparison with them.
    planned
        The planned contrasts are worked out for it.
    more_less
        What the mean is when above and below that of the recordings; it has a sentence then.
    caption
        Of its figure in the report; without one it has no part of its own there.
    per_step
        The same per step, a column in its table.
    heading
        Of its column in the terminal; without one it is not shown there.
    """

    key: str
    label: str
    unit: str
    measure: Callable[[Episodes], Floats]
    share: bool = False
    of_recordings: bool = True
    planned: bool = False
    more_less: tuple[str, str] | None = None
    caption: str = ""
    per_step: Metric | None = None
    heading: str = ""

    @property
    def has_distribution(self) -> bool:
        """Whether its distribution is compared with that of the recordings."""
        return self.of_recordings and not self.share

    @property
    def axis(self) -> str:
        """Of a figure."""
        unit = "% of episodes" if self.share else self.unit
        return f"{self.label} ({unit})" if unit else self.label


RETURN = Metric(
    key="return",
    label="Target reached",
    unit="share of episodes",
    measure=lambda episodes: episodes.rollouts.captured.astype(float),
    share=True,
    caption="Share of episodes in which a pursuer reached the target (the moth the source), all "
    "episodes.",
    heading="target\nreached, %",
)
PATH_LENGTH = Metric(
    key="path_length",
    label="Path length",
    unit="arena units",
    measure=lambda episodes: episodes.path_length,
    planned=True,
    more_less=("longer", "shorter"),
    caption="Path length per episode, mean over the pursuers (or the moth's): all episodes, and "
    "captures only.",
    heading="path length",
)
DURATION = Metric(
    key="duration",
    label="Duration",
    unit="s",
    measure=lambda episodes: episodes.duration,
    planned=True,
    more_less=("longer", "shorter"),
    caption="Duration per episode: all episodes, and captures only.",
    heading="duration, s",
)
DTW_PER_STEP = Metric(
    key="dtw_per_step",
    label="DTW distance per step",
    unit="arena units",
    measure=lambda episodes: episodes.dtw_per_step,
    of_recordings=False,
)
DTW = Metric(
    key="dtw",
    label="DTW distance",
    unit="arena units",
    measure=lambda episodes: episodes.dtw,
    of_recordings=False,
    planned=True,
    caption="DTW distance of each rollout to the demonstration that it started from, mean over the "
    "pursuers (or the moth's), summed along the warping path: all episodes, and captures only.",
    per_step=DTW_PER_STEP,
    heading="DTW distance",
)

METRICS = [RETURN, PATH_LENGTH, DURATION, DTW, DTW_PER_STEP]
"""In the order in which they are shown. Resampling goes by it too: put new ones last."""


def add_metric(metric: Metric) -> None:
    """Have one more metric measured and shown, in this process.

    Raises
    ------
    InputError
        If there is one of that key.
    """
    if any(metric.key == known.key for known in METRICS):
        raise InputError(f"there is a metric {metric.key!r} already: give it another key")
    METRICS.append(metric)


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
    return dtw_alignments(rollouts, demos)[0]


def dtw_alignments(rollouts: Rollouts, demos: Demonstrations) -> tuple[Floats, Floats]:
    """:func:`dtw_distances`, and the number of pairs of frames that each warping path aligns."""
    offsets = demos.offsets
    distance, pairs = np.empty((2, len(rollouts), len(rollouts.individuals)))
    for i, demo in enumerate(rollouts.demo.tolist()):
        path = rollouts.path(i)
        recorded = demos.positions[offsets[demo] : offsets[demo + 1]]
        for k in range(distance.shape[1]):
            distance[i, k], pairs[i, k] = dtw_alignment(path[:, k], recorded[:, k])
    return distance, pairs


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
    - ``dtw_per_step`` [arena unit]: the same over the pairs of frames that the warping path aligns,
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
    episodes = Episodes(rollouts, demos)
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
            **{metric.key: metric.measure(episodes) for metric in METRICS},
        }
    )


def measure_recordings(demos: Demonstrations) -> pd.DataFrame:
    """The same table for the recordings themselves, in the order of the episodes."""
    return measure(Rollouts.from_demonstrations(demos), demos)
