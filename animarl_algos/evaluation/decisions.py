"""What a trained learner values along a recorded path."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from animarl_algos.evaluation.statistics import Floats, Ints
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.fitting.transitions import demonstrated_actions
from animarl_envs.focus import first_pursuer
from animarl_envs.species import Species
from animarl_envs.worlds import demonstration_observations


@dataclass(frozen=True, eq=False)
class Decisions:
    """Action values of one ``individual`` in the demonstration ``demo`` of the evaluated set.

    ``q`` ``(steps, actions)`` are those before each recorded step, ``actions`` ``(steps,)`` what
    inverse dynamics finds in it.
    """

    individual: str
    demo: int
    q: Floats
    actions: Ints


def decide_along(
    policy: Any,
    species: Species,
    demos: Demonstrations,
    demo: int,
    *,
    condition_flag: bool = False,
    focal: str | None = None,
) -> Decisions:
    """What ``policy`` values in one demonstration, where all move as recorded.

    Parameters
    ----------
    policy
        Of all individuals, in the order of ``demos``, or of ``focal`` alone; its ``advance`` gives
        Q-values ``(slots, actions)`` and the next memory.
    species
        As the policy was trained in; its locomotion tells the recorded actions.
    condition_flag
        Whether the condition is the last component of an observation.
    focal
        The individual that learned, whose values are told. If all did: those of the first that
        moves towards the target or source.
    """
    one = demos.select(episodes=[demo])
    steps = int(one.lengths[0]) - 1
    who = first_pursuer(one.roles) if focal is None else one.individuals.index(focal)
    slots = np.arange(len(one.roles)) if focal is None else np.array([who])
    observations: NDArray[np.float32] = demonstration_observations(species, one)[:, slots]
    if condition_flag:
        column = np.full((*observations.shape[:2], 1), one.condition[0], dtype=np.float32)
        observations = np.concatenate([observations, column], axis=2)
    actions = demonstrated_actions(one, species.locomotion).astype(np.int64)
    values = np.empty((steps, species.num_actions))
    state: Any = None
    for t in range(steps):
        q_values, hidden, _ = policy.advance(observations[t], state, np.zeros(len(slots), bool))
        values[t] = q_values[slots.tolist().index(who)]
        state = (hidden, np.maximum(actions[t, slots], 0))
    return Decisions(one.individuals[who], demo, values, actions[:steps, who])
