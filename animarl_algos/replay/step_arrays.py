"""A step's arrays as the replay kernels want them: given ones checked, missing ones filled in."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import DTypeLike, NDArray

from animarl_algos.replay.rings import NO_LABEL
from animarl_envs.errors import InputError


class Step(NamedTuple):
    """One step of every copy, as the kernels want it."""

    observations: NDArray[np.float32]  # (copies, K, n)
    actions: NDArray[np.int64]  # (copies, K)
    rewards: NDArray[np.float32]  # (copies, K)
    next_observations: NDArray[np.float32]  # (copies, K, n)
    terminated: NDArray[np.bool_]  # (copies,)
    truncated: NDArray[np.bool_]  # (copies,)
    penalties: NDArray[np.float32]  # (copies, K)
    labels: NDArray[np.int64]  # (copies, K)
    warmup: NDArray[np.bool_]  # (copies,)
    hidden: NDArray[np.float32]  # (copies, K, H)
    condition: NDArray[np.float32]  # (copies,)


class NotGiven(NamedTuple):
    """What stands in for the optional parts of a step."""

    penalties: NDArray[np.float32]
    labels: NDArray[np.int64]
    warmup: NDArray[np.bool_]
    hidden: NDArray[np.float32]
    condition: NDArray[np.float32]

    @classmethod
    def allocate(cls, copies: int, num_individuals: int) -> NotGiven:
        """No penalty, label, warm-up, recurrent state or condition for any copy."""
        return cls(
            penalties=np.zeros((copies, num_individuals), dtype=np.float32),
            labels=np.full((copies, num_individuals), NO_LABEL, dtype=np.int64),
            warmup=np.zeros(copies, dtype=np.bool_),
            hidden=np.zeros((copies, num_individuals, 0), dtype=np.float32),
            condition=np.zeros(copies, dtype=np.float32),
        )


def fit(name: str, value: Any, dtype: DTypeLike, shape: tuple[int, ...]) -> NDArray[Any]:
    """``value`` as the kernels want it: contiguous, writeable, of this type and shape."""
    array = np.ascontiguousarray(value, dtype=dtype)
    if array.shape != shape:
        raise InputError(
            f"{name} of a step have shape {array.shape}, this memory wants {shape}: "
            "make the memory for this environment"
        )
    return array if array.flags.writeable else array.copy()
