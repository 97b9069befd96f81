"""How well a classifier tells simulated from recorded motion (Lopez-Paz and Oquab 2017, ICLR).

How often boosted trees rank a simulated window of motion above a recorded one, the area under the
ROC curve, is 0.5 if nothing distinguishes the two and 1 if everything does. They are asked about
demonstrations that they were not trained on: folds are dealt by demonstration, and a rollout goes
with the recording that it started from. Only windows of one fold are compared: pooling scores of
all folds would push the null below 0.5.

Short windows are described by the same few series (speeds, acceleration, turning, distances,
bearings, place in the arena) of all individuals, each summed up by its mean, spread, extremes and
median. These are unsigned, so a path cannot be told from the same path reversed, or circles from a
search. Long windows, up to a quarter of an episode, are therefore described by the measures of
:mod:`animarl_algos.evaluation.order_in_time`. A row is not judged where closed-loop tracking is
recognised as well, by the same kind of feature: then it is the file or the locomotion, not the
policy.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from animarl_algos.evaluation import order_in_time, statistics
from animarl_algos.evaluation.boosting import LEVELS, MIN_LEAF_SAMPLES, BoostedTrees, Levels
from animarl_algos.evaluation.metrics import ORDER_METRICS
from animarl_algos.evaluation.prepared import WINDOW, Prepared
from animarl_algos.evaluation.rollouts import Rollouts
from animarl_algos.evaluation.statistics import UNDEFINED, Interval
from animarl_envs.arena import Arena
from animarl_envs.array_types import Bools, Floats, Ints
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.episode import Resolution, rounded
from animarl_envs.errors import require
from animarl_envs.fitting.tracking import Tracking
from animarl_envs.focus import nearest_other

FEWEST_STEPS = 4  # of a window, where decisions are slow
QUARTER = 0.25  # of the median episode: a long window ...
SHORTEST, LONGEST = 2.0, 20.0  # ... which lasts so long [s]
MOST_PARTS = 10_000  # of one demonstration
FEWEST_GROUPS = 5  # recordings, for their demonstrations to be kept together
COMPARED = Resolution((2.0**-17, 2.0**-17), (0.0, 0.0))
"""Grid of compared positions [arena unit]: nobody is known by rounding errors, such as turns of
1e-8 rad where a simulated animal goes exactly straight."""
SPEED, ACCELERATION, TURNING = "speed", "acceleration", "turning"
DISTANCE, BEARING, PLACE = "distances", "bearings", "place in the arena"

FOLDS = 5
DEALS = 2  # the folds are dealt anew so many times, at least, and the answers joined
DEALT = 100  # ... and as often as it takes until so many demonstrations were asked about
FEWEST_DEALT = 8  # demonstrations; fewer leave an interval that is wider than any deal moves it
NEAR_CHANCE = (1.0, 4.0)  # standard errors above 0.5: only there, more deals may change the answer
NULL_HALVES = 3
MOST_WINDOWS = 3000  # of one side; more make it slower, not sharper
BOOTSTRAP = 1000
LEVEL = 0.01  # of each classifier, at either end of its interval
MIN_RECORDINGS = 3  # for an interval
PART = 15  # windows of a part, where whole demonstrations are too few for a fit
AUC, SEQUENCE = "auc", "auc_sequence"
LITTLE_AUC = 0.60
"""Alike up to this area: two normal curves 0.36 standard deviations apart."""
NEAR_TRACKING = 0.02
"""Tracking is recognised as well as a simulation if its area is smaller by no more."""


# -- windows --------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Windows:
    """Windows of one side of a comparison.

    Parameters
    ----------
    values
        ``(windows, features)``, NaN where a feature is not defined.
    group
        ``(windows,)``, the demonstration that each is of, or started from; or the part of it.
    kinds
        ``(features,)``, what each feature is about: one of the names above.
    """

    values: Floats
    group: Ints
    kinds: NDArray[np.str_]

    def __len__(self) -> int:
        return len(self.values)

    def of(self, groups: NDArray[np.integer]) -> Windows:
        """Those of some demonstrations."""
        chosen = np.isin(self.group, groups)
        return replace(self, values=self.values[chosen], group=self.group[chosen])

    def by_recording(self, demos: Demonstrations) -> Windows:
        """All of one recording in one group, if there are ``FEWEST_GROUPS``; else unchanged.

        Episodes cut from one recording are of the same animals: who knows some of them knows the
        others. The present groups are ``demos``.
        """
        names, recording = np.unique(demos.recording, return_inverse=True)
        if len(names) < FEWEST_GROUPS:
            return self
        return replace(self, group=recording[self.group].astype(np.int64))


def window_features(
    rollouts: Rollouts, arena: Arena, *, block: int | None = None, still: Floats | None = None
) -> Windows:
    """Describe all windows of ``WINDOW`` seconds of all episodes.

    Of a group every animal has its own, which holds its neighbours and the group as it sees them.
    Windows lie end to end from the first frame of an episode. What is left over at its end is a
    window too if it is at least half as long; an episode shorter than a window is one short window.

    Parameters
    ----------
    rollouts, arena
        Of one method, or the recordings; for the distance to the arena's edge, in an open field
        that to the origin, the source.
    block
        Where demonstrations are too few: so many successive windows of one make a group of their
        own, the same stretch of time in the recording and in its rollouts.
    still
        ``(individuals,)`` distance [arena unit], see :func:`resting_step`; who moves less is at
        rest: no speed, no direction. By default zero.
    """
    steps = max(FEWEST_STEPS, round(WINDOW / rollouts.dt))
    first, count, episode = _cut(rollouts, steps)
    group = rollouts.demo[episode]
    if block is not None:
        place = (first - rollouts.offsets[episode]) // steps
        group = group * MOST_PARTS + np.minimum(place // block, MOST_PARTS - 1)
    offsets = np.arange(steps + 1)
    paths = rounded(rollouts.positions, COMPARED)[
        first[:, None] + np.minimum(offsets, count[:, None])
    ]
    paths[offsets > count[:, None]] = np.nan
    num = paths.shape[2]
    rest = np.zeros(num) if still is None else still
    series = list(_series(paths, rollouts, arena, rest))
    if rollouts.is_group:
        group = np.repeat(group, num)
    described = [(kind, _summary(one)) for kind, one in series]
    kinds = [kind for kind, columns in described for _ in range(columns.shape[1])]
    values = np.concatenate([columns for _, columns in described], axis=1)
    return Windows(values, group, np.array(kinds))


def window_steps(recorded: Rollouts) -> int:
    """Return the steps of a long window: a quarter of an episode, 2 to 20 s."""
    steps = QUARTER * order_in_time.median_steps(recorded)
    low, high = (round(limit / recorded.dt) for limit in (SHORTEST, LONGEST))
    return int(np.clip(round(steps), max(4, low), max(4, high)))


def sequence_windows(
    rollouts: Rollouts, arena: Arena, rest: Floats, steps: int, group: Ints
) -> Windows:
    """Describe the order in time in all windows of ``steps`` steps, cut as short ones are.

    ``group`` ``(recordings,)`` names the unit of resampling of each start.
    """
    first, count, episode = _cut(rollouts, steps)
    frames = [np.arange(a, a + n + 1) for a, n in zip(first.tolist(), count.tolist())]
    parts = {name: getattr(rollouts, name)[episode] for name in rollouts.EACH if name != "lengths"}
    positions = rounded(rollouts.positions, COMPARED)[np.concatenate(frames)]
    pieces = replace(rollouts, positions=positions, lengths=count + 1, **parts)
    measured = order_in_time.order_measures(
        pieces, order_in_time.lags_for(steps, rollouts.dt), rest, arena
    )
    kinds = [ORDER_METRICS[order_in_time.plain_name(name)].kind for name in measured.names]
    return Windows(measured.values, group[pieces.demo], np.array(kinds))


def _cut(rollouts: Rollouts, steps: int) -> tuple[Ints, Ints, Ints]:
    """First frame, steps and episode of every window."""
    pieces = []
    for index, (start, length) in enumerate(zip(rollouts.offsets.tolist(), rollouts.lengths)):
        left = int(length) - 1
        for begin in range(0, max(left, 1), steps):
            here = min(steps, left - begin)
            if begin == 0 or here >= steps / 2:
                pieces.append((start + begin, here, index))
    first, count, episode = np.array(pieces).T
    return first, count, episode


def _series(
    paths: Floats, rollouts: Rollouts, arena: Arena, still: Floats
) -> list[tuple[str, Floats]]:
    """Return the series of windows ``(windows, frames, K, 2)``, each ``(windows, times)``.

    Of a group, ``(windows * K, times)``.
    """
    steps, num, dt = paths.shape[1] - 1, paths.shape[2], rollouts.dt
    series: list[tuple[str, Floats]] = []
    if rollouts.is_group:
        nearest, centre = nearest_other(paths), paths.mean(axis=2, keepdims=True)
        each, near, arm = (
            one.swapaxes(1, 2).reshape(-1, steps + 1, 1, 2)
            for one in (paths, nearest, centre - paths)
        )
        moved = _moved(each[:, :, 0], 1, float(still.max()))
        for vectors in (near[:, :, 0], arm[:, :, 0]):
            series.append((DISTANCE, np.linalg.norm(vectors, axis=-1)))
            series.append((BEARING, _unsigned(moved, vectors[:, :-1])))
        mean = np.diff(paths, axis=1).mean(axis=2)
        series.append((BEARING, _unsigned(moved, np.repeat(mean, num, axis=0))))
        paths, num = each, 1
    quarter = max(1, steps // 4)
    for k in range(num):
        own = paths[:, :, k]
        for stride in sorted({1, quarter, steps}):
            moved = _moved(own, stride, still[k])
            series.append((SPEED, np.linalg.norm(moved, axis=-1) / (stride * dt)))
        moved = _moved(own, 1, still[k])
        bend = np.linalg.norm(np.diff(moved, axis=1), axis=-1)
        series.append((ACCELERATION, bend / dt**2))
        for stride in sorted({1, quarter}):
            turned = _moved(own, stride, still[k])
            series.append((TURNING, _unsigned(turned[:, :-stride], turned[:, stride:])))
        series.append((PLACE, order_in_time.distance_to_edge(own, arena)))
        if num == 1 and rollouts.has_goal:
            series.append((BEARING, _unsigned(moved, -own[:, :-1])))
        for other in range(num):
            between = paths[:, :, other] - own
            if other != k:
                series.append((BEARING, _unsigned(moved, between[:, :-1])))
            if other > k:
                series.append((DISTANCE, np.linalg.norm(between, axis=-1)))
    return series


def _moved(points: Floats, stride: int, still: float) -> Floats:
    """How far each point lies from the one ``stride`` frames before; zero up to ``still``."""
    moved = points[:, stride:] - points[:, :-stride]
    distance = np.linalg.norm(moved, axis=-1, keepdims=True)
    return np.where(distance <= still, 0.0 * moved, moved)  # where there is no point, NaN stays


def _unsigned(first: Floats, second: Floats) -> Floats:
    """Unsigned angle between vectors [rad]; NaN where one is zero."""
    shorter = np.minimum(np.linalg.norm(first, axis=-1), np.linalg.norm(second, axis=-1))
    return np.where(shorter <= 0, np.nan, np.abs(order_in_time.angle(first, second)))


def _summary(series: Floats) -> Floats:
    """Mean, standard deviation, least, median and greatest of each row, ``(windows, 5)``.

    A series of a single value gives that alone. NaN is left out.
    """
    ordered = np.sort(series, axis=1)  # NaN comes last
    if ordered.shape[1] == 1:
        return np.asarray(ordered)
    number = np.isfinite(ordered).sum(axis=1)
    last = np.maximum(number - 1, 0)
    rows = np.arange(len(ordered))
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = np.nansum(ordered, axis=1) / number
        spread = np.sqrt(np.nansum((ordered - mean[:, None]) ** 2, axis=1) / number)
    middle = (ordered[rows, last // 2] + ordered[rows, (last + 1) // 2]) / 2
    return np.stack([mean, spread, ordered[:, 0], middle, ordered[rows, last]], axis=1)


# -- telling them apart ---------------------------------------------------------------------------


@dataclass(frozen=True)
class ClassifierResult:
    """How well two sets of windows are told apart.

    ``auc`` has a 95 % interval over demonstrations and training sets; where it is undefined (NaN)
    its ``reason`` says why. ``importance`` is by how much the area falls when the features of one
    kind are shuffled. It is read beside ``areas``, and nothing of them is subtracted: those of
    recordings ``among`` themselves, of closed-loop tracking (``floor``) and of random actions
    (``ceiling``). ``units`` is the number of recordings that were compared. ``tracking_part`` is
    the kind of feature by which most of all closed-loop tracking differs from the recordings; empty
    where it does not.
    """

    auc: Interval
    importance: Mapping[str, float] = field(default_factory=dict)
    areas: Mapping[str, Interval] = field(default_factory=dict)
    units: int = 0
    tracking_part: str = ""

    @property
    def main_part(self) -> str:
        """The kind of feature that tells most; empty if none was shuffled."""
        return max(self.importance, key=lambda part: self.importance[part], default="")

    @property
    def tells_tracking_as_well(self) -> bool:
        """Whether tracking is recognised by the same kind of feature, and hardly worse."""
        floor = self.areas.get("floor", UNDEFINED).estimate
        same = bool(self.tracking_part) and self.tracking_part == self.main_part
        return same and self.auc.estimate <= floor + NEAR_TRACKING


def classify(
    first: Windows,
    second: Windows,
    rng: np.random.Generator,
    *,
    deals: int | None = None,
    importance: bool = False,
    until_clear: bool = False,
) -> ClassifierResult:
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
    first, second = _thinned(first, rng), _thinned(second, rng)
    values = _levels(np.concatenate([first.values, second.values]))
    simulated = np.repeat([False, True], [len(first), len(second)])
    names, group = np.unique(np.concatenate([first.group, second.group]), return_inverse=True)
    sides = [np.isin(names, side.group) for side in (first, second)]
    folds = min([FOLDS, *(int(side.sum()) for side in sides)])
    if folds < 2:
        return ClassifierResult(Interval(math.nan, reason="too few recordings"))
    most = deals or max(DEALS, 0 if len(names) < FEWEST_DEALT else math.ceil(DEALT / len(names)))
    kind = 2 * sides[0].astype(int) + sides[1]  # only simulated, only recorded, both
    wins, pairs = np.zeros((2, len(names), len(names)))
    resampler, shuffler = rng.spawn(2)
    drawn = _resampled(kind, resampler)
    fallen: dict[str, list[float]] = {}
    auc, splits = UNDEFINED, False
    for deal in range(most):
        fold = _deal(kind, folds, rng)[group]
        for number in range(folds):
            test = fold == number
            here, there, left = simulated[test], group[test], simulated[~test]
            if len(np.unique(here)) < 2:
                continue
            score = BoostedTrees.fit(values[~test], left).score
            splits |= len(left) >= 2 * MIN_LEAF_SAMPLES
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
            return ClassifierResult(Interval(math.nan, reason=reason))
        with np.errstate(invalid="ignore", divide="ignore"):
            above, all_met = (np.einsum("rg,rg->r", drawn @ s, drawn) for s in (wins, pairs))
            auc = statistics.percentile_interval(float(wins.sum() / pairs.sum()), above / all_met)
        auc = widen_for_folds(auc, folds)
        low, high = NEAR_CHANCE
        if until_clear and deal + 1 >= DEALS and not low <= _errors_above_chance(auc) <= high:
            break
    return ClassifierResult(auc, {what: float(np.mean(by)) for what, by in fallen.items()})


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
    areas = []
    for _ in range(halves):
        dealt = rng.permutation(groups)
        one, other = dealt[: len(groups) // 2], dealt[len(groups) // 2 :]
        auc = classify(recorded.of(one), recorded.of(other), rng, deals=1).auc
        areas.append((auc.estimate, auc.low, auc.high))
    estimate, low, high = np.mean(areas, axis=0).tolist()
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


def _levels(values: Floats) -> Levels:
    """Return each feature as its quantile level among all windows, 0 where it is not defined."""
    levels = np.zeros(values.shape, dtype=np.uint8)
    for column in range(values.shape[1]):
        known = np.isfinite(values[:, column])
        if known.any():
            ordered = values[known, column]
            edges = np.unique(np.quantile(ordered, np.arange(1, LEVELS - 1) / (LEVELS - 1)))
            levels[known, column] = 1 + np.searchsorted(edges, ordered, side="right")
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


def _compare(scores: Floats, simulated: Bools, group: Ints, groups: int) -> tuple[Floats, Floats]:
    """Pairs won by simulated windows, ties by halves, and all pairs, ``(groups, groups)`` each.

    Rows are the groups of the recorded, columns those of the simulated windows.
    """
    below, above = scores[~simulated], scores[simulated]
    margin = np.sign(above[None, :] - below[:, None])
    won = (margin + 1.0) / 2.0
    rows, columns = np.eye(groups)[group[~simulated]], np.eye(groups)[group[simulated]]
    return rows.T @ won @ columns, np.outer(rows.sum(axis=0), columns.sum(axis=0))


# -- classifiers of a verdict ----------------------------------------------------------------------


def tracked_rollouts(demos: Demonstrations, tracking: Tracking) -> Rollouts:
    """The demonstrations as tracking follows them, on the grid on which positions were stored."""
    require(
        tracking.positions.shape == demos.positions.shape,
        f"the tracking has shape {tracking.positions.shape} and the demonstrations "
        f"{demos.positions.shape}: track the evaluated ones",
    )
    stored = rounded(tracking.positions, demos.resolution())
    return replace(Rollouts.from_demonstrations(demos), positions=stored)


def interval_over_recordings(area: Interval, recordings: int) -> Interval:
    """Return an area with an interval of which each end errs in ``LEVEL`` of experiments.

    A bootstrap of few recordings is too narrow, and has no width where all are told apart: margins
    are widened to those of Student's t, and are at least as long as one more recording that is told
    by chance would move the area.
    """
    if not math.isfinite(area.low):
        return area
    if recordings < MIN_RECORDINGS:
        named = f"{recordings} recording{'s' * (recordings != 1)}"
        return Interval(area.estimate, reason=f"{named}, too few for an interval")
    wider = float(statistics.student_t(1 - LEVEL, recordings - 1)) / statistics.normal(0.975)
    middle, least = area.estimate, abs(area.estimate - 0.5) / (recordings + 1)
    below, above = (max(wider * abs(end - middle), least) for end in (area.low, area.high))
    if below + above == 0:
        return Interval(middle, reason="all scores are tied")
    return Interval(middle, max(middle - below, 0.0), min(middle + above, 1.0))


def classify_all(
    prepared: Prepared,
    counted: Rollouts,
    sides: Mapping[str, Rollouts],
    references: Demonstrations | None,
    unit: Ints,
    streams: Sequence[np.random.Generator],
    *,
    alone: bool = False,
) -> Iterator[tuple[str, str, ClassifierResult]]:
    """Classify two seconds of motion, then order in time: name, label and result of each.

    ``sides`` is what two seconds are read beside, smoothed as the recordings; ``references`` are
    other recordings to show two seconds of, by default halves of the evaluated ones are compared;
    ``unit`` ``(starts,)`` is the recording of each start. With ``alone`` there is the area of the
    rollouts and nothing beside it.
    """
    demos, steps = prepared.demos, window_steps(prepared.recorded)
    recordings = len(np.unique(unit[np.unique(counted.demo)]))

    def short(rollouts: Rollouts, unit: Ints = unit) -> Windows:
        made = window_features(rollouts, demos.arena, still=prepared.rest)
        return replace(made, group=unit[made.group])

    def long(rollouts: Rollouts) -> Windows:
        return sequence_windows(rollouts, demos.arena, prepared.rest, steps, unit)

    def others(own: Windows) -> Interval:
        if references is None:
            return among_themselves(own, streams[1])
        names = np.unique(references.recording, return_inverse=True)[1]
        further = prepared.filtered(Rollouts.from_demonstrations(references))
        apart = short(further, names + int(own.group.max()) + 1)
        return classify(own, apart, streams[1], deals=1).auc

    seconds = steps * prepared.recorded.dt
    halves = partial(among_themselves, rng=streams[2], halves=1)
    questions = (
        (AUC, f"Classifier on {WINDOW:g} s of motion", short, streams[0], others),
        (SEQUENCE, f"Classifier of order over {seconds:.3g} s", long, streams[2], halves),
    )
    for key, label, windows, rng, among in questions:
        own = windows(prepared.recorded)
        result = classify(own, windows(counted), rng, importance=not alone, until_clear=alone)
        areas: dict[str, Interval] = {}
        if not alone:
            areas["among"] = among(own)
        if not alone and key == AUC:
            for name, side in sides.items():
                tracking = name == "floor"
                beside = classify(own, windows(side), rng, deals=1, importance=tracking)
                areas[name] = beside.auc
                if tracking and interval_over_recordings(beside.auc, recordings).low > LITTLE_AUC:
                    result = replace(result, tracking_part=beside.main_part)
        auc = interval_over_recordings(result.auc, recordings)
        yield key, label, replace(result, auc=auc, areas=areas, units=recordings)
