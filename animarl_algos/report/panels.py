"""The figures of a report: which data goes into which panel."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from animarl_algos.evaluation.comparison import COUNTING, factual, interval
from animarl_algos.evaluation.decisions import Decisions
from animarl_algos.evaluation.metrics import DTW, METRICS, PATH_LENGTH, Metric
from animarl_algos.evaluation.rollouts import RECORDED, Rollouts
from animarl_algos.evaluation.statistics import Interval
from animarl_algos.report import figures, interpretation
from animarl_algos.report.inputs import ReportInputs
from animarl_algos.report.learning_curves import chosen_curves, learning_curve
from animarl_algos.report.path_figures import trajectory_pair
from animarl_algos.report.sentences import comparison_row, number
from animarl_algos.report.style import Image, method_label, to_image

if TYPE_CHECKING:
    import pandas as pd

QUANTILES = (0.1, 0.3, 0.5, 0.7, 0.9)  # of the DTW distance, for the examples


def trajectories(inputs: ReportInputs) -> Iterator[tuple[str, list[Image]]]:
    """Per condition present: its name and the examples, from the best to the worst."""
    rollouts, dtw = _factual(inputs)
    present = np.unique(rollouts.condition).tolist()
    for condition in present:
        among = np.flatnonzero(rollouts.condition == condition)
        order = among[np.argsort(dtw[among], kind="stable")]
        ranks = np.unique(np.round(np.array(QUANTILES) * (len(order) - 1)).astype(int))
        images = []
        for i in order[ranks].tolist():
            demo = int(rollouts.demo[i])
            ending = "reached" if rollouts.captured[i] else "not reached"
            figure = trajectory_pair(
                rollouts.path(i),
                inputs.demos.episode(demo).positions,
                inputs.demos.arena,
                inputs.demos.roles,
                f"DTW {number(dtw[i])}, {ending}",
            )
            alt = f"Simulated and recorded paths of test demonstration {demo}, DTW {dtw[i]:.3g}"
            images.append(to_image(figure, alt))
        named = len(present) > 1 and len(inputs.conditions) == 2
        yield inputs.conditions[condition] if named else "", images


def speeds(inputs: ReportInputs) -> tuple[list[Image], tuple[int, int]]:
    """A histogram for each role, and the numbers of simulated and recorded steps."""
    simulated = _factual(inputs)[0].speeds()
    recorded = Rollouts.from_demonstrations(inputs.demos).speeds()
    roles = np.array(inputs.demos.roles)
    images = []
    for role in dict.fromkeys(inputs.demos.roles):
        chosen = roles == role
        title = role.capitalize() + ("s" if chosen.sum() > 1 else "")
        figure = figures.speed_histogram(
            simulated[:, chosen].ravel(), recorded[:, chosen].ravel(), title
        )
        images.append(to_image(figure, f"Histogram of speeds: {title}, simulated over recorded"))
    return images, (len(simulated), len(recorded))


def metric_panels(inputs: ReportInputs, metric: Metric) -> list[Image]:
    """All episodes and captures side by side; of a share a single panel of means."""
    comparison = inputs.evaluation.comparison
    rows = factual(inputs.evaluation.metrics)
    names = [RECORDED, *inputs.rollouts] if metric.of_recordings else list(inputs.rollouts)
    if metric.share:
        percent = {n: _times(_mean(comparison, n, metric, "all"), 100.0) for n in names}
        figure = figures.interval_rows(
            percent,
            metric.axis,
            title=COUNTING["all"].capitalize(),
            reference=percent[RECORDED].estimate,
            limits=(-2.0, 102.0),
        )
        return [to_image(figure, f"{metric.axis} by method, {COUNTING['all']}")]
    images = []
    for counting in COUNTING:
        counted = rows[rows["captured"]] if counting == "captures" else rows
        values = {
            name: counted.loc[counted["method"] == name, metric.key].to_numpy() for name in names
        }
        if not any(len(v) for v in values.values()):
            continue
        figure = figures.metric_distribution(
            values,
            {name: _mean(comparison, name, metric, counting) for name in names},
            metric,
            title=COUNTING[counting].capitalize(),
        )
        images.append(to_image(figure, f"{metric.label} by method, {COUNTING[counting]}"))
    return images


def distance_panels(inputs: ReportInputs) -> list[Image]:
    """Kernel-density distance by method with its null band, a panel per metric."""
    images = []
    for metric in (metric for metric in METRICS if metric.has_distribution):
        values, nulls = {}, {}
        for name in inputs.rollouts:
            row = comparison_row(inputs.evaluation.comparison, name, metric)
            if row is not None and np.isfinite(row["kde"]):
                values[name], nulls[name] = interval(row, "kde"), interval(row, "kde_null")
        if not values:
            continue
        figure = figures.interval_rows(
            values,
            "Kernel-density distance to the recordings",
            title=metric.label,
            bands=nulls,
            limits=(0.0, 2.0),
        )
        images.append(to_image(figure, f"Kernel-density distance of {metric.label} by method"))
    return images


def counterfactual_panels(inputs: ReportInputs, conditions: Sequence[str]) -> list[Image]:
    """One panel per method that was asked with a flipped cue."""
    table = inputs.evaluation.counterfactual
    asked = table.loc[table["quantity"] == "cue shift", "method"].unique()
    images = []
    for name in asked:
        figure = figures.counterfactual_lengths(
            table, str(name), conditions, counting="all", unit=PATH_LENGTH.unit
        )
        alt = f"Mean path length by condition and cue, {method_label(str(name))}"
        images.append(to_image(figure, alt))
    return images


def is_target(inputs: ReportInputs, individual: str) -> bool:
    """Whether it is the one that the others pursue."""
    return inputs.demos.roles[inputs.demos.individuals.index(individual)] == "target"


def decision_panels(inputs: ReportInputs, decisions: Decisions) -> list[Image]:
    """Values along the recorded path and, where there is an arena, over it."""
    who, dt = decisions.individual, inputs.demos.dt
    along = interpretation.values_along_path(decisions.q, decisions.actions, dt, title=who)
    images = [to_image(along, f"Action values of {who} along test demonstration {decisions.demo}")]
    if decisions.map_q.size:
        figure = interpretation.value_map(
            decisions.x,
            decisions.y,
            decisions.map_q,
            decisions.focus,
            inputs.demos.arena,
            others=decisions.others,
            target_last=not is_target(inputs, who),
            title=f"{who} at {number(decisions.moment * dt)} s",
        )
        images.append(to_image(figure, f"Best action value of {who} over the arena"))
    return images


def learning_panels(curves: pd.DataFrame, learner: str, *, offline: bool) -> list[Image]:
    """One panel per quantity."""
    label = "Epoch" if offline else "Environment steps"
    return [
        to_image(learning_curve(curve.rows, curve.title, label), f"{curve.title} over training")
        for curve in chosen_curves(curves, learner)
    ]


def _factual(inputs: ReportInputs) -> tuple[Rollouts, NDArray[np.float64]]:
    """The rollouts of the learner that the tables compare, and their DTW distances."""
    rollouts = inputs.rollouts[inputs.learner]
    rows = inputs.evaluation.metrics
    first = int(np.flatnonzero(rows["method"] == inputs.learner)[0])
    compared = factual(rows)
    compared = compared[compared["method"] == inputs.learner]
    chosen = compared.index.to_numpy() - first  # rows stand in the order of the rollouts
    return rollouts.select(chosen), compared[DTW.key].to_numpy(dtype=np.float64)


def _mean(comparison: pd.DataFrame, name: str, metric: Metric, counting: str) -> Interval:
    row = comparison_row(comparison, name, metric, counting)
    assert row is not None  # the comparison has every method and metric
    return interval(row, "mean")


def _times(value: Interval, factor: float) -> Interval:
    return Interval(value.estimate * factor, value.low * factor, value.high * factor)
