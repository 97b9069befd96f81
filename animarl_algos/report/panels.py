"""The figures of a report: which data goes into which panel."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from animarl_algos.evaluation.comparison import COUNTING, factual
from animarl_algos.evaluation.decisions import Decisions
from animarl_algos.evaluation.metrics import DTW, Metric
from animarl_algos.evaluation.rollouts import RECORDED, Rollouts
from animarl_algos.evaluation.statistics import Interval
from animarl_algos.report import figures, interpretation
from animarl_algos.report.examples import examples, factual_rollouts
from animarl_algos.report.inputs import ReportInputs
from animarl_algos.report.learning_curves import chosen_curves, learning_curve
from animarl_algos.report.path_figures import trajectory_pair
from animarl_algos.report.sentences import comparison_row, number
from animarl_algos.report.style import Image, to_image
from animarl_algos.report.words import scaled

if TYPE_CHECKING:
    import pandas as pd

QUANTILES = (0.1, 0.3, 0.5, 0.7, 0.9)  # of the DTW distance, for the examples


def trajectories(inputs: ReportInputs) -> Iterator[tuple[str, list[Image]]]:
    """Per condition present: its name and the examples, from the best to the worst."""
    rollouts, dtw = factual_rollouts(inputs)
    words = inputs.words
    for condition, chosen in examples(inputs, QUANTILES):
        images = []
        for i in chosen:
            demo = int(rollouts.demo[i])
            ending = "reached" if rollouts.captured[i] else "not reached"
            distance = f"DTW {number(dtw[i] * words.factor(DTW))}"
            figure = trajectory_pair(
                rollouts.path(i),
                inputs.demos.episode(demo).positions,
                inputs.arena,
                inputs.demos.roles,
                inputs.demos.individuals,
                words,
                f"start {demo}: {distance},\n{ending}",
            )
            what = words.say(f"Simulated and recorded paths of test demonstration {demo}")
            images.append(to_image(figure, f"{what}, {distance} {words.unit_of(DTW)}"))
        yield condition, images


def speeds(inputs: ReportInputs) -> tuple[list[Image], tuple[int, int]]:
    """A histogram for each role, and the numbers of simulated and recorded steps."""
    simulated = factual_rollouts(inputs)[0].speeds()
    recorded = Rollouts.from_demonstrations(inputs.demos).speeds()
    roles, words = np.array(inputs.demos.roles), inputs.words
    images = []
    for role in dict.fromkeys(inputs.demos.roles):
        chosen = roles == role
        title = role.capitalize() + ("s" if chosen.sum() > 1 else "")
        figure = figures.speed_histogram(
            simulated[:, chosen].ravel(), recorded[:, chosen].ravel(), words, title
        )
        alt = words.say(f"Histogram of speeds: {title}, simulated over recorded")
        images.append(to_image(figure, alt))
    return images, (len(simulated), len(recorded))


def metric_panels(inputs: ReportInputs, metric: Metric) -> list[Image]:
    """All episodes and captures side by side; of a share a single panel of means."""
    words = inputs.words
    rows = factual(inputs.evaluation.metrics)
    names = [RECORDED, *inputs.rollouts] if metric.of_recordings else list(inputs.rollouts)
    if metric.share:
        percent = {n: _mean(inputs, n, metric, "all") for n in names}
        figure = figures.interval_rows(
            percent,
            words.axis(metric),
            title=COUNTING["all"].capitalize(),
            reference=percent[RECORDED].estimate,
            limits=(-2.0, 102.0),
            label=words.label,
        )
        return [to_image(figure, f"{words.axis(metric)} by method, {COUNTING['all']}")]
    images = []
    for counting in COUNTING:
        counted = rows[rows["captured"]] if counting == "captures" else rows
        values = {
            name: words.factor(metric)
            * counted.loc[counted["method"] == name, metric.key].to_numpy()
            for name in names
        }
        if not any(len(v) for v in values.values()):
            continue
        figure = figures.metric_distribution(
            values,
            {name: _mean(inputs, name, metric, counting) for name in names},
            words.axis(metric),
            title=COUNTING[counting].capitalize(),
            label=words.label,
        )
        images.append(to_image(figure, f"{metric.label} by method, {COUNTING[counting]}"))
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
            targets=interpretation.other_targets(inputs.demos, who),
            unit=inputs.words.unit,
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


def _mean(inputs: ReportInputs, name: str, metric: Metric, counting: str) -> Interval:
    """In the unit told, shares in percent."""
    row = comparison_row(inputs.evaluation.comparison, name, metric, counting)
    assert row is not None  # the comparison has every method and metric
    value = inputs.words.interval(row, "mean", metric)
    return scaled(value, 100.0) if metric.share else value
