"""Well-formed tables whose meaning is known: read rightly, refused in a sentence, or read wrongly.

Other targets damage the bytes of a file. Here the file is whole, as some program or person could
have written it, and the question is whether clock, units, decimal marks, pairs of columns, arenas
and marks of lost animals are understood. ``python -m tools.fuzz --meanings`` counts.
"""

from __future__ import annotations

import itertools
import tempfile
import warnings
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from animarl_envs.errors import InputError
from animarl_envs.importing.lost_animals import mark_lost
from animarl_envs.importing.readers import read_tracks
from animarl_envs.importing.tracks import Tracks, trim

Floats = NDArray[np.float64]
NAMES = ("anna", "bert", "carl", "dora")
RATES = (10.0, 12.5, 25.0, 29.97, 30.0, 60.0, 100.0)
TIME_UNITS = {"s": 1.0, "ms": 1e-3, "min": 60.0}
TIME_HEADS = {
    "s": ("time (s)", "time_s", "t [s]"),
    "ms": ("time (ms)", "time_ms"),
    "min": ("time (min)",),
}
UNITS = ("px", "mm", "cm")
LOST = ((-1.0, -1.0), (0.0, 0.0), (9999.0, 9999.0))
EXTRAS = ("likelihood", "velocity", "area", "sd")
TOLERANCE = 0.006  # positions are written with two decimals
LEFT_OUT = "that number is left out"  # as an import says of a last number that may be cut off


@dataclass(frozen=True)
class Meaning:
    """A table and what it says: per recording the animals' positions, and the frame rate [Hz]."""

    text: str
    recordings: tuple[dict[str, Floats], ...]
    rate: float | None
    features: tuple[str, ...]


def draw_meaning(rng: np.random.Generator) -> Meaning:
    """Return a table drawn at random, with its true meaning."""

    def pick(options: Sequence[Any]) -> Any:
        return options[int(rng.integers(len(options)))]

    layout, clock = pick(("long", "wide", "box")), pick(("frames", "time", "both", "bare time"))
    separator, decimal = pick(((",", "."), (";", "."), (";", ","), ("\t", "."), ("\t", ",")))
    count, frames = int(rng.integers(1, 4)), int(rng.integers(40, 90))
    arenas = 2 if layout == "long" and rng.random() < 0.25 else 1
    lost, first = pick((None, None, "empty", "absent", *LOST)), pick((0, 1, 1000))
    if layout != "long" and lost == "absent":
        lost = "empty"
    unit, rate, time_unit = pick((None, *UNITS)), pick(RATES), pick(tuple(TIME_UNITS))
    extra = pick((None, None, *EXTRAS)) if layout == "long" else None
    recordings = tuple(_walks(rng, count, frames, lost is not None) for _ in range(arenas))
    heads, columns = _clock_columns(clock, time_unit, first, frames, rate, rng)
    place = "" if unit is None else f" ({unit})"
    if layout == "long":
        head, rows = _long_rows(recordings, heads, columns, place, lost, extra, rng)
    else:
        head, rows = _wide_rows(recordings[0], heads, columns, place, lost, layout == "box", rng)
    lines = [separator.join(head)]
    lines += [separator.join(cell.replace(".", decimal) for cell in row) for row in rows]
    text = pick(("\n", "\r\n")).join(lines) + pick(("\n", ""))
    known = clock != "frames"
    drawn = (layout, clock, time_unit * known, separator, decimal, lost, unit, extra, arenas, count)
    features = tuple(map(str, drawn))
    return Meaning(text, recordings, rate if known else None, features)


def _walks(rng: np.random.Generator, count: int, frames: int, with_gap: bool) -> dict[str, Floats]:
    """Return smooth walks of so many animals ``(frames, 2)``; the last one may have a gap."""
    walks = {}
    for name in NAMES[:count]:
        course = rng.uniform(0, 2 * np.pi) + np.cumsum(rng.normal(0, 0.2, frames))
        speed = rng.uniform(1.5, 3.0) * rng.uniform(0.6, 1.4, frames)
        steps = speed[:, None] * np.stack([np.cos(course), np.sin(course)], axis=1)
        walks[name] = np.round(rng.uniform(150, 350, 2) + np.cumsum(steps, axis=0), 2)
    if with_gap:
        start = int(rng.integers(5, frames // 2))
        walks[name][start : start + int(rng.integers(3, 15))] = np.nan
    return walks


def _clock_columns(
    clock: str, unit: str, first: int, frames: int, rate: float, rng: np.random.Generator
) -> tuple[list[str], list[list[str]]]:
    """Return heads and cells of the columns of frames and times."""
    numbers = np.arange(first, first + frames)
    seconds = numbers / rate / TIME_UNITS[unit]
    digits = {"s": 4, "ms": 1, "min": 7}[unit]
    times = [f"{value:.{digits}f}" for value in seconds]
    head = TIME_HEADS[unit][int(rng.integers(len(TIME_HEADS[unit])))]
    frame_column = [str(n) for n in numbers]
    if clock == "frames":
        return ["frame"], [frame_column]
    if clock == "both":
        return ["frame", head], [frame_column, times]
    return [head if clock == "time" else "time"], [times]


def _long_rows(
    recordings: Sequence[dict[str, Floats]],
    heads: list[str],
    columns: list[list[str]],
    place: str,
    lost: Any,
    extra: str | None,
    rng: np.random.Generator,
) -> tuple[list[str], list[list[str]]]:
    several = len(recordings) > 1
    more = {None: [], "velocity": ["vx", "vy"], "sd": ["x_sd", "y_sd"]}.get(extra, [extra])
    head = [*heads, *["arena"] * several, "id", f"x{place}", f"y{place}", *map(str, more)]
    rows = []
    for number, animals in enumerate(recordings):
        for t in range(len(columns[0])):
            for name, walk in animals.items():
                gone = bool(np.isnan(walk[t]).any())
                if gone and lost == "absent":
                    continue
                own = [f"{rng.uniform(0.7, 1):.3f}" for _ in more]
                arena = [f"dish{number + 1}"] * several
                rows.append([*[c[t] for c in columns], *arena, name, *_cells(walk[t], lost), *own])
    return head, rows


def _wide_rows(
    animals: dict[str, Floats],
    heads: list[str],
    columns: list[list[str]],
    place: str,
    lost: Any,
    box: bool,
    rng: np.random.Generator,
) -> tuple[list[str], list[list[str]]]:
    if box:  # of the first animal alone; the others go
        for name in list(animals)[1:]:
            del animals[name]
        corners = (("x1", "y1", "x2", "y2"), ("xmin", "ymin", "xmax", "ymax"))[rng.integers(2)]
        head, half = [*heads, *corners], np.array([6.0, 4.0])
        (walk,) = animals.values()
        return head, [
            [*[c[t] for c in columns], *_cells(p - half, lost), *_cells(p + half, lost)]
            for t, p in enumerate(walk)
        ]
    style = ("x_{}", "{}_x", "{} x", "{}.x")[rng.integers(4)]
    names = [style.format(name) for name in animals]
    pairs = [(f"{x}{place}", f"{_y_of(x)}{place}") for x in names]
    head = [*heads, *[name for pair in pairs for name in pair]]
    return head, [
        [
            *[c[t] for c in columns],
            *[cell for walk in animals.values() for cell in _cells(walk[t], lost)],
        ]
        for t in range(len(columns[0]))
    ]


def _y_of(name: str) -> str:
    return name.replace("x", "y") if name.startswith("x_") else f"{name[:-1]}y"


def _cells(point: Floats, lost: Any) -> list[str]:
    if np.isnan(point).any():
        return ["", ""] if isinstance(lost, str) else [f"{value:.2f}" for value in lost]
    return [f"{value:.2f}" for value in point]


def judge(path: Path, meaning: Meaning) -> tuple[str, str]:
    """Return ``right``, ``refused`` or ``wrong``, and what was said or what differs."""
    path.write_text(meaning.text, newline="")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            found = [trim(tracks) for tracks in mark_lost(read_tracks(path))[0]]
    except InputError as error:
        return "refused", str(error)
    differs = _difference(found, meaning)
    return ("wrong", differs) if differs else ("right", "")


def _difference(found: Sequence[Tracks], meaning: Meaning) -> str:
    """Return what differs from the true meaning, or nothing."""
    if len(found) != len(meaning.recordings):
        return f"{len(found)} recordings, not {len(meaning.recordings)}"
    for tracks, animals in zip(found, meaning.recordings, strict=True):
        if len(tracks.individuals) != len(animals):
            return f"animals {', '.join(tracks.individuals)}, not {', '.join(animals)}"
        rate = tracks.frame_rate
        if (rate is None) != (meaning.rate is None):
            return f"{rate} Hz, not {meaning.rate}"
        if rate is not None and meaning.rate and abs(rate / meaning.rate - 1) > 2e-3:
            return f"{rate} Hz, not {meaning.rate}"
        is_cut = any(LEFT_OUT in note for note in tracks.provenance.get("notes", ()))
        compared = slice(-1 if is_cut else None)
        for name, walk in animals.items():
            bodies = [tracks.positions[:, i].mean(axis=1) for i in range(len(animals))]
            several = len(found) > 1  # arenas side by side are moved to their own middle
            if not any(_same(body[compared], walk[compared], several) for body in bodies):
                return f"positions of {name}"
    return ""


def _same(body: Floats, walk: Floats, moved: bool) -> bool:
    if body.shape != walk.shape:
        return False
    shift = np.nanmedian(body - walk, axis=0) if moved else 0.0
    return np.allclose(body - shift, walk, atol=TOLERANCE, equal_nan=True)


def judge_all(numbers: Sequence[int], seed: int) -> list[tuple[int, str, str]]:
    """Judge tables by number; return number, outcome and what was said or what differs."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "table.csv"
        return [
            (number, *judge(path, draw_meaning(np.random.default_rng([seed, number]))))
            for number in numbers
        ]


def count_meanings(
    number: int, workers: int, seed: int, shown: int = 5
) -> tuple[Counter[str], list[str]]:
    """Judge so many tables; return counts, and lines of the first wrong and the usual refusals."""
    chunks = [range(start, number, 8 * workers) for start in range(min(8 * workers, number))]
    with ProcessPoolExecutor(workers) as pool:
        judged = sorted(itertools.chain(*pool.map(judge_all, chunks, itertools.repeat(seed))))
    wrong = [(index, why) for index, outcome, why in judged if outcome == "wrong"]
    refused = Counter(
        " ".join(why.partition("table.csv")[2].split()[1:9])
        for _, outcome, why in judged
        if outcome == "refused"
    )
    lines = []
    for index, why in wrong[:shown]:
        features = draw_meaning(np.random.default_rng([seed, index])).features
        lines.append(f"table {index} ({' | '.join(features)}): {why}")
    lines += [f"refused {n} times: {reason} ..." for reason, n in refused.most_common(shown)]
    return Counter(outcome for _, outcome, _ in judged), lines
