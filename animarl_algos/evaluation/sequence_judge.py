"""A judge of order in time: long windows, signed and lagged features.

The classifier of :mod:`animarl_algos.evaluation.classifier` looks at two seconds and at unsigned
series, so it cannot tell a path from the same path reversed, or circles from a search. This judge
looks at windows of up to a quarter of an episode and at the measures of
:mod:`animarl_algos.evaluation.order_in_time` within them. It is asked only about recordings that it
was not trained on.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from animarl_algos.evaluation.order_in_time import lags_for, median_steps, order_measures
from animarl_algos.evaluation.rollouts import Rollouts
from animarl_algos.evaluation.windows import Windows
from animarl_envs.arena import Arena

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

QUARTER = 0.25  # of the median episode
SHORTEST, LONGEST = 2.0, 20.0  # of a window [s]
PER_EPISODE = ("outcome", "condition", "cue", "demo", "seed", "repetition", "components")


def window_steps(recorded: Rollouts) -> int:
    """Return the steps of a window: a quarter of an episode, 2 to 20 s."""
    steps = QUARTER * median_steps(recorded)
    low, high = (round(limit / recorded.dt) for limit in (SHORTEST, LONGEST))
    return int(np.clip(round(steps), max(4, low), max(4, high)))


def sequence_windows(
    rollouts: Rollouts, arena: Arena, rest: Floats, steps: int, group: Ints
) -> Windows:
    """Describe all windows of ``steps`` steps, end to end from the start of each episode.

    ``group`` ``(recordings,)`` names the unit of resampling of each start. An episode that is
    shorter than a window is one short window.
    """
    pieces = _pieces(rollouts, steps)
    measured = order_measures(pieces, arena, lags_for(steps, rollouts.dt), rest)
    return Windows(measured.values, group[pieces.demo], np.array(measured.kinds))


def _pieces(rollouts: Rollouts, steps: int) -> Rollouts:
    """Cut episodes into windows; what is left at the end counts if it is half a window or more."""
    frames, lengths, owner = [], [], []
    for index, start in enumerate(rollouts.offsets[:-1].tolist()):
        left = int(rollouts.lengths[index]) - 1
        for begin in range(0, max(left, 1), steps):
            here = min(steps, left - begin)
            if begin == 0 or here >= steps / 2:
                frames.append(np.arange(start + begin, start + begin + here + 1))
                lengths.append(here + 1)
                owner.append(index)
    which = np.array(owner)
    parts = {name: getattr(rollouts, name)[which] for name in PER_EPISODE}
    return replace(
        rollouts,
        positions=rollouts.positions[np.concatenate(frames)],
        lengths=np.array(lengths),
        **parts,
    )
