"""Figures of paths: a rollout above its recording, in their arena, with names and a scale bar."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from animarl_algos.report import style
from animarl_algos.report.words import Words
from animarl_envs.arena import Arena
from animarl_envs.demos.units import Unit

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Floats = NDArray[np.float64]
View = tuple[float, float, float]


def trajectory_pair(
    simulated: Floats,
    recorded: Floats,
    arena: Arena,
    roles: Sequence[str],
    names: Sequence[str],
    words: Words,
    title: str = "",
) -> Figure:
    """A rollout above the demonstration that it started from.

    Parameters
    ----------
    simulated, recorded
        ``(frames, individuals, 2)``, arena frame [arena unit].
    arena, roles, names
        The field, whose outline is drawn, and what each individual is and is called.
    words
        What the demonstration and the unit of the scale bar are called.
    """
    with style.figure_style():
        from matplotlib.patches import Rectangle

        figure, axes = style.new_figure(1.9, 4.5, rows=2)
        view = view_of(arena, simulated, recorded)
        x, y, half = view
        for panel, path, name in zip(
            axes, (simulated, recorded), ("simulated", words.say("recorded"))
        ):
            draw_paths(panel, path, arena, roles, names)
            panel.set(xlim=(x - half, x + half), ylim=(y - half, y + half))
            if arena.shape == "open":
                panel.add_patch(
                    Rectangle((x - half, y - half), 2 * half, 2 * half, color=style.FLOOR, zorder=0)
                )
            panel.text(
                0.0, 1.02, name, transform=panel.transAxes, fontsize=8, color=style.MUTED,
                va="bottom",
            )  # fmt: skip
        _scale_bar(axes[-1], view, words.unit)
        figure.legend(
            *(part[::-1] for part in axes[0].get_legend_handles_labels()),
            loc="outside lower left", fontsize=7, handlelength=2.6, labelspacing=0.25,
            borderaxespad=0.2,
        )  # fmt: skip
        if title:
            figure.suptitle(title, fontsize=8, x=0.02, ha="left")
    return figure


def draw_paths(
    panel: Axes, path: Floats, arena: Arena, roles: Sequence[str], names: Sequence[str]
) -> None:
    """Paths in an arena: open mark at the start, filled at the end, a cross at the source."""
    from matplotlib.patches import Circle, Rectangle

    outline: dict[str, Any] = {
        "fill": True, "facecolor": style.FLOOR, "edgecolor": style.MUTED,
        "linewidth": 1.4 if arena.rebound else 0.8,
        "linestyle": "-" if arena.rebound else (0, (4, 2)), "zorder": 0,
    }  # fmt: skip
    if arena.shape == "square":
        panel.add_patch(
            Rectangle((-arena.size, -arena.size), 2 * arena.size, 2 * arena.size, **outline)
        )
    elif arena.shape == "disc":
        panel.add_patch(Circle((0.0, 0.0), arena.size, **outline))
    if "searcher" in roles:
        panel.plot(0.0, 0.0, "x", color=style.RECORDED_COLOUR, markersize=6, markeredgewidth=1.5)
    for k, look in reversed(list(enumerate(style.looks(roles)))):
        xy = path[:, k]
        panel.plot(
            xy[:, 0], xy[:, 1], color=look.colour, linestyle=look.dashes, linewidth=1.2,
            label=names[k],
        )  # fmt: skip
        panel.plot(
            *xy[0], look.marker, markersize=3.8, markerfacecolor=style.GROUND,
            markeredgecolor=look.colour, markeredgewidth=0.9,
        )  # fmt: skip
        panel.plot(*xy[-1], look.marker, markersize=4.4, color=look.colour,
                   markeredgecolor=style.GROUND, markeredgewidth=0.5)  # fmt: skip
    panel.set_aspect("equal")
    panel.set_axis_off()


def view_of(arena: Arena, simulated: Floats, recorded: Floats) -> View:
    """A square window: centre and half side [arena unit].

    It holds the arena and both paths; in an open field, where a lost searcher may be anywhere, the
    recording and the source with room around them.
    """
    points = recorded.reshape(-1, 2)
    if arena.shape == "open":
        points = np.concatenate([points, [[0.0, 0.0]]])
        margin = 1.5
    else:
        edge = min(1.08 * arena.boundary, 1.5 * arena.size)  # a step beyond stays in view
        points = np.concatenate([points, simulated.reshape(-1, 2), [[-edge] * 2, [edge] * 2]])
        margin = 1.04
    low, high = points.min(axis=0), points.max(axis=0)
    x, y = (low + high) / 2
    return float(x), float(y), float((high - low).max()) / 2 * margin


def bar_length(half: float, unit: Unit) -> float:
    """A round length for a scale bar, at most a quarter of the window, in the unit told."""
    most = half * unit.per_arena_unit / 2
    power = 10.0 ** np.floor(np.log10(most))
    return float(max(step * power for step in (1, 2, 5) if step * power <= most))


def _scale_bar(panel: Axes, view: View, unit: Unit) -> None:
    """Below the window, so that it covers no path."""
    x, y, half = view
    length = bar_length(half, unit)
    left, below = x - half, y - 1.06 * half
    panel.plot(
        [left, left + length / unit.per_arena_unit], [below, below], color=style.TEXT,
        linewidth=1.4, clip_on=False, solid_capstyle="butt",
    )  # fmt: skip
    panel.text(
        left + length / unit.per_arena_unit + 0.06 * half, below, f"{length:g} {unit.name}",
        fontsize=7, va="center",
    )  # fmt: skip
