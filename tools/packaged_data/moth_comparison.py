"""Programmed moths beside recorded ones and the paper's figures.

    python -m tools.packaged_data.moth_comparison [DATA_DIR] [--file FILE]

prints the table of ``docs/data/packaged_silkmoth.md`` for the packaged demonstrations or another
file, then how often, how fast and on how long a path ``--episodes`` programmed moths find the
source in plumes of training and in held-out ones (``docs/plume.md``). ``DATA_DIR`` is the folder of
recorded moths; without it, their column stays empty.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.packaged import load_packaged
from animarl_envs.drawing import markdown_table
from animarl_envs.locomotion import Locomotion
from animarl_envs.species import SILKMOTH
from tools.packaged_data.moth_published import PUBLISHED
from tools.packaged_data.moth_statistics import (
    QUARTILES,
    SPEED_QUANTILES,
    TURNING_QUANTILES,
    SearchStatistics,
    of_demonstrations,
    recorded_statistics,
    search_statistics,
    wasserstein,
)

RECORDED_FIT = Locomotion(0.342, 0.0171)  # animarl fit moth.npz --method onset --split all
ABSENT = "-"


def comparison(demos: Demonstrations, recorded: SearchStatistics | None) -> list[tuple[str, ...]]:
    """Rows: statistic, published, recorded, generated."""
    both = of_demonstrations(demos)
    full, reduced = (of_demonstrations(demos.select(condition=c)) for c in (0, 1))
    terminal = SILKMOTH.locomotion[0].terminal_speed(SILKMOTH.dt)

    def seen(of: Callable[[SearchStatistics], str]) -> str:
        return ABSENT if recorded is None else of(recorded)

    def quantiles(name: str, shares: tuple[float, ...], digits: int) -> tuple[str, ...]:
        def words(found: SearchStatistics) -> str:
            values = getattr(found, name)
            if name in ("duration", "path"):
                values = values[found.reached]
            return ", ".join(f"{q:.{digits}f}" for q in np.quantile(values, shares))

        return ABSENT, seen(words), words(full)

    rows: list[tuple[str, ...]] = [
        ("episodes, full and reduced senses", "30, 30", seen(lambda r: f"{len(r.reached)}, 0"),
         f"{len(full.reached)}, {len(reduced.reached)}"),
        ("source reached, full", f"{PUBLISHED.reached_full:.3f}", seen(lambda r: f"{r.rate:.3f}"),
         f"{full.rate:.3f}"),
        ("source reached, reduced", f"{PUBLISHED.reached_reduced:.3f}", ABSENT,
         f"{reduced.rate:.3f}"),
        ("shortest episode [s]", f"{PUBLISHED.shortest:.1f}",
         seen(lambda r: f"{r.duration.min():.1f}"), f"{both.duration.min():.1f}"),
        ("total duration [s]", f"{PUBLISHED.total:.1f}", seen(lambda r: f"{r.duration.sum():.1f}"),
         f"{both.duration.sum():.1f}"),
        ("mean duration [s]", f"{PUBLISHED.mean_duration:.1f}",
         seen(lambda r: f"{r.duration.mean():.1f}"), f"{both.duration.mean():.1f}"),
        ("mean path, reduced less full [m]",
         "{:.2f} to {:.2f}".format(*PUBLISHED.path_difference), ABSENT,
         f"{reduced.path.mean() - full.path.mean():.2f}"),
        ("duration, full, reached: quartiles [s]", *quantiles("duration", QUARTILES, 0)),
        ("path, full, reached: quartiles [m]", *quantiles("path", QUARTILES, 2)),
        ("speed, full: 5, 25, 50, 75, 95, 99 % [m/s]", *quantiles("speed", SPEED_QUANTILES, 4)),
        ("highest speed [m/s]", f"{terminal:.3f} (terminal)",
         seen(lambda r: f"{r.speed.max():.4f}"), f"{both.speed.max():.4f}"),
        ("share of steps under 2 mm/s, full", ABSENT, seen(lambda r: f"{r.resting:.3f}"),
         f"{full.resting:.3f}"),
        ("turning rate, full: 25, 50, 75, 90 % [rad/s]",
         *quantiles("turning", TURNING_QUANTILES, 2)),
    ]  # fmt: skip
    if recorded is not None:
        for name, unit in (("speed", "m/s"), ("turning", "rad/s"), ("duration", "s")):
            distance = wasserstein(getattr(full, name), getattr(recorded, name))
            rows.append((f"{name}, full: distance to recorded [{unit}]", ABSENT, "0",
                         f"{distance:.4f}" if name == "speed" else f"{distance:.2f}"))  # fmt: skip
    return rows


def rates(
    episodes: int, seed: int, recorded: SearchStatistics | None
) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Head and rows: who, senses, reached with its interval, quartiles of duration and path."""
    fitted = replace(SILKMOTH, locomotion=(RECORDED_FIT,))
    held_out = replace(SILKMOTH, train_plumes=SILKMOTH.test_plumes)
    rows: list[tuple[str, ...]] = []
    if recorded is not None:
        rows.append(("recorded moths", "full", *_fared(recorded)))
    for who, species in (
        ("programmed, training plumes", SILKMOTH),
        ("programmed, held-out plumes", held_out),
        (f"with d = {RECORDED_FIT.damping}, u = {RECORDED_FIT.thrust}, training plumes", fitted),
    ):
        for condition, senses in enumerate(("full", "reduced")):
            found = search_statistics(species, condition, episodes=episodes, seed=seed)
            rows.append((who if condition == 0 else "", senses, *_fared(found)))
    return ("", "senses", "reached", "duration [s]", "path [m]"), rows


def _fared(found: SearchStatistics) -> tuple[str, str, str]:
    low, high = found.interval()
    duration = np.quantile(found.duration[found.reached], QUARTILES)
    path = np.quantile(found.path[found.reached], QUARTILES)
    return (
        f"{found.reached.sum()} of {len(found.reached)} = {found.rate:.3f} [{low:.3f}, {high:.3f}]",
        ", ".join(f"{value:.0f}" for value in duration),
        ", ".join(f"{value:.2f}" for value in path),
    )


def main() -> None:
    """Command line; see the top of this module."""
    parser = argparse.ArgumentParser(description="Programmed moths beside recorded ones.")
    parser.add_argument("folder", type=Path, nargs="?", help="folder of recorded moths")
    parser.add_argument("--file", type=Path, help="demonstrations; by default the packaged ones")
    parser.add_argument("--episodes", type=int, default=1000, help="per row of the second table")
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    demos = load_packaged("silkmoth") if given.file is None else Demonstrations.load(given.file)
    recorded = None
    if given.folder is not None:
        recorded = recorded_statistics(given.folder)
    head = ("statistic", "published", "recorded (24 runs)", "generated (synthetic)")
    print(markdown_table(head, comparison(demos, recorded)))
    print()
    print(markdown_table(*rates(given.episodes, given.seed, recorded)))


if __name__ == "__main__":
    main()
