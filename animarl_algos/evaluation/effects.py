"""What a flipped cue does, beside the truth and beside what it does where nothing was learned.

A policy is asked from the same starts, in the same world and with the same random numbers, told the
true condition and then the other one. The *predicted shift* is the mean path length of the second
answer minus that of the first. The *true shift* is what the other condition really does from these
starts: for artificial agents, teams that were trained under it; for a searcher, whose condition is
what it senses, its own search in the changed world.

Untrained networks answer to their flag as to any other input, so their shift stands beside, and
that of the trained networks with the flag zeroed, which is chance alone. A claim is worded only if
there are at least three training seeds, their mean shift excludes zero over seeds and over starts,
and it differs from that of networks that learned nothing.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from itertools import permutations
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from animarl_algos.evaluation import statistics
from animarl_algos.evaluation.comparison import COUNTING
from animarl_algos.evaluation.metrics import PATH_LENGTH
from animarl_algos.evaluation.prepared import Prepared
from animarl_algos.evaluation.rollouts import RECORDED, Rollouts
from animarl_algos.evaluation.statistics import CONFIDENCE, RESAMPLES, Cells, Draws, Interval
from animarl_envs.demos.demonstrations import Demonstrations

MEAN, FLIPPED = "mean", "mean, cue flipped"
ERROR, PREDICTED, TRUE = "signed error", "predicted shift", "true shift"
MISSED, UNTRAINED_SHIFT, BLIND = "predicted - true", "untrained shift", "flag zeroed"
ACCURACY, ERROR_DIFFERENCE = "treatment accuracy", "difference of signed errors"
NO_TRUTH = "no truth is known for these demonstrations: give --truth"
FEWEST_SEEDS = 3


class Answers(NamedTuple):
    """Rollouts of one method from the same starts, told the true condition and the other one."""

    factual: Rollouts
    flipped: Rollouts


@dataclass(frozen=True, eq=False, kw_only=True)
class Asked:
    """All that one method was asked, over its training seeds.

    ``trained`` and ``untrained`` are the answers of the trained networks and of those that training
    began with, ``blind`` those of the trained networks with the flag zeroed, with random numbers of
    their own. ``world`` are rollouts in the world of the other condition, told so, where that
    changes the world; ``accuracy`` the balanced accuracy of the treatment head on held-out
    demonstrations, by seed; ``main`` says whether it is a variant of the main comparison.
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

    The columns ``condition`` and ``told`` are those of the starts and of the policy; ``value`` has
    a 95 % interval; ``seeds`` and ``demos`` count, and ``reason`` says why there is no value or
    claim.
    """

    table: pd.DataFrame
    claims: pd.DataFrame


def cue_effects(
    asked: Mapping[str, Asked],
    demos: Demonstrations,
    *,
    teams: tuple[Rollouts, Rollouts] | None = None,
    planned: tuple[int, int] | None = None,
    resamples: int = RESAMPLES,
) -> Effects:
    """Shifts of path length with their truth and their nulls, errors and their differences.

    Parameters
    ----------
    asked, demos
        By method; the evaluated demonstrations, which all rollouts started from.
    teams
        What the teams of condition 0 and of condition 1 do from every start.
    planned
        The flip ``(from, to)`` that was planned in advance; only of it a claim may be worded.
    """
    worked = _Effects(demos, teams, planned, Draws(0, resamples))
    rows = [
        worked.row(RECORDED, MEAN, c, c, counting, worked.recorded(counting, c))
        for counting, c in worked.everything
    ]
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
    teams: tuple[Rollouts, Rollouts] | None
    planned: tuple[int, int] | None
    draws: Draws

    @property
    def everything(self) -> list[tuple[str, int]]:
        conditions = np.unique(self.demos.condition).tolist()
        return [(counting, c) for counting in COUNTING for c in conditions]

    def method_rows(self, name: str, one: Asked) -> Iterator[dict[str, Any]]:
        for counting, c in self.everything:
            factual, flipped = (self.of(side, counting, c) for side in one.trained)
            predicted = minus(flipped, factual)
            truth = None if self.teams is None else Answers(self.teams[c], self.teams[1 - c])
            truth = truth if one.world is None else Answers(one.trained.factual, one.world)
            true = self.shift(truth, counting, c, NO_TRUTH)
            found = {
                MEAN: (c, factual),
                FLIPPED: (1 - c, flipped),
                ERROR: (c, minus(factual, self.recorded(counting, c))),
                PREDICTED: (1 - c, predicted),
                TRUE: (1 - c, true),
                MISSED: (1 - c, minus(predicted, true)),
                UNTRAINED_SHIFT: (1 - c, self.shift(one.untrained, counting, c)),
                BLIND: (1 - c, self.shift(one.blind, counting, c)),
            }
            blind = one.blind
            if blind and np.array_equal(blind.factual.positions, blind.flipped.positions):
                same = "it acts without chance: asked twice, it does the same"
                found[BLIND] = 1 - c, Cells.absent(same)
            for quantity, (told, data) in found.items():
                yield self.row(name, quantity, c, told, counting, data, one.main)
        data, mean = Cells.absent("it has no treatment head"), None
        if one.accuracy:
            data = statistics.single_cells(np.array([*one.accuracy.values()])[:, None])
            mean = Interval(data.mean, reason="no interval")
        yield self.row(name, ACCURACY, -1, -1, "all", data, one.main, mean)

    def claim_rows(self, name: str, one: Asked) -> Iterator[dict[str, Any]]:
        """Only over all episodes: what counts among captures depends on what is asked."""
        for c in np.unique(self.demos.condition).tolist():
            against = "this flip was not planned in advance"
            if (c, 1 - c) == self.planned:
                shift, untrained = (self.shift(a, "all", c) for a in (one.trained, one.untrained))
                against = objection_to_claim(shift, untrained, self.draws)
            yield {"method": name, "condition": c, "told": 1 - c, "worded": not against,
                   "reason": against}  # fmt: skip

    def difference_rows(
        self, first: str, a: Asked, second: str, b: Asked
    ) -> Iterator[dict[str, Any]]:
        """Signed error of one method minus that of another, on the same starts."""
        for counting, c in self.everything:
            truth = self.recorded(counting, c)
            mine, other = (
                minus(self.of(one.trained.factual, counting, c), truth) for one in (a, b)
            )
            value = statistics.bootstrap_difference(mine, other, self.draws)
            name = f"{first} - {second}"
            yield self.row(name, ERROR_DIFFERENCE, c, c, counting, mine, a.main, value)

    def shift(
        self, answers: Answers | None, counting: str, c: int, lacking: str = "not asked"
    ) -> Cells:
        if answers is None:
            return Cells.absent(lacking)
        return minus(self.of(answers.flipped, counting, c), self.of(answers.factual, counting, c))

    def recorded(self, counting: str, c: int) -> Cells:
        return self.of(Rollouts.from_demonstrations(self.demos), counting, c)

    def of(self, rollouts: Rollouts, counting: str, c: int) -> Cells:
        """The metric by seed and start, of starts of condition ``c``."""
        starts = self.demos.condition == c
        counts = starts[rollouts.demo] & (rollouts.captured | (counting == "all"))
        values = PATH_LENGTH.measure(Prepared(self.demos).episodes(rollouts))
        whole = statistics.cells(
            values, rollouts.seed, rollouts.demo, self.demos.num_episodes, counts
        )
        return Cells(whole.sums[:, starts], whole.counts[:, starts])

    def row(
        self, method: str, quantity: str, of: int, told: int, counting: str, data: Cells,
        main: bool = True, value: Interval | None = None,
    ) -> dict[str, Any]:  # fmt: skip
        seeds, starts = len(data.sums), int(data.starts.sum())
        value = value or statistics.bootstrap_mean(data, self.draws)
        speaks_of = "this network only" if seeds == 1 else "networks trained in this way"
        if method == RECORDED or (quantity == TRUE and self.teams is not None):
            seeds, speaks_of = 0, RECORDED if method == RECORDED else "the teams"
        return statistics.row_of(
            value, method=method,
            variant="" if method == RECORDED else "main" if main else "supplementary",
            quantity=quantity, condition=of, told=told, planned=(of, told) == self.planned,
            counting=counting, seeds=seeds, demos=starts, covers=speaks_of,
        )  # fmt: skip


def minus(first: Cells, second: Cells) -> Cells:
    """Difference of the means of every seed and start, where both have one; each counts once.

    ``second`` may have a single row, for all seeds. If either is absent, so is the difference.
    """
    if gone := [one for one in (first, second) if not one.sums.size]:
        return gone[0]
    return statistics.single_cells(first.cell_means - second.cell_means)


def objection_to_claim(
    shift: Cells,
    untrained: Cells,
    rng: np.random.Generator | Draws,
    resamples: int = RESAMPLES,
) -> str:
    """Why a shift by seed and start is not worded as an effect; empty where it may be."""
    from scipy.stats import ttest_1samp

    seeds = len(shift.sums)
    if seeds < FEWEST_SEEDS:
        return f"{seeds} training seed{'s' * (seeds != 1)}: give at least {FEWEST_SEEDS}"
    if len(untrained.sums) < FEWEST_SEEDS:
        return "there are too few untrained networks to tell it apart from"
    if not ttest_1samp(shift.seed_means, 0.0).pvalue < 1 - CONFIDENCE:
        return "the training seeds do not agree"
    if not statistics.bootstrap_mean(shift, rng, resamples).excludes_zero:
        return "the interval includes zero"
    if not statistics.bootstrap_difference(shift, untrained, rng, resamples).excludes_zero:
        return "it is not told apart from that of untrained networks"
    return ""
