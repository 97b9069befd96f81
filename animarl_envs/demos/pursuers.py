"""Demonstrations of many pursuers as demonstrations of fewer."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.episode import UNFINISHED
from animarl_envs.errors import InputError


def first_pursuers(demos: Demonstrations, count: int) -> Demonstrations:
    """The recordings of the first ``count`` pursuers and of the target.

    An episode that ended by the contact of a pursuer who is left out is unfinished.

    Raises
    ------
    InputError
        If fewer pursuers were recorded.
    """
    recorded = demos.roles.count("pursuer")
    if recorded == 0:
        raise InputError(
            f"num_pursuers does not apply to {demos.name}, where nobody pursues: drop it"
        )
    if isinstance(count, bool) or not isinstance(count, int):
        raise InputError(f"num_pursuers is {count!r}: it must be a whole number, 1 or more")
    if not 1 <= count <= recorded:
        raise InputError(
            f"num_pursuers is {count} but {demos.name} holds {recorded} pursuer"
            f"{'s' * (recorded != 1)}: choose at most {recorded}, or start='uniform', where nobody "
            "follows a demonstration and more pursuers move like those recorded"
        )
    if count == recorded:
        return demos
    everyone = demos.num_individuals
    kept = [*range(count), *range(recorded, everyone)]
    # Recorded actions are left out: the target's may have been told towards one who is gone now.
    outcome = np.where(demos.outcome > count, UNFINISHED, demos.outcome)
    signals = {
        key: value[:, kept] if value.ndim > 1 and value.shape[1] == everyone else value
        for key, value in demos.signals.items()
        if key != "actions"
    }
    return replace(
        demos,
        individuals=tuple(demos.individuals[i] for i in kept),
        roles=tuple(demos.roles[i] for i in kept),
        positions=demos.positions[:, kept],
        initial_velocity=demos.initial_velocity[:, kept],
        outcome=outcome,
        signals=signals,
    )
