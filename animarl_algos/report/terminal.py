"""The comparison of an evaluation as a table for the terminal."""

from __future__ import annotations

from typing import TYPE_CHECKING

from animarl_algos.evaluation.comparison import COUNTING, interval
from animarl_algos.evaluation.metrics import DTW, METRICS, PATH_LENGTH
from animarl_algos.evaluation.rollouts import RECORDED
from animarl_algos.evaluation.tables import Evaluation
from animarl_algos.report.sentences import comparison_row, with_interval
from animarl_algos.report.style import method_label
from animarl_envs.errors import MissingExtraError

if TYPE_CHECKING:
    from rich.table import Table


def evaluation_table(
    evaluation: Evaluation, *, counting: str = "all", learner: str | None = None
) -> Table:
    """One row per method: means with 95 % intervals, and distances to the demonstrations.

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
    try:
        from rich.box import SIMPLE_HEAD
        from rich.table import Table
        from rich.text import Text
    except ImportError as error:
        raise MissingExtraError("the table", "algos") from error
    comparison = evaluation.comparison
    table = Table(
        title=f"Simulated against demonstrated, {COUNTING[counting]}",
        caption="Mean [95 % interval] over demonstrations and seeds. KDE: kernel-density "
        "distance to the demonstrations, 0 to 2; in brackets what a perfect simulator gives. "
        "Within starts: the DTW distance with what all methods share of a start taken out.",
        box=SIMPLE_HEAD,
        padding=(0, 1),
    )
    table.add_column("method", no_wrap=True)
    table.add_column("n", justify="right", no_wrap=True, min_width=3)
    shown = [metric for metric in METRICS if metric.heading]
    headings = [h for m in shown for h in (m.heading, *(["KDE"] if m.has_distribution else []))]
    for heading in (*headings, "within starts"):
        table.add_column(heading, justify="right", no_wrap=True)
    for name in comparison["method"].unique():
        cells = []
        for metric in shown:
            which = "all" if metric.share else counting
            row = comparison_row(comparison, str(name), metric, which)
            cells.append("" if row is None else with_interval(interval(row, "mean"), metric.share))
            if metric.has_distribution:
                cells.append("" if row is None else _against_null(row))
        own = comparison_row(comparison, str(name), DTW, counting)
        cells.append("" if own is None else with_interval(interval(own, "within")))
        count = comparison_row(comparison, str(name), PATH_LENGTH, counting)
        table.add_row(
            "demonstrated" if name == RECORDED else Text(method_label(str(name))),
            "" if count is None else str(int(count["rollouts"])),
            *(Text(cell.replace(" [", "\n[")) for cell in cells),
            style="bold" if name == learner else "",
        )
    return table


def _against_null(row: object) -> str:
    value, null = interval(row, "kde"), interval(row, "kde_null")
    if value.estimate != value.estimate:
        return ""
    return f"{value.estimate:.2f} [{null.low:.2f}, {null.high:.2f}]"
