"""The shape of stop-and-go: how long animals pause, how long and how fast they move.

Measured alike on recordings and on generated courtship. An individual moves while it is faster than
``MOVING_SHARE`` of the 99th percentile of all speeds; runs shorter than ``SHORTEST_RUN`` belong to
their neighbours; the first and last run of a track are cut off and not counted. Distributions are
kept as their quantiles at ``LEVELS``.

    python -m tools.packaged_data.courtship fit fly --data DATA_DIR
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from animarl_envs.errors import InputError
from animarl_envs.importing.cleaning import clean, resample, runs, scale_of
from animarl_envs.importing.readers import default_recipe, find_reader, read_tracks

MOVING_SHARE = 0.1  # of the 99th percentile of speed
SHORTEST_RUN = 0.3  # [s]
STEADY_RUN = 1.0  # speeds are taken from runs of this length [s]: shorter ones are all ramp
DECISION_RATE = 10.0  # [Hz]
LEVELS = (0.01, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.99)

RECORDINGS = {
    "fly": "fly_groups12/tracks_24fps_int16.npz",
    "newt": "termite_tandem/tracks_30fps_int16.npz",  # no newts are public; termites stop and go
}
"""Where in the data folder the recordings lie that give each species its shape."""


@dataclass(frozen=True, kw_only=True)
class Shape:
    """Quantiles at ``LEVELS``, and the scale of speed."""

    pause: tuple[float, ...]  # [s]
    move: tuple[float, ...]  # [s]
    speed: tuple[float, ...]  # mean of a steady run, as a share of ``top``
    top: float  # 99th percentile of speed [arena unit / s]
    turning: float  # diffusion of the heading while moving [rad / s^(1/2)]
    source: str

    def __post_init__(self) -> None:
        for name in ("pause", "move", "speed"):
            values = getattr(self, name)
            if len(values) != len(LEVELS) or min(values) <= 0 or list(values) != sorted(values):
                raise InputError(
                    f"quantiles of {name} are {values}: give {len(LEVELS)} positive, growing ones"
                )
        if not (self.top > 0 and self.turning >= 0):
            raise InputError(f"top is {self.top} and turning {self.turning}: they are not negative")


def measure(tracks: Sequence[NDArray[np.float64]], dt: float, source: str) -> Shape:
    """The shape of stop-and-go of tracks, each ``(frames, individuals, 2)`` [arena unit].

    Raises
    ------
    InputError
        If there are no pauses or no steady runs.
    """
    speeds = [np.linalg.norm(np.diff(track, axis=0), axis=2) / dt for track in tracks]
    top = float(np.quantile(np.concatenate([s.ravel() for s in speeds]), 0.99))
    pause, move, steady, turns = [], [], [], []
    for track, speed in zip(tracks, speeds, strict=True):
        for i in range(speed.shape[1]):
            moving = is_moving(speed[:, i], MOVING_SHARE * top, dt)
            pause += [(b - a) * dt for a, b in runs(~moving) if a > 0 and b < len(moving)]
            for a, b in runs(moving):
                if a > 0 and b < len(moving):
                    move.append((b - a) * dt)
                if (b - a) * dt >= STEADY_RUN:
                    steady.append(speed[a:b, i].mean() / top)
                    step = np.diff(track[a : b + 1, i], axis=0)
                    turns.append(_turns(step, dt))
    if not pause or not move or not steady:
        raise InputError(f"{source}: the tracks hold no pause or no steady run: give longer ones")
    turned = np.concatenate(turns)
    levels = {
        name: tuple(np.quantile(values, LEVELS).round(3).tolist())
        for name, values in (("pause", pause), ("move", move), ("speed", steady))
    }
    # The middle half of a normal distribution spans 1.349 deviations; the tails are jumps.
    spread = np.subtract(*np.quantile(turned, [0.75, 0.25])) / 1.349
    return Shape(**levels, top=round(top, 4), turning=round(float(spread), 3), source=source)


def is_moving(speed: NDArray[np.float64], threshold: float, dt: float) -> NDArray[np.bool_]:
    """Where an individual moves, ``(steps,)``; short moves, then short pauses, are filled in."""
    moving, shortest = speed > threshold, round(SHORTEST_RUN / dt)
    for state in (True, False):
        for a, b in runs(moving == state):
            if b - a < shortest:
                moving[a:b] = not state
    return moving


def _turns(step: NDArray[np.float64], dt: float) -> NDArray[np.float64]:
    """Change of heading over one second of a run [rad]."""
    heading = np.unwrap(np.arctan2(step[:, 1], step[:, 0]))
    lag = round(1.0 / dt)
    return np.asarray(heading[lag:] - heading[:-lag])


def recorded_tracks(species: str, data: Path) -> list[NDArray[np.float64]]:
    """The recordings that a species' shape comes from, smoothed at 2 Hz, at 10 Hz, scaled."""
    path = data / RECORDINGS[species]
    recipe = default_recipe(find_reader(path))
    found = []
    for tracks in read_tracks(path):
        cleaned, _ = clean(tracks, recipe.cleaning)
        assert cleaned.frame_rate is not None
        bodies = scale_of([cleaned], recipe.scaling).to_arena(cleaned.bodies)
        found.append(resample(bodies, cleaned.frame_rate, DECISION_RATE))
    return found


def fit(species: str, data: Path) -> Shape:
    """The shape of a species' recordings; what ``SHAPES`` holds."""
    if species not in RECORDINGS:
        raise InputError(f"species {species!r} is unknown: choose {' or '.join(RECORDINGS)}")
    return measure(recorded_tracks(species, data), 1.0 / DECISION_RATE, RECORDINGS[species])
