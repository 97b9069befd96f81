"""From the rows of a table to tracks, once the part of each column is known."""

import itertools
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from animarl_envs.array_types import Floats, Ints
from animarl_envs.demos.episode import HEADING
from animarl_envs.errors import FaultCollector, InputError, require
from animarl_envs.importing import tables
from animarl_envs.importing.clock import (
    IN_SECONDS,
    even_rows,
    fit_clock,
    irregular_rate,
    refuse_times_going_back,
    seconds,
)
from animarl_envs.importing.table_checks import (
    check_extent,
    frame_numbers,
    is_sparse,
    refuse_two_rows,
)
from animarl_envs.importing.table_columns import (
    DEGREES,
    Columns,
    is_body_part,
    is_idtracker,
    parsed_names,
    split_names,
)
from animarl_envs.importing.table_geometry import centre_arenas, project_degrees, with_boxes
from animarl_envs.importing.table_slots import stack_slots
from animarl_envs.importing.tracks import (
    CENTROID,
    LONE,
    RATE_FROM,
    STATED_CONDITION,
    TOGETHER_AT_MOST,
    TRACKS,
    Tracks,
)

CONDITION = "condition"  # the name of a column


@dataclass(eq=False)
class _Rows:
    """Rows of a table: their numbers by column, and the recording, individual and keypoint of each.

    ``line`` is the row of the table that each is of. Without ``names`` of individuals or of
    ``points`` the header has them. ``time`` is the column of the clock, where it counts.
    ``condition`` is the number of each row's condition in ``conditions``, -1 where there is none.
    """

    number: dict[str, Floats]
    line: Ints
    recordings: list[str]
    recording: Ints
    names: list[str]
    individual: Ints
    points: list[str]
    point: Ints
    time: Floats | tables.TextColumn | None
    condition: Ints
    conditions: list[str]

    @property
    def track(self) -> Ints:
        """A number for each recording, individual and keypoint."""
        body = self.recording * max(len(self.names), 1) + self.individual
        return body * max(len(self.points), 1) + self.point

    def interpolate(self, low: Ints, high: Ints, share: Floats) -> None:
        """Replace the rows by others between rows ``low`` and ``high`` of the same track."""
        self.number = {
            key: own[low] + share * (own[high] - own[low]) for key, own in self.number.items()
        }
        for name in ("line", "recording", "individual", "point", "condition"):
            setattr(self, name, getattr(self, name)[low])


def tracks_of_rows(
    table: tables.Table,
    columns: Columns,
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
    rows, columns = _read_rows(table, columns, fps, progress, heading, stated, provenance)
    fps, frames, start = _frames_of(table, columns, rows, fps, heading, provenance)
    if rows.names and is_sparse(frames, rows.recording, len(rows.names)):
        start = _split_tracks(rows, frames, start, provenance)
    tracks, faults = list[Tracks](), FaultCollector()
    for at in range(len(rows.recordings)):
        alone = len(rows.recordings) == 1  # a slice, since copies of a gigabyte are felt
        own = slice(None) if alone else np.flatnonzero(rows.recording == at)
        with faults.collect():
            tracks.append(
                Tracks(
                    recording=rows.recordings[at],
                    frame_rate=fps,
                    unit=columns.unit or "px",
                    y_down=y_down,
                    start_time=float(start[at]),
                    provenance=provenance | _stated_condition(rows, own),
                    **_place_rows(table, columns, rows, own, frames[own], heading),
                )
            )
    faults.refuse()
    return centre_arenas(tracks) if columns.arena else tracks


def _read_rows(
    table: tables.Table,
    columns: Columns,
    fps: float | None,
    progress: tables.Progress,
    heading: str | None,
    stated: bool,
    provenance: dict[str, Any],
) -> tuple[_Rows, Columns]:
    """Return the rows, and the columns as their numbers show them: boxes, metres.

    What is not used, and what an import says, goes to ``provenance``.
    """
    clock = "" if columns.frame and fps else columns.time or ""
    numbers = [
        *itertools.chain(*(one.columns for one in columns.positions)),
        heading,
        columns.frame,
    ]
    numbers += [position.score or columns.confidence for position in columns.positions]
    slots = list(columns.tracks.values())
    condition = next((name for name in table.names if name.lower() == CONDITION), "")
    texts = [columns.individual, columns.keypoint, columns.recording, columns.arena, *slots]
    texts.append(condition)
    (texts if clock in table.words_in else numbers).append(clock)
    used = {*numbers, *texts, columns.time}
    if unused := [name for name in table.names if name and name not in used]:
        provenance["columns_not_used"] = unused
    number, word = table.columns(
        [*filter(None, numbers)], [*filter(None, texts)], progress, may_be_empty=[*slots, condition]
    )
    notes = table.notes
    line = np.arange(len(next(iter(number.values()))))
    if slots:
        number, word, columns, line = stack_slots(number, word, columns)
    if columns.unit == DEGREES:
        notes.append(project_degrees(table.path, number, columns))
        columns = replace(columns, unit="m")
    if not stated:
        columns = with_boxes(table, columns, number)
    zeros = np.zeros(len(line), dtype=np.int64)
    sets = _recordings_of(table.path, columns, word, zeros)
    bodies = _bodies_of(table.path, columns, word, zeros, stated)
    time = word.get(clock, number.get(clock))
    stated_words = word.get(condition, tables.TextColumn([], zeros - 1))
    rows = _Rows(
        number,
        line,
        sets.entries,
        sets.number,
        *bodies,
        time,
        stated_words.number,
        stated_words.entries,
    )
    notes += _notes_on(columns, rows.points)
    if is_idtracker(table):
        notes.append("the columns are idTracker's: y is taken to grow downwards")
    if notes:
        provenance["notes"] = notes
    return rows, columns


def _frames_of(
    table: tables.Table,
    columns: Columns,
    rows: _Rows,
    fps: float | None,
    heading: str | None,
    provenance: dict[str, Any],
) -> tuple[float | None, Ints, Floats]:
    """Return the rate [Hz], the frame of each row and the time of frame 0 of each recording.

    Rows of an irregular clock are resampled.
    """
    path = table.path
    frames = np.zeros(len(rows.line), dtype=np.int64)
    if columns.frame is not None:
        frames = frame_numbers(table, columns.frame, rows.number[columns.frame])
    elif rows.time is None:
        for at in range(len(rows.recordings)):
            own = rows.recording == at
            frames[own] = np.arange(np.count_nonzero(own))
    if rows.time is None:
        return fps, frames, np.zeros(len(rows.recordings))
    assert columns.time is not None
    is_text = isinstance(rows.time, tables.TextColumn)
    unit = columns.time_unit or parsed_names([columns.time], table.units)[0].unit
    when = seconds(path, columns.time, rows.time, unit or None)
    unsaid = None if unit or is_text else columns.time
    written = 1.0 if is_text else IN_SECONDS[unit or "s"]
    provenance[RATE_FROM] = (
        f"the column {columns.time} ({'times of day' if is_text else unit or 's'})"
    )
    if columns.frame is None:
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
    numbered = None if columns.frame is None else frames
    clock = fit_clock(path, when, rows.recording, table.place, numbered, fps, unsaid, written)
    return clock.rate, clock.frames, clock.first


def _split_tracks(rows: _Rows, frames: Ints, start: Floats, provenance: dict[str, Any]) -> Floats:
    """Make each individual of each recording a recording; return the times of their frame 0."""
    together = np.unique(frames * len(rows.recordings) + rows.recording, return_counts=True)[1]
    count = len(rows.names)
    kept, recording = np.unique(rows.recording * count + rows.individual, return_inverse=True)
    provenance |= {TRACKS: len(kept), TOGETHER_AT_MOST: int(together.max())}
    rows.recordings = [f"{rows.recordings[k // count]}/{rows.names[k % count]}" for k in kept]
    rows.recording, rows.individual = recording.astype(np.int64), np.zeros_like(rows.individual)
    rows.names = []
    return np.asarray(start[kept // count])


def _stated_condition(rows: _Rows, own: Ints | slice) -> dict[str, str]:
    """Return the condition of a recording, if there is a column of conditions."""
    number = np.unique(rows.condition[own])
    if not rows.conditions:
        return {}
    is_one = len(number) == 1 and number[0] >= 0
    return {STATED_CONDITION: rows.conditions[number[0]] if is_one else ""}


def _place_rows(
    table: tables.Table,
    columns: Columns,
    rows: _Rows,
    own: Ints | slice,
    frames: Ints,
    heading: str | None,
) -> dict[str, Any]:
    """Return names and arrays of one recording, of its ``own`` rows and the ``frames`` of these."""
    recording = rows.recordings[int(rows.recording[own][0])]
    individuals = list(dict.fromkeys(one.individual or LONE for one in columns.positions))
    place = np.zeros(1, dtype=np.int64)
    if rows.names:
        individuals, place = tables.in_natural_order(rows.names, rows.individual[own])
    parts = rows.points or list(dict.fromkeys(one.keypoint for one in columns.positions))
    first = int(frames.min())
    shape = (int(frames.max()) + 1 - first, len(individuals), len(parts))
    check_extent(table, recording, shape, frames, rows.line[own])
    body = (frames - first) * len(individuals) + place[rows.individual[own]]
    labels = [f"{a} {part}" if len(parts) > 1 else a for a in individuals for part in parts]
    refuse_two_rows(
        table, recording, body * len(parts) + rows.point[own], labels, rows.line[own], first
    )
    positions = np.full((*shape, 2), np.nan)
    scores = [position.score or columns.confidence for position in columns.positions]
    confidence = np.full(shape, np.nan) if any(scores) else None
    for position, score in zip(columns.positions, scores, strict=True):
        further = 0 if rows.names else individuals.index(position.individual or LONE)
        part = rows.point[own] if rows.points else parts.index(position.keypoint)
        cell = (body + further) * len(parts) + part
        for axis in range(2):  # a column, or the two edges of a box, whose middle it is
            edges = [rows.number[name][own] for name in position.columns[axis::2]]
            positions.reshape(-1, 2)[cell, axis] = sum(edges) / len(edges)
        if confidence is not None and score is not None:
            confidence.reshape(-1)[cell] = rows.number[score][own]
    signals = {}
    if heading is not None:
        signals[HEADING] = np.full(shape[:2], np.nan)
        signals[HEADING].reshape(-1)[body] = rows.number[heading][own]
    return {
        "individuals": tuple(individuals),
        "keypoints": tuple(parts),
        "positions": positions,
        "confidence": confidence,
        "signals": signals,
        "start": first,
    }


def _recordings_of(
    path: Path, columns: Columns, word: Mapping[str, tables.TextColumn], zeros: Ints
) -> tables.TextColumn:
    """Return the recording of each row: that of a column, an arena of it, else of the file."""
    stem = Path(path.name.removesuffix(tables.PACKED)).stem
    sets = word.get(columns.recording or "", tables.TextColumn([stem], zeros))
    arenas = word.get(columns.arena or "", tables.TextColumn([""], zeros))
    if len(arenas.entries) == 1:
        return sets
    count = len(arenas.entries)
    pairs, number = np.unique(sets.number * count + arenas.number, return_inverse=True)
    names = [f"{sets.entries[pair // count]}/{arenas.entries[pair % count]}" for pair in pairs]
    return tables.TextColumn(names, number.astype(np.int64))


def _bodies_of(
    path: Path, columns: Columns, word: Mapping[str, tables.TextColumn], zeros: Ints, stated: bool
) -> tuple[list[str], Ints, list[str], Ints]:
    """Return the names of individuals and keypoints, and for each row the number of its own.

    No names: the header has them. A column of individuals may name parts of bodies: ``nose``.
    """
    none = tables.TextColumn([], zeros)
    bodies, points = (word.get(name or "", none) for name in (columns.individual, columns.keypoint))
    unclear = not stated and not points.entries
    split = split_names(bodies.entries) if unclear else None
    if unclear and split is None and any(map(is_body_part, bodies.entries)):
        column = shlex.quote(f"individual={columns.individual}")
        part = shlex.quote(f"keypoint={columns.individual}")
        raise InputError(
            f"{path}: column {columns.individual!r} names parts of bodies "
            f"({', '.join(filter(is_body_part, bodies.entries))[:80]}) beside others: say --source "
            f"long-table --option {part} if all are parts of one individual, --option {column} if "
            "each is an individual"
        )
    if split and any(part != CENTROID for _, part in split):
        names = list(dict.fromkeys(individual for individual, _ in split))
        parts = list(dict.fromkeys(part for _, part in split))
        place = np.array([(names.index(a), parts.index(b)) for a, b in split], dtype=np.int64)
        individual, point = place[bodies.number].T
        return [name or LONE for name in names], individual, parts, point
    return bodies.entries, bodies.number, points.entries, points.number


def _notes_on(columns: Columns, points: Sequence[str]) -> list[str]:
    """Return notes on columns that were taken for a box, for keypoints or for a landmark."""
    notes = [
        f"{', '.join(position.columns)} are the edges of a box: its centre is the position"
        for position in columns.positions
        if len(position.columns) == 4
    ]
    named = dict.fromkeys(one.keypoint for one in columns.positions if one.keypoint != CENTROID)
    if parts := [*points, *named]:
        notes.append(f"taken for keypoints of each individual: {', '.join(parts)}")
    if columns.landmarks:
        notes.append(f"taken for landmarks, not for animals: {', '.join(columns.landmarks)}")
    return notes
