"""The figures of ``data/packaged_courtship.md``: ``python docs/make_courtship_figures.py DATA``.

``DATA`` is the folder with the recordings of fly groups and termite pairs.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.patches import Circle, Rectangle
from numpy.typing import NDArray

from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.packaged import load_packaged
from animarl_envs.drawing.palette import PURSUERS, RECORDED, SIMULATED, TARGET, TOUCH, to_hex
from animarl_envs.files import write_then_rename
from animarl_envs.importing.cleaning import runs
from tools.packaged_data.courtship_published import BEHAVIOURS
from tools.packaged_data.courtship_shapes import MOVING_SHARE, is_moving, recorded_tracks

IMAGES = Path(__file__).parent / "images"
RECORDED_ANIMALS = {"fly": "groups of flies, recorded", "newt": "termite pairs, recorded"}
SHOWN = 6  # tracks of episodes, evenly by duration
SPEED_BINS = np.linspace(0.0, 1.3, 41)
STYLES = {"recorded": {"color": to_hex(RECORDED)}, "synthetic": {"color": to_hex(SIMULATED)}}


def figure(name: str, folder: Path) -> None:
    """Sample tracks above; speeds, pauses and moves below."""
    demos = load_packaged(name)
    drawn = plt.figure(figsize=(11, 5.4), layout="constrained")
    above, below = drawn.subfigures(2, 1, height_ratios=(1.0, 1.1))  # type: ignore[misc]  # an array of two
    order = np.argsort(demos.lengths, kind="stable")
    chosen = order[(np.linspace(0.15, 0.97, SHOWN) * len(order)).astype(int)]
    panels = above.subplots(1, SHOWN)
    for axis, index in zip(panels, chosen, strict=True):
        tracks(axis, demos, int(index))
    handles, names = panels[0].get_legend_handles_labels()
    above.legend(handles, names, loc="lower center", ncols=len(names), frameon=False, fontsize=8)
    distributions(below.subplots(1, 3), demos, recorded_tracks(name, folder))
    drawn.suptitle(f"Packaged {name}: synthetic courtship, not recorded from animals", fontsize=11)
    with write_then_rename(IMAGES / f"packaged_{name}.png") as part:
        drawn.savefig(part, dpi=90)
    plt.close(drawn)


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
    edge: dict[str, Any] = {"fill": False, "ec": to_hex(RECORDED), "lw": 0.8}
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
    for who, paths in sets.items():
        speeds, pauses, moves = stop_and_go(paths, demos.dt)
        style = STYLES[who] | {"label": labels[who]}
        axes[0].hist(np.minimum(speeds, 1.3), SPEED_BINS, density=True, histtype="step", **style)
        lasting(axes[1], pauses, **style)
        lasting(axes[2], moves, **style)
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


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("folder", type=Path)
    folder = parser.parse_args().folder
    for name in BEHAVIOURS:
        figure(name, folder)


if __name__ == "__main__":
    main()
