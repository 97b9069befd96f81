"""Figures of numbers: speeds, distributions, intervals, every episode as a dot, learning curves.

Each function takes arrays or tables and returns one matplotlib figure of one panel, small enough
that a page can set several side by side, or below one another on a narrow screen. A figure that is
added here is put on the page by a ``Gallery`` of :mod:`animarl_algos.report.run_page`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from animarl_algos.evaluation.distances import kde_rule, kde_weighted
from animarl_algos.evaluation.statistics import Interval
from animarl_algos.report import style
from animarl_algos.report.words import Words, capitalised

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Floats = NDArray[np.float64]

ROW_HEIGHT = 0.52  # of one method in a distribution [inch]
MOST_DOTS = 400  # more rollouts than this are thinned evenly in drawings, never in numbers
GOLDEN_RATIO = 0.6180339887498949
REFERENCE: dict[str, Any] = {
    "color": style.MUTED.hex, "linewidth": 0.7, "linestyle": (0, (4, 3)), "zorder": 0.5,
}  # fmt: skip


@contextmanager
def one_panel(width: float, height: float, grid: str, **texts: str) -> Iterator[tuple[Figure, Any]]:
    """Hand out a new figure and its axes; ``texts`` are its title and the labels of its axes."""
    with style.figure_style():
        figure, panel = style.new_figure(width, height)
        if grid:
            panel.grid(axis=grid, color=style.LINE.hex, linewidth=0.5)
        panel.set(**texts)
        yield figure, panel


# -- distributions --------------------------------------------------------------------------------


def speed_histogram(
    simulated: ArrayLike, recorded: ArrayLike, words: Words, title: str = ""
) -> Figure:
    """Draw speeds per step, recorded filled and simulated as a line, on shared bins.

    Speeds are in arena units per s and drawn in the unit of ``words``; areas sum to one.
    """
    scale = words.unit.per_arena_unit
    first, second = (scale * np.asarray(one, dtype=float) for one in (simulated, recorded))
    edges = shared_bins(first, second)
    with one_panel(
        4.0, 2.4, "", xlabel=f"Speed ({words.speed})", ylabel="Density", title=title
    ) as (figure, panel):
        panel.hist(
            second, edges, density=True, color=style.FILL.hex, alpha=0.55, linewidth=0,
            label=words.say("recorded"),
        )  # fmt: skip
        panel.hist(
            first, edges, density=True, histtype="step", linewidth=1.6, label="simulated",
            color=style.BLUE.hex,
        )  # fmt: skip
        panel.set_xlim(edges[0], edges[-1])
        panel.legend(loc="best")
    return figure


def shared_bins(*samples: Floats, most: int = 50) -> Floats:
    """Return bin edges for all samples, from zero to the largest value: Freedman and Diaconis."""
    pooled = np.concatenate(samples)
    high = float(pooled.max(initial=0.0)) or 1.0
    quartiles = np.percentile(pooled, [25, 75]) if len(pooled) else (0.0, 0.0)
    width = 2.0 * (quartiles[1] - quartiles[0]) * max(len(pooled), 1) ** (-1 / 3)
    count = most if width <= 0 else int(np.clip(np.ceil(high / width), 8, most))
    return np.linspace(0.0, high, count + 1)


def metric_distribution(
    values: Mapping[str, ArrayLike],
    means: Mapping[str, Interval],
    axis: str,
    *,
    title: str = "",
    label: Callable[[str], str] = style.method_label,
) -> Figure:
    """Draw one row per method: density above, every rollout below, mean with its 95 % interval.

    ``values`` are one per rollout that counts, by method, the recordings first.
    """
    names = list(values)
    samples = {name: _finite(value) for name, value in values.items()}
    pooled = np.concatenate(list(samples.values()))
    rule = kde_rule(*(s for s in samples.values() if len(s))) if len(pooled) else None
    with one_panel(4.6, 0.75 + ROW_HEIGHT * len(names), "x", xlabel=axis, title=title) as (
        figure,
        panel,
    ):
        for row, name in enumerate(names):
            colour = style.method_colour(name, row)
            sample, base = samples[name], float(len(names) - 1 - row)
            if len(sample) and rule is not None:
                density = kde_weighted(rule, sample, np.ones((1, len(sample))))[0]
                inside = (rule.grid >= sample.min()) & (rule.grid <= sample.max())
                inside = inside if inside.sum() > 1 else np.ones_like(inside)
                grid, height = rule.grid[inside], (0.46 * density / density.max())[inside]
                panel.fill_between(grid, base, base + height, color=colour, alpha=0.30, linewidth=0)
                panel.plot(grid, base + height, color=colour, linewidth=0.9)
                dots = _thinned(sample)
                panel.plot(
                    dots, base - 0.12 - 0.18 * _spread(len(dots)), ".", color=colour,
                    markersize=2.4, alpha=0.55, markeredgewidth=0, rasterized=True,
                )  # fmt: skip
            marker = "s" if style.is_recorded(name) else "o"
            draw_interval(panel, means[name], base, colour, marker)
        if style.is_recorded(names[0]) and np.isfinite(means[names[0]].estimate):
            panel.axvline(means[names[0]].estimate, **REFERENCE)
        _name_rows(panel, names, label, 0.6)
        if len(pooled) and pooled.min() >= 0:
            near_zero = pooled.min() < 0.35 * pooled.max()
            panel.set_xlim(left=min(0.0, panel.get_xlim()[0]) if near_zero else None)
    return figure


# -- intervals ------------------------------------------------------------------------------------


def interval_rows(
    means: Mapping[str, Interval],
    axis: str,
    *,
    title: str = "",
    reference: float | None = None,
    bands: Mapping[str, Interval] | None = None,
    limits: tuple[float, float] | None = None,
    label: Callable[[str], str] = str,
    colours: Mapping[str, str] | None = None,
) -> Figure:
    """Draw one row per method: an estimate with its interval, over an optional null band.

    A dashed line is drawn at ``reference``; ``bands`` are what nothing but chance would give;
    ``colours`` go over those of the recipes.
    """
    names = list(means)
    with one_panel(4.6, 0.8 + 0.36 * len(names), "x", xlabel=axis, title=title) as (figure, panel):
        for row, name in enumerate(names):
            base = float(len(names) - 1 - row)
            band = (bands or {}).get(name)
            if band is not None and np.isfinite(band.low):
                panel.barh(
                    base, band.high - band.low, left=band.low, height=0.62, color=style.LINE.hex,
                    linewidth=0, zorder=0.6,
                )  # fmt: skip
                panel.plot(
                    [band.estimate] * 2, [base - 0.31, base + 0.31], color=style.MUTED.hex,
                    linewidth=0.8,
                )  # fmt: skip
            colour = (colours or {}).get(name) or style.method_colour(name, row)
            draw_interval(panel, means[name], base, colour)
        if reference is not None and np.isfinite(reference):
            panel.axvline(reference, **REFERENCE)
        _name_rows(panel, names, label, 0.55)
        if limits is not None:
            panel.set_xlim(limits)
        panel.xaxis.set_major_locator(_locator(5))
        panel.xaxis.set_major_formatter("{x:g}")
    return figure


def draw_interval(
    panel: Axes, value: Interval, base: float, colour: str, marker: str = "o"
) -> None:
    """Draw a mean as a dot with its interval, ringed in the ground so that it stands out."""
    if not np.isfinite(value.estimate):
        return
    ground = style.PAGE.hex
    if np.isfinite(value.low):
        ends = [value.low, value.high]
        panel.plot(ends, [base, base], color=ground, linewidth=4.2, zorder=3)
        panel.plot(ends, [base, base], color=colour, linewidth=2.2, zorder=3.1)
    panel.plot(
        value.estimate, base, marker, color=colour, markersize=6.2, markeredgecolor=ground,
        markeredgewidth=1.2, zorder=3.2,
    )  # fmt: skip


# -- episodes -------------------------------------------------------------------------------------


class Dots(NamedTuple):
    """One column of episodes: its label, whose they are, one value each; hollow where flipped."""

    label: str
    method: str
    values: Floats
    flipped: bool = False


def episode_dots(columns: Sequence[Dots], label: str) -> Figure:
    """Draw every episode as a dot, a column per question; the bar is the mean of the column.

    Dots are spread sideways by rank within their column, the same every time.
    """
    with one_panel(1.1 + 0.62 * len(columns), 3.6, "y", ylabel=label) as (figure, panel):
        for place, column in enumerate(columns):
            colour = style.method_colour(column.method, place)
            values = np.asarray(column.values, dtype=np.float64)
            panel.plot(
                place + 0.6 * (_spread(len(values)) - 0.5), values, "o", markersize=3.4, alpha=0.7,
                markeredgewidth=0.8, markeredgecolor=colour,
                markerfacecolor="none" if column.flipped else colour,
                rasterized=len(values) > MOST_DOTS,
            )  # fmt: skip
            if len(values):
                panel.plot(
                    [place - 0.36, place + 0.36], [values.mean()] * 2, color=style.TEXT.hex,
                    linewidth=1.8, zorder=4,
                )  # fmt: skip
        panel.set_xticks(range(len(columns)), [c.label for c in columns], rotation=40, ha="right")
        panel.tick_params(axis="x", length=0)
        panel.set_xlim(-0.6, len(columns) - 0.4)
        panel.set_ylim(bottom=0)
    return figure


# -- learning curves ------------------------------------------------------------------------------

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


def chosen_curves(curves: pd.DataFrame, learner: str) -> dict[str, pd.DataFrame]:
    """Return the panels of one phase, in order: rows ``method, seed, step, value`` by title.

    Quantities that were also logged for each individual are shown by individual (in ``method``)
    where that is a loss of ``learner``, and as their mean elsewhere.
    """
    curves = curves.assign(quantity=curves["quantity"].str.removeprefix("offline/"))
    curves = curves[~curves["quantity"].str.startswith(UNSHOWN)]
    names = [str(name) for name in curves["quantity"].unique()]
    wholes = [name for name in names if name.rpartition("/")[0] not in names]
    order = [name for name in QUANTITIES if name in wholes]
    order += sorted(name for name in wholes if name not in QUANTITIES)
    chosen = {}
    for name in order:
        title = QUANTITIES.get(name, name.partition("/")[2].replace("_", " ") or name)
        parts = curves[curves["quantity"].str.startswith(f"{name}/")]
        own = parts[parts["method"].str.casefold() == learner.casefold()]
        by_individual = name.startswith("train/") and not own.empty
        chosen[title] = (
            own.assign(method=own["quantity"].str.removeprefix(f"{name}/"))
            if by_individual
            else curves[curves["quantity"] == name]
        )
    return chosen


def learning_curve(curves: pd.DataFrame, title: str, x_label: str) -> Figure:
    """Draw one quantity over training: a thin line per seed, a thick one for their mean.

    ``curves`` has columns ``method, seed, step, value``.
    """
    from matplotlib.ticker import FuncFormatter

    with one_panel(3.4, 2.3, "y", title=capitalised(title), xlabel=x_label) as (figure, panel):
        methods = list(curves.groupby("method", sort=False))
        for position, (name, rows) in enumerate(methods):
            label = style.method_label(str(name)) if style.is_method(str(name)) else str(name)
            look = {
                "color": style.method_colour(str(name), position),
                "linestyle": style.DASHES[position % len(style.DASHES)],
            }
            seeds = list(rows.groupby("seed"))
            for _, one in seeds if len(seeds) > 1 else []:
                panel.plot(one["step"], one["value"], **look, linewidth=0.6, alpha=0.45)
            mean = rows.groupby("step")["value"].mean()
            width = 1.8 if len(seeds) > 1 else 1.4
            panel.plot(mean.index, mean.to_numpy(), **look, linewidth=width, label=label)
        panel.margins(x=0.01)
        panel.xaxis.set_major_locator(_locator(5))
        panel.xaxis.set_major_formatter(
            FuncFormatter(lambda x, _: f"{x / 1000:g}k" if abs(x) >= 1000 else f"{x:g}")
        )
        if len(methods) > 1:
            panel.legend(loc="best")
    return figure


# -- small things ---------------------------------------------------------------------------------


def _name_rows(panel: Axes, names: Sequence[str], label: Callable[[str], str], pad: float) -> None:
    panel.set_yticks(range(len(names)), [label(name) for name in reversed(names)])
    panel.tick_params(axis="y", length=0)
    panel.spines["left"].set_visible(False)
    panel.set_ylim(-pad, len(names) - 1 + pad)


def _finite(values: ArrayLike) -> Floats:
    array = np.asarray(values, dtype=np.float64)
    return array[np.isfinite(array)]


def _thinned(sample: Floats) -> Floats:
    """Evenly spaced order statistics of a large sample."""
    if len(sample) <= MOST_DOTS:
        return sample
    return np.asarray(np.sort(sample)[np.linspace(0, len(sample) - 1, MOST_DOTS).astype(int)])


def _spread(count: int) -> Floats:
    """Offsets in [0, 1) that fill a strip evenly and are the same every time."""
    return np.asarray((np.arange(count) * GOLDEN_RATIO) % 1.0)


def _locator(bins: int) -> Any:
    """Ticks at round numbers, about so many."""
    from matplotlib.ticker import MaxNLocator

    return MaxNLocator(bins, steps=[1, 2, 2.5, 5, 10])
