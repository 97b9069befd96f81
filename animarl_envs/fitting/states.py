"""States of locomotion, such as rest and go: a hidden Markov model, d and u of its own in each.

In state s a step is ``v' = (1 - d_s) v + u_sj a dt`` plus a Gaussian error of standard deviation
``noise_s``: ``a`` is one of the 12 directions of the egocentric frame, ``j`` one of the thrust
magnitudes, or nothing is pushed. Pushes have the same probabilities in all states, so that states
differ in what a push does and not in where an animal wants to go. States are sticky: the next one
is most often the same (Rabiner 1989; Fox et al. 2011). Expectation maximisation fits all of it on
training episodes. A rare broad error stands for tracking jumps.

Models are compared by the likelihood of steps of episodes that no fit has seen, in nats a step.
More thrust magnitudes in one state are the rival of more states: both add speeds, only states
make them last.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from animarl_envs import locomotion
from animarl_envs.compiling import jit
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.errors import InputError
from animarl_envs.fitting.joint import fast_speed, fit_joint
from animarl_envs.fitting.transitions import transitions, whole_steps

Floats = NDArray[np.float64]

MOST_STATES = 5
MOST_STEPS = 6_000  # of training, in whole episodes: a fit takes seconds
ITERATIONS = 200
TOLERANCE = 1e-5  # nats a step by which an iteration must gain
JUMPS = 0.002  # share of steps that the broad error explains
BROAD = 5.0  # its standard deviation over that of the velocity's changes
STICKY = 10.0  # steps of staying that are added to what was counted
TINY = 1e-300  # in the place of zero, whose logarithm there is none of
LEAST_NOISE = 1e-3  # of the velocity's changes
MATTERS = 0.01  # nats a step; a smaller gain is none
LEAST_SHARE = 0.01  # of all steps; a state that holds less is not supported by the data


@dataclass(frozen=True, eq=False)
class Steps:
    """Steps of one kind of animal, sequence after sequence, in the egocentric frame.

    ``before`` and ``after`` ``(steps, 2)`` are velocities [arena unit / s]; ``begins`` ``(steps,)``
    is true where a sequence begins.
    """

    before: Floats
    after: Floats
    begins: NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.before)


@dataclass(frozen=True, eq=False)
class StateFit:
    """Locomotion in S states with M thrust magnitudes, the slowest state first."""

    damping: Floats  # (S,)
    thrusts: Floats  # (S, M) [arena unit / s^2]
    noise: Floats  # (S,), standard deviation of a velocity's error [arena unit / s]
    pushes: Floats  # (12 M + 1,), probabilities of the actions
    stay: Floats  # (S, S), probabilities of the next state
    broad: float  # standard deviation of tracking jumps [arena unit / s]
    dt: float  # [s]
    held_out: Floats  # nats a step of each episode that the fit has not seen

    @property
    def share(self) -> Floats:
        """Share of time in each state, in the long run."""
        states = len(self.stay)
        rows = np.vstack([self.stay.T - np.eye(states), np.ones(states)])
        return np.asarray(np.linalg.lstsq(rows, np.eye(states + 1)[-1], rcond=None)[0])

    @property
    def bout(self) -> Floats:
        """Mean time for which a state lasts [s]; infinite where there is one state."""
        with np.errstate(divide="ignore"):
            return self.dt / (1.0 - np.diag(self.stay))

    @property
    def bodies(self) -> tuple[locomotion.Locomotion, ...]:
        """The locomotion of each state."""
        found = []
        for damping, thrusts in zip(self.damping, np.sort(self.thrusts)[:, ::-1]):
            falling = thrusts / thrusts[0] * (1.0 - 1e-9 * np.arange(len(thrusts)))
            found.append(locomotion.Locomotion(damping, thrusts[0], tuple(falling)))
        return tuple(found)

    @property
    def supported(self) -> bool:
        """Whether every state holds a hundredth of the steps or more."""
        return bool(self.share.min() >= LEAST_SHARE)


def compare_states(
    demos: Demonstrations, individual: int, states: Sequence[int], thrusts: Sequence[int]
) -> tuple[list[StateFit], int]:
    """Fit every number of states (1 to 5) with every number of thrusts each; say which is best.

    Fitted on train, compared on val; animals of a group that are alike are fitted together. The
    best has the fewest parameters among those whose held-out likelihood is within one standard
    error, over episodes, of the highest (Breiman et al. 1984), or a hundredth of a nat. Returns the
    fits, states in the outer loop, and its index.

    Raises InputError if a number of states is none of 1 to 5, or there are no episodes to train or
    validate.
    """
    for number in states:
        if not 1 <= number <= MOST_STATES:
            raise InputError(f"states is {number}: choose 1 to {MOST_STATES}")
    for split in ("train", "val"):
        if not (demos.split == split).any():
            raise InputError(
                f"{demos.name}: it has no {split} episodes, and states are fitted on train and "
                "compared on val: import it with at least 3 recordings"
            )
    training, unseen = demos.select(split="train"), demos.select(split="val")
    data = transitions(training, individual)
    one = fit_joint(data, f"{demos.name}: {demos.individuals[individual]}", fast_speed(data))
    last = int(np.searchsorted(np.cumsum(training.lengths - 1), MOST_STEPS)) + 1
    seen = _steps(training.select(episodes=np.arange(min(last, len(training)))), individual)
    held_out = [
        _steps(unseen.select(episodes=np.array([episode])), individual)
        for episode in range(len(unseen))
    ]

    def fitted(count: int, magnitudes: int) -> StateFit:
        starts = _starts(seen, one, count, magnitudes, demos.dt)
        best, _ = max((_maximise(seen, *start) for start in starts), key=lambda found: found[1])
        nats = [_expected(steps, best)[0] / len(steps) for steps in held_out if len(steps)]
        return replace(best, held_out=np.array(nats))

    fits = [fitted(count, magnitudes) for count in states for magnitudes in thrusts]
    top = max(fits, key=lambda fit: fit.held_out.mean())

    def near(fit: StateFit) -> bool:
        less = top.held_out - fit.held_out
        error = less.std(ddof=1) / math.sqrt(len(less)) if len(less) > 1 else 0.0
        return fit.supported and bool(less.mean() <= max(error, MATTERS))

    fitting = [i for i, fit in enumerate(fits) if near(fit)] or [fits.index(top)]
    return fits, min(
        fitting, key=lambda i: fits[i].pushes.size + fits[i].thrusts.size + fits[i].stay.size
    )


def states_of(demos: Demonstrations, individual: int, fit: StateFit) -> NDArray[np.int64]:
    """The state of each step of an individual, or of all that are alike: ``(frames, 1 or K)``.

    The most probable one given all steps of its episode; 0 at frames without a step.
    """
    seen = _steps(demos, individual)
    found = _expected(seen, fit)[1].argmax(axis=1)
    path = np.zeros((len(demos.positions), demos.num_individuals if demos.is_group else 1), int)
    path[whole_steps(demos)] = found.reshape(path.shape[1], -1).T
    return path


def _steps(demos: Demonstrations, individual: int) -> Steps:
    """Steps of an individual, or of all that are alike, sequence after sequence."""
    data = transitions(demos, individual)
    alike = demos.num_individuals if demos.is_group else 1  # rows of one frame stand together
    ahead = data.focus
    left = np.stack([-ahead[:, 1], ahead[:, 0]], axis=1)

    def ordered(values: NDArray[np.generic]) -> NDArray[np.generic]:
        return np.concatenate([values[who::alike] for who in range(alike)])

    def turned(velocity: Floats) -> Floats:
        ego = np.stack([(velocity * ahead).sum(axis=1), (velocity * left).sum(axis=1)], axis=1)
        return np.asarray(ordered(ego), dtype=np.float64)

    episode = ordered(data.episode)
    begins = np.ones(len(data), dtype=bool)
    begins[1:] = episode[1:] != episode[:-1]
    begins[:: max(len(data) // alike, 1)] = True
    return Steps(turned(data.velocity), turned(data.next_velocity), begins)


def _starts(
    seen: Steps, one: locomotion.Locomotion, states: int, thrusts: int, dt: float
) -> list[tuple[Floats, StateFit]]:
    """Where the search begins: steps dealt to states by speed, and by acceleration, over a second.

    Each is the probabilities of states, ``(steps, S)``, with a model of one locomotion for all.
    """
    change = seen.after - seen.before
    spread = math.sqrt(float((change**2).mean())) or 1e-9
    actions = locomotion.NUM_DIRECTIONS * thrusts + 1
    model = StateFit(
        damping=np.full(states, one.damping),
        thrusts=np.tile(one.thrust * np.array(locomotion.fixed_multiples(thrusts)), (states, 1)),
        noise=np.full(states, 0.3 * spread),
        pushes=np.full(actions, 1.0 / actions),
        stay=np.full((states, states), 0.1 / max(states - 1, 1)),
        broad=BROAD * spread,
        dt=dt,
        held_out=np.empty(0),
    )
    np.fill_diagonal(model.stay, 0.9 if states > 1 else 1.0)
    window = np.ones(min(max(round(1.0 / dt), 1), len(seen)))
    found = []
    for quantity in (seen.after, change) if states > 1 else (seen.after,):
        length = np.hypot(quantity[:, 0], quantity[:, 1])
        ranks = np.argsort(np.argsort(np.convolve(length, window, "same"), kind="stable"))
        state = ranks * states // len(ranks)
        found.append((0.8 * np.eye(states)[state] + 0.2 / states, model))
    return found


def _maximise(seen: Steps, weight: Floats, model: StateFit) -> tuple[StateFit, float]:
    """Expectation maximisation; returns the model, slowest state first, and its nats a step."""
    counts = np.zeros_like(model.stay)
    found = -math.inf
    for _ in range(ITERATIONS):
        model = _fitted(seen, weight, counts, model)
        nats, weight, counts = _expected(seen, model)
        if nats / len(seen) < found + TOLERANCE:
            break
        found = nats / len(seen)
    speed = model.thrusts.max(axis=1) * model.dt / np.maximum(model.damping, 1e-3)
    order = np.argsort(speed)
    model = replace(
        model, damping=model.damping[order], thrusts=model.thrusts[order],
        noise=model.noise[order], stay=model.stay[order][:, order],
    )  # fmt: skip
    return model, found


def _misses(seen: Steps, damping: float, vectors: Floats) -> Floats:
    """Squared distance of each step's push to each of ``vectors``, ``(steps, 12 M + 1)``."""
    rest = locomotion.residual(seen.after, seen.before, damping)
    square = (rest**2).sum(axis=1)[:, None] - 2 * rest @ vectors.T + (vectors**2).sum(axis=1)
    return np.asarray(square)


def _log_actions(seen: Steps, model: StateFit, state: int) -> tuple[Floats, Floats]:
    """Log density of each step with each action, ``(steps, 12 M + 1)``, and of it in all,
    ``(steps,)``, where it may be a tracking jump as well.
    """
    change = ((seen.after - seen.before) ** 2).sum(axis=1)
    jump = math.log(JUMPS) + _log_normal(change, model.broad)
    vectors = model.dt * locomotion.action_vectors(tuple(model.thrusts[state]))
    square = _misses(seen, float(model.damping[state]), vectors)
    each = math.log1p(-JUMPS) + np.log(model.pushes + TINY)
    each = each + _log_normal(square, float(model.noise[state]))
    return each, np.logaddexp(np.logaddexp.reduce(each, axis=1), jump)


def _log_normal(square: Floats, deviation: float) -> Floats:
    """Log density of a Gaussian error in the plane, of that squared length."""
    return -square / (2 * deviation**2) - math.log(2 * math.pi * deviation**2)


def _expected(seen: Steps, model: StateFit) -> tuple[float, Floats, Floats]:
    """Nats of all steps, the probabilities of states ``(steps, S)``, and the counts ``(S, S)`` of
    which state follows which.
    """
    emission = np.stack(
        [_log_actions(seen, model, s)[1] for s in range(len(model.damping))], axis=1
    )
    weight, counts = np.empty_like(emission), np.zeros_like(model.stay)
    nats = forward_backward(
        emission, model.stay, model.share.clip(TINY), seen.begins, weight, counts
    )
    return float(nats), weight, counts


def _fitted(seen: Steps, weight: Floats, counts: Floats, model: StateFit) -> StateFit:
    """The model that explains steps best, given the probabilities of states at each."""
    states, magnitudes = model.thrusts.shape
    damping, thrusts, noise = (a.copy() for a in (model.damping, model.thrusts, model.noise))
    pushes = np.full(len(model.pushes), 1e-6)
    unit = model.dt * locomotion.action_vectors((1.0,) * magnitudes)
    for s in range(states):
        log, whole = _log_actions(seen, model, s)
        each = np.exp(log - whole[:, None]) * weight[:, s, None]
        pushes += each.sum(axis=0)
        total = each.sum(axis=1)
        onto_before = ((each.T @ seen.before) * unit).sum(axis=1)
        onto_after = ((each.T @ seen.after) * unit).sum(axis=1)
        gram, right = np.zeros((1 + magnitudes,) * 2), np.zeros(1 + magnitudes)
        gram[0, 0] = (total * (seen.before**2).sum(axis=1)).sum()
        right[0] = (total * (seen.before * seen.after).sum(axis=1)).sum()
        for j in range(magnitudes):
            own = slice(locomotion.NUM_DIRECTIONS * j, locomotion.NUM_DIRECTIONS * (j + 1))
            gram[0, 1 + j] = gram[1 + j, 0] = onto_before[own].sum()
            gram[1 + j, 1 + j] = model.dt**2 * each[:, own].sum()
            right[1 + j] = onto_after[own].sum()
        ridge = 1e-9 * np.diag(gram).max() + TINY
        kept, *pushed = np.linalg.solve(gram + ridge * np.eye(len(gram)), right)
        damping[s] = 1.0 - min(max(kept, 0.0), 1.0)
        thrusts[s] = np.maximum(pushed, 1e-9)
        vectors = model.dt * locomotion.action_vectors(tuple(thrusts[s]))
        square = _misses(seen, float(damping[s]), vectors)
        variance = float((each * square).sum()) / (2 * max(float(total.sum()), 1e-12))
        noise[s] = max(math.sqrt(max(variance, 0.0)), LEAST_NOISE * model.broad / BROAD)
    stay = model.stay
    if counts.any():
        stay = counts + STICKY * np.eye(states) + 1e-6
        stay = stay / stay.sum(axis=1, keepdims=True)
    pushes /= pushes.sum()
    return replace(model, damping=damping, thrusts=thrusts, noise=noise, pushes=pushes, stay=stay)


# -- kernels ----------------------------------------------------------------------------------


@jit
def forward_backward(emission, stay, first, begins, weight, counts):  # type: ignore[no-untyped-def]
    """Log likelihood of all sequences, given log densities ``emission`` ``(steps, S)``.

    ``stay`` ``(S, S)`` and ``first`` ``(S,)`` are probabilities of the next and the first state.
    Writes ``weight`` ``(steps, S)``, probabilities of states given all steps of their sequence;
    adds to ``counts`` ``(S, S)`` how often one follows another.
    """
    steps, states = emission.shape
    ahead = np.empty((steps, states))
    both = np.empty((states, states))
    nats = 0.0
    for t in range(steps):
        most = emission[t].max()
        for s in range(states):
            ahead[t, s] = first[s] if begins[t] else (ahead[t - 1] * stay[:, s]).sum()
            ahead[t, s] *= np.exp(emission[t, s] - most)
        total = ahead[t].sum()
        nats += most + np.log(total)
        ahead[t] /= total
    back = np.ones(states)
    for t in range(steps - 1, -1, -1):
        if t == steps - 1 or begins[t + 1]:
            back[:] = 1.0
        weight[t] = ahead[t] * back
        weight[t] /= weight[t].sum()
        if begins[t]:
            continue
        back *= np.exp(emission[t] - emission[t].max())
        for r in range(states):
            both[r] = stay[r] * back
        for r in range(states):
            back[r] = both[r].sum()
            both[r] *= ahead[t - 1, r]
        counts += both / both.sum()
        back /= back.sum()
    return nats
