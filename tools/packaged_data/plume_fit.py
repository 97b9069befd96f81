"""Fit the plume model to recorded plumes, and compare the two.

``python -m tools.packaged_data.plume_fit DATA_DIR`` prints the comparison of the shipped constants;
with ``--fit`` it fits them anew first and writes ``plume.json``.

The fit minimises the squared difference of summary statistics
(:func:`tools.packaged_data.plume_probe.summarise`), each in units of its sampling error plus a
tolerance, by the cross-entropy method, on every third run. All random draws are seeded.
"""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from animarl_envs.files import write_then_rename
from animarl_envs.worlds.plume import plume
from animarl_envs.worlds.plume.filaments import FilamentModel
from tools.packaged_data.plume_probe import (
    ENOUGH,
    CellMap,
    Probe,
    Summary,
    read_along,
    summarise,
    whiffs_and_blanks,
)

CONSTANTS = Path(plume.__file__).with_name("plume.json")
CLUSTER = 60.0  # frames that count as one independent sample: a visit to a place lasts about 2 s
TOLERANCE = {"map": 0.005, "phase": 0.02, "rate": 0.001}  # differences that do not matter; or 0.01


def distance(recorded: Mapping[str, Summary], model: Mapping[str, Summary]) -> float:
    """Mean over the summaries of the mean squared difference in units of its error."""
    total = 0.0
    for name, (rate, samples) in recorded.items():
        used = samples >= ENOUGH
        error = rate * (1 - rate) * CLUSTER / np.maximum(samples, 1)
        error = error + TOLERANCE.get(name, 0.01) ** 2
        total += float(np.mean((rate - model[name].rate)[used] ** 2 / error[used]))
    return total / len(recorded)


# -- the fit ----------------------------------------------------------------------------------

FITTED = (
    "release_duration", "advection_speed", "speed_spread", "direction_spread", "meander_spread",
    "meander_time", "source_spread", "flatness", "initial_radius", "growth", "threshold",
    "filaments_per_puff", "lag",
)  # fmt: skip
SHORT = 80.0  # period while fitting, for speed [s]
START = dict(
    zip(
        FITTED,
        (0.2, 0.8, 0.2, 0.1, 0.13, 2.0, 0.012, 0.5, 0.008, 2e-4, 0.05, 8.0, 0.03),
        strict=True,
    )
)


def fit(
    probe: Probe, model: FilamentModel, *, seed: int, generations: int = 25, population: int = 24
) -> tuple[FilamentModel, float, float]:
    """The model, its lag [s] and :func:`distance`, by the cross-entropy method on logarithms."""
    rng = np.random.default_rng(seed)
    period, model = model.period, replace(model, period=SHORT)
    target = summarise(probe, probe.hits)
    mean = np.log([START[name] for name in FITTED])
    spread = np.full(len(FITTED), 0.35)
    best: tuple[float, NDArray[np.float64]] = (math.inf, mean)
    for generation in range(generations):
        points = mean + spread * rng.standard_normal((population, len(FITTED)))
        points[0] = best[1]
        scores = []
        for point in points:
            candidate, lag = _model_at(model, point)
            hits = read_along(candidate, probe, lag, np.random.default_rng(seed + generation))
            scores.append(distance(target, summarise(probe, hits)))
        order = np.argsort(scores)
        elite = points[order[: population // 4]]
        mean = 0.3 * mean + 0.7 * elite.mean(axis=0)
        spread = 0.3 * spread + 0.7 * elite.std(axis=0) + 0.01
        best = (scores[order[0]], points[order[0]])
        print(f"generation {generation:2d}: distance {best[0]:.3f}", flush=True)
    candidate, lag = _model_at(model, mean)
    hits = read_along(candidate, probe, lag, np.random.default_rng(seed))
    return replace(candidate, period=period), lag, distance(target, summarise(probe, hits))


def _model_at(model: FilamentModel, point: NDArray[np.float64]) -> tuple[FilamentModel, float]:
    values: dict[str, Any] = dict(zip(FITTED, np.exp(point).tolist(), strict=True))
    values["filaments_per_puff"] = max(1, round(values["filaments_per_puff"]))
    lag = values.pop("lag")
    return replace(model, **values), float(lag)


# -- the comparison ---------------------------------------------------------------------------


def lag() -> float:
    """The shipped lag: from the start of a recorded movie to the release of its first puff [s]."""
    return float(json.loads(CONSTANTS.read_text())["lag"])


def expected_map(
    probe: Probe, cells: CellMap, model: FilamentModel, draws: int, seed: int
) -> CellMap:
    """The model's hits at the recorded poses, over several independent shifts of the patterns."""
    maps = []
    for draw in range(draws):
        hits = read_along(model, probe, lag(), np.random.default_rng([seed, draw]))
        maps.append(cells.of(probe.body, np.asarray(hits.any(axis=1))))
    mean = np.mean([m.hits for m in maps], axis=0)
    return replace(maps[0], hits=mean)


def compare(folder: Path, *, draws: int = 10, seed: int = 0) -> dict[str, Any]:
    """The numbers of the documentation, model against recordings."""
    model, probe, cells = FilamentModel.fitted(), Probe.load(folder), CellMap.recorded(folder)
    recorded = np.asarray(probe.hits.any(axis=1))
    hits = np.asarray(read_along(model, probe, lag(), np.random.default_rng(seed)).any(axis=1))
    odd = probe.run % 2 == 1
    halves = [cells.of(probe.body[part], recorded[part]) for part in (odd, ~odd)]
    one = cells.of(probe.body, hits)
    many = expected_map(probe, cells, model, draws, seed)
    away = np.digitize(np.hypot(probe.body[:, 0], probe.body[:, 1]), DISTANCES)
    lengths = {
        "recorded": whiffs_and_blanks(probe, recorded),
        "model": whiffs_and_blanks(probe, hits),
    }
    return {
        "correlation over cells": cells.correlation(many),
        "correlation, one draw": cells.correlation(one),
        "correlation of recorded halves": halves[0].correlation(halves[1]),
        "hit rate": {
            "recorded": cells.hits.sum() / cells.samples.sum(),
            "model": many.hits.sum() / many.samples.sum(),
        },
        "by distance": [
            (DISTANCES[k - 1], recorded[away == k].mean(), hits[away == k].mean())
            for k in range(1, len(DISTANCES))
        ],
        "whiff lengths": {name: whiffs for name, (whiffs, _) in lengths.items()},
        "blank lengths": {name: blanks for name, (_, blanks) in lengths.items()},
    }


DISTANCES = np.arange(0.05, 0.326, 0.025)  # from the source [m]
PERCENTILES = (10, 25, 50, 75, 90, 99)


def main() -> None:
    """Command line; see the top of this module."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("folder", type=Path, help="folder with the recorded plume contacts")
    parser.add_argument("--fit", action="store_true", help="fit and write plume.json first")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--generations", type=int, default=28)
    given = parser.parse_args()
    if given.fit:
        probe = Probe.load(given.folder)
        third = probe.runs(np.arange(len(probe.movie)) % 3 == 0)
        model, found_lag, score = fit(
            third, FilamentModel.fitted(), seed=given.seed, generations=given.generations
        )
        content = {
            "constants": asdict(model),
            "lag": found_lag,
            "distance": score,
            "seed": given.seed,
        }
        with write_then_rename(CONSTANTS) as path:
            path.write_text(json.dumps(content, indent=1) + "\n")
        FilamentModel.fitted.cache_clear()
    for name, value in compare(given.folder).items():
        print(name)
        if name == "by distance":
            for start, recorded, modelled in value:
                print(f"  from {start:.3f} m: recorded {recorded:.4f}, model {modelled:.4f}")
        elif isinstance(value, dict):
            for kind, numbers in value.items():
                shown = f"{numbers:.4f}" if np.size(numbers) == 1 else _percentiles(numbers)
                print(f"  {kind}: {shown}")
        else:
            print(f"  {value[0]:.3f} over {value[1]} cells")


def _percentiles(lengths: NDArray[np.int64]) -> str:
    shown = ", ".join(f"{v:g}" for v in np.percentile(lengths, PERCENTILES))
    return f"{shown} frames (percentiles {', '.join(map(str, PERCENTILES))})"


if __name__ == "__main__":
    main()
