"""Fitting damping d and thrust u of v' = (1 - d) v + u a dt to recorded episodes."""

from animarl_envs.fitting.joint import fit_joint, joint_locomotion
from animarl_envs.fitting.result import IndividualFit, LocomotionFit, fit_locomotion
from animarl_envs.fitting.tracking import Tracking, one_step_misses, track
from animarl_envs.fitting.transitions import (
    Transitions,
    demonstrated_actions,
    fit_onset,
    transitions,
    velocity_rmse,
)

__all__ = [
    "IndividualFit", "LocomotionFit", "Tracking", "Transitions", "demonstrated_actions",
    "fit_joint", "fit_locomotion", "fit_onset", "joint_locomotion", "one_step_misses", "track",
    "transitions", "velocity_rmse",
]  # fmt: skip
