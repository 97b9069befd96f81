"""The picture of the README, from the run that ``make demo`` makes.

make demo && python docs/make_demo_picture.py
"""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
from PIL import Image

from animarl_algos.evaluation.rollouts import NO_CUE, Rollouts
from animarl_algos.report.path_figures import trajectory_pair
from animarl_algos.report.words import Words
from animarl_algos.runs.rolling_out import method_name
from animarl_algos.runs.run_folder import RunFolder

ROOT = Path(__file__).resolve().parents[1]
PERCENTILES = (10, 30, 50, 70, 90)  # of the duration: chosen by rank, not by eye


def main() -> None:
    run = RunFolder(ROOT / "out" / "demo")
    demos = run.demos.select(split="test")
    name = method_name(run.settings.algo)
    rollouts = Rollouts.load(run.path / "rollouts" / f"{name}.npz")
    told_nothing_false = (rollouts.cue == NO_CUE) | (rollouts.cue == rollouts.condition)
    rollouts = rollouts.select(told_nothing_false)
    ranked = np.argsort(rollouts.lengths)
    shown: set[int] = set()
    panels = []
    for percentile in PERCENTILES:
        longer = ranked[round(percentile / 100 * (len(ranked) - 1)) :].tolist()
        chosen = next(i for i in longer if int(rollouts.demo[i]) not in shown)  # no start twice
        shown.add(int(rollouts.demo[chosen]))
        figure = trajectory_pair(
            rollouts.path(chosen),
            demos.episode(int(rollouts.demo[chosen])).positions,
            demos.arena,
            demos.roles,
            demos.individuals,
            Words.of(demos),
        )
        buffer = io.BytesIO()
        figure.savefig(buffer, format="png", dpi=110)
        panels.append(Image.open(buffer).convert("RGB"))
    width, height = sum(p.width for p in panels), max(p.height for p in panels)
    picture = Image.new("RGB", (width, height), "white")
    left = 0
    for panel in panels:
        picture.paste(panel, (left, 0))
        left += panel.width
    out = ROOT / "docs" / "images" / "demo.png"
    picture.save(out, optimize=True)
    print(f"wrote {out.relative_to(ROOT)}")


if __name__ == "__main__":
    main()
