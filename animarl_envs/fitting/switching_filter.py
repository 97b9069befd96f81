"""How probable noisy positions are under v' = (1 - d) v + u a dt with actions that nobody saw.

The state (position, velocity) is hidden, the action switches, positions are read with Gaussian
noise: a switching Kalman filter. One Gaussian is kept per action; each step makes every pair
(last action, present action) and merges the pairs of each present action by their first two moments
(generalised pseudo-Bayes of second order: Blom and Bar-Shalom 1988; Murphy 1998). Axes are filtered
separately. Last actions less probable than ``NEGLIGIBLE`` are left out.
"""

from __future__ import annotations

import math

from animarl_envs.compiling import jit, part

NEGLIGIBLE = 1e-4
PLACE, VELOCITY = 0, 1
# What is known of a last action before the present one pushes: the miss of the next position, the
# velocity, the variance of the miss, the gains, and what remains of the variances.
MISS, SPEED, PRECISION, BY_PLACE, BY_VELOCITY, P00, P01, P11, AT = range(9)
PAIR = 3  # scratch among the weights


@jit
def log_likelihood(  # type: ignore[no-untyped-def]
    positions, focus, first, directions, dt, spread, parameters, shares, hypotheses, episodes, taken
):
    """Sum over episodes, each of which is also written to ``episodes``.

    Parameters
    ----------
    positions, focus
        ``(frames, 2)``, read positions and unit vectors towards the focus.
    first
        ``(episodes + 1,)``, first frames.
    directions
        ``(A, 2)``, of the actions in the egocentric frame; zero for coasting.
    dt, spread
        Time step [s]; standard deviation of velocities at the start of an episode.
    parameters
        Damping d, impulse u dt, noise (of positions), and the probability that an action is kept;
        otherwise the next one is drawn by ``shares`` ``(A,)``.
    hypotheses
        Scratch: means ``(2, A, 2, 2)``, variances ``(2, A, 2, 3)``, weights ``(4, A)``, and
        predictions ``(A, 2, 9)``.
    taken
        ``(A,)``, gets the expected number of steps of each action.
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
