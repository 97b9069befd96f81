"""The verdict and the comparison of an evaluation as tables for the terminal."""

from __future__ import annotations

from collections.abc import Callable, Collection
from typing import TYPE_CHECKING

from animarl_algos.evaluation.comparison import COUNTING, interval
from animarl_algos.evaluation.metrics import DTW, METRICS, PATH_LENGTH
from animarl_algos.evaluation.rollouts import RECORDED
from animarl_algos.evaluation.tables import Evaluation
from animarl_algos.evaluation.verdict import Verdict
from animarl_algos.report.page import Group, Row, Table
from animarl_algos.report.style import method_label
from animarl_algos.report.verdict_section import DEMONSTRATED, verdict_as_table, verdict_sentence
from animarl_algos.report.words import Words, pick, with_interval
from animarl_envs.errors import MissingExtraError

if TYPE_CHECKING:
    from rich.table import Table as TerminalTable


def verdict_table(verdict: Verdict, words: Words = DEMONSTRATED) -> TerminalTable:
    """Return the verdict for the terminal.

    Raises
    ------
    MissingExtraError
        If rich is not installed.
    """
    table = verdict_as_table(verdict, words)
    wide = {0, len(table.columns) - 1}
    return _terminal_table(table, verdict_sentence(verdict, words), lambda row: not row.faint, wide)


def evaluation_table(
    evaluation: Evaluation, *, counting: str = "all", learner: str | None = None
) -> TerminalTable:
    """Return one row per method: means with 95 % intervals, and distances to the demonstrations.

    They are called demonstrated, not recorded: they may be synthetic.

    Parameters
    ----------
    counting
        Which episodes count: ``"all"`` or ``"captures"``; the table says so.
    learner
        A method to print in bold.

    Raises
    ------
    MissingExtraError
        If rich is not installed.
    """
    known = set(evaluation.comparison["metric"])
    shown = [metric for metric in METRICS if metric.heading and metric.key in known]
    headings = [h for m in shown for h in (m.heading, *(["KDE"] if m.has_distribution else []))]
    rows = []
    for name in evaluation.comparison["method"].unique():

        def found(key: str, rule: str, name: str = name) -> object | None:
            return pick(evaluation.comparison, method=name, metric=key, counting=rule)

        cells = []
        for metric in shown:
            row = found(metric.key, "all" if metric.share else counting)
            cells.append("" if row is None else with_interval(interval(row, "mean"), metric.share))
            if metric.has_distribution:
                cells.append("" if row is None else _against_null(row))
        own, count = found(DTW.key, counting), found(PATH_LENGTH.key, counting)
        cells.append("" if own is None else with_interval(interval(own, "within")))
        label = "demonstrated" if name == RECORDED else method_label(str(name))
        number = "" if count is None else str(int(count["rollouts"]))  # type: ignore[index]
        rows.append(Row([label, number, *(c.replace(" [", "\n[") for c in cells)], name == learner))
    table = Table(
        "comparison",
        ["method", "n", *headings, "within starts"],
        [Group("", rows)],
        "Mean [95 % interval] over demonstrations and seeds. KDE: kernel-density "
        "distance to the demonstrations, 0 to 2; in brackets what a perfect simulator gives. "
        "Within starts: the DTW distance with what all methods share of a start taken out.",
    )
    title = f"Simulated against demonstrated, {COUNTING[counting]}"
    return _terminal_table(table, title, lambda row: row.strong)


def _against_null(row: object) -> str:
    value, null = interval(row, "kde"), interval(row, "kde_null")
    if value.estimate != value.estimate:
        return ""
    return f"{value.estimate:.2f} [{null.low:.2f}, {null.high:.2f}]"


def _terminal_table(
    table: Table, title: str, bold: Callable[[Row], bool], wide: Collection[int] = ()
) -> TerminalTable:
    """A table of one group; ``wide`` columns hold words, and their lines may end."""
    try:
        from rich.box import SIMPLE_HEAD
        from rich.table import Table as TerminalTable
        from rich.text import Text
    except ImportError as error:
        raise MissingExtraError("the table", "algos") from error
    made = TerminalTable(
        title=Text(title), caption=Text(table.caption), box=SIMPLE_HEAD, padding=(0, 1)
    )
    for i, heading in enumerate(table.columns):
        left = i < table.left or i in wide
        made.add_column(heading, justify="left" if left else "right", no_wrap=i not in wide)
    for row in table.groups[0].rows:
        made.add_row(*map(Text, row.cells), style="bold" if bold(row) else "")
    return made
