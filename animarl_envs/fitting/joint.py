"""The joint fit: d and u chosen together so that the 13 actions explain the observed velocities.

What is left of a velocity after damping, ``r = v_{t+1} - (1 - d) v_t``, should be either zero (the
individual coasts) or have the length ``u dt`` along one of the 12 directions of the egocentric
frame. The fit minimises the squared distance of ``r`` to the nearest of these 13 points, which is
the square of the velocity RMSE that Table 1 of the paper reports. Steps that miss by more than
``FAR`` times what nine tenths of all steps miss by are taken for tracking jumps and left out; a
Gaussian error loses nothing by that (trimming a fixed share would cost a sixth of the precision).

Three moves alternate: every step takes its nearest action (as in k-means), far misses are set
aside, and with these fixed the optimum (d, u) solves two linear equations. A grid supplies the
starting points.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from animarl_envs.compiling import jit
from animarl_envs.errors import InputError
from animarl_envs.fitting.transitions import Transitions
from animarl_envs.locomotion import Locomotion

FAR = 5.0  # a miss beyond so many times the BULK quantile of all misses is a tracking jump
BULK = 0.9
GRID_DAMPING = np.linspace(0.0, 1.0, 26)
GRID_QUANTILES = (0.2, 0.35, 0.5, 0.65, 0.8, 0.9, 0.95, 0.99)  # of |r| / dt, for the thrust
GRID_STEPS = 4000  # steps looked at from each grid point
STARTS = 6  # best grid points, refined with all steps
ITERATIONS = 300
TOLERANCE = 1e-9  # relative change of d and u at which the alternation has converged
CURVATURE_STEP = 0.05  # of the bootstrap's difference quotient; smaller ones are noisy

_HALF_SQRT3 = math.sqrt(3.0) / 2.0


def fit_joint(data: Transitions, name: str = "the individual") -> Locomotion:
    """Damping and thrust of one individual by least squares without tracking jumps.

    Parameters
    ----------
    data
        Its transitions.
    name
        For the message.

    Raises
    ------
    InputError
        If there are fewer than three steps, or the individual never moves.
    """
    moving = np.hypot(data.next_velocity[:, 0], data.next_velocity[:, 1]) > 0
    if len(data) < 3 or not moving.any():
        raise InputError(
            f"{name} has {len(data)} steps, {int(moving.sum())} of them in motion: "
            "a fit needs at least three and some motion; check the track"
        )
    best, best_loss = (0.0, 0.0), math.inf
    for start in _starting_points(data):
        damping, thrust, loss = _alternate(data, *start)
        if loss < best_loss:
            best, best_loss = (damping, thrust), loss
    return Locomotion(*best)


def bootstrap_joint(
    data: Transitions, fitted: Locomotion, weights: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Resampled (d, u), ``(resamples, 2)``, by one Newton step from the fit.

    Each episode contributes its own gradient g_e of the objective; a resample that draws episode e
    ``w_e`` times moves the optimum by ``-H_w^-1 sum_e w_e g_e``. The curvature H_w is that of all
    data, scaled to the steps drawn; as a difference quotient it counts changes of action. This is
    the estimating-function bootstrap (Hu and Kalbfleisch 2000): to first order its intervals are
    those of refitting every resample, at a thousandth of the cost.

    ``weights`` ``(resamples, episodes)`` says how often each episode was drawn.
    """
    point = np.array([fitted.damping, fitted.thrust])
    steps_drawn = weights @ np.bincount(data.episode, minlength=data.num_episodes)
    slope = (weights @ _gradients(data, point)) * (len(data) / steps_drawn)[:, None]
    held = _fixed_curvature(data, point)
    moved = -np.linalg.solve(held, slope.T).T
    curvature = _curvature(data, point, CURVATURE_STEP * np.array([1.0, fitted.thrust]))
    if (np.linalg.eigvalsh(curvature) > 0).all():
        moved = -np.linalg.solve(curvature, slope.T).T
    return np.asarray(np.maximum(point + moved, 0.0))


def _starting_points(data: Transitions) -> list[tuple[float, float]]:
    """The most promising cells of a grid over d and u."""
    every = max(1, len(data) // GRID_STEPS)
    velocity, next_velocity = data.velocity[::every], data.next_velocity[::every]
    focus = np.ascontiguousarray(data.focus[::every])
    velocity, next_velocity = np.ascontiguousarray(velocity), np.ascontiguousarray(next_velocity)
    error, action = np.empty(len(velocity)), np.empty((len(velocity), 2))
    found = []
    for damping in GRID_DAMPING:
        rest = next_velocity - (1 - damping) * velocity
        length = np.hypot(rest[:, 0], rest[:, 1]) / data.dt
        for thrust in np.unique(np.quantile(length[length > 0], GRID_QUANTILES)):
            _assign(velocity, next_velocity, focus, damping, thrust * data.dt, error, action)
            found.append((_loss(error), float(damping), float(thrust)))
    found.sort()
    return [(damping, thrust) for _, damping, thrust in found[:STARTS]]


def _alternate(data: Transitions, damping: float, thrust: float) -> tuple[float, float, float]:
    """Assign actions, trim, solve; until nothing changes. Returns d, u and the mean loss."""
    error, action = np.empty(len(data)), np.empty((len(data), 2))
    for _ in range(ITERATIONS):
        _assign(
            data.velocity, data.next_velocity, data.focus, damping, thrust * data.dt, error, action
        )
        new = _solve(data.velocity, data.next_velocity, action, error, _limit(error), data.dt)
        new = (min(max(new[0], 0.0), 1.0), new[1])
        if not new[1] > 0:
            return damping, thrust, math.inf
        change = max(abs(new[0] - damping), abs(new[1] - thrust) / thrust)
        damping, thrust = new
        if change < TOLERANCE:
            break
    _assign(data.velocity, data.next_velocity, data.focus, damping, thrust * data.dt, error, action)
    return damping, thrust, _loss(error)


def _limit(error: NDArray[np.float64]) -> float:
    """Squared error beyond which a step is a tracking jump."""
    rank = math.ceil(BULK * len(error)) - 1
    return FAR**2 * float(np.partition(error, rank)[rank])


def _loss(error: NDArray[np.float64]) -> float:
    """Mean squared error with jumps counted at the limit."""
    return float(np.minimum(error, _limit(error)).mean())


def _gradients(data: Transitions, point: NDArray[np.float64]) -> NDArray[np.float64]:
    """Half the gradient of the loss by (d, u), per episode ``(episodes, 2)``."""
    error, action = _nearest(data, point)
    kept = error <= _limit(error)
    impulse = data.dt * action
    miss = data.next_velocity - (1 - point[0]) * data.velocity - point[1] * impulse
    terms = np.column_stack([np.sum(miss * data.velocity, axis=1), -np.sum(miss * impulse, axis=1)])
    out = np.zeros((data.num_episodes, 2))
    for column in range(2):
        out[:, column] = np.bincount(data.episode, terms[:, column] * kept, data.num_episodes)
    return out


def _curvature(
    data: Transitions, point: NDArray[np.float64], step: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Half the Hessian of the loss by (d, u), as a difference quotient over ``step``."""
    rows = []
    for shift in np.diag(step):
        rise = _gradients(data, point + shift) - _gradients(data, point - shift)
        rows.append(rise.sum(axis=0) / (2 * shift.sum()))
    return np.asarray(0.5 * (np.array(rows) + np.array(rows).T))


def _fixed_curvature(data: Transitions, point: NDArray[np.float64]) -> NDArray[np.float64]:
    """Half the Hessian of the loss with all actions held fixed, ``(2, 2)``."""
    _, action = _nearest(data, point)
    impulse = data.dt * action
    mixed = -np.sum(data.velocity * impulse)
    return np.array([[np.sum(data.velocity**2), mixed], [mixed, np.sum(impulse**2)]])


def _nearest(
    data: Transitions, point: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Squared errors ``(steps,)`` and nearest action vectors ``(steps, 2)`` at (d, u)."""
    error, action = np.empty(len(data)), np.empty((len(data), 2))
    damping, impulse = point[0], point[1] * data.dt
    _assign(data.velocity, data.next_velocity, data.focus, damping, impulse, error, action)
    return error, action


@jit
def _assign(  # type: ignore[no-untyped-def]
    velocity, next_velocity, focus, damping, impulse, error, action
):
    """Nearest of the 13 actions to each observed acceleration.

    ``impulse`` is u dt. Writes the squared error ``(steps,)`` of the rebuilt velocity and the
    action's vector in the arena frame ``(steps, 2)``. Directions are searched in one quadrant.
    """
    for t in range(velocity.shape[0]):
        rest_x = next_velocity[t, 0] - (1.0 - damping) * velocity[t, 0]
        rest_y = next_velocity[t, 1] - (1.0 - damping) * velocity[t, 1]
        ahead = rest_x * focus[t, 0] + rest_y * focus[t, 1]
        left = rest_y * focus[t, 0] - rest_x * focus[t, 1]
        x, y = abs(ahead), abs(left)
        along, c, s = x, 1.0, 0.0
        if _HALF_SQRT3 * x + 0.5 * y > along:
            along, c, s = _HALF_SQRT3 * x + 0.5 * y, _HALF_SQRT3, 0.5
        if 0.5 * x + _HALF_SQRT3 * y > along:
            along, c, s = 0.5 * x + _HALF_SQRT3 * y, 0.5, _HALF_SQRT3
        if y > along:
            along, c, s = y, 0.0, 1.0
        square = x * x + y * y
        if impulse < 2.0 * along:  # nearer to that direction than to zero
            c = c if ahead >= 0 else -c
            s = s if left >= 0 else -s
            action[t, 0] = c * focus[t, 0] - s * focus[t, 1]
            action[t, 1] = c * focus[t, 1] + s * focus[t, 0]
            error[t] = max(square - 2.0 * impulse * along + impulse * impulse, 0.0)
        else:
            action[t, 0] = 0.0
            action[t, 1] = 0.0
            error[t] = square


@jit
def _solve(velocity, next_velocity, action, error, limit, dt):  # type: ignore[no-untyped-def]
    """Least squares for v' = (1 - d) v + u (dt a) over the steps with ``error <= limit``."""
    vv, va, aa, vn, an = 0.0, 0.0, 0.0, 0.0, 0.0
    for t in range(velocity.shape[0]):
        if error[t] > limit:
            continue
        for axis in range(2):
            v, n, a = velocity[t, axis], next_velocity[t, axis], dt * action[t, axis]
            vv += v * v
            va += v * a
            aa += a * a
            vn += v * n
            an += a * n
    determinant = vv * aa - va * va
    if aa == 0.0:
        return 0.0, 0.0
    if determinant <= 1e-12 * vv * aa:
        return 1.0, an / aa
    return 1.0 - (aa * vn - va * an) / determinant, (vv * an - va * vn) / determinant
