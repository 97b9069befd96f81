"""Figures of paths: a rollout beside its recording, in their arena."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from animarl_algos.report import style
from animarl_envs.arena import Arena

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Floats = NDArray[np.float64]


def trajectory_pair(
    simulated: Floats, recorded: Floats, arena: Arena, roles: Sequence[str], title: str = ""
) -> Figure:
    """A rollout above the demonstration that it started from.

    Parameters
    ----------
    simulated, recorded
        ``(frames, individuals, 2)``, arena frame [arena unit].
    arena, roles
        The field, whose outline is drawn, and what each individual is.
    """
    with style.figure_style():
        from matplotlib.patches import Rectangle

        figure, axes = style.new_figure(1.7, 3.6, rows=2)
        view = _view(arena, simulated, recorded)
        x, y, half = view
        for panel, path, name in zip(axes, (simulated, recorded), ("simulated", "recorded")):
            draw_paths(panel, path, arena, roles)
            panel.set(xlim=(x - half, x + half), ylim=(y - half, y + half))
            if arena.shape == "open":
                panel.add_patch(
                    Rectangle((x - half, y - half), 2 * half, 2 * half, color=style.FLOOR, zorder=0)
                )
                _scale_bar(panel, view)
            panel.text(
                0.0, 1.02, name, transform=panel.transAxes, fontsize=8, color=style.MUTED,
                va="bottom",
            )  # fmt: skip
        if title:
            figure.suptitle(title, fontsize=8.5, x=0.02, ha="left")
    return figure


def draw_paths(panel: Axes, path: Floats, arena: Arena, roles: Sequence[str]) -> None:
    """Paths in an arena: open circle at the start, filled at the end, a cross at the source."""
    from matplotlib.patches import Circle, Rectangle

    outline: dict[str, Any] = {
        "fill": True, "facecolor": style.FLOOR, "edgecolor": style.MUTED, "linewidth": 0.8,
        "zorder": 0,
    }  # fmt: skip
    if arena.shape == "square":
        panel.add_patch(
            Rectangle((-arena.size, -arena.size), 2 * arena.size, 2 * arena.size, **outline)
        )
    elif arena.shape == "disc":
        panel.add_patch(Circle((0.0, 0.0), arena.size, **outline))
    if "searcher" in roles:
        panel.plot(0.0, 0.0, "x", color=style.RECORDED_COLOUR, markersize=6, markeredgewidth=1.5)
    colours = style.individual_colours(roles)
    for k in reversed(range(len(roles))):
        xy, colour = path[:, k], colours[k]
        panel.plot(xy[:, 0], xy[:, 1], color=colour, linewidth=1.1, alpha=0.9)
        panel.plot(
            *xy[0], "o", markersize=3.6, markerfacecolor="white", markeredgecolor=colour,
            markeredgewidth=0.9,
        )  # fmt: skip
        panel.plot(*xy[-1], "o", markersize=4.0, color=colour, markeredgecolor="white",
                   markeredgewidth=0.5)  # fmt: skip
    panel.set_aspect("equal")
    panel.set_axis_off()


def _view(arena: Arena, simulated: Floats, recorded: Floats) -> tuple[float, float, float]:
    """A square window: centre and half side.

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


def _scale_bar(panel: Axes, view: tuple[float, float, float]) -> None:
    """A bar of a round length, about a quarter of the window."""
    x, y, half = view
    power = 10.0 ** np.floor(np.log10(half / 2))
    length = max(step * power for step in (1, 2, 5) if step * power <= half / 2)
    left, bottom = x - 0.9 * half, y - 0.9 * half
    panel.plot([left, left + length], [bottom, bottom], color=style.TEXT, linewidth=1.2)
    panel.text(
        left + length / 2, bottom + 0.03 * half, f"{length:g}", fontsize=7, ha="center", va="bottom"
    )
