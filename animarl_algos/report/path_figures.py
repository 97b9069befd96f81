"""Figures in the arena: paths from one start."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from animarl_algos.report import style
from animarl_algos.report.words import Words
from animarl_envs.arena import Arena
from animarl_envs.demos.summary import Unit
from animarl_envs.drawing.render import round_length
from animarl_envs.focus import is_free
from animarl_envs.species import Species

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Floats = NDArray[np.float64]
View = tuple[float, float, float]


@dataclass(frozen=True)
class Stage:
    """Where animals move and who they are: what is drawn beside every path.

    ``contact_radius`` is how near a pursuer comes to touch the target, or the searcher to reach the
    source [arena unit].
    """

    arena: Arena
    roles: Sequence[str]
    names: Sequence[str]
    words: Words
    contact_radius: float | None = None

    def of(self, species: Species) -> Stage:
        """Return the stage of that species."""
        return replace(
            self,
            arena=replace(species.arena, rebound=self.arena.rebound),
            roles=species.roles,
            names=species.individuals,
            contact_radius=contact_drawn(species),
        )


def contact_drawn(species: Species) -> float | None:
    """Return how near is contact, where somebody is pursued or searches [arena unit]."""
    return None if is_free(species.roles) else species.contact_radius


# -- paths ----------------------------------------------------------------------------------------


def path_panels(
    paths: Sequence[tuple[str, Floats]],
    recorded: Floats,
    stage: Stage,
    title: str = "",
    *,
    below: bool = False,
) -> Figure:
    """Draw paths from one start in one window, with a scale bar.

    Each is named, ``(frames, individuals, 2)``, arena frame [arena unit]. The demonstration that
    they started from, ``recorded``, stays in the window. Panels stand side by side, or ``below``
    one another with names of the individuals.
    """
    view = view_of(stage.arena, recorded, *(path for _, path in paths))
    x, y, half = view
    with style.figure_style():
        from matplotlib.patches import Rectangle

        size = (1.9, 4.5, len(paths), 1) if below else (1.55 * len(paths), 2.1, 1, len(paths))
        figure, axes = style.new_figure(*size)
        axes = np.atleast_1d(axes)
        for panel, (name, path) in zip(axes, paths):
            draw_paths(panel, path, stage.arena, stage.roles, stage.names)
            panel.set(xlim=(x - half, x + half), ylim=(y - half, y + half))
            if stage.arena.shape == "open":
                window = (x - half, y - half)
                panel.add_patch(
                    Rectangle(window, 2 * half, 2 * half, color=style.FLOOR.hex, zorder=0)
                )
            panel.set_title(name, fontsize=7.5, fontweight="normal", pad=3)
        _scale_bar(axes[-1 if below else 0], view, stage.words.unit)
        if below:
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
    """Draw paths in an arena: open mark at the start, filled at the end, a cross at the source."""
    from matplotlib.patches import Circle, Rectangle

    outline: dict[str, Any] = {
        "fill": True, "facecolor": style.FLOOR.hex, "edgecolor": style.MUTED.hex,
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
        panel.plot(0.0, 0.0, "x", color=style.TARGET.hex, markersize=6, markeredgewidth=1.5)
    ground = style.PAGE.hex
    for k, look in reversed(list(enumerate(style.looks(roles)))):
        panel.plot(
            *path[:, k].T, color=look.colour, linestyle=look.dashes, linewidth=1.2, label=names[k]
        )
        panel.plot(
            *path[0, k], look.marker, markersize=3.8, markerfacecolor=ground,
            markeredgecolor=look.colour, markeredgewidth=0.9,
        )  # fmt: skip
        panel.plot(
            *path[-1, k], look.marker, markersize=4.4, color=look.colour, markeredgecolor=ground,
            markeredgewidth=0.5,
        )  # fmt: skip
    panel.set_aspect("equal")
    panel.set_axis_off()


def view_of(arena: Arena, recorded: Floats, *others: Floats) -> View:
    """Return a square window: centre and half side [arena unit].

    It holds the arena and all paths; in an open field, where a lost searcher may be anywhere, the
    recording and the source with room around them.
    """
    points = recorded.reshape(-1, 2)
    if arena.shape == "open":
        points = np.concatenate([points, [[0.0, 0.0]]])
        margin = 1.5
    else:
        edge = min(1.08 * arena.boundary, 1.5 * arena.size)  # a step beyond stays in view
        moved = (path.reshape(-1, 2) for path in others)
        points = np.concatenate([points, *moved, [[-edge] * 2, [edge] * 2]])
        margin = 1.04
    low, high = points.min(axis=0), points.max(axis=0)
    x, y = (low + high) / 2
    return float(x), float(y), float((high - low).max()) / 2 * margin


def _scale_bar(panel: Axes, view: View, unit: Unit) -> None:
    """Below the window, so that it covers no path."""
    x, y, half = view
    length, label = round_length(half * unit.per_arena_unit / 2, unit.name)
    left, below = x - half, y - 1.06 * half
    right = left + length / unit.per_arena_unit
    panel.plot(
        [left, right], [below, below], color=style.TEXT.hex, linewidth=1.4, clip_on=False,
        solid_capstyle="butt",
    )  # fmt: skip
    panel.text(right + 0.06 * half, below, label, fontsize=7, va="center")
