"""The verdict as the first section of the page, as a sentence, and as a table for the terminal."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from animarl_algos.evaluation.motion import MEASURES
from animarl_algos.evaluation.statistics import Interval
from animarl_algos.evaluation.told_apart import AUC
from animarl_algos.evaluation.verdict import Verdict
from animarl_algos.evaluation.windows import WINDOW
from animarl_algos.report import figures
from animarl_algos.report.blocks import Block, Gallery, Group, Row, Table, Text
from animarl_algos.report.sentences import NOTHING, number, with_interval
from animarl_algos.report.style import Image, method_label, to_image
from animarl_envs.errors import MissingExtraError

if TYPE_CHECKING:
    from rich.table import Table as TerminalTable

COLUMNS = (
    "Question", "Recorded", "Simulated", "Difference\n[95 %]", "Distance", "Null\n(95 %)",
    "Verdict",
)  # fmt: skip
SHARES = frozenset(measure.key for measure in MEASURES if measure.is_share)
SPREADS = tuple(measure.key for measure in MEASURES if measure.spread)


def verdict_blocks(verdict: Verdict, recorded: str = "Recorded") -> Iterator[Block]:
    """Sentence, table and the two figures of the classifier.

    ``recorded`` is what the demonstrations are called: they may be synthetic.
    """
    yield Text(verdict_sentence(verdict))
    lines = [Row(cells, faint=bool(row["alike"])) for row, cells in _lines(verdict)]
    columns = [COLUMNS[0], recorded, *COLUMNS[2:]]
    yield Table("Verdict", columns, [Group("", lines)], _caption(verdict))
    yield Gallery(list(_pictures(verdict)), _classifier_caption(verdict))
    energies = [
        Row([str(row["label"]), number(row["energy"]), number(row["energy_pooled"])])
        for key in SPREADS
        if math.isfinite((row := verdict.row(key))["energy"])
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


def verdict_sentence(verdict: Verdict) -> str:
    """The verdict in one sentence, with the classifier's area beside it."""
    found = (
        f"{method_label(verdict.learner)} {verdict.overall}"
        if verdict.like
        else f"{method_label(verdict.learner)}: {verdict.overall}"
    )
    auc = (
        f"; a classifier ranks a simulated window above a recorded one in "
        f"{with_interval(verdict.auc, percent=True)} % of pairs (50: cannot tell them apart)"
        if math.isfinite(verdict.auc.estimate)
        else ""
    )
    size = f"{verdict.rollouts} rollouts from {verdict.starts} starts"
    at = "told apart from the demonstrations in nothing that counts, at this sample size: "
    return f"{found} ({at if verdict.like else ''}{size}){auc}."


def verdict_table(verdict: Verdict) -> TerminalTable:
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
        title=Text(verdict_sentence(verdict)), caption=Text(_caption(verdict)),
        box=SIMPLE_HEAD, padding=(0, 1),
    )  # fmt: skip
    for i, heading in enumerate((COLUMNS[0], "Demonstrated", *COLUMNS[2:])):
        words = i in (0, len(COLUMNS) - 1)
        table.add_column(heading, justify="left" if words else "right", no_wrap=not words)
    for row, cells in _lines(verdict):
        table.add_row(*(Text(cell) for cell in cells), style="" if row["alike"] else "bold")
    return table


def _lines(verdict: Verdict) -> Iterator[tuple[Any, list[str]]]:
    """Each row of the table with its cells as texts."""
    for _, row in verdict.table.iterrows():
        percent = row["measure"] in SHARES
        scale = 100.0 if percent else 1.0
        unit = "%" if percent else str(row["unit"])
        label = f"{row['label']} ({unit})" if unit else str(row["label"])
        gap = Interval(row["difference"], row["difference_low"], row["difference_high"])
        cells = [
            label,
            number(scale * row["recorded"]),
            number(scale * row["simulated"]),
            with_interval(gap, percent),
            number(scale * row["distance"]),
            number(scale * row["null"]),
            str(row["verdict"]),
        ]
        if row["measure"] == AUC:
            cells[2] = with_interval(verdict.auc)
            cells[4], cells[5] = NOTHING, number(verdict.among.high)
        yield row, cells


def _caption(verdict: Verdict) -> str:
    filtered = (
        f" All positions, simulated ones too, went through a moving average of {verdict.smoothing} "
        "frames first."
        if verdict.smoothing > 1
        else ""
    )
    return (
        "Means over episodes and their difference [95 % interval]. Distance: the Wasserstein "
        f"distance of {', '.join(key.replace('_', ' ') for key in SPREADS)}, the absolute "
        "difference elsewhere. Null: what it stays below in 95 % of cases if the recorded episode "
        "of each start is exchanged with one of its rollouts. For the classifier: recordings among "
        f"themselves.{filtered}"
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
        "the fitted locomotion follows them (no policy can do better) and random actions. Right: "
        f"by how much the area falls when one kind of feature is shuffled.{parts}"
    )


def _pictures(verdict: Verdict) -> Iterator[Image]:
    areas = {
        method_label(verdict.learner): verdict.auc,
        "demonstrations among themselves": verdict.among,
        "closed-loop tracking": verdict.floor,
        "random": verdict.ceiling,
    }
    shown = {name: area for name, area in areas.items() if math.isfinite(area.estimate)}
    if shown:
        figure = figures.interval_rows(
            shown, "Area under the ROC curve", title="Told apart", reference=0.5,
            limits=(min(0.4, *(a.low for a in shown.values())), 1.02),
        )  # fmt: skip
        yield to_image(figure, "Area under the ROC curve of the classifier, with its references")
    if verdict.importance:
        falls = {
            kind: Interval(fall, math.nan, math.nan)
            for kind, fall in sorted(verdict.importance.items(), key=lambda item: -item[1])
        }
        figure = figures.interval_rows(falls, "Fall of the area", title="By what", reference=0.0)
        yield to_image(figure, "By how much the area falls when one kind of feature is shuffled")
