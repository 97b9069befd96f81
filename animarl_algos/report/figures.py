"""Figures: histograms, intervals with or without the values behind them, paths from one start.

Each function takes arrays or tables and returns one matplotlib figure of one panel, small enough
that a page can set several side by side, or below one another on a narrow screen. A figure that is
added here is put on the page by a ``Gallery`` of :mod:`animarl_algos.report.run_page`.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from itertools import cycle
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from animarl_algos.evaluation.statistics import Interval
from animarl_algos.evaluation.verdict_rows import ALIKE, DIFFERS, LITTLE, UNKNOWN
from animarl_algos.report import style
from animarl_algos.report.words import Words
from animarl_envs.arena import Arena
from animarl_envs.array_types import Floats
from animarl_envs.demos.summary import Unit
from animarl_envs.drawing.render import round_length
from animarl_envs.fitting.custom_species import SMALLEST_CONTACT
from animarl_envs.focus import is_free
from animarl_envs.species import Species

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

View = tuple[float, float, float]

ROW_HEIGHT = 0.52  # of one method in a distribution [inch]
BINS = 41  # edges of the bins of a histogram
POINTS = 200  # of a density
MOST_DOTS = 400  # more rollouts than this are thinned evenly in drawings, never in numbers
RANK_BINS = 5
FOREST_LIMIT = 4.0  # tolerances to either side
WORD_COLOURS = {
    ALIKE: style.GREEN,
    LITTLE: style.ORANGE,
    DIFFERS: style.VERMILION,
    UNKNOWN: style.STONE,
}
GOLDEN_RATIO = 0.6180339887498949
REFERENCE: dict[str, Any] = {
    "color": style.MUTED.hex,
    "linewidth": 0.7,
    "linestyle": (0, (4, 3)),
    "zorder": 0.5,
}


@contextmanager
def one_panel(width: float, height: float, grid: str, **texts: str) -> Iterator[tuple[Figure, Any]]:
    """Hand out a new figure and its axes; ``texts`` are its title and the labels of its axes."""
    with style.figure_style():
        figure, panel = style.new_figure(width, height)
        if grid:
            panel.grid(axis=grid, color=style.LINE.hex, linewidth=0.5)
        panel.set(**texts)
        yield figure, panel


def histograms(
    simulated: Floats, recorded: Floats, axis: str, title: str = "", name: str = "recorded"
) -> Figure:
    """Draw two samples on shared bins, recorded filled and simulated as a line; areas are one."""
    edges = shared_edges(simulated, recorded)
    with one_panel(3.4, 2.1, "", xlabel=axis, ylabel="Density", title=title) as (figure, panel):
        draw_histograms(panel, recorded, simulated, edges, (name, "simulated"))
        panel.set_xlim(edges[0], edges[-1])
        panel.legend(loc="best")
    return figure


def shared_edges(*samples: Floats) -> Floats:
    """Return the edges of bins from 0 that hold all samples."""
    return np.linspace(0.0, max(one.max(initial=0.0) for one in samples) or 1.0, BINS)


def draw_histograms(
    panel: Axes,
    recorded: Floats,
    simulated: Floats,
    edges: Floats,
    labels: Sequence[str],
    *,
    fill: str = style.FILL.hex,
    line: str = style.BLUE.hex,
    dashes: Any = "-",
) -> tuple[Floats, Floats]:
    """Draw recorded values filled and simulated ones as a line; return both densities."""
    densities = [
        np.histogram(one, edges, density=True)[0] if len(one) else np.zeros(len(edges) - 1)
        for one in (recorded, simulated)
    ]
    panel.stairs(
        densities[0], edges, fill=True, color=fill, alpha=0.45, linewidth=0, label=labels[0]
    )
    panel.stairs(densities[1], edges, color=line, linewidth=1.4, linestyle=dashes, label=labels[1])
    return densities[0], densities[1]


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
    band: float = 0.0,
    hollow: Collection[str] = (),
) -> Figure:
    """Draw one row per method, an estimate with its interval, and a dashed line at ``reference``.

    ``colours`` go over those of the recipes. ``values`` are one per rollout that counts, by method:
    then a density stands above each row, and every rollout below it. A ``band`` of that half width
    lies about the reference; dots of ``hollow`` rows are empty.
    """
    names, samples = list(means), {k: np.asarray(v, np.float64) for k, v in (values or {}).items()}
    height = 0.8 + (0.36 if values is None else ROW_HEIGHT) * len(names)
    with one_panel(4.6, height, "x", xlabel=axis, title=title) as (figure, panel):
        from matplotlib.ticker import MaxNLocator

        for row, name in enumerate(names):
            base = float(len(names) - 1 - row)
            colour = (colours or {}).get(name) or style.method_colour(name, row)
            if name in samples and len(sample := samples[name][np.isfinite(samples[name])]):
                _draw_values(panel, sample, base, colour)
            value, ground = means[name], style.PAGE.hex
            if np.isfinite(value.low):  # ringed in the ground so that it stands out
                ends = [value.low, value.high]
                panel.plot(ends, [base, base], color=ground, linewidth=4.2, zorder=3)
                panel.plot(ends, [base, base], color=colour, linewidth=2.2, zorder=3.1)
            if np.isfinite(value.estimate):
                face, edge = (ground, colour) if name in hollow else (colour, ground)
                panel.plot(
                    value.estimate,
                    base,
                    "o",
                    color=face,
                    markersize=6.2,
                    markeredgecolor=edge,
                    markeredgewidth=1.2,
                    zorder=3.2,
                )
        if reference is not None and np.isfinite(reference):
            panel.axvline(reference, **REFERENCE)
        if reference is not None and band:
            panel.axvspan(reference - band, reference + band, color=style.LINE.hex, lw=0, zorder=0)
        panel.set_yticks(range(len(names)), [label(name) for name in reversed(names)])
        panel.tick_params(axis="y", length=0)
        panel.spines["left"].set_visible(False)
        panel.set_ylim(-0.6, len(names) - 0.4)
        if limits is not None:
            panel.set_xlim(limits)
        panel.xaxis.set_major_locator(MaxNLocator(5, steps=[1, 2, 2.5, 5, 10]))
        panel.xaxis.set_major_formatter("{x:g}")
    return figure


def forest(
    rows: Sequence[tuple[str, str, float, float, float]], say: Callable[[str], str] = str
) -> Figure:
    """Draw questions with their intervals in units of their tolerances, coloured by their words.

    Each row is ``(label, word, value, low, high)``, from bottom to top.
    """
    with one_panel(6.4, 0.8 + 0.24 * len(rows), "") as (figure, panel):
        draw_forest(panel, rows, say)
        panel.tick_params(axis="y", labelsize=7.5)
        for word in WORD_COLOURS:
            panel.plot([], [], "o", color=WORD_COLOURS[word].hex, markersize=5, label=word)
        figure.legend(loc="outside upper left", ncols=len(WORD_COLOURS))
    return figure


def draw_forest(
    panel: Axes,
    rows: Sequence[tuple[str, str, float, float, float]],
    say: Callable[[str], str] = str,
) -> None:
    """Draw the questions of :func:`forest` on any axes."""
    panel.grid(axis="x", color=style.LINE.hex, linewidth=0.5)
    panel.axvspan(-1, 1, color=style.LINE.hex, lw=0, zorder=0)
    panel.axvline(0, **REFERENCE)
    for base, (_, word, value, low, high) in enumerate(rows):
        if not np.isfinite(value):
            continue
        colour = WORD_COLOURS[word].hex
        if np.isfinite(low):
            ends = np.clip([low, high], -FOREST_LIMIT, FOREST_LIMIT)
            panel.plot(ends, [base, base], color=colour, linewidth=1.8)
        place, inside = np.clip(value, -FOREST_LIMIT, FOREST_LIMIT), abs(value) <= FOREST_LIMIT
        mark = "o" if inside else "<" if value < 0 else ">"
        panel.plot(place, base, mark, color=colour, markersize=5)
    panel.set_yticks(range(len(rows)), [say(label) for label, *_ in rows])
    panel.tick_params(axis="y", length=0)
    panel.spines["left"].set_visible(False)
    panel.set_ylim(-0.7, len(rows) - 0.3)
    panel.set(xlim=(-FOREST_LIMIT, FOREST_LIMIT), xlabel="Difference / tolerance")


def rank_histograms(ranks: Mapping[str, Sequence[float]]) -> Figure:
    """Draw how often recordings have each rank among their rollouts; a dashed line is uniform."""
    edges = np.linspace(0.0, 1.0, RANK_BINS + 1)
    with one_panel(4.6, 2.1, "", xlabel="Rank among the rollouts", ylabel="Share") as drawn:
        figure, panel = drawn
        for (name, values), colour, dashes in zip(
            ranks.items(), style.PURSUERS, cycle(style.DASHES)
        ):
            known = np.asarray(values)[np.isfinite(values)]
            shares = np.histogram(known, edges)[0] / max(len(known), 1)
            panel.stairs(shares, edges, label=name, color=colour.hex, linestyle=dashes)
        panel.axhline(1 / RANK_BINS, **REFERENCE)
        panel.set_xlim(0.0, 1.0)
        figure.legend(loc="outside right upper")
    return figure


def occupancy_map(shares: Floats, title: str, most: float) -> Figure:
    """Draw where individuals are: ``shares`` ``(columns, rows)`` of the time, dark at ``most``."""
    from matplotlib.patches import Rectangle

    with one_panel(2.2, 2.4, "", title=title) as (figure, panel):
        for place, share in np.ndenumerate(shares):
            shade = float(share) / most
            cell = Rectangle(place, 1, 1, color=style.BLUE.hex, alpha=shade, linewidth=0)
            panel.add_patch(cell)
        panel.set(xlim=(0, len(shares)), ylim=(0, len(shares)))
        panel.set_aspect("equal")
        panel.set_axis_off()
    return figure


def _draw_values(panel: Axes, sample: Floats, base: float, colour: str) -> None:
    """Values of a sample below ``base``, and above it their density, where they differ."""
    if np.ptp(sample) > 1e-9 * np.abs(sample).max():
        grid = np.linspace(sample.min(), sample.max(), POINTS)
        width = sample.std(ddof=1) * len(sample) ** -0.2  # Scott's rule
        height = np.exp(-(((grid[:, None] - sample) / width) ** 2) / 2).sum(axis=1)
        height = base + 0.46 * height / height.max()
        panel.fill_between(grid, base, height, color=colour, alpha=0.30, linewidth=0)
        panel.plot(grid, height, color=colour, linewidth=0.9)
    dots = np.sort(sample)[np.linspace(0, len(sample) - 1, min(len(sample), MOST_DOTS)).astype(int)]
    offsets = (np.arange(len(dots)) * GOLDEN_RATIO) % 1.0  # the same every time
    panel.plot(
        dots,
        base - 0.12 - 0.18 * offsets,
        ".",
        color=colour,
        markersize=2.4,
        alpha=0.55,
        markeredgewidth=0,
        rasterized=True,
    )


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
            arena=species.arena,
            roles=species.roles,
            names=species.individuals,
            contact_radius=contact_drawn(species),
        )


def contact_drawn(species: Species) -> float | None:
    """Return how near is contact, where somebody is pursued or searches [arena unit].

    None where recordings show no contact, and simulated animals are kept from any.
    """
    none = species.contact_radius <= SMALLEST_CONTACT * species.arena.size
    return None if none or is_free(species.roles) else species.contact_radius


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
    with style.figure_style():
        size = (1.9, 4.5, len(paths), 1) if below else (1.55 * len(paths), 2.1, 1, len(paths))
        figure, axes = style.new_figure(*size)
        axes = np.atleast_1d(axes)
        for panel, (name, path) in zip(axes, paths):
            draw_paths(panel, path, stage.arena, stage.roles, stage.names)
            frame_window(panel, view, stage.arena)
            panel.set_title(name, fontsize=7.5, fontweight="normal", pad=3)
        draw_scale_bar(axes[-1 if below else 0], view, stage.words.unit)
        if below:
            figure.legend(
                *(part[::-1] for part in axes[0].get_legend_handles_labels()),
                loc="outside lower left",
                fontsize=7,
                handlelength=2.6,
                labelspacing=0.25,
                borderaxespad=0.2,
            )
        if title:
            figure.suptitle(title, fontsize=8, x=0.02, ha="left")
    return figure


def draw_paths(
    panel: Axes, path: Floats, arena: Arena, roles: Sequence[str], names: Sequence[str]
) -> None:
    """Draw paths in an arena: open mark at the start, filled at the end, a cross at the source."""
    from matplotlib.patches import Circle, Polygon

    outline: dict[str, Any] = {
        "fill": True,
        "facecolor": style.FLOOR.hex,
        "edgecolor": style.MUTED.hex,
        "linewidth": 1.4 if arena.rebound else 0.8,
        "linestyle": "-" if arena.rebound else (0, (4, 2)),
        "zorder": 0,
    }
    if arena.shape == "square":
        panel.add_patch(Polygon(arena.corners, **outline))
    elif arena.shape == "disc":
        panel.add_patch(Circle((0.0, 0.0), arena.size, **outline))
    for x, y, radius in arena.pillars:
        panel.add_patch(Circle((x, y), radius, **outline | {"facecolor": "none"}))
    for _, *place in arena.landmarks:
        panel.plot(*place, "^", color=style.MUTED.hex, markersize=6)
    if "searcher" in roles:
        panel.plot(0.0, 0.0, "x", color=style.TARGET.hex, markersize=6, markeredgewidth=1.5)
    ground = style.PAGE.hex
    for k, look in reversed(list(enumerate(style.looks(roles)))):
        panel.plot(
            *path[:, k].T, color=look.colour, linestyle=look.dashes, linewidth=1.2, label=names[k]
        )
        panel.plot(
            *path[0, k],
            look.marker,
            markersize=3.8,
            markerfacecolor=ground,
            markeredgecolor=look.colour,
            markeredgewidth=0.9,
        )
        panel.plot(
            *path[-1, k],
            look.marker,
            markersize=4.4,
            color=look.colour,
            markeredgecolor=ground,
            markeredgewidth=0.5,
        )
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


def frame_window(panel: Axes, view: View, arena: Arena) -> None:
    """Set the limits of a window; an open field, which has no edge, fills it."""
    from matplotlib.patches import Rectangle

    x, y, half = view
    panel.set(xlim=(x - half, x + half), ylim=(y - half, y + half))
    if arena.shape == "open":
        corner = (x - half, y - half)
        panel.add_patch(Rectangle(corner, 2 * half, 2 * half, color=style.FLOOR.hex, zorder=0))


def draw_scale_bar(panel: Axes, view: View, unit: Unit) -> None:
    """Draw a scale bar below the window, so that it covers no path."""
    x, y, half = view
    length, label = round_length(half * unit.per_arena_unit / 2, unit.name)
    left, below = x - half, y - 1.06 * half
    right = left + length / unit.per_arena_unit
    panel.plot(
        [left, right],
        [below, below],
        color=style.TEXT.hex,
        linewidth=1.4,
        clip_on=False,
        solid_capstyle="butt",
    )
    panel.text(right + 0.06 * half, below, label, fontsize=7, va="center")
