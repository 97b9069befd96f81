"""Fitting M thrust magnitudes to every individual.

With one magnitude this is the joint fit. With more, d and all thrusts are fitted together from
several starting points, and then held against fixed multiples of the one-magnitude thrust which did
well on moths, termites and flies: what follows the recordings more closely in closed loop
(:mod:`animarl_envs.fitting.tracking`) is taken, individual by individual. ``u`` stays the thrust of
the joint fit, of which the magnitudes are multiples.

In every fit the terminal speed of the largest thrust is at least the recorded 99 % quantile of
speed: a model that cannot go as fast as the animal cannot move like it. How many magnitudes a set
asks for is chosen above, where there is a classifier
(``animarl_algos.evaluation.thrust_choice``).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.fitting.joint import best_of, fit_joint
from animarl_envs.fitting.tracking import track, tracking_errors
from animarl_envs.fitting.transitions import Transitions, transitions
from animarl_envs.locomotion import Locomotion, check_thrusts, fixed_multiples

Floats = NDArray[np.float64]

FAST = 0.99  # quantile of recorded speed that the terminal speed reaches
TOLERANCE = 1e-5  # relative change of d and magnitudes at which a fit of several has converged


def joint_locomotion(demos: Demonstrations, thrusts: int = 1) -> tuple[Locomotion, ...]:
    """Damping, thrust and magnitudes of every individual, from all episodes of ``demos``.

    Parameters
    ----------
    demos
        Recorded episodes, those to fit only.
    thrusts
        The number of magnitudes, M.

    Raises
    ------
    InputError
        If ``thrusts`` is none of 1 to 10, or an individual has too few steps or never moves.
    """
    check_thrusts(thrusts)
    return _richer(demos, _one_magnitude(demos), thrusts)


def fast_speed(data: Transitions) -> float:
    """The speed that a fit must be able to reach [arena unit / s]."""
    speed = np.hypot(data.next_velocity[:, 0], data.next_velocity[:, 1])
    return float(np.quantile(speed, FAST)) if len(speed) else 0.0


def _one_magnitude(demos: Demonstrations) -> tuple[Locomotion, ...]:
    """The joint fit of every individual, whatever terminal speed it has."""
    return tuple(
        fit_joint(transitions(demos, i), f"{demos.name}: {name}")
        for i, name in enumerate(demos.individuals)
    )


def _richer(
    demos: Demonstrations, ones: Sequence[Locomotion], thrusts: int
) -> tuple[Locomotion, ...]:
    """``thrusts`` magnitudes for every individual, given its joint fit."""
    every = [transitions(demos, i) for i in range(demos.num_individuals)]
    if thrusts == 1:
        return tuple(_fast_enough(data, one) for data, one in zip(every, ones, strict=True))
    multiples = fixed_multiples(thrusts)
    fitted = [_fit_magnitudes(data, one, thrusts) for data, one in zip(every, ones, strict=True)]
    fixed = [_with_multiples(data, one, multiples) for data, one in zip(every, ones, strict=True)]
    errors = [tracking_errors(demos, track(demos, each)) for each in (fitted, fixed)]
    return tuple(
        own if own_error < other_error else other
        for own, other, own_error, other_error in zip(fitted, fixed, *errors, strict=True)
    )


def _fast_enough(data: Transitions, one: Locomotion) -> Locomotion:
    """The joint fit, or the best one that reaches the fast speed."""
    fast = fast_speed(data)
    return one if one.terminal_speed(data.dt) >= fast else fit_joint(data, least_speed=fast)


def _with_multiples(data: Transitions, one: Locomotion, multiples: Sequence[float]) -> Locomotion:
    """The one-magnitude fit with fixed multiples, damped little enough to reach the fast speed."""
    fast = fast_speed(data)
    largest = one.thrust * multiples[0] * data.dt
    damping = one.damping if one.damping * fast <= largest else largest / fast
    return Locomotion(damping, one.thrust, tuple(multiples))


def _fit_magnitudes(data: Transitions, one: Locomotion, thrusts: int) -> Locomotion:
    """d and all thrusts of one individual by least squares."""
    rest = data.next_velocity - (1.0 - one.damping) * data.velocity
    length = np.hypot(rest[:, 0], rest[:, 1]) / data.dt
    length = length[length > 0.5 * min(fixed_multiples(thrusts)) * one.thrust]
    spread = (np.arange(thrusts) + 0.5) / thrusts
    guesses = [one.thrust * np.array(fixed_multiples(thrusts))]
    if len(length):
        guesses.append(np.quantile(length, spread))
    starts = [(one.damping, guess) for guess in guesses]
    damping, found = best_of(data, starts, fast_speed(data), TOLERANCE)
    ordered = np.unique(found)[::-1] / one.thrust
    if len(ordered) < thrusts:  # some coincide: exact tracks of fewer magnitudes
        return _with_multiples(data, one, fixed_multiples(thrusts))
    return Locomotion(damping, one.thrust, tuple(ordered.tolist()))
