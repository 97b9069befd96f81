"""Pictures of the pages that no command of the package draws: ``python docs/make_pictures.py``.

One argument chooses, others say where the recordings are:

    agent                            data/packaged_agent.md
    moth DATA_DIR                    data/packaged_silkmoth.md, beside the recorded moths
    courtship DATA                   data/packaged_courtship.md, beside fly groups and termite pairs
    plume DATA_DIR                   plume.md, beside plume_probe_kpb400.npz and hit_counts_5mm.npz
    free RUN_OF_LARVAE RUN_OF_FISH   one_animal.md and shoal.md, of runs on recordings
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Rectangle
from numpy.typing import NDArray

from animarl_algos import load_run
from animarl_algos.report import style
from animarl_algos.report.figures import Stage, draw_paths, path_panels
from animarl_algos.report.words import Words
from animarl_envs.arena import Arena
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.packaged import load_packaged
from animarl_envs.drawing.palette import PURSUERS, RECORDED, SIMULATED, TARGET, TOUCH, to_hex
from animarl_envs.files import write_then_rename
from animarl_envs.importing.cleaning import runs
from animarl_envs.species import AGENT, SILKMOTH
from animarl_envs.worlds.plume.filaments import FilamentModel
from animarl_envs.worlds.plume.plume import ModelPlume
from tools.packaged_data.courtship_published import BEHAVIOURS
from tools.packaged_data.courtship_shapes import MOVING_SHARE, is_moving, recorded_tracks
from tools.packaged_data.moth_statistics import of_demonstrations, recorded_statistics
from tools.packaged_data.plume_fit import compare, expected_map
from tools.packaged_data.plume_probe import ENOUGH, CellMap, Probe

GREY, BLUE = to_hex(RECORDED), to_hex(SIMULATED)  # recorded and simulated


def two_rows(height: float, upper: float, lower: float, width: float = 11.0) -> tuple[Any, ...]:
    """A figure and its two rows of panels, with the ratios of their heights."""
    figure = plt.figure(figsize=(width, height), layout="constrained")
    rows: Any = figure.subfigures(2, 1, height_ratios=(upper, lower))
    return figure, rows[0], rows[1]


def save(figure: Figure, name: str, dpi: int = 90) -> None:
    with write_then_rename(Path(__file__).parent / "images" / f"{name}.png") as part:
        figure.savefig(part, dpi=dpi)
    print(f"wrote docs/images/{name}.png")


# -- the packaged chases ---------------------------------------------------------------------------

PERCENTILES = (10, 30, 50, 70, 90)  # of the duration: chosen by rank, not by eye
CONDITIONS = (to_hex(PURSUERS[2]), to_hex(PURSUERS[3]))  # individual, shared


def agent() -> None:
    """Chases of both conditions; when the prey is caught, how far the predators are apart."""
    demos = load_packaged("agent")
    with style.figure_style():
        figure, top, bottom = two_rows(6.6, 1.75, 1.0)
        samples = top.subplots(2, len(PERCENTILES))
        panels = bottom.subplots(1, 3)
        for condition, name in enumerate(AGENT.conditions):
            part = demos.select(condition=condition)
            order = np.argsort(part.lengths, kind="stable")
            for panel, percentile in zip(samples[condition], PERCENTILES):
                episode = part.episode(int(order[round(percentile / 100 * (len(order) - 1))]))
                draw_paths(panel, episode.positions, demos.arena, demos.roles, demos.individuals)
                panel.set(xlim=(-1.15, 1.15), ylim=(-1.15, 1.15))
                ends = "captured" if episode.outcome > 0 else "time-out"
                ends = "left the arena" if episode.outcome < 0 else ends
                panel.set_title(f"{name}: {ends}, {episode.duration:.1f} s", fontweight="normal")
            duration = (part.lengths - 1) * part.dt
            times = np.sort(duration[part.outcome > 0])
            share = np.arange(1, len(times) + 1) / len(duration)
            limit = AGENT.dt * AGENT.time_limit
            panels[0].step(
                [0, *times, limit], [0, *share, share[-1]], where="post",
                color=CONDITIONS[condition], label=f"{name}, in the end {share[-1]:.3f}",
            )  # fmt: skip
            edges = np.linspace(0, limit, 23)
            panels[1].hist(
                times, edges, weights=np.full(len(times), 1 / len(duration)), histtype="step",
                color=CONDITIONS[condition], label=name,
            )  # fmt: skip
            apart = np.linalg.norm(part.positions[:, 0] - part.positions[:, 1], axis=-1)
            panels[2].hist(
                apart, np.linspace(0, 2.4, 41), density=True, histtype="step",
                color=CONDITIONS[condition], label=name,
            )  # fmt: skip
        panels[0].set(xlabel="time (s)", ylabel="share captured so far", xlim=(0, 15), ylim=(0, 1))
        panels[1].set(xlabel="capture time (s)", ylabel="share of episodes")
        panels[2].set(xlabel="distance between the predators (arena units)", ylabel="density")
        for panel in panels:
            panel.legend(loc="lower right" if panel is panels[0] else "upper right")
        save(figure, "packaged_agent", 100)


# -- the packaged moths ----------------------------------------------------------------------------

PATTERN = 0  # whose searches are drawn
SENSES = {"recorded": GREY, "full": BLUE, "reduced": to_hex(PURSUERS[1])}


def searches(axis: Any, demos: Demonstrations, condition: int, colour: str) -> None:
    """All searches of one plume pattern over a moment of that plume."""
    values, (left, right, low, high) = ModelPlume.fitted().field(PATTERN, 30.3)
    extent = (left, right, low, high)
    axis.imshow(values, origin="lower", extent=extent, vmin=0, vmax=1.6, cmap="Greys", zorder=0)
    for episode in demos.select(condition=condition):
        if episode.signals["plume"][0] != PATTERN:
            continue
        x, y = episode.positions[:, 0].T
        reached = episode.outcome == 1
        axis.plot(x, y, color=colour, lw=0.7, alpha=0.9 if reached else 0.45)
        axis.plot(x[-1], y[-1], "o" if reached else "x", color=colour, ms=4)
    axis.add_patch(Circle((0, 0), SILKMOTH.contact_radius, fill=False, ls="--", color="0.3"))
    axis.plot(0.3, 0, "k>", ms=5)
    axis.set(title=f"synthetic, {SILKMOTH.conditions[condition]} (plume {PATTERN})",
             xlabel="x [m]", ylabel="y [m]", xlim=(-0.1, 0.45), ylim=(-0.2, 0.2))  # fmt: skip


def moth(folder: str) -> None:
    """Searches of one plume; speeds, turning and times of success beside the recorded ones."""
    demos = load_packaged("silkmoth")
    found = {
        "recorded": recorded_statistics(Path(folder)),
        "full": of_demonstrations(demos.select(condition=0)),
        "reduced": of_demonstrations(demos.select(condition=1)),
    }
    names = {
        "recorded": "recorded (24), full senses",
        "full": "synthetic (30), full senses",
        "reduced": "synthetic (30), wind and vision blocked",
    }
    figure, top, bottom = two_rows(6.4, 1.15, 1.0)
    for axis, condition in zip(top.subplots(1, 2, sharey=True), (0, 1)):
        searches(axis, demos, condition, SENSES["reduced" if condition else "full"])
    speed, turning, duration = bottom.subplots(1, 3)
    for who, one in found.items():
        line: dict[str, Any] = {
            "histtype": "step",
            "density": True,
            "color": SENSES[who],
            "lw": 1.5,
        }
        if who != "reduced":  # compared like with like
            speed.hist(1000 * one.speed, np.arange(0, 41, 2), **line)
            turning.hist(one.turning, np.linspace(0, 2 * np.pi, 26), **line)
        when = np.sort(one.duration[one.reached])
        share = np.arange(1, len(when) + 1) / len(one.duration)
        ends = SILKMOTH.time_limit * SILKMOTH.dt
        duration.step(
            [0, *when, ends], [0, *share, one.rate], where="post", color=SENSES[who],
            label=names[who],
        )  # fmt: skip
    speed.set(xlabel="speed at 2 Hz [mm/s]", ylabel="density")
    turning.set(xlabel="turning rate of the direction of travel [rad/s]", ylabel="density")
    duration.set(xlabel="time [s]", ylabel="share that has reached the source", ylim=(0, 1.02))
    duration.set_xlim(0, SILKMOTH.time_limit * SILKMOTH.dt)
    handles, labels = duration.get_legend_handles_labels()
    bottom.legend(handles, labels, frameon=False, ncols=3, loc="outside lower center")
    save(figure, "packaged_silkmoth")


# -- packaged courtship ----------------------------------------------------------------------------

RECORDED_ANIMALS = {"fly": "groups of flies, recorded", "newt": "termite pairs, recorded"}
SHOWN = 6  # tracks of episodes, evenly by duration
SPEED_BINS = np.linspace(0.0, 1.3, 41)


def courtship(folder: str) -> None:
    for name in BEHAVIOURS:
        couple(name, Path(folder))


def couple(name: str, folder: Path) -> None:
    """Sample tracks above; speeds, pauses and moves below."""
    demos = load_packaged(name)
    drawn, above, below = two_rows(5.4, 1.0, 1.1)
    order = np.argsort(demos.lengths, kind="stable")
    chosen = order[(np.linspace(0.15, 0.97, SHOWN) * len(order)).astype(int)]
    panels = above.subplots(1, SHOWN)
    for axis, index in zip(panels, chosen, strict=True):
        tracks(axis, demos, int(index))
    handles, names = panels[0].get_legend_handles_labels()
    above.legend(handles, names, loc="lower center", ncols=len(names), frameon=False, fontsize=8)
    distributions(below.subplots(1, 3), demos, recorded_tracks(name, folder))
    drawn.suptitle(f"Packaged {name}: synthetic courtship, not recorded from animals", fontsize=11)
    save(drawn, f"packaged_{name}")


def tracks(axis: Any, demos: Demonstrations, index: int) -> None:
    """One episode; starts are rings, contact is a star."""
    one, arena = demos.episode(index), demos.arena
    colours = [to_hex(c) for c in (*PURSUERS[: demos.num_individuals - 1], TARGET)]
    for i, (name, colour) in enumerate(zip(demos.individuals, colours, strict=True)):
        x, y = one.positions[:, i].T
        axis.plot(x, y, color=colour, lw=1.2, label=name)
        axis.plot(x[0], y[0], "o", ms=5, mfc="white", color=colour)
    if one.outcome > 0:
        axis.plot(*one.positions[-1, -1], "*", ms=9, color=to_hex(TOUCH))
    edge: dict[str, Any] = {"fill": False, "ec": GREY, "lw": 0.8}
    size = arena.size
    axis.add_patch(
        Circle((0, 0), size, **edge)
        if arena.shape == "disc"
        else Rectangle((-size, -size), 2 * size, 2 * size, **edge)
    )
    ended = f"contact by {demos.individuals[one.outcome - 1]}" if one.outcome > 0 else "time-out"
    axis.set(xlim=(-1.08, 1.08), ylim=(-1.08, 1.08), aspect="equal", xticks=[], yticks=[])
    axis.set_title(f"episode {index}: {one.duration:.1f} s\n{ended}", fontsize=8)
    axis.spines[:].set_visible(False)


def distributions(axes: Any, demos: Demonstrations, recorded: list[NDArray[np.float64]]) -> None:
    """Speeds as shares of the 99th percentile; how many pauses and moves last longer than t."""
    sets = {"recorded": recorded, "synthetic": [one.positions for one in demos]}
    labels = {"recorded": RECORDED_ANIMALS[demos.species], "synthetic": "packaged, synthetic"}
    for (who, paths), colour in zip(sets.items(), (GREY, BLUE)):
        speeds, pauses, moves = stop_and_go(paths, demos.dt)
        line: dict[str, Any] = {"color": colour, "label": labels[who]}
        axes[0].hist(np.minimum(speeds, 1.3), SPEED_BINS, density=True, histtype="step", **line)
        lasting(axes[1], pauses, **line)
        lasting(axes[2], moves, **line)
    axes[0].set(xlabel="speed / 99th percentile", ylabel="density", title="Speed")
    axes[1].set(xlabel="s", ylabel="share that lasts longer", title="Pauses", xscale="log")
    axes[2].set(xlabel="s", title="Moves", xscale="log")
    for axis in axes:
        axis.legend(frameon=False, fontsize=8)
        axis.spines[["top", "right"]].set_visible(False)


def stop_and_go(
    paths: list[NDArray[np.float64]], dt: float
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Relative speeds, and durations of complete pauses and moves [s]."""
    speeds = [np.linalg.norm(np.diff(path, axis=0), axis=2) / dt for path in paths]
    everything = np.concatenate([speed.ravel() for speed in speeds])
    top = np.quantile(everything, 0.99)
    found: dict[bool, list[float]] = {True: [], False: []}
    for speed in speeds:
        for own in speed.T:
            moving = is_moving(own, MOVING_SHARE * top, dt)
            for state in (True, False):
                inner = [b - a for a, b in runs(moving == state) if a > 0 and b < len(moving)]
                found[state] += [dt * n for n in inner]
    return everything / top, np.array(found[False]), np.array(found[True])


def lasting(axis: Any, values: NDArray[np.float64], **style: Any) -> None:
    """Share of durations longer than t."""
    axis.plot(np.sort(values), 1.0 - np.arange(len(values)) / len(values), **style)


# -- the plume -------------------------------------------------------------------------------------

PLUMES = {"recorded": GREY, "model": BLUE}


def plume(data: str) -> None:
    """Hit rate per cell, recorded and modelled; rate over distance; whiffs and blanks."""
    patterns()
    folder = Path(data)
    probe, recorded = Probe.load(folder), CellMap.recorded(folder)
    model = expected_map(probe, recorded, FilamentModel.fitted(), draws=10, seed=0)
    seen = compare(folder)
    figure, top, bottom = two_rows(6.2, 1.0, 0.9, width=10)
    axes = top.subplots(1, 3, width_ratios=(1, 1, 0.85))
    extent = (*recorded.x_edges[[0, -1]], *recorded.y_edges[[0, -1]])
    for axis, cells, title in zip(axes, (recorded, model), ("recorded", "model")):
        shown = axis.imshow(
            100 * cells.rate.T, origin="lower", extent=extent, vmin=0, vmax=15, cmap="viridis"
        )
        axis.set(title=f"hit rate per 5 mm cell, {title}", xlabel="x [m]", ylabel="y [m]")
    top.colorbar(shown, ax=list(axes[:2]), label="samples with a hit [%]", shrink=0.8)
    correlation, count = seen["correlation over cells"]
    dots = {"ms": 2, "color": PLUMES["recorded"]}
    axes[2].plot(100 * model.rate.ravel(), 100 * recorded.rate.ravel(), ".", **dots)
    axes[2].axline((0, 0), slope=1, color=PLUMES["model"], lw=1)
    axes[2].set(
        title=f"r = {correlation:.2f} over {count} cells\nwith {ENOUGH} samples or more",
        xlabel="model [%]", ylabel="recorded [%]", xlim=(0, 25), ylim=(0, 40),
    )  # fmt: skip

    axes = bottom.subplots(1, 3)
    start, *rates = np.array(seen["by distance"]).T
    for rate, (who, colour) in zip(rates, PLUMES.items()):
        axes[0].plot(start + 0.0125, 100 * rate, "o-", ms=4, color=colour, label=who)
    axes[0].set(xlabel="distance from the source [m]", ylabel="samples with a hit [%]", ylim=0)
    axes[0].legend(frameon=False)
    for axis, name, edges in (
        (axes[1], "whiff", np.arange(0.5, 15.5) / 30),
        (axes[2], "blank", np.geomspace(0.9 / 30, 30, 60)),
    ):
        for who, colour in PLUMES.items():
            lengths = seen[f"{name} lengths"][who] / 30
            weights = np.full(len(lengths), 100 / len(lengths))
            axis.hist(lengths, edges, weights=weights, histtype="step", lw=1.5, color=colour)
        axis.set(xlabel=f"length of {name}s [s]", ylabel="share [%]")
    axes[2].set_xscale("log")
    save(figure, "plume_calibration")


def patterns() -> None:
    """One moment of each of the five patterns, and where they hit on average."""
    model = ModelPlume.fitted()
    figure, axes = plt.subplots(1, 6, figsize=(10, 2.2), layout="constrained", sharey=True)
    for pattern, axis in enumerate(axes[:5]):
        values, extent = model.field(pattern, 30.3)
        axis.imshow(values, origin="lower", extent=extent, vmin=0, vmax=1, cmap="Greys")
        axis.set(title=f"pattern {pattern}", xlabel="x [m]")
    tables = [model.pattern_table(pattern, 0.5, 0.0025) for pattern in range(5)]
    share = np.mean([[t.unpack(0, s) for s in range(0, 520, 3)] for t in tables], axis=(0, 1))
    axes[5].imshow(share, origin="lower", extent=tables[0].extent, cmap="viridis")
    axes[5].set(title="hits per step", xlabel="x [m]")
    axes[0].set_ylabel("y [m]")
    save(figure, "plume_patterns", 80)


# -- animals without a target ----------------------------------------------------------------------

LARVAE, STEPS = 12, 250  # tracks of single animals, and for how many steps, 20 s


def free(run_of_larvae: str, run_of_fish: str) -> None:
    larvae(run_of_larvae)
    fish(run_of_fish)


def larvae(run_folder: str) -> None:
    """Tracks from a common start: recorded, and simulated from the same starts."""
    run = load_run(run_folder)
    demos, simulated = run.demos.select(split="test"), run.simulate(repetitions=1)
    enough = np.flatnonzero(demos.lengths > STEPS)[:LARVAE]
    first = [int(np.flatnonzero(simulated.demo == i)[0]) for i in enough]
    sides = {
        "recorded": _from_the_origin([demos.path(int(i)) for i in enough]),
        "simulated": _from_the_origin([simulated.path(i) for i in first]),
    }
    names = tuple(str(i) for i in enough)
    reach = max(float(np.abs(side).max()) for side in sides.values())
    stage = Stage(Arena("open", reach), ("pursuer",) * len(enough), names, Words.of(demos))
    save(path_panels([*sides.items()], sides["recorded"], stage), "one_animal", 150)


def fish(run_folder: str) -> None:
    """A shoal: recorded, simulated from the same start, and put together of strangers."""
    run = load_run(run_folder)
    demos, simulated = run.demos.select(split="test"), run.simulate(repetitions=1)
    longest = int(np.argmax(demos.lengths))
    frames = int(demos.lengths[longest])
    every = run.demos
    others = np.flatnonzero(every.lengths >= frames).tolist()
    paths = [every.path(others[k % len(others)])[:frames, k] for k in range(every.num_individuals)]
    strangers = np.stack(paths, axis=1)
    same = simulated.path(int(np.flatnonzero(simulated.demo == longest)[0]))[:frames]
    sides = {"recorded": demos.path(longest), "simulated": same, "strangers": strangers}
    stage = Stage(demos.arena, demos.roles, demos.individuals, Words.of(demos))
    save(path_panels([*sides.items()], demos.path(longest), stage), "shoal_recorded", 150)


def _from_the_origin(paths: list[NDArray[np.float64]]) -> NDArray[np.float64]:
    """Tracks of single animals as if they were of a group: ``(STEPS + 1, tracks, 2)``."""
    return np.stack([path[: STEPS + 1, 0] - path[0, 0] for path in paths], axis=1)


if __name__ == "__main__":
    drawers: dict[str, Any] = {one.__name__: one for one in (agent, moth, courtship, plume, free)}
    drawers[sys.argv[1]](*sys.argv[2:])
