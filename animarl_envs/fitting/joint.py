"""The joint fit: d and the thrusts chosen together so that the actions explain the velocities.

What is left of a velocity after damping, ``r = v_{t+1} - (1 - d) v_t``, should be either zero (the
individual coasts) or have the length ``m u dt`` along one of the 12 directions of the egocentric
frame, ``m`` one of the M thrust magnitudes (one, in the paper). The fit minimises the squared
distance of ``r`` to the nearest of these 12 M + 1 points. Steps that miss by more than ``FAR``
times what nine tenths of all steps miss by are taken for tracking jumps and left out.

Three moves alternate: every step takes its nearest action (as in k-means), far misses are set
aside, and with these fixed the optimum (d, thrusts) solves linear equations. Where that would leave
the terminal speed below a given one, the optimum on the line of just that terminal speed takes its
place. Several magnitudes are held against fixed multiples of the one-magnitude thrust, and what
follows the recordings more closely is taken (``docs/data/fitting.md``).
"""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from animarl_envs import locomotion
from animarl_envs.array_types import Floats, Ints
from animarl_envs.compiling import jit
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.errors import InputError
from animarl_envs.fitting.tracking import track, tracking_errors
from animarl_envs.fitting.transitions import Transitions, transitions
from animarl_envs.kinematics import residual
from animarl_envs.locomotion import Locomotion, check_thrusts, fixed_multiples

FAR = 5.0  # a miss beyond so many times the BULK quantile of all misses is a tracking jump
BULK = 0.9
GRID_DAMPING = np.linspace(0.0, 1.0, 26)
GRID_QUANTILES = (0.2, 0.35, 0.5, 0.65, 0.8, 0.9, 0.95, 0.99)  # of |r| / dt, for the thrust
GRID_STEPS = 4000  # steps looked at from each grid point
STARTS = 6  # best grid points, refined with all steps
ITERATIONS = 300
TOLERANCE = 1e-9  # relative change of d and u at which the alternation has converged
CURVATURE_STEP = 0.05  # of the bootstrap's difference quotient; smaller ones are noisy
FAST = 0.99  # quantile of recorded speed that the terminal speed reaches
SEVERAL_TOLERANCE = 1e-5  # relative change at which a fit of several magnitudes has converged
_HALF_SQRT3 = math.sqrt(3.0) / 2.0


def joint_locomotion(demos: Demonstrations, thrusts: int = 1) -> tuple[Locomotion, ...]:
    """Fit damping, thrust and magnitudes of every individual to all episodes of ``demos``.

    ``thrusts`` is the number of magnitudes, M. One that never moves stops at once (d = 1) and has
    the largest thrust of the others, so that no push explains a step of it. Raises InputError if
    ``thrusts`` is none of 1 to 10, an individual has too few steps, or nobody moves.
    """
    check_thrusts(thrusts)
    names = demos.kinds
    alike = demos.num_individuals // len(names)  # of a group one stands for all
    every = [transitions(demos, i) for i in range(len(names))]
    moving = {
        name: fit_joint(data, f"{demos.name}: {name}")
        for data, name in zip(every, names, strict=True)
        if data.next_velocity.any() or len(data) < 3
    }
    if not moving:
        raise InputError(f"{demos.name}: no individual ever moves: check the tracks")
    still = Locomotion(1.0, max(one.thrust for one in moving.values()))
    ones = [moving.get(name, still) for name in names]
    if thrusts == 1:  # or the best fit that reaches the fast speed
        return alike * tuple(
            one
            if one.terminal_speed(demos.dt) >= fast_speed(data)
            else fit_joint(data, least_speed=fast_speed(data))
            for data, one in zip(every, ones, strict=True)
        )
    multiples = fixed_multiples(thrusts)
    fitted = [_fit_magnitudes(data, one, thrusts) for data, one in zip(every, ones, strict=True)]
    fixed = [_with_multiples(data, one, multiples) for data, one in zip(every, ones, strict=True)]
    errors = [
        tracking_errors(demos, track(demos, alike * each)).reshape(alike, -1).mean(axis=0)
        for each in (fitted, fixed)
    ]
    return alike * tuple(
        own if own_error < other_error else other
        for own, other, own_error, other_error in zip(fitted, fixed, *errors, strict=True)
    )


def fit_joint(
    data: Transitions,
    name: str = "the individual",
    least_speed: float = 0.0,
    far: float = FAR,
) -> Locomotion:
    """Fit damping and thrust of one individual by least squares without tracking jumps.

    The terminal speed ``u dt / d`` is at least ``least_speed`` [arena unit / s]; ``far`` says which
    misses are tracking jumps (``FAR``; infinity: none), and ``name`` is for messages. Raises
    InputError if there are fewer than three steps, or the individual never moves.
    """
    moving = np.hypot(data.next_velocity[:, 0], data.next_velocity[:, 1]) > 0
    if len(data) < 3 or not moving.any():
        raise InputError(
            f"{name} has {len(data)} steps, {int(moving.sum())} of them in motion: "
            "a fit needs at least three and some motion; check the track"
        )
    starts = [(damping, np.array([thrust])) for damping, thrust in _starting_points(data)]
    damping, thrusts = best_of(data, starts, least_speed, far=far)
    return Locomotion(damping, float(thrusts[0]))


def fast_speed(data: Transitions) -> float:
    """Return the speed that a fit must be able to reach [arena unit / s]."""
    speed = np.hypot(data.next_velocity[:, 0], data.next_velocity[:, 1])
    return float(np.quantile(speed, FAST)) if len(speed) else 0.0


def best_of(
    data: Transitions,
    starts: Sequence[tuple[float, Floats]],
    least_speed: float,
    tolerance: float = TOLERANCE,
    far: float = FAR,
) -> tuple[float, Floats]:
    """Return the best (d, thrusts) to which any of several starting points leads.

    Thrusts are ``(M,)`` [arena unit / s^2]; ``tolerance`` is the relative change of d and of the
    thrusts at which the search ends.
    """
    fitted = [_alternate(data, *start, least_speed, tolerance, far) for start in starts]
    damping, thrusts, loss = min(fitted, key=lambda one: one[2])
    return (damping, thrusts) if loss < math.inf else starts[0]


def bootstrap_joint(
    data: Transitions, fitted: Locomotion, weights: Floats, least_speed: float = 0.0
) -> Floats:
    """Return resampled (d, u), ``(resamples, 2)``, by one Newton step from a fit of one thrust.

    Each episode contributes its own gradient g_e of the objective; a resample that draws episode e
    ``w_e`` times moves the optimum by ``-H_w^-1 sum_e w_e g_e``. The curvature H_w is that of all
    data, scaled to the steps drawn; as a difference quotient it counts changes of action. This is
    the estimating-function bootstrap (Hu and Kalbfleisch 2000): to first order its intervals are
    those of refitting every resample, at a thousandth of the cost.

    ``weights`` ``(resamples, episodes)`` says how often each episode was drawn. Where the fit has
    just the ``least_speed`` as its terminal speed, it moves along the line of that speed.
    """
    point = np.array([fitted.damping, fitted.thrust])
    steps_drawn = weights @ np.bincount(data.episode, minlength=data.num_episodes)
    slope = (weights @ _gradients(data, point)) * (len(data) / steps_drawn)[:, None]
    bound = math.isclose(fitted.terminal_speed(data.dt), least_speed, rel_tol=1e-6)
    free = np.array([[data.dt / least_speed], [1.0]]) if bound else np.eye(2)
    slope = slope @ free
    # Half the Hessian: with all actions held fixed, and as a difference quotient.
    impulse = data.dt * nearest_actions(data, point[0], point[1:])[1]
    mixed = -np.sum(data.velocity * impulse)
    fixed = np.array([[np.sum(data.velocity**2), mixed], [mixed, np.sum(impulse**2)]])
    moved = -np.linalg.solve(free.T @ fixed @ free, slope.T).T
    rows = []
    for shift in np.diag(CURVATURE_STEP * np.array([1.0, fitted.thrust])):
        rise = _gradients(data, point + shift) - _gradients(data, point - shift)
        rows.append(rise.sum(axis=0) / (2 * shift.sum()))
    curvature = free.T @ (0.5 * (np.array(rows) + np.array(rows).T)) @ free
    if (np.linalg.eigvalsh(curvature) > 0).all():
        moved = -np.linalg.solve(curvature, slope.T).T
    return np.asarray(np.maximum(point + moved @ free.T, 0.0))


def _starting_points(data: Transitions) -> list[tuple[float, float]]:
    """Return the most promising cells of a grid over d and u."""
    every = max(1, len(data) // GRID_STEPS)
    few = replace(
        data,
        velocity=np.ascontiguousarray(data.velocity[::every]),
        next_velocity=np.ascontiguousarray(data.next_velocity[::every]),
        focus=np.ascontiguousarray(data.focus[::every]),
    )
    cells = []
    for damping in GRID_DAMPING.tolist():
        rest = locomotion.residual(few.next_velocity, few.velocity, damping)
        length = np.hypot(rest[:, 0], rest[:, 1]) / data.dt
        for thrust in np.unique(np.quantile(length[length > 0], GRID_QUANTILES)):
            error = nearest_actions(few, damping, np.array([thrust]))[0]
            cells.append((_loss(error), damping, float(thrust)))
    cells.sort()
    return [(damping, thrust) for _, damping, thrust in cells[:STARTS]]


def _alternate(
    data: Transitions,
    damping: float,
    thrusts: Floats,
    least_speed: float,
    tolerance: float,
    far: float,
) -> tuple[float, Floats, float]:
    """Alternate until nothing changes: assign actions, leave jumps out, solve.

    Returns d, thrusts and the mean loss.
    """
    for _ in range(ITERATIONS):
        error, action, level = nearest_actions(data, damping, thrusts)
        vv, vn, va, aa, an = sums(
            data.velocity,
            data.next_velocity,
            action,
            level,
            error,
            _limit(error, far),
            data.dt,
            len(thrusts),
        )
        new_damping, new_thrusts = _solve(vv, vn, va, aa, an, thrusts, data.dt, least_speed)
        if not (new_thrusts > 0).all():
            return damping, thrusts, math.inf
        change = max(abs(new_damping - damping), np.max(np.abs(new_thrusts - thrusts) / thrusts))
        damping, thrusts = new_damping, new_thrusts
        if change < tolerance:
            break
    return damping, thrusts, _loss(nearest_actions(data, damping, thrusts)[0], far)


def nearest_actions(
    data: Transitions, damping: float, thrusts: Floats
) -> tuple[Floats, Floats, Ints]:
    """Return for every step the nearest action's squared miss, vector and thrust number."""
    fitted = np.empty(len(data)), np.empty((len(data), 2)), np.empty(len(data), dtype=np.int64)
    assign(data.velocity, data.next_velocity, data.focus, damping, thrusts * data.dt, *fitted)
    return fitted


def _solve(
    vv: float,
    vn: float,
    va: Floats,
    aa: Floats,
    an: Floats,
    thrusts: Floats,
    dt: float,
    least_speed: float,
) -> tuple[float, Floats]:
    """Solve v' = (1 - d) v + sum_j u_j (dt a_j) by least squares, from its :func:`sums`.

    The terminal speed of the largest thrust is at least ``least_speed``. A thrust that no step is
    nearest to stays what it was.
    """
    used = aa > 0
    if not used.any():
        return 0.0, np.zeros_like(thrusts)
    va, aa, an = va[used], aa[used], an[used]
    remainder = vv - float(np.sum(va * va / aa))
    kept = 0.0
    if remainder > 1e-12 * vv:
        kept = (vn - float(np.sum(va * an / aa))) / remainder
    kept = min(max(kept, 0.0), 1.0)
    fitted = thrusts.copy()
    fitted[used] = (an - kept * va) / aa
    top = int(np.argmax(fitted))
    if (1.0 - kept) * least_speed > fitted[top] * dt:
        # d = u_top dt / least_speed: the regressor of u_top then is dt a_top - share v.
        share = dt / least_speed
        own = np.flatnonzero(used) == top
        gram = np.diag(aa) - share * (np.outer(own, va) + np.outer(va, own))
        gram += share**2 * vv * np.outer(own, own)
        right = an - va - share * (vn - vv) * own
        if own.any():
            fitted[used] = np.linalg.solve(gram, right)
        kept = 1.0 - min(float(fitted[top]) * share, 1.0)
    return 1.0 - kept, fitted


def _limit(error: Floats, far: float = FAR) -> float:
    """Return the squared error beyond which a step is a tracking jump."""
    if math.isinf(far):
        return math.inf
    rank = math.ceil(BULK * len(error)) - 1
    return far**2 * float(np.partition(error, rank)[rank])


def _loss(error: Floats, far: float = FAR) -> float:
    """Return the mean squared error, jumps counted at the limit."""
    return float(np.minimum(error, _limit(error, far)).mean())


def _gradients(data: Transitions, point: Floats) -> Floats:
    """Return half the gradient of the loss by (d, u), per episode ``(episodes, 2)``."""
    error, action, _ = nearest_actions(data, point[0], point[1:])
    kept = error <= _limit(error)
    impulse = data.dt * action
    miss = locomotion.residual(data.next_velocity, data.velocity, float(point[0]))
    miss = miss - point[1] * impulse
    terms = np.sum(miss * data.velocity, axis=1), -np.sum(miss * impulse, axis=1)
    each = [np.bincount(data.episode, term * kept, data.num_episodes) for term in terms]
    return np.stack(each, axis=1)


def _with_multiples(data: Transitions, one: Locomotion, multiples: Sequence[float]) -> Locomotion:
    """Return a fit with fixed multiples, damped little enough to reach the fast speed."""
    fast = fast_speed(data)
    largest = one.thrust * multiples[0] * data.dt
    damping = one.damping if one.damping * fast <= largest else largest / fast
    return Locomotion(damping, one.thrust, tuple(multiples))


def _fit_magnitudes(data: Transitions, one: Locomotion, thrusts: int) -> Locomotion:
    """Fit d and all thrusts of one individual by least squares."""
    rest = locomotion.residual(data.next_velocity, data.velocity, one.damping)
    length = np.hypot(rest[:, 0], rest[:, 1]) / data.dt
    length = length[length > 0.5 * min(fixed_multiples(thrusts)) * one.thrust]
    spread = (np.arange(thrusts) + 0.5) / thrusts
    guesses = [one.thrust * np.array(fixed_multiples(thrusts))]
    if len(length):
        guesses.append(np.quantile(length, spread))
    starts = [(one.damping, guess) for guess in guesses]
    damping, fitted = best_of(data, starts, fast_speed(data), SEVERAL_TOLERANCE)
    ordered = np.unique(fitted)[::-1] / one.thrust
    if len(ordered) < thrusts:  # some coincide: exact tracks of fewer magnitudes
        return _with_multiples(data, one, fixed_multiples(thrusts))
    return Locomotion(damping, one.thrust, tuple(ordered.tolist()))


# -- kernels ----------------------------------------------------------------------------------


@jit
def assign(  # type: ignore[no-untyped-def]
    velocity, next_velocity, focus, damping, impulses, error, action, level
):
    """Find the action nearest to each observed acceleration.

    ``impulses`` ``(M,)`` are the thrusts times dt. Writes the squared error ``(steps,)`` of the
    rebuilt velocity, the action's unit vector in the arena frame ``(steps, 2)``, zero for coasting,
    and which thrust it has ``(steps,)``. Directions are searched in one quadrant.
    """
    for t in range(velocity.shape[0]):
        rest_x = residual(next_velocity[t, 0], velocity[t, 0], damping)
        rest_y = residual(next_velocity[t, 1], velocity[t, 1], damping)
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
        nearest, least = -1, 0.0
        for j in range(len(impulses)):
            gain = impulses[j] * (impulses[j] - 2.0 * along)
            if gain < least:
                nearest, least = j, gain
        level[t] = nearest
        if nearest >= 0:  # nearer to that direction than to zero
            c = c if ahead >= 0 else -c
            s = s if left >= 0 else -s
            action[t, 0] = c * focus[t, 0] - s * focus[t, 1]
            action[t, 1] = c * focus[t, 1] + s * focus[t, 0]
            impulse = impulses[nearest]
            error[t] = max(square - 2.0 * impulse * along + impulse * impulse, 0.0)
        else:
            action[t, 0] = 0.0
            action[t, 1] = 0.0
            error[t] = square


@jit
def sums(velocity, next_velocity, action, level, error, limit, dt, thrusts):  # type: ignore[no-untyped-def]
    """Return inner products over steps with ``error <= limit``; with actions, per thrust."""
    vv, vn = 0.0, 0.0
    va, aa, an = np.zeros(thrusts), np.zeros(thrusts), np.zeros(thrusts)
    for t in range(velocity.shape[0]):
        if error[t] > limit:
            continue
        j = level[t]
        for axis in range(2):
            v, n, a = velocity[t, axis], next_velocity[t, axis], dt * action[t, axis]
            vv += v * v
            vn += v * n
            if j >= 0:
                va[j] += v * a
                aa[j] += a * a
                an[j] += a * n
    return vv, vn, va, aa, an
