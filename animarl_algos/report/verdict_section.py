"""The verdict as the first section of the page, as a picture, and as lines of a terminal."""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, Literal

from rich.box import SIMPLE_HEAD
from rich.table import Table as TerminalTable
from rich.text import Text

from animarl_algos.evaluation.classifier import AUC, LITTLE_AUC, SEQUENCE
from animarl_algos.evaluation.comparison import COUNTING, ENERGY, Evaluation
from animarl_algos.evaluation.conditions import ComparedConditions
from animarl_algos.evaluation.headline import compare_with_law, detectable_changes
from animarl_algos.evaluation.metrics import KINDS, METRICS, PATH_LENGTH, Metric
from animarl_algos.evaluation.realism import CEILING, REFERENCES
from animarl_algos.evaluation.statistics import Interval, interval
from animarl_algos.evaluation.verdict import Verdict
from animarl_algos.evaluation.verdict_rows import (
    ALIKE,
    CONTROLS,
    DIFFERS,
    LITTLE,
    UNKNOWN,
    Row,
    farness,
    figures,
    lower_first,
)
from animarl_algos.report.figures import forest, rank_histograms
from animarl_algos.report.page import Block, Gallery, Lead, Table, tabulate
from animarl_algos.report.style import method_label, to_image
from animarl_algos.report.words import NOTHING, Words, number, pick, with_interval

MARKS = {ALIKE: "\u2248", LITTLE: "~", DIFFERS: "\u2260", UNKNOWN: "?"}
"""Signs of the words, for readers who do not see colours."""
SHARE = "share"  # the unit of what is shown in percent
FARTHEST = 3  # rows on the terminal
CALLED = {CEILING: "the recording itself"}
BESIDE = {
    "among": "recordings among themselves",
    "floor": "closed-loop tracking of the recordings (perfect control in this locomotion)",
    "ceiling": "random actions",
}
DEMONSTRATED = Words(synthetic=True)
"""Where nobody says what the demonstrations are, they are called that."""


# -- in words -------------------------------------------------------------------------------------


def verdict_lead(verdict: Verdict, words: Words, cautions: Sequence[str] = ()) -> Lead:
    """Return the headline and what it rests on."""
    return Lead(
        verdict.judgement,
        verdict.colour,
        MARKS[verdict.judgement],
        words.adapt(_headline(verdict)),
        [words.adapt(sentence) for sentence in _evidence(verdict)],
        cautions,
    )


def verdict_sentence(verdict: Verdict, words: Words = DEMONSTRATED) -> str:
    """Return the verdict in a few sentences."""
    return words.adapt(" ".join([_headline(verdict), *_evidence(verdict)]))


def verdict_lines(verdict: Verdict, words: Words = DEMONSTRATED) -> list[str]:
    """Return what the terminal prints: the headline, the rows farthest from alike, the classifier.

    Each of these rows has both values and the unit.
    """
    lines = [_headline(verdict)]
    rows = [row for row in verdict.rows() if row.measure not in (AUC, SEQUENCE)]
    rows = [row for row in rows if row.judgement != ALIKE and math.isfinite(row.value)]
    for row in sorted(rows, key=farness, reverse=True)[:FARTHEST]:
        one, other = figures(row.unit, row.simulated, row.recorded)
        unit = "%" if row.unit == SHARE else row.unit
        values = f"{lower_first(row.label)} {one} for {other} {unit}".rstrip()
        lines.append(f"  {MARKS[row.judgement]} {values} ({row.judgement})")
    return [words.adapt(line) for line in [*lines, *_evidence(verdict)[:1]]]


def _headline(verdict: Verdict) -> str:
    return f"{method_label(verdict.learner)}: {lower_first(verdict.headline)}"


def _evidence(verdict: Verdict) -> list[str]:
    """Return sentences on the classifier, on what would have been seen, and on a simple law."""
    rows, sentences = verdict.rows(), []
    if math.isfinite(verdict.auc.estimate):
        wrong = 100 * (1 - verdict.auc.estimate)
        sentences.append(
            f"A classifier takes the simulated piece for the recorded one in {wrong:.0f} of 100 "
            "pairs (50: chance)."
        )
    if changes_by_name := detectable_changes(rows):
        changes = [f"{name} {100 * part:.0f} %" for name, part in changes_by_name.items()]
        sentences.append(f"Smallest changes that so many recordings show: {', '.join(changes)}.")
    if beside_law := compare_with_law(rows):
        sentences.append(beside_law)
    return sentences


# -- as tables and pictures -----------------------------------------------------------------------


def verdict_blocks(verdict: Verdict, words: Words = DEMONSTRATED) -> Iterator[Block]:
    """Yield the picture of all questions, their table and, folded, the realism score."""
    strip = forest(forest_rows(verdict), words.adapt)
    images = [to_image(strip, words.adapt("Difference of every question in its tolerances"))]
    caption = (
        "Each question as the difference of simulated and recorded, in units of its tolerance, "
        "with its interval; within the band it is alike. Arrows leave the picture."
    )
    if verdict.ranks and math.isfinite(verdict.rank_p):
        images.append(
            to_image(rank_histograms(verdict.ranks), words.adapt("Ranks of the recordings"))
        )
        caption += (
            " Beside it the rank of each recording among the rollouts from its start (Besag and "
            "Clifford 1989): uniform for a perfect simulator, high at both ends where rollouts are "
            "too much alike. A perfect simulator's ranks are as uneven in "
            f"{100 * verdict.rank_p:.2g} % of experiments."
        )
    yield Gallery(images, words.adapt(caption))
    yield replace(verdict_as_table(verdict, words), folded="All numbers of the verdict")
    scores = verdict.components
    if scores is None or scores.empty:
        return
    columns: dict[str, Any] = {
        "Weight": lambda row: number(row["weight"], 2),
        "Score\n[95 %]": lambda row: with_interval(interval(row)),
    }
    for one in REFERENCES:
        columns[words.adapt(CALLED.get(one, one)).capitalize()] = lambda row, one=one: number(
            row.get(one, math.nan)
        )
    whole = scores["component"].fillna("") == ""
    yield tabulate(
        "Realism",
        {"Kind": lambda row: lower_first(KINDS.get(row["kind"], row["kind"])), **columns},
        [("", scores[whole][::-1])],
        words.adapt(
            "How likely the recordings are under the rollouts from their own start, from 0 to 1 "
            "(after the Waymo Open Sim Agents Challenge, Montali et al. 2023). Beside it, in place "
            "of the rollouts: the recording itself, other recordings, and random actions."
        ),
        strong=lambda row: row["kind"] == "total",
        folded="Realism score",
    )
    yield tabulate(
        "Realism by component",
        {"Component": lambda row: str(row["component"]), **columns},
        [("", scores[~whole])],
        "Components of a kind weigh alike.",
        folded="Realism by component",
    )


def forest_rows(verdict: Verdict) -> list[tuple[str, str, float, float, float]]:
    """Return label, word and difference with interval in tolerances, the farthest row last."""
    return [
        (row.label, row.judgement, *_in_tolerances(row))
        for row in sorted(verdict.rows(), key=farness)
    ]


def _in_tolerances(row: Row) -> tuple[float, float, float]:
    """Return difference and interval of a row divided by its tolerance."""
    if not row.tolerance > 0:
        return math.nan, math.nan, math.nan
    zero = 0.5 if row.measure in (AUC, SEQUENCE) else 0.0
    value, low, high = ((end - zero) / row.tolerance for end in (row.value, row.low, row.high))
    return value, low, high


def verdict_as_table(verdict: Verdict, words: Words) -> Table:
    """Return one row per question, those that are alike faint."""
    controls = [key for key in CONTROLS if key in verdict.table]
    return _rows_as_table(
        verdict.rows(),
        (words.adapt("Recorded"), "Simulated"),
        words.adapt(_caption(verdict)),
        words.adapt,
        controls,
    )


def conditions_as_table(compared: ComparedConditions) -> Table:
    """Return one row per question, of recordings of two conditions."""
    caption = (
        f"{compared.names[1]} minus {compared.names[0]}: means over recordings, and their "
        "difference with an interval; all intervals together hold the truth in 97 % of experiments."
    )
    return _rows_as_table(compared.rows, compared.names, caption)


def _rows_as_table(
    rows: Sequence[Row],
    sides: tuple[str, str],
    caption: str,
    say: Callable[[str], str] = str,
    controls: Sequence[str] = (),
) -> Table:
    areas = (AUC, SEQUENCE)

    def scaled(key: str) -> Callable[[Row], str]:
        return lambda row: number((100.0 if row.unit == SHARE else 1.0) * getattr(row, key))

    def question(row: Row) -> str:
        unit = "%" if row.unit == SHARE else row.unit
        return f"{row.label} ({unit})" if unit else row.label

    def difference(row: Row) -> str:
        return with_interval(Interval(row.value, row.low, row.high), row.unit == SHARE)

    def tolerance(row: Row) -> str:
        if row.measure in areas:
            return f"{LITTLE_AUC:.2f}"
        return f"\u00b1{scaled('tolerance')(row)}" if row.tolerance > 0 else NOTHING

    return tabulate(
        "Verdict",
        {
            "Question": question,
            "Verdict": lambda row: say(row.verdict),
            sides[0]: scaled("recorded"),
            sides[1]: scaled("simulated"),
            "Difference\n[95 %]": difference,
            "Tolerance": tolerance,
            **{key.title(): scaled(key) for key in controls},
        },
        [("", rows)],
        caption,
        left=2,
        faint=lambda row: row.judgement == ALIKE,
    )


def _caption(verdict: Verdict) -> str:
    text = (
        f"{verdict.rollouts} rollouts from {verdict.starts} starts in {verdict.recordings} "
        "recordings. Means over recordings, and their difference with an interval: all intervals "
        "together hold the truth in 95 % of experiments. Alike: the interval lies within the "
        "tolerance. Differs: it excludes zero, and the difference is larger than the tolerance. "
        "Not known: neither. Of each kind the measure farthest from alike is shown. For the "
        f"classifiers: the area under the curve (.5: chance), alike up to {LITTLE_AUC:.2f}."
    )
    if "law" in verdict.table:
        text += " Law: persistent random walkers that turn towards their focus, fitted to"
        text += f" recordings. {compare_with_law(verdict.rows())}"
    if "strangers" in verdict.table:
        text += " Strangers: recorded animals of different episodes put together, without reactions"
        text += " to each other."
    if "blind" in verdict.table:
        text += " Blind: the same clone, where each animal is shown another one's neighbours."
    for key, name in ((AUC, "the first classifier"), (SEQUENCE, "that of order")):
        areas = verdict.areas.get(key, {})
        parts = [
            f"{with_interval(areas[one])} for {what}"
            for one, what in BESIDE.items()
            if one in areas and math.isfinite(areas[one].estimate)
        ]
        text += f" The area of {name} is {' and '.join(parts)}." if parts else ""
    if verdict.smoothing > 1:
        text += (
            " All positions, simulated ones too, went through a moving average of "
            f"{verdict.smoothing} frames first."
        )
    return text


def comparison_as_table(
    evaluation: Evaluation, words: Words, countings: Sequence[str], learner: str | None = None
) -> Table:
    """Return one row per method, of each of the rules in ``countings`` of which episodes count."""
    comparison = evaluation.comparison
    metrics = [m for m in METRICS if m.heading and (comparison["measure"] == m.key).any()]

    def format_rows(
        metric: Metric, write: Callable[[Any], str], of: str = ""
    ) -> Callable[[tuple[str, str]], str]:
        def cell(one: tuple[str, str]) -> str:
            counting = "all" if metric.share else one[1]
            row = pick(comparison, method=one[0], measure=of + metric.key, counting=counting)
            return "" if row is None else write(row)

        return cell

    def energy(row: Any, factor: float) -> str:
        score, pooled = (factor * float(row[key]) for key in ("value", "null"))
        return f"{number(score)} ({number(pooled)})" if math.isfinite(score) else ""

    columns: dict[str, Callable[[Any], str]] = {
        "method": lambda one: words.label(one[0]),
        "n": format_rows(PATH_LENGTH, lambda row: str(int(row["rollouts"]))),
    }
    for metric in metrics:
        unit = f"\n({words.unit_of(metric)})" if metric.is_length else ""
        columns[metric.heading + unit] = format_rows(
            metric, partial(words.format_value, metric=metric)
        )
        if metric.has_distribution:
            columns[ENERGY + metric.heading.partition(",")[0]] = format_rows(
                metric, partial(energy, factor=words.factor(metric)), ENERGY
            )
    names = [str(name) for name in comparison["method"].unique()]
    return tabulate(
        "Comparison",
        columns,
        [(COUNTING[rule].capitalize(), [(name, rule) for name in names]) for rule in countings],
        words.adapt(
            "Mean [95 % interval] over recordings and training seeds; n: episodes. Energy: energy "
            "score, in brackets what recordings of the other starts score; below it a simulator "
            "uses its start."
        ),
        strong=lambda one: one[0] == learner,
    )


# -- on the terminal ------------------------------------------------------------------------------


def verdict_table(verdict: Verdict, words: Words = DEMONSTRATED) -> TerminalTable:
    """Return the verdict for the terminal."""
    table = verdict_as_table(verdict, words)
    return terminal_table(table, verdict_sentence(verdict, words), wrapped=True)


def evaluation_table(evaluation: Evaluation, words: Words = DEMONSTRATED) -> TerminalTable:
    """Return the comparison for the terminal."""
    table = comparison_as_table(evaluation, words, ["all"])
    title = words.adapt(f"Simulated against recorded, {COUNTING['all']}")
    return terminal_table(table, title, wrapped=False)


def terminal_table(table: Table, title: str, *, wrapped: bool) -> TerminalTable:
    """Return a table of one group for the terminal.

    Cells may be wrapped, and rows are bold or faint; where they are not, intervals stand below
    means.
    """
    made = TerminalTable(
        title=Text(title), caption=Text(table.caption), box=SIMPLE_HEAD, padding=(0, 1)
    )
    for i, heading in enumerate(table.columns):
        justify: Literal["left", "right"] = "left" if i < table.left else "right"
        made.add_column(heading, justify=justify, no_wrap=not wrapped)
    for row in table.groups[0].rows:
        cells = row.cells if wrapped else [cell.replace(" [", "\n[") for cell in row.cells]
        made.add_row(*map(Text, cells), style=("dim" if row.faint else "bold") if wrapped else "")
    return made
