"""What an individual is like, beside what it senses: how fast it is, and how much it turns.

Recorded animals differ from each other for as long as they are recorded. A clone that is not told
so simulates one and the same mean animal. So it is told: of recordings by the traits of the
episode, in standard deviations from the mean of the training animals in that condition; a simulated
animal is given those of a training animal, drawn as its episode begins. A condition changes the
mean alone, so that its effect is left to what the network is told of it.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from animarl_envs.array_types import Floats
from animarl_envs.errors import require_extra

TRAITS = ("own speed", "own turning")
LARGEST = 3.0  # no individual is said to be further from the mean [sd]
PARTS = 4  # of an episode, which are more alike than those of different ones if animals differ
MIN_TRAIT_EPISODES = 8  # episodes, below which nobody can say so
LEVEL = 0.01  # of the test that they differ


@dataclass(frozen=True, eq=False)
class Traits:
    """Traits of training animals, of K individuals [arena unit / s; rad / s].

    ``centre`` ``(2, K, 2)`` is per condition, ``scale`` is ``(K, 2)``, and ``table``
    ``(n, K, 2)`` holds their scores.

    The score of a trait in which animals do not differ is 0; its scale is infinite.
    """

    centre: Floats
    scale: Floats
    table: Floats

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


def fit_traits(
    positions: Floats, lengths: NDArray[np.integer], dt: float, condition: NDArray[np.integer]
) -> Traits | None:
    """Return the traits of training animals, or None where they do not differ.

    They differ in a trait if quarters of one episode are more alike than those of several (analysis
    of variance over episodes, each about the mean of its condition).

    Raises MissingExtraError without scipy, which the extra "data" has.
    """
    with require_extra("telling individuals apart by their traits", "data"):
        from scipy.stats import f
    num, (_, individuals, _) = len(lengths), positions.shape
    if num < MIN_TRAIT_EPISODES or lengths.min() < 3 * PARTS:
        return None
    values = episode_traits(positions, lengths, dt)
    overall = values.mean(axis=0)
    centre = np.stack(
        [values[condition == c].mean(axis=0) if (condition == c).any() else overall for c in (0, 1)]
    )
    cut = np.stack([lengths // PARTS] * (PARTS - 1) + [lengths - lengths // PARTS * (PARTS - 1)])
    part = episode_traits(positions, cut.T.ravel(), dt).reshape(num, PARTS, individuals, 2)
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
