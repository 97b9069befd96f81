"""The packaged Fly and Newt demonstrations: synthetic intermittent courtship.

Nothing here was recorded from animals. Two males and a female stop and go in the chase world of
their species, with its published locomotion (:mod:`~tools.packaged_data.courtship_behaviour`); the
shape of pauses, moves and speeds was fitted to recordings of other animals
(:mod:`~tools.packaged_data.courtship_shapes`); episodes are chosen so that their number, durations
and outcomes are those of the paper (:mod:`~tools.packaged_data.courtship_episodes`).

    python -m tools.packaged_data.courtship make fly --seed 1 --out fly.npz
    python -m tools.packaged_data.courtship table fly [--data DATA_DIR]
    python -m tools.packaged_data.courtship fit fly --data DATA_DIR
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path

import numpy as np

import animarl_envs
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.packaged import load_packaged
from animarl_envs.demos.splits import assign_splits
from animarl_envs.errors import InputError
from animarl_envs.species import ChaseSpecies, get_species
from animarl_envs.species.options import with_options
from tools.packaged_data.courtship_behaviour import simulate
from tools.packaged_data.courtship_episodes import (
    SETTLED,
    Window,
    choose_windows,
    durations,
    outcomes,
)
from tools.packaged_data.courtship_published import BEHAVIOURS, PUBLISHED
from tools.packaged_data.courtship_shapes import fit
from tools.packaged_data.courtship_statistics import table

SESSION_STEPS = SETTLED + 12_000  # twenty minutes, after one in which everybody gets going
SESSIONS_PER_EPISODE, MORE_SESSIONS = 2, 30
GRID = 2.0**-17  # positions are rounded to it [arena unit], so that a file stays below 2 MB


def make(
    name: str,
    seed: int,
    episodes: int | None = None,
    session_steps: int = SESSION_STEPS,
    progress: Callable[[float], None] | None = None,
) -> Demonstrations:
    """Synthetic demonstrations of ``"fly"`` or ``"newt"``; the same seed gives the same bytes.

    Parameters
    ----------
    episodes
        How many; as published by default. Fewer are thinned evenly by duration.
    session_steps
        Length of a session; enough for the full number by default.
    progress
        Is told the share of the simulation that is done.

    Raises
    ------
    InputError
        If the species or the number is not possible.
    """
    if name not in PUBLISHED:
        raise InputError(f"species {name!r} has no courtship: choose {' or '.join(PUBLISHED)}")
    # sessions are cut where nobody is beyond the edge, so they are simulated without walls
    published, species = PUBLISHED[name], with_options(get_species(name), rebound=False)
    count = published.episodes if episodes is None else episodes
    if not 3 <= count <= published.episodes:
        raise InputError(f"episodes is {count}: choose 3 to {published.episodes}")
    assert isinstance(species, ChaseSpecies)
    rng = np.random.default_rng(seed)
    steps = durations(published, species.dt)
    steps = steps[np.linspace(0, len(steps) - 1, count).round().astype(int)]
    codes = outcomes(published, steps, species.time_limit, rng)
    number = SESSIONS_PER_EPISODE * count + MORE_SESSIONS
    sessions = simulate(species, BEHAVIOURS[name], number, session_steps, rng, progress=progress)
    windows = choose_windows(species, BEHAVIOURS[name], sessions, steps, codes, rng)
    windows = [windows[i] for i in rng.permutation(count)]
    return _demonstrations(species, windows, seed)


def _demonstrations(species: ChaseSpecies, windows: Sequence[Window], seed: int) -> Demonstrations:
    published = PUBLISHED[species.name]
    paths, actions, first = [], [], []
    for w in windows:
        path = w.sessions.position[w.start : w.stop + 1, w.session]
        acted = np.full(path.shape[:2], -1, dtype=np.int8)
        acted[:-1] = w.sessions.actions[w.start : w.stop, w.session]
        paths.append(np.round(path.astype(np.float64) / GRID) * GRID)
        actions.append(acted)
        first.append(w.sessions.velocity[w.start, w.session])
    shares = tuple(n / published.episodes for n in published.splits)
    return Demonstrations.of_species(
        species,
        paths,
        signals={"actions": actions},
        initial_velocity=np.array(first),
        condition=np.zeros(len(windows), dtype=np.int8),
        outcome=np.array([w.outcome for w in windows], dtype=np.int8),
        split=assign_splits([f"{e:04d}" for e in range(len(windows))], seed, shares),  # type: ignore[arg-type]
        recording=np.array([w.label for w in windows]),
        provenance={
            "source": "synthetic courtship, not recorded from animals, made by python -m "
            f"tools.packaged_data.courtship make {species.name} --seed {seed}",
            "licence": "MIT",
            "synthetic": True,
            "seed": seed,
            "version": animarl_envs.__version__,
            "behaviour": asdict(BEHAVIOURS[species.name]),
            "statistics": "number, durations and outcomes chosen to match the paper's; "
            "see docs/data/packaged_courtship.md",
        },
        name=f"synthetic courtship, {species.name}",
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """The command line; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n", maxsplit=1)[0])
    commands = parser.add_subparsers(dest="command", required=True)
    parsers = {
        name: commands.add_parser(name, help=text, description=text)
        for name, text in (
            ("make", "write synthetic demonstrations"),
            ("table", "compare a file with what is published and recorded"),
            ("fit", "print the constants of a species' recordings"),
        )
    }
    for one in parsers.values():
        one.add_argument("species", choices=sorted(PUBLISHED))
    parsers["make"].add_argument("--out", type=Path, help="file to write; SPECIES.npz by default")
    parsers["make"].add_argument("--seed", type=int, default=1, help="root of all randomness")
    parsers["make"].add_argument("--episodes", type=int, help="as published by default")
    parsers["table"].add_argument("--file", type=Path, help="the packaged one by default")
    parsers["table"].add_argument("--data", type=Path, help="folder of the recordings")
    parsers["fit"].add_argument("--data", type=Path, required=True, help="folder of the recordings")
    given = parser.parse_args(arguments)
    try:
        if given.command == "make":
            _make(given.species, given.seed, given.episodes, given.out)
        elif given.command == "table":
            file = given.file
            demos = load_packaged(given.species) if file is None else Demonstrations.load(file)
            print(table(demos, PUBLISHED[given.species], given.data))
        else:
            print(fit(given.species, given.data))
    except InputError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    return 0


def _make(species: str, seed: int, episodes: int | None, out: Path | None) -> None:
    demos = make(species, seed, episodes, progress=_bar if sys.stderr.isatty() else None)
    path = demos.save(out or Path(f"{species}.npz"), dtype=np.float32)
    print(demos)
    print(f"wrote {path} ({path.stat().st_size / 1e6:.2f} MB)")


def _bar(done: float) -> None:
    """A bar over the same line of the terminal."""
    full = int(40 * done)
    end = "\n" if done >= 1.0 else ""
    print(f"\r[{'#' * full}{'.' * (40 - full)}] {done:4.0%}", end=end, file=sys.stderr, flush=True)


if __name__ == "__main__":
    sys.exit(main())
