"""Figures of numbers: histograms, and intervals with or without the values behind them.

Each function takes arrays or tables and returns one matplotlib figure of one panel, small enough
that a page can set several side by side, or below one another on a narrow screen. A figure that is
added here is put on the page by a ``Gallery`` of :mod:`animarl_algos.report.run_page`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from animarl_algos.evaluation.statistics import Interval
from animarl_algos.report import style

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Floats = NDArray[np.float64]

ROW_HEIGHT = 0.52  # of one method in a distribution [inch]
BINS = 41  # edges of the bins of a histogram
POINTS = 200  # of a density
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


def histograms(
    simulated: Floats, recorded: Floats, axis: str, title: str = "", name: str = "recorded"
) -> Figure:
    """Draw two samples on shared bins, recorded filled and simulated as a line; areas are one."""
    edges = np.linspace(
        0.0, max(simulated.max(initial=0.0), recorded.max(initial=0.0)) or 1.0, BINS
    )
    with one_panel(3.4, 2.1, "", xlabel=axis, ylabel="Density", title=title) as (figure, panel):
        panel.hist(
            recorded, edges, density=True, color=style.FILL.hex, alpha=0.55, linewidth=0, label=name
        )
        panel.hist(
            simulated, edges, density=True, histtype="step", linewidth=1.6, label="simulated",
            color=style.BLUE.hex,
        )  # fmt: skip
        panel.set_xlim(edges[0], edges[-1])
        panel.legend(loc="best")
    return figure


# -- intervals, with or without every value -------------------------------------------------------


def interval_rows(
    means: Mapping[str, Interval],
    axis: str,
    *,
    title: str = "",
    reference: float | None = None,
    limits: tuple[float, float] | None = None,
    label: Callable[[str], str] = str,
    colours: Mapping[str, str] | None = None,
    values: Mapping[str, ArrayLike] | None = None,
) -> Figure:
    """Draw one row per method, an estimate with its interval, and a dashed line at ``reference``.

    ``colours`` go over those of the recipes. ``values`` are one per rollout that counts, by method:
    then a density stands above each row, and every rollout below it.
    """
    names, found = list(means), {name: _finite(v) for name, v in (values or {}).items()}
    height = 0.8 + (0.36 if values is None else ROW_HEIGHT) * len(names)
    with one_panel(4.6, height, "x", xlabel=axis, title=title) as (figure, panel):
        for row, name in enumerate(names):
            base = float(len(names) - 1 - row)
            colour = (colours or {}).get(name) or style.method_colour(name, row)
            if len(found.get(name, ())):
                _draw_values(panel, found[name], base, colour)
            draw_interval(panel, means[name], base, colour)
        if reference is not None and np.isfinite(reference):
            panel.axvline(reference, **REFERENCE)
        panel.set_yticks(range(len(names)), [label(name) for name in reversed(names)])
        panel.tick_params(axis="y", length=0)
        panel.spines["left"].set_visible(False)
        panel.set_ylim(-0.6, len(names) - 0.4)
        if limits is not None:
            panel.set_xlim(limits)
        panel.xaxis.set_major_locator(_locator(5))
        panel.xaxis.set_major_formatter("{x:g}")
    return figure


def _draw_values(panel: Axes, sample: Floats, base: float, colour: str) -> None:
    """Values of a sample below ``base``, and above it their density, where they differ."""
    if np.ptp(sample) > 1e-9 * np.abs(sample).max():
        from scipy.stats import gaussian_kde

        grid = np.linspace(sample.min(), sample.max(), POINTS)
        height = gaussian_kde(sample)(grid)
        height = base + 0.46 * height / height.max()
        panel.fill_between(grid, base, height, color=colour, alpha=0.30, linewidth=0)
        panel.plot(grid, height, color=colour, linewidth=0.9)
    dots = np.sort(sample)[np.linspace(0, len(sample) - 1, min(len(sample), MOST_DOTS)).astype(int)]
    offsets = (np.arange(len(dots)) * GOLDEN_RATIO) % 1.0  # the same every time
    panel.plot(
        dots, base - 0.12 - 0.18 * offsets, ".", color=colour, markersize=2.4, alpha=0.55,
        markeredgewidth=0, rasterized=True,
    )  # fmt: skip


def draw_interval(panel: Axes, value: Interval, base: float, colour: str) -> None:
    """Draw a mean as a dot with its interval, ringed in the ground so that it stands out."""
    if not np.isfinite(value.estimate):
        return
    ground = style.PAGE.hex
    if np.isfinite(value.low):
        ends = [value.low, value.high]
        panel.plot(ends, [base, base], color=ground, linewidth=4.2, zorder=3)
        panel.plot(ends, [base, base], color=colour, linewidth=2.2, zorder=3.1)
    panel.plot(
        value.estimate, base, "o", color=colour, markersize=6.2, markeredgecolor=ground,
        markeredgewidth=1.2, zorder=3.2,
    )  # fmt: skip


# -- small things ---------------------------------------------------------------------------------


def _finite(values: ArrayLike) -> Floats:
    array = np.asarray(values, dtype=np.float64)
    return array[np.isfinite(array)]


def _locator(bins: int) -> Any:
    """Ticks at round numbers, about so many."""
    from matplotlib.ticker import MaxNLocator

    return MaxNLocator(bins, steps=[1, 2, 2.5, 5, 10])
