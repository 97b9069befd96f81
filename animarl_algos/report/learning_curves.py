"""Learning curves: which of the logged quantities a report shows, in what words, and how."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

from animarl_algos.report import style
from animarl_algos.report.figures import locator, thousands

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

QUANTITIES = {
    "val/cross_entropy": "Validation cross-entropy (nat)",
    "val/mean_rank": "Rank of the demonstrated action",
    "val/top_1": "Demonstrated action first (share)",
    "val/top_3": "Demonstrated action in top 3 (share)",
    "val/treatment_balanced_accuracy": "Condition read from the state",
    "rollout/ep_rew_mean": "Task return per episode",
    "rollout/success_rate": "Share of successes",
    "rollout/ep_len_mean": "Episode length (steps)",
    "train/td": "Temporal-difference loss",
    "train/supervision": "Supervision cross-entropy (nat)",
    "train/treatment": "Treatment cross-entropy (nat)",
    "train/treatment_balanced_accuracy": "Condition read from the state",
    "rollout/exploration_rate": "Exploration rate",
}
"""In the order of the page; other quantities follow under their own names."""

UNSHOWN = ("train/l2", "train/learning_rate", "train/n_updates", "rollout/buffer_")
"""Bookkeeping, by prefix."""


@dataclass(frozen=True, eq=False)
class Curve:
    """One panel: a quantity's title and its rows ``method, seed, step, value``.

    Where it was logged for each individual, these stand in ``method`` and one learner is shown.
    """

    title: str
    rows: pd.DataFrame


def chosen_curves(curves: pd.DataFrame, learner: str) -> Iterator[Curve]:
    """The panels of one phase, in order.

    Quantities that were also logged for each individual are shown by individual where that is a
    loss of ``learner``, and as their mean elsewhere.
    """
    curves = curves.assign(quantity=curves["quantity"].str.removeprefix("offline/"))
    curves = curves[~curves["quantity"].str.startswith(UNSHOWN)]
    names = [str(name) for name in curves["quantity"].unique()]
    wholes = [name for name in names if name.rpartition("/")[0] not in names]
    order = [name for name in QUANTITIES if name in wholes]
    order += sorted(name for name in wholes if name not in QUANTITIES)
    for name in order:
        title = QUANTITIES.get(name, name.partition("/")[2].replace("_", " ") or name)
        parts = curves[curves["quantity"].str.startswith(f"{name}/")]
        own = parts[parts["method"].str.casefold() == learner.casefold()]
        if name.startswith("train/") and not own.empty:
            who = own["quantity"].str.removeprefix(f"{name}/")
            yield Curve(title, own.assign(method=who))
        else:
            yield Curve(title, curves[curves["quantity"] == name])


def learning_curve(curves: pd.DataFrame, title: str, x_label: str, y_label: str = "") -> Figure:
    """One quantity over training: a thin line per seed, a thick one for their mean.

    Parameters
    ----------
    curves
        Columns ``method, seed, step, value``.
    """
    with style.figure_style():
        figure, panel = style.new_figure(3.4, 2.3)
        style.light_grid(panel, "y")
        methods = list(curves.groupby("method", sort=False))
        for position, (name, rows) in enumerate(methods):
            label = style.method_label(str(name)) if style.is_method(str(name)) else str(name)
            colour = style.method_colour(str(name), position)
            dashes = style.DASHES[position % len(style.DASHES)]
            seeds = list(rows.groupby("seed"))
            for _, one in seeds:
                alone = len(seeds) == 1
                panel.plot(
                    one["step"], one["value"], color=colour, linestyle=dashes,
                    linewidth=1.4 if alone else 0.6,
                    alpha=1.0 if alone else 0.45,
                    label=label if alone else None,
                )  # fmt: skip
            if len(seeds) > 1:
                mean = rows.groupby("step")["value"].mean()
                panel.plot(
                    mean.index, mean.to_numpy(), color=colour, linestyle=dashes, linewidth=1.8,
                    label=label,
                )  # fmt: skip
        panel.set(title=title[:1].upper() + title[1:], xlabel=x_label, ylabel=y_label)
        panel.margins(x=0.01)
        panel.xaxis.set_major_locator(locator(5))
        panel.xaxis.set_major_formatter(thousands())
        if len(methods) > 1:
            panel.legend(loc="best")
    return figure
