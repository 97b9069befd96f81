"""Damping, thrust and tracking noise together: maximum likelihood with hidden states and actions.

Tracking noise of a tenth of a median step doubles the thrust of the joint fit, which must explain
every jitter by an action. Here positions are read with noise, and what the animal did is summed
over. Actions are kept with a fitted probability; how often each is chosen is found by fixed point.
Intervals are of Student's t with the sandwich variance over episodes, since the steps of an episode
depend on each other.

The state (position, velocity) is hidden, the action switches, positions are read with Gaussian
noise: a switching Kalman filter. One Gaussian is kept per action; each step makes every pair
(last action, present action) and merges the pairs of each present action by their first two moments
(generalised pseudo-Bayes of second order: Blom and Bar-Shalom 1988; Murphy 1998). Axes are filtered
separately. Last actions less probable than ``NEGLIGIBLE`` are left out.
"""

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from animarl_envs.compiling import jit, part
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.fitting.joint import fit_joint
from animarl_envs.fitting.transitions import transitions
from animarl_envs.locomotion import ACTION_VECTORS, NUM_ACTIONS, Locomotion, apply_actions

Floats = NDArray[np.float64]

Interval = tuple[float, float]
CONFIDENCE = 0.95
MOST_STEPS = 4000  # looked at: more make the intervals narrower than the model is right
FEWEST_EPISODES = 3  # for an interval
FIRST_NOISE = (0.02, 0.1, 0.3)  # of a median step: where the search starts
LEAST_NOISE = 2e-3  # of a median step; with less the joint fit is exact
ROUNDS = 3  # of the shares of actions
REPLICATES = 4  # simulated tracks that measure the bias

NEGLIGIBLE = 1e-4
PLACE, VELOCITY = 0, 1
# What is known of a last action before the present one pushes: the miss of the next position, the
# velocity, the variance of the miss, the gains, and what remains of the variances.
MISS, SPEED, PRECISION, BY_PLACE, BY_VELOCITY, P00, P01, P11, AT = range(9)
PAIR = 3  # scratch among the weights


@dataclass(frozen=True)
class NoisyFit:
    """Locomotion and tracking noise of one individual.

    Intervals are ``None`` with fewer than three episodes and for exact tracks, whose noise is 0.
    """

    damping: float
    thrust: float  # [arena unit / s^2]
    noise: float  # standard deviation of each coordinate of a position [arena unit]
    kept: float  # probability that an action is kept for another step
    median_step: float  # recorded [arena unit]
    damping_interval: Interval | None
    thrust_interval: Interval | None
    noise_interval: Interval | None

    @property
    def share_of_step(self) -> float:
        """The noise in units of the median recorded step."""
        return self.noise / self.median_step


def fit_with_noise(
    demos: Demonstrations, individual: int, *, most_steps: int = MOST_STEPS, intervals: bool = True
) -> NoisyFit:
    """Fit damping, one thrust and the tracking noise of an individual (an index).

    Whole episodes are taken from the first on until ``most_steps`` steps are there. ``intervals``
    says whether intervals are made and the bias of the merging is taken out; both need time. Raises
    InputError if there are fewer than three steps, or the individual never moves.
    """
    name = f"{demos.name}: {demos.individuals[individual]}"
    enough = int(np.searchsorted(np.cumsum(demos.lengths - 1), most_steps, side="right"))
    few = demos.select(episodes=np.arange(max(1, enough)))
    joint = fit_joint(transitions(few, individual), name)
    model = _Model(few, individual)
    step = model.median_step
    found = [
        model.search(
            _logits(max(joint.damping, 0.02), joint.thrust * few.dt, share * step, 0.5), 60, 0.5
        )
        for share in FIRST_NOISE
    ]
    point = min(found, key=lambda one: one[0])[1]
    for _ in range(ROUNDS):
        model.negative(point)
        # Shares of actions; none is impossible.
        model.shares = (model.taken + 1) / (model.taken.sum() + NUM_ACTIONS)
        point = model.search(point, 100, 0.1)[1]
    if _natural(point)[2] < LEAST_NOISE * step:
        kept = _natural(point)[3]
        return NoisyFit(joint.damping, joint.thrust, 0.0, kept, step, None, None, None)
    around: list[Interval | None] = [None] * 3
    if intervals:
        bounds, bias = model.intervals(point), model.bias(point)
        point = point - bias
        if bounds is not None:
            low, high = (_natural(side - bias) for side in bounds)
            around = [(low[0], high[0]), (low[1] / few.dt, high[1] / few.dt), (low[2], high[2])]
    damping, impulse, noise, kept = _natural(point)
    return NoisyFit(damping, impulse / few.dt, noise, kept, step, *around)


class _Model:
    """One individual's track, how often its actions are chosen, and the filter's scratch."""

    def __init__(self, demos: Demonstrations, individual: int) -> None:
        A = NUM_ACTIONS
        steps = np.linalg.norm(demos.velocities()[:, individual], axis=1) * demos.dt
        self.median_step = float(np.median(steps[steps > 0]))
        self.positions = np.ascontiguousarray(demos.positions[:, individual])
        self.focus = np.ascontiguousarray(demos.focus()[:, individual])
        self.first, self.dt = demos.offsets.astype(np.int64), demos.dt
        self.shares, self.taken = np.full(A, 1 / A), np.zeros(A)
        self.episodes = np.zeros(demos.num_episodes)
        self.hypotheses = (
            np.zeros((2, A, 2, 2)), np.zeros((2, A, 2, 3)), np.zeros((4, A)), np.zeros((A, 2, 9))
        )  # fmt: skip

    def negative(self, point: Floats) -> float:
        """Minus the log likelihood per frame; ``episodes`` and ``taken`` are filled."""
        damping, impulse, noise, kept = _natural(point)
        parameters = damping, impulse, math.hypot(noise, LEAST_NOISE * self.median_step), kept
        total = log_likelihood(
            self.positions, self.focus, self.first, ACTION_VECTORS, self.dt,
            3.0 * self.median_step / self.dt, parameters, self.shares, self.hypotheses,
            self.episodes, self.taken,
        )  # fmt: skip
        return float(-total / len(self.positions)) if math.isfinite(total) else math.inf

    def search(self, point: Floats, calls: int, size: float) -> tuple[float, Floats]:
        """Nelder and Mead's search from ``point``."""
        from scipy.optimize import minimize

        corners = np.vstack([point, point + size * np.eye(len(point))])
        options = {"maxfev": calls, "xatol": 1e-3, "fatol": 1e-7, "initial_simplex": corners}
        found = minimize(self.negative, point, method="Nelder-Mead", options=options)
        return float(found.fun), np.asarray(found.x)

    def intervals(self, point: Floats) -> tuple[Floats, Floats] | None:
        """Lower and upper ends, unbounded; the sandwich over episodes, and what the bias adds."""
        from scipy.stats import t as student

        count = len(self.episodes)
        if count < FEWEST_EPISODES:
            return None

        def per_episode(at: Floats) -> Floats:
            self.negative(at)
            return self.episodes.copy()

        scores = _gradient(per_episode, point)  # (episodes, 4)
        curvature = _gradient(lambda at: _gradient(per_episode, at).sum(0), point)
        inverse = np.linalg.pinv(-(curvature + curvature.T) / 2)
        scores = scores - scores.mean(0)
        variance = inverse @ (scores.T @ scores * count / (count - 1)) @ inverse
        spread = np.sqrt(np.maximum(np.diag(variance), 0) * (1 + 1 / REPLICATES))
        half = student.ppf(0.5 + CONFIDENCE / 2, count - 1) * spread
        return point - half, point + half

    def bias(self, point: Floats) -> Floats:
        """Return the bias of merging hypotheses: the mean shift of fits to simulated tracks."""
        rng, shifts, recorded = np.random.default_rng(0), [], self.positions
        for _ in range(REPLICATES):
            self.positions = self._simulate(recorded, point, rng)
            shifts.append(self.search(point, 80, 0.1)[1] - point)
        self.positions = recorded
        return np.asarray(np.mean(shifts, axis=0))

    def _simulate(self, recorded: Floats, point: Floats, rng: np.random.Generator) -> Floats:
        """Tracks ``(frames, 2)`` of the model, from recorded starts and focus directions."""
        damping, impulse, noise, kept = _natural(point)
        own, path = Locomotion(damping, impulse), recorded.copy()
        for begin, end in itertools.pairwise(self.first.tolist()):
            velocity = (path[min(begin + 1, end - 1)] - path[begin]) / self.dt
            action = rng.choice(NUM_ACTIONS, p=self.shares)
            for t in range(begin, end - 1):
                if rng.random() >= kept:
                    action = rng.choice(NUM_ACTIONS, p=self.shares)
                velocity = apply_actions(velocity, np.array(action), self.focus[t], own, dt=1.0)
                path[t + 1] = path[t] + self.dt * velocity
        return path + noise * rng.standard_normal(path.shape)


def _gradient(function: Callable[[Floats], Floats], point: Floats, step: float = 0.01) -> Floats:
    """Central differences, the last axis along the parameters."""
    columns = []
    for k in range(len(point)):
        offset = step * np.eye(len(point))[k]
        columns.append((function(point + offset) - function(point - offset)) / (2 * step))
    return np.stack(columns, axis=-1)


def _logits(damping: float, impulse: float, noise: float, kept: float) -> Floats:
    """Parameters without bounds, for the search."""
    shares = np.clip([damping, kept], 1e-4, 1 - 1e-4)
    odds = np.log(shares / (1 - shares))
    return np.array([odds[0], math.log(impulse), math.log(noise), odds[1]])


def _natural(point: Floats) -> tuple[float, float, float, float]:
    """Damping, impulse, noise and the probability of keeping an action."""
    damping, kept = 1 / (1 + np.exp(-np.clip(point[[0, 3]], -30, 30)))
    impulse, noise = np.exp(np.clip(point[[1, 2]], -60, 60))
    return float(damping), float(impulse), float(noise), float(kept)


# -- kernels ----------------------------------------------------------------------------------


@jit
def log_likelihood(  # type: ignore[no-untyped-def]
    positions, focus, first, directions, dt, spread, parameters, shares, hypotheses, episodes, taken
):
    """Sum over episodes, each of which is also written to ``episodes``.

    ``spread`` is the standard deviation of velocities at the start of an episode, ``directions``
    ``(A, 2)`` those of the actions, of which the next is drawn by ``shares``, where it is not kept;
    ``hypotheses`` are means, variances, weights and predictions, ``taken`` ``(A,)`` gets the
    expected number of steps of each action.
    """
    damping, impulse, noise, kept = parameters
    means, variances, weights, _ = hypotheses
    A = len(shares)
    taken[:] = 0.0
    total = 0.0
    for e in range(len(first) - 1):
        begin, end = first[e], first[e + 1]
        for j in range(A):
            weights[0, j] = shares[j]
            for x in range(2):
                means[0, j, x, PLACE], means[0, j, x, VELOCITY] = positions[begin, x], 0.0
                variances[0, j, x, 0], variances[0, j, x, 1] = noise * noise, 0.0
                variances[0, j, x, 2] = spread * spread
        episode = 0.0
        for t in range(begin, end - 1):
            _predict(1.0 - damping, dt, noise, positions[t + 1], hypotheses)
            highest = -math.inf
            for j in range(A):
                ahead, left = impulse * directions[j, 0], impulse * directions[j, 1]
                push = (
                    ahead * focus[t, 0] - left * focus[t, 1],
                    ahead * focus[t, 1] + left * focus[t, 0],
                )
                weights[1, j] = _merge(j, dt, push, kept, shares[j], hypotheses)
                highest = max(highest, weights[1, j])
            together = 0.0
            for j in range(A):
                weights[0, j] = math.exp(weights[1, j] - highest)
                together += weights[0, j]
            episode += highest + math.log(together)
            for j in range(A):
                weights[0, j] /= together
                if t > begin:
                    taken[j] += weights[0, j]
            means[0] = means[1]
            variances[0] = variances[1]
        episodes[e] = episode
        total += episode
    return total


@part
def _predict(keep, dt, noise, read, hypotheses):  # type: ignore[no-untyped-def]
    """All that does not depend on the present action; ``weights[2]`` gets log densities so far."""
    means, variances, weights, predictions = hypotheses
    c = dt * keep
    for i in range(weights.shape[1]):
        if weights[0, i] < NEGLIGIBLE:
            weights[2, i] = -math.inf
            continue
        density = weights[0, i]
        for x in range(2):
            p00, p01, p11 = variances[0, i, x, 0], variances[0, i, x, 1], variances[0, i, x, 2]
            q00, q01 = p00 + 2.0 * c * p01 + c * c * p11, keep * (p01 + c * p11)
            total = q00 + noise * noise
            known = predictions[i, x]
            known[SPEED] = keep * means[0, i, x, VELOCITY]
            known[AT] = means[0, i, x, PLACE] + dt * known[SPEED]
            known[MISS] = read[x] - known[AT]
            known[PRECISION] = 1.0 / total
            known[BY_PLACE], known[BY_VELOCITY] = q00 / total, q01 / total
            known[P00] = q00 * (1.0 - known[BY_PLACE])
            known[P01] = q01 * (1.0 - known[BY_PLACE])
            known[P11] = keep * keep * p11 - known[BY_VELOCITY] * q01
            density /= math.sqrt(2.0 * math.pi * total)
        weights[2, i] = math.log(density)


@part
def _merge(j, dt, push, kept, share, hypotheses):  # type: ignore[no-untyped-def]
    """Correct by what is read, for each last action, and merge; the log weight of action ``j``."""
    means, variances, weights, predictions = hypotheses
    A = weights.shape[1]
    stays, comes = math.log(kept + (1.0 - kept) * share), math.log((1.0 - kept) * share)
    top = -math.inf
    for i in range(A):
        weights[PAIR, i] = weights[2, i]
        if weights[2, i] > -math.inf:
            for x in range(2):
                miss = predictions[i, x, MISS] - dt * push[x]
                weights[PAIR, i] -= 0.5 * miss * miss * predictions[i, x, PRECISION]
            weights[PAIR, i] += stays if i == j else comes
            top = max(top, weights[PAIR, i])
    together = 0.0
    for i in range(A):
        weights[PAIR, i] = math.exp(weights[PAIR, i] - top)
        together += weights[PAIR, i]
    for x in range(2):
        place, velocity, p00, p01, p11 = 0.0, 0.0, 0.0, 0.0, 0.0
        origin, pace = predictions[0, x, AT], predictions[0, x, SPEED]
        for i in range(A):
            share_i = weights[PAIR, i] / together
            if share_i > 0.0:
                known = predictions[i, x]
                miss = known[MISS] - dt * push[x]
                at = known[AT] + dt * push[x] + known[BY_PLACE] * miss - origin
                going = known[SPEED] + push[x] + known[BY_VELOCITY] * miss - pace
                place += share_i * at
                velocity += share_i * going
                p00 += share_i * (known[P00] + at * at)
                p01 += share_i * (known[P01] + at * going)
                p11 += share_i * (known[P11] + going * going)
        means[1, j, x, PLACE], means[1, j, x, VELOCITY] = place + origin, velocity + pace
        variances[1, j, x, 0] = p00 - place * place
        variances[1, j, x, 1] = p01 - place * velocity
        variances[1, j, x, 2] = p11 - velocity * velocity
    return top + math.log(together)
