"""The pictures of ``one_animal.md`` and ``shoal.md``, of runs on recordings.

python docs/make_free_animals_pictures.py RUN_OF_LARVAE RUN_OF_FISH
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from animarl_algos import load_run
from animarl_algos.report.path_figures import Stage, path_panels
from animarl_algos.report.words import Words
from animarl_envs.files import write_then_rename

IMAGES = Path(__file__).parent / "images"
SHOWN, STEPS = 12, 80  # tracks of single animals, and for how many steps


def larvae(run_folder: str) -> None:
    """Tracks from a common start: recorded, and simulated from the same starts."""
    run = load_run(run_folder)
    demos, simulated = run.demos.select(split="test"), run.simulate(repetitions=1)
    enough = np.flatnonzero(demos.lengths > STEPS)[:SHOWN]
    first = [int(np.flatnonzero(simulated.demo == i)[0]) for i in enough]
    sides = {
        "recorded": _from_the_origin([demos.path(int(i)) for i in enough]),
        "simulated": _from_the_origin([simulated.path(i) for i in first]),
    }
    names = tuple(str(i) for i in enough)
    stage = Stage(demos.arena, ("pursuer",) * len(enough), names, Words.of(demos))
    _save("one_animal", sides, sides["recorded"], stage)


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
    _save("shoal_recorded", sides, demos.path(longest), stage)


def _from_the_origin(paths: list[NDArray[np.float64]]) -> NDArray[np.float64]:
    """Tracks of single animals as if they were of a group: ``(STEPS + 1, tracks, 2)``."""
    return np.stack([path[: STEPS + 1, 0] - path[0, 0] for path in paths], axis=1)


def _save(
    name: str, sides: dict[str, NDArray[np.float64]], recorded: NDArray[np.float64], stage: Stage
) -> None:
    figure = path_panels([*sides.items()], recorded, stage)
    with write_then_rename(IMAGES / f"{name}.png") as part:
        figure.savefig(part, dpi=150)


if __name__ == "__main__":
    larvae(sys.argv[1])
    fish(sys.argv[2])
