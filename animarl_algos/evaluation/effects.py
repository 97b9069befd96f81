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

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import permutations
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from animarl_algos.evaluation import statistics
from animarl_algos.evaluation.comparison import COUNTING
from animarl_algos.evaluation.metrics import DURATION, PATH_LENGTH, measure, measure_recordings
from animarl_algos.evaluation.rollouts import RECORDED, Rollouts
from animarl_algos.evaluation.statistics import CONFIDENCE, RESAMPLES, Cells, Draws, Interval
from animarl_envs.demos.demonstrations import Demonstrations

MEAN, MEAN_FLIPPED = "mean", "mean, cue flipped"
ERROR, PREDICTED, TRUE = "signed error", "predicted shift", "true shift"
MISSED, UNTRAINED_SHIFT, BLIND = "predicted - true", "untrained shift", "flag zeroed"
ACCURACY, ERROR_DIFFERENCE = "treatment accuracy", "difference of signed errors"

# What an episode answers: a policy that was told the true condition, or the other one (of untrained
# networks and with the flag zeroed, a word goes before); in the other world; a team.
FACTUAL, FLIPPED, UNTRAINED, ZEROED = "factual", "flipped", "untrained, ", f"{BLIND}, "
WORLD, TEAM = "other world", "truth"
NO_TRUTH = "no truth is known for these demonstrations: give --truth"
FEWEST_SEEDS = 3
NOT_PLANNED = "this flip was not planned in advance, by the option planned_flip of the world"


@dataclass(frozen=True, eq=False)
class Effects:
    """``table`` one row per quantity, ``claims`` one row per method and flip.

    The columns ``condition`` and ``told`` are those of the starts and of the policy; ``value`` has
    a 95 % interval; ``seeds`` and ``demos`` count, and ``reason`` says why there is no value or
    claim.
    """

    table: pd.DataFrame
    claims: pd.DataFrame


def measured_answers(
    demos: Demonstrations, answers: Mapping[tuple[str, str], Rollouts]
) -> pd.DataFrame:
    """Return a row per recording and rollout, measured; ``answers`` are by method and answer."""
    parts = [measure_recordings(demos).assign(answer=RECORDED)]
    for (method, answer), rollouts in answers.items():
        parts.append(measure(rollouts, demos).assign(method=method, answer=answer))
    return pd.concat(parts, ignore_index=True)


def cue_effects(
    episodes: pd.DataFrame,
    main: Mapping[str, bool],
    *,
    teams: Sequence[str] = (),
    accuracy: Mapping[str, Sequence[float]] = {},
    planned: tuple[int, int] | None = None,
    resamples: int = RESAMPLES,
) -> Effects:
    """Shifts of path length with their truth and their nulls, errors and their differences.

    Parameters
    ----------
    episodes
        Of :func:`measured_answers`.
    main
        The methods, and whether each is a variant of the main comparison.
    teams
        As which methods the teams of condition 0 and of condition 1 are in the table.
    accuracy
        By method, the balanced accuracy of the treatment head on held-out demonstrations, one per
        training seed.
    planned
        The flip ``(from, to)`` that was planned in advance; only of it a claim may be worded.
    """
    draws, rows, claims = Draws(0, resamples), list[dict[str, Any]](), list[dict[str, Any]]()
    conditions = episodes.loc[episodes["answer"] == RECORDED, "condition"].to_numpy()
    places = [
        (counting, c, _cells(episodes, conditions == c, counting))
        for counting in COUNTING
        for c in np.unique(conditions).tolist()
    ]

    def add(
        method: str, quantity: str, of: int, told: int, counting: str, data: Cells,
        value: Interval | None = None,
    ) -> None:  # fmt: skip
        seeds, starts = len(data.sums), int(data.starts.sum())
        value = value or statistics.bootstrap_mean(data, draws)
        speaks_of = "this network only" if seeds == 1 else "networks trained in this way"
        variant = "main" if main.get(method.partition(" - ")[0]) else "supplementary"
        if method == RECORDED or (quantity == TRUE and teams):
            seeds, speaks_of = 0, RECORDED if method == RECORDED else "the teams"
        rows.append(
            statistics.row_of(
                value, method=method, variant="" if method == RECORDED else variant,
                quantity=quantity, condition=of, told=told, planned=(of, told) == planned,
                counting=counting, seeds=seeds, demos=starts, covers=speaks_of,
            )
        )  # fmt: skip

    for counting, c, at in places:
        add(RECORDED, MEAN, c, c, counting, at[RECORDED, RECORDED])
    for name in main:
        for counting, c, at in places:
            found = _quantities(name, at, [teams[k] for k in (c, 1 - c)] if teams else ())
            if _repeats_itself(episodes, name):
                same = "it acts without chance: asked twice, it does the same"
                found[BLIND] = Cells.absent(same)
            for quantity, data in found.items():
                add(name, quantity, c, c if quantity in (MEAN, ERROR) else 1 - c, counting, data)
            if counting != "all":  # what counts among captures depends on what is asked
                continue
            against = "; ".join(filter(None, [lacking_seeds(found[PREDICTED]), NOT_PLANNED]))
            if (c, 1 - c) == planned:
                against = objection_to_claim(found[PREDICTED], found[UNTRAINED_SHIFT], draws)
            claims.append(
                {"method": name, "condition": c, "told": 1 - c, "worded": not against,
                 "reason": against}
            )  # fmt: skip
        data, mean = Cells.absent("it has no treatment head"), None
        if accuracy.get(name):
            data = statistics.single_cells(np.array(accuracy[name])[:, None])
            mean = Interval(data.mean, reason="no interval")
        add(name, ACCURACY, -1, -1, "all", data, mean)
    for first, second in permutations(main, 2):
        if second == first.replace("CIL", "DIL"):
            for counting, c, at in places:
                mine, other = (_quantities(name, at)[ERROR] for name in (first, second))
                value = statistics.bootstrap_difference(mine, other, draws)
                add(f"{first} - {second}", ERROR_DIFFERENCE, c, c, counting, mine, value)
    return Effects(pd.DataFrame(rows), pd.DataFrame(claims))


def _cells(
    episodes: pd.DataFrame, starts: NDArray[np.bool_], counting: str
) -> dict[tuple[str, str], Cells]:
    """Return path lengths by seed and start, of some of the starts, by method and answer."""
    counts = starts[episodes["demo"]] & (episodes["captured"] | (counting == "all"))
    found = {}
    for (method, answer), rows in episodes.assign(counts=counts).groupby(["method", "answer"]):
        whole = statistics.cells(
            rows[PATH_LENGTH.key], rows["seed"], rows["demo"], len(starts), rows["counts"]
        )
        found[str(method), str(answer)] = Cells(whole.sums[:, starts], whole.counts[:, starts])
    return found


def _quantities(
    name: str, at: Mapping[tuple[str, str], Cells], teams: Sequence[str] = ()
) -> dict[str, Cells]:
    """Return every quantity of a method at some starts; ``teams`` are theirs and the other one."""

    def shift(kind: str) -> Cells:
        lacking = Cells.absent("not asked")
        before, after = (at.get((name, kind + one), lacking) for one in (FACTUAL, FLIPPED))
        return minus(after, before)

    factual, predicted = at[name, FACTUAL], shift("")
    if teams:
        true = minus(at[teams[1], TEAM], at[teams[0], TEAM])
    else:
        true = minus(at.get((name, WORLD), Cells.absent(NO_TRUTH)), factual)
    return {
        MEAN: factual,
        MEAN_FLIPPED: at[name, FLIPPED],
        ERROR: minus(factual, at[RECORDED, RECORDED]),
        PREDICTED: predicted,
        TRUE: true,
        MISSED: minus(predicted, true),
        UNTRAINED_SHIFT: shift(UNTRAINED),
        BLIND: shift(ZEROED),
    }


def _repeats_itself(episodes: pd.DataFrame, name: str) -> bool:
    """Return whether a method did the same twice with the flag zeroed."""
    own = episodes[episodes["method"] == name].set_index("answer")
    asked = [own[own.index == ZEROED + one] for one in (FACTUAL, FLIPPED)]
    once, again = (one[[PATH_LENGTH.key, DURATION.key]] for one in asked)
    return len(once) > 0 and np.array_equal(once, again)


def minus(first: Cells, second: Cells) -> Cells:
    """Difference of the means of every seed and start, where both have one; each counts once.

    ``second`` may have a single row, for all seeds. If either is absent, so is the difference.
    """
    if gone := [one for one in (first, second) if not one.sums.size]:
        return gone[0]
    return statistics.single_cells(first.cell_means - second.cell_means)


def lacking_seeds(shift: Cells) -> str:
    """Return that a shift has too few training seeds; empty where it has enough."""
    seeds = len(shift.sums)
    if seeds >= FEWEST_SEEDS:
        return ""
    return f"{seeds} training seed{'s' * (seeds != 1)}: give at least {FEWEST_SEEDS}"


def objection_to_claim(
    shift: Cells,
    untrained: Cells,
    rng: np.random.Generator | Draws,
    resamples: int = RESAMPLES,
) -> str:
    """Why a shift by seed and start is not worded as an effect; empty where it may be."""
    from scipy.stats import ttest_1samp

    if few := lacking_seeds(shift):
        return few
    if len(untrained.sums) < FEWEST_SEEDS:
        return "there are too few untrained networks to tell it apart from"
    if not ttest_1samp(shift.seed_means, 0.0).pvalue < 1 - CONFIDENCE:
        return "the training seeds do not agree"
    if not statistics.bootstrap_mean(shift, rng, resamples).excludes_zero:
        return "the interval includes zero"
    if not statistics.bootstrap_difference(shift, untrained, rng, resamples).excludes_zero:
        return "it is not told apart from that of untrained networks"
    return ""
