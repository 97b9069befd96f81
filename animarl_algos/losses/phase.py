"""The numbers of a phase of training, offline or online: the discount and weights of loss terms.

A new weight is named here, in :class:`Phase` and among the settings of learners, and has its value
in ``zoo_configs/learner.yml``.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import TypedDict

from animarl_algos.ranges import NOT_NEGATIVE, POSITIVE_OR_NONE, PROBABILITY


@dataclass(frozen=True)
class Phase:
    """The numbers of one phase of training.

    Attributes
    ----------
    name
        ``"offline"`` or ``"online"``, for messages and logs.
    gamma
        Discount per step.
    alpha
        Weight of the distance penalty in the reward, ``R - alpha * penalty``.
    lambda1, lambda2, lambda3
        Weights of squared l2 norm, treatment cross-entropy and action supervision.
    max_grad_norm
        Largest gradient norm of one individual; ``None`` does not clip.
    scaled_penalties
        Whether penalties of all actions are taken in units of their mean over actions and steps
        (per individual and batch) instead of arena units. That mean is about ``u dt^2``, how far
        one thrust moves the animal in a step: 0.03 for the agents and 0.0001 for the newts.
    n_steps
        Rewards that are summed before the value of what follows (Sutton 1988; Hessel et al. 2018).
    """

    name: str
    gamma: float
    alpha: float
    lambda1: float
    lambda2: float
    lambda3: float
    max_grad_norm: float | None
    scaled_penalties: bool = False
    n_steps: int = 1

    def __post_init__(self) -> None:
        prefix = "" if self.name == "online" else f"{self.name}_"
        PROBABILITY.check(prefix + "gamma", self.gamma)
        for key in WEIGHTS:
            NOT_NEGATIVE.check(prefix + key, getattr(self, key))
        POSITIVE_OR_NONE.check(prefix + "max_grad_norm", self.max_grad_norm)


WEIGHTS = tuple(
    each.name
    for each in fields(Phase)
    if each.name not in ("name", "gamma", "max_grad_norm", "scaled_penalties", "n_steps")
)


class PhaseSettings(TypedDict, total=False):
    """The numbers of both phases as settings of a learner; ``lambda1`` holds in both."""

    lambda1: float

    gamma: float
    alpha: float
    lambda2: float
    lambda3: float
    max_grad_norm: float | None
    n_steps: int

    offline_gamma: float
    offline_alpha: float
    offline_lambda2: float
    offline_lambda3: float
    offline_max_grad_norm: float | None
    offline_scaled_penalties: bool
