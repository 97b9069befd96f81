"""The comparison as a table, for the page and, as the verdict, for the terminal."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

from animarl_algos.evaluation.comparison import COUNTING
from animarl_algos.evaluation.metrics import METRICS, PATH_LENGTH, Metric
from animarl_algos.evaluation.tables import Evaluation
from animarl_algos.evaluation.verdict import Verdict
from animarl_algos.report.page import Row, Table, tabulate
from animarl_algos.report.verdict_section import DEMONSTRATED, verdict_as_table, verdict_sentence
from animarl_algos.report.words import Words, number, pick
from animarl_envs.errors import MissingExtraError

if TYPE_CHECKING:
    from rich.table import Table as TerminalTable


def comparison_as_table(
    evaluation: Evaluation, words: Words, countings: Sequence[str], learner: str | None = None
) -> Table:
    """Return one row per method, of each of the rules in ``countings`` of which episodes count."""
    comparison = evaluation.comparison
    shown = [m for m in METRICS if m.heading and (comparison["metric"] == m.key).any()]

    def told(metric: Metric, write: Callable[[Any], str]) -> Callable[[Any], str]:
        def cell(one: tuple[str, str]) -> str:
            counting = "all" if metric.share else one[1]
            row = pick(comparison, method=one[0], metric=metric.key, counting=counting)
            return "" if row is None else write(row)

        return cell

    def mean(metric: Metric) -> Callable[[Any], str]:
        return told(metric, lambda row: words.told(row, "mean", metric))

    def energy(metric: Metric) -> Callable[[Any], str]:
        def written(row: Any) -> str:
            score, pooled = (
                words.factor(metric) * float(row[key]) for key in ("energy", "energy_pooled")
            )
            return f"{number(score)} ({number(pooled)})" if math.isfinite(score) else ""

        return told(metric, written)

    columns: dict[str, Callable[[Any], str]] = {
        "method": lambda one: words.label(one[0]),
        "n": told(PATH_LENGTH, lambda row: str(int(row["rollouts"]))),
    }
    for metric in shown:
        unit = f"\n({words.unit_of(metric)})" if metric.is_length else ""
        columns[metric.heading + unit] = mean(metric)
        if metric.has_distribution:
            columns[f"energy of {metric.heading.partition(',')[0]}"] = energy(metric)
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
    """Return the verdict for the terminal; raise MissingExtraError if rich is not installed."""
    table = verdict_as_table(verdict, words)
    return _terminal_table(table, verdict_sentence(verdict, words), lambda row: not row.faint)


def evaluation_table(
    evaluation: Evaluation,
    *,
    counting: str = "all",
    learner: str | None = None,
    words: Words = DEMONSTRATED,
) -> TerminalTable:
    """Return the comparison for the terminal; raise MissingExtraError if rich is not installed.

    Which episodes count, ``"all"`` or ``"captures"``, is in its title; the ``learner`` is bold.
    """
    table = comparison_as_table(evaluation, words, [counting], learner)
    title = words.say(f"Simulated against recorded, {COUNTING[counting]}")
    return _terminal_table(table, title, lambda row: row.strong, wrapped=False)


def _terminal_table(
    table: Table, title: str, bold: Callable[[Row], bool] = lambda row: False, wrapped: bool = True
) -> TerminalTable:
    """Return a table of one group for the terminal.

    Columns of words may be wrapped; where they are not, intervals stand below means.
    """
    try:
        from rich.box import SIMPLE_HEAD
        from rich.table import Table as TerminalTable
        from rich.text import Text
    except ImportError as error:
        raise MissingExtraError("the table", "algos") from error
    made = TerminalTable(
        title=Text(title), caption=Text(table.caption), box=SIMPLE_HEAD, padding=(0, 1)
    )
    words = table.left if wrapped else 0
    for i, heading in enumerate(table.columns):
        left = i < table.left
        made.add_column(heading, justify="left" if left else "right", no_wrap=i >= words)
    for row in table.groups[0].rows:
        cells = row.cells if wrapped else [cell.replace(" [", "\n[") for cell in row.cells]
        made.add_row(*map(Text, cells), style="bold" if bold(row) else "")
    return made
