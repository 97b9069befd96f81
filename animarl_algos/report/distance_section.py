"""How far the simulated distributions are from the recorded ones, as a section of the page."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from animarl_algos.evaluation.comparison import COUNTING, interval
from animarl_algos.evaluation.metrics import METRICS
from animarl_algos.report import panels
from animarl_algos.report.blocks import Block, Gallery, Group, Row, Table
from animarl_algos.report.inputs import ReportInputs
from animarl_algos.report.sentences import comparison_row, number, with_interval
from animarl_algos.report.style import method_label


def distances(inputs: ReportInputs) -> Iterator[Block]:
    evaluation = inputs.evaluation
    images = panels.distance_panels(inputs)
    if not images:
        return
    yield Gallery(
        images,
        "Kernel-density distance between simulated and recorded values (0: equal, 2: disjoint), "
        "all episodes, with its 95 % interval. Grey: what a perfect simulator gives at the "
        "same sample sizes, central 95 % and mean. A value inside the grey cannot be told "
        "from chance; the distance is biased upwards, and so is its interval.",
    )
    groups = []
    measured = set(evaluation.comparison["metric"])
    for metric in (m for m in METRICS if m.has_distribution and m.key in measured):
        for counting in COUNTING:
            lines = []
            for name in inputs.rollouts:
                row = comparison_row(evaluation.comparison, name, metric, counting)
                if row is None:
                    continue
                cells = [
                    method_label(name),
                    str(int(row["rollouts"])),
                    with_interval(interval(row, "energy")),
                    number(row["energy_pooled"]),
                    with_interval(interval(row, "kde")),
                    with_interval(interval(row, "kde_null")),
                    with_interval(interval(row, "wasserstein")),
                    with_interval(interval(row, "wasserstein_null")),
                ]
                lines.append(Row(cells, strong=name == inputs.learner))
            title = f"{metric.label} ({metric.unit}), {COUNTING[counting]}"
            groups.append(Group(title, lines))
    yield Table(
        "Distances to the recordings",
        [
            "Method",
            "Episodes",
            "Energy\nscore",
            "other\nstarts",
            "Kernel-density\ndistance",
            "null\nreference",
            "Wasserstein\ndistance",
            "null\nreference",
        ],
        groups,
        "The energy score per start, the primary measure, beside what the demonstrations of all "
        "other starts score: the smaller the better, and a simulator that always does the same "
        "cannot win by it. Both distances [95 % interval], each beside its null reference "
        "[central 95 %] from "
        f"{evaluation.distance_resamples:,} resamples. The kernel-density distance lies between 0 "
        "and 2; the Wasserstein distance has the metric's unit. Null: what both come to if the "
        "recorded episode of every start is exchanged with one of its rollouts, which a perfect "
        f"simulator would not notice.{_floors(evaluation.comparison)}",
    )


def _floors(comparison: Any) -> str:
    """Where the smallest bandwidth acts, and so makes the kernel-density distance."""
    acts = comparison[comparison["kde_floor"].notna()]
    if acts.empty:
        return ""
    units = {metric.key: metric for metric in METRICS}
    places = [
        f"{method_label(str(row['method']))}, {units[row['metric']].label.lower()}, "
        f"{COUNTING[row['counting']]} ({number(row['kde_floor'], 2)} {units[row['metric']].unit})"
        for _, row in acts.iterrows()
    ]
    return (
        " Values hardly vary, so that the smallest bandwidth decides on the kernel-density "
        f"distance, of: {'; '.join(places)}."
    )
