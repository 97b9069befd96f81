"""Figures of a counterfactual: every episode as a dot, shifts beside their truth, paths."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from animarl_algos.evaluation.statistics import Interval
from animarl_algos.report import style
from animarl_algos.report.figures import draw_interval
from animarl_algos.report.path_figures import draw_paths
from animarl_envs.arena import Arena

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Floats = NDArray[np.float64]


class Dots(NamedTuple):
    """One column of episodes: its label, whose they are, one value each; hollow where flipped."""

    label: str
    method: str
    values: Floats
    flipped: bool = False


class ShiftRow(NamedTuple):
    """One line of shifts: label, value with interval, colour by method, whether it is a null."""

    label: str
    value: Interval
    method: str
    null: bool = False


def episode_dots(columns: Sequence[Dots], label: str) -> Figure:
    """Every episode as a dot, a column per question; the bar is the mean of the column.

    Dots are spread sideways by rank within their column, the same every time.
    """
    with style.figure_style():
        figure, panel = style.new_figure(1.1 + 0.62 * len(columns), 3.6)
        style.light_grid(panel, "y")
        for place, column in enumerate(columns):
            colour = style.method_colour(column.method, place)
            values = np.asarray(column.values, dtype=np.float64)
            sideways = 0.6 * (((np.arange(len(values)) * 0.6180339887498949) % 1.0) - 0.5)
            panel.plot(
                place + sideways, values, "o", markersize=3.4, alpha=0.7, markeredgewidth=0.8,
                markeredgecolor=colour, markerfacecolor="none" if column.flipped else colour,
                rasterized=len(values) > 400,
            )  # fmt: skip
            if len(values):
                panel.plot(
                    [place - 0.36, place + 0.36], [values.mean()] * 2, color=style.TEXT,
                    linewidth=1.8, zorder=4,
                )  # fmt: skip
        panel.set_xticks(range(len(columns)), [c.label for c in columns], rotation=40, ha="right")
        panel.tick_params(axis="x", length=0)
        panel.set_xlim(-0.6, len(columns) - 0.4)
        panel.set(ylabel=label)
        panel.set_ylim(bottom=0)
    return figure


def shift_rows(rows: Sequence[ShiftRow], label: str, title: str) -> Figure:
    """Predicted and true shifts over the nulls, from top to bottom; the line is no shift."""
    with style.figure_style():
        figure, panel = style.new_figure(4.8, 0.8 + 0.34 * len(rows))
        style.light_grid(panel)
        for i, row in enumerate(rows):
            base = float(len(rows) - 1 - i)
            colour = style.MUTED if row.null else style.method_colour(row.method, i)
            draw_interval(panel, row.value, base, colour)
        panel.axvline(0.0, color=style.MUTED, linewidth=0.7, linestyle=(0, (4, 3)), zorder=0.5)
        panel.set_yticks(range(len(rows)), [row.label for row in reversed(rows)])
        panel.tick_params(axis="y", length=0)
        panel.spines["left"].set_visible(False)
        panel.set_ylim(-0.6, len(rows) - 0.4)
        panel.set(xlabel=label, title=title)
    return figure


def path_row(
    paths: Sequence[tuple[str, Floats]],
    arena: Arena,
    roles: Sequence[str],
    names: Sequence[str],
    title: str,
) -> Figure:
    """Paths from one start side by side, in one window: what was asked stands above each."""
    with style.figure_style():
        figure, axes = style.new_figure(1.55 * len(paths), 2.0, columns=len(paths))
        points = np.concatenate([path.reshape(-1, 2) for _, path in paths] + [np.zeros((1, 2))])
        if arena.shape == "open":
            low, high = points.min(axis=0), points.max(axis=0)
        else:
            edge = np.full(2, min(1.08 * arena.boundary, 1.5 * arena.size))
            low = np.minimum(points.min(axis=0), -edge)
            high = np.maximum(points.max(axis=0), edge)
        centre, half = (low + high) / 2, float((high - low).max()) / 2 * 1.04
        for panel, (name, path) in zip(np.atleast_1d(axes), paths):
            draw_paths(panel, path, arena, roles, names)
            panel.set(
                xlim=(centre[0] - half, centre[0] + half), ylim=(centre[1] - half, centre[1] + half)
            )
            panel.set_title(name, fontsize=7.5, fontweight="normal")
        figure.suptitle(title, fontsize=8.5, x=0.01, ha="left")
    return figure
