"""When a shift may be put into words, as an effect that networks learned.

An untrained network answers to its flag as to any other input, so the answers of one network, or of
two, always differ somehow: over its starts alone such a shift excludes zero as often as not. A
claim therefore speaks of training seeds. It is worded only if there are at least three, their mean
shift excludes zero over seeds and over starts, and it is told apart from that of networks that
learned nothing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from animarl_algos.evaluation.statistics import (
    CONFIDENCE,
    RESAMPLES,
    Cells,
    Interval,
    bootstrap_difference,
    bootstrap_mean,
)

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
