"""Tables of text, Excel or Parquet: a row per frame and individual, or a row per frame.

Columns are found by their names or named by options. A table may hold several recordings, told
apart by a column. The frame rate comes from ``fps``, or from a column of times.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from animarl_envs.demos.episode import HEADING
from animarl_envs.errors import InputError
from animarl_envs.files import EXPANSION, allowed_bytes
from animarl_envs.importing.readers import clocks
from animarl_envs.importing.readers.columns import (
    Columns,
    find_columns,
    pairs_of,
    parsed_names,
    radians_per_unit,
    refuse_unused_pair,
    suggested_command,
)
from animarl_envs.importing.readers.registry import register_track_reader
from animarl_envs.importing.tables import (
    EXTENSIONS,
    MOST_COLUMNS,
    Progress,
    Table,
    Words,
    open_table,
    table_or_none,
)
from animarl_envs.importing.tracks import Tracks

LONE = "individual_0"  # of a table with one x and one y
Pairs = dict[str, list[str]]
Whole = NDArray[np.int64]


def _is_long(path: Path) -> bool:
    table = table_or_none(path)
    return table is not None and find_columns(table).is_long


def _is_wide(path: Path) -> bool:
    table = table_or_none(path)
    if table is None or len(table.names) > MOST_COLUMNS:
        return table is not None
    return len(wide_columns(table, find_columns(table))) > 0


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
    clock = clock if frame is None or fps is None else None
    stated = time_unit or (found.time_unit if time is None else "") or None
    numbers = [name for name in (frame, x, y, confidence, heading) if name]
    number, word, when = _read_columns(
        table, numbers, [individual, recording], clock, stated, progress
    )
    lone = np.zeros(len(number[x]), dtype=np.int64)
    who = word.get(individual or "") or Words([LONE], lone)
    sets = word.get(recording or "") or Words([path.stem], lone)
    _, track = np.unique(sets.number * len(who.entries) + who.number, return_inverse=True)
    frames = lone if frame is None else _frame_numbers(table, frame, number[frame])
    start = np.zeros(len(sets.entries))
    if when is not None and clock is not None:
        if frame is not None:
            fps = clocks.rate_of_frames(path, frames, when, sets.number)
        else:
            clocks.refuse_times_going_back(path, when, track, table.place)
            fps, frames, start = clocks.frames_at(path, when, fps, sets.number, table.place)
        if time is None and stated is None and clock not in word:
            clocks.check_rate(path, clock, fps)
    tracks = []
    for at, name in enumerate(sets.entries):
        rows = np.flatnonzero(sets.number == at)
        own = sorted(np.unique(who.number[rows]), key=lambda i: _natural(who.entries[i]))
        individuals = [who.entries[i] for i in own]
        column = np.argsort(own)[np.searchsorted(np.sort(own), who.number[rows])]
        cell = _cells(table, name, individuals, frames, rows, column)
        shape = (int(frames[rows].max()) + 1, len(individuals))
        columns = {HEADING: number[heading] * to_radians} if heading else {}
        columns |= {"x": number[x], "y": number[y]}
        columns |= {"confidence": number[confidence]} if confidence else {}
        spread = {}
        for key, values in columns.items():
            spread[key] = np.full(shape, np.nan)
            spread[key].ravel()[cell] = values[rows]
        tracks.append(
            Tracks(
                recording=name,
                individuals=tuple(individuals),
                positions=np.stack([spread["x"], spread["y"]], axis=2)[:, :, None],
                frame_rate=fps,
                unit=unit or found.unit or "px",
                y_down=y_down,
                confidence=spread["confidence"][:, :, None] if confidence else None,
                signals={HEADING: spread[HEADING]} if heading else {},
                start=float(start[at]),
                provenance={"file": path.name, "read_as": table.description},
            )
        )
    return tracks


@register_track_reader(
    "wide-table",
    "a row per frame (CSV, TSV, text, Excel, Parquet); columns x_NAME, y_NAME, or pairs by option",
    sniff=_is_wide,
    extensions=EXTENSIONS,
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
    progress: Progress = None,
) -> list[Tracks]:
    """Read one or more recordings. ``columns`` maps each individual to its x and y column.

    Without ``columns``, pairs such as ``x_male y_male``, ``male_x male_y`` or ``x1 y1`` are taken.
    A column of times gives the frame rate and must run evenly; one of frames must rise by one from
    row to row; one of recordings tells them apart.
    """
    table = open_table(path, encoding, sheet, decimal)
    table.check_names()
    found = find_columns(table)
    pairs = columns or wide_columns(table, found)
    if columns is None and found.x is not None:
        refuse_unused_pair(table, found)
    if columns is None and (found.x is None or len(pairs) > 1):
        _refuse_lone(path, [one.bare for one in parsed_names(table.names)])
    if not pairs or any(len(pair) != 2 for pair in pairs.values()):
        raise InputError(
            f"{path}: it has no pairs of x and y columns: name them, such as "
            "columns: {male: [mx, my], female: [fx, fy]}"
        )
    clock, frame = time or (found.time if fps is None else None), frame or found.frame
    recording = recording or found.recording
    stated = time_unit or (found.time_unit if time is None else "") or None
    numbers = [name for pair in pairs.values() for name in pair] + ([frame] if frame else [])
    number, word, when = _read_columns(table, numbers, [recording], clock, stated, progress)
    bodies = np.stack([np.column_stack([number[a], number[b]]) for a, b in pairs.values()], axis=1)
    units = {one.column: one.unit for one in parsed_names(table.names, table.layout.units)}
    sets = word.get(recording or "") or Words([path.stem], np.zeros(len(bodies), dtype=np.int64))
    tracks = []
    for at in dict.fromkeys(sets.number.tolist()):
        rows = np.flatnonzero(sets.number == at)

        def place(row: int, rows: Whole = rows) -> str:
            return table.place(int(rows[row]))

        rate, start = fps, 0.0
        if frame is not None:
            clocks.refuse_uneven_frames(path, number[frame][rows], place)
        if when is not None and clock is not None:
            rate = fps or clocks.even_rate(path, when[rows], place)
            start = float(when[rows[0]])
            if time is None and stated is None and clock not in word:
                clocks.check_rate(path, clock, rate)
        tracks.append(
            Tracks(
                recording=sets.entries[at],
                individuals=tuple(pairs),
                positions=bodies[rows][:, :, None],
                frame_rate=rate,
                start=start,
                unit=unit or units[next(iter(pairs.values()))[0]] or "px",
                y_down=y_down,
                provenance={"file": path.name, "read_as": table.description},
            )
        )
    return tracks


def _read_columns(
    table: Table,
    numbers: list[str],
    words: Sequence[str | None],
    clock: str | None,
    time_unit: str | None,
    progress: Progress,
) -> tuple[dict[str, NDArray[np.float64]], dict[str, Words], NDArray[np.float64] | None]:
    """Columns of numbers and of words, and times [s] if there is a clock."""
    texts = [name for name in words if name]
    if clock is not None:
        (texts if clock in table.layout.words_in else numbers).append(clock)
    number, word = table.columns(numbers, texts, progress)
    if clock is None:
        return number, word, None
    times = word[clock] if clock in word else number[clock]
    return number, word, clocks.seconds(table.path, clock, times, time_unit)


def wide_columns(table: Table, found: Columns) -> Pairs:
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
            if partner not in names:
                raise InputError(
                    f"{path}: it has a column {name!r} and no {partner!r}: correct the header, or "
                    "name the pairs by the option columns"
                )


def _frame_numbers(table: Table, column: str, frames: NDArray[np.float64]) -> Whole:
    bad = ~((frames >= 0) & (frames == np.floor(frames)) & (frames < clocks.LARGEST_FRAME))
    if bad.any():
        at = int(bad.argmax())
        raise InputError(
            f"{table.path}: {table.place(at)}, column {column!r} holds {frames[at]:g}: give whole "
            "numbers from 0"
        )
    return frames.astype(np.int64)


def _cells(
    table: Table, recording: str, individuals: list[str], frames: Whole, rows: Whole, column: Whole
) -> Whole:
    """Where the rows of a recording lie in an array ``(frames, individuals)``, laid flat."""
    own, count = frames[rows], len(individuals)
    last = int(own.max())
    if (last + 1) * count * 16 > allowed_bytes(table.path.stat().st_size):
        raise InputError(
            f"{table.path}: {table.place(int(rows[own.argmax()]))} is of frame {last}, with which "
            f"recording {recording} would take {(last + 1) * count * 16 / 2**20:,.0f} MiB, more "
            f"than {EXPANSION} times the file: correct it"
        )
    cell = own * count + column
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
