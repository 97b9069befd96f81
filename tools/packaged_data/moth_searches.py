"""Synthetic demonstrations of odour search: programmed moths in the modelled plume.

Each of the five plume patterns is searched six times with full and six times with reduced senses,
as in the paper. Patterns 0, 1, 2 are for training, 3 for validation, 4 for testing, so that no
split shares a plume with another. Nothing here was recorded from animals.

    python -m tools.packaged_data.moth_searches --seed 10 --out silkmoth.npz
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import animarl_envs
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.errors import InputError
from animarl_envs.scenario import Scenario
from animarl_envs.species import SILKMOTH, SearchSpecies
from animarl_envs.worlds.search.programmed_moth import MothProgramme, ProgrammedMoth
from animarl_envs.worlds.search.world import SearchWorld
from tools.packaged_data import demonstrations_of

TRIALS = 6  # per plume pattern and condition (paper, "Silkmoth dataset")
SEED = 10  # of the packaged file: of 1 to 12 the one with the published success rates
SPLIT_OF_PATTERN = ("train", "train", "train", "val", "test")


@dataclass(frozen=True, eq=False)
class Searches:
    """``n`` searches side by side, up to ``T`` steps; what follows an episode's end is no part.

    Attributes
    ----------
    position
        ``(T + 1, n, 2)``, arena frame [arena unit].
    heading
        ``(T + 1, n)``, direction of the body, arena frame [rad].
    hits
        ``(T + 1, n, 2)`` bool: left and right antenna hit in the step that led to each frame.
    actions
        ``(T, n)`` int8, 0 to 12.
    frames
        ``(n,)``, frames of each episode, the last one included.
    reached
        ``(n,)`` bool: the source was reached; otherwise time ran out.
    pattern, step
        ``(n,)``: the plume's pattern, and its step at the first frame.
    dt
        Time between frames [s].
    """

    position: NDArray[np.float64]
    heading: NDArray[np.float64]
    hits: NDArray[np.bool_]
    actions: NDArray[np.int8]
    frames: NDArray[np.int64]
    reached: NDArray[np.bool_]
    pattern: NDArray[np.int64]
    step: NDArray[np.int64]
    dt: float

    def tracks(self) -> list[NDArray[np.float64]]:
        """Positions of each episode, ``(frames, 2)`` [arena unit]."""
        return [self.position[:n, i] for i, n in enumerate(self.frames)]


def search(
    species: SearchSpecies,
    condition: int,
    *,
    episodes: int,
    seed: int | list[int],
    programme: MothProgramme | None = None,
) -> Searches:
    """Let programmed moths search, each from the start without a demonstration.

    The plume patterns are drawn from ``species.train_plumes``, its phase at random.
    """
    if episodes < 1:
        raise InputError(f"episodes is {episodes}: it must be at least 1")
    scenario = Scenario(
        species=species,
        condition=condition,  # type: ignore[arg-type]
        start="uniform",
        drivers=("action",),
    )
    world = SearchWorld(scenario, episodes)
    generator = np.random.default_rng(seed)
    world.seed(generator.integers(2**63, size=episodes))
    world.reset()
    moths = ProgrammedMoth(episodes, generator, species, programme or MothProgramme())
    pattern, phase = np.array(world.patterns)[world.pattern], world.phase.copy()
    seen = [_look(world)]
    actions: list[NDArray[np.int8]] = []
    frames = np.full(episodes, species.time_limit + 1)
    searching = np.ones(episodes, dtype=bool)
    while searching.any() and len(actions) < species.time_limit:
        chosen = moths.act(world.observation)
        world.step(chosen)
        actions.append(chosen[:, 0].astype(np.int8))
        seen.append(_look(world))
        frames[searching & world.terminated] = len(seen)
        searching &= ~world.terminated
    position, heading, hits = (np.stack(series) for series in zip(*seen, strict=True))
    return Searches(
        position, heading, hits, np.stack(actions), frames, ~searching, pattern, phase, species.dt
    )


def _look(world: SearchWorld) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.bool_]]:
    """Positions, headings and hits of all copies now."""
    heading = np.arctan2(world.heading[:, 1], world.heading[:, 0])
    return world.position[:, 0].copy(), heading, world.odour >= 1.0


def generate(
    seed: int, *, trials: int = TRIALS, programme: MothProgramme | None = None
) -> Demonstrations:
    """``trials`` searches per plume pattern and condition, whole patterns in one split.

    Signals per frame: ``odour_left``, ``odour_right`` (hit or not), ``heading`` [rad, arena frame],
    ``plume`` (pattern), ``plume_step`` (step of the pattern) and ``actions`` (-1 at the last).
    """
    programme = programme or MothProgramme()
    parts: list[tuple[int, str, Searches]] = []  # condition, split, searches
    for condition in range(len(SILKMOTH.conditions)):
        for pattern, split in enumerate(SPLIT_OF_PATTERN):
            species = replace(SILKMOTH, train_plumes=(pattern,))
            one = search(
                species, condition, episodes=trials, seed=[seed, condition, pattern],
                programme=programme,
            )  # fmt: skip
            parts.append((condition, split, one))
    names = ("odour_left", "odour_right", "heading", "plume", "plume_step", "actions")
    signals: dict[str, list[NDArray[np.generic]]] = {name: [] for name in names}
    for _, _, one in parts:
        for i, frames in enumerate(one.frames):
            signals["odour_left"].append(one.hits[:frames, i, 0])
            signals["odour_right"].append(one.hits[:frames, i, 1])
            signals["heading"].append(one.heading[:frames, i])
            signals["plume"].append(np.full(frames, one.pattern[i], dtype=np.int8))
            signals["plume_step"].append((one.step[i] + np.arange(frames)).astype(np.int32))
            acted = np.append(one.actions[: frames - 1, i], np.int8(-1))
            signals["actions"].append(acted[:, None])
    return demonstrations_of(
        SILKMOTH,
        paths=[track[:, None] for _, _, one in parts for track in one.tracks()],
        signals=signals,
        condition=np.repeat([condition for condition, _, _ in parts], trials),
        outcome=np.concatenate([one.reached for _, _, one in parts]).astype(np.int8),
        split=np.repeat([split for _, split, _ in parts], trials),
        recording=np.array(
            [f"synthetic, plume {p}" for _, _, one in parts for p in one.pattern.tolist()]
        ),
        provenance={
            "source": "programmed moths in the modelled plume, made by "
            "python -m tools.packaged_data.moth_searches",
            "licence": "MIT",
            "synthetic": True,
            "seed": seed,
            "trials_per_plume_and_condition": trials,
            "programme": {k: v for k, v in vars(programme).items()},
            "version": animarl_envs.__version__,
        },
        name="programmed moths",
    )


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n", maxsplit=1)[0])
    parser.add_argument("--out", type=Path, default=Path("silkmoth.npz"), help="file to write")
    parser.add_argument("--seed", type=int, default=SEED, help="root of all randomness")
    parser.add_argument(
        "--trials", type=int, default=TRIALS, help="searches per plume pattern and condition"
    )
    given = parser.parse_args()
    demos = generate(given.seed, trials=given.trials)
    demos.save(given.out)
    for condition, name in enumerate(SILKMOTH.conditions):
        part = demos.select(condition=condition)
        print(
            f"{name}: {part.num_episodes} synthetic episodes, "
            f"source reached {(part.outcome == 1).mean():.3f}, "
            f"{(part.lengths - 1).min() * part.dt:.1f} to "
            f"{(part.lengths - 1).max() * part.dt:.1f} s"
        )
    print(f"wrote {given.out} ({given.out.stat().st_size / 1e3:.0f} kB)")


if __name__ == "__main__":
    main()
