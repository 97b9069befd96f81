"""A policy of one individual, acting where all are asked for: the others replay, whatever it says.

Used when a run trained a single individual (``focal``).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray


def focal_drivers(names: tuple[str, ...], focal: str | None) -> dict[str, str]:
    """Who replays its demonstration when only ``focal`` learned: everybody else, or nobody."""
    return {name: "replay" for name in names if focal not in (None, name)}


class FocalPolicy:
    """``predict`` for all slots of a world from a policy that knows one individual.

    Parameters
    ----------
    policy
        With stable-baselines3's ``predict``; its slots are the copies.
    names
        Of all individuals of the world it acts in.
    focal
        Whom it drives.
    """

    def __init__(self, policy: Any, names: Sequence[str], focal: str) -> None:
        self.policy = policy
        self.observation_space = policy.observation_space
        self.action_space = policy.action_space
        self.individuals = len(names)
        self.index = tuple(names).index(focal)

    def predict(
        self,
        observation: NDArray[Any],
        state: Any = None,
        episode_start: NDArray[np.bool_] | None = None,
        deterministic: bool = False,
    ) -> tuple[NDArray[np.int64], Any]:
        """Actions ``(slots,)`` of slots ``copy * individuals + individual``; 0 for the others."""
        own = slice(self.index, None, self.individuals)
        actions = np.zeros(len(observation), dtype=np.int64)
        actions[own], state = self.policy.predict(
            observation[own],
            state,
            None if episode_start is None else episode_start[own],
            deterministic,
        )
        return actions, state

    def remember(self, state: Any, executed: NDArray[np.integer]) -> Any:
        """See :meth:`GruPolicy.remember`; ``executed`` of all slots."""
        return self.policy.remember(state, executed[self.index :: self.individuals])

    def leave_out(self, state: Any, over: NDArray[np.bool_]) -> Any:
        """See :meth:`GruPolicy.leave_out`; ``over`` of all slots. Foreign policies have none."""
        leave_out = getattr(self.policy, "leave_out", None)
        return (
            state if leave_out is None else leave_out(state, over[self.index :: self.individuals])
        )
