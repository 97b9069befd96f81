"""Realism score: how likely the recording is under rollouts from its own start.

The form is that of the Waymo Open Sim Agents Challenge (Montali et al. 2023, arXiv 2305.12032): for
every start, individual and component the values of all rollouts and steps make a histogram; the
score is exp(mean log probability) of the recorded values, between 0 and 1. Components and weights
are ours: animals have no lanes, but they have bouts, turns that follow each other, and neighbours.
Beside it stand the score of the recording itself (ceiling), of others, and of random actions.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from animarl_algos.evaluation import order_in_time, statistics
from animarl_algos.evaluation.metrics import (
    INTERACTIVE,
    KINEMATIC,
    ORDER,
    ORDER_METRICS,
    PLACE,
    Metric,
)
from animarl_algos.evaluation.order_in_time import Series, plain_name
from animarl_algos.evaluation.prepared import Prepared
from animarl_algos.evaluation.rollouts import Rollouts
from animarl_algos.evaluation.statistics import Draws, Interval
from animarl_envs.array_types import Floats, Ints
from animarl_envs.demos.episode import UNFINISHED

ENDING, OWN = "ending", "measures of your own"
WEIGHTS: Mapping[str, float] = {
    KINEMATIC: 0.2,  # what a two-second window shows, and the easiest to meet
    ORDER: 0.25,  # what two-second windows are blind to
    INTERACTIVE: 0.25,  # what a simulator of several animals is for
    PLACE: 0.15,
    ENDING: 0.15,
    OWN: 0.25,  # in the choice of acting alone, where asked for
}
"""Shares of the kinds in the total. A kind that a recording does not have is left out, and the
others keep their proportions; components of a kind weigh alike."""

BINS = 10
PSEUDO_COUNT = 0.1  # added to every bin, as the challenge does
LIMITS = (0.005, 0.995)  # quantiles of the recordings between which bins lie
CEILING, OTHERS, RANDOM = REFERENCES = "ceiling", "other recordings", "random actions"


@dataclass(frozen=True)
class Component:
    """Values ``(n,)`` of one component, of all episodes of one side, and of whom each is."""

    name: str
    kind: str
    values: Floats
    episode: Ints
    individual: Ints


@dataclass(frozen=True, eq=False)
class Likelihood:
    """How likely recordings are under rollouts, component by component.

    ``truth`` are the components of the recordings, ``limits`` between which bins of each lie.
    Measures of the user's ``own`` are components, too.
    """

    prepared: Prepared
    truth: tuple[Component, ...]
    limits: tuple[tuple[float, float], ...]
    own: Sequence[Metric] = ()

    @classmethod
    def of(
        cls, prepared: Prepared, pool: Rollouts | None = None, own: Sequence[Metric] = ()
    ) -> Likelihood:
        """Return that of the prepared recordings; limits are those of ``pool``, or of them."""
        truth = tuple(_components(prepared, prepared.recorded, own))
        of_pool = truth if pool is None else _components(prepared, pool, own)
        return cls(prepared, truth, tuple(_limits(one.values) for one in of_pool), own)

    @property
    def names(self) -> list[str]:
        """Names of the components."""
        return [*(one.name for one in self.truth), "outcome", "duration"]

    @property
    def kinds(self) -> NDArray[np.str_]:
        """Kinds of the components."""
        return np.array([*(one.kind for one in self.truth), ENDING, ENDING])

    def matrix(self, side: Rollouts, start: Ints) -> Floats:
        """Log likelihoods ``(components, recordings)`` under rollouts from ``start``."""
        recorded = self.prepared.recorded
        others = _components(self.prepared, side, self.own)
        rows = [
            _likelihood(true, other, limit, start, len(recorded))
            for true, other, limit in zip(self.truth, others, self.limits)
        ]
        return np.log(np.stack([*rows, *_endings(recorded, side, start)]))

    def components(self, rollouts: Rollouts) -> Floats:
        """Log likelihoods under rollouts, which stop where their recording merely stops."""
        counted = self.prepared.counted(rollouts)
        return self.matrix(counted, counted.demo)

    def of_others(self, repetitions: int, rng: np.random.Generator) -> Floats:
        """Log likelihoods under so many other recordings in place of rollouts; of one: its own."""
        recorded = self.prepared.recorded
        start = np.repeat(np.arange(len(recorded)), repetitions)
        drawn = _others(len(recorded), start, True, rng)
        return self.matrix(recorded.select(drawn if len(drawn) else start), start)

    def total(self, matrix: Floats) -> Floats:
        """Weighted mean over components, ``(recordings,)``."""
        return _weighted(matrix, _weights(self.kinds, matrix))

    def by_kind(self, matrix: Floats) -> dict[str, float]:
        """Mean of each kind that is defined."""
        means = {kind: matrix[self.kinds == kind] for kind in WEIGHTS if kind in self.kinds}
        return {
            kind: float(np.nanmean(each)) for kind, each in means.items() if np.isfinite(each).any()
        }


def realism(
    prepared: Prepared,
    rollouts: Rollouts,
    rng: np.random.Generator,
    *,
    references: Rollouts | None = None,
    random: Rollouts | None = None,
) -> pd.DataFrame:
    """Score rollouts by the likelihood of the recordings that they started from.

    One row per component, per kind and, last, the total: ``component, kind, weight``, the ``value``
    with its 95 % interval over recordings and, where they were asked for, the scores of
    ``ceiling``, ``other recordings`` and ``random actions``. Rows of kinds and the total have an
    empty ``component``. Scores rise with the number of rollouts a start.

    Parameters
    ----------
    prepared
        The evaluated recordings; those of one animal or recording are resampled together.
    rollouts
        From their starts, in their condition, told no other one, smoothed as the recordings.
    references
        Recordings that are not evaluated, for the row of other recordings and for the limits of the
        bins; by default the evaluated ones, each start beside all others.
    random
        Rollouts of random actions from the same starts.
    """
    recorded, recording = prepared.recorded, prepared.demos.recording
    pool = recorded if references is None else references
    likelihood = Likelihood.of(prepared, references)
    starts = np.unique(rollouts.demo)
    repeated = np.repeat(starts, max(1, round(len(rollouts) / len(starts))))

    def score(side: Rollouts, start: Ints) -> Floats:
        return np.exp(likelihood.matrix(side, start)[:, starts])

    columns = {"score": score(rollouts, rollouts.demo)}
    columns[CEILING] = score(recorded.select(repeated), repeated)
    drawn = _others(len(pool), repeated, references is None, rng)
    if len(drawn):
        columns[OTHERS] = score(pool.select(drawn), repeated)
    if random is not None:
        columns[RANDOM] = score(random, random.demo)
    names, kinds = likelihood.names, likelihood.kinds
    weights = _weights(kinds, columns["score"])
    group = np.unique(recording[starts], return_inverse=True)[1]
    draws = Draws.by(rng)
    levels = [(name, kinds[i], np.arange(len(kinds)) == i) for i, name in enumerate(names)]
    levels += [("", kind, kinds == kind) for kind in WEIGHTS if (kinds == kind).any()]
    levels.append(("", "total", np.ones(len(kinds), dtype=bool)))
    rows = []
    for name, kind, members in levels:
        if not weights[members].sum() > 0:
            continue
        means = {key: _weighted(each[members], weights[members]) for key, each in columns.items()}
        row = statistics.row_of(
            over_groups(means.pop("score"), group, draws),
            component=name,
            kind=kind,
            weight=float(weights[members].sum()),
        )
        rows.append(row | {key: float(np.nanmean(each)) for key, each in means.items()})
    return pd.DataFrame(rows)


def leave_one_out(prepared: Prepared, rollouts: Rollouts) -> tuple[Floats, Floats]:
    """Return how likely each episode is under all others of its start, recorded or simulated.

    Mean log likelihoods ``(starts,)`` of recordings and ``(rollouts,)``. If a simulator is perfect
    they can be exchanged. How episodes end does not count.
    """
    recorded = prepared.recorded
    count, rows, kinds = len(recorded), [], []
    start = np.concatenate([np.arange(count), rollouts.demo])
    for one, two in zip(_components(prepared, recorded), _components(prepared, rollouts)):
        values = np.concatenate([one.values, two.values])
        episode = np.concatenate([one.episode, two.episode + count])
        individual = np.concatenate([one.individual, two.individual])
        shape = (len(start), 1 + int(individual.max(initial=0)), BINS)
        place = np.ravel_multi_index((episode, individual, _bin(values, _limits(values))), shape)
        own = np.bincount(place, minlength=math.prod(shape)).reshape(shape)
        total = np.zeros((count, *shape[1:]))
        np.add.at(total, start, own)
        rest = total[start] - own + PSEUDO_COUNT
        log_p = np.log(rest / rest.sum(axis=-1, keepdims=True))
        number = own.sum(axis=(1, 2))
        rows.append((own * log_p).sum(axis=(1, 2)) / np.where(number > 0, number, np.nan))
        kinds.append(one.kind)
    scores = np.stack(rows)
    typical = _weighted(scores, _weights(np.array(kinds), scores))
    return typical[:count], typical[count:]


def _weights(kinds: NDArray[np.str_], scores: Floats) -> Floats:
    """Weights ``(components,)``; they sum to one over those that are defined."""
    defined = np.isfinite(scores).any(axis=1)
    weights = np.zeros(len(kinds))
    for kind, share in WEIGHTS.items():
        members = (kinds == kind) & defined
        weights[members] = share / max(1, members.sum())
    return np.asarray(weights / weights.sum())


def _components(
    prepared: Prepared, rollouts: Rollouts, own: Sequence[Metric] = ()
) -> Iterator[Component]:
    """Components of all episodes: of single steps, and of whole episodes what is order in time."""
    gathered: dict[tuple[str, str], list[tuple[Floats, Ints, Ints]]] = {}
    with np.errstate(invalid="ignore", divide="ignore"):
        for series in Series.of(rollouts, prepared.rest):
            for name, kind, values in _step_series(series, prepared):
                episode, _, individual = np.nonzero(np.isfinite(values))
                part = (values[np.isfinite(values)], series.chosen[episode], individual)
                gathered.setdefault((name, kind), []).append(part)
    for (name, kind), parts in gathered.items():
        yield Component(name, kind, *(np.concatenate(side) for side in zip(*parts)))
    measured = prepared.order(rollouts)
    for name, values in zip(measured.names, measured.values.T):
        metric = ORDER_METRICS[plain_name(name)]
        if metric.kind == ORDER or metric.whole:
            yield _of_episodes(name, metric.kind, values)
    for metric in own:
        yield _of_episodes(metric.key, OWN, metric.measure(prepared.episodes(rollouts)))


def _of_episodes(name: str, kind: str, values: Floats) -> Component:
    """Return the component of values of whole episodes, ``(episodes,)``, NaN where undefined."""
    known = np.flatnonzero(np.isfinite(values))
    return Component(name, kind, values[known], known, np.zeros(len(known), dtype=np.int64))


def _step_series(series: Series, prepared: Prepared) -> Iterator[tuple[str, str, Floats]]:
    """Name, kind and values ``(episodes, times, individuals)`` of components of single steps."""
    arena, dt, position = prepared.demos.arena, prepared.demos.dt, series.position
    speed, turn = series.speed, series.turn / dt
    yield "speed", KINEMATIC, speed
    yield "acceleration", KINEMATIC, np.diff(speed, axis=1) / dt
    yield "turning", KINEMATIC, turn
    yield "angular acceleration", KINEMATIC, np.diff(turn, axis=1) / dt
    if position.shape[2] > 1 or prepared.demos.has_goal:
        bearing = order_in_time.angle(series.focus[:, :-1], series.step)
        yield "course beside the focus", INTERACTIVE, np.where(series.moving, bearing, np.nan)
    if position.shape[2] > 1:
        yield "nearest neighbour", INTERACTIVE, series.nearest
        closing = -np.diff(series.nearest, axis=1) / dt
        soon = closing > 0
        contact = np.where(soon, series.nearest[:, 1:] / np.where(soon, closing, 1.0), np.nan)
        yield "log of the time to contact", INTERACTIVE, np.log(contact + dt)
    yield "place, x", PLACE, position[..., 0]
    yield "place, y", PLACE, position[..., 1]
    if arena.shape == "square":
        yield "distance from the wall", PLACE, arena.size - np.abs(position).max(axis=-1)
    else:
        yield "distance from the centre", PLACE, np.linalg.norm(position, axis=-1)


def _limits(values: Floats) -> tuple[float, float]:
    if len(values) == 0:
        return 0.0, 1.0
    low, high = np.quantile(values, LIMITS).tolist()
    return (low, high) if high > low else (low - 0.5, low + 0.5)


def _bin(values: Floats, limits: tuple[float, float]) -> Ints:
    low, high = limits
    place = np.floor((values - low) / (high - low) * BINS)
    return np.clip(place, 0, BINS - 1).astype(np.int64)


def _likelihood(
    true: Component, other: Component, limits: tuple[float, float], start: Ints, count: int
) -> Floats:
    """exp(mean log probability) of the recorded values, ``(recordings,)``; NaN without any.

    Where rollouts have no value at all (who stands still has no turns), they count as if as many
    values as recorded were all in other bins.
    """
    num = 1 + max(int(side.individual.max(initial=0)) for side in (true, other))
    place = (start[other.episode] * num + other.individual) * BINS + _bin(other.values, limits)
    counts = np.bincount(place, minlength=count * num * BINS).reshape(-1, BINS) + PSEUDO_COUNT
    cell = true.episode * num + true.individual
    number = np.bincount(cell, minlength=count * num)
    none = np.bincount(place // BINS, minlength=count * num) == 0
    sizes = counts.sum(axis=1) + np.where(none, number, 0)
    log_p = np.log(counts / sizes[:, None])
    value = log_p[cell, _bin(true.values, limits)]
    total = np.bincount(cell, value, minlength=count * num)
    with np.errstate(invalid="ignore"):
        score = np.exp(total / np.where(number, number, np.nan)).reshape(count, num)
        known = np.isfinite(score).sum(axis=1)
        return np.asarray(np.nansum(score, axis=1) / np.where(known, known, np.nan))


def _endings(recorded: Rollouts, rollouts: Rollouts, start: Ints) -> tuple[Floats, Floats]:
    """Likelihoods of how and of when each recording ended, ``(recordings,)`` each.

    Where a recording merely ends, nothing is known of how the episode would have: there the outcome
    is NaN, and the duration's likelihood is the share of rollouts that lasted at least as long.
    """
    longest = int(max(recorded.lengths.max(), rollouts.lengths.max()))
    limits = (np.log(2.0), np.log(longest + 1.0))
    outcome, duration = np.full((2, len(recorded)), np.nan)
    kinds = len(np.unique(recorded.outcome))
    for one in np.unique(start):
        here = start == one
        lengths, number = rollouts.lengths[here], int(here.sum())
        if recorded.outcome[one] == UNFINISHED:
            lasted = np.count_nonzero(lengths >= recorded.lengths[one])
            duration[one] = (lasted + PSEUDO_COUNT) / (number + 2 * PSEUDO_COUNT)
            continue
        same = np.count_nonzero(rollouts.outcome[here] == recorded.outcome[one])
        outcome[one] = (same + PSEUDO_COUNT) / (number + PSEUDO_COUNT * kinds)
        counts = np.bincount(_bin(np.log(lengths), limits), minlength=BINS) + PSEUDO_COUNT
        place = _bin(np.log(recorded.lengths[one : one + 1]), limits)[0]
        duration[one] = counts[place] / counts.sum()
    return outcome, duration


def _others(count: int, start: Ints, same: bool, rng: np.random.Generator) -> Ints:
    """Which recordings stand in for rollouts from each ``start``; never a start's own."""
    if same and count < 2:
        return np.zeros(0, dtype=np.int64)
    drawn = rng.integers(count - same, size=len(start))
    return drawn + (drawn >= start) if same else drawn


def _weighted(scores: Floats, weights: Floats) -> Floats:
    """Weighted mean over components ``(starts,)``; undefined components do not count."""
    known = np.isfinite(scores)
    total = (weights[:, None] * known).sum(axis=0)
    filled = np.where(known, scores, 0.0)
    return np.asarray((weights[:, None] * filled).sum(axis=0) / np.where(total, total, np.nan))


def over_groups(scores: Floats, group: Ints, draws: Draws) -> Interval:
    """Mean over starts, its interval over recordings, between 0 and 1."""
    data = statistics.cells(scores, np.zeros(len(scores)), group, int(group.max()) + 1)
    mean = statistics.bootstrap_mean(data, draws)
    return replace(mean, low=max(mean.low, 0.0), high=min(mean.high, 1.0))
