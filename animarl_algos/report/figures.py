"""Figures of an evaluation: speeds, distributions, counterfactuals.

Each function takes arrays or tables and returns one matplotlib figure of one panel or a pair, small
enough that a page can set several side by side, or below one another on a narrow screen.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from animarl_algos.evaluation.distances import kde_rule, kde_weighted
from animarl_algos.evaluation.statistics import Interval
from animarl_algos.report import style
from animarl_algos.report.words import Words

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Floats = NDArray[np.float64]

ROW_HEIGHT = 0.52  # of one method in a distribution [inch]
MOST_DOTS = 400  # more rollouts than this are thinned evenly in drawings, never in numbers


# -- speeds ---------------------------------------------------------------------------------------


def speed_histogram(
    simulated: ArrayLike, recorded: ArrayLike, words: Words, title: str = ""
) -> Figure:
    """Speeds per step, recorded filled and simulated as a line, on shared bins.

    Speeds are in arena units per s and drawn in the unit of ``words``; areas sum to one.
    """
    scale = words.unit.per_arena_unit
    first, second = (scale * np.asarray(one, dtype=float) for one in (simulated, recorded))
    edges = shared_bins(first, second)
    with style.figure_style():
        figure, panel = style.new_figure(4.0, 2.4)
        panel.hist(
            second, edges, density=True, color=style.RECORDED_FILL, alpha=0.55, linewidth=0,
            label=words.say("recorded"),
        )  # fmt: skip
        panel.hist(
            first, edges, density=True, histtype="step", linewidth=1.6, label="simulated",
            color=style.SIMULATED_COLOUR,
        )  # fmt: skip
        panel.set(xlabel=f"Speed ({words.speed})", ylabel="Density", title=title)
        panel.set_xlim(edges[0], edges[-1])
        panel.legend(loc="best")
    return figure


def shared_bins(*samples: Floats, most: int = 50) -> Floats:
    """Bin edges for all samples: Freedman and Diaconis' width, from zero to the largest value."""
    pooled = np.concatenate(samples)
    high = float(pooled.max(initial=0.0)) or 1.0
    quartiles = np.percentile(pooled, [25, 75]) if len(pooled) else (0.0, 0.0)
    width = 2.0 * (quartiles[1] - quartiles[0]) * max(len(pooled), 1) ** (-1 / 3)
    count = most if width <= 0 else int(np.clip(np.ceil(high / width), 8, most))
    return np.linspace(0.0, high, count + 1)


# -- distributions --------------------------------------------------------------------------------


def metric_distribution(
    values: Mapping[str, ArrayLike],
    means: Mapping[str, Interval],
    axis: str,
    *,
    title: str = "",
    label: Callable[[str], str] = style.method_label,
) -> Figure:
    """One row per method: density above, every rollout below, mean with its 95 % interval.

    Parameters
    ----------
    values
        By method, the recordings first: one value per rollout that counts.
    means
        By method, as in the comparison table.
    axis, label
        What the values are, with their unit; how a method is called.
    """
    names = list(values)
    samples = {name: _finite(value) for name, value in values.items()}
    rule = kde_rule(*(s for s in samples.values() if len(s))) if _any(samples) else None
    with style.figure_style():
        figure, panel = style.new_figure(4.6, 0.75 + ROW_HEIGHT * len(names))
        style.light_grid(panel)
        for row, name in enumerate(names):
            colour = style.method_colour(name, row)
            sample, base = samples[name], float(len(names) - 1 - row)
            if len(sample) and rule is not None:
                density = kde_weighted(rule, sample, np.ones((1, len(sample))))[0]
                inside = (rule.grid >= sample.min()) & (rule.grid <= sample.max())
                inside = inside if inside.sum() > 1 else np.ones_like(inside)
                height = 0.46 * density / density.max()
                panel.fill_between(
                    rule.grid[inside], base, base + height[inside], color=colour, alpha=0.30,
                    linewidth=0,
                )  # fmt: skip
                panel.plot(rule.grid[inside], base + height[inside], color=colour, linewidth=0.9)
            dots = _thinned(sample)
            if len(dots):
                panel.plot(
                    dots, base - 0.12 - 0.18 * _spread(len(dots)), ".", color=colour,
                    markersize=2.4, alpha=0.55, markeredgewidth=0, rasterized=True,
                )  # fmt: skip
            marker = "s" if style.is_recorded(name) else "o"
            draw_interval(panel, means[name], base, colour, marker)
        if style.is_recorded(names[0]) and np.isfinite(means[names[0]].estimate):
            panel.axvline(
                means[names[0]].estimate, color=style.MUTED, linewidth=0.7, linestyle=(0, (4, 3)),
                zorder=0.5,
            )  # fmt: skip
        _method_rows(panel, names, label)
        panel.set(xlabel=axis, title=title)
        if rule is not None and min(s.min() for s in samples.values() if len(s)) >= 0:
            panel.set_xlim(left=min(0.0, panel.get_xlim()[0]) if _near_zero(samples) else None)
    return figure


def interval_rows(
    means: Mapping[str, Interval],
    axis: str,
    *,
    title: str = "",
    reference: float | None = None,
    bands: Mapping[str, Interval] | None = None,
    limits: tuple[float, float] | None = None,
    label: Callable[[str], str] = style.method_label,
) -> Figure:
    """One row per method: an estimate with its interval, over an optional null band.

    Parameters
    ----------
    reference
        Where a dashed line is drawn: zero difference, or the recordings' value.
    bands
        By method, the range that nothing but chance would give, drawn as a grey bar.
    """
    names = list(means)
    with style.figure_style():
        figure, panel = style.new_figure(4.6, 0.8 + 0.36 * len(names))
        style.light_grid(panel)
        for row, name in enumerate(names):
            base = float(len(names) - 1 - row)
            band = (bands or {}).get(name)
            if band is not None and np.isfinite(band.low):
                panel.barh(
                    base, band.high - band.low, left=band.low, height=0.62, color=style.FAINT,
                    linewidth=0, zorder=0.6,
                )  # fmt: skip
                panel.plot([band.estimate] * 2, [base - 0.31, base + 0.31], color=style.MUTED,
                           linewidth=0.8)  # fmt: skip
            draw_interval(panel, means[name], base, style.method_colour(name, row))
        if reference is not None and np.isfinite(reference):
            panel.axvline(
                reference, color=style.MUTED, linewidth=0.7, linestyle=(0, (4, 3)), zorder=0.5
            )
        _method_rows(panel, names, label, pad=0.55)
        panel.set(xlabel=axis, title=title)
        if limits is not None:
            panel.set_xlim(limits)
        panel.xaxis.set_major_locator(locator(5))
        panel.xaxis.set_major_formatter("{x:g}")
    return figure


def draw_interval(
    panel: Axes, value: Interval, base: float, colour: str, marker: str = "o"
) -> None:
    """A mean as a dot with its interval, ringed in the ground so that it stands out."""
    if not np.isfinite(value.estimate):
        return
    if np.isfinite(value.low):
        panel.plot(
            [value.low, value.high], [base, base], color=style.GROUND, linewidth=4.2, zorder=3
        )
        panel.plot([value.low, value.high], [base, base], color=colour, linewidth=2.2, zorder=3.1)
    panel.plot(
        value.estimate, base, marker, color=colour, markersize=6.2, markeredgecolor=style.GROUND,
        markeredgewidth=1.2, zorder=3.2,
    )  # fmt: skip


# -- counterfactual -------------------------------------------------------------------------------


# -- small things ---------------------------------------------------------------------------------


def _method_rows(
    panel: Axes, names: Sequence[str], label: Callable[[str], str], pad: float = 0.6
) -> None:
    panel.set_yticks(range(len(names)), [label(name) for name in reversed(names)])
    panel.tick_params(axis="y", length=0)
    panel.spines["left"].set_visible(False)
    panel.set_ylim(-pad, len(names) - 1 + pad)


def _finite(values: ArrayLike) -> Floats:
    array = np.asarray(values, dtype=np.float64)
    return array[np.isfinite(array)]


def _any(samples: Mapping[str, Floats]) -> bool:
    return any(len(sample) for sample in samples.values())


def _near_zero(samples: Mapping[str, Floats]) -> bool:
    pooled = np.concatenate([s for s in samples.values() if len(s)])
    return bool(pooled.min() < 0.35 * pooled.max())


def _thinned(sample: Floats) -> Floats:
    """Evenly spaced order statistics of a large sample."""
    if len(sample) <= MOST_DOTS:
        return sample
    return np.asarray(np.sort(sample)[np.linspace(0, len(sample) - 1, MOST_DOTS).astype(int)])


def _spread(count: int) -> Floats:
    """Offsets in [0, 1) that fill a strip evenly and are the same every time (golden ratio)."""
    return np.asarray((np.arange(count) * 0.6180339887498949) % 1.0)


def locator(bins: int) -> Any:
    """Ticks at round numbers, about so many."""
    from matplotlib.ticker import MaxNLocator

    return MaxNLocator(bins, steps=[1, 2, 2.5, 5, 10])


def thousands() -> Any:
    """Ticks as 20k for 20,000."""
    from matplotlib.ticker import FuncFormatter

    return FuncFormatter(lambda x, _: f"{x / 1000:g}k" if abs(x) >= 1000 else f"{x:g}")
