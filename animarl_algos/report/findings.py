"""What a report says in numbers: metrics, distances, contrasts, counterfactuals."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

from animarl_algos.evaluation.comparison import BASELINE, COUNTING, find_method
from animarl_algos.evaluation.effects import ERROR, PREDICTED, TRUE
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
from animarl_algos.report.words import scaled


def metrics(inputs: ReportInputs) -> Iterator[Block]:
    evaluation, say = inputs.evaluation, inputs.words.say
    yield Text(
        say(
            "Every distribution shows one dot per rollout, its density, and the mean with its 95 % "
            "interval; the dashed line is the recorded mean. Intervals add the margin of "
            f"demonstrations (studentised bootstrap, {evaluation.resamples:,} resamples) and that "
            "of training seeds (Student's t); repetitions from one start are never counted as "
            "independent. Captures are episodes in which the target was reached."
        )
    )
    measured = set(evaluation.comparison["metric"])
    for metric in (m for m in METRICS if m.caption and m.key in measured):
        yield Heading(metric.label)
        yield Gallery(panels.metric_panels(inputs, metric), say(metric.caption))
        yield _metric_table(inputs, metric)


def _metric_table(inputs: ReportInputs, metric: Metric) -> Table:
    comparison, words = inputs.evaluation.comparison, inputs.words
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
                words.label(str(row["method"])),
                str(int(row["rollouts"])),
                str(int(row["demos"])),
                with_interval(words.interval(row, "mean", metric), percent),
                str(row["covers"]),
            ]
            if with_recorded:
                gap = words.interval(row, "to_recorded", metric)
                cells.append(with_interval(gap, percent))
            if baseline is not None:
                less = pair_difference(
                    inputs.evaluation.pairs, str(row["method"]), baseline, metric, counting
                )
                cells.append(with_interval(scaled(less, words.factor(metric)), percent))
            if not metric.of_recordings:
                cells += _further_cells(inputs, row, metric)
            lines.append(Row(cells, strong=row["method"] == inputs.learner))
        groups.append(Group("" if metric.share else COUNTING[counting].capitalize(), lines))
    columns = ["Method", "Episodes", "Starts", f"Mean\n({words.unit_of(metric)})"]
    columns += ["Interval of"]
    columns += [words.say("Minus recorded")] if with_recorded else []
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
    words = inputs.words
    less = pair_difference(evaluation.pairs, name, inputs.learner, metric, counting)
    cells = [
        number(row["duration"]),
        number(100.0 * row["reached"]),
        with_interval(words.interval(row, "within", metric)),
        with_interval(scaled(less, words.factor(metric))),
    ]
    if metric.per_step is not None:
        step = comparison_row(evaluation.comparison, name, metric.per_step, counting)
        cells.append(
            NOTHING
            if step is None
            else with_interval(words.interval(step, "mean", metric.per_step))
        )
    return cells


def contrasts(inputs: ReportInputs) -> Iterator[Block]:
    contrasts, words = inputs.evaluation.contrasts, inputs.words
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
                f"{gate['gate_unit']}; differences in {words.unit_of(metric)}"
            )
        lines = [
            Row(
                [
                    f"{method_label(row['first'])} {wording.MINUS} {method_label(row['second'])}",
                    with_interval(words.interval(row, "difference", metric))
                    if row["gate_passed"]
                    else NOTHING,
                ],
                faint=not row["gate_passed"],
            )
            for _, row in rows.iterrows()
        ]
        title += ")"
        groups.append(Group(title, lines))
    yield Table(
        "Planned contrasts",
        ["Contrast", words.say("Difference of the gaps to the recordings")],
        groups,
        words.say(
            "The contrasts planned in advance, all episodes, of the starts that all methods have. "
            "Compared is the energy score per start and, as in the paper, the absolute gap between "
            "its mean and the recording (for DTW the distance itself); below zero, the first "
            "method is closer. A contrast is shown only behind a gate that was passed."
        ),
    )


def counterfactual(inputs: ReportInputs) -> Iterator[Block]:
    table = inputs.evaluation.counterfactual
    if table.empty:
        return
    names, words = condition_names(inputs), inputs.words
    yield Text(
        "The policy is told the other condition; the world stays as it is. The shift is the path "
        "length with the flipped cue minus that with the true one, on the same starts and the "
        "same networks. The page of 'animarl counterfactual' shows it beside its truth and beside "
        "networks that learned nothing."
    )
    quantities = {ERROR: "minus recorded", PREDICTED: "cue flipped", TRUE: "world changed"}
    groups = []
    for counting in COUNTING:
        lines = []
        for _, row in table[table["counting"] == counting].iterrows():
            if row["quantity"] not in quantities or not math.isfinite(row["value"]):
                continue
            of, told = names[int(row["condition"])], names[int(row["told"])]
            cells = [
                words.label(str(row["method"])),
                words.say(quantities[row["quantity"]]),
                of if of == told else f"{of} \u2192 {told}",
                with_interval(words.interval(row, "value", PATH_LENGTH)),
                "planned" if row["planned"] and of != told else "",
            ]
            lines.append(Row(cells, strong=bool(cells[-1])))
        groups.append(Group(COUNTING[counting].capitalize(), lines))
    yield Table(
        "Counterfactual path lengths",
        ["Method", "Quantity", "Condition", f"Path length\n({words.unit_of(PATH_LENGTH)})", ""],
        groups,
        "Differences of the mean path length [95 % interval].",
        left=3,
    )


def condition_names(inputs: ReportInputs) -> tuple[str, str]:
    """Names of conditions 0 and 1, as given or by number."""
    names = tuple(inputs.conditions[:2])
    return (names[0], names[1]) if len(names) == 2 else ("condition 0", "condition 1")
