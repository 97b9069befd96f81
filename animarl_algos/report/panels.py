"""Panels for papers: recorded against simulated animals, each drawn on any axes.

A panel is a function of axes and of :class:`SideBySide`; it draws, and returns what it drew as a
table. :func:`draw_panels` sets several in one figure of a journal's width, and
:func:`write_panels` saves it, with the table of each panel beside it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from animarl_algos.evaluation.order_in_time import Series, stretches
from animarl_algos.evaluation.prepared import Prepared, comparison_smoothing, dtw_alignments
from animarl_algos.evaluation.rollouts import RECORDED, Rollouts
from animarl_algos.evaluation.verdict import Verdict
from animarl_algos.report import figures, style
from animarl_algos.report.verdict_section import forest_rows
from animarl_algos.report.words import Words
from animarl_envs.array_types import Floats
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.errors import InputError, require
from animarl_envs.files import write_then_rename
from animarl_envs.focus import nearest_other

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SIMULATED = "simulated"
WIDTHS = {"single": 89.0, "double": 183.0}  # of a column, and of two, in most journals [mm]
NARROWEST, WIDEST = 40.0, 400.0  # [mm]
COLUMN = 55.0  # narrowest panel where several stand side by side [mm]
ROW_HEIGHT = 48.0  # [mm]
QUESTION_HEIGHT = 3.6  # of a row of the verdict [mm]
INCH = 25.4  # [mm]
FORMATS: dict[str, dict[str, Any]] = {
    "svg": {"metadata": {"Date": None}},
    "png": {"dpi": 600, "metadata": {"Software": None}},
    "pdf": {"metadata": {"CreationDate": None}},
}  # without dates: the same figure gives the same bytes
PAPER: dict[str, Any] = {
    "pdf.fonttype": 42,  # texts that can be edited
    "font.size": 7.0,
    "axes.titlesize": 8.0,
    "axes.labelsize": 7.0,
    "xtick.labelsize": 6.5,
    "ytick.labelsize": 6.5,
    "legend.fontsize": 6.5,
}


@dataclass(frozen=True, eq=False)
class SideBySide:
    """Recordings and the rollouts from their starts, as panels take them.

    Both are compared as the verdict compares them: rollouts in the recorded condition, cut where
    their recording was, and both smoothed alike.

    Parameters
    ----------
    demos
        The recordings, such as ``run.demos.select(split="test")``.
    rollouts
        Rollouts of one method from their starts, such as ``run.simulate()``.
    verdict
        Of the same, for the panel of that name.
    """

    demos: Demonstrations
    rollouts: Rollouts
    verdict: Verdict | None = None

    @cached_property
    def words(self) -> Words:
        """What recordings and the unit of lengths are called."""
        return Words.of(self.demos)

    @cached_property
    def _prepared(self) -> Prepared:
        return Prepared(self.demos, comparison_smoothing(self.demos))

    @cached_property
    def both(self) -> dict[str, Rollouts]:
        """Recorded and simulated episodes, by name."""
        simulated = self._prepared.counted(self.rollouts)
        require(
            len(simulated) > 0,
            "no rollout is in the condition of its recording: simulate without a change",
        )
        return {self.words.adapt(RECORDED): self._prepared.recorded, SIMULATED: simulated}

    def series(self, side: str) -> list[Series]:
        """Return speeds, turns and motion of the episodes of one side."""
        return list(Series.of(self.both[side], self._prepared.rest))


def paths(ax: Axes, sides: SideBySide) -> pd.DataFrame:
    """Draw the recording whose rollout is the median one by DTW distance, and that rollout."""
    name, simulated = next(iter(sides.both)), sides.both[SIMULATED]
    distances = dtw_alignments(simulated, sides.demos)[0].mean(axis=1)
    chosen = int(np.argsort(distances, kind="stable")[len(distances) // 2])
    demo, demos, tables = int(simulated.demo[chosen]), sides.demos, []
    as_it_is = sides.rollouts.factual(demos).path(chosen)[: simulated.lengths[chosen]]
    drawn = {name: demos.path(demo), SIMULATED: as_it_is}
    view = figures.view_of(demos.arena, drawn[name], drawn[SIMULATED])
    ax.set_axis_off()
    for place, (side, path) in enumerate(drawn.items()):
        window = ax.inset_axes((0.51 * place, 0.06, 0.49, 0.86))
        figures.draw_paths(window, path, demos.arena, demos.roles, demos.individuals)
        figures.frame_window(window, view, demos.arena)
        window.set_title(side.capitalize(), fontweight="normal", loc="center", pad=2)
        if place == 0:
            figures.draw_scale_bar(window, view, sides.words.unit)
        frames, num, _ = path.shape
        places = sides.words.unit.per_arena_unit * path.reshape(-1, 2)
        table = {
            "side": side,
            "recording": demos.recording[demo],
            "time_s": np.repeat(np.arange(frames) * demos.dt, num),
            "id": np.tile(demos.individuals, frames),
            f"x ({sides.words.unit.name})": places[:, 0],
            f"y ({sides.words.unit.name})": places[:, 1],
        }
        tables.append(pd.DataFrame(table))
    return pd.concat(tables, ignore_index=True)


def speeds(ax: Axes, sides: SideBySide) -> pd.DataFrame:
    """Draw the distribution of the speed of every step, those of a target apart."""
    roles, factor = np.array(sides.demos.roles), sides.words.unit.per_arena_unit
    samples, colours = {}, {}
    for role in dict.fromkeys(sides.demos.roles):
        label = f"{role}, " if len(set(roles)) > 1 else ""
        samples[label] = [factor * one.speeds()[:, roles == role] for one in sides.both.values()]
        colours[label] = style.TARGET.hex if role == "target" else style.BLUE.hex
    return _histograms(ax, sides, samples, f"Speed ({sides.words.speed})", colours)


def turning(ax: Axes, sides: SideBySide) -> pd.DataFrame:
    """Draw the distribution of turns between successive steps of moving animals, left above 0."""
    turns = [
        np.degrees(np.concatenate([one.turn.ravel() for one in sides.series(side)]))
        for side in sides.both
    ]
    edges = np.linspace(-180.0, 180.0, figures.BINS)
    ax.set_xticks([-180, -90, 0, 90, 180])
    axis = f"Turn in {sides.demos.dt:g} s (\N{DEGREE SIGN}, left is positive)"
    return _histograms(ax, sides, {"": turns}, axis, edges=edges)


def bouts(ax: Axes, sides: SideBySide) -> pd.DataFrame:
    """Draw which share of bouts of motion, and of rests, lasts longer than a time."""
    tables, dt = [], sides.demos.dt
    for kind, colour, dashes in (
        ("motion", style.BLUE.hex, style.DASHES[0]),
        ("rest", style.VERMILION.hex, style.DASHES[1]),
    ):
        for side in sides.both:
            moving = [(one.moving, np.isfinite(one.speed)) for one in sides.series(side)]
            lengths = np.concatenate(
                [stretches((true == (kind == "motion")) & known) for true, known in moving]
            )
            if not len(lengths):
                continue
            steps, counts = np.unique(lengths, return_counts=True)
            share = np.append(1.0, 1.0 - counts.cumsum() / len(lengths))
            times, simulated = np.append(0.0, steps * dt), side == SIMULATED
            ax.step(
                times,
                share,
                where="post",
                color=colour,
                linestyle=dashes,
                linewidth=1.2 if simulated else 3.2,
                alpha=1.0 if simulated else 0.35,
                label=f"{kind}, {side}",
            )
            table = {"kind": kind, "side": side, "longer_than_s": times, "share": share}
            tables.append(pd.DataFrame(table))
    smallest = min(one["share"][one["share"] > 0].min() for one in tables)
    ax.set_yscale("log")
    ax.yaxis.set_major_formatter("{x:g}")
    ax.yaxis.set_minor_formatter("")
    ax.set(xlabel="Length of the bout (s)", ylabel="Share that is longer", ylim=(smallest / 2, 1.1))
    ax.set_xlim(left=0.0)
    ax.legend(loc="best")
    return pd.concat(tables, ignore_index=True)


def neighbours(ax: Axes, sides: SideBySide) -> pd.DataFrame:
    """Draw the distribution of the distance to the nearest other animal, in every frame."""
    require(sides.demos.num_individuals > 1, "neighbours: there is one animal, so leave it out")
    factor, unit = sides.words.unit.per_arena_unit, sides.words.unit.name
    near = [
        factor * np.linalg.norm(nearest_other(one.positions), axis=-1)
        for one in sides.both.values()
    ]
    return _histograms(ax, sides, {"": near}, f"Distance to the nearest other ({unit})")


def verdict(ax: Axes, sides: SideBySide) -> pd.DataFrame:
    """Draw the difference of every question of the verdict in units of its tolerance."""
    if sides.verdict is None:
        raise InputError("verdict: the run has none: make it with 'animarl evaluate RUN'")
    rows = forest_rows(sides.verdict)
    figures.draw_forest(ax, rows, sides.words.adapt)
    ax.tick_params(axis="y", labelsize="small")
    columns = ["question", "judgement", "difference_in_tolerances", "low", "high"]
    return pd.DataFrame(rows[::-1], columns=columns)


Panel = Callable[["Axes", SideBySide], pd.DataFrame]
PANELS: dict[str, Panel] = {
    one.__name__: one for one in (paths, speeds, turning, bouts, neighbours, verdict)
}


def fitting_panels(sides: SideBySide) -> list[str]:
    """Return the names of the panels that can be drawn."""
    missing = {"neighbours"} if sides.demos.num_individuals == 1 else set()
    if sides.verdict is None:
        missing.add("verdict")
    return [name for name in PANELS if name not in missing]


def width_in_mm(given: str) -> float:
    """Return a journal's width, ``single``, ``double`` or a number, in mm."""
    try:
        width = WIDTHS.get(given) or float(given)
    except ValueError:
        width = math.nan
    if not NARROWEST <= width <= WIDEST:
        raise InputError(
            f"width is {given!r}: give single, double, or {NARROWEST:g} to {WIDEST:g} mm"
        )
    return width


def draw_panels(
    sides: SideBySide, names: Sequence[str], width: float
) -> tuple[Figure, dict[str, pd.DataFrame]]:
    """Return a figure of that width [mm] with these panels, and the table of each.

    Panels stand in rows, in their order; the verdict has a row of its own. Raises InputError if a
    panel is unknown or cannot be drawn.
    """
    for name in names:
        if name not in PANELS:
            raise InputError(f"panel {name!r} is unknown: choose among {', '.join(PANELS)}")
    names = list(dict.fromkeys(names))
    columns = max(1, min(int(width / COLUMN), len(names)))
    rows: list[list[str]] = []
    for name in names:
        wide = name == "verdict"
        if wide or not rows or rows[-1][0] == "verdict" or len(rows[-1]) == columns:
            rows.append([])
        rows[-1].append(name)
    questions = 0 if sides.verdict is None else len(sides.verdict.table)
    heights = [
        12.0 + QUESTION_HEIGHT * questions if row == ["verdict"] else ROW_HEIGHT for row in rows
    ]
    tables = {}
    with style.figure_style(PAPER):
        from matplotlib.figure import Figure

        size = (width / INCH, sum(heights) / INCH)
        figure = Figure(figsize=size, layout="constrained")
        lines = figure.subfigures(len(rows), 1, height_ratios=heights, squeeze=False)[:, 0]
        for line, row in zip(lines, rows):
            across = 1 if row == ["verdict"] else columns
            for name, ax in zip(row, line.subplots(1, across, squeeze=False)[0]):
                tables[name] = PANELS[name](ax, sides)
                if len(names) > 1:
                    ax.set_title("abcdef"[names.index(name)], loc="left")
            for ax in line.axes[len(row) :]:
                ax.set_axis_off()
    return figure, tables


def write_panels(
    sides: SideBySide, names: Sequence[str], out: str | Path, width: float = WIDTHS["double"]
) -> list[Path]:
    """Write the figure of these panels to ``out``, the table of each beside it, and return all.

    The suffix of ``out`` chooses among PDF, SVG and PNG. The same rollouts give the same bytes.
    """
    out = Path(out)
    kind = out.suffix.removeprefix(".").lower()
    require(kind in FORMATS, f"{out}: the suffix says the format: choose .pdf, .svg or .png")
    figure, tables = draw_panels(sides, names, width)
    with style.figure_style(PAPER), write_then_rename(out) as part:
        figure.savefig(part, format=kind, **FORMATS[kind])
    written = [out]
    for name, table in tables.items():
        written.append(out.with_name(f"{out.stem}-{name}.csv"))
        with write_then_rename(written[-1]) as part:
            table.to_csv(part, index=False, float_format="%.6g")
    return written


def _histograms(
    ax: Axes,
    sides: SideBySide,
    samples: Mapping[str, Sequence[Floats]],
    axis: str,
    colours: Mapping[str, str] | None = None,
    edges: Floats | None = None,
) -> pd.DataFrame:
    """Draw a recorded and a simulated sample by label, on shared bins, and return the densities."""
    every = [np.ravel(one) for pair in samples.values() for one in pair]
    edges = figures.shared_edges(*every) if edges is None else edges
    tables = []
    for place, (label, pair) in enumerate(samples.items()):
        recorded, simulated = (one[np.isfinite(one)] for one in map(np.ravel, pair))
        names = [f"{label}{side}" for side in sides.both]
        colour = (colours or {}).get(label, style.BLUE.hex)
        fill = style.FILL.hex if len(samples) == 1 else colour
        densities = figures.draw_histograms(
            ax,
            recorded,
            simulated,
            edges,
            names,
            fill=fill,
            line=colour,
            dashes=style.DASHES[place],
        )
        bins = {"low": edges[:-1], "high": edges[1:]}
        tables.append(pd.DataFrame(bins | dict(zip(names, densities))))
    ax.set(xlabel=axis, ylabel="Density", xlim=(edges[0], edges[-1]))
    ax.legend(loc="best")
    return pd.concat([tables[0], *(one.iloc[:, 2:] for one in tables[1:])], axis=1)
