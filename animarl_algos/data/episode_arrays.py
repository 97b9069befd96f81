"""The arrays of recorded episodes, laid end to end: what is refused, and what enters a loss.

``first`` and ``lengths`` ``(episodes,)`` are the first frame of each episode and its frames,
``warmup`` ``(frames,)`` is true for steps that enter no loss; ``source`` is named in messages.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from animarl_envs.errors import InputError


def checked(
    source: str, name: str, value: NDArray[Any] | None, dtype: DTypeLike, shape: tuple[int, ...]
) -> NDArray[Any]:
    """``value`` as the kernels want it, zeros if it is not given; finite and of this shape."""
    if value is None:
        return np.zeros(shape, dtype=dtype)
    array = np.ascontiguousarray(value, dtype=dtype)
    if array.shape != shape:
        raise InputError(
            f"{source}: {name} have shape {array.shape}, not {shape}: "
            "make them from the same episodes"
        )
    if not np.isfinite(array).all():
        place = tuple(int(i) for i in np.argwhere(~np.isfinite(array))[0])
        raise InputError(
            f"{source}: {name} at {place} is not a finite number: "
            "look for a gap in the recording there"
        )
    return array if array.flags.writeable else array.copy()


def refuse_missing_actions(
    source: str,
    names: Sequence[str],
    actions: NDArray[np.int16],
    first: NDArray[np.int64],
    lengths: NDArray[np.int64],
    num_actions: int,
) -> None:
    """Every frame but each episode's last needs an action of each individual."""
    bad = (actions < 0) | (actions >= num_actions)
    bad[first + lengths - 1] = False
    if bad.any():
        frame, k = (int(i) for i in np.argwhere(bad)[0])
        episode = int(np.searchsorted(first, frame, side="right") - 1)
        raise InputError(
            f"{source}: episode {episode}, frame {frame - first[episode]}, "
            f"{names[k]}: action {actions[frame, k]} is not one of 0 .. "
            f"{num_actions - 1}: infer the actions of the recording first"
        )


def leading_warmup(
    warmup: NDArray[np.bool_], first: NDArray[np.int64], lengths: NDArray[np.int64]
) -> NDArray[np.int64]:
    """Steps at the start of each episode that enter no loss."""
    return np.array(
        [
            n - 1 if warmup[f : f + n - 1].all() else int(np.argmin(warmup[f : f + n - 1]))
            for f, n in zip(first, lengths, strict=True)
        ],
        dtype=np.int64,
    )


def trainable_episodes(
    source: str, warmup: NDArray[np.bool_], first: NDArray[np.int64], lengths: NDArray[np.int64]
) -> NDArray[np.int64]:
    """Those with a step that enters a loss."""
    kept = [not warmup[f : f + n - 1].all() for f, n in zip(first, lengths, strict=True)]
    if not any(kept):
        raise InputError(f"{source}: all episodes end within the warm-up: shorten the warm-up")
    return np.flatnonzero(kept)
