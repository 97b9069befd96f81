"""The packaged Fly and Newt demonstrations: synthetic intermittent courtship.

Nothing here was recorded from animals. Two males and a female stop and go in the chase world of
their species, with its published locomotion, by a policy that knows only what they see
(:mod:`~tools.packaged_data.courtship_behaviour`), until contact or the time limit. Number,
extremes, total and outcomes of the episodes are those of the paper
(:mod:`~tools.packaged_data.courtship_episodes`); how they pause and move is shown beside recordings
of other animals (:mod:`~tools.packaged_data.courtship_shapes`).

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
from tools.packaged_data import demonstrations_of
from tools.packaged_data.courtship_episodes import Episode, make_episodes
from tools.packaged_data.courtship_published import BEHAVIOURS, PUBLISHED, STARTS, Published
from tools.packaged_data.courtship_shapes import fit
from tools.packaged_data.courtship_statistics import table

GRID = 2.0**-17  # positions are rounded to it [arena unit], so that a file stays below 2 MB


def make(
    name: str,
    seed: int,
    published: Published | None = None,
    progress: Callable[[float], None] | None = None,
) -> Demonstrations:
    """Synthetic demonstrations of ``"fly"`` or ``"newt"``; the same seed gives the same bytes.

    Parameters
    ----------
    published
        Number, extremes, total and outcomes of the episodes; by default those of the paper.
    progress
        Is told the share of the simulation that is done.

    Raises
    ------
    InputError
        If the species has no courtship, or chance does not give such episodes.
    """
    if name not in PUBLISHED:
        raise InputError(f"species {name!r} has no courtship: choose {' or '.join(PUBLISHED)}")
    asked, species = published or PUBLISHED[name], get_species(name)
    assert isinstance(species, ChaseSpecies)
    rng = np.random.default_rng(seed)
    episodes = make_episodes(species, BEHAVIOURS[name], STARTS[name], asked, rng, progress)
    episodes = [episodes[i] for i in rng.permutation(len(episodes))]
    return _demonstrations(species, episodes, asked, seed)


def _demonstrations(
    species: ChaseSpecies, episodes: Sequence[Episode], published: Published, seed: int
) -> Demonstrations:
    paths, actions, first = [], [], []
    for each in episodes:
        path = each.pool.position[: each.steps + 1, each.index]
        acted = np.full(path.shape[:2], -1, dtype=np.int8)
        acted[:-1] = each.pool.actions[: each.steps, each.index]
        paths.append(np.round(path.astype(np.float64) / GRID) * GRID)
        actions.append(acted)
        first.append(each.pool.velocity[each.index])
    shares = tuple(n / published.episodes for n in published.splits)
    return demonstrations_of(
        species,
        paths,
        signals={"actions": actions},
        initial_velocity=np.array(first),
        condition=np.zeros(len(episodes), dtype=np.int8),
        outcome=np.array([each.outcome for each in episodes], dtype=np.int8),
        split=assign_splits([f"{e:04d}" for e in range(len(episodes))], seed, shares),  # type: ignore[arg-type]
        recording=np.array([each.label for each in episodes]),
        provenance={
            "source": "synthetic courtship, not recorded from animals, made by python -m "
            f"tools.packaged_data.courtship make {species.name} --seed {seed}",
            "licence": "MIT",
            "synthetic": True,
            "seed": seed,
            "version": animarl_envs.__version__,
            "behaviour": asdict(BEHAVIOURS[species.name]),
            "starts": asdict(STARTS[species.name]),
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
    parsers["table"].add_argument("--file", type=Path, help="the packaged one by default")
    parsers["table"].add_argument("--data", type=Path, help="folder of the recordings")
    parsers["fit"].add_argument("--data", type=Path, required=True, help="folder of the recordings")
    given = parser.parse_args(arguments)
    try:
        if given.command == "make":
            _make(given.species, given.seed, given.out)
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


def _make(species: str, seed: int, out: Path | None) -> None:
    demos = make(species, seed, progress=_bar if sys.stderr.isatty() else None)
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
