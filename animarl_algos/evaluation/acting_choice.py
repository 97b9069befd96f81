"""How a trained policy should act: chosen by what its rollouts do, beside what was recorded.

Candidates are Boltzmann sampling at temperature 1, which a clone's logits mean, and at shares of
the temperatures that fit the demonstrated actions best, and the greedy rule; where none of them
comes near, also sampling at one share for how hard and another for which way. Each is rolled out
from the starts of training and validation episodes, never of a test episode, and compared by
outcome, duration, path length, speed, rest and the memory of turns; where nobody is pursued, also
by what the verdict judges of a group or of one animal alone. Not by the DTW distance, which
hardly tells good simulators from bad ones. Rollouts stop where their recording merely stops.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from animarl_algos.evaluation.collect import Cue, Policy, collect_rollouts
from animarl_algos.evaluation.metrics import judged_metrics, path_lengths
from animarl_algos.evaluation.order_in_time import lags_for, median_steps, order_measures
from animarl_algos.evaluation.prepared import censored
from animarl_algos.evaluation.rollouts import Rollouts
from animarl_algos.evaluation.windows import resting_step
from animarl_algos.networks.acting_rule import Acting
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.episode import TIME_OUT, UNFINISHED
from animarl_envs.errors import InputError
from animarl_envs.worlds.base import World

COOLER = (1.0, 0.85, 0.7, 0.5, 0.35)
"""Shares of the fitted temperatures that are tried: a clone that is unsure samples too widely."""
APART = tuple((thrust, way) for way in (0.7, 0.5, 0.35) for thrust in (0.7, 0.3))
"""Shares for how hard and for which way, of the fitted temperatures."""
NEAR = 0.3
"""Mismatch up to which nothing further is tried: rollouts take time."""
MARGIN = 0.1
"""Mismatch by which another must beat the first: rollouts anew move it by some hundredths."""
MOST_STARTS, ROLLOUTS = 200, 400
WEIGHT = 4.0  # of rest and order: .05 of either weighs as a fifth of the duration
SPEEDS = 400  # quantiles by which two distributions of speed are compared


@dataclass(frozen=True)
class Candidate:
    """An acting rule, and how far its rollouts are from the recordings.

    Of the ``distances``, ``outcome`` is the total variation distance of the shares of outcomes;
    the others are Wasserstein distances in units of the recorded mean, ``speed`` that of all steps,
    as the mean over individuals. ``rest`` is the difference of the shares of steps at rest and
    ``order`` that of the autocorrelation of turns (circles have one), each times ``WEIGHT``.
    ``together`` is, of a group or one animal alone, the mean difference of the metrics that are
    about it (:mod:`animarl_algos.evaluation.metrics`): relative, or times ``WEIGHT`` without unit.
    """

    acting: str
    distances: Mapping[str, float]

    @property
    def mismatch(self) -> float:
        """Their sum: the lower, the more alike."""
        return sum(self.distances.values())


@dataclass(frozen=True)
class ActingChoice:
    """The rule that was chosen, and the candidates it was chosen from."""

    acting: Acting
    candidates: tuple[Candidate, ...]

    def to_json(self) -> dict[str, Any]:
        """As plain data."""
        rows = [
            {"acting": each.acting, **each.distances, "mismatch": each.mismatch}
            for each in self.candidates
        ]
        return {"acting": self.acting.to_json(), "candidates": rows}


def candidate_rules(temperatures: ArrayLike) -> list[Acting]:
    """Sampling at 1, at shares of the fitted ``temperatures`` ``(K,)``, and greedy."""
    fitted = np.atleast_1d(np.asarray(temperatures, dtype=np.float64))
    tried = [np.ones_like(fitted), *(fitted * share for share in COOLER)]
    return [*(Acting.boltzmann(temperature) for temperature in tried), Acting()]


def further_rules(temperatures: ArrayLike) -> list[Acting]:
    """Sampling at one share of the ``temperatures`` for how hard, at another for which way."""
    fitted = np.atleast_1d(np.asarray(temperatures, dtype=np.float64))
    return [Acting.boltzmann(fitted, thrust=hard, direction=way) for hard, way in APART]


def choice_episodes(demos: Demonstrations, seed: int) -> Demonstrations:
    """The episodes to choose by: those of validation, and of training up to ``MOST_STARTS``.

    Raises
    ------
    InputError
        If there are none.
    """
    validation, training = (np.flatnonzero(demos.split == name) for name in ("val", "train"))
    rng = np.random.default_rng([seed, len(training)])
    spare = max(0, MOST_STARTS - len(validation))
    chosen = np.sort(np.concatenate([validation[:MOST_STARTS], rng.permutation(training)[:spare]]))
    if not len(chosen):
        raise InputError(
            f"{demos.name}: it holds no training or validation episode to choose an acting rule "
            "by: split it again"
        )
    return demos.select(episodes=chosen)


def choose_acting(
    policy_for: Callable[[Acting], Policy],
    make_world: Callable[[int], World],
    demos: Demonstrations,
    rules: Sequence[Acting],
    further: Sequence[Acting] = (),
    *,
    seed: int,
    cue: Cue | None = None,
) -> ActingChoice:
    """The rule whose rollouts are most like the recordings.

    Parameters
    ----------
    policy_for
        The policy, acting by a rule, its draws seeded.
    make_world
        Of the episodes ``demos``; see :func:`animarl_algos.evaluation.collect.collect_rollouts`.
    demos
        Training and validation episodes, see :func:`choice_episodes`.
    rules
        To choose among: the first of them, unless its mismatch is more than ``MARGIN`` above the
        least; then the rule with the least. The others were fitted to few validation animals, and
        the best of a dozen is lucky.
    further
        To try as well where the mismatch of all ``rules`` is above ``NEAR``.
    seed, cue
        Of the worlds, and what policies are told of the condition.
    """
    recorded = Rollouts.from_demonstrations(demos)
    repetitions = max(1, round(ROLLOUTS / demos.num_episodes))
    candidates: list[Candidate] = []
    for number, rule in enumerate((*rules, *further)):
        if number == len(rules) and min(each.mismatch for each in candidates) <= NEAR:
            break
        simulated = collect_rollouts(
            make_world, policy_for(rule), method="candidate", seed=seed, repetitions=repetitions,
            cue=cue,
        )  # fmt: skip
        candidates.append(compared(str(rule), simulated, recorded))
    mismatches = [each.mismatch for each in candidates]
    stays = mismatches[0] <= min(mismatches) + MARGIN
    chosen = 0 if stays else int(np.argmin(mismatches))
    return ActingChoice((*rules, *further)[chosen], tuple(candidates))


def compared(name: str, simulated: Rollouts, recorded: Rollouts) -> Candidate:
    """How far rollouts are from recordings, by what an acting rule is chosen for."""
    simulated = censored(simulated, recorded)
    # A recording that was cut went on, as a rollout does that time ends.
    ends = [np.where(r.outcome == UNFINISHED, TIME_OUT, r.outcome) for r in (simulated, recorded)]
    known = np.union1d(*ends)
    shares = [np.array([(each == outcome).mean() for outcome in known]) for each in ends]
    duration = [(r.lengths - 1) * r.dt for r in (simulated, recorded)]
    path = [path_lengths(r)[:, r.movers].mean(axis=1) for r in (simulated, recorded)]
    levels = (np.arange(SPEEDS) + 0.5) / SPEEDS
    speeds = [np.quantile(r.speeds(), levels, axis=0) for r in (simulated, recorded)]
    still = resting_step(recorded)
    lags = lags_for(median_steps(recorded), recorded.dt)
    order_of = [order_measures(r, lags, still) for r in (simulated, recorded)]
    rest, turns = (
        np.subtract(*(one.mean(name) for one in order_of))
        for name in ("share at rest", "turn autocorrelation")
    )
    rest, order = (WEIGHT * np.nan_to_num(np.abs(each)).mean() for each in (rest, turns))
    distances = {
        "outcome": 0.5 * np.abs(shares[0] - shares[1]).sum(),
        "duration": relative_distance(*duration),
        "path_length": relative_distance(*path),
        "speed": np.mean([relative_distance(a, b) for a, b in zip(speeds[0].T, speeds[1].T)]),
        "rest": rest,
        "order": order,
    }
    if alike := [metric for metric in judged_metrics(recorded) if metric.of_order]:
        gaps = []
        for metric in alike:
            drawn, true = (float(one.mean(metric.of_order).mean()) for one in order_of)
            scale = abs(true) if metric.unit else 1 / WEIGHT
            gaps.append(abs(drawn - true) / scale if scale > 0 else 0.0)
        distances["together"] = np.nan_to_num(gaps).mean()
    return Candidate(name, {key: float(value) for key, value in distances.items()})


def relative_distance(simulated: ArrayLike, recorded: ArrayLike) -> float:
    """Wasserstein distance over the recorded mean."""
    from scipy.stats import wasserstein_distance

    scale = float(np.abs(np.asarray(recorded)).mean())
    return float(wasserstein_distance(simulated, recorded)) / scale if scale > 0 else 0.0
