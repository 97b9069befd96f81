"""Small trained runs on a few packaged chases of both conditions, made in a second or two each."""

from pathlib import Path
from typing import Any

import numpy as np

from animarl_algos.recipes.registry import named_recipe
from animarl_algos.runs import pipeline
from animarl_algos.runs.evaluating import roll_out
from animarl_algos.runs.run import Run
from animarl_algos.runs.run_settings import RunSettings
from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.packaged import load_packaged

QUICK: dict[str, Any] = {
    "offline_epochs": 1,
    "offline_kwargs": {"updates_per_epoch": 3},
    "policy_kwargs": {"hidden": 16, "depth": 1},
}


def few(
    species: str = "agent", train: int = 3, val: int = 2, test: int = 3, *, skip: int = 0
) -> Demonstrations:
    """The shortest packaged episodes of every split, of both conditions, but for a few."""
    demos = load_packaged(species)
    chosen: list[int] = []
    for split, count in (("train", train), ("val", val), ("test", test)):
        for condition in (0, 1):
            found = np.flatnonzero((demos.split == split) & (demos.condition == condition))
            ordered = found[np.argsort(demos.lengths[found], kind="stable")]
            chosen += ordered[skip : skip + count].tolist()
    return demos.select(episodes=chosen)


def made(
    folder: Path,
    algo: str = "dqcil-pt",
    seed: int = 0,
    *,
    demos: Demonstrations | None = None,
    species: str = "agent",
    rolled_out: bool = True,
    baselines: bool = False,
    env_kwargs: dict[str, Any] | None = None,
) -> Run:
    """A run that was fitted, trained a little, and rolled out."""
    quick = QUICK if named_recipe(algo).pretrained else {"policy_kwargs": QUICK["policy_kwargs"]}
    asked = RunSettings(
        file="few.npz", species=species, algo=algo, steps=20, seed=seed, copies=2, repetitions=2,
        thrusts="1", acting="boltzmann:0.5", baselines=baselines,
        overrides=quick | ({} if env_kwargs is None else {"env_kwargs": env_kwargs}),
    )  # fmt: skip
    out = folder / f"{algo}-{seed}"
    command = f"animarl train few.npz --algo {algo} --seed {seed} --out {out}"
    run = pipeline.open_run(asked, out, command, few(species) if demos is None else demos)
    pipeline.fit(run)
    pipeline.learn(run, algo, progress_bar=False)
    if rolled_out:
        roll_out(run)
    return run
