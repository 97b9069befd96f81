"""Rows of a table to tracks: where each cell belongs, once it is known which column is which."""

import itertools
import math
import re
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from animarl_envs.demos.episode import HEADING
from animarl_envs.errors import InputError, require
from animarl_envs.files import EXPANSION, allowed_bytes
from animarl_envs.importing import tables
from animarl_envs.importing.clock import (
    IN_SECONDS,
    LARGEST_FRAME,
    even_rows,
    fit_clock,
    irregular_rate,
    refuse_times_going_back,
    seconds,
)
from animarl_envs.importing.table_columns import (
    DEGREES,
    Columns,
    Position,
    corners_of,
    is_body_part,
    is_idtracker,
    parsed_names,
    split_names,
)
from animarl_envs.importing.tracks import (
    CENTROID,
    LONE,
    RATE_FROM,
    TOGETHER_AT_MOST,
    TRACKS,
    Tracks,
)

Floats = NDArray[np.float64]
Whole = NDArray[np.int64]

SPARSE, SMALL = 100, 2**20  # cells of frame and individual: so many a row, and in all
EARTH = 6_371_008.8  # [m], its mean radius
ORDERED = 0.99  # share of rows in which corners of a box are left of and above the others
STEADY = 0.5  # spread of the size of a box, of that of its centre; of two animals it is more


@dataclass(eq=False)
class _Rows:
    """Rows of a table: their numbers by column, and the recording, individual and keypoint of each.

    ``line`` is the row of the table that each is of. Without ``names`` of individuals or of
    ``points`` the header has them. ``time`` is the column of the clock, where it counts.
    """

    number: dict[str, Floats]
    line: Whole
    recordings: list[str]
    recording: Whole
    names: list[str]
    individual: Whole
    points: list[str]
    point: Whole
    time: Floats | tables.Words | None

    @property
    def track(self) -> Whole:
        """A number for each recording, individual and keypoint."""
        body = self.recording * max(len(self.names), 1) + self.individual
        return body * max(len(self.points), 1) + self.point

    def interpolate(self, low: Whole, high: Whole, share: Floats) -> None:
        """Replace the rows by others between rows ``low`` and ``high`` of the same track."""
        self.number = {
            key: own[low] + share * (own[high] - own[low]) for key, own in self.number.items()
        }
        for name in ("line", "recording", "individual", "point"):
            setattr(self, name, getattr(self, name)[low])


def tracks_of_rows(
    table: tables.Table,
    found: Columns,
    fps: float | None,
    y_down: bool,
    progress: tables.Progress,
    heading: str | None = None,
    stated: bool = False,
) -> list[Tracks]:
    """Return the tracks of each recording.

    Individuals and keypoints are named by columns of the rows, or by positions of the header;
    ``stated`` says that an option names them.
    """
    provenance: dict[str, Any] = {"file": table.path.name, "read_as": table.description}
    rows, found = _read_rows(table, found, fps, progress, heading, stated, provenance)
    fps, frames, start = _frames_of(table, found, rows, fps, heading, provenance)
    if rows.names and _is_sparse(frames, rows.recording, len(rows.names)):
        start = _split_tracks(rows, frames, start, provenance)
    tracks = []
    for at in range(len(rows.recordings)):
        own = np.flatnonzero(rows.recording == at)
        record = _place_rows(table, found, rows, own, frames[own], heading)
        tracks.append(
            Tracks(
                recording=rows.recordings[at],
                frame_rate=fps,
                unit=found.unit or "px",
                y_down=y_down,
                start_time=float(start[at]),
                provenance=provenance,
                **record,
            )
        )
    return _centre_arenas(tracks) if found.arena else tracks


def _read_rows(
    table: tables.Table,
    found: Columns,
    fps: float | None,
    progress: tables.Progress,
    heading: str | None,
    stated: bool,
    provenance: dict[str, Any],
) -> tuple[_Rows, Columns]:
    """Return the rows, and the columns as their numbers show them: boxes, metres.

    What is not used, and what an import says, goes to ``provenance``.
    """
    clock = "" if found.frame and fps else found.time or ""
    numbers = [*itertools.chain(*(one.columns for one in found.positions)), heading, found.frame]
    numbers += [position.score or found.confidence for position in found.positions]
    slots = list(found.tracks.values())
    texts = [found.individual, found.keypoint, found.recording, found.arena, *slots]
    (texts if clock in table.words_in else numbers).append(clock)
    used = {*numbers, *texts, found.time}
    if unused := [name for name in table.names if name and name not in used]:
        provenance["columns_not_used"] = unused
    number, word = table.columns(
        [*filter(None, numbers)], [*filter(None, texts)], progress, may_be_empty=slots
    )
    notes = table.notes
    line = np.arange(len(next(iter(number.values()))))
    if slots:
        number, word, found, line = _stack_slots(number, word, found)
    if found.unit == DEGREES:
        notes.append(_project(table.path, number, found))
        found = replace(found, unit="m")
    if not stated:
        found = _with_boxes(table, found, number)
    zeros = np.zeros(len(line), dtype=np.int64)
    sets = _recordings_of(table.path, found, word, zeros)
    bodies = _bodies_of(table.path, found, word, zeros, stated)
    time = word.get(clock, number.get(clock))
    rows = _Rows(number, line, sets.entries, sets.number, *bodies, time)
    notes += _notes_on(found, rows.points)
    if is_idtracker(table):
        notes.append("the columns are idTracker's: y is taken to grow downwards")
    if notes:
        provenance["notes"] = notes
    return rows, found


def _frames_of(
    table: tables.Table,
    found: Columns,
    rows: _Rows,
    fps: float | None,
    heading: str | None,
    provenance: dict[str, Any],
) -> tuple[float | None, Whole, Floats]:
    """Return the rate [Hz], the frame of each row and the time of frame 0 of each recording.

    Rows of an irregular clock are resampled.
    """
    path = table.path
    frames = np.zeros(len(rows.line), dtype=np.int64)
    if found.frame is not None:
        frames = frame_numbers(table, found.frame, rows.number[found.frame])
    elif rows.time is None:
        for at in range(len(rows.recordings)):
            own = rows.recording == at
            frames[own] = np.arange(np.count_nonzero(own))
    if rows.time is None:
        return fps, frames, np.zeros(len(rows.recordings))
    assert found.time is not None
    is_text = isinstance(rows.time, tables.Words)
    unit = found.time_unit or parsed_names([found.time], table.units)[0].unit
    when = seconds(path, found.time, rows.time, unit or None)
    unsaid = None if unit or is_text else found.time
    written = 1.0 if is_text else IN_SECONDS[unit or "s"]
    provenance[RATE_FROM] = (
        f"the column {found.time} ({'times of day' if is_text else unit or 's'})"
    )
    if found.frame is None:
        refuse_times_going_back(path, when, rows.track, table.place)
        if fps is None and (fps := irregular_rate(path, when, rows.track, written)) is not None:
            require(
                heading is None,
                f"{path}: its clock is irregular, and headings are not resampled: give rows at "
                "even times",
            )
            low, high, share, when = even_rows(when, rows.track, fps)
            rows.interpolate(low, high, share)
            provenance["read_as"] += f", irregular clock resampled to {fps:g} Hz"
            provenance[RATE_FROM] += ", irregular and resampled"
    numbered = None if found.frame is None else frames
    clock = fit_clock(path, when, rows.recording, table.place, numbered, fps, unsaid, written)
    return clock.rate, clock.frames, clock.first


def _split_tracks(rows: _Rows, frames: Whole, start: Floats, provenance: dict[str, Any]) -> Floats:
    """Make each individual of each recording a recording; return the times of their frame 0."""
    together = np.unique(frames * len(rows.recordings) + rows.recording, return_counts=True)[1]
    count = len(rows.names)
    kept, recording = np.unique(rows.recording * count + rows.individual, return_inverse=True)
    provenance |= {TRACKS: len(kept), TOGETHER_AT_MOST: int(together.max())}
    rows.recordings = [f"{rows.recordings[k // count]}/{rows.names[k % count]}" for k in kept]
    rows.recording, rows.individual = recording.astype(np.int64), np.zeros_like(rows.individual)
    rows.names = []
    return np.asarray(start[kept // count])


def _place_rows(
    table: tables.Table,
    found: Columns,
    rows: _Rows,
    own: Whole,
    frames: Whole,
    heading: str | None,
) -> dict[str, Any]:
    """Return names and arrays of one recording, of its ``own`` rows and the ``frames`` of these."""
    recording = rows.recordings[int(rows.recording[own[0]])]
    individuals = list(dict.fromkeys(one.individual or LONE for one in found.positions))
    place = np.zeros(1, dtype=np.int64)
    if rows.names:
        individuals, place = _in_natural_order(rows.names, rows.individual[own])
    parts = rows.points or list(dict.fromkeys(one.keypoint for one in found.positions))
    first = int(frames.min())
    shape = (int(frames.max()) + 1 - first, len(individuals), len(parts))
    _check_extent(table, recording, shape, frames, rows.line[own])
    body = (frames - first) * len(individuals) + place[rows.individual[own]]
    labels = [f"{a} {part}" if len(parts) > 1 else a for a in individuals for part in parts]
    refuse_two_rows(
        table, recording, body * len(parts) + rows.point[own], labels, rows.line[own], first
    )
    positions, confidence = np.full((*shape, 2), np.nan), np.full(shape, np.nan)
    scores = [position.score or found.confidence for position in found.positions]
    for position, score in zip(found.positions, scores, strict=True):
        further = 0 if rows.names else individuals.index(position.individual or LONE)
        part = rows.point[own] if rows.points else parts.index(position.keypoint)
        cell = (body + further) * len(parts) + part
        positions.reshape(-1, 2)[cell] = _places(rows.number, position.columns)[own]
        if score is not None:
            confidence.reshape(-1)[cell] = rows.number[score][own]
    signals = {}
    if heading is not None:
        signals[HEADING] = np.full(shape[:2], np.nan)
        signals[HEADING].reshape(-1)[body] = rows.number[heading][own]
    return {
        "individuals": tuple(individuals),
        "keypoints": tuple(parts),
        "positions": positions,
        "confidence": confidence if any(scores) else None,
        "signals": signals,
        "start": first,
    }


def _places(number: Mapping[str, Floats], columns: Sequence[str]) -> Floats:
    """Return x and y ``(rows, 2)`` of two columns, or the centre of the edges of a box."""
    x, y = (np.mean([number[name] for name in columns[axis::2]], axis=0) for axis in (0, 1))
    return np.stack([x, y], axis=1)


def _recordings_of(
    path: Path, found: Columns, word: Mapping[str, tables.Words], zeros: Whole
) -> tables.Words:
    """Return the recording of each row: that of a column, an arena of it, else of the file."""
    stem = Path(path.name.removesuffix(tables.PACKED)).stem
    sets = word.get(found.recording or "", tables.Words([stem], zeros))
    arenas = word.get(found.arena or "", tables.Words([""], zeros))
    if len(arenas.entries) == 1:
        return sets
    count = len(arenas.entries)
    pairs, number = np.unique(sets.number * count + arenas.number, return_inverse=True)
    names = [f"{sets.entries[pair // count]}/{arenas.entries[pair % count]}" for pair in pairs]
    return tables.Words(names, number.astype(np.int64))


def _bodies_of(
    path: Path, found: Columns, word: Mapping[str, tables.Words], zeros: Whole, stated: bool
) -> tuple[list[str], Whole, list[str], Whole]:
    """Return names of individuals and of keypoints that rows are of, and for each row which one.

    No names: the header has them. A column of individuals may name parts of bodies: ``nose``.
    """
    none = tables.Words([], zeros)
    bodies, points = (word.get(name or "", none) for name in (found.individual, found.keypoint))
    unclear = not stated and not points.entries
    split = split_names(bodies.entries) if unclear else None
    if unclear and split is None and any(map(is_body_part, bodies.entries)):
        column = shlex.quote(f"individual={found.individual}")
        part = shlex.quote(f"keypoint={found.individual}")
        raise InputError(
            f"{path}: column {found.individual!r} names parts of bodies "
            f"({', '.join(filter(is_body_part, bodies.entries))[:80]}) beside others: say --source "
            f"long-table --option {part} if all are parts of one individual, --option {column} if "
            "each is an individual"
        )
    if split and any(part != CENTROID for _, part in split):
        names = list(dict.fromkeys(individual for individual, _ in split))
        parts = list(dict.fromkeys(part for _, part in split))
        place = np.array([(names.index(a), parts.index(b)) for a, b in split], dtype=np.int64)
        who, point = place[bodies.number].T
        return [name or LONE for name in names], who, parts, point
    return bodies.entries, bodies.number, points.entries, points.number


def _stack_slots(
    number: dict[str, Floats], word: dict[str, tables.Words], found: Columns
) -> tuple[dict[str, Floats], dict[str, tables.Words], Columns, Whole]:
    """Return rows of one individual each, of rows with several whose names stand in columns.

    Last is the row of the table that each is of.
    """
    slots = list(found.tracks)
    own = {name: [p for p in found.positions if p.individual == name] for name in slots}
    first = own[slots[0]]
    rows = [np.flatnonzero(word[column].number >= 0) for column in found.tracks.values()]
    entries = sorted(set(itertools.chain(*(word[c].entries for c in found.tracks.values()))))
    who = [
        np.searchsorted(entries, np.array(word[column].entries))[word[column].number[at]]
        for column, at in zip(found.tracks.values(), rows, strict=True)
    ]
    order = np.concatenate(rows)
    used = set(
        itertools.chain(*(p.columns for p in found.positions), (p.score for p in found.positions))
    )
    stacked = {name: values[order] for name, values in number.items() if name not in used}
    for at, position in enumerate(first):
        for k, column in enumerate((*position.columns, position.score)):
            parts = [(*own[name][at].columns, own[name][at].score)[k] for name in slots]
            if column is not None:
                values = [number[str(part)][rows_] for part, rows_ in zip(parts, rows, strict=True)]
                stacked[column] = np.concatenate(values)
    words = {
        name: tables.Words(value.entries, value.number[order])
        for name, value in word.items()
        if name not in found.tracks.values()
    }
    column = found.tracks[slots[0]]
    words[column] = tables.Words(entries, np.concatenate(who).astype(np.int64))
    positions = tuple(replace(position, individual="") for position in first)
    return stacked, words, replace(found, individual=column, positions=positions, tracks={}), order


def _project(path: Path, number: dict[str, Floats], found: Columns) -> str:
    """Turn longitudes and latitudes [degrees] into metres on a plane around their middle.

    A local equirectangular projection; returns what an import says of it.
    """
    (east, north), *_ = (position.columns for position in found.positions)
    longitude, latitude = number[east], number[north]
    seen = np.isfinite(longitude) & np.isfinite(latitude)
    fits = (
        seen.any() and np.abs(latitude[seen]).max() <= 90 and np.abs(longitude[seen]).max() <= 360
    )
    require(
        fits,
        f"{path}: columns {east!r} and {north!r} are longitudes and latitudes by their names, but "
        "hold other numbers than degrees: name the unit by --option unit=m",
    )
    first = longitude[seen][0]
    longitude = first + (longitude - first + 180.0) % 360.0 - 180.0  # across the date line
    middle = np.median(longitude[seen]), np.median(latitude[seen])
    per_degree = EARTH * np.pi / 180.0
    number[east] = per_degree * np.cos(np.radians(middle[1])) * (longitude - middle[0])
    number[north] = per_degree * (latitude - middle[1])
    return (
        f"{east} and {north} are degrees: projected to metres on a plane around longitude "
        f"{middle[0]:.5f}, latitude {middle[1]:.5f}"
    )


def _with_boxes(table: tables.Table, found: Columns, number: dict[str, Floats]) -> Columns:
    """Return the same with x1, y1, x2, y2 as a box, where they are no two animals."""
    corners = corners_of(table.names) or ()
    pairs = itertools.chain(*(one.columns for one in found.positions))
    is_box = corners == tuple(pairs) and are_corners(*(number[name] for name in corners))
    return replace(found, positions=(Position(corners),)) if is_box else found


def are_corners(x1: Floats, y1: Floats, x2: Floats, y2: Floats) -> bool:
    """Return whether two points of each row are corners of a box, not two animals."""
    low, high = np.stack([x1, y1]), np.stack([x2, y2])
    seen = np.isfinite(low + high).all(axis=0)
    seen &= (low != high).any(axis=0)  # the corners of a lost animal are one mark, such as 0
    low, high = low[:, seen], high[:, seen]
    if not seen.any() or (high > low).all(axis=0).mean() < ORDERED:
        return False
    size, centre = high - low, (low + high) / 2
    return bool((size.std(axis=1) < STEADY * centre.std(axis=1)).all())


def _notes_on(found: Columns, points: Sequence[str]) -> list[str]:
    """Return what was taken for a box, for keypoints and for a landmark."""
    notes = [
        f"{', '.join(position.columns)} are the edges of a box: its centre is the position"
        for position in found.positions
        if len(position.columns) == 4
    ]
    named = dict.fromkeys(one.keypoint for one in found.positions if one.keypoint != CENTROID)
    if parts := [*points, *named]:
        notes.append(f"taken for keypoints of each individual: {', '.join(parts)}")
    if found.landmarks:
        notes.append(f"taken for landmarks, not for animals: {', '.join(found.landmarks)}")
    return notes


def _centre_arenas(tracks: list[Tracks]) -> list[Tracks]:
    """Return the arenas of a table, each moved to its own middle if they are side by side."""
    places = [one.positions.reshape(-1, 2) for one in tracks]
    low, high = (np.array([end(own, axis=0) for own in places]) for end in (np.nanmin, np.nanmax))
    apart = (low[:, None] > high).any(axis=2)
    if not (apart | apart.T | np.eye(len(tracks), dtype=bool)).all():
        return tracks
    middles = (low + high) / 2
    return [replace(one, positions=one.positions - m) for one, m in zip(tracks, middles)]


def _in_natural_order(entries: list[str], numbers: Whole) -> tuple[list[str], Whole]:
    """Return those entries that occur, 2 before 10, and the place of each entry among these."""

    def pieces(number: int) -> list[tuple[int, int, str]]:
        parts = re.findall(r"\d+|\D+", entries[number])
        return [(0, int(part), "") if part.isdecimal() else (1, 0, part) for part in parts]

    order = sorted(np.unique(numbers).tolist(), key=pieces)
    place = np.zeros(len(entries), dtype=np.int64)
    place[order] = np.arange(len(order))
    return [entries[number] for number in order], place


def frame_numbers(table: tables.Table, column: str, frames: NDArray[np.float64]) -> Whole:
    """Return frames as whole numbers, or refuse what is none."""
    bad = ~((frames >= 0) & (frames == np.floor(frames)) & (frames < LARGEST_FRAME))
    if bad.any():
        at = int(bad.argmax())
        raise InputError(
            f"{table.path}: {table.place(at)}, column {column!r} holds {frames[at]:g}: give whole "
            "numbers from 0"
        )
    return frames.astype(np.int64)


def refuse_two_rows(
    table: tables.Table,
    recording: str,
    cell: Whole,
    individuals: list[str],
    rows: Whole,
    first: int = 0,
) -> None:
    """Refuse a second row of one frame and individual; ``rows`` are those of the table."""
    twice = np.flatnonzero(np.bincount(cell) > 1)
    if len(twice):
        frame, who = divmod(int(twice[0]), len(individuals))
        second = int(np.flatnonzero(cell == twice[0])[1])
        before = cell[:second][cell[:second] % len(individuals) == who]
        require(
            before.max() == twice[0],
            f"{table.path}: frames begin again at {table.place(int(rows[second]))}, as of a second "
            "session: add a column recording that tells the sessions apart, or split the file",
        )
        raise InputError(
            f"{table.path}: {recording}, frame {first + frame}, {individuals[who]} has two rows: "
            "drop the duplicate, or name the recording column"
        )


def _is_sparse(frames: Whole, recording: Whole, individuals: int) -> bool:
    """Whether few of the frames between first and last hold a row, as in a film of short visits."""
    first = np.full(int(recording.max()) + 1, LARGEST_FRAME)
    last = np.zeros_like(first)
    np.minimum.at(first, recording, frames)
    np.maximum.at(last, recording, frames)
    cells = int((last - first + 1).max()) * individuals
    return individuals > 1 and cells > max(SPARSE * len(frames), SMALL)


def _check_extent(
    table: tables.Table, recording: str, shape: tuple[int, ...], frames: Whole, rows: Whole
) -> None:
    """Refuse a frame so late that the recording would take more memory than the file may ask."""
    size = math.prod(shape) * 16
    if size > allowed_bytes(table.path.stat().st_size):
        last = int(frames.argmax())
        raise InputError(
            f"{table.path}: {table.place(int(rows[last]))} is of frame {frames[last]}, with which "
            f"recording {recording} would take {size / 2**20:,.0f} MiB, more "
            f"than {EXPANSION} times the file: correct it"
        )
