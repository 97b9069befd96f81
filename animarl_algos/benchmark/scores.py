"""What is measured of a method: value, interval and null of every measure of the leaderboard."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from animarl_algos.benchmark.measured import (
    ENERGY,
    REALISM,
    Measured,
    Score,
    differences,
    labels,
)
from animarl_algos.benchmark.references import RECORDINGS, beside_fold, others_as_rollouts
from animarl_algos.evaluation.classifier import AUC, SEQUENCE
from animarl_algos.evaluation.distances import (
    FEW_ROLLOUTS,
    bootstrap_distances,
    energy_score,
    pooled_score,
)
from animarl_algos.evaluation.exchange_test import Exchanges
from animarl_algos.evaluation.metrics import ARENA_UNITS, dtw_alignments
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
from animarl_algos.evaluation.verdict import SUMMARY, Verdict, verdict
from animarl_algos.evaluation.windows import comparison_smoothing
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.splits import learnable
from animarl_envs.dtw import dtw_alignment
from animarl_envs.species import SPECIES

Floats = NDArray[np.float64]

SEED = 0  # of all resampling
DISTRIBUTIONS = ("duration", "path_length")


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

    Parameters
    ----------
    folds
        For every fold and seed the demonstrations, as this fold splits them, and the rollouts.
    method
        Its name.
    resamples
        Of the intervals.
    """
    made, beside = [], {}
    for demos, rollouts in folds:
        tested = np.flatnonzero(demos.split == "test")
        made.append(replace(rollouts, demo=tested[rollouts.demo]))
        if int(tested[0]) not in beside:
            others = others_as_rollouts(beside_fold(demos), demos.select(split="test"), SEED)
            beside[int(tested[0])] = replace(others, demo=tested[others.demo])
    whole = folds[0][0]
    joined = Rollouts.concatenate(made, method)
    return _score(joined, whole, Rollouts.concatenate(list(beside.values())), None, resamples)


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
    seen = prepared.filtered(counted)
    simulated, recorded = prepared.measures(seen), prepared.measures(prepared.recorded)
    draws = Draws.by(rng_draws, resamples)
    same = others is None and rollouts.method == RECORDINGS
    energies = {}
    measures = [_realism(found), _area(AUC, found, same), _area(SEQUENCE, found, same)]
    for name, keys in {ENERGY: SUMMARY, **{f"energy_{key}": (key,) for key in SUMMARY}}.items():
        spread = [float(np.std(recorded[k])) or 1.0 for k in keys]
        drawn, true = (
            np.stack([side[k] / s for k, s in zip(keys, spread)], axis=1)
            for side in (simulated, recorded)
        )
        energies[name] = start_energies(drawn, counted.seed, counted.demo, true)
        mean = _mean(energies[name], draws)
        measures.append(_of(name, "recorded SD", mean, null=pooled_score(true)))
    measures.append(_endings(found))
    measures += _closeness(counted, test, beside, draws)
    copies = counted.copies
    exchanges = Exchanges.draw(counted.demo, len(test), rng_null, resamples, copies=copies)
    for metric in differences():
        key = metric.key
        gap = _difference(simulated[key], counted, recorded[key], draws, metric.share)
        tested = exchanges.difference(np.concatenate([recorded[key], simulated[key]]))
        unit = metric.unit.replace(ARENA_UNITS, prepared.unit.name)
        measures.append(_of(key, unit, gap, null=tested.null, p=tested.p))
    for key in DISTRIBUTIONS:
        kde, _ = bootstrap_distances(
            simulated[key], recorded[key], counted.seed, counted.demo, rng_kde, resamples
        )
        (null, p), _ = exchanges.distances(np.concatenate([recorded[key], simulated[key]]))
        measures.append(_of(f"kde_{key}", "", kde, null=null.high, p=p))
    ordered = {one.measure: one for one in measures}
    return Score(
        method=rollouts.method,
        seeds=tuple(np.unique(counted.seed).tolist()),
        starts=len(np.unique(counted.demo)),
        rollouts=len(counted),
        covers=covers(cells(simulated["duration"], counted.seed, counted.demo, len(test))),
        words=found.overall,
        measures=tuple(ordered[key] for key in labels()),
        energies=energies[ENERGY],
    )


def start_energies(drawn: Floats, seed: Any, demo: Any, true: Floats) -> Floats:
    """The energy score of every seed at every start, ``(seeds, starts)``; NaN below two rollouts.

    Parameters
    ----------
    drawn, seed, demo
        ``(rollouts, d)`` values, and seed and start of each.
    true
        ``(starts, d)``.
    """
    seeds = np.unique(seed)
    found = np.full((len(seeds), len(true)), math.nan)
    for row, one in enumerate(seeds):
        for start in np.unique(demo):
            chosen = (seed == one) & (demo == start)
            if chosen.any():
                found[row, start] = energy_score(drawn[chosen], true[start])
    return found


def first_second(rollouts: Rollouts, demos: Demonstrations, warmup: int) -> Floats:
    """DTW distance per aligned pair of frames, of the first second after the warm-up.

    Mean over those who move by themselves, ``(rollouts,)`` [arena unit]; NaN where either is over
    before it begins.
    """
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


def _closeness(
    counted: Rollouts, test: Demonstrations, beside: Rollouts, draws: Draws
) -> list[Measured]:
    """DTW of whole episodes and of the first second, beside what other recordings come to."""
    spec = SPECIES.get(test.species)
    warmup = spec.warmup if spec is not None else 0

    def per_step(rollouts: Rollouts) -> Floats:
        distance, pairs = dtw_alignments(rollouts, test)
        return np.asarray((distance / pairs)[:, rollouts.movers].mean(axis=1))

    def early(rollouts: Rollouts) -> Floats:
        return first_second(rollouts, test, warmup)

    found = []
    for key, of in (("dtw_per_step", per_step), ("dtw_first_second", early)):
        data = cells(of(counted), counted.seed, counted.demo, len(test))
        null = float(np.nanmean(of(beside)))
        found.append(_of(key, "arena unit", bootstrap_mean(data, draws), null=null))
    return found


def _difference(
    values: Floats, counted: Rollouts, recorded: Floats, draws: Draws, share: bool
) -> Interval:
    """Mean of the rollouts less that of the recordings."""
    starts = np.arange(len(recorded))
    many = cells(values, counted.seed, counted.demo, len(recorded))
    one = cells(recorded, np.full(len(recorded), -1), starts, len(recorded))
    return bootstrap_difference(many, one, draws, share=share)


def _realism(found: Verdict) -> Measured:
    """The realism score beside that of other recordings."""
    null = found.realism_beside.get(OTHERS, math.nan)
    return _of(REALISM, "", found.realism, null=null)


def _area(judge: str, found: Verdict, same: bool) -> Measured:
    """That of recordings among themselves, where the ``same`` recordings stand on both sides.

    Over all folds each is on one side itself and on the other as another's: the classifier would
    learn to call it by the side on which it met it.
    """
    among = found.areas[judge]["among"]
    own = found.auc if judge == AUC else found.sequence
    return _of(judge, "", among if same else own, null=among.high)


def _endings(found: Verdict) -> Measured:
    row = found.row("outcomes")
    return Measured(
        "outcomes",
        value=row["distance"],
        null=row["null"],
        p=row["p"],
        reason="a test: no interval",
    )


def _of(measure: str, unit: str, value: Interval, *, null: float, p: float = math.nan) -> Measured:
    return Measured(measure, unit, value.estimate, value.low, value.high, null, p, value.reason)


def _mean(energies: Floats, draws: Draws) -> Interval:
    if not np.isfinite(energies).any():
        return Interval(math.nan, reason=FEW_ROLLOUTS)
    return bootstrap_mean(single_cells(energies), draws)
