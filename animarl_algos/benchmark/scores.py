"""What is measured of a method: value, interval and null of every measure, and its rank.

A method is better than another where the 95 % interval of the difference of their energy scores,
over demonstrations and seeds, lies below zero. Its rank is then a range: from one more than the
number of methods that are better, to the number of all less those that are worse. Nothing corrects
the pairs for their number.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from animarl_algos.benchmark.methods import RECORDINGS, beside_fold, others_as_rollouts
from animarl_algos.evaluation.classifier import AUC, SEQUENCE
from animarl_algos.evaluation.metrics import DTW_PER_STEP, METRICS, Metric
from animarl_algos.evaluation.prepared import Prepared, censored
from animarl_algos.evaluation.realism import OTHERS
from animarl_algos.evaluation.rollouts import Rollouts
from animarl_algos.evaluation.statistics import (
    FEW_ROLLOUTS,
    Draws,
    Interval,
    bootstrap_difference,
    bootstrap_mean,
    cells,
    covers,
    energy_cells,
    interval,
    pooled_score,
    row_of,
    single_cells,
)
from animarl_algos.evaluation.verdict import summary_table, verdict
from animarl_algos.evaluation.verdict_rows import OUTCOMES, SAME
from animarl_algos.evaluation.windows import comparison_smoothing
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.splits import learnable

Floats = NDArray[np.float64]

SEED = 0  # of all resampling
REALISM, ENERGY = "realism", "energy"
UNRANKED = ("recordings", "tracking")
"""References that were told where the recordings go."""
ROUNDING = 1e-9
"""Differences of energy scores up to it are those of sums in another order, and rank nothing."""


def differences() -> list[Metric]:
    """Return the metrics whose difference to the recordings stands on the board."""
    return [one for one in METRICS if one.judged and one.of_recordings and one.on_board]


def labels() -> dict[str, str]:
    """Return the measures in their order, what a simulator is judged by first, with their names."""
    return {
        REALISM: "realism",
        AUC: "classifier AUC",
        SEQUENCE: "AUC of order in time",
        ENERGY: "energy score",
        OUTCOMES: "endings (chi-squared)",
        **{one.key: one.label[:1].lower() + one.label[1:] for one in differences()},
        DTW_PER_STEP.key: "DTW per step",
    }


@dataclass(frozen=True, eq=False, kw_only=True)
class Score:
    """A method on one set of demonstrations.

    Parameters
    ----------
    covers, words
        What intervals speak of, and the verdict.
    measures
        One row per measure: ``unit``, ``value`` with its interval ``low`` to ``high``, and the
        ``reason`` why there is none. Differences, endings and areas are those of the rows of the
        verdict, with their ``null`` and ``p``; ``inside`` says that such a row finds nothing, of
        other measures that they are as good as the ``null``: recordings of other starts.
    energies
        ``(seeds, starts)``: the joint energy score, NaN for none.
    """

    data: str = ""
    kind: str = ""
    method: str
    seeds: tuple[int, ...]
    starts: int
    rollouts: int
    covers: str = ""
    words: str = ""
    measures: pd.DataFrame
    energies: Floats

    def of(self, measure: str) -> Any:
        """Return the row of one measure."""
        return self.measures.loc[measure]

    def to_json(self) -> dict[str, Any]:
        """Return it as plain values; NaN stays NaN."""
        table = self.measures.reset_index().to_dict("records")
        return vars(self) | {"measures": table, "energies": self.energies.tolist()}

    @classmethod
    def from_json(cls, plain: Mapping[str, Any]) -> Score:
        """Return what :meth:`to_json` wrote."""
        measures = pd.DataFrame(plain["measures"]).set_index("measure")
        energies, seeds = np.array(plain["energies"], dtype=np.float64), tuple(plain["seeds"])
        return cls(**{**plain, "measures": measures, "energies": energies, "seeds": seeds})


def score(rollouts: Rollouts, demos: Demonstrations, *, resamples: int) -> Score:
    """Measure rollouts from the test starts of ``demos`` against the recordings.

    ``rollouts`` are of one method and all its seeds, ``rollouts.demo`` counts the test episodes;
    recordings of the other splits are what recordings are compared with.
    """
    test, others = demos.select(split="test"), learnable(demos)
    return _score(rollouts, test, others_as_rollouts(others, test, SEED), others, resamples)


def crossed_score(
    folds: Sequence[tuple[Demonstrations, Rollouts]], method: str, *, resamples: int
) -> Score:
    """Measure rollouts from the test starts of all folds against the recordings, as one set.

    ``folds`` are, for every fold and seed, the demonstrations as this fold splits them, and the
    rollouts.
    """
    made, beside = [], {}
    for demos, rollouts in folds:
        tested = np.flatnonzero(demos.split == "test")
        made.append(replace(rollouts, demo=tested[rollouts.demo]))
        if int(tested[0]) not in beside:
            others = others_as_rollouts(beside_fold(demos), demos.select(split="test"), SEED)
            beside[int(tested[0])] = replace(others, demo=tested[others.demo])
    joined = Rollouts.concatenate(made, method)
    return _score(joined, folds[0][0], Rollouts.concatenate([*beside.values()]), None, resamples)


def _score(
    rollouts: Rollouts,
    test: Demonstrations,
    beside: Rollouts,
    others: Demonstrations | None,
    resamples: int,
) -> Score:
    """Against the recordings ``test``; ``beside``: others, each as if it began at a test start."""
    rng_verdict, rng_draws = np.random.default_rng(SEED).spawn(2)
    found = verdict(test, rollouts, seed=int(rng_verdict.integers(2**31)), references=others)
    prepared = Prepared(test, comparison_smoothing(test))
    counted = censored(rollouts.factual(test), test)
    draws = Draws.by(rng_draws, resamples)
    rows: dict[str, dict[str, Any]] = {}

    def put(
        key: str, value: Interval, null: float, inside: bool, unit: str = "", p: float = math.nan
    ) -> None:
        rows[key] = row_of(value, measure=key, unit=unit, null=null, p=p, inside=inside)

    for _, row in found.table.iterrows():
        value, same = interval(row), bool(row["judgement"] == SAME)
        # Over all folds each recording stands on one side itself and on the other as another's: a
        # classifier would learn to call it by the side on which it met it.
        if row["measure"] in found.areas and others is None and rollouts.method == RECORDINGS:
            value, same = found.areas[row["measure"]]["among"], True
        put(row["measure"], value, row["null"], same, row["unit"], row["p"])
    others_score = found.realism_beside.get(OTHERS, math.nan)
    put(REALISM, found.realism, others_score, found.realism.estimate >= others_score)
    drawn, true = (
        summary_table(prepared, side) for side in (prepared.filtered(counted), prepared.recorded)
    )
    energies = energy_cells(drawn, counted.seed, counted.demo, true)
    energy, pooled = Interval(math.nan, reason=FEW_ROLLOUTS), pooled_score(true)
    if energies.counts.any():
        energy = bootstrap_mean(energies, draws)
    put(ENERGY, energy, pooled, energy.estimate <= pooled, "recorded SD")
    own, other = (DTW_PER_STEP.measure(prepared.episodes(side)) for side in (counted, beside))
    data, null = cells(own, counted.seed, counted.demo, len(test)), float(other.mean())
    dtw = bootstrap_mean(data, draws)
    put(DTW_PER_STEP.key, dtw, null, dtw.estimate <= null, DTW_PER_STEP.unit)
    return Score(
        method=rollouts.method,
        seeds=tuple(np.unique(counted.seed).tolist()),
        starts=len(np.unique(counted.demo)),
        rollouts=len(counted),
        covers=covers(data),
        words=found.overall,
        measures=pd.DataFrame([rows[key] for key in labels() if key in rows]).set_index("measure"),
        energies=energies.cell_means,
    )


def ranked(scores: Sequence[Score], resamples: int) -> dict[str, str]:
    """Return the places that intervals allow a method of one set, such as 2-4, where it has any."""
    energies = {
        one.method: single_cells(one.energies)
        for one in scores
        if one.method not in UNRANKED and np.isfinite(one.energies).any()
    }
    better, worse = dict.fromkeys(energies, 0), dict.fromkeys(energies, 0)
    names = list(energies)
    for i, first in enumerate(names):
        for second in names[i + 1 :]:
            gap = bootstrap_difference(
                energies[first], energies[second], np.random.default_rng(SEED), resamples
            )
            if gap.excludes_zero and abs(gap.estimate) > ROUNDING:
                winner, loser = (first, second) if gap.high < 0 else (second, first)
                better[loser] += 1
                worse[winner] += 1
    places = {name: (1 + better[name], len(names) - worse[name]) for name in names}
    return {
        name: f"{best}" if best == worst else f"{best}\u2013{worst}"
        for name, (best, worst) in places.items()
    }
