"""How well the fitted turning foretells the headings of recorded moths.

    python -m tools.packaged_data.moth_turning DATA_DIR

prints the table of ``docs/plume.md``: six-fold cross-validation over the runs, against a heading
that is held and one along the direction of travel; then how often an antenna is hit, in a step and
in a frame; then the fit to all runs, which is ``RECORDED_TURNING`` of
:mod:`animarl_envs.species.silkmoth`. ``DATA_DIR`` holds ``raw/case*.csv``.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.drawing import markdown_table
from animarl_envs.errors import InputError
from animarl_envs.fitting.turning import (
    along_travel,
    fit_turning,
    free_running,
    heading_misses,
)
from animarl_envs.importing.readers.living import FRAME_RATE, read_mothvr
from animarl_envs.species.turning import Turning
from tools.packaged_data.moth_statistics import recorded_moths

FOLDS = 6
HITS = ("odour_left", "odour_right")
HELD = Turning(persistence=0.0, gain=1e-9, slip=0.0, speed=1.0)  # hardly turns at all


def held_out_errors(demos: Demonstrations) -> dict[str, NDArray[np.float64]]:
    """Errors of three rules, each figure the mean over folds of runs that the fit has not seen.

    Medians of the absolute difference after one step and running free [rad], and the share of steps
    whose wind sector (90 deg about front, left, back and right) is that of the recorded heading.
    """
    dealt = np.random.default_rng(0).permutation(len(demos)) % FOLDS
    found: dict[str, list[NDArray[np.float64]]] = {}
    for fold in range(FOLDS):
        parts = replace(demos, split=np.where(dealt == fold, "test", "train"))
        seen, unseen = parts.select(split="train"), parts.select(split="test")
        turning = fit_turning(seen)
        if turning is None:
            raise InputError(f"{demos.name}: its bodies point where they walk: nothing is fitted")
        rules: dict[str, Turning | NDArray[np.float64]]
        rules = {"held": HELD, "along travel": along_travel(unseen), "fitted turning": turning}
        for name, rule in rules.items():
            found.setdefault(name, []).append(_errors(unseen, rule))
    return {name: np.mean(errors, axis=0) for name, errors in found.items()}


def hit_shares(folder: Path) -> tuple[float, float]:
    """Share of hits of an antenna, over decision steps and over frames at decision times."""
    demos = recorded_moths(folder)
    steps = np.mean([demos.signals[name] for name in HITS])
    every = round(FRAME_RATE * demos.dt)
    frames = [
        tracks.signals[name][every::every]
        for path in sorted((folder / "raw").glob("*.csv"))
        for tracks in read_mothvr(path)
        for name in HITS
    ]
    return float(steps), float(np.concatenate(frames).mean())


def _errors(demos: Demonstrations, rule: Turning | NDArray[np.float64]) -> NDArray[np.float64]:
    free = free_running(demos, rule) if isinstance(rule, Turning) else rule
    later = np.setdiff1d(np.arange(len(free)), demos.offsets[:-1])
    recorded = demos.headings()
    assert recorded is not None
    right = _sector(free[later]) == _sector(recorded[later, 0])
    return np.array([*np.median(heading_misses(demos, rule), axis=1), right.mean()])


def _sector(heading: NDArray[np.float64]) -> NDArray[np.float64]:
    """Quarter of the circle about front, left, back and right of upwind, 0 to 3."""
    return np.asarray(np.floor((heading - np.pi) / (0.5 * np.pi) + 0.5) % 4)


def main() -> None:
    """Command line; see the top of this module."""
    parser = argparse.ArgumentParser(description="Fitted turning of recorded moths.")
    parser.add_argument("folder", type=Path, help="folder of recorded moths")
    folder = parser.parse_args().folder
    demos = recorded_moths(folder)
    rows = [
        (name, *(f"{error:.2f}" for error in errors))
        for name, errors in held_out_errors(demos).items()
    ]
    head = ("heading", "one step [rad]", "free running [rad]", "wind sector right")
    print(markdown_table(head, rows))
    print("\nhits of an antenna: {:.3f} of all steps, {:.3f} of frames".format(*hit_shares(folder)))
    print(f"fitted to all {len(demos)} runs: {fit_turning(demos)}")


if __name__ == "__main__":
    main()
