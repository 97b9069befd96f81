"""The figure of ``docs/data/packaged_agent.md``: ``python docs/make_packaged_agent.py``."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from animarl_algos.report import style
from animarl_algos.report.path_figures import draw_paths
from animarl_envs.demos.packaged import load_packaged
from animarl_envs.drawing.palette import PURSUERS, to_hex
from animarl_envs.species import AGENT

IMAGE = Path(__file__).parent / "images" / "packaged_agent.png"
PERCENTILES = (10, 30, 50, 70, 90)  # of the duration: chosen by rank, not by eye
COLOURS = (to_hex(PURSUERS[2]), to_hex(PURSUERS[3]))  # individual, shared


def main() -> None:
    demos = load_packaged("agent")
    with style.figure_style():
        from matplotlib.figure import Figure

        figure = Figure(figsize=(11, 6.6), layout="constrained")
        top, bottom = figure.subfigures(2, 1, height_ratios=(1.75, 1.0))  # type: ignore[misc]  # an array of two
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
                [0, *times, limit], [0, *share, share[-1]], where="post", color=COLOURS[condition],
                label=f"{name}, in the end {share[-1]:.3f}",
            )  # fmt: skip
            edges = np.linspace(0, limit, 23)
            panels[1].hist(
                times, edges, weights=np.full(len(times), 1 / len(duration)), histtype="step",
                color=COLOURS[condition], label=name,
            )  # fmt: skip
            apart = np.linalg.norm(part.positions[:, 0] - part.positions[:, 1], axis=-1)
            panels[2].hist(
                apart, np.linspace(0, 2.4, 41), density=True, histtype="step",
                color=COLOURS[condition], label=name,
            )  # fmt: skip
        panels[0].set(xlabel="time (s)", ylabel="share captured so far", xlim=(0, 15), ylim=(0, 1))
        panels[1].set(xlabel="capture time (s)", ylabel="share of episodes")
        panels[2].set(xlabel="distance between the predators (arena units)", ylabel="density")
        for panel in panels:
            panel.legend(loc="lower right" if panel is panels[0] else "upper right")
        figure.savefig(IMAGE, dpi=100)


if __name__ == "__main__":
    main()
