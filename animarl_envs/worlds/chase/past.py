"""Own velocities of the last steps, as exponential means ``(scales, K, 2, B)``.

A mean is over the velocities before the present one; :data:`animarl_envs.worlds.chase.layout.PAST`
has the steps it reaches back. An episode begins as if it had always moved as it does then.
"""

from __future__ import annotations

from animarl_envs.compiling import jit, part
from animarl_envs.worlds.chase import layout

PAST = layout.PAST


@part
def remember(velocity, past):  # type: ignore[no-untyped-def]
    """Before a step: the present velocity moves each mean by its share."""
    for scale in range(past.shape[0]):
        share = 1.0 / PAST[scale]
        for i in range(velocity.shape[0]):
            for x in range(2):
                for b in range(velocity.shape[2]):
                    past[scale, i, x, b] += share * (velocity[i, x, b] - past[scale, i, x, b])


@jit
def remembered(velocity, steps, past):  # type: ignore[no-untyped-def]
    """Mean velocities of recorded frames ``(K, 2, frames)``, whose episodes begin at step 0."""
    for scale in range(past.shape[0]):
        share = 1.0 / PAST[scale]
        for i in range(velocity.shape[0]):
            for x in range(2):
                for t in range(velocity.shape[2]):
                    mean = velocity[i, x, t]
                    if steps[t] > 0:
                        mean = past[scale, i, x, t - 1]
                        mean += share * (velocity[i, x, t - 1] - mean)
                    past[scale, i, x, t] = mean
