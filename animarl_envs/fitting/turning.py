"""How a body turns, fitted to recorded headings; and how well headings are then predicted.

Persistence, gain and slip of :class:`animarl_envs.species.turning.Turning` minimise the squared
error of the heading over ``HORIZON`` seconds of free running from every recorded step, on the
recorded velocities; over half of the median episode where that is shorter. (A fit to single steps
drifts away sooner.) The error is a chord, ``2 sin(difference / 2)``, so that headings that are lost
altogether do not decide. The search runs first over few steps from one start, then from there over
twice as many, and so on, since the error over many has other minima.
"""

import math

import numpy as np

from animarl_envs.array_types import Floats, Ints
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.episode import HEADING
from animarl_envs.errors import InputError, require_extra
from animarl_envs.locomotion import shorter_turn
from animarl_envs.species.turning import Turning

HORIZON = 2.0  # of the free running in the fit [s]
MOST_STARTS = 10_000  # of the free running
FIRST_STEPS = 4  # of the free running, to begin with
START = (0.2, 0.8, 0.0)  # persistence, gain, slip
LOWEST, HIGHEST = (0.0, 1e-3, -3.1), (0.95, 3.1, 3.1)


def fit_turning(demos: Demonstrations, individual: int = 0) -> Turning | None:
    """Fit the turning of one recorded individual by least squares.

    ``None`` where no headings are recorded, where it never moves, or where the body points where it
    walks: there the direction of travel predicts the next heading better.

    Raises InputError if the headings are not one number per frame and individual.
    """
    if HEADING not in demos.signals:
        return None
    heading, velocity = _recorded(demos, individual)
    speeds = np.hypot(velocity[:, 0], velocity[:, 1])
    if not (speeds > 0).any():
        return None
    with require_extra("fitting how bodies turn", "data"):
        from scipy.optimize import least_squares
    speed, numbers = float(np.median(speeds[speeds > 0])), np.array(START)

    def turning(tried: Floats) -> Turning:
        persistence, gain, slip = tried.tolist()
        return Turning(persistence, gain, slip, speed)

    longest = max(1, min(round(HORIZON / demos.dt), (int(np.median(demos.lengths)) - 1) // 2))
    horizons = [longest]
    while horizons[0] > FIRST_STEPS:
        horizons.insert(0, (horizons[0] + 1) // 2)
    last = np.repeat(demos.offsets[1:], demos.lengths) - 1
    for horizon in horizons:
        at = _steps(demos)
        at = at[at + horizon <= last[at]]
        at = at[:: max(1, math.ceil(len(at) / MOST_STARTS))]
        if len(at) <= len(START):
            return None
        ahead = at + np.arange(1, horizon + 1)[:, None]
        turn = shorter_turn(heading[at], heading[at - 1])
        data = heading[at], turn, velocity[ahead], heading[ahead]
        fitted = least_squares(
            lambda tried, data=data: _chords(turning(tried), *data),
            numbers,
            bounds=(LOWEST, HIGHEST),
            x_scale=(0.1, 0.1, 0.1),
            ftol=1e-9,
            xtol=1e-9,
        )
        numbers = np.clip(fitted.x, LOWEST, HIGHEST)
    fitted_turning = turning(numbers)
    own, travel = (
        float(np.median(heading_misses(demos, rule, individual)[0]))
        for rule in (fitted_turning, along_travel(demos, individual))
    )
    return fitted_turning if own < travel else None


def along_travel(demos: Demonstrations, individual: int = 0) -> Floats:
    """Return headings of a body that points where it walks, ``(frames,)`` [rad].

    At rest the heading stays.
    """
    heading, velocity = _recorded(demos, individual)
    out = np.arctan2(velocity[:, 1], velocity[:, 0])
    moving = np.hypot(velocity[:, 0], velocity[:, 1]) > 0
    first = np.isin(np.arange(len(out)), demos.offsets[:-1])
    for t in np.flatnonzero(~moving):
        out[t] = heading[t] if first[t] else out[t - 1]
    return out


def free_running(demos: Demonstrations, turning: Turning, individual: int = 0) -> Floats:
    """Return headings ``(frames,)`` [rad] predicted from each episode's first heading alone.

    The velocities are the recorded ones.
    """
    heading, velocity = _recorded(demos, individual)
    out = heading.copy()
    for start, stop in zip(demos.offsets[:-1], demos.offsets[1:], strict=True):
        turn = np.zeros(())
        for t in range(start + 1, stop):
            turn = turning.next_turn(turn, out[t - 1], velocity[t])
            out[t] = out[t - 1] + turn
    return out


def heading_misses(demos: Demonstrations, rule: Turning | Floats, individual: int = 0) -> Floats:
    """Return absolute differences from the recorded headings ``(2, steps)`` [rad].

    They are of all frames but the first: after one step from the recorded state, and running free
    from the first frame on.
    """
    heading, velocity = _recorded(demos, individual)
    steps = _steps(demos)
    if isinstance(rule, Turning):
        turn = np.zeros(len(heading))
        turn[steps] = shorter_turn(heading[steps], heading[steps - 1])
        before = turn[steps - 1], heading[steps - 1]
        once = before[1] + rule.next_turn(*before, velocity[steps])
        predicted = np.stack([once, free_running(demos, rule, individual)[steps]])
    else:
        predicted = np.stack([rule[steps]] * 2)
    return np.abs(shorter_turn(predicted, heading[steps]))


def _recorded(demos: Demonstrations, individual: int) -> tuple[Floats, Floats]:
    """Return headings ``(frames,)`` and velocities ``(frames, 2)``."""
    heading = demos.headings()
    if heading is None:
        columns = demos.signals[HEADING][:1].size
        raise InputError(
            f"{demos.name}: signal {HEADING!r} has {columns} columns for "
            f"{demos.num_individuals} individuals: turning is fitted to one of each"
        )
    return heading[:, individual], demos.velocities()[:, individual]


def _steps(demos: Demonstrations) -> Ints:
    """Return all frames but the first of each episode."""
    return np.setdiff1d(np.arange(len(demos.positions)), demos.offsets[:-1])


def _chords(
    turning: Turning, heading: Floats, turn: Floats, velocity: Floats, wanted: Floats
) -> Floats:
    """Return chords ``(horizon * n,)`` from recorded headings ``(horizon, n)``, running free.

    ``heading`` and the last ``turn`` ``(n,)`` are those of the starts, ``velocity``
    ``(horizon, n, 2)`` of the steps that follow.
    """
    out = np.empty(wanted.shape)
    for j in range(len(wanted)):
        turn = turning.next_turn(turn, heading, velocity[j])
        heading = heading + turn
        out[j] = 2.0 * np.sin(0.5 * shorter_turn(heading, wanted[j]))
    return out.ravel()
