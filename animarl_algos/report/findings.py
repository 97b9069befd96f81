"""What a report says in numbers: metrics, distances, contrasts, counterfactuals."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from animarl_algos.evaluation.comparison import BASELINE, COUNTING, find_method, interval
from animarl_algos.evaluation.counterfactual import DIFFERENCE, ERROR, SHIFT, WORLD_SHIFT
from animarl_algos.evaluation.metrics import METRICS, PATH_LENGTH, Metric
from animarl_algos.report import panels
from animarl_algos.report import sentences as wording
from animarl_algos.report.blocks import Block, Gallery, Group, Heading, Row, Sentences, Table, Text
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


def summary(inputs: ReportInputs) -> Iterator[Block]:
    """What the tables say, in sentences."""
    evaluation = inputs.evaluation
    yield Sentences(
        wording.headline(evaluation.comparison, evaluation.pairs, inputs.learner, inputs.words)
    )


def metrics(inputs: ReportInputs) -> Iterator[Block]:
    evaluation, say = inputs.evaluation, inputs.words.say
    yield Text(
        say(
            "Every distribution shows one dot per rollout, its density, and the mean with its 95 % "
            "interval; the dashed line is the recorded mean. Intervals are percentile bootstrap "
            f"intervals from {evaluation.resamples:,} paired resamples of demonstrations and of "
            "training seeds; repetitions from one start are never counted as independent. Captures "
            "are episodes in which the target was reached."
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
    columns += [words.say("Minus recorded")] if with_recorded else []
    columns += [f"Minus {BASELINE}"] if baseline is not None else []
    note = ""
    if not metric.of_recordings:
        columns += ["Within starts", f"Minus {method_label(inputs.learner)}"]
        note = (
            " Within starts: the mean with what all methods share of a start taken out "
            "(Cousineau 2005, Morey 2008), to compare methods where episodes differ much in length."
        )
        if metric.per_step is not None:
            columns.append("Per step")
            note += " Per step: the distance over the frames of the longer of the two paths."
    return Table(
        f"{metric.label} by method",
        columns,
        groups,
        f"Mean [95 % interval] and paired differences.{note}",
    )


def _further_cells(inputs: ReportInputs, row: Any, metric: Metric) -> list[str]:
    """Of a distance to the recordings: within starts, minus the learner, per step."""
    evaluation, name, counting = inputs.evaluation, str(row["method"]), str(row["counting"])
    words = inputs.words
    less = pair_difference(evaluation.pairs, name, inputs.learner, metric, counting)
    cells = [
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


def distances(inputs: ReportInputs) -> Iterator[Block]:
    evaluation = inputs.evaluation
    images = panels.distance_panels(inputs)
    if not images:
        return
    words = inputs.words
    yield Gallery(
        images,
        words.say(
            "Kernel-density distance between simulated and recorded values (0: the same "
            "distribution, 2: disjoint), all episodes, with its 95 % interval. Grey: what "
            "recordings against recordings give at the same sample sizes, central 95 % and mean. A "
            "value inside the grey cannot be told from chance at this sample size; the distance is "
            "biased upwards, and so is its interval."
        ),
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
                    with_interval(interval(row, "kde")),
                    with_interval(interval(row, "kde_null")),
                    with_interval(words.interval(row, "wasserstein", metric)),
                    with_interval(words.interval(row, "wasserstein_null", metric)),
                ]
                lines.append(Row(cells, strong=name == inputs.learner))
            title = f"{metric.label} ({words.unit_of(metric)}), {COUNTING[counting]}"
            groups.append(Group(title, lines))
    yield Table(
        words.say("Distances to the recordings"),
        [
            "Method",
            "Episodes",
            "Kernel-density\ndistance",
            "null\nreference",
            "Wasserstein\ndistance",
            "null\nreference",
        ],
        groups,
        "Both distances [95 % interval], each beside its null reference [central 95 %] from "
        f"{evaluation.distance_resamples:,} resamples. The kernel-density distance lies between 0 "
        "and 2; the Wasserstein distance has the metric's unit. Its null samples are independent, "
        "where rollouts from one start are not.",
    )


def contrasts(inputs: ReportInputs) -> Iterator[Block]:
    contrasts, words = inputs.evaluation.contrasts, inputs.words
    if contrasts.empty:
        return
    groups = []
    for key, rows in contrasts.groupby("metric", sort=False):
        metric = next(m for m in METRICS if m.key == key)
        gate = rows.iloc[0]
        passed = "passed" if gate["gate_passed"] else "not passed"
        title = (
            f"{metric.label}: gate {passed} (F = {number(gate['gate_f'])}, permutation "
            f"p = {number(gate['gate_p'], 2)} over {gate['gate_unit']}); "
            f"differences in {words.unit_of(metric)}"
        )
        lines = [
            Row(
                [
                    f"{method_label(row['first'])} {wording.MINUS} {method_label(row['second'])}",
                    with_interval(words.interval(row, "difference", metric)),
                ],
                faint=not row["gate_passed"],
            )
            for _, row in rows.iterrows()
        ]
        groups.append(Group(title, lines))
    yield Table(
        "Planned contrasts",
        ["Contrast", words.say("Difference of the gaps to the recordings")],
        groups,
        words.say(
            "The contrasts planned in advance, all episodes. Compared is the absolute gap "
            "between a rollout's start-wise mean and the recording (for DTW the distance itself); "
            "below zero, the first method is closer. Contrasts behind a gate that was not passed "
            "are pale and should not be read."
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
        "same networks."
    )
    yield Gallery(
        panels.counterfactual_panels(inputs, names),
        words.say(
            "Mean path length with 95 % interval, all episodes: recorded (square), simulated "
            "(dot), and simulated with the cue flipped (arrow, ringed diamond)."
        ),
    )
    quantities = {
        DIFFERENCE: f"{names[0]} {wording.MINUS} {names[1]}",
        ERROR: "absolute error",
        SHIFT: "cue flipped",
        WORLD_SHIFT: "world changed",
    }
    groups = []
    for counting in COUNTING:
        lines = []
        for _, row in table[table["counting"] == counting].iterrows():
            if row["quantity"] not in quantities:
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
                        words.label(str(row["method"])),
                        quantities[row["quantity"]],
                        where,
                        with_interval(words.interval(row, "value", PATH_LENGTH)),
                        "planned" if row["planned"] else "",
                    ],
                    strong=bool(row["planned"]),
                )
            )
        groups.append(Group(COUNTING[counting].capitalize(), lines))
    yield Table(
        "Counterfactual path lengths",
        ["Method", "Quantity", "Condition", f"Path length\n({words.unit_of(PATH_LENGTH)})", ""],
        groups,
        "Differences and errors of the mean path length [95 % interval]. An absolute error is "
        "never negative, so its interval cannot include zero.",
        left=3,
    )


def condition_names(inputs: ReportInputs) -> tuple[str, str]:
    """Names of conditions 0 and 1, as given or by number."""
    names = tuple(inputs.conditions[:2])
    return (names[0], names[1]) if len(names) == 2 else ("condition 0", "condition 1")
