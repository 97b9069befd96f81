"""The verdict as the first section of the page, as its headline, and as a sentence."""

import math
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.table import Table as TerminalTable
from rich.text import Text

from animarl_algos.evaluation.classifier import AUC, FEWEST_DEMOS, SEQUENCE
from animarl_algos.evaluation.comparison import COUNTING, ENERGY, Evaluation
from animarl_algos.evaluation.metrics import METRICS, PATH_LENGTH, Metric
from animarl_algos.evaluation.prepared import WINDOW
from animarl_algos.evaluation.realism import REFERENCES
from animarl_algos.evaluation.statistics import interval
from animarl_algos.evaluation.verdict import Verdict
from animarl_algos.evaluation.verdict_rows import (
    BY_LITTLE,
    CONTROLS,
    DIFFERS,
    KINDS,
    LEVEL,
    OUTCOMES,
    SAME,
    UNKNOWN,
)
from animarl_algos.report.page import Block, Lead, Table, tabulate
from animarl_algos.report.style import method_label
from animarl_algos.report.words import NOTHING, Words, capitalised, number, pick, with_interval

SIGNS = {
    SAME: ("green", "\u2248"), BY_LITTLE: ("amber", "~"), DIFFERS: ("red", "\u2260"),
    UNKNOWN: ("grey", "?"),
}  # fmt: skip
"""Colour and mark of a judgement."""
HEADLINES = {
    SAME: "{learner} is not distinguishable from the recordings at this sample size ({size})",
    BY_LITTLE: "{learner} differs from the recordings, but by little ({size})",
    DIFFERS: "{learner} differs from the recordings ({size})",
    UNKNOWN: "Too little data to say whether {learner} moves like the recordings ({size}{why})",
}
SHARE = "share"  # the unit of what is told in percent
BESIDE = {
    "floor": "closed-loop tracking of the recordings (perfect control in this locomotion)",
    "ceiling": "random actions",
}
DEMONSTRATED = Words(synthetic=True)
"""Where nobody says what the demonstrations are, they are called that."""


# -- in words -------------------------------------------------------------------------------------


def verdict_lead(verdict: Verdict, words: Words, cautions: Sequence[str] = ()) -> Lead:
    """Return the verdict as a line and what it rests on, every figure with its interval."""
    details = [*map(capitalised, _differences(verdict)), *_scores(verdict)]
    return Lead(
        verdict.judgement,
        *SIGNS[verdict.judgement],
        words.say(f"{_headline(verdict)}."),
        [words.say(f"{detail}.") for detail in details],
        cautions,
    )


def verdict_sentence(verdict: Verdict, words: Words = DEMONSTRATED) -> str:
    """Return the verdict in one sentence, with the intervals that it rests on."""
    differences = ", ".join(_differences(verdict))
    found = f"{_headline(verdict)}{f': {differences}' if differences else ''}"
    return words.say(f"{'. '.join([found, *_scores(verdict)])}.")


def _headline(verdict: Verdict) -> str:
    return HEADLINES[verdict.judgement].format(
        learner=method_label(verdict.learner),
        size=f"{verdict.rollouts} rollouts from {verdict.starts} "
        f"start{'s' * (verdict.starts != 1)}",
        why=f"; {verdict.too_little}" if verdict.too_little else "",
    )


def _scores(verdict: Verdict) -> Iterator[str]:
    if math.isfinite(verdict.auc.estimate):
        yield (
            "A classifier ranks a simulated window above a recorded one in "
            f"{with_interval(verdict.auc, percent=True)} % of pairs (50: chance)"
        )
    if math.isfinite(verdict.realism.estimate):
        beside = ", ".join(f"{name} {number(v)}" for name, v in verdict.realism_beside.items())
        yield f"Realism {with_interval(verdict.realism)}{f' ({beside})' if beside else ''}"


def _differences(verdict: Verdict) -> Iterator[str]:
    """What differs, each with the figure it rests on; nothing where nothing does."""
    rows = [row for _, row in verdict.table.iterrows()]
    for word in verdict.words:
        if word != SAME:
            row = next((row for row in rows if row["verdict"] == word), None)
            told = row is None or row["measure"] in KINDS  # whose words hold the figure
            evidence = "" if told else _evidence(row)
            yield f"{word} ({evidence})" if evidence else word


def _evidence(row: Any) -> str:
    """The difference with its interval; where it might be none, also the distance and its null."""
    scale, unit = _scale(row)
    gap = interval(row)
    points = "percentage points" if unit == "%" else unit
    parts = []
    if math.isfinite(gap.estimate):
        parts.append(f"difference {with_interval(gap, unit == '%')} {points}".rstrip())
    if not (math.isfinite(gap.low) and gap.excludes_zero):
        null = f"by chance up to {number(scale * row['null'])}"
        parts.append(f"distance {number(scale * row['distance'])}, {null} {points}".rstrip())
    return "; ".join(parts)


def _scale(row: Any) -> tuple[float, str]:
    """By what the row's numbers are multiplied, and the unit they then have."""
    return (100.0, "%") if row["unit"] == SHARE else (1.0, str(row["unit"]))


# -- as tables and pictures -----------------------------------------------------------------------


def verdict_blocks(verdict: Verdict, words: Words = DEMONSTRATED) -> Iterator[Block]:
    """Yield the table and the realism score by kind and, folded, by component."""
    yield verdict_as_table(verdict, words)
    scores = verdict.components
    if scores is None or scores.empty:
        return
    columns: dict[str, Any] = {
        "Weight": lambda row: number(row["weight"], 2),
        "Score\n[95 %]": lambda row: with_interval(interval(row)),
    }
    for one in REFERENCES:
        columns[words.say(one).capitalize()] = lambda row, one=one: number(row.get(one, math.nan))
    whole = scores["component"].fillna("") == ""
    yield tabulate(
        "Realism",
        {"Kind": lambda row: str(row["kind"]), **columns},
        [("", scores[whole][::-1])],
        words.say(
            "How likely the recordings are under the rollouts from their own start, from 0 to 1 "
            "(after the Waymo Open Sim Agents Challenge, Montali et al. 2023). Beside it: the "
            "recording itself in place of its rollouts, other recordings, and random actions."
        ),
        strong=lambda row: row["kind"] == "total",
    )
    yield tabulate(
        "Realism by component",
        {"Component": lambda row: str(row["component"]), **columns},
        [("", scores[~whole])],
        "Components of a kind weigh alike.",
        folded="Realism by component",
    )


def verdict_as_table(verdict: Verdict, words: Words) -> Table:
    """Return one row per question, those that find nothing faint."""
    judges = (AUC, SEQUENCE)

    def scaled(key: str) -> Any:
        return lambda row: number(_scale(row)[0] * row[key])

    def value(row: Any) -> str:
        return with_interval(interval(row), _scale(row)[1] == "%")

    return tabulate(
        "Verdict",
        {
            "Question": lambda row: row["label"] + (f" ({_scale(row)[1]})" if row["unit"] else ""),
            "Verdict": lambda row: words.say(str(row["verdict"])),
            words.say("Recorded"): scaled("recorded"),
            "Simulated": lambda row: (
                value(row) if row["measure"] in judges else scaled("simulated")(row)
            ),
            "Difference\n[95 %]": lambda row: (
                NOTHING if row["measure"] in (*judges, OUTCOMES) else value(row)
            ),
            "Distance": scaled("distance"),
            "Null": scaled("null"),
            **{key.title(): scaled(key) for key in CONTROLS if key in verdict.table},
        },
        [("", verdict.table)],
        words.say(_caption(verdict)),
        left=2,
        faint=lambda row: row["judgement"] == SAME,
    )


def _caption(verdict: Verdict) -> str:
    said = (
        "Means over episodes and their difference [95 % interval]. Distance: the difference that "
        "is tested, of means or of spreads. Null: what all distances together stay below in "
        f"{100 * (1 - LEVEL):.0f} % of cases if the recorded episode of each start is exchanged "
        "with one of its rollouts. For the classifiers: recordings among themselves. Of each kind "
        "of order the measure that differs most is told."
    )
    if "strangers" in verdict.table:
        said += " Strangers: recorded animals of different episodes put together, a group without"
        said += " reactions."
    if "blind" in verdict.table:
        said += " Blind: the same clone, where each animal is shown another one's neighbours."
    for key, name in ((AUC, "classifier's AUC"), (SEQUENCE, "AUC of order")):
        areas = verdict.areas.get(key, {})
        told = [
            f"{with_interval(areas[one])} for {what}"
            for one, what in BESIDE.items()
            if one in areas and math.isfinite(areas[one].estimate)
        ]
        said += f" The {name} is {' and '.join(told)}." if told else ""
    falls = sorted(verdict.importance.items(), key=lambda item: -item[1])
    if falls:
        told = [f"{number(fall, 2)} ({kind})" for kind, fall in falls]
        said += f" Shuffling one kind of feature lowers the AUC on {WINDOW:g} s by "
        said += f"{', '.join(told)}."
    if verdict.starts < FEWEST_DEMOS:
        said += " There are few demonstrations, so the classifier's intervals are of parts of them."
    if verdict.smoothing > 1:
        said += (
            " All positions, simulated ones too, went through a moving average of "
            f"{verdict.smoothing} frames first."
        )
    return said


def comparison_as_table(
    evaluation: Evaluation, words: Words, countings: Sequence[str], learner: str | None = None
) -> Table:
    """Return one row per method, of each of the rules in ``countings`` of which episodes count."""
    comparison = evaluation.comparison
    shown = [m for m in METRICS if m.heading and (comparison["measure"] == m.key).any()]

    def told(
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
        "n": told(PATH_LENGTH, lambda row: str(int(row["rollouts"]))),
    }
    for metric in shown:
        unit = f"\n({words.unit_of(metric)})" if metric.is_length else ""
        columns[metric.heading + unit] = told(metric, partial(words.told, metric=metric))
        if metric.has_distribution:
            columns[ENERGY + metric.heading.partition(",")[0]] = told(
                metric, partial(energy, factor=words.factor(metric)), ENERGY
            )
    names = [str(name) for name in comparison["method"].unique()]
    return tabulate(
        "Comparison",
        columns,
        [(COUNTING[rule].capitalize(), [(name, rule) for name in names]) for rule in countings],
        words.say(
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
    title = words.say(f"Simulated against recorded, {COUNTING['all']}")
    return terminal_table(table, title, wrapped=False)


def terminal_table(table: Table, title: str, *, wrapped: bool) -> TerminalTable:
    """Return a table of one group for the terminal.

    Columns of words may be wrapped, and rows are bold or faint; where they are not, intervals stand
    below means.
    """
    made = TerminalTable(
        title=Text(title), caption=Text(table.caption), box=SIMPLE_HEAD, padding=(0, 1)
    )
    words = table.left if wrapped else 0
    for i, heading in enumerate(table.columns):
        left = i < table.left
        made.add_column(heading, justify="left" if left else "right", no_wrap=i >= words)
    for row in table.groups[0].rows:
        cells = row.cells if wrapped else [cell.replace(" [", "\n[") for cell in row.cells]
        made.add_row(*map(Text, cells), style=("dim" if row.faint else "bold") if wrapped else "")
    return made
