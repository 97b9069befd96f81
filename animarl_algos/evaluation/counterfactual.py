"""Counterfactual path lengths: what changes when a policy is told the other condition.

Flipping the cue changes what the policy is told and never the world. Rollouts in a changed world
(the condition of the world differs from that of the demonstration) are told apart here: they are
the truth that a flipped cue tries to predict.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from animarl_algos.evaluation.comparison import COUNTING
from animarl_algos.evaluation.metrics import PATH_LENGTH
from animarl_algos.evaluation.rollouts import NO_CUE, RECORDED
from animarl_algos.evaluation.statistics import (
    RESAMPLES,
    Floats,
    Interval,
    cells,
    draw_weights,
    percentile_interval,
    resampled_means,
)

if TYPE_CHECKING:
    import pandas as pd

MEAN = "mean"
ERROR = "absolute error"
DIFFERENCE = "condition 0 - condition 1"
SHIFT = "cue shift"
WORLD_SHIFT = "world shift"


@dataclass(frozen=True, eq=False)
class Resampled:
    """An estimate and its values on all resamples, so that differences stay paired."""

    estimate: float
    values: Floats

    def __sub__(self, other: Resampled) -> Resampled:
        return Resampled(self.estimate - other.estimate, self.values - other.values)

    def __abs__(self) -> Resampled:
        return Resampled(abs(self.estimate), np.abs(self.values))

    @property
    def interval(self) -> Interval:
        return percentile_interval(self.estimate, self.values)


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
    ``value_low`` and ``value_high``:

    - ``mean``: of the metric, factual, with flipped cue, or in the changed world;
    - ``absolute error``: of the factual mean to the recorded mean of the same condition;
    - ``condition 0 - condition 1``: difference of the factual means;
    - ``cue shift``: mean with the cue flipped minus the factual mean, on the same demonstrations
      and seeds; ``planned`` marks the planned one;
    - ``world shift``: mean in the changed world, told so, minus the factual mean.

    Notes
    -----
    Demonstrations are resampled within their condition. The answers of one network to two cues
    share their resample of demonstrations and of seeds. An absolute error is never negative, so
    its interval cannot include zero: compare it between methods.
    """
    import pandas as pd

    condition = np.asarray(demo_condition)
    weights = _stratified(condition, rng, resamples)
    names = [RECORDED, *(str(m) for m in metrics["method"].unique() if m != RECORDED)]
    seeds = {
        name: draw_weights(rng, metrics.loc[metrics["method"] == name, "seed"].nunique(), resamples)
        for name in names
    }
    table: list[dict[str, Any]] = []
    for counting in COUNTING:
        truth: dict[Question, Resampled] = {}
        for name in names:
            rows = metrics[metrics["method"] == name]
            answers = _answers(rows, condition, metric, counting, seeds[name], weights)
            truth = truth or answers
            for quantity, of, world, cue, value in _quantities(answers, truth, name == RECORDED):
                interval = value.interval
                table.append(
                    {
                        "method": name,
                        "quantity": quantity,
                        "condition": of,
                        "world": world,
                        "cue": cue,
                        "counting": counting,
                        "planned": quantity == SHIFT and (of, cue) == planned,
                        "value": interval.estimate,
                        "value_low": interval.low,
                        "value_high": interval.high,
                    }
                )
    return pd.DataFrame(table)


def has_flips(metrics: pd.DataFrame) -> bool:
    """Whether any policy was told another condition than the world's."""
    told = metrics["cue"] != NO_CUE
    return bool((told & (metrics["cue"] != metrics["condition"])).any())


def _stratified(
    condition: NDArray[np.integer], rng: np.random.Generator, resamples: int
) -> dict[int, Floats]:
    """Weights of the demonstrations of each condition; the others weigh nothing."""
    weights = {}
    for c in np.unique(condition).tolist():
        chosen = condition == c
        weights[c] = np.zeros((resamples, len(condition)))
        weights[c][:, chosen] = draw_weights(rng, int(chosen.sum()), resamples)
    return weights


def _answers(
    rows: pd.DataFrame,
    condition: NDArray[np.integer],
    metric: str,
    counting: str,
    seeds: Floats,
    weights: dict[int, Floats],
) -> dict[Question, Resampled]:
    """Mean of the metric for every question the rows hold; a missing cue counts as factual."""
    world = rows["condition"].to_numpy()
    cue = np.where(rows["cue"] == NO_CUE, world, rows["cue"])
    demo = rows["demo"].to_numpy()
    counts = rows["captured"].to_numpy() | (counting == "all")
    answers = {}
    asked = np.unique(np.stack([condition[demo], world, cue], axis=1), axis=0)
    for of, around, told in asked.tolist():
        chosen = counts & (condition[demo] == of) & (world == around) & (cue == told)
        data = cells(rows[metric], rows["seed"], demo, len(condition), chosen)
        answers[of, around, told] = Resampled(data.mean, resampled_means(data, seeds, weights[of]))
    return answers


def _quantities(
    answers: dict[Question, Resampled], truth: dict[Question, Resampled], recorded: bool
) -> Iterator[tuple[str, int, int, int, Resampled]]:
    """Everything that is reported of one method: quantity, condition, world, cue, value."""
    for (of, around, told), value in answers.items():
        yield MEAN, of, around, told, value
    for c in (0, 1):
        if (c, c, c) not in answers:
            continue
        actual = answers[c, c, c]
        if not recorded and (c, c, c) in truth:
            yield ERROR, c, c, c, abs(actual - truth[c, c, c])
        if (c, c, 1 - c) in answers:
            yield SHIFT, c, c, 1 - c, answers[c, c, 1 - c] - actual
        if (c, 1 - c, 1 - c) in answers:
            yield WORLD_SHIFT, c, 1 - c, 1 - c, answers[c, 1 - c, 1 - c] - actual
    if (0, 0, 0) in answers and (1, 1, 1) in answers:
        yield DIFFERENCE, 0, 0, 0, answers[0, 0, 0] - answers[1, 1, 1]
