"""The verdict as the first section of the page, as a sentence, and as a table for the terminal."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from animarl_algos.evaluation.classifier_row import AUC, SEQUENCE
from animarl_algos.evaluation.statistics import UNDEFINED, Interval
from animarl_algos.evaluation.verdict import REFERENCES, Verdict
from animarl_algos.evaluation.verdict_rows import BY_LITTLE, DIFFERS, LEVEL, SAME, UNKNOWN
from animarl_algos.evaluation.windows import WINDOW
from animarl_algos.report import figures
from animarl_algos.report.blocks import Block, Gallery, Group, Row, Table, Text
from animarl_algos.report.sentences import NOTHING, number, with_interval
from animarl_algos.report.style import Image, method_label, to_image
from animarl_algos.report.words import Words
from animarl_envs.errors import MissingExtraError

if TYPE_CHECKING:
    from rich.table import Table as TerminalTable

COLUMNS = (
    "Question", "Recorded", "Simulated", "Difference\n[95 %]", "Distance", "Null",
    "Verdict",
)  # fmt: skip
COLOURS = {SAME: "green", BY_LITTLE: "amber", DIFFERS: "red", UNKNOWN: "grey"}
MARKS = {SAME: "\u2248", BY_LITTLE: "~", DIFFERS: "\u2260", UNKNOWN: "?"}
SIZE = " at this sample size"
SHARE = "share"  # the unit of what is told in percent
BESIDE = {
    "floor": "closed-loop tracking of the recordings (perfect control in this locomotion)",
    "ceiling": "random actions",
}
HEADLINES = {
    SAME: "{learner} is not distinguishable from the recordings" + SIZE + " ({size})",
    BY_LITTLE: "{learner} differs from the recordings, but by little ({size})",
    DIFFERS: "{learner} differs from the recordings ({size})",
    UNKNOWN: "Too little data to say whether {learner} moves like the recordings ({size}{why})",
}
DEMONSTRATED = Words(synthetic=True)
"""Where nobody says what the demonstrations are, they are called that."""


@dataclass(frozen=True)
class Lead:
    """What stands at the top of the page: the judgement, what differs, how surely, what limits it.

    The ``judgement`` is one of :data:`~animarl_algos.evaluation.verdict_rows.JUDGEMENTS`.
    """

    judgement: str
    headline: str
    details: Sequence[str]
    cautions: Sequence[str] = ()

    @property
    def colour(self) -> str:
        """Green, amber, red, or grey where there is too little data."""
        return COLOURS[self.judgement]

    @property
    def mark(self) -> str:
        """A sign for the judgement, for readers who do not see colours."""
        return MARKS[self.judgement]


def verdict_lead(verdict: Verdict, words: Words, cautions: Sequence[str] = ()) -> Lead:
    """The verdict as a line and what it rests on, every figure with its interval."""
    details = [f"{word[:1].upper()}{word[1:]}." for word in _differences(verdict)]
    if math.isfinite(verdict.auc.estimate):
        details.append(f"{_classifier(verdict)}.")
    if math.isfinite(verdict.realism.estimate):
        details.append(f"{_realism(verdict)}.")
    return Lead(
        verdict.judgement,
        words.say(f"{_headline(verdict)}."),
        [words.say(detail) for detail in details],
        cautions,
    )


def _headline(verdict: Verdict) -> str:
    return HEADLINES[verdict.judgement].format(
        learner=method_label(verdict.learner),
        size=f"{verdict.rollouts} rollouts from {verdict.starts} starts",
        why=f"; {verdict.too_little}" if verdict.too_little else "",
    )


def verdict_blocks(verdict: Verdict, words: Words = DEMONSTRATED) -> Iterator[Block]:
    """Sentence, table and the two figures of the classifier."""
    say = words.say
    yield Text(verdict_sentence(verdict, words))
    lines = [
        Row(cells, faint=row["judgement"] == SAME) for row, cells in verdict_lines(verdict, words)
    ]
    columns = [say(column) for column in COLUMNS]
    yield Table("Verdict", columns, [Group("", lines)], say(_caption(verdict)))
    yield Gallery(list(_pictures(verdict)), say(_classifier_caption(verdict)))
    yield from _realism_blocks(verdict, say)
    energies = [
        Row([_asked(row), number(row["energy"]), number(row["energy_pooled"])])
        for _, row in verdict.table.iterrows()
        if math.isfinite(row["energy"])
    ]
    if energies:
        yield Table(
            "Energy score",
            ["Question", "Energy score", "other starts"],
            [Group("", energies)],
            "Mean energy score per start (continuous ranked probability score; the smaller the "
            "better, unbiased), which a simulator cannot lower by always returning the same value. "
            "Beside it the score of the demonstrations of all other starts, taken as if they were "
            "rollouts: below it, the simulator knows something of its start.",
        )


def _realism_blocks(verdict: Verdict, say: Callable[[str], str]) -> Iterator[Block]:
    """The realism score by component, beside what it is read by."""
    table = verdict.components
    if table is None or table.empty:
        return
    kinds: list[Row] = []
    components: list[Row] = []
    for _, row in table.iterrows():
        name = str(row["component"]) if isinstance(row["component"], str) else ""
        score = Interval(row["score"], row["low"], row["high"])
        cells = [name or str(row["kind"]), number(row["weight"], 2), with_interval(score)]
        cells += [number(row[one]) if one in row else NOTHING for one in REFERENCES]
        (components if name else kinds).append(Row(cells, strong=row["kind"] == "total"))
    columns = ["Kind", "Weight", "Score\n[95 %]", *(say(one).capitalize() for one in REFERENCES)]
    yield Table(
        "Realism",
        columns,
        [Group("", kinds[::-1])],
        say(
            "How likely the recordings are under the rollouts from their own start, from 0 to 1 "
            "(after the Waymo Open Sim Agents Challenge, Montali et al. 2023). Beside it: the "
            "recording itself in place of its rollouts, other recordings, and random actions."
        ),
    )
    yield Table(
        "Realism by component",
        ["Component", *columns[1:]],
        [Group("", components)],
        "Components of a kind weigh alike.",
        folded="Realism by component",
    )


def verdict_sentence(verdict: Verdict, words: Words = DEMONSTRATED) -> str:
    """The verdict in one sentence, with the intervals that it rests on."""
    differences = ", ".join(_differences(verdict))
    found = f"{_headline(verdict)}{f': {differences}' if differences else ''}"
    auc = f". {_classifier(verdict)}" if math.isfinite(verdict.auc.estimate) else ""
    score = f". {_realism(verdict)}" if math.isfinite(verdict.realism.estimate) else ""
    return words.say(f"{found}{auc}{score}.")


def _realism(verdict: Verdict) -> str:
    beside = ", ".join(f"{name} {number(v)}" for name, v in verdict.realism_beside.items())
    return f"Realism {with_interval(verdict.realism)}{f' ({beside})' if beside else ''}"


def _classifier(verdict: Verdict) -> str:
    return (
        "A classifier ranks a simulated window above a recorded one in "
        f"{with_interval(verdict.auc, percent=True)} % of pairs (50: chance)"
    )


def _differences(verdict: Verdict) -> Iterator[str]:
    """What differs, each with the figure it rests on; nothing where nothing does."""
    rows = [row for _, row in verdict.table.iterrows()]
    for word in verdict.words:
        if word == SAME:
            continue
        row = next((row for row in rows if row["verdict"] == word), None)
        evidence = "" if row is None else _evidence(row)
        yield f"{word} ({evidence})" if evidence else word


def _evidence(row: Any) -> str:
    """The difference with its interval; where it might be none, also the distance and its null."""
    scale, unit = _scale(row)
    gap = Interval(row["difference"], row["difference_low"], row["difference_high"])
    points = "percentage points" if unit == "%" else unit
    parts = []
    if math.isfinite(gap.estimate):
        parts.append(f"difference {with_interval(gap, unit == '%')} {points}".rstrip())
    if not (math.isfinite(gap.low) and gap.excludes_zero):
        null = f"by chance up to {number(scale * row['null'])}"
        parts.append(f"distance {number(scale * row['distance'])}, {null} {points}".rstrip())
    return "; ".join(parts)


def verdict_table(verdict: Verdict, words: Words = DEMONSTRATED) -> TerminalTable:
    """The verdict for the terminal.

    Raises
    ------
    MissingExtraError
        If rich is not installed.
    """
    try:
        from rich.box import SIMPLE_HEAD
        from rich.table import Table as TerminalTable
        from rich.text import Text
    except ImportError as error:
        raise MissingExtraError("the table", "algos") from error
    table = TerminalTable(
        title=Text(verdict_sentence(verdict, words)),
        caption=Text(words.say(_caption(verdict))),
        box=SIMPLE_HEAD, padding=(0, 1),
    )  # fmt: skip
    for i, heading in enumerate(COLUMNS):
        wide = i in (0, len(COLUMNS) - 1)
        table.add_column(
            words.say(heading), justify="left" if wide else "right", no_wrap=not wide
        )  # fmt: skip
    for row, cells in verdict_lines(verdict, words):
        style = "" if row["judgement"] == SAME else "bold"
        table.add_row(*(Text(cell) for cell in cells), style=style)
    return table


def _scale(row: Any) -> tuple[float, str]:
    """By what the row's numbers are multiplied, and the unit they then have."""
    return (100.0, "%") if row["unit"] == SHARE else (1.0, str(row["unit"]))


def _asked(row: Any) -> str:
    unit = _scale(row)[1]
    return f"{row['label']} ({unit})" if unit else str(row["label"])


def verdict_lines(verdict: Verdict, words: Words) -> Iterator[tuple[Any, list[str]]]:
    """Each row of the table with its cells as texts."""
    for _, row in verdict.table.iterrows():
        scale, unit = _scale(row)
        gap = Interval(row["difference"], row["difference_low"], row["difference_high"])
        cells = [
            _asked(row),
            number(scale * row["recorded"]),
            number(scale * row["simulated"]),
            with_interval(gap, unit == "%"),
            number(scale * row["distance"]),
            number(scale * row["null"]),
            words.say(str(row["verdict"])),
        ]
        if row["measure"] in (AUC, SEQUENCE):
            among = verdict.areas.get(str(row["measure"]), {}).get("among", UNDEFINED)
            cells[2] = with_interval(verdict.auc if row["measure"] == AUC else verdict.sequence)
            cells[4], cells[5] = NOTHING, number(among.high)
        yield row, cells


def _caption(verdict: Verdict) -> str:
    filtered = (
        f" All positions, simulated ones too, went through a moving average of {verdict.smoothing} "
        "frames first."
        if verdict.smoothing > 1
        else ""
    )
    return (
        "Means over episodes and their difference [95 % interval]. Distance: the difference that "
        "is tested, of means or of spreads. Null: what all distances together stay below in "
        f"{100 * (1 - LEVEL):.0f} % of cases if the recorded episode of each start is exchanged "
        "with one of its rollouts. For the classifiers: recordings among themselves. Of each kind "
        f"of order the measure that differs most is told.{_floor(verdict)}{filtered}"
    )


def _floor(verdict: Verdict) -> str:
    """What the judges make of tracking and of random actions, as sentences; none if neither."""
    said = ""
    for key, name in ((AUC, "classifier's AUC"), (SEQUENCE, "AUC of order")):
        areas = verdict.areas.get(key, {})
        told = [
            f"{with_interval(areas[one])} for {what}"
            for one, what in BESIDE.items()
            if one in areas and math.isfinite(areas[one].estimate)
        ]
        said += f" The {name} is {' and '.join(told)}." if told else ""
    return said


def _classifier_caption(verdict: Verdict) -> str:
    parts = (
        " There are fewer than five demonstrations, so parts of them are dealt to the folds, and "
        "the intervals are of these."
        if verdict.parts
        else ""
    )
    return (
        f"Left: how often boosted trees, shown {WINDOW:g} s of motion of a demonstration that they "
        "were not trained on, rank the simulated above the recorded: 0.5 is chance. Beside it "
        "demonstrations among themselves, and, where they were rolled out, the demonstrations as "
        "the fitted locomotion follows them (an estimate of what it allows), the same with one "
        "action in ten at random, and random actions. Right: "
        f"by how much the area falls when one kind of feature is shuffled.{parts}"
    )


def _pictures(verdict: Verdict) -> Iterator[Image]:
    beside = verdict.areas.get(AUC, {})
    areas = {
        method_label(verdict.learner): verdict.auc,
        "demonstrations among themselves": beside.get("among", UNDEFINED),
        "closed-loop tracking": beside.get("floor", UNDEFINED),
        "... one action in ten at random": beside.get("perturbed", UNDEFINED),
        "random": beside.get("ceiling", UNDEFINED),
    }
    shown = {name: area for name, area in areas.items() if math.isfinite(area.estimate)}
    if shown:
        figure = figures.interval_rows(
            shown, "Area under the ROC curve", title="Distinguished", reference=0.5,
            limits=(min(0.4, *(a.low for a in shown.values())), 1.02), label=str,
        )  # fmt: skip
        yield to_image(figure, "Area under the ROC curve of the classifier, with its references")
    if verdict.importance:
        falls = {
            kind: Interval(fall, math.nan, math.nan)
            for kind, fall in sorted(verdict.importance.items(), key=lambda item: -item[1])
        }
        figure = figures.interval_rows(
            falls, "Fall of the area", title="By what", reference=0.0, label=str
        )
        yield to_image(figure, "By how much the area falls when one kind of feature is shuffled")
