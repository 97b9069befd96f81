"""The figure to check demonstrations by eye: tracks, speeds, distances, outcomes, gaps."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from animarl_envs.array_types import Floats
from animarl_envs.demos import summary
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.episode import FILLED
from animarl_envs.drawing import palette
from animarl_envs.errors import require_extra
from animarl_envs.files import write_then_rename
from animarl_envs.focus import distances_to_target

ROWS, COLUMNS = 2, 6  # of the episodes drawn
GREY = "0.45"
LEAST_EPISODES = 3  # a median over fewer is not drawn


def plot_summary(demos: Demonstrations, path: str | Path) -> Path:
    """Draw the summary of ``demos`` into a file (``.png``, ``.svg``, ``.pdf``).

    Above: single episodes, spread evenly over the set, with start (dot), end (cross) and filled
    gaps (black). Below: durations, path lengths, speeds, distances to the target, outcomes, and
    what the cleaning found.
    """
    with require_extra("the summary figure", "algos"):
        from matplotlib import rc_context
        from matplotlib.figure import Figure
    path, unit = Path(path), summary.unit_of(demos)
    with rc_context({"text.parse_math": False}):  # a name with dollar signs is a name
        figure = Figure(figsize=(13, 9.5), layout="constrained")
        parts: Any = figure.subfigures(2, 1, height_ratios=(1.0, 1.25))
        kind = "SYNTHETIC episodes" if demos.synthetic else "recorded episodes"
        title = ", ".join(demos.individuals) if demos.species == "custom" else demos.species
        figure.suptitle(
            f"{title}: {demos.num_episodes} {kind}, "
            f"{(demos.lengths - 1).sum() * demos.dt:.0f} s in total",
            fontsize="x-large",
            color="#B00020" if demos.synthetic else "black",
        )
        _draw_episodes(parts[0], demos, unit)
        _draw_distributions(parts[1].subplots(2, 3).ravel(), demos, unit)
        with write_then_rename(path) as part:
            figure.savefig(part, dpi=120)
    return path


def _colours(demos: Demonstrations) -> list[str]:
    """Return the colour of each individual."""
    return [palette.to_hex(palette.colour_of(role, i)) for i, role in enumerate(demos.roles)]


def _draw_episodes(figure: Any, demos: Demonstrations, unit: summary.Unit) -> None:
    drawn = np.unique(np.linspace(0, demos.num_episodes - 1, ROWS * COLUMNS).round().astype(int))
    panels = figure.subplots(ROWS, COLUMNS, sharex=True, sharey=True).ravel()
    size, angle = unit.per_arena_unit * demos.arena.size, np.linspace(0, 2 * math.pi, 100)
    edge: Any = {
        "disc": (size * np.cos(angle), size * np.sin(angle)),
        "square": size * np.array([[-1, 1, 1, -1, -1], [-1, -1, 1, 1, -1]]),
        "open": ([], []),
    }[demos.arena.shape]
    for axes, index in zip(panels, drawn.tolist(), strict=False):
        one = demos.episode(index)
        positions = unit.per_arena_unit * one.positions
        axes.plot(*edge, color="0.8", lw=0.8)
        if "searcher" in demos.roles:
            axes.plot(0, 0, "*", color=palette.to_hex(palette.PLUME), ms=8)
        for i, colour in enumerate(_colours(demos)):
            x, y = positions[:, i].T
            axes.plot(x, y, color=colour, lw=0.9, label=demos.individuals[i])
            axes.plot(x[0], y[0], "o", color=colour, ms=3)
            axes.plot(x[-1], y[-1], "x", color=colour, ms=5)
            if FILLED in one.signals:
                gap = np.where(one.signals[FILLED][:, i, None], positions[:, i], np.nan)
                axes.plot(*gap.T, ".", color="black", ms=3)
        axes.set_aspect("equal")
        ending = summary.outcome_name(one.outcome, demos)
        axes.set_title(f"episode {index}, {one.duration:.1f} s\n{ending}", fontsize="x-small")
        axes.tick_params(labelsize="x-small")
    for axes in panels[len(drawn) :]:
        axes.set_axis_off()
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=min(len(labels), 6))
    figure.supylabel(unit.name, fontsize="small")


def _draw_distributions(panels: Any, demos: Demonstrations, unit: summary.Unit) -> None:
    durations, lengths, speeds, distances, bars, gaps = panels
    rows, tints = summary.episode_table(demos), _colours(demos)
    _histogram(durations, [[row["duration"] for row in rows]], [GREY])
    durations.set(title="Duration", xlabel="s", ylabel="episodes")
    paths = [
        [unit.per_arena_unit * row[f"path_length_{name}"] for row in rows]
        for name in demos.individuals
    ]
    _histogram(lengths, paths, tints)
    lengths.set(title="Path length", xlabel=unit.name, ylabel="episodes")
    speed = unit.per_arena_unit * np.linalg.norm(demos.velocities(), axis=2)
    bins = np.linspace(0.0, max(float(np.quantile(speed, 0.995)), 1e-9), 50)
    share = np.full(len(speed), 100.0 / len(speed))
    for i, colour in enumerate(tints):
        speeds.hist(speed[:, i], bins, weights=share, histtype="step", color=colour, lw=1.3)
    speeds.set(title="Speed", xlabel=f"{unit.name} / s", ylabel="% of the time")
    _draw_distances(distances, demos, unit)
    names, counts = np.unique([row["outcome"] for row in rows], return_counts=True)
    _bars(bars, dict(zip(names.tolist(), counts.tolist(), strict=True)), "Outcomes", "episodes")
    tracking = summary.tracking_counts(demos)
    _bars(gaps, tracking, "Gaps and flags of the tracks", "frames")
    if not tracking:
        why = "simulated: nothing was tracked" if demos.synthetic else "not recorded in this file"
        gaps.text(0.5, 0.5, why, ha="center", transform=gaps.transAxes)
        gaps.set_axis_off()
    for axes in panels:
        axes.spines[["top", "right"]].set_visible(False)


def _histogram(axes: Any, values: Sequence[Sequence[float]], tints: Sequence[str]) -> None:
    every = np.concatenate(values)
    top = max(float(every.max()), 1e-9)
    bins = np.linspace(0.0, top, min(30, max(8, round(math.sqrt(len(every)) * 1.5))) + 1)
    style: dict[str, Any] = {"histtype": "step", "lw": 1.3} if len(values) > 1 else {}
    for colour, entry in zip(tints, values, strict=True):
        axes.hist(entry, bins, color=colour, **style)
    axes.yaxis.get_major_locator().set_params(integer=True)


def _draw_distances(axes: Any, demos: Demonstrations, unit: summary.Unit) -> None:
    searching = "searcher" in demos.roles
    axes.set(title="Distance to the source" if searching else "Distance of the nearest pursuer")
    distance = distances_to_target(demos.positions, demos.roles).min(axis=1)
    if not np.isfinite(distance).all():
        axes.text(0.5, 0.5, "nobody is the target", ha="center", transform=axes.transAxes)
        return
    longest = int(demos.lengths.max())
    ends = np.full((len(demos), longest), np.nan)
    for row, path in zip(ends, np.split(distance, demos.offsets[1:-1]), strict=True):
        row[longest - len(path) :] = unit.per_arena_unit * path
    time = (np.arange(longest) - longest + 1) * demos.dt
    axes.plot(time, ends.T, color=GREY, lw=0.5, alpha=0.4)
    common = np.isfinite(ends).sum(axis=0) >= LEAST_EPISODES
    if common.any():
        median: Floats = np.nanmedian(ends[:, common], axis=0)
        axes.plot(time[common], median, color="black", lw=2, label="median")
        axes.legend(fontsize="small", frameon=False)
    axes.set(xlabel="s before the end", ylabel=unit.name, ylim=(0, None))


def _bars(axes: Any, counts: Mapping[str, int], title: str, unit: str) -> None:
    axes.set(title=title, xlabel=unit)
    if not counts:
        return
    drawn = axes.barh(list(counts), list(counts.values()), color=GREY, height=0.6)
    axes.bar_label(drawn, padding=3)
    axes.margins(x=0.15, y=0.3 / len(counts))
    axes.set_xlim(left=0, right=max(*counts.values(), 1) * 1.15)
    axes.xaxis.get_major_locator().set_params(integer=True)
