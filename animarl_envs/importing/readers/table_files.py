"""Tables of text, Excel or Parquet: a row per frame and individual, or a row per frame.

Columns are found by their names or named by options. A table may hold several recordings, told
apart by a column. The frame rate comes from ``fps``, or from a column of times.
"""

import re
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from animarl_envs.demos.episode import HEADING
from animarl_envs.errors import InputError, require
from animarl_envs.files import EXPANSION, allowed_bytes
from animarl_envs.importing import tables
from animarl_envs.importing.readers.columns import (
    LARGEST_FRAME,
    Columns,
    check_rate,
    even_rows,
    find_columns,
    frames_at,
    irregular_rate,
    pairs_of,
    parsed_names,
    radians_per_unit,
    rate_of_frames,
    refuse_times_going_back,
    refuse_unused_pair,
    seconds,
    suggested_command,
)
from animarl_envs.importing.readers.registry import register_track_reader
from animarl_envs.importing.tracks import LONE, Tracks

CONFIDENCE = "confidence"
Pairs = dict[str, list[str]]
Whole = NDArray[np.int64]


def _is_long(path: Path) -> bool:
    table = tables.table_or_none(path)
    return table is not None and find_columns(table).is_long


def _is_wide(path: Path) -> bool:
    table = tables.table_or_none(path)
    if table is None or len(table.names) > tables.MOST_COLUMNS:
        return table is not None
    return len(wide_columns(table, find_columns(table))) > 0


@register_track_reader(
    "long-table",
    "a row per frame and individual (CSV, TSV, text, Excel, Parquet); columns by habit or option",
    sniff=_is_long,
    extensions=tables.EXTENSIONS,
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
    progress: tables.Progress = None,
) -> list[Tracks]:
    """Read one or more recordings; frames are whole numbers, missing rows are gaps.

    ``time`` names a column of times (numbers in ``time_unit``, by default seconds, or ISO 8601)
    that stands in for ``frame``; without ``fps`` it gives the frame rate as well. Frame 0 is the
    earliest time of each recording.

    ``heading`` names a column of where bodies point, from x towards y; its ``angle_unit`` (rad or
    deg) may stand in its name. No such column is found by its name: an angle may be that of an
    ellipse, which has no front.
    """
    named = heading is not None or angle_unit is None
    require(named, f"{path}: angle_unit is {angle_unit!r} of no column: name it by heading")
    to_radians = 1.0 if heading is None else radians_per_unit(path, heading, angle_unit)
    table = tables.open_table(path, encoding, sheet, decimal)
    found = find_columns(table)
    given = {"frame": frame or time, "individual": individual, "x": x, "recording": recording}
    if any(given.get(part, part) is None for part in found.unclear) and (
        words := suggested_command(path)
    ):
        raise InputError(f"{path}: {words}")
    if found.x is not None and not (individual or found.individual or x or y):
        refuse_unused_pair(table, found)
    recording, confidence = recording or found.recording, confidence or found.confidence
    individual = individual or found.individual or (None if recording else "id")
    extra = {CONFIDENCE: confidence} if confidence else {}
    extra |= {HEADING: heading} if heading else {}
    pairs = {LONE: [x or found.x or "x", y or found.y or "y"]}
    clocked = frame or time or found.frame or found.time
    tracks = _recordings(
        table, found, pairs, individual, recording, extra, frame if clocked else "frame", time,
        fps, time_unit, progress, unit=unit or found.unit or "px", y_down=y_down,
    )  # fmt: skip
    for one in tracks if heading else ():
        one.signals[HEADING][:] *= to_radians
    return tracks


@register_track_reader(
    "wide-table",
    "a row per frame (CSV, TSV, text, Excel, Parquet); columns x_NAME, y_NAME, or pairs by option",
    sniff=_is_wide,
    extensions=tables.EXTENSIONS,
    generic=True,
)
def read_wide_table(
    path: Path,
    columns: Pairs | None = None,
    frame: str | None = None,
    time: str | None = None,
    recording: str | None = None,
    fps: float | None = None,
    unit: str | None = None,
    time_unit: str | None = None,
    y_down: bool = False,
    decimal: str | None = None,
    encoding: str | None = None,
    sheet: str | None = None,
    progress: tables.Progress = None,
) -> list[Tracks]:
    """Read one or more recordings. ``columns`` maps each individual to its x and y column.

    Without ``columns``, pairs such as ``x_male y_male``, ``male_x male_y`` or ``x1 y1`` are taken.
    Columns of frames, times and recordings are as of a long table; without one of frames or times
    each row is the next frame of its recording.
    """
    table = tables.open_table(path, encoding, sheet, decimal)
    table.check_names()
    found = find_columns(table)
    pairs = columns or wide_columns(table, found)
    if columns is None and found.x is not None:
        refuse_unused_pair(table, found)
    if columns is None and (found.x is None or len(pairs) > 1):
        _refuse_lone(path, [one.bare for one in parsed_names(table.names)])
    require(
        pairs and all(len(pair) == 2 for pair in pairs.values()),
        f"{path}: it has no pairs of x and y columns: name them, such as "
        "columns: {male: [mx, my], female: [fx, fy]}",
    )
    units = {one.column: one.unit for one in parsed_names(table.names, table.units)}
    unit = unit or units.get(next(iter(pairs.values()))[0]) or "px"
    return _recordings(
        table, found, pairs, None, recording or found.recording, {}, frame, time, fps, time_unit,
        progress, unit=unit, y_down=y_down,
    )  # fmt: skip


def _recordings(
    table: tables.Table,
    found: Columns,
    pairs: Pairs,
    individual: str | None,
    recording: str | None,
    extra: dict[str, str],
    frame: str | None,
    time: str | None,
    fps: float | None,
    time_unit: str | None,
    progress: tables.Progress,
    **more: Any,
) -> list[Tracks]:
    """Tracks of each recording: of individuals by a column, or else of the pairs of columns.

    ``extra`` are columns of confidence and heading, which a row has once.
    """
    path, read_as = table.path, table.description
    clock = time or (found.time if frame is None else None)
    frame = None if time is not None else frame or found.frame
    clock = clock if frame is None or fps is None else None
    stated = time_unit or (found.time_unit if time is None else "") or None
    numbers = [name for pair in pairs.values() for name in pair] + [*extra.values()]
    numbers += [frame] if frame else []
    texts = [name for name in (individual, recording) if name]
    if clock is not None:
        (texts if clock in table.words_in else numbers).append(clock)
    number, word = table.columns(numbers, texts, progress)
    rows = len(number[numbers[0]])
    zeros = np.zeros(rows, dtype=np.int64)
    sets = word.get(recording or "") or tables.Words(
        [path.name.removesuffix(tables.PACKED).rpartition(".")[0]], zeros
    )
    who = word.get(individual or "") or tables.Words([], zeros)
    start, origin = np.zeros(len(sets.entries)), np.arange(rows)  # the table's row of each
    if frame is not None:
        frames = _frame_numbers(table, frame, number[frame])
    elif clock is None:
        frames = zeros.copy()
        for at in range(len(sets.entries)):
            frames[sets.number == at] = np.arange(np.count_nonzero(sets.number == at))
    if clock is not None:
        times = word[clock] if clock in word else number[clock]
        when = seconds(path, clock, times, stated)
        if frame is not None:
            fps = rate_of_frames(path, frames, when, sets.number)
        else:
            track = sets.number * max(len(who.entries), 1) + who.number
            refuse_times_going_back(path, when, track, table.place)
            if fps is None and (fps := irregular_rate(when, track)) is not None:
                require(
                    HEADING not in extra,
                    f"{path}: its clock is irregular, and headings are not resampled: give rows at "
                    "even times",
                )
                low, high, share, when = even_rows(when, track, fps)
                origin = low
                number = {k: v[low] + share * (v[high] - v[low]) for k, v in number.items()}
                sets, who = (tables.Words(one.entries, one.number[low]) for one in (sets, who))
                read_as += f", irregular clock resampled to {fps:g} Hz"
            fps, frames, start = frames_at(path, when, fps, sets.number, table.place)
        if time is None and stated is None and clock not in word:
            check_rate(path, clock, fps)
    tracks = []
    for at, name in enumerate(sets.entries):
        own: Any = np.flatnonzero(sets.number == at) if len(sets.entries) > 1 else slice(None)
        individuals, columns = list(pairs), list[Any](range(len(pairs)))
        if individual:
            ids = sorted(np.unique(who.number[own]), key=lambda i: _natural(who.entries[i]))
            individuals = [who.entries[i] for i in ids]
            column_of = np.zeros(len(who.entries), dtype=np.int64)
            column_of[ids] = np.arange(len(ids))
            columns = [column_of[who.number[own]]]
        shape = (int(frames[own].max()) + 1, len(individuals))
        _check_extent(table, name, shape, frames[own], origin[own])
        positions = np.full((*shape, 1, 2), np.nan)
        more_of = {key: np.full(shape, np.nan) for key in extra}
        for column, (a, b) in zip(columns, pairs.values(), strict=True):
            cell = frames[own] * shape[1] + column
            if column is columns[0]:
                _refuse_twice(table, name, cell, individuals)
            positions.reshape(-1, 2)[cell, 0] = number[a][own]
            positions.reshape(-1, 2)[cell, 1] = number[b][own]
            for key, values in more_of.items():
                values.reshape(-1)[cell] = number[extra[key]][own]
        confidence = more_of.pop(CONFIDENCE, None)
        tracks.append(
            Tracks(
                recording=name,
                individuals=tuple(individuals),
                positions=positions,
                frame_rate=fps,
                confidence=None if confidence is None else confidence[:, :, None],
                signals=more_of,
                start=float(start[at]),
                provenance={"file": path.name, "read_as": read_as},
                **more,
            )
        )
    return tracks


def wide_columns(table: tables.Table, found: Columns) -> Pairs:
    """Return pairs of an x and a y; a lone x and y where no animal is named."""
    if found.individual is not None or {"individual", "x"} & set(found.unclear):
        return {}  # of rows of several individuals, or of points that might be taken for them
    if found.x is not None and found.y is not None:
        return {LONE: [found.x, found.y]}
    known = {one.bare: one.column for one in parsed_names(table.names)}
    if len(known) < len(table.names):
        known = {name: name for name in table.names}
    return {who: [known[x], known[y]] for who, (x, y) in pairs_of(list(known)).items()}


def _refuse_lone(path: Path, names: list[str]) -> None:
    """Refuse an x without its y, whose animal would be left out silently."""
    joined = any(re.match(r"x[^\W\d_]", x) for x, _ in pairs_of(names).values())  # as in xmale
    after = r"(?=.)" if joined else r"(?=[_ .]|\d+$)"
    for name in names:
        partners = [re.sub(f"^{own}{after}", other, name) for own, other in ("xy", "yx")]
        if ending := re.fullmatch(r"(.+[_ .])([xy])", name):
            partners.append(ending[1] + ("y" if ending[2] == "x" else "x"))
        for partner in partners:
            require(
                partner in names,
                f"{path}: it has a column {name!r} and no {partner!r}: correct the header, or "
                "name the pairs by the option columns",
            )


def _frame_numbers(table: tables.Table, column: str, frames: NDArray[np.float64]) -> Whole:
    bad = ~((frames >= 0) & (frames == np.floor(frames)) & (frames < LARGEST_FRAME))
    if bad.any():
        at = int(bad.argmax())
        raise InputError(
            f"{table.path}: {table.place(at)}, column {column!r} holds {frames[at]:g}: give whole "
            "numbers from 0"
        )
    return frames.astype(np.int64)


def _check_extent(
    table: tables.Table, recording: str, shape: tuple[int, int], frames: Whole, rows: Whole
) -> None:
    """Refuse a frame so late that the recording would take more memory than the file may ask."""
    size = shape[0] * shape[1] * 16
    if size > allowed_bytes(table.path.stat().st_size):
        last = int(frames.argmax())
        raise InputError(
            f"{table.path}: {table.place(int(rows[last]))} is of frame {frames[last]}, with which "
            f"recording {recording} would take {size / 2**20:,.0f} MiB, more "
            f"than {EXPANSION} times the file: correct it"
        )


def _refuse_twice(table: tables.Table, recording: str, cell: Whole, individuals: list[str]) -> None:
    twice = np.flatnonzero(np.bincount(cell) > 1)
    if len(twice):
        frame, who = divmod(int(twice[0]), len(individuals))
        raise InputError(
            f"{table.path}: {recording}, frame {frame}, {individuals[who]} has two rows: drop the "
            "duplicate, or name the recording column"
        )


def _natural(name: str) -> tuple[tuple[int, int, str], ...]:
    """Sort key under which 2 comes before 10."""
    pieces = re.findall(r"\d+|\D+", name)
    return tuple((0, int(p), "") if p.isdecimal() else (1, 0, p) for p in pieces)
