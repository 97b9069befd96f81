"""How far the simulated distributions are from the recorded ones, as a section of the page."""

from __future__ import annotations

from collections.abc import Iterator

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
    words = inputs.words
    yield Gallery(
        images,
        words.say(
            "Kernel-density distance between simulated and recorded values (0: the same "
            "distribution, 2: disjoint), all episodes, with the central 95 % of its resamples. "
            "Grey: what a perfect simulator gives at the same sample sizes, central 95 % and mean. "
            "A value inside the grey cannot be told from chance at this sample size; the distance "
            "is biased upwards, and so is its interval."
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
                    with_interval(words.interval(row, "energy", metric)),
                    number(words.factor(metric) * row["energy_pooled"]),
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
            "Energy\nscore",
            "other\nstarts",
            "Kernel-density\ndistance",
            "null\nreference",
            "Wasserstein\ndistance",
            "null\nreference",
        ],
        groups,
        words.say(
            "The energy score per start, the primary measure, beside what the recordings of all "
            "other starts score: the smaller the better, and a simulator that always does the same "
            "cannot win by it. Both distances [central 95 % of resamples: spread, not centred], "
            "each beside its null reference [central 95 %], from "
            f"{evaluation.distance_resamples:,} resamples. The kernel-density "
            "distance lies between 0 and 2; the Wasserstein distance has the metric's unit. Null: "
            "what both come to if the recorded episode of every start is exchanged with one of its "
            f"rollouts, which a perfect simulator would not notice.{_floors(inputs)}"
        ),
    )


def _floors(inputs: ReportInputs) -> str:
    """Where the smallest bandwidth acts, and so makes the kernel-density distance."""
    comparison, words = inputs.evaluation.comparison, inputs.words
    acts = comparison[comparison["kde_floor"].notna()]
    if acts.empty:
        return ""
    by_key = {metric.key: metric for metric in METRICS}
    places = []
    for _, row in acts.iterrows():
        metric = by_key[row["metric"]]
        floor = number(words.factor(metric) * row["kde_floor"], 2)
        places.append(
            f"{method_label(str(row['method']))}, {metric.label.lower()}, "
            f"{COUNTING[row['counting']]} ({floor} {words.unit_of(metric)})"
        )
    return (
        " Values hardly vary, so that the smallest bandwidth decides on the kernel-density "
        f"distance, of: {'; '.join(places)}."
    )
