"""What a report says in numbers: metrics, distances, contrasts, counterfactuals."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

from animarl_algos.evaluation.comparison import BASELINE, COUNTING, find_method, interval
from animarl_algos.evaluation.counterfactual import DIFFERENCE, ERROR, SHIFT, WORLD_SHIFT
from animarl_algos.evaluation.metrics import METRICS, PATH_LENGTH, Metric
from animarl_algos.report import panels
from animarl_algos.report import sentences as wording
from animarl_algos.report.blocks import Block, Gallery, Group, Heading, Row, Table, Text
from animarl_algos.report.inputs import ReportInputs
from animarl_algos.report.sentences import (
    NOTHING,
    comparison_row,
    number,
    pair_difference,
    with_interval,
)
from animarl_algos.report.style import method_label


def metrics(inputs: ReportInputs) -> Iterator[Block]:
    evaluation = inputs.evaluation
    yield Text(
        "Every distribution shows one dot per rollout, its density, and the mean with its 95 % "
        "interval; the dashed line is the recorded mean. Intervals add the margin of "
        f"demonstrations (studentised bootstrap, {evaluation.resamples:,} resamples) and that of "
        "training seeds (Student's t); repetitions from one start are never counted as "
        "independent. Captures are episodes in which the target was reached."
    )
    measured = set(evaluation.comparison["metric"])
    for metric in (m for m in METRICS if m.caption and m.key in measured):
        yield Heading(metric.label)
        yield Gallery(panels.metric_panels(inputs, metric), metric.caption)
        yield _metric_table(inputs, metric)


def _metric_table(inputs: ReportInputs, metric: Metric) -> Table:
    comparison = inputs.evaluation.comparison
    rows = comparison[comparison["metric"] == metric.key]
    percent = metric.share
    with_recorded = bool(rows["to_recorded"].notna().any())
    baseline = find_method(inputs.rollouts, BASELINE)
    groups = []
    for counting in COUNTING:
        chosen = rows[rows["counting"] == counting]
        if chosen.empty:
            continue
        lines = []
        for _, row in chosen.iterrows():
            cells = [
                method_label(str(row["method"])),
                str(int(row["rollouts"])),
                str(int(row["demos"])),
                with_interval(interval(row, "mean"), percent),
                str(row["covers"]),
            ]
            if with_recorded:
                cells.append(with_interval(interval(row, "to_recorded"), percent))
            if baseline is not None:
                less = pair_difference(
                    inputs.evaluation.pairs, str(row["method"]), baseline, metric, counting
                )
                cells.append(with_interval(less, percent))
            if not metric.of_recordings:
                cells += _further_cells(inputs, row, metric)
            lines.append(Row(cells, strong=row["method"] == inputs.learner))
        groups.append(Group("" if metric.share else COUNTING[counting].capitalize(), lines))
    columns = ["Method", "Episodes", "Starts", f"Mean\n({'%' if percent else metric.unit})"]
    columns += ["Interval of"]
    columns += ["Minus recorded"] if with_recorded else []
    columns += [f"Minus {BASELINE}"] if baseline is not None else []
    note = ""
    if not metric.of_recordings:
        columns += ["Duration\n(s)", "Reached\n(%)", "Within starts"]
        columns += [f"Minus {method_label(inputs.learner)}"]
        note = (
            " Within starts: the mean with what all methods share of a start taken out "
            "(Cousineau 2005, Morey 2008), to compare methods where episodes differ much in length."
        )
        if metric.per_step is not None:
            columns.append("Per step")
            note += " Per step: the mean distance of aligned positions."
    return Table(
        f"{metric.label} by method",
        columns,
        groups,
        f"Mean [95 % interval] and paired differences.{note}",
    )


def _further_cells(inputs: ReportInputs, row: Any, metric: Metric) -> list[str]:
    """Of a distance to the recordings: duration and outcome, without which an episode that ends
    at once passes for a close one, then within starts, minus the learner, per step."""
    evaluation, name, counting = inputs.evaluation, str(row["method"]), str(row["counting"])
    cells = [
        number(row["duration"]),
        number(100.0 * row["reached"]),
        with_interval(interval(row, "within")),
        with_interval(pair_difference(evaluation.pairs, name, inputs.learner, metric, counting)),
    ]
    if metric.per_step is not None:
        step = comparison_row(evaluation.comparison, name, metric.per_step, counting)
        cells.append(NOTHING if step is None else with_interval(interval(step, "mean")))
    return cells


def contrasts(inputs: ReportInputs) -> Iterator[Block]:
    contrasts = inputs.evaluation.contrasts
    if contrasts.empty:
        return
    groups = []
    for (key, measure), rows in contrasts.groupby(["metric", "measure"], sort=False):
        metric = next(m for m in METRICS if m.key == key)
        gate = rows.iloc[0]
        title = f"{metric.label}: gate {gate['gate']} ({measure}"
        if math.isfinite(gate["gate_p"]):
            title += (
                f"; F = {number(gate['gate_f'])}, p = {number(gate['gate_p'], 2)}, exchanging "
                f"{gate['gate_unit']}"
            )
        lines = [
            Row(
                [
                    f"{method_label(row['first'])} {wording.MINUS} {method_label(row['second'])}",
                    with_interval(interval(row, "difference")) if row["gate_passed"] else NOTHING,
                ],
                faint=not row["gate_passed"],
            )
            for _, row in rows.iterrows()
        ]
        title += ")"
        groups.append(Group(title, lines))
    yield Table(
        "Planned contrasts",
        ["Contrast", "Difference of the gaps to the recordings"],
        groups,
        "The contrasts planned in advance, all episodes, of the starts that all methods have. "
        "Compared is the energy score per start and, as in the paper, the absolute gap between "
        "its mean and the recording (for DTW the distance itself); below zero, the first method is "
        "closer. A contrast is shown only behind a gate that was passed.",
    )


def counterfactual(inputs: ReportInputs) -> Iterator[Block]:
    table = inputs.evaluation.counterfactual
    if table.empty:
        return
    names = condition_names(inputs)
    yield Text(
        "The policy is told the other condition; the world stays as it is. The shift is the path "
        "length with the flipped cue minus that with the true one, on the same starts and the "
        "same networks."
    )
    yield Gallery(
        panels.counterfactual_panels(inputs, names),
        "Mean path length with 95 % interval, all episodes: recorded, simulated, and simulated "
        "with the cue flipped (arrow, ringed dot).",
    )
    words = {
        DIFFERENCE: f"{names[0]} {wording.MINUS} {names[1]}",
        ERROR: "absolute error",
        SHIFT: "cue flipped",
        WORLD_SHIFT: "world changed",
    }
    groups = []
    for counting in COUNTING:
        lines = []
        for _, row in table[table["counting"] == counting].iterrows():
            if row["quantity"] not in words:
                continue
            of, told = names[int(row["condition"])], names[int(row["cue"])]
            where = {
                DIFFERENCE: "",
                ERROR: of,
                SHIFT: f"{of} \u2192 {told}",
                WORLD_SHIFT: f"{of} \u2192 {told}",
            }[row["quantity"]]
            lines.append(
                Row(
                    [
                        method_label(str(row["method"])),
                        words[row["quantity"]],
                        where,
                        with_interval(interval(row, "value")),
                        "planned" if row["planned"] else "",
                    ],
                    strong=bool(row["planned"]),
                )
            )
        groups.append(Group(COUNTING[counting].capitalize(), lines))
    yield Table(
        "Counterfactual path lengths",
        ["Method", "Quantity", "Condition", f"Path length\n({PATH_LENGTH.unit})", ""],
        groups,
        "Differences and errors of the mean path length [95 % interval]. An absolute error is "
        "never negative, so its interval cannot include zero.",
        left=3,
    )


def condition_names(inputs: ReportInputs) -> tuple[str, str]:
    """Names of conditions 0 and 1, as given or by number."""
    names = tuple(inputs.conditions[:2])
    return (names[0], names[1]) if len(names) == 2 else ("condition 0", "condition 1")
