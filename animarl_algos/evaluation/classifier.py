"""Which of these two is recorded? A classifier's answer, after Lopez-Paz and Oquab (2017, ICLR).

How often boosted trees rank a simulated window (:mod:`animarl_algos.evaluation.windows`) above a
recorded one, the area under the ROC curve, is 0.5 if nothing distinguishes the two and 1 if
everything does. They are asked about demonstrations that they were not trained on: folds are dealt
by demonstration, and a rollout goes with the recording that it started from. Only windows of one
fold are compared: pooling scores of all folds would push the null below 0.5.

In a verdict two judges are asked: about two seconds of motion, and about order in time over up to
a quarter of an episode. What their areas are printed beside excuses no row.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from animarl_algos.evaluation.prepared import Prepared
from animarl_algos.evaluation.rollouts import Rollouts
from animarl_algos.evaluation.statistics import (
    UNDEFINED,
    Floats,
    Interval,
    Ints,
    percentile_interval,
)
from animarl_algos.evaluation.verdict_rows import BY_LITTLE, DIFFERS, UNKNOWN, Row
from animarl_algos.evaluation.windows import (
    WINDOW,
    Windows,
    sequence_windows,
    window_features,
    window_steps,
)
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.episode import rounded
from animarl_envs.errors import InputError, MissingExtraError

FOLDS = 5
DEALS = 2  # the folds are dealt anew so many times, at least, and the answers joined
DEALT = 100  # ... and as often as it takes until so many demonstrations were asked about
FEWEST_DEALT = 8  # demonstrations; fewer leave an interval that is wider than any deal moves it
NEAR_CHANCE = (1.0, 4.0)  # standard errors above 0.5: only there, more deals may change the answer
NULL_HALVES = 3
MOST_WINDOWS = 3000  # of one side; more make it slower, not sharper
BOOTSTRAP = 1000
LEVELS = 63  # of a feature, as many as the trees tell apart
TREES: dict[str, Any] = {
    "max_iter": 50, "learning_rate": 0.1, "max_leaf_nodes": 8, "min_samples_leaf": 10,
    "l2_regularization": 1.0, "max_bins": LEVELS + 1, "early_stopping": False, "random_state": 0,
}  # fmt: skip

LITTLE_AUC = 0.60  # up to here it differs by little: two normal curves 0.36 sd apart
MOST_ERRORS = 2.33  # above chance: a row that differs by chance alone does so in 1 % of cases
FEWEST_DEMOS = 5  # with fewer, parts of them are dealt to the classifier's folds
PART = 15  # windows of such a part
AUC, SEQUENCE = "auc", "auc_sequence"


@dataclass(frozen=True)
class Telling:
    """How well two sets of windows are told apart.

    ``auc`` has a 95 % interval over demonstrations and training sets; where it is undefined (NaN)
    its ``reason`` says why. ``importance`` is by how much the area falls when the features of one
    kind are shuffled.
    """

    auc: Interval
    importance: Mapping[str, float] = field(default_factory=dict)


def tell_apart(
    first: Windows,
    second: Windows,
    rng: np.random.Generator,
    *,
    deals: int | None = None,
    importance: bool = False,
    until_clear: bool = False,
) -> Telling:
    """Area under the ROC curve of a cross-fitted classifier, ``second`` against ``first``.

    Parameters
    ----------
    first, second
        Recorded and simulated. Windows of the same group (demonstration) are in one fold.
    rng
        Deals the folds, thins, shuffles and resamples.
    deals
        How often the folds are dealt; by default ``DEALS`` times and, of ``FEWEST_DEALT``
        demonstrations and more, until ``DEALT`` were asked about.
    importance
        Whether to shuffle features too, one kind after the other.
    until_clear
        No more deals than ``DEALS`` where the area is so far from chance, or so near, that more
        would not change what a row says: for a benchmark, which asks for that alone.
    """
    try:
        from sklearn.ensemble import HistGradientBoostingClassifier
        from threadpoolctl import threadpool_limits
    except ImportError as error:
        raise MissingExtraError("telling simulation from recording", "algos") from error
    first, second = _thinned(first, rng), _thinned(second, rng)
    values = _levels(np.concatenate([first.values, second.values]))
    simulated = np.repeat([False, True], [len(first), len(second)])
    names, group = np.unique(np.concatenate([first.group, second.group]), return_inverse=True)
    sides = [np.isin(names, side.group) for side in (first, second)]
    folds = min([FOLDS, *(int(side.sum()) for side in sides)])
    if folds < 2:
        return Telling(Interval(math.nan, reason="too few recordings to split"))
    most = deals or max(DEALS, 0 if len(names) < FEWEST_DEALT else math.ceil(DEALT / len(names)))
    kind = 2 * sides[0].astype(int) + sides[1]  # only simulated, only recorded, both
    wins, pairs = np.zeros((2, len(names), len(names)))
    resampler, shuffler = rng.spawn(2)
    drawn = _resampled(kind, resampler)
    fallen: dict[str, list[float]] = {}
    auc, splits = UNDEFINED, False
    with threadpool_limits(1):  # looking for the thread pools takes longer than to score windows
        for deal in range(most):
            fold = _deal(kind, folds, rng)[group]
            for number in range(folds):
                test = fold == number
                here, there, left = simulated[test], group[test], simulated[~test]
                if len(np.unique(here)) < 2:
                    continue
                weights = np.where(left, 0.5 / left.mean(), 0.5 / (1.0 - left.mean()))
                model = HistGradientBoostingClassifier(**TREES)
                score = model.fit(values[~test], left, sample_weight=weights).decision_function
                splits |= len(left) >= 2 * TREES["min_samples_leaf"]
                won, met = _compare(score(values[test]), here, there, len(names))
                wins += won
                pairs += met
                for what in dict.fromkeys(first.kinds.tolist()) if importance and not deal else ():
                    shuffled, columns = values[test], first.kinds == what
                    shuffled[:, columns] = shuffler.permutation(shuffled[:, columns])
                    without, _ = _compare(score(shuffled), here, there, len(names))
                    fallen.setdefault(what, []).append((won.sum() - without.sum()) / met.sum())
            if not splits:
                reason = "too few windows for a tree to split: all scores are tied"
                return Telling(Interval(math.nan, reason=reason))
            auc = _area(wins, pairs, drawn, folds)
            low, high = NEAR_CHANCE
            if until_clear and deal + 1 >= DEALS and not low <= _errors_above_chance(auc) <= high:
                break
    return Telling(auc, {what: float(np.mean(by)) for what, by in fallen.items()})


def _area(wins: Floats, pairs: Floats, drawn: Floats, folds: int) -> Interval:
    """Share of ``pairs`` won, its interval over the ``drawn`` groups."""
    with np.errstate(invalid="ignore", divide="ignore"):
        won, met = (np.einsum("rg,rg->r", drawn @ side, drawn) for side in (wins, pairs))
        return widen_for_folds(
            percentile_interval(float(wins.sum() / pairs.sum()), won / met), folds
        )


def _errors_above_chance(auc: Interval) -> float:
    """By how many standard errors an area is above 0.5."""
    above, error = auc.estimate - 0.5, (auc.estimate - auc.low) / 1.96
    if above == 0:
        return 0.0
    return above / error if error > 0 else math.copysign(math.inf, above)


def among_themselves(
    recorded: Windows, rng: np.random.Generator, halves: int = NULL_HALVES
) -> Interval:
    """The area for recordings against recordings: two halves of the demonstrations, repeatedly.

    Estimate and ends of the interval are means over the ``halves``.
    """
    groups = np.unique(recorded.group)
    found = []
    for _ in range(halves):
        dealt = rng.permutation(groups)
        one, other = dealt[: len(groups) // 2], dealt[len(groups) // 2 :]
        auc = tell_apart(recorded.of(one), recorded.of(other), rng, deals=1).auc
        found.append((auc.estimate, auc.low, auc.high))
    estimate, low, high = np.mean(found, axis=0).tolist()
    return Interval(estimate, low, high)


def widen_for_folds(interval: Interval, folds: int) -> Interval:
    """The interval with the variance between training sets, which a bootstrap of scores lacks.

    What one fold is tested on, the others were trained on, so folds err together. Nadeau and
    Bengio (2003, Machine Learning 52, 239) put the variance of a cross-validated mean at
    1 + folds * n_test / n_train times that of independent folds.
    """
    factor = math.sqrt(1.0 + folds / (folds - 1))
    middle = interval.estimate
    low, high = (middle + factor * (end - middle) for end in (interval.low, interval.high))
    return Interval(middle, max(low, 0.0), min(high, 1.0))


def _thinned(windows: Windows, rng: np.random.Generator) -> Windows:
    if len(windows) <= MOST_WINDOWS:
        return windows
    kept = np.sort(rng.choice(len(windows), MOST_WINDOWS, replace=False))
    return Windows(windows.values[kept], windows.group[kept], windows.kinds)


def _levels(values: Floats) -> Floats:
    """Every feature as its level among all windows, -1 where it is not defined.

    Trees ask for nothing but the order. The library would find the levels again in every fit, which
    takes it ten times as long as to grow the trees.
    """
    levels = np.full(values.shape, -1.0)
    for column in range(values.shape[1]):
        known = np.isfinite(values[:, column])
        if known.any():
            ordered = values[known, column]
            edges = np.unique(np.quantile(ordered, np.arange(1, LEVELS) / LEVELS))
            levels[known, column] = np.searchsorted(edges, ordered, side="right")
    return levels


def _deal(kind: Ints, folds: int, rng: np.random.Generator) -> Ints:
    """The fold of every group, ``(groups,)``; each kind of group is spread over all folds."""
    fold = np.empty(len(kind), dtype=np.int64)
    for one in np.unique(kind):
        members = rng.permutation(np.flatnonzero(kind == one))
        fold[members] = np.arange(len(members)) % folds
    return fold


def _resampled(kind: Ints, rng: np.random.Generator) -> Floats:
    """How often each group is drawn, ``(BOOTSTRAP, groups)``, within its kind."""
    drawn = np.zeros((BOOTSTRAP, len(kind)))
    for one in np.unique(kind):
        members = np.flatnonzero(kind == one)
        even = np.full(len(members), 1.0 / len(members))
        drawn[:, members] = rng.multinomial(len(members), even, size=BOOTSTRAP)
    return drawn


def _compare(
    scores: Floats, simulated: NDArray[np.bool_], group: Ints, groups: int
) -> tuple[Floats, Floats]:
    """Pairs won by simulated windows, ties by halves, and all pairs, ``(groups, groups)`` each.

    Rows are the groups of the recorded, columns those of the simulated windows.
    """
    below, above = scores[~simulated], scores[simulated]
    margin = np.sign(above[None, :] - below[:, None])
    won = (margin + 1.0) / 2.0
    rows, columns = np.eye(groups)[group[~simulated]], np.eye(groups)[group[simulated]]
    return rows.T @ won @ columns, np.outer(rows.sum(axis=0), columns.sum(axis=0))


# -- judges of a verdict --------------------------------------------------------------------------


class Tracked(Protocol):
    """Closed-loop tracking of the evaluated demonstrations, frame for frame."""

    @property
    def positions(self) -> Floats: ...


def followed(demos: Demonstrations, tracking: Tracked) -> Rollouts:
    """The demonstrations as tracking follows them, on the grid on which positions were stored."""
    if tracking.positions.shape != demos.positions.shape:
        raise InputError(
            f"the tracking has shape {tracking.positions.shape} and the demonstrations "
            f"{demos.positions.shape}: track the evaluated ones"
        )
    stored = rounded(tracking.positions, demos.resolution())
    return replace(Rollouts.from_demonstrations(demos), positions=stored)


@dataclass(frozen=True, eq=False)
class Judge:
    """What one judge makes of the rollouts, and of what they are read beside.

    ``areas`` are those under the curve, by name: of recordings ``among`` themselves, of closed-loop
    tracking (``floor``) and of random actions (``ceiling``).
    """

    key: str
    label: str
    simulated: Telling
    areas: Mapping[str, Interval] = field(default_factory=dict)

    def row(self) -> Row:
        """Return its row: what tracking comes to is printed beside it, not subtracted."""
        auc, among = self.simulated.auc, self.areas.get("among", UNDEFINED)
        row = Row(
            measure=self.key,
            label=self.label,
            recorded=among.estimate,
            simulated=auc.estimate,
            value=auc.estimate,
            low=auc.low,
            high=auc.high,
            null=among.high,
        )
        if not math.isfinite(auc.low):
            words = f"{UNKNOWN}: {auc.reason}" if auc.reason else UNKNOWN
            return replace(row, judgement=UNKNOWN, verdict=words, reason=auc.reason)
        if _errors_above_chance(auc) <= MOST_ERRORS:
            return row
        importance = self.simulated.importance
        by = max(importance, key=lambda what: importance[what], default="")
        if auc.estimate <= LITTLE_AUC:
            words = f"{BY_LITTLE}: AUC {auc.estimate:.2f}, most of all by {by}"
            return replace(row, judgement=BY_LITTLE, verdict=words)
        words = f"distinguished, most of all by {by}"
        return replace(row, judgement=DIFFERS, verdict=words)


def judges(
    prepared: Prepared,
    counted: Rollouts,
    sides: Mapping[str, Rollouts],
    references: Demonstrations | None,
    group: Ints,
    streams: Sequence[np.random.Generator],
    *,
    alone: bool = False,
) -> Iterator[Judge]:
    """Ask about two seconds of motion, then about order in time.

    ``sides`` is what the rollouts are read beside, smoothed as the recordings; ``references`` are
    other recordings to show two seconds of, by default halves of the evaluated ones are compared;
    ``group`` ``(starts,)`` is the recording of each start. With ``alone`` there is the area of the
    rollouts and nothing beside it.
    """
    demos, steps = prepared.demos, window_steps(prepared.recorded)
    block = PART if len(np.unique(counted.demo)) < FEWEST_DEMOS else None

    def short(rollouts: Rollouts, of: Demonstrations = demos) -> Windows:
        made = window_features(rollouts, demos.arena, block=block, still=prepared.rest)
        return made.by_recording(of) if block is None else made

    def long(rollouts: Rollouts) -> Windows:
        return sequence_windows(rollouts, demos.arena, prepared.rest, steps, group)

    def judge(
        key: str, of: str, windows: Callable[[Rollouts], Windows], rng: np.random.Generator,
        among: Callable[[Windows], Interval],
    ) -> Judge:  # fmt: skip
        own, label = windows(prepared.recorded), f"Distinguished by {of} (AUC)"
        found = tell_apart(own, windows(counted), rng, importance=not alone, until_clear=alone)
        if alone:
            return Judge(key, label, found)
        areas = {name: tell_apart(own, windows(s), rng, deals=1).auc for name, s in sides.items()}
        return Judge(key, label, found, {"among": among(own), **areas})

    def others(own: Windows) -> Interval:
        if references is None:
            return among_themselves(own, streams[1])
        apart = short(prepared.filtered(Rollouts.from_demonstrations(references)), references)
        apart = replace(apart, group=apart.group + own.group.max() + 1)
        return tell_apart(own, apart, streams[1], deals=1).auc

    yield judge(AUC, f"a classifier on {WINDOW:g} s", short, streams[0], others)
    seconds, halves = steps * prepared.recorded.dt, partial(among_themselves, rng=streams[2])
    of_order = f"order in time over {seconds:.3g} s"
    yield judge(SEQUENCE, of_order, long, streams[2], partial(halves, halves=1))


def read_beside(
    prepared: Prepared, floor: Tracked | None, baselines: Mapping[str, Rollouts]
) -> dict[str, Rollouts]:
    """Return what rollouts are read beside, smoothed as the recordings."""
    demos, sides = prepared.demos, {}
    if (random := baselines.get("random")) is not None:
        sides["ceiling"] = random.factual(demos)
    if floor is not None:
        sides["floor"] = followed(demos, floor)
    return {name: prepared.filtered(one) for name, one in sides.items()}
