"""Recorded contacts with real plumes, and the model read along the same paths.

Recorded are 400 runs of a programmed searcher through five movies of real smoke plumes: positions,
headings and hits of both antennae at 30 Hz (``plume_probe_kpb400.npz``). The model is read along
the same positions and headings, one model pattern per movie, shifted by a whole number of seconds:
the puffs stay in step with the recorded ones, but the patterns are independent of them.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from animarl_envs.compiling import jit
from animarl_envs.errors import InputError
from animarl_envs.files import read_npz
from animarl_envs.species import SILKMOTH
from animarl_envs.worlds.plume.filaments import FilamentModel
from animarl_envs.worlds.plume.plume import NUM_PATTERNS, ModelPlume, is_hit

ENOUGH = 50  # samples that a cell needs to be compared
WHIFF_EDGES = np.array([1, 2, 3, 4, 5, 6, 7, 9, 12, 1000])  # [frames]
BLANK_EDGES = np.array(
    [1, 2, 3, 4, 6, 10, 15, 20, 23, 26, 29, 32, 40, 50, 56, 62, 80, 110, 150, 300, 9000]
)  # [frames]


@dataclass(frozen=True, eq=False)
class Probe:
    """Recorded contacts with real plumes; n samples, frames of 1/30 s, lengths in metres."""

    body: NDArray[np.float64]  # (n, 2)
    antennae: NDArray[np.float64]  # (n, 2, 2): left and right; x, y
    hits: NDArray[np.bool_]  # (n, 2)
    frame: NDArray[np.int64]  # (n,), since the start of the movie
    start: NDArray[np.int64]  # (runs + 1,), first sample of each run
    movie: NDArray[np.int64]  # (runs,), 0 to 4

    @classmethod
    def load(cls, folder: Path) -> Probe:
        path = folder / "plume_probe_kpb400.npz"
        arrays = read_npz(path)
        missing = {"x_q", "y_q", "theta_q", "hit", "n_frames", "movie"} - set(arrays)
        if missing:
            raise InputError(f"{path}: it lacks {sorted(missing)[0]!r}: use the probe file")
        body = np.stack([arrays["x_q"], arrays["y_q"]], axis=-1) / 50_000.0
        heading = arrays["theta_q"] / 1e4
        angle = heading[:, None] + np.deg2rad(SILKMOTH.antenna_angle) * np.array([1.0, -1.0])
        ahead = SILKMOTH.antenna_length * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
        lengths = arrays["n_frames"].astype(np.int64)
        code = arrays["hit"]
        return cls(
            body=body,
            antennae=body[:, None] + ahead,
            hits=np.stack([code & 2, code & 1], axis=-1) > 0,
            frame=np.concatenate([np.arange(n) for n in lengths]),
            start=np.concatenate([[0], np.cumsum(lengths)]),
            movie=arrays["movie"].astype(np.int64) - 1,
        )

    @property
    def run(self) -> NDArray[np.int64]:
        """Run of each sample, ``(n,)``."""
        return np.repeat(np.arange(len(self.movie)), np.diff(self.start))

    def runs(self, chosen: NDArray[np.bool_]) -> Probe:
        """Only some of the runs."""
        keep = np.repeat(chosen, np.diff(self.start))
        lengths = np.diff(self.start)[chosen]
        return Probe(
            self.body[keep], self.antennae[keep], self.hits[keep], self.frame[keep],
            np.concatenate([[0], np.cumsum(lengths)]), self.movie[chosen],
        )  # fmt: skip


# -- the model along the recorded path --------------------------------------------------------


def read_along(
    model: FilamentModel, probe: Probe, lag: float, rng: np.random.Generator
) -> NDArray[np.bool_]:
    """Hits ``(n, 2)`` that the model gives at the probe's antennae.

    The pattern of a run is that of its movie's number, shifted by a random whole number of puffs;
    ``lag`` [s] is the time from the start of a movie to the release of its first puff.
    """
    per_puff = round(model.frame_rate / model.puff_rate)
    shift = per_puff * rng.integers(model.num_puffs, size=len(probe.movie))
    shift -= round(lag * model.frame_rate)
    out = np.zeros(probe.hits.shape, dtype=bool)
    plume = ModelPlume(model)
    for pattern in range(NUM_PATTERNS):
        table = plume.pattern_table(pattern, 1.0 / model.frame_rate, SILKMOTH.antenna_radius)
        chosen = np.flatnonzero(probe.movie == pattern)
        _read_runs(probe.antennae, probe.frame, probe.start, chosen, shift, table, out)
    return out


@jit
def _read_runs(  # type: ignore[no-untyped-def]
    antennae, frame, start, chosen, shift, table, out
):
    for run in chosen:
        for n in range(start[run], start[run + 1]):
            step = (frame[n] + shift[run]) % table.bits.shape[1]
            for side in range(2):
                x, y = antennae[n, side, 0], antennae[n, side, 1]
                out[n, side] = is_hit(table, 0, step, x, y)


# -- summaries --------------------------------------------------------------------------------


class Summary(NamedTuple):
    """Rates of hits, and how many samples they rest on."""

    rate: NDArray[np.float64]
    samples: NDArray[np.float64]


def summarise(probe: Probe, hits: NDArray[np.bool_]) -> dict[str, Summary]:
    """What is compared: map, timing within a puff, both antennae, whiffs, blanks, recurrence."""
    x, y = probe.antennae[..., 0].ravel(), probe.antennae[..., 1].ravel()
    flat = hits.ravel()
    phase = np.repeat(probe.frame % 30, 2)
    distance = np.digitize(x, np.arange(0.025, 0.326, 0.025))
    lateral = np.digitize(y, np.arange(-0.12, 0.121, 0.015))
    near_axis = np.abs(y) < 0.03
    either: NDArray[np.bool_] = np.asarray(hits.any(axis=1))
    both: NDArray[np.bool_] = np.asarray(hits.all(axis=1))
    at = np.digitize(probe.body[:, 0], [0.1, 0.17, 0.24])
    out = {
        "map": _rates(distance * 18 + lateral, flat, 14 * 18),
        "phase": _rates((distance * 30 + phase)[near_axis], flat[near_axis], 14 * 30),
        "rate": _rates(at, either, 4),
        "both": _rates(at[either], both[either], 4),
    }
    for seconds in (1, 2, 5):
        now, later = _pairs(probe, 30 * seconds)
        hit = either[now]
        out[f"again after {seconds} s"] = _rates(at[now][hit], either[later][hit], 4)
    whiffs, blanks = whiffs_and_blanks(probe, either)
    out["whiff"] = _shares(whiffs, WHIFF_EDGES)
    out["blank"] = _shares(blanks, BLANK_EDGES)
    return out


def whiffs_and_blanks(
    probe: Probe, either: NDArray[np.bool_]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Lengths [frames] of hits of either antenna, and of the pauses between hits of a run."""
    whiffs, blanks = [], []
    for first, last in zip(probe.start[:-1], probe.start[1:]):
        edges = np.flatnonzero(np.diff(np.concatenate([[0], either[first:last], [0]]).astype(int)))
        on, off = edges[::2], edges[1::2]
        whiffs.append(off - on)
        blanks.append(on[1:] - off[:-1])
    return np.concatenate(whiffs), np.concatenate(blanks)


def _pairs(probe: Probe, lag: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    run = probe.run
    now = np.flatnonzero(run[:-lag] == run[lag:])
    return now, now + lag


def _rates(bins: NDArray[np.int64], hits: NDArray[np.bool_], size: int) -> Summary:
    count = np.bincount(bins, minlength=size).astype(float)
    total = np.bincount(bins, weights=hits, minlength=size)
    return Summary(total / np.maximum(count, 1), count)


def _shares(lengths: NDArray[np.int64], edges: NDArray[np.int64]) -> Summary:
    count = np.histogram(lengths, edges)[0].astype(float)
    total = max(count.sum(), 1.0)
    return Summary(count / total, np.full(len(count), total))


# -- cells ----------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class CellMap:
    """Samples and hits per 5 mm cell of the body's position, ``(x cells, y cells)``."""

    x_edges: NDArray[np.float64]  # [m]
    y_edges: NDArray[np.float64]
    samples: NDArray[np.float64]
    hits: NDArray[np.float64]

    @classmethod
    def recorded(cls, folder: Path) -> CellMap:
        """All five movies of ``hit_counts_5mm.npz``."""
        path = folder / "hit_counts_5mm.npz"
        arrays = read_npz(path)
        movies = range(1, NUM_PATTERNS + 1)
        missing = {"x_edges", "y_edges", *(f"n_{m}" for m in movies)} - set(arrays)
        if missing:
            raise InputError(f"{path}: it lacks {sorted(missing)[0]!r}: use the hit counts' file")
        return cls(
            arrays["x_edges"] / 1000.0,
            arrays["y_edges"] / 1000.0,
            np.sum([arrays[f"n_{m}"] for m in movies], axis=0).astype(float),
            np.sum([arrays[f"hit_{m}"] for m in movies], axis=0).astype(float),
        )

    def of(self, body: NDArray[np.float64], hits: NDArray[np.bool_]) -> CellMap:
        """The map of other samples ``(n, 2)`` and hits ``(n,)`` on the same cells."""
        edges = [self.x_edges, self.y_edges]
        samples = np.histogram2d(body[:, 0], body[:, 1], bins=edges)[0]
        hit = np.histogram2d(body[hits, 0], body[hits, 1], bins=edges)[0]
        return CellMap(self.x_edges, self.y_edges, samples, hit)

    @property
    def rate(self) -> NDArray[np.float64]:
        """Hit rate, NaN in cells with fewer than ``ENOUGH`` samples."""
        rate = self.hits / np.maximum(self.samples, 1)
        return np.where(self.samples >= ENOUGH, rate, np.nan)

    def correlation(self, other: CellMap) -> tuple[float, int]:
        """Pearson correlation of the rates over cells with enough samples in both; their number."""
        use = np.isfinite(self.rate) & np.isfinite(other.rate)
        return float(np.corrcoef(self.rate[use], other.rate[use])[0, 1]), int(use.sum())
