"""The numbers of the programmed moth, fitted to recorded moths and to published figures.

    python -m tools.packaged_data.moth_fit DATA_DIR --generations 80 --seed 0

Evolution of the logarithms of the numbers, within bounds that keep each what it is called. Every
term of the loss is a squared difference in units of its tolerance, so that each aim counts alike.
The aims contradict each other: with the published success and the published total duration, moths
that succeed take 68 s on average, where recorded ones take 124 s. The fit lies between.
"""

from __future__ import annotations

import argparse
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from animarl_envs.species import SILKMOTH
from animarl_envs.worlds.search.programmed_moth import MothProgramme
from tools.packaged_data.moth_published import PUBLISHED
from tools.packaged_data.moth_statistics import (
    QUARTILES,
    SPEED_QUANTILES,
    TURNING_QUANTILES,
    SearchStatistics,
    recorded_statistics,
    search_statistics,
)

EVERY_PLUME = replace(SILKMOTH, train_plumes=(*SILKMOTH.train_plumes, *SILKMOTH.test_plumes))
EPISODES = 100  # per candidate and condition
CANDIDATES, PARENTS = 16, 5
LEAST_STEP, MEMORY = 0.05, 0.85  # of the evolution's step sizes

BOUNDS = {  # units as in MothProgramme
    "surge": (0.5, 2.0), "turn 1": (0.5, 2.0), "turn 2": (1.0, 4.0), "turn 3": (1.5, 6.0),
    "yaw_rate": (0.6, 2.0), "surge_speed": (0.006, 0.036), "turn_speed": (0.004, 0.02),
    "careful": (0.4, 1.0), "odour_turn": (0.1, 1.2), "wind_turn": (0.02, 0.8),
    "motor_noise": (0.05, 0.8), "slip": (0.001, 0.012), "pace_spread": (0.1, 0.5),
    "pause_rate": (0.01, 0.5), "pause": (0.5, 4.0),
}  # fmt: skip
LOW, HIGH = np.log(np.array(list(BOUNDS.values()))).T

FULL_RATE = (0.975, 0.025)  # between 30 of 30 published and 22 of 24 recorded; tolerance
REDUCED_TOLERANCE = 0.05
MEAN_DURATION_TOLERANCE = 15.0  # [s]
RATIO_TOLERANCE = 0.25  # of durations and paths: logarithm of the ratio
SPEED_TOLERANCE = 0.001  # [m / s]
RESTING_TOLERANCE = 0.02
TURNING_TOLERANCE = 0.3  # [rad / s]


def programme_of(point: NDArray[np.float64]) -> MothProgramme:
    """The programme at the logarithms of the numbers in the order of ``BOUNDS``, rounded."""
    numbers = {
        name: float(f"{value:.3g}") for name, value in zip(BOUNDS, np.exp(point), strict=True)
    }
    turns = tuple(numbers.pop(f"turn {i}") for i in (1, 2, 3))
    return MothProgramme(turns=turns, **numbers)


def start_point() -> NDArray[np.float64]:
    """The middle of the bounds."""
    return np.asarray((LOW + HIGH) / 2)


def losses(programme: MothProgramme, recorded: SearchStatistics, seed: int) -> dict[str, float]:
    """Each aim's squared distance, in units of its tolerance."""
    full, reduced = (
        search_statistics(EVERY_PLUME, c, episodes=EPISODES, seed=[seed, c], programme=programme)
        for c in (0, 1)
    )
    durations = np.concatenate([full.duration, reduced.duration])
    shortest = np.quantile(durations, 1 / PUBLISHED.episodes)
    difference = reduced.path.mean() - full.path.mean()
    low, high = PUBLISHED.path_difference
    off = {
        "reached, full": min(0.0, (full.rate - FULL_RATE[0]) / FULL_RATE[1]),
        "reached, reduced": (reduced.rate - PUBLISHED.reached_reduced) / REDUCED_TOLERANCE,
        "mean duration": (durations.mean() - PUBLISHED.mean_duration) / MEAN_DURATION_TOLERANCE,
        "shortest": np.log(shortest / PUBLISHED.shortest) / (2 * RATIO_TOLERANCE),
        "path, reduced - full": (difference - (low + high) / 2) / ((high - low) / 4),
        "durations": _ratio(full.duration[full.reached], recorded.duration[recorded.reached]),
        "paths": _ratio(full.path[full.reached], recorded.path[recorded.reached]),
        "speed": _quantile_difference(full.speed, recorded.speed, SPEED_QUANTILES)
        / SPEED_TOLERANCE,
        "resting": (full.resting - recorded.resting) / RESTING_TOLERANCE,
        "turning": _quantile_difference(full.turning, recorded.turning, TURNING_QUANTILES)
        / TURNING_TOLERANCE,
    }  # fmt: skip
    return {name: float(np.mean(np.square(value))) for name, value in off.items()}


def _ratio(one: NDArray[np.float64], other: NDArray[np.float64]) -> NDArray[np.float64]:
    if len(one) == 0:
        return np.full(len(QUARTILES), 10.0)
    ratio = np.quantile(one, QUARTILES) / np.quantile(other, QUARTILES)
    return np.asarray(np.log(ratio) / RATIO_TOLERANCE)


def _quantile_difference(
    one: NDArray[np.float64], other: NDArray[np.float64], shares: tuple[float, ...]
) -> NDArray[np.float64]:
    return np.asarray(np.quantile(one, shares) - np.quantile(other, shares))


def fit(recorded: SearchStatistics, generations: int, seed: int) -> MothProgramme:
    """Evolve: the weighted mean of the best candidates is the next generation's middle."""
    rng = np.random.default_rng(seed)
    middle = start_point()
    step = (HIGH - LOW) / 5
    weight = np.log(PARENTS + 0.5) - np.log(np.arange(1, PARENTS + 1))
    weight /= weight.sum()
    for generation in range(generations):
        drawn = middle + step * rng.standard_normal((CANDIDATES, len(middle)))
        drawn = np.clip(drawn, LOW, HIGH)
        # The same searches for all of a generation, others for the next.
        loss = [
            sum(losses(programme_of(point), recorded, seed * 100_000 + generation).values())
            for point in drawn
        ]
        best = drawn[np.argsort(loss)[:PARENTS]]
        spread = np.sqrt(weight @ (best - middle) ** 2)
        step = np.maximum(MEMORY * step + (1 - MEMORY) * spread, LEAST_STEP)
        middle = weight @ best
        print(f"generation {generation + 1}: losses {min(loss):.1f} to {max(loss):.1f}", flush=True)
    return programme_of(middle)


def main() -> None:
    """Command line; see the top of this module."""
    parser = argparse.ArgumentParser(description="Fit the numbers of the programmed moth.")
    parser.add_argument("folder", type=Path, help="folder of recorded moths")
    parser.add_argument("--generations", type=int, default=80)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    recorded = recorded_statistics(given.folder)
    found = fit(recorded, given.generations, given.seed)
    for name in fields(found):
        print(f"{name.name} = {getattr(found, name.name)}")
    for who, programme in (("found", found), ("shipped", MothProgramme())):
        terms = losses(programme, recorded, given.seed + 1)
        print(f"{who}: {sum(terms.values()):.1f} =", end=" ")
        print(" + ".join(f"{value:.2f} ({name})" for name, value in terms.items()))


if __name__ == "__main__":
    main()
