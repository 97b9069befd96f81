"""Windows of motion as rows of numbers, for a classifier to look at.

Short windows are described by the same few series (speeds, acceleration, turning, distances,
bearings, place in the arena) of all individuals, each summed up by its mean, spread, extremes and
median. These are unsigned, so a path cannot be told from the same path reversed, or circles from a
search. Long windows, up to a quarter of an episode, are therefore described by the measures of
:mod:`animarl_algos.evaluation.order_in_time`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from animarl_algos.evaluation.order_in_time import (
    angle,
    distance_to_edge,
    lags_for,
    median_steps,
    nearest_other,
    order_measures,
)
from animarl_algos.evaluation.rollouts import Rollouts
from animarl_algos.evaluation.statistics import Floats, Ints
from animarl_envs.arena import Arena
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.summary import RESTING_SHARE
from animarl_envs.errors import InputError

WINDOW = 2.0  # [s]
FEWEST_STEPS = 4  # of a window, where decisions are slow
QUARTER = 0.25  # of the median episode: a long window ...
SHORTEST, LONGEST = 2.0, 20.0  # ... which lasts so long [s]
MOST_PARTS = 10_000  # of one demonstration
FEWEST_GROUPS = 5  # recordings, for their demonstrations to be kept together
NOISE_SHARE = 0.2  # of a median step: what a filter may leave of the tracking noise
DECIMALS = 9  # [arena unit] of smoothed positions
HALF_POWER = 0.443  # cutoff of a moving average times its length
SPEED, ACCELERATION, TURNING = "speed", "acceleration", "turning"
DISTANCE, BEARING, PLACE = "distances", "bearings", "place in the arena"


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
    paths = rollouts.positions[first[:, None] + np.minimum(offsets, count[:, None])]
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
    steps = QUARTER * median_steps(recorded)
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
    positions = rollouts.positions[np.concatenate(frames)]
    pieces = replace(rollouts, positions=positions, lengths=count + 1, **parts)
    measured = order_measures(pieces, lags_for(steps, rollouts.dt), rest, arena)
    return Windows(measured.values, group[pieces.demo], np.array(measured.kinds))


def smoothed(positions: Floats, lengths: Ints, frames: int) -> Floats:
    """Centred moving average of positions within episodes, over fewer frames towards their ends.

    Over an odd number of ``frames``; 1 leaves the positions ``(frames, individuals, 2)`` as they
    are. Each average depends on its own frames only, and is rounded: positions on a pixel grid that
    agreed before still do. (Differences of one running sum over all episodes would carry rounding
    errors that grow with the size of the set, by which a classifier tells a large set from a small
    one.)
    """
    if frames < 1 or frames % 2 == 0:
        raise InputError(f"smoothing is over {frames} frames: give an odd number, 1 for none")
    if frames == 1:
        return np.asarray(positions)
    ends = np.cumsum(lengths)
    last, begin = np.repeat(ends - 1, lengths), np.repeat(ends - lengths, lengths)
    here = np.arange(len(positions))
    reach = np.minimum(frames // 2, np.minimum(here - begin, last - here))
    total = np.array(positions, dtype=np.float64)
    for offset in range(1, frames // 2 + 1):
        inside = np.flatnonzero(reach >= offset)
        total[inside] += positions[inside - offset] + positions[inside + offset]
    return np.asarray((total / (2 * reach + 1)[:, None, None]).round(DECIMALS))


def suggested_smoothing(recorded: Rollouts) -> int:
    """Frames of the moving average after which tracking noise no longer shows in a step.

    White noise of the positions makes successive accelerations anti-correlated: their covariance
    at lag one is -4 times its variance, to which damped motion adds little. An average over n
    frames leaves sqrt(2)/n of it in a step, which may be a fifth of the median moving step; n is
    at most a quarter of a window.
    """
    widest = max(1, round(WINDOW / recorded.dt / 4))
    noise, step = tracking_noise(recorded), recorded.speeds() * recorded.dt
    moving = step[step > 0]
    if noise == 0 or moving.size == 0:
        return 1
    needed = int(np.ceil(np.sqrt(2) * noise / (NOISE_SHARE * float(np.median(moving)))))
    return min(needed | 1, widest - 1 + widest % 2) if needed > 1 else 1


def comparison_smoothing(demos: Demonstrations) -> int:
    """Frames of the moving average that both sides of a comparison go through; 1 for none.

    What tracking noise asks for (:func:`suggested_smoothing`), and where the import low-pass
    filtered the tracks, an average with the same cutoff: faster motion was taken out of the
    recordings, so that a simulator cannot learn it.
    """
    recipe = demos.provenance.get("recipe")
    cleaning = recipe.get("cleaning", {}) if isinstance(recipe, Mapping) else {}
    cutoff = cleaning.get("smoothing_cutoff")
    filtered = 1
    if isinstance(cutoff, int | float) and cutoff > 0:
        filtered = int(np.ceil(HALF_POWER / (cutoff * demos.dt))) | 1
    return max(filtered, suggested_smoothing(Rollouts.from_demonstrations(demos)))


def resting_step(recorded: Rollouts) -> Floats:
    """Distance within a step below which an individual is at rest ``(individuals,)``.

    It rests where it is slower than 5 % of its 99th percentile [arena unit]. Speed and direction of
    one at rest are those of rounding and of tracking noise on the one side, of the smallest thrust
    on the other, which would tell any simulation from any recording.
    """
    speeds = recorded.speeds()
    fast = np.quantile(speeds, 0.99, axis=0)
    if recorded.is_group:  # animals of a group are alike
        fast[:] = np.quantile(speeds, 0.99)
    return np.asarray(RESTING_SHARE * fast * recorded.dt)


def tracking_noise(recorded: Rollouts) -> float:
    """Standard deviation of white noise of the recorded positions, per axis [arena unit]."""
    products = []
    for index in range(len(recorded)):
        bend = np.diff(recorded.path(index), n=2, axis=0)
        if len(bend) > 1:
            products.append((bend[1:] * bend[:-1]).ravel())
    if not products:
        return 0.0
    return float(np.sqrt(max(0.0, -np.concatenate(products).mean() / 4.0)))


def _cut(rollouts: Rollouts, steps: int) -> tuple[Ints, Ints, Ints]:
    """First frame, steps and episode of every window."""
    found = []
    for index, (start, length) in enumerate(zip(rollouts.offsets.tolist(), rollouts.lengths)):
        left = int(length) - 1
        for begin in range(0, max(left, 1), steps):
            here = min(steps, left - begin)
            if begin == 0 or here >= steps / 2:
                found.append((start + begin, here, index))
    first, count, episode = np.array(found).T
    return first, count, episode


def _series(
    paths: Floats, rollouts: Rollouts, arena: Arena, still: Floats
) -> list[tuple[str, Floats]]:
    """What is looked at along windows ``(windows, frames, K, 2)``, each ``(windows, times)``.

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
        series.append((PLACE, distance_to_edge(own, arena)))
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
    return np.where(shorter <= 0, np.nan, np.abs(angle(first, second)))


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
