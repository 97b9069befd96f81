"""What a demonstrated step is labelled with: an action, or how probable each of them is."""

from __future__ import annotations

from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from animarl_algos.ranges import POSITIVE, Range
from animarl_envs.errors import InputError

HORIZON = Range(least=1.0)  # [steps]


class Labels(StrEnum):
    """The choices."""

    HARD = "hard"  # the action nearest to the recorded acceleration, at recorded states
    SOFT = "soft"  # a probability for each action, by how near it would have led
    TRACKING = "tracking"  # actions that follow the recording, at the states they lead to


def check_labels(labels: str, width: float, horizon: float = 1.0) -> None:
    """Refuse settings of labels that are none.

    Raises
    ------
    InputError
        If there are no such labels, the width is not positive, or the horizon is below a step.
    """
    if labels not in list(Labels):
        raise InputError(f"labels is {labels!r}: choose {', '.join(Labels)}")
    POSITIVE.check("label_width", width)
    HORIZON.check("label_horizon", horizon)


def soft_labels(
    penalties: NDArray[np.floating], step: float | NDArray[np.floating], width: float
) -> NDArray[np.float32]:
    """Probability of each action, the higher the nearer it would have led.

    ``p(a)`` is proportional to ``exp(-(e_a / (u dt^2))^2 / (2 c^2))``: a normal error of the
    recorded acceleration, with a standard deviation of c times the thrust.

    Parameters
    ----------
    penalties
        ``(..., actions)``, e_a: distance between where action a would have led by the fitted
        dynamics and where the animal went [arena unit].
    step
        ``u dt^2``, how far one thrust moves the animal in a step [arena unit]; a number, or an
        array that broadcasts against ``penalties``.
    width
        c [1].

    Returns
    -------
    ``(..., actions)``, each row a distribution.

    Raises
    ------
    InputError
        If ``width`` is not positive.
    """
    POSITIVE.check("label_width", width)
    exponent = -((penalties.astype(np.float64) / step) ** 2) / (2.0 * width**2)
    share = np.exp(exponent - exponent.max(axis=-1, keepdims=True))
    return np.asarray(share / share.sum(axis=-1, keepdims=True), dtype=np.float32)
