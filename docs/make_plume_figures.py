"""The figures of ``plume.md``: ``python docs/make_plume_figures.py DATA_DIR``.

``DATA_DIR`` is the folder with the recorded plume contacts (``plume_probe_kpb400.npz``,
``hit_counts_5mm.npz``).
"""

from __future__ import annotations

import argparse
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from animarl_envs.drawing.palette import RECORDED, SIMULATED, to_hex
from animarl_envs.worlds.plume.filaments import FilamentModel
from animarl_envs.worlds.plume.plume import ModelPlume
from tools.packaged_data.plume_fit import compare, expected_map
from tools.packaged_data.plume_probe import ENOUGH, CellMap, Probe

IMAGES = Path(__file__).parent / "images"
COLOURS = {"recorded": to_hex(RECORDED), "model": to_hex(SIMULATED)}


def calibration(folder: Path) -> None:
    """Hit rate per cell, recorded and modelled; rate over distance; whiffs and blanks."""
    probe, recorded = Probe.load(folder), CellMap.recorded(folder)
    model = expected_map(probe, recorded, FilamentModel.fitted(), draws=10, seed=0)
    seen = compare(folder)
    figure = plt.figure(figsize=(10, 6.2), layout="constrained")
    top, bottom = figure.subfigures(2, 1, height_ratios=(1.0, 0.9))  # type: ignore[misc]  # an array of two
    axes = top.subplots(1, 3, width_ratios=(1, 1, 0.85))
    extent = (*recorded.x_edges[[0, -1]], *recorded.y_edges[[0, -1]])
    for axis, cells, title in zip(axes, (recorded, model), ("recorded", "model")):
        shown = axis.imshow(
            100 * cells.rate.T, origin="lower", extent=extent, vmin=0, vmax=15, cmap="viridis"
        )
        axis.set(title=f"hit rate per 5 mm cell, {title}", xlabel="x [m]", ylabel="y [m]")
    top.colorbar(shown, ax=list(axes[:2]), label="samples with a hit [%]", shrink=0.8)
    correlation, count = seen["correlation over cells"]
    dots = {"ms": 2, "color": COLOURS["recorded"]}
    axes[2].plot(100 * model.rate.ravel(), 100 * recorded.rate.ravel(), ".", **dots)
    axes[2].axline((0, 0), slope=1, color=COLOURS["model"], lw=1)
    axes[2].set(
        title=f"r = {correlation:.2f} over {count} cells\nwith {ENOUGH} samples or more",
        xlabel="model [%]", ylabel="recorded [%]", xlim=(0, 25), ylim=(0, 40),
    )  # fmt: skip

    axes = bottom.subplots(1, 3)
    start, *rates = np.array(seen["by distance"]).T
    for rate, (who, colour) in zip(rates, COLOURS.items()):
        axes[0].plot(start + 0.0125, 100 * rate, "o-", ms=4, color=colour, label=who)
    axes[0].set(xlabel="distance from the source [m]", ylabel="samples with a hit [%]", ylim=0)
    axes[0].legend(frameon=False)
    for axis, name, edges in (
        (axes[1], "whiff", np.arange(0.5, 15.5) / 30),
        (axes[2], "blank", np.geomspace(0.9 / 30, 30, 60)),
    ):
        for who, colour in COLOURS.items():
            lengths = seen[f"{name} lengths"][who] / 30
            weights = np.full(len(lengths), 100 / len(lengths))
            axis.hist(lengths, edges, weights=weights, histtype="step", lw=1.5, color=colour)
        axis.set(xlabel=f"length of {name}s [s]", ylabel="share [%]")
    axes[2].set_xscale("log")
    figure.savefig(IMAGES / "plume_calibration.png", dpi=90)


def patterns() -> None:
    """One moment of each of the five patterns, and where they hit on average."""
    plume = ModelPlume.fitted()
    figure, axes = plt.subplots(1, 6, figsize=(10, 2.2), layout="constrained", sharey=True)
    for pattern, axis in enumerate(axes[:5]):
        values, extent = plume.field(pattern, 30.3)
        axis.imshow(values, origin="lower", extent=extent, vmin=0, vmax=1, cmap="Greys")
        axis.set(title=f"pattern {pattern}", xlabel="x [m]")
    tables = [plume.pattern_table(pattern, 0.5, 0.0025) for pattern in range(5)]
    share = np.mean([[t.unpack(0, s) for s in range(0, 520, 3)] for t in tables], axis=(0, 1))
    axes[5].imshow(share, origin="lower", extent=tables[0].extent, cmap="viridis")
    axes[5].set(title="hits per step", xlabel="x [m]")
    axes[0].set_ylabel("y [m]")
    figure.savefig(IMAGES / "plume_patterns.png", dpi=80)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Draw the figures of plume.md.")
    parser.add_argument("folder", type=Path)
    given = parser.parse_args()
    IMAGES.mkdir(exist_ok=True)
    patterns()
    calibration(given.folder)
