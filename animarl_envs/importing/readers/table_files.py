"""Tables of text, Excel or Parquet: a row per frame and individual, or a row per frame.

Columns are found by their names or named by options. A table may hold several recordings, told
apart by a column. The frame rate comes from ``fps``, or from a column of times.
"""

import contextlib
import itertools
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from animarl_envs.demos.episode import HEADING
from animarl_envs.errors import InputError, require
from animarl_envs.files import EXPANSION, allowed_bytes
from animarl_envs.importing import tables
from animarl_envs.importing.clock import (
    LARGEST_FRAME,
    UNEVEN,
    even_rows,
    fit_clock,
    irregular_rate,
    refuse_times_going_back,
    seconds,
)
from animarl_envs.importing.readers.columns import (
    CLOCKS,
    Columns,
    find_columns,
    frame_numbers,
    pairs_of,
    parsed_names,
    radians_per_unit,
    refuse_two_rows,
    refuse_unused_pair,
    suggested_command,
)
from animarl_envs.importing.readers.registry import register_track_reader
from animarl_envs.importing.tracks import LONE, RATE_FROM, TOGETHER_AT_MOST, TRACKS, Tracks

CONFIDENCE = "confidence"
SPARSE, SMALL = 100, 2**20  # cells of frame and individual: so many a row, and in all
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
    recording = recording or found.recording
    found = replace(
        found.with_clock(frame, time, time_unit),
        individual=individual or found.individual or (None if recording else "id"),
        recording=recording,
        confidence=confidence or found.confidence,
        unit=unit or found.unit,
    )
    if found.frame is None and found.time is None:
        found = replace(found, frame="frame")  # whose absence is then said
    pairs = {LONE: [x or found.x or "x", y or found.y or "y"]}
    tracks = _recordings(table, found, pairs, fps, y_down, progress, heading)
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
    if not (frame or time or found.frame or found.time):
        _refuse_hidden_clock(table, found, pairs)
    units = {one.column: one.unit for one in parsed_names(table.names, table.units)}
    found = replace(
        found.with_clock(frame, time, time_unit),
        individual=None,
        recording=recording or found.recording,
        confidence=None,
        unit=unit or units.get(next(iter(pairs.values()))[0], ""),
    )
    return _recordings(table, found, pairs, fps, y_down, progress)


def _recordings(
    table: tables.Table,
    found: Columns,
    pairs: Pairs,
    fps: float | None,
    y_down: bool,
    progress: tables.Progress,
    heading: str | None = None,
) -> list[Tracks]:
    """Tracks of each recording: of individuals by a column, or else of the pairs of columns."""
    path, read_as = table.path, table.description
    known = {CONFIDENCE: found.confidence, HEADING: heading}
    extra = {key: column for key, column in known.items() if column}
    clock = found.time if found.frame is None or fps is None else None
    numbers = [*itertools.chain(*pairs.values()), *extra.values(), found.frame]
    texts = [found.individual, found.recording]
    (texts if clock in table.words_in else numbers).append(clock)
    used = {*numbers, *texts, found.time}
    told: dict[str, Any] = {"file": path.name}
    if unused := [name for name in table.names if name and name not in used]:
        told["columns_not_used"] = unused
    number, word = table.columns([*filter(None, numbers)], [*filter(None, texts)], progress)
    zeros = np.zeros(len(next(iter(number.values()))), dtype=np.int64)
    whole = tables.Words([Path(path.name.removesuffix(tables.PACKED)).stem], zeros)
    sets = word.get(found.recording or "", whole)
    recording, row = sets.number, np.arange(len(zeros))  # of each, where it is in the table
    names = word[found.individual].entries if found.individual else list(pairs)[:1]
    who = word[found.individual].number if found.individual else zeros
    start = np.zeros(len(sets.entries))
    if found.frame is not None:
        frames = frame_numbers(table, found.frame, number[found.frame])
    elif clock is None:
        frames = zeros.copy()
        for at in range(len(sets.entries)):
            frames[recording == at] = np.arange(np.count_nonzero(recording == at))
    if clock is not None:
        time_unit = found.time_unit or parsed_names([clock], table.units)[0].unit
        when = seconds(path, clock, word.get(clock) or number[clock], time_unit or None)
        unsaid = None if time_unit or clock in word else clock
        told[RATE_FROM] = (
            f"the column {clock} ({'times of day' if clock in word else time_unit or 's'})"
        )
        if found.frame is not None:
            fps = fit_clock(path, when, recording, table.place, frames, unsaid=unsaid).rate
        else:
            track = recording * len(names) + who
            refuse_times_going_back(path, when, track, table.place)
            if fps is None and (fps := irregular_rate(path, when, track)) is not None:
                require(
                    HEADING not in extra,
                    f"{path}: its clock is irregular, and headings are not resampled: give rows at "
                    "even times",
                )
                row, after, share, when = even_rows(when, track, fps)
                number = {k: v[row] + share * (v[after] - v[row]) for k, v in number.items()}
                recording, who = recording[row], who[row]
                read_as += f", irregular clock resampled to {fps:g} Hz"
                told[RATE_FROM] += ", irregular and resampled"
            fitted = fit_clock(path, when, recording, table.place, rate=fps, unsaid=unsaid)
            fps, frames, start = fitted.rate, fitted.frames, fitted.first
    entries = sets.entries
    if found.individual and _is_sparse(frames, recording, len(names)):
        together = np.unique(frames * len(entries) + recording, return_counts=True)[1]
        kept, recording = np.unique(recording * len(names) + who, return_inverse=True)
        told |= {TRACKS: len(kept), TOGETHER_AT_MOST: int(together.max())}
        start = start[kept // len(names)]
        entries = [f"{entries[k // len(names)]}/{names[k % len(names)]}" for k in kept]
        found, who = replace(found, individual=None), np.zeros_like(who)
    tracks = []
    for at, name in enumerate(entries):
        own: Any = np.flatnonzero(recording == at) if len(entries) > 1 else slice(None)
        individuals, place = list(pairs), zeros[:1]
        if found.individual:
            individuals, place = _in_natural_order(names, who[own])
        first = int(frames[own].min())
        shape = (int(frames[own].max()) + 1 - first, len(individuals))
        _check_extent(table, name, shape, frames[own], row[own])
        cell = (frames[own] - first) * len(individuals) + place[who[own]]
        refuse_two_rows(table, name, cell, individuals, row[own], first)
        positions = np.full((*shape, 1, 2), np.nan)
        more_of = {key: np.full(shape, np.nan) for key in extra}
        for further, (x, y) in enumerate(pairs.values()):
            places = positions.reshape(-1, 2)[further:]
            places[cell, 0], places[cell, 1] = number[x][own], number[y][own]
        for key, values in more_of.items():
            values.reshape(-1)[cell] = number[extra[key]][own]
        confidence = more_of.pop(CONFIDENCE, None)
        tracks.append(
            Tracks(
                recording=name,
                individuals=tuple(individuals),
                positions=positions,
                frame_rate=fps,
                unit=found.unit or "px",
                y_down=y_down,
                confidence=None if confidence is None else confidence[:, :, None],
                signals=more_of,
                start=first,
                start_time=float(start[at]),
                provenance=told | {"read_as": read_as},
            )
        )
    return tracks


def _in_natural_order(entries: list[str], numbers: Whole) -> tuple[list[str], Whole]:
    """Return those entries that occur, 2 before 10, and the place of each entry among these."""

    def pieces(number: int) -> list[tuple[int, int, str]]:
        parts = re.findall(r"\d+|\D+", entries[number])
        return [(0, int(part), "") if part.isdecimal() else (1, 0, part) for part in parts]

    order = sorted(np.unique(numbers).tolist(), key=pieces)
    place = np.zeros(len(entries), dtype=np.int64)
    place[order] = np.arange(len(order))
    return [entries[number] for number in order], place


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


def _refuse_hidden_clock(table: tables.Table, found: Columns, pairs: Pairs) -> None:
    """Refuse a table whose rows would be taken for one frame after the other, and are not."""
    unclear = ", ".join(part for part in CLOCKS if part in found.unclear)
    require(
        not unclear,
        f"{table.path}: several of its columns may be of {unclear}: name the one by that option",
    )
    first, values = table.names[0], np.zeros(0)
    if first not in {found.recording, *table.words_in, *itertools.chain(*pairs.values())}:
        with contextlib.suppress(InputError):  # it holds more than numbers
            values = table.columns([first])[0][first]
    step = np.diff(values)
    if len(step) and (step > 0).all():
        steps = step / np.median(step)
        row = int(steps.argmax()) + 1
        require(
            round(steps.max()) == 1 or (np.abs(steps - np.rint(steps)) > UNEVEN).any(),
            f"{table.path}: its first column, {first!r}, rises as frames or times do, and before "
            f"{table.place(row)} some are missing: name it in the file, or by the option frame or "
            "time",
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
