"""How many thrust magnitudes recordings ask for: as many as a classifier needs to be fooled.

Closed-loop tracking is the best that the 12 directions with M magnitudes can do. What tells it
from the recordings (area under the ROC curve of a classifier) is the floor of every simulation with
these magnitudes, whatever the policy.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from animarl_algos.evaluation.classifier import tell_apart
from animarl_algos.evaluation.rollouts import Rollouts
from animarl_algos.evaluation.statistics import Interval
from animarl_algos.evaluation.windows import comparison_smoothing, resting_step, window_features
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.resolution import rounded
from animarl_envs.fitting.magnitudes import joint_locomotion
from animarl_envs.fitting.tracking import track
from animarl_envs.locomotion import Locomotion

TRIED = (1, 2, 3, 5, 8)
LOW = 2 / 3  # a floor that needs no further magnitude
GAIN = 0.05  # by which the floor must fall to be worth more actions
PART = 15  # windows of one demonstration that make a group, where demonstrations are few
FEW = 10


def tracking_floor(
    seen: Demonstrations, locomotion: Sequence[Locomotion], *, seed: int = 0
) -> Interval:
    """How well closed-loop tracking of ``seen`` is told from it: 0.5 where it is not.

    Both sides are at the scale at which positions were stored and filtered.
    """
    recorded = Rollouts.from_demonstrations(seen)
    followed = rounded(track(seen, locomotion).positions, seen.resolution())
    still, smoothing = resting_step(recorded), comparison_smoothing(seen)
    block = PART if seen.num_episodes < FEW else None
    own, other = (
        window_features(each, seen.arena, block=block, still=still, smoothing=smoothing)
        for each in (recorded, replace(recorded, positions=followed))
    )
    if block is None:
        own, other = own.by_recording(seen), other.by_recording(seen)
    return tell_apart(own, other, np.random.default_rng(seed), deals=1).auc


def choose_thrusts(demos: Demonstrations, *, seed: int = 0) -> int:
    """The number of magnitudes for a simulator, by the training episodes (all, if there are none).

    More are tried until the floor is at most ``LOW``, and the fewest are taken from which the floor
    does not fall by another ``GAIN``.
    """
    seen = demos.select(split="train") if (demos.split == "train").any() else demos
    floors: dict[int, float] = {}
    for thrusts in TRIED:
        fitted = joint_locomotion(seen, thrusts)
        floors[thrusts] = tracking_floor(seen, fitted, seed=seed).estimate
        if floors[thrusts] <= LOW or not np.isfinite(floors[thrusts]):
            break
    lowest = min(floors.values())
    return next((m for m, floor in floors.items() if floor <= lowest + GAIN), TRIED[0])
