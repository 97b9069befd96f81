"""Recordings and rollouts made comparable: same condition, same smoothing, same end of the film.

A recording that merely ends says that the animals went on for at least as long. Rollouts from its
start stop there too, and durations are compared as survival, by the mean time up to the longest one
(the area under the survival curve).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import ArrayLike

from animarl_algos.evaluation import order_in_time
from animarl_algos.evaluation.rollouts import Rollouts
from animarl_envs.array_types import Bools, Floats, Ints
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.episode import PURSUER_OUT, TARGET_OUT, TIME_OUT, UNFINISHED
from animarl_envs.demos.summary import RESTING_SHARE, Unit, tracking_noise, unit_of
from animarl_envs.dtw import dtw_alignment
from animarl_envs.errors import require

REACHED, NEITHER = 1, 0  # endings, beside TARGET_OUT and PURSUER_OUT
WINDOW = 2.0  # [s]
CELLS = 8  # along each side of the field, of maps of where individuals are
NOISE_SHARE = 0.2  # of a median step: what a filter may leave of the tracking noise
DECIMALS = 9  # [arena unit] of smoothed positions
HALF_POWER = 0.443  # cutoff of a moving average times its length
SLOW_SHARE = 0.25  # of the recorded median moving speed: a step below it is a slow one


@dataclass(frozen=True, eq=False)
class Prepared:
    """Smoothed recordings, with what all comparisons with them have in common.

    ``smoothing`` are the frames of the moving average that both sides go through, 1 for none.
    """

    demos: Demonstrations
    smoothing: int = 1
    _orders: WeakKeyDictionary[Rollouts, order_in_time.EpisodeMeasures] = field(
        default_factory=WeakKeyDictionary, init=False, repr=False
    )

    @cached_property
    def recorded(self) -> Rollouts:
        return self.filtered(Rollouts.from_demonstrations(self.demos))

    @cached_property
    def rest(self) -> Floats:
        """``(individuals,)`` steps up to this length are at rest [arena unit]."""
        return resting_step(self.recorded)

    @cached_property
    def maps(self) -> Floats:
        """``(starts, individuals, cells)`` shares of the recorded frames in each cell."""
        return self.cell_shares(self.recorded)

    @cached_property
    def maps_of_others(self) -> Floats:
        """``(starts, individuals, cells)`` shares of the frames of all other recordings."""
        unit = np.unique(self.demos.recording, return_inverse=True)[1]
        counts = self.maps * self.recorded.lengths[:, None, None]
        if self.recorded.is_group:  # animals of a group are alike
            counts = np.repeat(counts.mean(axis=1, keepdims=True), counts.shape[1], axis=1)
        own = np.zeros((int(unit.max()) + 1, *counts.shape[1:]))
        np.add.at(own, unit, counts)
        others = counts.sum(axis=0) - own
        total = others.sum(axis=-1, keepdims=True)
        return np.asarray((others / np.where(total > 0, total, np.nan))[unit])

    @property
    def rectangle(self) -> tuple[Floats, Floats]:
        """Lower left corner, and size, of the rectangle that holds the recorded positions."""
        known = self.recorded.positions.reshape(-1, 2)
        return known.min(axis=0), np.maximum(np.ptp(known, axis=0), 1e-9)

    @cached_property
    def lags(self) -> tuple[int, ...]:
        """Lags at which order in time is looked at [steps]."""
        steps = order_in_time.median_steps(self.recorded)
        return order_in_time.lags_for(steps, self.recorded.dt)

    def cell_shares(self, rollouts: Rollouts) -> Floats:
        """Return the shares of the frames of each episode in each cell of the field.

        ``(episodes, individuals, cells)``. The rectangle that holds the recorded positions is
        divided into ``CELLS`` by ``CELLS`` cells; those at its edge hold what lies beyond.
        """
        low, size = self.rectangle
        place = np.clip((CELLS * (rollouts.positions - low) / size).astype(int), 0, CELLS - 1)
        cell = place[..., 0] * CELLS + place[..., 1]
        shares = np.zeros((len(rollouts), cell.shape[1], CELLS**2))
        episode = np.repeat(np.arange(len(rollouts)), rollouts.lengths)
        for i in range(cell.shape[1]):
            counts = np.bincount(episode * CELLS**2 + cell[:, i], minlength=len(shares) * CELLS**2)
            shares[:, i] = counts.reshape(len(shares), CELLS**2)
        return np.asarray(shares / rollouts.lengths[:, None, None])

    def episodes(self, rollouts: Rollouts) -> MeasuredEpisodes:
        """Return rollouts as metrics are worked out from them."""
        return MeasuredEpisodes(self, rollouts)

    @property
    def unit(self) -> Unit:
        return unit_of(self.demos)

    def filtered(self, rollouts: Rollouts) -> Rollouts:
        """Smooth rollouts as the recordings were."""
        moved = smoothed(rollouts.positions, rollouts.lengths, self.smoothing)
        return replace(rollouts, positions=moved)

    def counted(self, rollouts: Rollouts) -> Rollouts:
        """Rollouts in the recorded condition, cut where their recording was, and smoothed."""
        return self.filtered(censored(rollouts.factual(self.demos), self.demos))

    def order(self, rollouts: Rollouts) -> order_in_time.EpisodeMeasures:
        """Order in time, reactions and places of every episode."""
        if rollouts not in self._orders:
            measured = order_in_time.order_measures(
                rollouts, self.lags, self.rest, self.demos.arena
            )
            self._orders[rollouts] = measured
        return self._orders[rollouts]


@dataclass(frozen=True, eq=False)
class MeasuredEpisodes:
    """Rollouts beside the recordings that they started from, as metrics need them.

    ``rollouts.demo`` counts the episodes of ``prepared.demos``.
    """

    prepared: Prepared
    rollouts: Rollouts

    @property
    def order(self) -> order_in_time.EpisodeMeasures:
        """Order in time, reactions and places, at the lags of the demonstrations."""
        return self.prepared.order(self.rollouts)

    @cached_property
    def dtw(self) -> Floats:
        """``(2, rollouts)``: DTW distance of those who move by themselves, and the same per step.

        Means over individuals, of whole paths and of the distance of aligned positions [arena
        unit].
        """
        distance, pairs = dtw_alignments(self.rollouts, self.prepared.demos)
        return np.stack([self._mean_over_movers(each) for each in (distance, distance / pairs)])

    @property
    def path_length(self) -> Floats:
        """``(rollouts,)``: mean over those who move by themselves [arena unit]."""
        return self._mean_over_movers(path_lengths(self.rollouts))

    @property
    def duration(self) -> Floats:
        """``(rollouts,)`` [s]."""
        return np.asarray((self.rollouts.lengths - 1) * self.rollouts.dt, dtype=np.float64)

    @property
    def outside(self) -> Bools:
        """``(rollouts,)``, whether somebody was outside the arena, or left it.

        Who is outside by no more than positions are rounded by may have been rounded there.
        """
        demos = self.prepared.demos
        grid = demos.resolution()
        margin = 0.0 if grid is None else grid.reach
        inside = demos.arena.contains(self.rollouts.positions, margin=margin)
        ever = np.logical_or.reduceat(~inside.all(axis=1), self.rollouts.offsets[:-1])
        return np.asarray(ever | np.isin(self.rollouts.outcome, (TARGET_OUT, PURSUER_OUT)))

    @property
    def occupancy(self) -> Floats:
        """``(rollouts,)`` distance of each episode's map to that of the other recordings.

        The share of the time that would have to be spent elsewhere, mean over individuals. Left out
        of the map is the recording that the episode started from, of recordings their own.
        """
        prepared = self.prepared
        others = prepared.maps_of_others[self.rollouts.demo]
        apart = np.abs(prepared.cell_shares(self.rollouts) - others)
        return np.asarray(0.5 * apart.sum(axis=-1).mean(axis=1))

    @cached_property
    def motion(self) -> Floats:
        """``(4, rollouts)``, means over individuals.

        Mean and median speed of single steps [arena unit / s], share of slow steps, and the angle
        between successive steps summed over an episode, divided by its duration [rad/s].
        """
        rollouts, slow = self.rollouts, slow_speeds(self.prepared.recorded)
        numbers = np.zeros((4, len(rollouts)))
        for i in range(len(rollouts)):
            moved = np.diff(rollouts.path(i), axis=0)
            if len(moved) == 0:
                continue
            speed = np.linalg.norm(moved, axis=-1) / rollouts.dt
            turned = np.abs(order_in_time.angle(moved[:-1], moved[1:])).sum(axis=0).mean()
            median = np.median(speed, axis=0).mean()
            numbers[:, i] = speed.mean(), median, (speed < slow).mean(), turned / self.duration[i]
        return numbers

    def _mean_over_movers(self, values: Floats) -> Floats:
        return np.asarray(values[:, self.rollouts.movers].mean(axis=1))


def smoothed(positions: Floats, lengths: Ints, frames: int) -> Floats:
    """Centred moving average of positions within episodes, over fewer frames towards their ends.

    Over an odd number of ``frames``; 1 leaves the positions ``(frames, individuals, 2)`` as they
    are. Each average depends on its own frames only, and is rounded: positions on a pixel grid that
    agreed before still do. (Differences of one running sum over all episodes would carry rounding
    errors that grow with the size of the set, by which a classifier tells a large set from a small
    one.)
    """
    odd = frames > 0 and frames % 2 == 1
    require(odd, f"smoothing is over {frames} frames: give an odd number, 1 for none")
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

    An average over n
    frames leaves sqrt(2)/n of it in a step, which may be a fifth of the median moving step; n is
    at most a quarter of a window.
    """
    widest = max(1, round(WINDOW / recorded.dt / 4))
    paths = [recorded.path(index) for index in range(len(recorded))]
    noise, step = tracking_noise(paths), recorded.speeds() * recorded.dt
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


def slow_speeds(recorded: Rollouts) -> Floats:
    """Return the speed below which each individual is slow, ``(individuals,)`` [arena unit / s].

    It is a quarter of the median speed of those recorded steps in which it moves at all, faster
    than 5 % of its 99th percentile.
    """
    speeds = recorded.speeds()
    if recorded.is_group:  # animals of a group are alike
        speeds = np.repeat(speeds.reshape(-1, 1), speeds.shape[1], axis=1)
    moving = (one[one > RESTING_SHARE * np.quantile(one, 0.99)] for one in speeds.T)
    return np.array([SLOW_SHARE * np.median(one) if one.size else 0.0 for one in moving])


def ending(rollouts: Rollouts) -> Ints:
    """Reached, target out, pursuer out, or neither (time-out, or the recording was cut)."""
    outcome = rollouts.outcome
    known = np.where(np.isin(outcome, (TARGET_OUT, PURSUER_OUT)), outcome, NEITHER)
    return np.where(outcome > 0, REACHED, known).astype(np.int64)


def path_lengths(rollouts: Rollouts) -> Floats:
    """Distance travelled by each individual, ``(rollouts, individuals)`` [arena unit]."""
    step = np.zeros(rollouts.positions.shape[:2])
    step[1:] = np.linalg.norm(np.diff(rollouts.positions, axis=0), axis=-1)
    step[rollouts.offsets[:-1]] = 0.0  # no step leads from one episode to the next
    return np.asarray(np.add.reduceat(step, rollouts.offsets[:-1], axis=0))


def dtw_alignments(rollouts: Rollouts, demos: Demonstrations) -> tuple[Floats, Floats]:
    """DTW distance of each individual's whole path to its demonstration's, and pairs of frames.

    Closed at both ends, Euclidean local cost, summed along the best warping path, which aligns so
    many pairs; ``(rollouts, individuals)`` [arena unit], twice.
    """
    distance, pairs = np.empty((2, len(rollouts), len(rollouts.individuals)))
    for i, demo in enumerate(rollouts.demo.tolist()):
        path, recorded = rollouts.path(i), demos.path(demo)
        for k in range(distance.shape[1]):
            distance[i, k], pairs[i, k] = dtw_alignment(path[:, k], recorded[:, k])
    return distance, pairs


def censored(rollouts: Rollouts, recorded: Demonstrations | Rollouts) -> Rollouts:
    """Stop rollouts where their recording merely stops, as nothing is known of what came after.

    A rollout from the start of a recording that was cut (outcome ``UNFINISHED``) ends no later than
    that recording, and is then cut as well. What ended before by itself stays as it is.
    """
    cut = recorded.outcome[rollouts.demo] == UNFINISHED
    limit = np.asarray(recorded.lengths)[rollouts.demo]
    long = cut & (rollouts.lengths > limit)
    stopped = long | (cut & (rollouts.lengths == limit) & (rollouts.outcome == 0))
    if not stopped.any():
        return rollouts
    lengths = np.where(long, limit, rollouts.lengths)
    frame = np.arange(len(rollouts.positions)) - np.repeat(rollouts.offsets[:-1], rollouts.lengths)
    return replace(
        rollouts,
        positions=rollouts.positions[frame < np.repeat(lengths, rollouts.lengths)],
        lengths=lengths,
        outcome=np.where(stopped, UNFINISHED, rollouts.outcome),
    )


def has_ended(rollouts: Rollouts) -> np.ndarray:
    """``(rollouts,)``, false where time or the film ran out."""
    return ~np.isin(rollouts.outcome, (UNFINISHED, TIME_OUT))


def restricted_mean_scores(duration: ArrayLike, ended: ArrayLike) -> Floats:
    """Return what each episode adds to the mean duration up to the longest one, ``(episodes,)``.

    Where no episode is cut by the end of the film (``ended``), it is its duration. Of others it is
    the pseudo-value of the mean under the Kaplan-Meier curve (Andersen, Klein and Rosthoj 2003,
    Biometrika 90, 15), to first order: their mean is the area under the curve, and those of two
    groups can be compared as any other values.
    """
    duration, ended = np.asarray(duration, np.float64), np.asarray(ended, bool)
    if ended.all():
        return duration
    times, place = np.unique(duration, return_inverse=True)
    here = np.bincount(place, minlength=len(times))
    events = np.bincount(place, ended, minlength=len(times))
    at_risk = here[::-1].cumsum()[::-1]
    hazard = events / at_risk
    survival = np.cumprod(1.0 - hazard)
    areas = np.concatenate([[1.0], survival[:-1]]) * np.diff(times, prepend=0.0)
    total = float(areas.sum())
    left = np.append(areas[1:][::-1].cumsum()[::-1], 0.0)  # area under the curve after each time
    share = at_risk / len(duration)
    # An event lowers the curve after it; each episode at risk bears its part of the hazard.
    step = left / np.where(hazard < 1, 1.0 - hazard, 1.0)
    moved = np.cumsum(step * hazard / share)
    return np.asarray(total - np.where(ended, (step / share)[place], 0.0) + moved[place])
