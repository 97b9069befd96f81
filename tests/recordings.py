"""Small synthetic recordings of any species, for tests that need demonstrations of it."""

from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from animarl_envs.arena import Arena
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.episode import TIME_OUT, UNFINISHED
from animarl_envs.locomotion import Locomotion
from animarl_envs.scenario import Scenario, make_scenario
from animarl_envs.species import AGENT, SILKMOTH, SPECIES, ChaseSpecies
from animarl_envs.worlds import make_world
from tools.packaged_data import demonstrations_of, shoal

CHASER, PREY = Locomotion(0.2, 2.2), Locomotion(0.3, 2.8)
SPLITS = ("train", "train", "train", "train", "val", "test")
DT, STEPS = 0.1, 40  # of a group
SYNTHETIC = {"source": "made by the test", "licence": "none", "synthetic": True}


def write_tracks(path: Path, bodies: NDArray[np.float64], names: Sequence[str]) -> Path:
    """Write a long table of positions ``(frames, individuals, 2)``, a row a frame and animal."""
    rows = [
        f"{t},{name},{x!r},{y!r}"
        for t, frame in enumerate(bodies.tolist())
        for name, (x, y) in zip(names, frame, strict=True)
    ]
    path.write_text("frame,id,x,y\n" + "\n".join(rows) + "\n")
    return path


def episodes_along(paths: Sequence[NDArray[np.float64]], **more: Any) -> Demonstrations:
    """Test episodes of two predators and a prey, or of others, along given paths."""
    count, num = len(paths), paths[0].shape[1]
    given: dict[str, Any] = {
        "species": "agent", "individuals": ("predator_0", "predator_1", "prey"),
        "roles": ("pursuer", "pursuer", "target"), "dt": 0.1, "arena": Arena(),
        "positions": np.concatenate(paths), "lengths": [len(path) for path in paths],
        "initial_velocity": np.zeros((count, num, 2)), "condition": np.zeros(count),
        "outcome": np.zeros(count), "split": np.full(count, "test"),
        "recording": np.array([f"r{i}" for i in range(count)]), "provenance": SYNTHETIC,
    }  # fmt: skip
    return Demonstrations(**given | more)


def cut_short(demos: Demonstrations, frames: int) -> Demonstrations:
    """The first frames of every episode, as of films that were stopped then."""
    frame = np.concatenate([np.arange(length) for length in demos.lengths])
    return replace(
        demos,
        positions=demos.positions[frame < frames],
        signals={name: values[frame < frames] for name, values in demos.signals.items()},
        lengths=np.minimum(demos.lengths, frames),
        outcome=np.full(len(demos), UNFINISHED),
    )


def begun(scenario: Scenario, copies: int = 1, first: int = 0) -> Any:
    """A world at the start of its first episodes, its copies seeded from ``first`` on."""
    world = make_world(scenario, copies)
    world.seed(first + np.arange(copies))
    world.reset()
    return world


def scripted_chase(
    species: ChaseSpecies, lengths: NDArray[np.int64], **what: Any
) -> Demonstrations:
    """Episodes of so many frames, everybody following the script, none ended by contact."""
    lone = replace(species, contact_radius=1e-6)
    drivers = dict.fromkeys(species.individuals, "scripted")
    episodes = len(lengths)
    world = begun(make_scenario(lone, demos=None, drivers=drivers), episodes)
    path = [world.position.copy()]
    for _ in range(lengths.max() - 1):
        world.step(np.zeros((episodes, species.num_individuals), dtype=int))
        path.append(world.position.copy())
    positions = np.stack(path)
    several = {
        "condition": np.zeros(episodes), "outcome": np.full(episodes, UNFINISHED),
        "split": np.resize(SPLITS, episodes),
        "recording": np.array([f"field {e}" for e in range(episodes)]), "provenance": SYNTHETIC,
    }  # fmt: skip
    paths = [positions[:n, e] for e, n in enumerate(lengths)]
    return demonstrations_of(species, paths, {}, **several | what)


@cache
def dogs(pursuers: int) -> Demonstrations:
    """Eight episodes of so many dogs and a sheep of known locomotion; no species of the suite."""
    names = (*(f"dog_{chr(ord('a') + i)}" for i in range(pursuers)), "sheep")
    species = replace(
        AGENT, name="custom", individuals=names, locomotion=(*(CHASER,) * pursuers, PREY),
        arena=Arena("disc", 2.0, 2.2), time_limit=60,
    )  # fmt: skip
    return scripted_chase(species, 61 - np.arange(8), name="dogs.npz")


@cache
def flock(targets: int) -> Demonstrations:
    """Eight episodes of so many sheep and a dog of known locomotion, who pursues them."""
    species = replace(
        AGENT, name="custom", individuals=(*(f"sheep_{i}" for i in range(targets)), "dog"),
        locomotion=(*(PREY,) * targets, CHASER), lone_pursuer=True,
        arena=Arena("disc", 2.0, 2.2), time_limit=60,
    )  # fmt: skip
    return scripted_chase(species, 61 - np.arange(8), name="flock.npz")


def search(**changes: Any) -> Demonstrations:
    """Three random walks upwind of a searcher of no known species, without odour."""
    return replace(_walks("custom", "beetle", 0.4, 3, 0.4), **changes)


@cache
def recordings_of(name: str) -> Demonstrations:
    """Six short episodes of a species of the suite, in both conditions where there are two."""
    species = SPECIES[name]
    condition = np.arange(6) % 2 if species.conditions else np.zeros(6)
    if isinstance(species, ChaseSpecies):
        return scripted_chase(species, np.full(6, 40), condition=condition)
    rng = np.random.default_rng(0)
    patterns = [0, 1, 2, 0, 3, 4]
    signals = {
        "odour_left": rng.random(240) < 0.3, "odour_right": rng.random(240) < 0.3,
        "heading": np.full(240, np.pi), "plume": np.repeat(patterns, 40),
        "plume_step": np.concatenate([np.arange(40) + 7 * e for e in range(6)]),
    }  # fmt: skip
    walks = _walks(name, *species.individuals, species.dt, 6, SILKMOTH.arena.size)
    return replace(walks, condition=condition, signals=signals)


def _walks(species: str, name: str, dt: float, episodes: int, size: float) -> Demonstrations:
    rng = np.random.default_rng(0)
    steps = 0.002 * rng.standard_normal((episodes, 40, 1, 2)) + [-0.004, 0.0]
    positions = np.array([0.3, 0.0]) + np.cumsum(steps, axis=1)
    return episodes_along(
        list(positions), species=species, individuals=(name,), roles=("searcher",), dt=dt,
        arena=Arena("open", size=size), initial_velocity=steps[:, 0] / dt,
        condition=np.arange(episodes) % 2, outcome=np.full(episodes, TIME_OUT),
        split=np.resize(["train", "val", "test"] if episodes == 3 else SPLITS, episodes),
        recording=np.array([f"run {e}" for e in range(episodes)]),
    )  # fmt: skip


def group(animals: int, episodes: int = 6, arena: str = "disc") -> Demonstrations:
    """Synthetic shoals of the zonal model, by the test split and the others."""
    law = shoal.ZonalLaw()
    paths = shoal.simulate(law, episodes, animals, STEPS, np.random.default_rng(0)) / 10.0
    field = Arena(arena, 1.0, 1.1, rebound=True) if arena != "open" else Arena("open", 1.0)
    return episodes_along(
        list(paths), species="custom", individuals=tuple(f"fish_{k}" for k in range(animals)),
        initial_velocity=(paths[:, 1] - paths[:, 0]) / DT, roles=("pursuer",) * animals,
        arena=field, outcome=np.full(episodes, UNFINISHED),
        split=["train"] * (episodes - 2) + ["val", "test"],
    )  # fmt: skip
