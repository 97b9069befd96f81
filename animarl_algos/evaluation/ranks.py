"""The exact rank of each recording among the rollouts from its start.

If a simulator is perfect, the recording is one more rollout: its rank among them by any measure is
uniform, whatever the distribution (Besag and Clifford 1989, Biometrika 76, 633). One test asks this
of several measures together. By realism, each episode is scored by its likelihood under the others
from the same start. Of a recording that was cut into pieces the first counts, so that
ranks are independent.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from animarl_algos.evaluation.realism import leave_one_out
from animarl_algos.evaluation.verdict_rows import Comparison
from animarl_envs.array_types import Floats, Ints
from animarl_envs.demos.episode import UNFINISHED

RANKED = ("duration", "path_length", "mean_speed", "turning", "nearest_neighbour")
"""Metrics by which recordings are ranked, besides realism."""
DRAWS = 1000  # of ranks of a perfect simulator


@dataclass(frozen=True)
class Ranks:
    """Ranks between 0 and 1, ``(recordings, measures)``, and the ``p`` of all being uniform.

    NaN where a measure is undefined in a recording, or in all rollouts from its start.
    """

    measures: tuple[str, ...]
    values: Floats
    p: float


def rank_recordings(compared: Comparison, rng: np.random.Generator) -> Ranks:
    """Rank each recording among its rollouts by some metrics, and by how typical it is of all.

    Nothing is known of the duration of a recording that was cut: it has no rank by that.
    """
    prepared, kept = compared.prepared, ~compared.counted.copies
    counted = compared.counted.select(kept)
    columns = [i for i, metric in enumerate(compared.metrics) if metric.key in RANKED]
    first, second = (side[:, columns] for side in compared.values)
    cut = prepared.recorded.outcome == UNFINISHED
    for place, i in enumerate(columns):
        if compared.metrics[i].key == "duration":
            first[cut, place] = np.nan
    typical = leave_one_out(prepared, counted)
    own, others = (
        np.column_stack(both) for both in ((first, typical[0]), (second[kept], typical[1]))
    )
    names = (*(compared.metrics[i].label for i in columns), "Realism")
    return exact_ranks(own, others, np.asarray(counted.demo), compared.unit, names, rng)


def exact_ranks(
    recorded: Floats,
    simulated: Floats,
    demo: Ints,
    unit: Ints,
    measures: tuple[str, ...],
    rng: np.random.Generator,
) -> Ranks:
    """Rank ``recorded`` ``(starts, measures)`` among ``simulated`` ``(rollouts, measures)``.

    ``demo`` ``(rollouts,)`` is the start of each rollout, ``unit`` ``(starts,)`` the recording of
    each start. Ties are broken by chance.
    """
    _, first = np.unique(unit, return_index=True)
    chosen = [start for start in first.tolist() if (demo == start).any()]
    ranks, drawn = [], []
    for start in chosen:
        own, others = recorded[start], simulated[demo == start]
        pool = np.concatenate([own[None], others])
        known = np.isfinite(pool)
        order = np.lexsort((rng.random(pool.shape), np.nan_to_num(pool, nan=np.inf)), axis=0)
        place = order.argsort(axis=0)
        number = known.sum(axis=0)
        fine = known[0] & (number > 1)
        ranks.append(np.where(fine, (place[0] + 0.5) / np.maximum(number, 1), np.nan))
        # A perfect simulator: any of the episodes is called the recording, for all measures alike.
        other = rng.integers(len(pool), size=DRAWS)
        fine = known[other] & (number > 1)
        drawn.append(np.where(fine, (place[other] + 0.5) / np.maximum(number, 1), np.nan))
    values = np.array(ranks).reshape(len(chosen), len(measures))
    null = np.array(drawn).reshape(len(chosen), DRAWS, len(measures))
    unevenness = float(_unevenness(values[:, None])[0]) if len(chosen) else np.nan
    expected = _unevenness(null)
    at_least = int(np.count_nonzero(expected >= unevenness * (1 - 1e-9)))
    return Ranks(measures, values, (1 + at_least) / (1 + DRAWS) if chosen else np.nan)


def _unevenness(ranks: Floats) -> Floats:
    """Return the largest Cramer-von Mises distance from uniform, ``(draws,)``.

    ``ranks`` is ``(recordings, draws, measures)``.
    """
    number = np.isfinite(ranks).sum(axis=0)
    ordered = np.sort(ranks, axis=0)  # NaN comes last
    place = (np.arange(len(ranks))[:, None, None] + 0.5) / np.maximum(number, 1)
    square = np.where(np.isfinite(ordered), np.square(ordered - place), 0.0).sum(axis=0)
    return np.asarray(square.max(axis=-1))
