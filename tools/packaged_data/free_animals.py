"""The packaged Solo and Shoal demonstrations: a larva and a shoal by published laws.

Nothing here was recorded from animals. Larvae run and turn after Davies et al. (2015)
(:mod:`~tools.packaged_data.larva`), fish keep to the zones of Couzin et al. (2002)
(:mod:`~tools.packaged_data.shoal`). Positions have the noise of a tracker. Episodes begin when the
first moments are over, and merely end, as a film does.

    python -m tools.packaged_data.free_animals solo --seed 1 --out solo.npz
    python -m tools.packaged_data.free_animals shoal --seed 1 --out shoal.npz
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import animarl_envs
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.episode import UNFINISHED
from animarl_envs.demos.splits import assign_splits
from animarl_envs.species import Species, get_species
from tools.packaged_data import demonstrations_of
from tools.packaged_data.larva import RunAndTurnLaw
from tools.packaged_data.larva import simulate as crawl
from tools.packaged_data.shoal import ZonalLaw
from tools.packaged_data.shoal import simulate as swim

Paths = list[NDArray[np.float64]]

GRID = 2.0**-17  # positions are rounded to it [arena unit]
LARVAE, SHORTEST, LONGEST = 160, 20.0, 60.0  # tracks, and how long they are [s]
MM = 20.0  # of one arena unit of Solo
GROUPS, DURATION, BODY_LENGTHS = 50, 20.0, 10.0  # shoals, of so many seconds; of one arena unit
BEFORE = 10.0  # simulated before an episode begins [s]
INSIDE = 0.99  # of the tank's radius: tracking noise leaves it to nobody
NOISE = {"solo": 0.015, "shoal": 0.02}  # of tracking, standard deviation per axis [mm, body length]


def larvae(species: Species, rng: np.random.Generator) -> tuple[Paths, RunAndTurnLaw]:
    """Return tracks ``(frames, 1, 2)`` [arena unit] that begin at the origin."""
    law, dt = RunAndTurnLaw(), species.dt
    lasts = rng.uniform(SHORTEST, LONGEST, LARVAE)
    before = round(BEFORE / dt)
    tracks = crawl(law, LARVAE, before + round(LONGEST / dt) + 1, dt, rng)[:, before:]
    tracks = (tracks - tracks[:, :1]) / MM
    return [p[: round(t / dt) + 1, None] for p, t in zip(tracks, lasts.tolist())], law


def fish(species: Species, rng: np.random.Generator) -> tuple[Paths, ZonalLaw]:
    """Return shoals ``(frames, animals, 2)`` [arena unit]."""
    law = ZonalLaw(dt=species.dt)
    before, steps = round(BEFORE / law.dt), round(DURATION / law.dt)
    paths = swim(law, GROUPS, species.num_individuals, before + steps, rng)[:, before:]
    return list(INSIDE * paths / BODY_LENGTHS), law


PROGRAMS: dict[str, Any] = {"solo": (larvae, MM, "mm"), "shoal": (fish, BODY_LENGTHS, "")}


def make(name: str, seed: int) -> Demonstrations:
    """Synthetic demonstrations of ``"solo"`` or ``"shoal"``; the same seed gives the same bytes."""
    program, scale, unit = PROGRAMS[name]
    species, rng = get_species(name), np.random.default_rng(seed)
    paths, law = program(species, rng)
    noise = NOISE[name] / scale
    paths = [path + noise * rng.normal(size=path.shape) for path in paths]
    paths = [np.round(path / GRID) * GRID for path in paths]
    count = len(paths)
    recording = [f"synthetic {name} {i}" for i in range(count)]
    return demonstrations_of(
        species,
        paths,
        signals={},
        initial_velocity=np.array([(path[1] - path[0]) / species.dt for path in paths]),
        condition=np.zeros(count, dtype=np.int8),
        outcome=np.full(count, UNFINISHED, dtype=np.int8),
        split=assign_splits(recording, seed, (0.6, 0.15, 0.25)),
        recording=np.array(recording),
        provenance={
            "source": "synthetic, not recorded from animals, made by python -m "
            f"tools.packaged_data.free_animals {name} --seed {seed}",
            "licence": "MIT",
            "synthetic": True,
            "seed": seed,
            "version": animarl_envs.__version__,
            "law": asdict(law),
            "tracking_noise": NOISE[name],
            **({"unit": unit, "scales": {r: {"unit": scale} for r in recording}} if unit else {}),
        },
        name=f"synthetic {species.title[:1].lower()}{species.title[1:]}",
    )


def main(arguments: Sequence[str] | None = None) -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n", maxsplit=1)[0])
    parser.add_argument("species", choices=sorted(PROGRAMS))
    parser.add_argument("--out", type=Path, help="file to write; SPECIES.npz by default")
    parser.add_argument("--seed", type=int, default=1, help="root of all randomness")
    given = parser.parse_args(arguments)
    demos = make(given.species, given.seed)
    path = demos.save(given.out or Path(f"{given.species}.npz"), dtype=np.float32)
    print(demos)
    print(f"wrote {path} ({path.stat().st_size / 1e6:.2f} MB)")


if __name__ == "__main__":
    main()
