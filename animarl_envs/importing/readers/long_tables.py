"""Long tables: a row per frame and individual, in CSV, TSV, text of any layout, Excel or Parquet.

Columns are found by their names or named by options. A table may hold several recordings, told
apart by a column. The frame rate comes from ``fps``, or from a column of times.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from animarl_envs.demos.episode import HEADING
from animarl_envs.errors import InputError
from animarl_envs.files import EXPANSION, allowed_bytes
from animarl_envs.importing.headings import radians_per_unit
from animarl_envs.importing.readers import clocks
from animarl_envs.importing.readers.column_names import (
    find_columns,
    refuse_unused_pair,
    suggested_command,
)
from animarl_envs.importing.readers.registry import register_track_reader
from animarl_envs.importing.readers.tables import (
    EXTENSIONS,
    Progress,
    Table,
    Words,
    open_table,
    table_or_none,
)
from animarl_envs.importing.tracks import Tracks

LONE = "individual_0"  # of a table with one x and one y


def _is_long(path: Path) -> bool:
    table = table_or_none(path)
    return table is not None and find_columns(table).is_long


@register_track_reader(
    "long-table",
    "a row per frame and individual (CSV, TSV, text, Excel, Parquet); columns by habit or option",
    sniff=_is_long,
    extensions=EXTENSIONS,
    generic=True,
)
def read_long_table(
    path: Path,
    frame: str | None = None,
    individual: str | None = None,
    x: str | None = None,
    y: str | None = None,
    confidence: str | None = None,
    recording: str | None = None,
    time: str | None = None,
    fps: float | None = None,
    unit: str | None = None,
    time_unit: str | None = None,
    y_down: bool = False,
    decimal: str | None = None,
    encoding: str | None = None,
    sheet: str | None = None,
    heading: str | None = None,
    angle_unit: str | None = None,
    progress: Progress = None,
) -> list[Tracks]:
    """Read one or more recordings; frames are whole numbers, missing rows are gaps.

    ``time`` names a column of times (numbers in ``time_unit``, by default seconds, or ISO 8601)
    that stands in for ``frame``; without ``fps`` it gives the frame rate as well. Frame 0 is the
    earliest time of each recording.

    ``heading`` names a column of where bodies point, from x towards y; its ``angle_unit`` (rad or
    deg) may stand in its name. No such column is found by its name: an angle may be that of an
    ellipse, which has no front.
    """
    if heading is None and angle_unit is not None:
        raise InputError(f"{path}: angle_unit is {angle_unit!r} of no column: name it by heading")
    to_radians = 1.0 if heading is None else radians_per_unit(path, heading, angle_unit)
    table = open_table(path, encoding, sheet, decimal)
    found = find_columns(table)
    given = {"frame": frame or time, "individual": individual, "x": x, "recording": recording}
    if any(given.get(part, part) is None for part in found.unclear) and (
        words := suggested_command(path)
    ):
        raise InputError(f"{path}: {words}")
    if found.x is not None and not (individual or found.individual or x or y):
        refuse_unused_pair(table, found)
    x, y = x or found.x or "x", y or found.y or "y"
    recording = recording or found.recording
    confidence = confidence or found.confidence
    individual = individual or found.individual or (None if recording else "id")
    clock = time or (found.time if frame is None else None)
    frame = None if time is not None else frame or found.frame or (None if clock else "frame")
    if clock is not None and time is None:
        time_unit = time_unit or found.time_unit or None
    times_in_words = clock is not None and clock in table.layout.words_in
    texts = [name for name in (individual, recording) if name]
    numbers = [name for name in (frame, x, y, confidence, heading) if name]
    if clock is not None:
        (texts if times_in_words else numbers).append(clock)
    number, word = table.columns(list(dict.fromkeys(numbers)), texts, progress)
    names = _tracks_of(table, len(number[x]), word.get(individual or ""), word.get(recording or ""))
    frames = np.zeros(len(number[x]), dtype=np.int64)
    if frame is not None:
        frames = _frame_numbers(table, frame, number[frame])
    start = np.zeros(len(names.recordings))
    if clock is not None and (frame is None or fps is None):
        column = word[clock] if times_in_words else number[clock]
        when = clocks.seconds(path, clock, column, time_unit)
        group = names.recording_of[names.track]
        if frame is not None:
            fps = clocks.rate_of_frames(path, frames, when, group)
        else:
            clocks.refuse_times_going_back(path, when, names.track, table.place)
            fps, numbered = clocks.frames_at(path, when, fps, group, table.place)
            frames = numbered.astype(np.int64)
            start = np.full(len(names.recordings), np.inf)
            np.minimum.at(start, group, when)
        if not times_in_words and time is None and time_unit is None:
            clocks.check_rate(path, clock, fps)
    tracks = []
    for at, name in enumerate(names.recordings):
        rows = np.flatnonzero(names.recording_of[names.track] == at)
        own = np.unique(names.track[rows])
        individuals = sorted((names.individuals[i] for i in own), key=_natural)
        columns = np.full(len(names.individuals), -1)
        columns[own] = [individuals.index(names.individuals[i]) for i in own]
        cell = _cells(table, name, individuals, frames, rows, columns[names.track[rows]])
        shape = (int(frames[rows].max()) + 1, len(individuals))

        def spread(
            values: NDArray[np.float64], shape: tuple[int, int] = shape,
            cell: NDArray[np.int64] = cell, rows: NDArray[np.int64] = rows,
        ) -> NDArray[np.float64]:  # fmt: skip
            out = np.full(shape[0] * shape[1], np.nan)
            out[cell] = values[rows]
            return out.reshape(shape)

        tracks.append(
            Tracks(
                recording=name,
                individuals=tuple(individuals),
                positions=np.stack([spread(number[x]), spread(number[y])], axis=2)[:, :, None],
                frame_rate=fps,
                unit=unit or found.unit or "px",
                y_down=y_down,
                confidence=spread(number[confidence])[:, :, None] if confidence else None,
                signals={HEADING: spread(number[heading] * to_radians)} if heading else {},
                start=float(start[at]),
                provenance={"file": path.name, "read_as": table.description},
            )
        )
    return tracks


class _tracks_of:
    """Who is in which row: ``track`` ``(rows,)``, and of each track its names."""

    def __init__(self, table: Table, rows: int, who: Words | None, sets: Words | None) -> None:
        lone = np.zeros(rows, dtype=np.int64)
        who = who or Words([LONE], lone)
        sets = sets or Words([table.path.stem], lone)
        pairs, self.track = np.unique(
            sets.number * len(who.entries) + who.number, return_inverse=True
        )
        self.recordings = sets.entries
        self.recording_of = pairs // len(who.entries)
        self.individuals = [who.entries[i] for i in pairs % len(who.entries)]


def _frame_numbers(table: Table, column: str, frames: NDArray[np.float64]) -> NDArray[np.int64]:
    bad = ~((frames >= 0) & (frames == np.floor(frames)) & (frames < clocks.LARGEST_FRAME))
    if bad.any():
        at = int(bad.argmax())
        raise InputError(
            f"{table.path}: {table.place(at)}, column {column!r} holds {frames[at]:g}: give whole "
            "numbers from 0"
        )
    return frames.astype(np.int64)


def _cells(
    table: Table,
    recording: str,
    individuals: list[str],
    frames: NDArray[np.integer],
    rows: NDArray[np.int64],
    columns: NDArray[np.int64],
) -> NDArray[np.int64]:
    """Where the rows of a recording lie in an array ``(frames, individuals)``, laid flat."""
    own, count = frames[rows].astype(np.int64), len(individuals)
    last = int(own.max())
    if (last + 1) * count * 16 > allowed_bytes(table.path.stat().st_size):
        raise InputError(
            f"{table.path}: {table.place(int(rows[own.argmax()]))} is of frame {last}, with which "
            f"recording {recording} would take {(last + 1) * count * 16 / 2**20:,.0f} MiB, more "
            f"than {EXPANSION} times the file: correct it"
        )
    cell = own * count + columns
    twice = np.flatnonzero(np.bincount(cell) > 1)
    if len(twice):
        frame, who = divmod(int(twice[0]), count)
        raise InputError(
            f"{table.path}: {recording}, frame {frame}, {individuals[who]} has two rows: drop the "
            "duplicate, or name the recording column"
        )
    return cell


def _natural(name: str) -> tuple[tuple[int, int, str], ...]:
    """Sort key under which 2 comes before 10."""
    pieces = re.findall(r"\d+|\D+", name)
    return tuple((0, int(p), "") if p.isdecimal() else (1, 0, p) for p in pieces)
