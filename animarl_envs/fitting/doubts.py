"""What makes a fit of locomotion doubtful, in sentences: what to look at before it is believed."""

from __future__ import annotations

import math

from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.fitting.joint import fit_joint
from animarl_envs.fitting.magnitudes import fast_speed
from animarl_envs.fitting.result import IndividualFit, LocomotionFit
from animarl_envs.fitting.transitions import transitions

TOO_FAST = 2.0  # terminal speeds beyond so many times the top speed seen
MATTERS = 0.1  # relative difference of d that is worth a warning, if it is beyond the interval
ALIKE = 1e-6  # differences of d up to it are of rounding
NEAR_ZERO = 1e-3  # an interval of d that begins below it reaches zero


def doubts(fit: LocomotionFit, demos: Demonstrations) -> list[str]:
    """Who is to be believed with care, and why.

    Parameters
    ----------
    fit
        Of any method.
    demos
        What it was fitted to; the joint fit of one thrust is made once more without leaving any
        step out as a tracking jump.
    """
    seen = demos if fit.fitted_on == "all" else demos.select(split=fit.fitted_on)
    found = []
    for i, one in enumerate(fit.individuals):
        if one.terminal_speed > TOO_FAST * one.top_speed:
            found.append(
                f"{one.name}: with its thrust held it would reach {one.terminal_speed:.3g} arena "
                f"units/s, {one.terminal_speed / one.top_speed:.1f} times the top speed seen "
                f"({one.top_speed:.3g}): a policy that pushes on leaves what was recorded"
            )
        if one.damping_interval is not None and one.damping_interval[0] < NEAR_ZERO:
            found.append(
                f"{one.name}: the interval of d reaches 0, so the recordings do not say how it "
                "slows down: record longer, or more of its turns and stops"
            )
        if fit.method == "joint" and len(one.magnitudes) == 1:
            found += _trimming(one, i, seen)
    return found


def _trimming(one: IndividualFit, individual: int, seen: Demonstrations) -> list[str]:
    data = transitions(seen, individual)
    whole = fit_joint(data, one.name, fast_speed(data), far=math.inf)
    low, high = one.damping_interval or (one.damping, one.damping)
    change = abs(whole.damping - one.damping)
    if low <= whole.damping <= high or change <= MATTERS * one.damping + ALIKE:
        return []
    return [
        f"{one.name}: d is {one.damping:.3g} and u {one.thrust:.3g} without the steps that are "
        f"taken for tracking jumps, {whole.damping:.3g} and {whole.thrust:.3g} with all: look at "
        "the jumps ('animarl data check')"
    ]
