"""The figure to check demonstrations by eye: tracks, speeds, distances, outcomes, gaps."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.episode import FILLED, Episode
from animarl_envs.demos.summary import TRACKING, episode_table, outcome_name, summarise
from animarl_envs.demos.units import Unit, unit_of
from animarl_envs.errors import MissingExtraError
from animarl_envs.files import write_then_rename
from animarl_envs.focus import distances_to_target

ROWS, COLUMNS = 2, 6  # of the episodes drawn
COLOURS = ("#0072B2", "#009E73", "#56B4E9", "#CC79A7", "#E69F00", "#999999")  # of pursuers
TARGET_COLOUR = "#D55E00"  # told apart by colour-blind readers as well
GREY = "0.45"
LEAST_EPISODES = 3  # a median over fewer is not drawn


def plot_summary(demos: Demonstrations, path: str | Path) -> Path:
    """Draw the summary of ``demos`` into a file (``.png``, ``.svg``, ``.pdf``).

    Above: single episodes, spread evenly over the set, with start (dot), end (cross) and filled
    gaps (black). Below: durations, path lengths, speeds, distances to the target, outcomes, and
    what the cleaning found.
    """
    try:
        from matplotlib import rc_context
    except ImportError as error:
        raise MissingExtraError("the summary figure", "algos") from error
    with rc_context({"text.parse_math": False}):  # a name with dollar signs is a name
        return _plot(demos, Path(path))


def _plot(demos: Demonstrations, path: Path) -> Path:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(13, 9.5), layout="constrained")
    parts: Any = figure.subfigures(2, 1, height_ratios=(1.0, 1.25))
    above, below = parts
    kind = "SYNTHETIC episodes" if demos.synthetic else "recorded episodes"
    title = ", ".join(demos.individuals) if demos.species == "custom" else demos.species
    figure.suptitle(
        f"{title}: {demos.num_episodes} {kind}, "
        f"{(demos.lengths - 1).sum() * demos.dt:.0f} s in total",
        fontsize="x-large",
        color="#B00020" if demos.synthetic else "black",
    )
    unit = unit_of(demos)
    _draw_episodes(above, demos, unit)
    durations, lengths, speeds, distances, bars, gaps = below.subplots(2, 3).ravel()
    rows = episode_table(demos)
    _histogram(durations, {"episodes": [row["duration"] for row in rows]}, (GREY,))
    durations.set(title="Duration", xlabel="s", ylabel="episodes")
    paths = {
        name: [unit.per_arena_unit * row[f"path_length_{name}"] for row in rows]
        for name in demos.individuals
    }
    _histogram(lengths, paths, colours(demos))
    lengths.set(title="Path length", xlabel=unit.name, ylabel="episodes")
    _draw_speeds(speeds, demos, unit)
    _draw_distances(distances, demos, unit)
    names, counts = np.unique([row["outcome"] for row in rows], return_counts=True)
    _bars(bars, names.tolist(), counts.tolist(), "Outcomes", "episodes")
    found = summarise(demos)
    tracking = {key: found[f"frames: {key}"] for key in TRACKING if f"frames: {key}" in found}
    _bars(gaps, list(tracking), list(tracking.values()), "Gaps and flags of the tracks", "frames")
    if not tracking:
        why = "simulated: nothing was tracked" if demos.synthetic else "not recorded in this file"
        gaps.text(0.5, 0.5, why, ha="center", transform=gaps.transAxes)
        gaps.set_axis_off()
    for axes in (durations, lengths, speeds, distances, bars, gaps):
        axes.spines[["top", "right"]].set_visible(False)
    path = Path(path)
    with write_then_rename(path) as part:
        figure.savefig(part, dpi=120)
    return path


def colours(demos: Demonstrations) -> tuple[str, ...]:
    """One per individual; the target's is its own."""
    return tuple(
        TARGET_COLOUR if role == "target" else COLOURS[i % len(COLOURS)]
        for i, role in enumerate(demos.roles)
    )


def _draw_episodes(figure: Any, demos: Demonstrations, unit: Unit) -> None:
    shown = np.unique(np.linspace(0, demos.num_episodes - 1, ROWS * COLUMNS).round().astype(int))
    panels = figure.subplots(ROWS, COLUMNS, sharex=True, sharey=True).ravel()
    for axes, index in zip(panels, shown.tolist(), strict=False):
        one = demos.episode(index)
        positions = unit.per_arena_unit * one.positions
        _outline(axes, demos, unit)
        for i, colour in enumerate(colours(demos)):
            x, y = positions[:, i].T
            axes.plot(x, y, color=colour, lw=0.9, label=demos.individuals[i])
            axes.plot(x[0], y[0], "o", color=colour, ms=3)
            axes.plot(x[-1], y[-1], "x", color=colour, ms=5)
            if FILLED in one.signals:
                gap = np.where(one.signals[FILLED][:, i, None], positions[:, i], np.nan)
                axes.plot(*gap.T, ".", color="black", ms=3)
        axes.set_aspect("equal")
        axes.set_title(_caption(one, demos), fontsize="x-small")
        axes.tick_params(labelsize="x-small")
    for axes in panels[len(shown) :]:
        axes.set_axis_off()
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=min(len(labels), 6))
    figure.supylabel(unit.name, fontsize="small")


def _caption(one: Episode, demos: Demonstrations) -> str:
    return f"episode {one.index}, {one.duration:.1f} s\n{outcome_name(one.outcome, demos)}"


def _outline(axes: Any, demos: Demonstrations, unit: Unit) -> None:
    size = unit.per_arena_unit * demos.arena.size
    if demos.arena.shape == "disc":
        angle = np.linspace(0, 2 * math.pi, 100)
        axes.plot(size * np.cos(angle), size * np.sin(angle), color="0.8", lw=0.8)
    elif demos.arena.shape == "square":
        axes.plot(
            size * np.array([-1, 1, 1, -1, -1]), size * np.array([-1, -1, 1, 1, -1]),
            color="0.8", lw=0.8,
        )  # fmt: skip
    if "searcher" in demos.roles:
        axes.plot(0, 0, "*", color=TARGET_COLOUR, ms=8)


def _histogram(axes: Any, values: dict[str, list[float]], tints: tuple[str, ...]) -> None:
    every = np.concatenate([np.asarray(entry) for entry in values.values()])
    top = max(float(every.max()), 1e-9)
    bins = np.linspace(0.0, top, min(30, max(8, round(math.sqrt(len(every)) * 1.5))) + 1)
    for colour, entry in zip(tints, values.values(), strict=True):
        if len(values) == 1:
            axes.hist(entry, bins, color=colour)
        else:
            axes.hist(entry, bins, histtype="step", color=colour, lw=1.3)
    axes.yaxis.get_major_locator().set_params(integer=True)


def _draw_speeds(axes: Any, demos: Demonstrations, unit: Unit) -> None:
    speed = unit.per_arena_unit * np.linalg.norm(demos.velocities(), axis=2)
    bins = np.linspace(0.0, max(float(np.quantile(speed, 0.995)), 1e-9), 50)
    for i, colour in enumerate(colours(demos)):
        share = np.full(len(speed), 100.0 / len(speed))
        axes.hist(speed[:, i], bins, weights=share, histtype="step", color=colour, lw=1.3)
    axes.set(title="Speed", xlabel=f"{unit.name} / s", ylabel="% of the time")


def _draw_distances(axes: Any, demos: Demonstrations, unit: Unit) -> None:
    searching = "searcher" in demos.roles
    paths = [
        unit.per_arena_unit * distances_to_target(one.positions, demos.roles).min(axis=1)
        for one in demos
    ]
    title = "Distance to the source" if searching else "Distance of the nearest pursuer"
    if not all(np.isfinite(path).all() for path in paths):
        axes.text(0.5, 0.5, "nobody is the target", ha="center", transform=axes.transAxes)
        axes.set(title=title)
        return
    longest = max(map(len, paths))
    ends = np.full((len(paths), longest), np.nan)
    for row, path in zip(ends, paths, strict=True):
        row[longest - len(path) :] = path
    time = (np.arange(longest) - longest + 1) * demos.dt
    axes.plot(time, ends.T, color=GREY, lw=0.5, alpha=0.4)
    common = np.isfinite(ends).sum(axis=0) >= LEAST_EPISODES
    if common.any():
        median: NDArray[np.float64] = np.nanmedian(ends[:, common], axis=0)
        axes.plot(time[common], median, color="black", lw=2, label="median")
        axes.legend(fontsize="small", frameon=False)
    axes.set(title=title, xlabel="s before the end", ylabel=unit.name, ylim=(0, None))


def _bars(axes: Any, names: list[str], counts: list[int], title: str, unit: str) -> None:
    axes.set(title=title, xlabel=unit)
    if not names:
        return
    drawn = axes.barh(names, counts, color=GREY, height=0.6)
    axes.bar_label(drawn, padding=3)
    axes.margins(x=0.15, y=0.3 / len(names))
    axes.set_xlim(left=0, right=max(*counts, 1) * 1.15)
    axes.xaxis.get_major_locator().set_params(integer=True)
