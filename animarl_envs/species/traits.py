"""What an individual is like, beside what it senses: how fast it is, and how much it turns.

Recorded animals differ from each other for as long as they are recorded. A clone without such an
input simulates one and the same mean animal. So it observes traits: of a recorded animal those of
all its episodes, in standard deviations from the mean of the training animals in that condition; a
simulated animal is given those of a training animal, drawn as its episode begins. A condition
changes the mean alone, so that its effect is left to the condition's own input.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from animarl_envs.array_types import Floats
from animarl_envs.errors import require_extra

TRAITS = ("own speed", "own turning")
LARGEST = 3.0  # no individual is said to be further from the mean [sd]
PARTS = 4  # of an episode, which are more alike than those of different ones if animals differ
MIN_TRAIT_ANIMALS = 6  # fewer cannot show that they differ
LEVEL = 0.01  # of the test that they differ


@dataclass(frozen=True, eq=False)
class Traits:
    """Traits of training animals, of K individuals [arena unit / s; rad / s].

    ``centre`` ``(2, K, 2)`` is per condition, ``scale`` is ``(K, 2)``, and ``table``
    ``(n, K, 2)`` holds the scores of n animals, or of those recorded together.

    The score of a trait in which animals do not differ is 0; its scale is infinite.
    """

    centre: Floats
    scale: Floats
    table: Floats

    def select(self, individuals: Sequence[int]) -> Traits:
        """Return the traits of these individuals; those of a group are of all of them."""
        if self.scale.shape[0] == 1:
            return self
        own = list(individuals)
        return Traits(self.centre[:, own], self.scale[own], self.table[:, own])

    def of_recordings(
        self,
        positions: Floats,
        lengths: NDArray[np.integer],
        dt: float,
        condition: NDArray[np.integer],
        recording: NDArray[np.str_],
    ) -> Floats:
        """Return the scores of the animals of recorded episodes, ``(episodes, K, 2)`` [sd]."""
        animal = np.unique(recording, return_inverse=True)[1]
        return self.scores(animal_traits(positions, lengths, dt, animal)[animal], condition)

    def scores(self, values: Floats, condition: NDArray[np.integer]) -> Floats:
        """Return ``values`` ``(n, K, 2)`` of :func:`episode_traits` in standard deviations."""
        score = (values - self.centre[condition]) / self.scale
        return np.asarray(np.clip(score, -LARGEST, LARGEST))

    def __eq__(self, other: object) -> bool:
        """Return whether all numbers are equal: two runs on the same recordings fit the same."""
        if not isinstance(other, Traits):
            return NotImplemented
        pairs = zip(vars(self).values(), vars(other).values(), strict=True)
        return all(np.array_equal(mine, its) for mine, its in pairs)

    def __hash__(self) -> int:
        return hash(self.table.tobytes())


def episode_traits(positions: Floats, lengths: NDArray[np.integer], dt: float) -> Floats:
    """Mean speed [arena unit / s] and mean size of turns [rad / s], ``(episodes, K, 2)``.

    ``positions`` ``(frames, K, 2)`` lays the episodes end to end. A turn from or to rest is none.
    """
    step = np.diff(positions, axis=0)
    speed = np.linalg.norm(step, axis=-1) / dt
    before, after = step[:-1], step[1:]
    sine = before[..., 0] * after[..., 1] - before[..., 1] * after[..., 0]
    turn = np.abs(np.arctan2(sine, (before * after).sum(axis=-1))) / dt
    traits = np.zeros((len(lengths), positions.shape[1], 2))
    first = 0
    for number, length in enumerate(lengths.tolist()):
        traits[number, :, 0] = speed[first : first + length - 1].mean(axis=0)
        if length > 2:
            traits[number, :, 1] = turn[first : first + length - 2].mean(axis=0)
        first += length
    return traits


def animal_traits(
    positions: Floats, lengths: NDArray[np.integer], dt: float, animal: NDArray[np.integer]
) -> Floats:
    """Return the traits over all episodes of one ``animal``, ``(animals, K, 2)``."""
    return _weighted_means(episode_traits(positions, lengths, dt), lengths - 1, animal)


def _weighted_means(
    values: Floats, weights: NDArray[np.integer], animal: NDArray[np.integer]
) -> Floats:
    """Return the means of ``values`` ``(episodes, K, 2)`` over the episodes of each animal."""
    total = np.zeros((int(animal.max()) + 1, *values.shape[1:]))
    np.add.at(total, animal, values * weights[:, None, None])
    return np.asarray(total / np.bincount(animal, weights)[:, None, None])


def fit_traits(
    positions: Floats,
    lengths: NDArray[np.integer],
    dt: float,
    condition: NDArray[np.integer],
    animal: NDArray[np.integer],
) -> Traits | None:
    """Return the traits of training animals, or None where they do not differ.

    ``condition`` and ``animal``, a number, are of each episode. They differ in a trait if quarters
    of what is recorded of one animal are more alike than those of several (analysis of variance
    over animals, each about the mean of its condition). Episodes too short for quarters are left
    out.

    Raises MissingExtraError without scipy, which the extra "data" has.
    """
    with require_extra("telling individuals apart by their traits", "data"):
        from scipy.stats import f
    long = lengths >= 3 * PARTS
    positions, lengths = positions[np.repeat(long, lengths)], lengths[long]
    units, animal = np.unique(2 * animal[long] + condition[long], return_inverse=True)
    condition, num, individuals = units % 2, len(units), positions.shape[1]
    if num < MIN_TRAIT_ANIMALS:
        return None
    values = animal_traits(positions, lengths, dt, animal)
    overall = values.mean(axis=0)
    centre = np.stack(
        [values[condition == c].mean(axis=0) if (condition == c).any() else overall for c in (0, 1)]
    )
    cut = np.stack([lengths // PARTS] * (PARTS - 1) + [lengths - lengths // PARTS * (PARTS - 1)])
    quarters = episode_traits(positions, cut.T.ravel(), dt)
    of_quarter, part = np.repeat(animal, PARTS), np.zeros((num, PARTS, individuals, 2))
    for number in range(num):  # the quarters of all its episodes, in order, are four parts of it
        own = quarters[of_quarter == number]
        part[number] = own.reshape(PARTS, -1, individuals, 2).mean(axis=1)
    part = part - centre[condition][:, None]
    free = num - len(np.unique(condition)), num * (PARTS - 1)
    between = PARTS * (part.mean(axis=1) ** 2).sum(axis=0) / free[0]
    within = ((part - part.mean(axis=1, keepdims=True)) ** 2).sum(axis=(0, 1)) / free[1]
    differ = between > f.isf(LEVEL, *free) * within
    if not differ.any():
        return None
    sd = (values - centre[condition]).std(axis=0)
    fitted = Traits(centre, np.where(differ, sd, np.inf), np.zeros((0, individuals, 2)))
    return Traits(centre, fitted.scale, fitted.scores(values, condition))
