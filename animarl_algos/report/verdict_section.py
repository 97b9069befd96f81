"""The verdict as the first section of the page, as its headline, and as a sentence."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any

from animarl_algos.evaluation.classifier import AUC, SEQUENCE
from animarl_algos.evaluation.realism import REFERENCES
from animarl_algos.evaluation.statistics import UNDEFINED, Interval, interval, told_by
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
from animarl_algos.evaluation.windows import WINDOW
from animarl_algos.report import figures
from animarl_algos.report.page import Block, Gallery, Lead, Table, tabulate
from animarl_algos.report.style import Image, method_label, to_image
from animarl_algos.report.words import NOTHING, Words, capitalised, number, with_interval

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
        size=f"{verdict.rollouts} rollouts from {verdict.starts} starts",
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
    gap = told_by(row)
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


def _asked(row: Any) -> str:
    unit = _scale(row)[1]
    return f"{row['label']} ({unit})" if unit else str(row["label"])


# -- as tables and pictures -----------------------------------------------------------------------


def verdict_blocks(verdict: Verdict, words: Words = DEMONSTRATED) -> Iterator[Block]:
    """Yield the table, figures of the classifier and realism."""
    say = words.say
    yield verdict_as_table(verdict, words)
    yield Gallery(list(_pictures(verdict)), say(_classifier_caption(verdict)))
    yield from _realism_tables(verdict, words)


def verdict_as_table(verdict: Verdict, words: Words) -> Table:
    """Return one row per question, those that find nothing faint."""
    judges = (AUC, SEQUENCE)

    def scaled(key: str) -> Any:
        return lambda row: number(_scale(row)[0] * row[key])

    def value(row: Any) -> str:
        return with_interval(told_by(row), _scale(row)[1] == "%")

    return tabulate(
        "Verdict",
        {
            "Question": _asked,
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
        [("", (row for _, row in verdict.table.iterrows()))],
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
    if verdict.smoothing > 1:
        said += (
            " All positions, simulated ones too, went through a moving average of "
            f"{verdict.smoothing} frames first."
        )
    return said


def _realism_tables(verdict: Verdict, words: Words) -> Iterator[Table]:
    """The realism score by kind and, folded, by component, beside what it is read by."""
    scores = verdict.components
    if scores is None or scores.empty:
        return

    def beside(reference: str) -> Any:
        return lambda row: number(row[reference]) if reference in row else NOTHING

    columns = {
        "Weight": lambda row: number(row["weight"], 2),
        "Score\n[95 %]": lambda row: with_interval(interval(row, "score")),
        **{words.say(one).capitalize(): beside(one) for one in REFERENCES},
    }
    whole: list[Any] = []
    parts: list[Any] = []
    for _, row in scores.iterrows():
        named = isinstance(row["component"], str) and row["component"]
        (parts if named else whole).append(row)
    yield tabulate(
        "Realism",
        {"Kind": lambda row: str(row["kind"]), **columns},
        [("", whole[::-1])],
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
        [("", parts)],
        "Components of a kind weigh alike.",
        folded="Realism by component",
    )


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
        "the fitted locomotion follows them (an estimate of what it allows), and random actions. "
        "Right: "
        f"by how much the area falls when one kind of feature is shuffled.{parts}"
    )


def _pictures(verdict: Verdict) -> Iterator[Image]:
    beside = verdict.areas.get(AUC, {})
    areas = {
        method_label(verdict.learner): verdict.auc,
        "demonstrations among themselves": beside.get("among", UNDEFINED),
        "closed-loop tracking": beside.get("floor", UNDEFINED),
        "random": beside.get("ceiling", UNDEFINED),
    }
    shown = {name: area for name, area in areas.items() if math.isfinite(area.estimate)}
    if shown:
        figure = figures.interval_rows(
            shown, "Area under the ROC curve", title="Distinguished", reference=0.5,
            limits=(min(0.4, *(a.low for a in shown.values())), 1.02),
        )  # fmt: skip
        yield to_image(figure, "Area under the ROC curve of the classifier, with its references")
    if verdict.importance:
        falls = {
            kind: Interval(fall)
            for kind, fall in sorted(verdict.importance.items(), key=lambda item: -item[1])
        }
        figure = figures.interval_rows(falls, "Fall of the area", title="By what", reference=0.0)
        yield to_image(figure, "By how much the area falls when one kind of feature is shuffled")
