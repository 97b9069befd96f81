"""The figure to check demonstrations by eye: tracks of recordings, and distributions below."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from animarl_envs.array_types import Floats, Ints
from animarl_envs.demos import summary
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.episode import FILLED
from animarl_envs.drawing import palette
from animarl_envs.errors import require_extra
from animarl_envs.files import write_then_rename
from animarl_envs.focus import distances_to_target, nearest_other

COLUMNS = 6  # recordings beside one another
MOST_RECORDINGS = 12  # drawn of each condition
PANEL = 2.1  # of a recording [inch]
GREY = "0.45"
LEAST_EPISODES = 3  # a median over fewer is not drawn
MOST_POINTS = 2000  # drawn of a track
LONGEST_TITLE = 26  # characters


def plot_summary(demos: Demonstrations, path: str | Path) -> Path:
    """Draw the summary of ``demos`` into a file (``.png``, ``.svg``, ``.pdf``).

    Above: the tracks of each recording, conditions apart, with start (dot), end (cross) and filled
    gaps (black); of many recordings, some that are spread evenly. Below: durations, path lengths,
    speeds, distances, outcomes and what the cleaning found, as far as there is something to see.
    """
    with require_extra("the summary figure", "algos"):
        from matplotlib import rc_context
        from matplotlib.figure import Figure
    path, unit, tables = Path(path), summary.unit_of(demos), _tables(demos)
    conditions = np.unique(demos.condition).tolist()
    chosen = [_spread_evenly(demos, condition) for condition in conditions]
    rows = [math.ceil(len(names) / COLUMNS) for _, names in chosen]
    below = math.ceil(len(tables) / 3)
    heights = [0.35 + (PANEL + 0.35) * count for count in rows] + [2.6 * below]
    with rc_context({"text.parse_math": False}):  # a name with dollar signs is a name
        figure = Figure(figsize=(13, sum(heights) + 0.8), layout="constrained")
        parts: Any = figure.subfigures(len(heights), 1, height_ratios=heights, squeeze=False)[:, 0]
        kind = "SYNTHETIC episodes" if demos.synthetic else "recorded episodes"
        title = ", ".join(demos.kinds) if demos.species == "custom" else demos.species
        figure.suptitle(
            f"{title}: {demos.num_episodes} {kind}, "
            f"{(demos.lengths - 1).sum() * demos.dt:.0f} s in total",
            fontsize="x-large",
            color="#B00020" if demos.synthetic else "black",
        )
        for part, condition, (count, names), num in zip(parts, conditions, chosen, rows):
            if len(conditions) > 1 or len(names) < count:
                part_of = f", {len(names)} of them drawn" if len(names) < count else ""
                noun = "recording" if count == 1 else "recordings"
                named = (
                    summary.condition_name(condition, demos) + ": " if len(conditions) > 1 else ""
                )
                part.suptitle(
                    f"{named}{count} {noun}{part_of}", fontsize="medium", ha="left", x=0.01
                )
            _draw_recordings(part, demos, unit, condition, names, num)
        panels = parts[-1].subplots(below, 3, squeeze=False).ravel()
        for axes, draw in zip(panels, tables):
            draw(axes, demos, unit)
            axes.spines[["top", "right"]].set_visible(False)
        for axes in panels[len(tables) :]:
            axes.set_axis_off()
        with write_then_rename(path) as part:
            figure.savefig(part, dpi=110)
    return path


def _colours(demos: Demonstrations) -> list[str]:
    """Return the colour of each individual."""
    return [palette.to_hex(palette.colour_of(role, i)) for i, role in enumerate(demos.roles)]


def _spread_evenly(demos: Demonstrations, condition: int) -> tuple[int, list[str]]:
    """Return how many recordings a condition has, and the names of those to draw."""
    names = np.unique(demos.recording[demos.condition == condition])
    drawn = np.linspace(0, len(names) - 1, min(len(names), MOST_RECORDINGS)).round().astype(int)
    return len(names), names[drawn].tolist()


def _draw_recordings(
    figure: Any, demos: Demonstrations, unit: summary.Unit, condition: int, names: Any, rows: int
) -> None:
    panels = figure.subplots(rows, COLUMNS, sharex=True, sharey=True, squeeze=False).ravel()
    size, angle = unit.per_arena_unit * demos.arena.size, np.linspace(0, 2 * math.pi, 100)
    edge: Any = {
        "disc": (size * np.cos(angle), size * np.sin(angle)),
        "square": unit.per_arena_unit
        * demos.arena.corners[[*range(-1, len(demos.arena.corners))]].T,
        "open": ([], []),
    }[demos.arena.shape]
    for axes, name in zip(panels, names, strict=False):
        own = np.flatnonzero((demos.recording == name) & (demos.condition == condition))
        axes.plot(*edge, color="0.8", lw=0.8)
        for _, *place in demos.arena.landmarks:
            axes.plot(*(unit.per_arena_unit * np.array(place)), "^", color="0.5", ms=6)
        for x, y, radius in unit.per_arena_unit * np.array(demos.arena.pillars).reshape(-1, 3):
            axes.plot(x + radius * np.cos(angle), y + radius * np.sin(angle), color="0.8", lw=0.8)
        if "searcher" in demos.roles:
            axes.plot(0, 0, "*", color=palette.to_hex(palette.PLUME), ms=8)
        _draw_tracks(axes, demos, unit, own)
        axes.set_aspect("equal")
        seconds = (demos.lengths[own] - 1).sum() * demos.dt
        short = name if len(name) <= LONGEST_TITLE else f"...{name[3 - LONGEST_TITLE :]}"
        splits = ", ".join(dict.fromkeys(demos.split[own].tolist()))
        digits = max(0, 2 - math.floor(math.log10(seconds)))
        axes.set_title(f"{short}\n{seconds:.{digits}f} s, {splits}", fontsize="x-small")
        axes.tick_params(labelsize="x-small")
    for axes in panels[len(names) :]:
        axes.set_axis_off()
    handles, labels = panels[0].get_legend_handles_labels()
    if len(labels) <= COLUMNS:
        figure.legend(handles, labels, loc="outside lower center", ncols=len(labels))
    figure.supylabel(unit.name, fontsize="small")


def _draw_tracks(axes: Any, demos: Demonstrations, unit: summary.Unit, episodes: Ints) -> None:
    """Draw all episodes of a recording; names of the individuals go with the first."""
    for place, index in enumerate(episodes.tolist()):
        one = demos.episode(index)
        positions = unit.per_arena_unit * one.positions
        every = len(positions) // MOST_POINTS + 1
        for i, colour in enumerate(_colours(demos)):
            x, y = positions[:, i].T
            label = demos.individuals[i] if place == 0 else None
            axes.plot(x[::every], y[::every], color=colour, lw=0.7, label=label)
            axes.plot(x[0], y[0], "o", color=colour, ms=3)
            axes.plot(x[-1], y[-1], "x", color=colour, ms=4)
            if FILLED in one.signals:
                gap = np.where(one.signals[FILLED][:, i, None], positions[:, i], np.nan)
                axes.plot(*gap.T, ".", color="black", ms=2)


def _tables(demos: Demonstrations) -> list[Any]:
    """Return what to draw below: only that of which there is something to see."""
    drawn: list[Any] = [_draw_durations, _draw_path_lengths, _draw_speeds]
    if demos.has_goal or demos.num_individuals > 1:
        drawn.append(_draw_distances)
    if len(np.unique(demos.outcome)) > 1:
        drawn.append(_draw_outcomes)
    if _flagged(demos):
        drawn.append(_draw_tracking)
    return drawn


def _draw_durations(axes: Any, demos: Demonstrations, unit: summary.Unit) -> None:
    _histogram(axes, [((demos.lengths - 1) * demos.dt).tolist()], [GREY])
    axes.set(title="Duration", xlabel="s", ylabel="episodes")


def _draw_path_lengths(axes: Any, demos: Demonstrations, unit: summary.Unit) -> None:
    rows = summary.episode_table(demos)
    lengths = [
        [unit.per_arena_unit * row[f"path_length_{name}"] for row in rows]
        for name in demos.individuals
    ]
    _histogram(axes, lengths, _colours(demos))
    axes.set(title="Path length", xlabel=unit.name, ylabel="episodes")


def _draw_speeds(axes: Any, demos: Demonstrations, unit: summary.Unit) -> None:
    speed = unit.per_arena_unit * np.linalg.norm(demos.velocities(), axis=2)
    bins = np.linspace(0.0, max(float(np.quantile(speed, 0.995)), 1e-9), 50)
    share = np.full(len(speed), 100.0 / len(speed))
    for i, colour in enumerate(_colours(demos)):
        axes.hist(speed[:, i], bins, weights=share, histtype="step", color=colour, lw=1.3)
    axes.set(title="Speed", xlabel=f"{unit.name} / s", ylabel="% of the time")


def _histogram(axes: Any, values: Sequence[Sequence[float]], tints: Sequence[str]) -> None:
    every = np.concatenate(values)
    top = max(float(every.max()), 1e-9)
    bins = np.linspace(0.0, top, min(30, max(8, round(math.sqrt(len(every)) * 1.5))) + 1)
    style: dict[str, Any] = {"histtype": "step", "lw": 1.3} if len(values) > 1 else {}
    for colour, entry in zip(tints, values, strict=True):
        axes.hist(entry, bins, color=colour, **style)
    axes.yaxis.get_major_locator().set_params(integer=True)


def _draw_distances(axes: Any, demos: Demonstrations, unit: summary.Unit) -> None:
    """Draw the distance to the target or source before the end, or to the nearest other."""
    if not demos.has_goal:
        near = unit.per_arena_unit * np.concatenate(
            [np.linalg.norm(nearest_other(one.positions), axis=2).ravel() for one in demos]
        )
        axes.hist(
            near,
            np.linspace(0.0, max(float(near.max()), 1e-9), 41),
            weights=np.full(len(near), 100.0 / len(near)),
            color=GREY,
        )
        axes.set(title="Distance to the nearest other", xlabel=unit.name, ylabel="% of the time")
        return
    searching = "searcher" in demos.roles
    axes.set(title="Distance to the source" if searching else "Distance of the nearest pursuer")
    distance = distances_to_target(demos.positions, demos.roles).min(axis=1)
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


def _draw_outcomes(axes: Any, demos: Demonstrations, unit: summary.Unit) -> None:
    outcomes = [summary.outcome_name(one, demos) for one in demos.outcome.tolist()]
    names, counts = np.unique(outcomes, return_counts=True)
    _bars(axes, dict(zip(names.tolist(), counts.tolist(), strict=True)), "Outcomes", "episodes")


def _draw_tracking(axes: Any, demos: Demonstrations, unit: summary.Unit) -> None:
    _bars(axes, _flagged(demos), "Gaps and flags of the tracks", "frames")


def _flagged(demos: Demonstrations) -> dict[str, int]:
    return {name: count for name, count in summary.tracking_counts(demos).items() if count}


def _bars(axes: Any, counts: Mapping[str, int], title: str, unit: str) -> None:
    axes.set(title=title, xlabel=unit)
    drawn = axes.barh(list(counts), list(counts.values()), color=GREY, height=0.6)
    axes.bar_label(drawn, padding=3)
    axes.margins(x=0.15, y=0.3 / len(counts))
    axes.set_xlim(left=0, right=max(*counts.values(), 1) * 1.15)
    axes.xaxis.get_major_locator().set_params(integer=True)
