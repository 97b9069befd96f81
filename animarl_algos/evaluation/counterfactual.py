"""Counterfactual path lengths: what changes when a policy is told the other condition.

Flipping the cue changes what the policy is told and never the world. Rollouts in a changed world
(the condition of the world differs from that of the demonstration) are told apart here: they are
the truth that a flipped cue tries to predict.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from animarl_algos.evaluation.cells import Cells, cells
from animarl_algos.evaluation.comparison import COUNTING, OF_RECORDINGS, put_interval
from animarl_algos.evaluation.metrics import PATH_LENGTH
from animarl_algos.evaluation.rollouts import NO_CUE, RECORDED
from animarl_algos.evaluation.statistics import (
    RESAMPLES,
    Draws,
    Interval,
    bootstrap_difference,
    bootstrap_mean,
    covers,
)

if TYPE_CHECKING:
    import pandas as pd

MEAN = "mean"
ERROR = "absolute error"
DIFFERENCE = "condition 0 - condition 1"
SHIFT = "cue shift"
WORLD_SHIFT = "world shift"


Question = tuple[int, int, int]
"""Condition of the demonstration, condition of the world, cue told to the policy."""


def counterfactual_table(
    metrics: pd.DataFrame,
    demo_condition: ArrayLike,
    rng: np.random.Generator,
    *,
    planned: tuple[int, int] | None = None,
    metric: str = PATH_LENGTH.key,
    resamples: int = RESAMPLES,
) -> pd.DataFrame:
    """Means, errors and shifts per condition, with 95 % intervals.

    Parameters
    ----------
    metrics
        Rows of :func:`~animarl_algos.evaluation.metrics.measure`, the recordings among them;
        of every method that is asked both the factual and the flipped cue.
    demo_condition
        ``(demos,)``, condition of each evaluated demonstration.
    planned
        The flip ``(from, to)`` that was planned in advance, as in the paper: agents individual to
        shared ``(0, 1)``, silkmoth blocked to full ``(1, 0)``.

    Returns
    -------
    One row per method, counting rule and ``quantity``; ``condition`` is that of the demonstrations,
    ``world`` that of the simulation, ``cue`` what the policy was told, and ``value`` comes with
    ``value_low`` and ``value_high``; ``covers`` says what the interval speaks of, ``reason`` why
    there is none:

    - ``mean``: of the metric, factual, with flipped cue, or in the changed world;
    - ``absolute error``: of the factual mean to the recorded mean of the same condition;
    - ``condition 0 - condition 1``: difference of the factual means;
    - ``cue shift``: mean with the cue flipped minus the factual mean, on the same demonstrations
      and seeds; ``planned`` marks the planned one;
    - ``world shift``: mean in the changed world, told so, minus the factual mean.

    Notes
    -----
    The answers of one network to two cues are subtracted start by start, so what the network and
    the start add cancels; of episodes that reached the target, only starts that both answers have
    count. The conditions have demonstrations of their own: their difference is not paired. An
    absolute error is never negative, so its interval cannot exclude zero from below: compare it
    between methods.
    """
    import pandas as pd

    condition = np.asarray(demo_condition)
    draws = Draws.by(rng, resamples)
    names = [RECORDED, *(str(m) for m in metrics["method"].unique() if m != RECORDED)]
    table: list[dict[str, Any]] = []
    for counting in COUNTING:
        truth: dict[Question, Cells] = {}
        for name in names:
            rows = metrics[metrics["method"] == name]
            answers = _answers(rows, condition, metric, counting)
            truth = truth or answers
            recorded = name == RECORDED
            for quantity, of, world, cue, value in _quantities(answers, truth, recorded, draws):
                row: dict[str, Any] = {
                    "method": name,
                    "quantity": quantity,
                    "condition": of,
                    "world": world,
                    "cue": cue,
                    "counting": counting,
                    "planned": quantity == SHIFT and (of, cue) == planned,
                    "covers": OF_RECORDINGS if recorded else covers(answers[of, world, cue]),
                    "reason": "",
                }
                put_interval(row, "value", value)
                table.append(row)
    return pd.DataFrame(table)


def has_flips(metrics: pd.DataFrame) -> bool:
    """Whether any policy was told another condition than the world's."""
    told = metrics["cue"] != NO_CUE
    return bool((told & (metrics["cue"] != metrics["condition"])).any())


def _answers(
    rows: pd.DataFrame, condition: NDArray[np.integer], metric: str, counting: str
) -> dict[Question, Cells]:
    """The metric for every question the rows hold; a missing cue counts as factual."""
    world = rows["condition"].to_numpy()
    cue = np.where(rows["cue"] == NO_CUE, world, rows["cue"])
    demo = rows["demo"].to_numpy()
    counts = rows["captured"].to_numpy() | (counting == "all")
    answers = {}
    asked = np.unique(np.stack([condition[demo], world, cue], axis=1), axis=0)
    for of, around, told in asked.tolist():
        chosen = counts & (condition[demo] == of) & (world == around) & (cue == told)
        answers[of, around, told] = cells(rows[metric], rows["seed"], demo, len(condition), chosen)
    return answers


def _quantities(
    answers: dict[Question, Cells], truth: dict[Question, Cells], recorded: bool, draws: Draws
) -> Iterator[tuple[str, int, int, int, Interval]]:
    """Everything that is reported of one method: quantity, condition, world, cue, value."""

    def minus(answer: Cells, actual: Cells) -> Interval:
        return bootstrap_difference(answer, actual, draws, same_seeds=True)

    for (of, around, told), value in answers.items():
        yield MEAN, of, around, told, bootstrap_mean(value, draws)
    for c in (0, 1):
        if (c, c, c) not in answers:
            continue
        actual = answers[c, c, c]
        if not recorded and (c, c, c) in truth:
            yield ERROR, c, c, c, _size(bootstrap_difference(actual, truth[c, c, c], draws))
        if (c, c, 1 - c) in answers:
            yield SHIFT, c, c, 1 - c, minus(answers[c, c, 1 - c], actual)
        if (c, 1 - c, 1 - c) in answers:
            yield WORLD_SHIFT, c, 1 - c, 1 - c, minus(answers[c, 1 - c, 1 - c], actual)
    if (0, 0, 0) in answers and (1, 1, 1) in answers:
        yield (
            DIFFERENCE,
            0,
            0,
            0,
            bootstrap_difference(
                answers[0, 0, 0], answers[1, 1, 1], draws, same_seeds=True, same_demos=False
            ),
        )


def _size(value: Interval) -> Interval:
    """Of a difference regardless of its sign."""
    ends = abs(value.low), abs(value.high)
    low = 0.0 if value.low <= 0 <= value.high else min(ends)
    return Interval(abs(value.estimate), low, max(ends), value.reason)
