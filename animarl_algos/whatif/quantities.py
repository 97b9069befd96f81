"""Quantities of what-if answers: a number of each episode, in the recordings' unit.

Every answer has outcome, duration, paths, distances and speeds. Each measure of the verdict can be
asked too, worked out from smoothed positions as the verdict does.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from weakref import WeakKeyDictionary

import numpy as np

from animarl_algos.evaluation.metrics import (
    KINDS,
    METRICS,
    ORDER_METRICS,
    Metric,
    judged_metrics,
)
from animarl_algos.evaluation.order_in_time import plain_name
from animarl_algos.evaluation.prepared import (
    MeasuredEpisodes,
    Prepared,
    comparison_smoothing,
    path_lengths,
)
from animarl_algos.evaluation.rollouts import Rollouts
from animarl_algos.evaluation.verdict_rows import lower_first, resolve, row_names
from animarl_envs.array_types import Floats
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.summary import RECORDED_SCALE, Unit
from animarl_envs.focus import distances_to_target, is_free, nearest_other
from animarl_envs.species import Species

ALL = "all"
OUTCOMES = "Outcome, paths and speeds"  # what every answer has
OTHERS = "Other rows of the verdict"


@dataclass(frozen=True)
class Quantity:
    """A number of each episode, ``(episodes,)``; ``kind`` is the heading that it stands under."""

    name: str
    unit: str
    values: Callable[[Rollouts], Floats]
    kind: str = OUTCOMES


def speeds_of(rollouts: Rollouts, scale: float = 1.0) -> Floats:
    """Return the mean speed of each individual, ``(episodes, individuals)``.

    ``scale`` is what one arena unit is in the unit of the result.
    """
    seconds = np.maximum(rollouts.lengths - 1, 1) * rollouts.dt
    return np.asarray(scale * path_lengths(rollouts) / seconds[:, None])


def quantities_of(
    of: Species | Rollouts, unit: Unit, named: Collection[str] = ()
) -> Iterator[Quantity]:
    """Yield the quantities of every answer: outcome, duration, paths, distance, speeds.

    Animals of a group have a speed each only where they are ``named``.
    """
    scale, name = unit.per_arena_unit, unit.name

    def speed_of(index: int) -> Callable[[Rollouts], Floats]:
        return lambda rollouts: speeds_of(rollouts, scale)[:, index]

    def own_of(measure: Callable[[Rollouts, float], Floats]) -> Callable[[Rollouts], Floats]:
        return lambda rollouts: measure(rollouts, scale)

    def mean_of(apart: Floats, rollouts: Rollouts) -> Floats:
        starts = rollouts.offsets[:-1]
        return np.asarray(scale * np.add.reduceat(apart, starts) / rollouts.lengths)

    def closest(rollouts: Rollouts) -> Floats:
        apart = distances_to_target(rollouts.positions, rollouts.roles).min(axis=1)
        return mean_of(apart, rollouts)

    def nearest(rollouts: Rollouts) -> Floats:
        apart = np.linalg.norm(nearest_other(rollouts.positions), axis=-1).mean(axis=1)
        return mean_of(apart, rollouts)

    for metric in METRICS:
        if metric.own is not None:
            yield Quantity(metric.label.lower(), metric.unit, own_of(metric.own))
    if is_free(of.roles):  # nothing is reached, and only the film ends
        yield Quantity("speed", f"{name}/s", lambda made: speeds_of(made, scale).mean(axis=1))
        if len(of.individuals) > 1:
            yield Quantity("nearest neighbour", name, nearest)
    else:
        yield Quantity("reached", "share", lambda made: made.captured.astype(np.float64))
        yield Quantity("duration", "s", lambda made: np.asarray((made.lengths - 1) * made.dt))
        paths = "path length", name
        yield Quantity(*paths, lambda made: scale * path_lengths(made)[:, made.movers].mean(axis=1))
        yield Quantity("mean distance", name, closest)
        named = of.individuals
    for index, individual in enumerate(of.individuals):
        if individual in named:
            yield Quantity(f"speed of {individual}", f"{name}/s", speed_of(index))


def measured_quantities(
    demos: Demonstrations, unit: Unit, keys: Sequence[str], smoothing: int | None = None
) -> Iterator[Quantity]:
    """Yield measures of the verdict that :func:`quantities_of` does not have.

    Parameters
    ----------
    demos
        The recordings, in the field whose walls count.
    keys
        Of :func:`resolve_measures`.
    smoothing
        Frames of the moving average, by default those of the verdict on ``demos``.
    """
    prepared = Prepared(demos, smoothing or comparison_smoothing(demos))
    known: WeakKeyDictionary[Rollouts, MeasuredEpisodes] = WeakKeyDictionary()

    def values(metric: Metric, rollouts: Rollouts) -> Floats:
        if rollouts not in known:
            known[rollouts] = prepared.episodes(prepared.filtered(rollouts))
        scale = unit.per_arena_unit if metric.is_length else 1.0
        return np.asarray(scale * metric.measure(known[rollouts]))

    usual = {quantity.name for quantity in quantities_of(prepared.recorded, unit)}
    for metric in judged_metrics(prepared):
        name = lower_first(metric.label)
        if metric.key not in keys or name in usual or metric.own is not None:
            continue
        usual.add(name)
        order = ORDER_METRICS.get(plain_name(name))
        kind = KINDS[order.kind] if order is not None else OTHERS
        unit_name = metric.unit.replace(RECORDED_SCALE.name, unit.name)
        yield Quantity(name, unit_name, partial(values, metric), kind)


def resolve_measures(names: Sequence[str], demos: Demonstrations) -> tuple[str, ...]:
    """Return the keys of measures of the verdict by the names that a user gives them.

    Raises
    ------
    InputError
        If a name is that of no measure of such recordings.
    """
    if not names:
        return ()
    metrics = judged_metrics(Prepared(demos.select(episodes=np.arange(1))))
    if ALL in names:
        return tuple(metric.key for metric in metrics)
    known = row_names(metrics)
    return tuple(known[resolve(name, known)] for name in names)
