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
from animarl_algos.evaluation.distances import (
    FEW_ROLLOUTS,
    bootstrap_distances,
    energy_score,
    pooled_score,
)
from animarl_algos.evaluation.exchange_test import Exchanges
from animarl_algos.evaluation.metrics import (
    ARENA_UNITS,
    METRICS,
    Metric,
    dtw_alignments,
)
from animarl_algos.evaluation.prepared import Prepared, censored, factual
from animarl_algos.evaluation.realism import OTHERS
from animarl_algos.evaluation.rollouts import Rollouts
from animarl_algos.evaluation.statistics import (
    Draws,
    Interval,
    bootstrap_difference,
    bootstrap_mean,
    cells,
    covers,
    single_cells,
)
from animarl_algos.evaluation.verdict import SUMMARY, verdict
from animarl_algos.evaluation.windows import comparison_smoothing
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.splits import learnable
from animarl_envs.dtw import dtw_alignment
from animarl_envs.species import SPECIES

Floats = NDArray[np.float64]

SEED = 0  # of all resampling
REALISM, ENERGY = "realism", "energy"
DISTRIBUTIONS = ("duration", "path_length")
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
        "energy_duration": "energy score of duration",
        "energy_path_length": "energy score of path length",
        "energy_mean_speed": "energy score of speed",
        "outcomes": "endings (chi-squared)",
        **{one.key: one.label[:1].lower() + one.label[1:] for one in differences()},
        "dtw_per_step": "DTW per step",
        "dtw_first_second": "DTW per step, first second",
        "kde_duration": "KDE distance of durations",
        "kde_path_length": "KDE distance of path lengths",
    }


@dataclass(frozen=True, eq=False, kw_only=True)
class Score:
    """A method on one set of demonstrations.

    Parameters
    ----------
    covers, words
        What intervals speak of, and the verdict.
    measures
        One row per measure: ``unit``, ``value`` with its interval ``low`` to ``high`` over
        demonstrations and seeds, and the ``reason`` why there is none. ``null`` is what chance
        alone stays below in 95 % of cases (``p``), or what recordings of other starts come to.
        ``inside``: it is no larger than its null (realism: no smaller); an AUC of one half always
        is. NaN is what is not defined.
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

    Parameters
    ----------
    rollouts
        Of one method and all its seeds; ``rollouts.demo`` counts the test episodes.
    demos
        All splits: recordings of train and val are what recordings are compared with.
    resamples
        Of the intervals.
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
    rng_verdict, rng_draws, rng_null, rng_kde = np.random.default_rng(SEED).spawn(4)
    found = verdict(test, rollouts, seed=int(rng_verdict.integers(2**31)), references=others)
    prepared = Prepared(test, comparison_smoothing(test))
    counted = censored(factual(rollouts, test), test)
    simulated, recorded = (
        prepared.measures(side) for side in (prepared.filtered(counted), prepared.recorded)
    )
    draws = Draws.by(rng_draws, resamples)
    starts, number = np.arange(len(test)), len(test)
    rows: dict[str, dict[str, Any]] = {}

    def put(
        key: str, value: Interval, null: float, *, unit: str = "", p: float = math.nan, of: str = ""
    ) -> None:
        inside = abs(value.estimate) <= (max(null, 0.5) if key in (AUC, SEQUENCE) else null)
        rows[key] = {
            "measure": key, "unit": unit, "value": value.estimate, "low": value.low,
            "high": value.high, "null": null, "p": p, "reason": of or value.reason,
            "inside": bool(value.estimate >= null if key == REALISM else inside),
        }  # fmt: skip

    put(REALISM, found.realism, found.realism_beside.get(OTHERS, math.nan))
    for judge, own in ((AUC, found.auc), (SEQUENCE, found.sequence)):
        among = found.areas[judge]["among"]
        # Over all folds each recording stands on one side itself and on the other as another's: a
        # classifier would learn to call it by the side on which it met it.
        same = others is None and rollouts.method == RECORDINGS
        put(judge, among if same else own, among.high)
    energies = {}
    for name, keys in {ENERGY: SUMMARY, **{f"energy_{key}": (key,) for key in SUMMARY}}.items():
        spread = [float(np.std(recorded[k])) or 1.0 for k in keys]
        drawn, true = (
            np.stack([side[k] / s for k, s in zip(keys, spread)], axis=1)
            for side in (simulated, recorded)
        )
        energies[name] = start_energies(drawn, counted.seed, counted.demo, true)
        mean = Interval(math.nan, reason=FEW_ROLLOUTS)
        if np.isfinite(energies[name]).any():
            mean = bootstrap_mean(single_cells(energies[name]), draws)
        put(name, mean, pooled_score(true), unit="recorded SD")
    if "outcomes" in set(found.table["measure"]):  # something may end
        row = found.row("outcomes")
        ends = Interval(row["distance"], reason="a test: no interval")
        put("outcomes", ends, row["null"], p=row["p"])
    for key, measured in (("dtw_per_step", dtw_per_step), ("dtw_first_second", first_second)):
        data = cells(measured(counted, test), counted.seed, counted.demo, number)
        other = float(np.nanmean(measured(beside, test)))
        put(key, bootstrap_mean(data, draws), other, unit="arena unit")
    exchanges = Exchanges.draw(counted.demo, number, rng_null, resamples, copies=counted.copies)
    for metric in differences():
        if metric.key not in simulated:
            continue
        many, one = simulated[metric.key], recorded[metric.key]
        gap = bootstrap_difference(
            cells(many, counted.seed, counted.demo, number),
            cells(one, np.full(number, -1), starts, number),
            draws,
            share=metric.share,
        )
        tested = exchanges.difference(np.concatenate([one, many]))
        unit = metric.unit.replace(ARENA_UNITS, prepared.unit.name)
        put(metric.key, gap, tested.null, unit=unit, p=tested.p)
    for key in DISTRIBUTIONS:
        kde, _ = bootstrap_distances(
            simulated[key], recorded[key], counted.seed, counted.demo, rng_kde, resamples
        )
        (null, p), _ = exchanges.distances(np.concatenate([recorded[key], simulated[key]]))
        put(f"kde_{key}", kde, null.high, p=p)
    return Score(
        method=rollouts.method,
        seeds=tuple(np.unique(counted.seed).tolist()),
        starts=len(np.unique(counted.demo)),
        rollouts=len(counted),
        covers=covers(cells(simulated["duration"], counted.seed, counted.demo, number)),
        words=found.overall,
        measures=pd.DataFrame([rows[key] for key in labels() if key in rows]).set_index("measure"),
        energies=energies[ENERGY],
    )


def start_energies(drawn: Floats, seed: Any, demo: Any, true: Floats) -> Floats:
    """Return the energy score ``(seeds, starts)``; NaN below two rollouts.

    Values ``drawn`` are ``(rollouts, d)``, with the seed and the start of each; the true ones are
    ``(starts, d)``.
    """
    seeds = np.unique(seed)
    found = np.full((len(seeds), len(true)), math.nan)
    for row, one in enumerate(seeds):
        for start in np.unique(demo[seed == one]):
            found[row, start] = energy_score(drawn[(seed == one) & (demo == start)], true[start])
    return found


def dtw_per_step(rollouts: Rollouts, demos: Demonstrations) -> Floats:
    """Return the mean DTW distance of aligned frames, ``(rollouts,)`` [arena unit].

    Mean over those who move by themselves.
    """
    distance, pairs = dtw_alignments(rollouts, demos)
    return np.asarray((distance / pairs)[:, rollouts.movers].mean(axis=1))


def first_second(rollouts: Rollouts, demos: Demonstrations) -> Floats:
    """Return the same of the first second after the warm-up; NaN where either is over before."""
    spec = SPECIES.get(demos.species)
    warmup = spec.warmup if spec is not None else 0
    last = warmup + 1 + max(1, round(1 / rollouts.dt))
    found = np.full(len(rollouts), math.nan)
    for i, demo in enumerate(rollouts.demo.tolist()):
        start = demos.offsets[demo]
        recorded = demos.positions[start : demos.offsets[demo + 1]][warmup:last]
        path = rollouts.path(i)[warmup:last]
        if len(path) and len(recorded):
            each = [dtw_alignment(path[:, k], recorded[:, k]) for k in rollouts.movers]
            found[i] = np.mean([distance / pairs for distance, pairs in each])
    return found


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
