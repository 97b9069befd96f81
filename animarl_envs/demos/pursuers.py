"""Demonstrations of many pursuers, or of many targets, as demonstrations of fewer."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from animarl_envs.checks import is_whole
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.episode import UNFINISHED
from animarl_envs.errors import InputError

COUNTS = {"num_pursuers": "pursuer", "num_targets": "target"}
"""Options that say how many take part, and of which role."""


def first_of_role(demos: Demonstrations, option: str, count: int) -> Demonstrations:
    """The recordings of the first ``count`` individuals of a role and of all others.

    An episode that ended by the contact of one who is left out is unfinished.

    Parameters
    ----------
    option
        One of :data:`COUNTS`, which names the role.

    Raises
    ------
    InputError
        If fewer were recorded.
    """
    role = COUNTS[option]
    recorded = demos.roles.count(role)
    if recorded == 0:
        nobody = "nobody pursues" if role == "pursuer" else "nobody is pursued"
        raise InputError(f"{option} does not apply to {demos.name}, where {nobody}: drop it")
    if not is_whole(count):
        raise InputError(f"{option} is {count!r}: it must be a whole number, 1 or more")
    if not 1 <= count <= recorded:
        raise InputError(
            f"{option} is {count} but {demos.name} holds {recorded} {role}"
            f"{'s' * (recorded != 1)}: choose at most {recorded}, or start='uniform', where nobody "
            f"follows a demonstration and more {role}s move like those recorded"
        )
    if count == recorded:
        return demos
    everyone = demos.num_individuals
    kept = [*range(count), *range(recorded, everyone)]  # several of a role come first
    # Recorded actions are left out: their directions may refer to somebody who is gone now.
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
