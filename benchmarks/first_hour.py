"""From a table of a lab to a report: how many commands and how much time, how near it comes.

Usage: python -m benchmarks.first_hour [--chases 300] [--out out/first_hour]

The table is synthetic (``tools/make_lab_table.py``): so many chases of a pursuer and a target, a
row per frame and individual, in pixels at 10 Hz. Two commands follow, without any option: ``animarl
import`` and ``animarl run``. Printed are the processor time of each, and of the test split the
recorded and simulated median speed, duration and share of chases that ended by contact.
"""

from __future__ import annotations

import argparse
import resource
import subprocess
import sys
import time
from pathlib import Path

from animarl_algos.evaluation.verdict import Verdict
from animarl_envs.drawing import markdown_table
from tools.make_lab_table import write

MEASURES = ("median_speed", "duration", "reached")
ANIMARL = "from animarl_algos.cli.main import main; main()"


def animarl(*words: object) -> tuple[float, float]:
    """Run a command; processor and wall time [s]."""
    before, start = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    given = [sys.executable, "-c", ANIMARL, *map(str, words)]
    subprocess.run(given, check=True, stdout=subprocess.DEVNULL)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    spent = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return spent, time.perf_counter() - start


def main() -> None:
    """Make the table, run both commands, print what they took and gave."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--chases", type=int, default=300)
    parser.add_argument("--out", type=Path, default=Path("out/first_hour"))
    asked = parser.parse_args()
    table = write(asked.out / "table.csv", asked.chases)
    demos, run = asked.out / "table.npz", asked.out / "run"
    commands = [("import", table, "--out", demos), ("run", demos, "--out", run)]
    spent = [(words, *animarl(*words)) for words in commands]
    rows = [
        (f"`animarl {' '.join(map(str, words))}`", f"{processor:.0f}", f"{wall:.0f}")
        for words, processor, wall in spent
    ]
    rows.append(("together", f"{sum(s[1] for s in spent):.0f}", f"{sum(s[2] for s in spent):.0f}"))
    print(markdown_table(("command", "processor time, s", "wall, s"), rows))
    print()
    found = Verdict.load(run / "evaluation")
    values = []
    for key in MEASURES:
        row = found.row(key)
        gap = row["simulated"] / row["recorded"] - 1
        values.append(
            (row["label"], row["unit"], f"{row['recorded']:.3g}", f"{row['simulated']:.3g}",
             f"{gap:+.0%}")
        )  # fmt: skip
    print(markdown_table(("measure", "unit", "recorded", "simulated", "gap"), values))
    print(f"\n{found.rollouts} rollouts from {found.starts} test starts: {found.headline}")


if __name__ == "__main__":
    main()
