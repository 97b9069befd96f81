"""How a body turns, fitted to recorded headings; and how well headings are then foretold.

The three numbers persistence, gain and slip of :class:`animarl_envs.species.turning.Turning`
minimise the squared error of the heading over ``HORIZON`` seconds of free running from every
recorded step (of long recordings from ``MOST_STARTS`` of them, evenly chosen), on the recorded
velocities; over half of the median episode where that is shorter. (A fit to single steps foretells
the next turn a little better and drifts away sooner.) The error is a chord, ``2 sin(difference /
2)``, so that headings that are lost altogether do not decide. The fourth number, ``speed``, is the
median recorded speed.

The optimum is found by damped Gauss-Newton steps (Levenberg 1944): first over at most
``FIRST_STEPS`` steps from one start, then from there over twice as many, and so on, since the error
over many has other minima.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.episode import HEADING
from animarl_envs.errors import InputError
from animarl_envs.species.turning import Turning

HORIZON = 2.0  # of the free running in the fit [s]
MOST_STARTS = 10_000  # of the free running
FIRST_STEPS = 4  # of the free running, to begin with
START = (0.2, 0.8, 0.0)  # persistence, gain, slip
LOWEST, HIGHEST = np.array([0.0, 1e-3, -3.1]), np.array([0.95, 3.1, 3.1])
NUDGE = 1e-5  # of a number, for its difference quotient
NUDGES = NUDGE * np.eye(len(START))
ITERATIONS, TOLERANCE = 60, 1e-9


@dataclass(frozen=True)
class HeadingErrors:
    """How far foretold headings are from recorded ones.

    ``one_step``: median of the absolute difference after one step from the recorded state [rad].
    ``free_running``: the same when only the first heading of an episode is given [rad].
    ``sectors``: share of free-running steps whose wind sector (90 deg about front, left, back and
    right) is that of the recorded heading.
    """

    one_step: float
    free_running: float
    sectors: float


def fit_turning(demos: Demonstrations, individual: int = 0) -> Turning | None:
    """Turning of one recorded individual by least squares.

    ``None`` where no headings are recorded, where it never moves, or where the body points where it
    walks: there the direction of travel foretells the next heading better.

    Raises
    ------
    InputError
        If the headings are not one number per frame and individual.
    """
    if HEADING not in demos.signals:
        return None
    heading, velocity = _recorded(demos, individual)
    speeds = np.hypot(velocity[:, 0], velocity[:, 1])
    if not (speeds > 0).any():
        return None
    found = Turning(*START, speed=float(np.median(speeds[speeds > 0])))
    longest = max(1, min(round(HORIZON / demos.dt), (int(np.median(demos.lengths)) - 1) // 2))
    for horizon in _horizons(longest):
        data = _starts(demos, heading, velocity, horizon)
        if len(data[0]) <= len(START):
            return None
        found = _least_squares(found, data)
    own = heading_errors(demos, found, individual).one_step
    travel = heading_errors(demos, along_travel(demos, individual), individual).one_step
    return found if own < travel else None


def along_travel(demos: Demonstrations, individual: int = 0) -> NDArray[np.float64]:
    """Heading of a body that points where it walks ``(frames,)`` [rad]; at rest it is kept."""
    heading, velocity = _recorded(demos, individual)
    out = np.arctan2(velocity[:, 1], velocity[:, 0])
    moving = np.hypot(velocity[:, 0], velocity[:, 1]) > 0
    for start, stop in zip(demos.offsets[:-1], demos.offsets[1:], strict=True):
        for t in range(start, stop):
            if not moving[t]:
                out[t] = out[t - 1] if t > start else heading[t]
    return out


def free_running(
    demos: Demonstrations, turning: Turning, individual: int = 0
) -> NDArray[np.float64]:
    """Headings ``(frames,)`` [rad] by the recorded velocities and each episode's first heading."""
    heading, velocity = _recorded(demos, individual)
    out = heading.copy()
    for start, stop in zip(demos.offsets[:-1], demos.offsets[1:], strict=True):
        turn = np.zeros(())
        for t in range(start + 1, stop):
            turn = turning.next_turn(turn, out[t - 1], velocity[t])
            out[t] = out[t - 1] + turn
    return out


def heading_errors(
    demos: Demonstrations, rule: Turning | NDArray[np.float64], individual: int = 0
) -> HeadingErrors:
    """Errors of a turning, or of given headings ``(frames,)`` [rad], at all but first frames."""
    heading = _recorded(demos, individual)[0][_steps(demos)]
    one_step, free = _predicted(demos, rule, individual)
    return HeadingErrors(
        one_step=float(np.median(np.abs(_between(one_step, heading)))),
        free_running=float(np.median(np.abs(_between(free, heading)))),
        sectors=float(np.mean(_sector(free) == _sector(heading))),
    )


def heading_misses(
    demos: Demonstrations, rule: Turning | NDArray[np.float64], individual: int = 0
) -> NDArray[np.float64]:
    """Absolute differences from the recorded headings ``(2, steps)`` [rad], at all but first
    frames: after one step from the recorded state, and running free from the first one."""
    heading = _recorded(demos, individual)[0][_steps(demos)]
    return np.stack(
        [np.abs(_between(each, heading)) for each in _predicted(demos, rule, individual)]
    )


def _predicted(
    demos: Demonstrations, rule: Turning | NDArray[np.float64], individual: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Headings ``(steps,)`` after one step from the recorded state, and running free."""
    heading, velocity = _recorded(demos, individual)
    steps = _steps(demos)
    if not isinstance(rule, Turning):
        return rule[steps], rule[steps]
    turn = np.zeros(len(heading))
    turn[steps] = _between(heading[steps], heading[steps - 1])
    predicted = heading[steps - 1] + rule.next_turn(
        turn[steps - 1], heading[steps - 1], velocity[steps]
    )
    return predicted, free_running(demos, rule, individual)[steps]


# -- the data and the optimum -----------------------------------------------------------------

_Data = tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]


def _recorded(
    demos: Demonstrations, individual: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Headings ``(frames,)`` and velocities ``(frames, 2)``."""
    heading = demos.headings()
    if heading is None:
        columns = demos.signals[HEADING][:1].size
        raise InputError(
            f"{demos.name}: signal {HEADING!r} has {columns} columns for "
            f"{demos.num_individuals} individuals: turning is fitted to one of each"
        )
    return heading[:, individual], demos.velocities()[:, individual]


def _steps(demos: Demonstrations) -> NDArray[np.int64]:
    """All frames but the first of each episode."""
    later = np.ones(len(demos.positions), dtype=bool)
    later[demos.offsets[:-1]] = False
    return np.flatnonzero(later)


def _horizons(longest: int) -> list[int]:
    """Steps of free running, twice as many each time, the longest last."""
    found = [longest]
    while found[0] > FIRST_STEPS:
        found.insert(0, (found[0] + 1) // 2)
    return found


def _starts(
    demos: Demonstrations,
    heading: NDArray[np.float64],
    velocity: NDArray[np.float64],
    horizon: int,
) -> _Data:
    """Heading and last turn ``(n,)`` at steps that ``horizon`` steps of an episode follow;
    velocities ``(horizon, n, 2)`` and headings ``(horizon, n)`` of those."""
    last = np.repeat(demos.offsets[1:], demos.lengths) - 1
    at = _steps(demos)
    at = at[at + horizon <= last[at]]
    at = at[:: max(1, math.ceil(len(at) / MOST_STARTS))]
    ahead = at + np.arange(1, horizon + 1)[:, None]
    return heading[at], _between(heading[at], heading[at - 1]), velocity[ahead], heading[ahead]


def _residuals(turning: Turning, data: _Data) -> NDArray[np.float64]:
    """Chords between foretold and recorded headings, ``(horizon * n,)``."""
    heading, turn, velocity, wanted = data
    out = np.empty(wanted.shape)
    for j in range(len(wanted)):
        turn = turning.next_turn(turn, heading, velocity[j])
        heading = heading + turn
        out[j] = 2.0 * np.sin(0.5 * _between(heading, wanted[j]))
    return out.ravel()


def _least_squares(turning: Turning, data: _Data) -> Turning:
    """Damped Gauss-Newton."""
    numbers = np.array([turning.persistence, turning.gain, turning.slip])
    residuals, damping = _residuals(turning, data), 1e-3
    for _ in range(ITERATIONS):
        nudged = [
            _residuals(_with(turning, numbers + NUDGE * unit), data)
            for unit in np.eye(len(numbers))
        ]
        slope = (np.stack(nudged, axis=1) - residuals[:, None]) / NUDGE
        square, downhill = slope.T @ slope, -slope.T @ residuals
        before = residuals @ residuals
        while damping < 1e6:
            step = np.linalg.solve(square + damping * np.diag(np.diag(square) + 1e-12), downhill)
            tried = np.clip(numbers + step, LOWEST, HIGHEST)
            other = _residuals(_with(turning, tried), data)
            if other @ other <= before:
                break
            damping *= 10.0
        else:
            break
        numbers, residuals, damping = tried, other, max(1e-9, 0.1 * damping)
        if before - residuals @ residuals <= TOLERANCE * before:
            break
    return _with(turning, numbers)


def _with(turning: Turning, numbers: NDArray[np.float64]) -> Turning:
    persistence, gain, slip = map(float, numbers)
    return replace(turning, persistence=persistence, gain=gain, slip=slip)


def _between(one: NDArray[np.float64], two: NDArray[np.float64]) -> NDArray[np.float64]:
    """``one - two`` by the shorter way, in [-pi, pi)."""
    return np.asarray((one - two + np.pi) % (2.0 * np.pi) - np.pi)


def _sector(heading: NDArray[np.float64]) -> NDArray[np.int64]:
    """Quarter of the circle about front, left, back and right of upwind, 0 to 3."""
    return np.asarray(np.floor((heading - np.pi) / (0.5 * np.pi) + 0.5) % 4, dtype=np.int64)
