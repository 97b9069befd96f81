"""Print the table of docs/data/fitting.md: both fits on every recorded set.

    python docs/make_fitting_table.py ../shared/data

A row per individual, and one per set with the root mean square over its individuals. The velocity
RMSE is measured on validation episodes, or on all where a set is a single recording.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.fitting.result import LocomotionFit, fit_locomotion
from animarl_envs.importing.build import demonstrations_from_tracks
from animarl_envs.importing.cutting import Cutting
from animarl_envs.importing.import_recipe import ImportRecipe
from animarl_envs.importing.readers import (
    default_recipe,
    follow,
    get_reader,
    load_readers,
    read,
    read_tracks,
)
from animarl_envs.importing.tracks import merge

load_readers(Path(__file__).parents[1] / "benchmarks" / "paper_readers.py")
DISH = 145.0  # diameter of the termites' dish [mm]
PAIR_RATE = 30.0  # of the fly pair: assumed, its source gives none [Hz]


def agents(data: Path, condition: str) -> Demonstrations:
    return read(data / "agents_collab_hunting" / f"episodes_c2ae_{condition}_slow2.4.npz")


def silkmoths(data: Path) -> Demonstrations:
    files = sorted((data / "silkmoth_mothvr" / "raw").glob("*.csv"))
    return follow(default_recipe(get_reader("mothvr")), files)


def sleap_clip(data: Path) -> Demonstrations:
    path = data / "fly_courtship_sleapclip" / "clip.2node.slp"
    whole = {"piece": float("inf")}
    return read(path, frame_rate=25.0, target="female", cutting=whole)


def termites(data: Path, kind: str) -> Demonstrations:
    path = data / "termite_tandem" / "tracks_30fps_int16.npz"
    scaling = {"shape": "disc", "width": DISH, "boundary": 1.3, "each": True}
    return read(path, kind=kind, scaling=scaling)


def fly_groups(data: Path) -> Demonstrations:
    path = data / "fly_groups12" / "tracks_24fps_int16.npz"
    return read(path, individuals=["fly_1", "fly_2", "fly_3"])


def fly_pair(data: Path) -> Demonstrations:
    parts = [
        replace(
            read_tracks(
                data / "fly_courtship_murthy" / f"X_tracks_{name}.npy", "numpy",
                axes=["xy", "keypoint", "frame"], keypoints=["head", "body"], names=[name],
                fps=PAIR_RATE,
            )[0],
            recording="bout",
        )
        for name in ("male", "female")
    ]  # fmt: skip
    recipe = ImportRecipe(target="female", decision_rate=10.0, cutting=Cutting(piece=float("inf")))
    return demonstrations_from_tracks(merge(parts), recipe, "fly pair")


SETS: dict[str, Callable[[Path], Demonstrations]] = {
    "agents, individual (artificial; 0.25; 2.4, 2.4, 3.0)": lambda data: agents(data, "indiv"),
    "agents, shared (artificial; 0.25; 2.4, 2.4, 3.0)": lambda data: agents(data, "share"),
    "silkmoths": silkmoths,
    "SLEAP clip (fly pair)": sleap_clip,
    "termites, *C. formosanus*": lambda data: termites(data, "Cf"),
    "termites, *R. speratus*": lambda data: termites(data, "Rs"),
    "fly groups (three of twelve)": fly_groups,
    "fly pair (30 Hz assumed)": fly_pair,
}


def both_fits(demos: Demonstrations) -> tuple[LocomotionFit, LocomotionFit]:
    """Onset and joint fit, on the training episodes if there are several recordings."""
    split = "train" if demos.num_episodes > 1 else None
    onset = fit_locomotion(demos, "onset", split=split, bootstrap=0)
    return onset, fit_locomotion(demos, "joint", split=split, bootstrap=0)


def pooled(fit: LocomotionFit) -> float:
    """Root mean square of the velocity RMSE over the individuals."""
    return float(np.sqrt(np.mean([one.velocity_rmse**2 for one in fit.individuals])))


def rows(name: str, demos: Demonstrations) -> Iterator[str]:
    onset, joint = both_fits(demos)
    for first, second in zip(onset.individuals, joint.individuals, strict=True):
        yield (
            f"| {name} | {first.name} | {first.damping:.3f}, {first.thrust:.3g} "
            f"| {first.velocity_rmse:.3g} | {second.damping:.3f}, {second.thrust:.3g} "
            f"| {second.velocity_rmse:.3g} |"
        )
        name = ""
    if len(onset.individuals) > 1:
        yield f"| | **all** | | **{pooled(onset):.3g}** | | **{pooled(joint):.3g}** |"


def main() -> None:
    """Print the table in Markdown."""
    data = Path(sys.argv[1])
    print("| set | individual | onset d, u | onset RMSE | joint d, u | joint RMSE |")
    print("|---|---|---|---|---|---|")
    for name, load in SETS.items():
        for row in rows(name, load(data)):
            print(row, flush=True)


if __name__ == "__main__":
    main()
