"""The picture of ``data/packaged_silkmoth.md``.

    python docs/make_packaged_moth_picture.py DATA_DIR

``DATA_DIR`` is the folder of recorded moths, of which only distributions are drawn.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Circle

from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.packaged import load_packaged
from animarl_envs.drawing.palette import PURSUERS, RECORDED, SIMULATED, to_hex
from animarl_envs.species import SILKMOTH
from animarl_envs.worlds.plume.plume import ModelPlume
from tools.packaged_data.moth_statistics import of_demonstrations, recorded_statistics

PATTERN = 0  # whose searches are drawn
COLOURS = {"recorded": to_hex(RECORDED), "full": to_hex(SIMULATED), "reduced": to_hex(PURSUERS[1])}


def tracks(axis: Axes, demos: Demonstrations, condition: int, colour: str) -> None:
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


def main() -> None:
    parser = argparse.ArgumentParser(description="Draw the packaged moths beside recorded ones.")
    parser.add_argument("folder", type=Path)
    given = parser.parse_args()
    demos = load_packaged("silkmoth")
    found = {
        "recorded": recorded_statistics(given.folder),
        "full": of_demonstrations(demos.select(condition=0)),
        "reduced": of_demonstrations(demos.select(condition=1)),
    }
    names = {
        "recorded": "recorded (24), full senses",
        "full": "synthetic (30), full senses",
        "reduced": "synthetic (30), wind and vision blocked",
    }
    figure = plt.figure(figsize=(11, 6.4), layout="constrained")
    top, bottom = figure.subfigures(2, 1, height_ratios=(1.15, 1.0))  # type: ignore[misc]  # an array of two
    for axis, condition in zip(top.subplots(1, 2, sharey=True), (0, 1)):
        tracks(axis, demos, condition, COLOURS["reduced" if condition else "full"])
    speed, turning, duration = bottom.subplots(1, 3)
    for who, one in found.items():
        style = {"histtype": "step", "density": True, "color": COLOURS[who], "lw": 1.5}
        if who != "reduced":  # compared like with like
            speed.hist(1000 * one.speed, np.arange(0, 41, 2), **style)
            turning.hist(one.turning, np.linspace(0, 2 * np.pi, 26), **style)
        when = np.sort(one.duration[one.reached])
        share = np.arange(1, len(when) + 1) / len(one.duration)
        ends = SILKMOTH.time_limit * SILKMOTH.dt
        duration.step(
            [0, *when, ends], [0, *share, one.rate], where="post", color=COLOURS[who],
            label=names[who],
        )  # fmt: skip
    speed.set(xlabel="speed at 2 Hz [mm/s]", ylabel="density")
    turning.set(xlabel="turning rate of the direction of travel [rad/s]", ylabel="density")
    duration.set(xlabel="time [s]", ylabel="share that has reached the source", ylim=(0, 1.02))
    duration.set_xlim(0, SILKMOTH.time_limit * SILKMOTH.dt)
    handles, labels = duration.get_legend_handles_labels()
    bottom.legend(handles, labels, frameon=False, ncols=3, loc="outside lower center")
    out = Path(__file__).parent / "images" / "packaged_silkmoth.png"
    figure.savefig(out, dpi=90)
    print(f"wrote {out}")


if __name__ == "__main__":
    main()
