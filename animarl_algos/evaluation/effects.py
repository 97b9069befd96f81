"""What a flipped cue does, beside the truth and beside what it does where nothing was learned.

A policy is asked from the same starts, in the same world and with the same random numbers, told the
true condition and then the other one. The *predicted shift* is the mean path length of the second
answer minus that of the first. The *true shift* is what the other condition really does from these
starts: for artificial agents, teams that were trained under it; for a searcher, whose condition is
what it senses, its own search in the changed world.

Two shifts stand beside it in which no effect of the condition was learned: that of untrained
networks, which answer to any input somehow, and that of the trained networks with the flag zeroed,
asked twice with random numbers of their own, which is chance alone.

An untrained network answers to its flag as to any other input, so the answers of one network, or of
two, always differ somehow. A claim therefore speaks of training seeds. It is worded only if there
are at least three, their mean shift excludes zero over seeds and over starts, and it differs from
that of networks that learned nothing.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from itertools import permutations
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from animarl_algos.evaluation.comparison import put_interval
from animarl_algos.evaluation.metrics import PATH_LENGTH, Episodes, Metric
from animarl_algos.evaluation.rollouts import NO_CUE, RECORDED, Rollouts
from animarl_algos.evaluation.statistics import (
    CONFIDENCE,
    RESAMPLES,
    UNDEFINED,
    Cells,
    Interval,
    bootstrap_difference,
    bootstrap_mean,
    cells,
)
from animarl_envs.demos.demonstrations import Demonstrations

if TYPE_CHECKING:
    import pandas as pd

MEAN, FLIPPED, TRUE_MEAN = "mean", "mean, cue flipped", "mean, other condition"
ERROR, PREDICTED, TRUE = "signed error", "predicted shift", "true shift"
MISSED, UNTRAINED_SHIFT, BLIND = "predicted - true", "untrained shift", "flag zeroed"
ACCURACY, ERROR_DIFFERENCE = "treatment accuracy", "difference of signed errors"
COUNTINGS = ("all", "captures")
NO_TRUTH = "no truth is known for these demonstrations: give --truth"
NO_HEAD = "it has no treatment head"
SAME_TWICE = "it acts without chance: asked twice, it does the same"
NOT_SHARED = "no start in which both answers count"


@dataclass(frozen=True, eq=False)
class Answers:
    """Rollouts of one method from the same starts, told the true condition and the other one."""

    factual: Rollouts
    flipped: Rollouts


@dataclass(frozen=True, eq=False, kw_only=True)
class Asked:
    """All that one method was asked, over its training seeds.

    Parameters
    ----------
    trained
        The answers of the trained networks.
    untrained
        Those of the networks that training began with.
    blind
        Those of the trained networks with the flag zeroed, with random numbers of their own.
    world
        Rollouts in the world of the other condition, told so; where that changes the world.
    accuracy
        Balanced accuracy of the treatment head on held-out demonstrations, by seed.
    main
        Whether it is a variant of the main comparison, or of the supplementary one.
    """

    trained: Answers
    untrained: Answers | None = None
    blind: Answers | None = None
    world: Rollouts | None = None
    accuracy: Mapping[int, float] = field(default_factory=dict)
    main: bool = True


@dataclass(frozen=True, eq=False)
class Effects:
    """``table`` one row per quantity, ``claims`` one row per method and flip.

    ``table``: ``method``, ``variant``, ``quantity``, ``condition`` (of the starts), ``told``,
    ``planned``, ``counting``, ``value`` with ``value_low`` and ``value_high`` (95 %), ``seeds``,
    ``starts``, ``speaks_of`` and ``reason``. ``claims``: ``method``, ``condition``, ``told``,
    ``worded`` and ``reason``.
    """

    table: pd.DataFrame
    claims: pd.DataFrame


def answers_of(rollouts: Rollouts, demos: Demonstrations) -> Asked | None:
    """Return what a method was asked, of all its rollouts; None if no cue was flipped."""
    own = demos.condition[rollouts.demo]
    told = np.where(rollouts.cue == NO_CUE, rollouts.condition, rollouts.cue)
    factual, flipped, world = (
        (rollouts.condition == own) & (told == own),
        (rollouts.condition == own) & (told != own),
        (rollouts.condition != own) & (told == rollouts.condition),
    )
    if not (factual.any() and flipped.any()):
        return None
    trained = Answers(rollouts.select(factual), rollouts.select(flipped))
    return Asked(trained=trained, world=rollouts.select(world) if world.any() else None)


def cue_effects(
    asked: Mapping[str, Asked],
    demos: Demonstrations,
    *,
    teams: tuple[Rollouts, Rollouts] | None = None,
    planned: tuple[int, int] | None = None,
    metric: Metric = PATH_LENGTH,
    seed: int = 0,
    resamples: int = RESAMPLES,
) -> Effects:
    """Shifts with their truth and their nulls, errors and their differences.

    Parameters
    ----------
    asked
        By method.
    demos
        The evaluated demonstrations, which all rollouts started from.
    teams
        What the teams of condition 0 and of condition 1 do from every start.
    planned
        The flip ``(from, to)`` that was planned in advance; only of it a claim may be worded.
    seed
        Of the resampling.
    """
    import pandas as pd

    worked = _Effects(demos, metric, teams, planned, np.random.default_rng(seed), resamples)
    rows = list(worked.recorded_rows())
    claims: list[dict[str, Any]] = []
    for name, one in asked.items():
        rows += worked.method_rows(name, one)
        claims += worked.claim_rows(name, one)
    for first, second in permutations(asked, 2):
        if second == first.replace("CIL", "DIL"):
            rows += worked.difference_rows(first, asked[first], second, asked[second])
    return Effects(pd.DataFrame(rows), pd.DataFrame(claims))


@dataclass(frozen=True, eq=False)
class _Effects:
    demos: Demonstrations
    metric: Metric
    teams: tuple[Rollouts, Rollouts] | None
    planned: tuple[int, int] | None
    rng: np.random.Generator
    resamples: int

    def recorded_rows(self) -> Iterator[dict[str, Any]]:
        recorded = Rollouts.from_demonstrations(self.demos)
        for counting, c in self._everything():
            yield self._row(RECORDED, MEAN, c, c, counting, self._of(recorded, counting, c))

    def method_rows(self, name: str, one: Asked) -> Iterator[dict[str, Any]]:
        recorded = Rollouts.from_demonstrations(self.demos)
        for counting, c in self._everything():
            factual = self._of(one.trained.factual, counting, c)
            flipped = self._of(one.trained.flipped, counting, c)
            predicted = minus(flipped, factual)
            true = self.true_shift(one, counting, c)
            truth = self._of(recorded, counting, c)
            found: list[tuple[str, int, Cells | None, str]] = [
                (MEAN, c, factual, ""),
                (FLIPPED, 1 - c, flipped, ""),
                (ERROR, c, minus(factual, truth), ""),
                (PREDICTED, 1 - c, predicted, ""),
                (TRUE, 1 - c, true, NO_TRUTH),
                (MISSED, 1 - c, None if true is None else minus(predicted, true), NO_TRUTH),
                (UNTRAINED_SHIFT, 1 - c, self._shift(one.untrained, counting, c), "not asked"),
                (BLIND, 1 - c, *self._chance(one.blind, counting, c)),
            ]
            for quantity, told, data, absent in found:
                yield self._row(name, quantity, c, told, counting, data, one.main, absent)
        yield self._accuracy(name, one)

    def claim_rows(self, name: str, one: Asked) -> Iterator[dict[str, Any]]:
        """Only over all episodes: what counts among captures depends on what is asked."""
        for c in self._conditions():
            shift = minus(
                self._of(one.trained.flipped, "all", c), self._of(one.trained.factual, "all", c)
            )
            found = Claim(False, "this flip was not planned in advance")
            if (c, 1 - c) == self.planned:
                untrained = self._shift(one.untrained, "all", c)
                found = claim(shift, untrained, self.rng, self.resamples)
            yield {
                "method": name, "condition": c, "told": 1 - c, "worded": found.worded,
                "reason": found.reason,
            }  # fmt: skip

    def difference_rows(
        self, first: str, a: Asked, second: str, b: Asked
    ) -> Iterator[dict[str, Any]]:
        """Signed error of one method minus that of another, on the same starts."""
        recorded = Rollouts.from_demonstrations(self.demos)
        for counting, c in self._everything():
            truth = self._of(recorded, counting, c)
            mine = minus(self._of(a.trained.factual, counting, c), truth)
            other = minus(self._of(b.trained.factual, counting, c), truth)
            value = bootstrap_difference(mine, other, self.rng, self.resamples)
            yield self._row(
                f"{first} - {second}", ERROR_DIFFERENCE, c, c, counting, mine, a.main,
                value=value,
            )  # fmt: skip

    def true_shift(self, one: Asked, counting: str, c: int) -> Cells | None:
        """What the other condition does from the starts of condition ``c``."""
        if one.world is not None:
            own = self._of(one.trained.factual, counting, c)
            return minus(self._of(one.world, counting, c), own)
        if self.teams is None:
            return None
        return minus(self._of(self.teams[1 - c], counting, c), self._of(self.teams[c], counting, c))

    def _shift(self, answers: Answers | None, counting: str, c: int) -> Cells | None:
        if answers is None:
            return None
        return minus(self._of(answers.flipped, counting, c), self._of(answers.factual, counting, c))

    def _chance(self, blind: Answers | None, counting: str, c: int) -> tuple[Cells | None, str]:
        """The shift of networks whose flag was zeroed; none of those that act without chance."""
        if blind is None:
            return None, "not asked"
        if np.array_equal(blind.factual.positions, blind.flipped.positions):
            return None, SAME_TWICE
        return self._shift(blind, counting, c), ""

    def _accuracy(self, name: str, one: Asked) -> dict[str, Any]:
        values = np.array(list(one.accuracy.values()))[:, None]
        data = Cells(values, np.ones_like(values)) if len(values) else None
        mean = UNDEFINED if data is None else Interval(data.mean, np.nan, np.nan)
        row = self._row(name, ACCURACY, -1, -1, "all", data, one.main, NO_HEAD, value=mean)
        return row if data is None else row | {"starts": 0, "reason": "no interval is worked out"}

    def _of(self, rollouts: Rollouts, counting: str, c: int) -> Cells:
        """The metric by seed and start, of starts of condition ``c``."""
        chosen = self.demos.condition[rollouts.demo] == c
        counts = chosen & (rollouts.captured | (counting == "all"))
        values = self.metric.measure(Episodes(rollouts, self.demos))
        whole = cells(values, rollouts.seed, rollouts.demo, self.demos.num_episodes, counts)
        starts = self.demos.condition == c
        return Cells(whole.sums[:, starts], whole.counts[:, starts])

    def _conditions(self) -> list[int]:
        return [c for c in (0, 1) if (self.demos.condition == c).any()]

    def _everything(self) -> Iterator[tuple[str, int]]:
        for counting in COUNTINGS:
            for c in self._conditions():
                yield counting, c

    def _row(
        self, method: str, quantity: str, of: int, told: int, counting: str, data: Cells | None,
        main: bool = True, absent: str = "", value: Interval | None = None,
    ) -> dict[str, Any]:  # fmt: skip
        seeds = 0 if data is None else len(data.sums)
        starts = 0 if data is None else int((data.counts.sum(axis=0) > 0).sum())
        reason = "" if data is not None else absent
        if value is None:
            value = UNDEFINED
            if data is not None and starts == 0:
                reason = NOT_SHARED
            elif data is not None:
                value = bootstrap_mean(data, self.rng, self.resamples)
                reason = "" if np.isfinite(value.low) else "too few starts for an interval"
        row: dict[str, Any] = {
            "method": method,
            "variant": "" if method == RECORDED else "main" if main else "supplementary",
            "quantity": quantity,
            "condition": of,
            "told": told,
            "planned": (of, told) == self.planned,
            "counting": counting,
        }
        put_interval(row, "value", value)
        speaks_of = "this network only" if seeds == 1 else "networks trained in this way"
        if method == RECORDED or (quantity == TRUE and self.teams is not None):
            seeds, speaks_of = 0, RECORDED if method == RECORDED else "the teams"
        return row | {"seeds": seeds, "starts": starts, "speaks_of": speaks_of, "reason": reason}


def minus(first: Cells, second: Cells) -> Cells:
    """Difference of the means of every seed and start, where both have one; each counts once.

    ``second`` may have a single row, for all seeds.
    """
    means: NDArray[np.float64] = first.cell_means - second.cell_means
    present = np.isfinite(means)
    return Cells(np.where(present, means, 0.0), present.astype(np.float64))


# -- claims ----------------------------------------------------------------------------------------

FEWEST_SEEDS = 3


@dataclass(frozen=True)
class Claim:
    """Whether a shift is worded as an effect, and if not, why not."""

    worded: bool
    reason: str = ""


def claim(
    shift: Cells,
    untrained: Cells | None,
    rng: np.random.Generator,
    resamples: int = RESAMPLES,
) -> Claim:
    """Judge the shift of a method by seed and start beside that of untrained networks."""
    seeds = len(shift.sums)
    if seeds < FEWEST_SEEDS:
        return Claim(
            False, f"{seeds} training seed{'s' * (seeds != 1)}: give at least {FEWEST_SEEDS}"
        )
    if untrained is None or len(untrained.sums) < FEWEST_SEEDS:
        return Claim(False, "there are too few untrained networks to tell it apart from")
    if not over_seeds(shift).excludes_zero:
        return Claim(False, "the training seeds do not agree")
    if not bootstrap_mean(shift, rng, resamples).excludes_zero:
        return Claim(False, "the interval includes zero")
    if not bootstrap_difference(shift, untrained, rng, resamples).excludes_zero:
        return Claim(False, "it is not told apart from that of untrained networks")
    return Claim(True)


def over_seeds(data: Cells, confidence: float = CONFIDENCE) -> Interval:
    """Mean of the seeds' means with Student's interval; undefined for fewer than two."""
    from scipy.stats import t

    with np.errstate(invalid="ignore", divide="ignore"):
        means = data.sums.sum(axis=1) / data.counts.sum(axis=1)
    means = means[np.isfinite(means)]
    if len(means) < 2:
        return Interval(float(means.mean()) if len(means) else np.nan, np.nan, np.nan)
    half = t.ppf(0.5 + confidence / 2, len(means) - 1) * means.std(ddof=1) / np.sqrt(len(means))
    centre = float(means.mean())
    return Interval(centre, centre - float(half), centre + float(half))
