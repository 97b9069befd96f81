"""Long tables: a row per frame and individual, in CSV, TSV, text of any layout, Excel or Parquet.

Columns are found by their names or named by options. A table may hold several recordings, told
apart by a column. The frame rate comes from ``fps``, or from a column of times.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from animarl_envs.demos.episode import HEADING
from animarl_envs.errors import InputError
from animarl_envs.files import EXPANSION, allowed_bytes
from animarl_envs.importing.headings import radians_per_unit
from animarl_envs.importing.readers.clocks import (
    check_rate,
    frames_at,
    rate_of_frames,
    refuse_times_going_back,
    seconds,
)
from animarl_envs.importing.readers.guards import Place
from animarl_envs.importing.readers.habits import columns_by_habit, refuse_left_over, what_to_type
from animarl_envs.importing.readers.layouts import Layout, layout_of, names_by_look
from animarl_envs.importing.readers.parquet import is_parquet, parquet_names
from animarl_envs.importing.readers.registry import register_track_reader
from animarl_envs.importing.readers.tabular import line_of, numbered, pieces
from animarl_envs.importing.tracks import Tracks

LONE = "individual_0"  # of a table with one x and one y
EXTENSIONS = (
    ".csv", ".tsv", ".txt", ".dat", ".asc", ".tab", ".xlsx", ".xlsm", ".xls", ".parquet", ".pq"
)  # fmt: skip
Progress = Callable[[float], None] | None
# Frame numbers, codes of recording and individual, positions (rows, 2), confidence, headings.
_Part = tuple[NDArray[Any], NDArray[Any], NDArray[Any], NDArray[Any] | None, NDArray[Any] | None]


def table_layout(
    path: Path, encoding: str | None, sheet: str | None, decimal: str | None
) -> Layout:
    """The layout of a text or workbook; of Parquet only the names."""
    if is_parquet(path):
        names = tuple(parquet_names(path))
        return Layout(names, ("",) * len(names))
    return layout_of(path, encoding, sheet, decimal)


def _is_long(path: Path) -> bool:
    names = parquet_names(path) if is_parquet(path) else names_by_look(path)
    return columns_by_habit(names).is_long


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
    """One or more recordings; frames are whole numbers, missing rows are gaps.

    ``time`` names a column of times (numbers in ``time_unit``, by default seconds, or ISO 8601)
    that stands in for ``frame``; without ``fps`` it gives the frame rate as well. Frame 0 is the
    earliest time of each recording.

    ``heading`` names a column of where bodies point, from x towards y; its ``angle_unit`` (rad or
    deg) may stand in its name. No such column is found by habit: an angle may be that of an
    ellipse, which has no front.
    """
    if heading is None and angle_unit is not None:
        raise InputError(f"{path}: angle_unit is {angle_unit!r} of no column: name it by heading")
    to_radians = 1.0 if heading is None else radians_per_unit(path, heading, angle_unit)
    layout = table_layout(path, encoding, sheet, decimal)
    habit = columns_by_habit(layout.names, layout.units)
    given = {"frame": frame or time, "individual": individual, "x": x, "recording": recording}
    if any(given.get(part, part) is None for part in habit.unclear) and (
        words := what_to_type(path)
    ):
        raise InputError(f"{path}: {words}")
    if habit.x is not None and not (individual or habit.individual or x or y):
        refuse_left_over(path, layout.names, habit)
    x, y = x or habit.x or "x", y or habit.y or "y"
    recording = recording or habit.recording
    confidence = confidence or habit.confidence
    individual = individual or habit.individual or (None if recording else "id")
    clock = time or (habit.time if frame is None else None)
    frame = None if time is not None else frame or habit.frame or (None if clock else "frame")
    if clock is not None and time is None:
        time_unit = time_unit or habit.time_unit or None
    wanted = (frame, clock, individual, x, y, confidence, heading, recording)
    columns = [name for name in wanted if name]
    words_of_time = clock is not None and clock in layout.words_in
    text = [name for name in (individual, recording) if name]
    text += [clock] if clock is not None and words_of_time else []
    codes: dict[tuple[str, str], int] = {}
    place = partial(line_of, path, layout)
    parts: list[_Part] = []
    times: list[NDArray[Any]] = []
    for piece in pieces(path, columns, text, progress, layout):
        rows = len(piece[x])
        names = piece[individual] if individual else np.full(rows, LONE, dtype=object)
        sets = piece[recording] if recording is not None else None
        which = _codes(codes, names, sets, path.stem)
        values = np.column_stack([piece[x], piece[y]])
        weight = piece[confidence] if confidence is not None else None
        angle = piece[heading] * to_radians if heading is not None else None
        when: NDArray[Any] = np.zeros(rows, dtype=np.int32)
        if frame is not None:
            when = _frame_numbers(path, frame, piece[frame], sum(len(p[0]) for p in parts), place)
        if clock is not None:
            times.append(piece[clock])
        parts.append((when, which, values, weight, angle))
    if not parts or not codes:
        raise InputError(f"{path}: it has a header but no rows: check the file")
    starts: dict[str, float] = {}
    if clock is not None and (frame is None or fps is None):
        sets_of = {name: i for i, name in enumerate(dict.fromkeys(name for name, _ in codes))}
        group = np.array([sets_of[name] for name, _ in codes])[
            np.concatenate([p[1] for p in parts])
        ]
        every = seconds(path, clock, np.concatenate(times), time_unit)
        if frame is not None:
            fps = rate_of_frames(path, np.concatenate([part[0] for part in parts]), every, group)
        else:
            refuse_times_going_back(path, every, np.concatenate([p[1] for p in parts]), place)
            fps, numbers = frames_at(path, every, fps, group, place)
            starts = {name: float(every[group == i].min()) for name, i in sets_of.items()}
            edges = np.cumsum([len(part[0]) for part in parts])[:-1]
            parts = [
                (own, *part[1:]) for own, part in zip(np.split(numbers, edges), parts, strict=True)
            ]
        if not words_of_time and time is None and time_unit is None:
            check_rate(path, clock, fps)
    return _spread(
        path, codes, parts, fps, unit or habit.unit or "px", y_down, layout.words, starts, place
    )


def _frame_numbers(
    path: Path, column: str, frames: NDArray[np.float64], first_row: int, place: Place
) -> NDArray[np.int32]:
    bad = ~((frames >= 0) & (frames == np.floor(frames)) & (frames < 2**31))
    if bad.any():
        at = int(bad.argmax())
        raise InputError(
            f"{path}: {place(first_row + at)}, column {column!r} holds {frames[at]:g}: give whole "
            "numbers from 0"
        )
    return frames.astype(np.int32)


def _codes(
    codes: dict[tuple[str, str], int],
    names: NDArray[Any],
    sets: NDArray[Any] | None,
    stem: str,
) -> NDArray[np.int32]:
    """A number for each (recording, individual), new ones added to ``codes``."""
    unique, inverse = numbered(names)
    if sets is None:
        lookup = [codes.setdefault((stem, str(name)), len(codes)) for name in unique]
        return np.array(lookup, dtype=np.int32)[inverse]
    unique_sets, inverse_sets = numbered(sets)
    pairs, back = np.unique(
        inverse_sets.astype(np.int64) * len(unique) + inverse, return_inverse=True
    )
    lookup = [
        codes.setdefault(
            (str(unique_sets[pair // len(unique)]), str(unique[pair % len(unique)])), len(codes)
        )
        for pair in pairs.tolist()
    ]
    return np.array(lookup, dtype=np.int32)[back]


def _spread(
    path: Path,
    codes: dict[tuple[str, str], int],
    parts: list[_Part],
    fps: float | None,
    unit: str,
    y_down: bool,
    read_as: str,
    starts: dict[str, float],
    place: Place,
) -> list[Tracks]:
    """Rows to arrays ``(frames, individuals, 1, 2)``, a Tracks per recording."""
    count = len(codes)
    last = np.full(count, -1, dtype=np.int64)
    for frames, which, *_ in parts:
        np.maximum.at(last, which, frames)
    found = []
    for name in dict.fromkeys(recording for recording, _ in codes):
        own = {who: code for (recording, who), code in codes.items() if recording == name}
        individuals = tuple(sorted(own, key=_natural))
        frames_total = int(max(last[code] for code in own.values())) + 1
        size = frames_total * len(own) * 16
        if size > allowed_bytes(path.stat().st_size):
            frames, which = (np.concatenate([part[i] for part in parts]) for i in (0, 1))
            latest = (frames == frames_total - 1) & np.isin(which, list(own.values()))
            raise InputError(
                f"{path}: {place(int(latest.argmax()))} is of frame {frames_total - 1}, with which "
                f"recording {name} would take {size / 2**20:,.0f} MiB, more than {EXPANSION} times "
                "the file: mend it"
            )
        column = np.full(count, -1)
        column[[own[who] for who in individuals]] = np.arange(len(own))
        positions = np.full((frames_total, len(own), 1, 2), np.nan)
        weights = None
        if parts[0][3] is not None:
            weights = np.full((frames_total, len(own), 1), np.nan)
        signals = {}
        if parts[0][4] is not None:
            signals[HEADING] = np.full((frames_total, len(own)), np.nan)
        seen = np.zeros((frames_total, len(own)), dtype=bool)
        for frames, which, values, weight, angle in parts:
            mine = column[which] >= 0
            rows, columns = frames[mine], column[which[mine]]
            flat = rows.astype(np.int64) * len(own) + columns
            twice = np.flatnonzero(
                (np.bincount(flat - flat.min()) if len(flat) else np.zeros(1)) > 1
            )
            clash = seen[rows, columns]
            if len(twice) or clash.any():
                at = int((twice[0] + flat.min()) if len(twice) else flat[clash.argmax()])
                raise InputError(
                    f"{path}: {name}, frame {at // len(own)}, {individuals[at % len(own)]} has "
                    "two rows: drop the duplicate, or name the recording column"
                )
            seen[rows, columns] = True
            positions[rows, columns, 0] = values[mine]
            if weights is not None and weight is not None:
                weights[rows, columns, 0] = weight[mine]
            if angle is not None:
                signals[HEADING][rows, columns] = angle[mine]
        found.append(
            Tracks(
                recording=name, individuals=individuals, positions=positions, frame_rate=fps,
                unit=unit, y_down=y_down, confidence=weights, signals=signals,
                start=starts.get(name, 0.0),
                provenance={"file": path.name, "read_as": read_as},
            )
        )  # fmt: skip
    return found


def _natural(name: str) -> tuple[tuple[int, int, str], ...]:
    """Sort key under which 2 comes before 10."""
    pieces_of_name = re.findall(r"\d+|\D+", name)
    return tuple((0, int(p), "") if p.isdecimal() else (1, 0, p) for p in pieces_of_name)
