"""Tables of text, Excel or Parquet: a row per frame and individual, or a row per frame.

Columns are found by their names or named by options. A table may hold several recordings, told
apart by a column. The frame rate comes from ``fps``, or from a column of times.
"""

import contextlib
import itertools
import re
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from animarl_envs.demos.episode import HEADING
from animarl_envs.errors import InputError, require
from animarl_envs.importing import tables
from animarl_envs.importing.clock import UNEVEN
from animarl_envs.importing.readers.registry import register_track_reader
from animarl_envs.importing.table_columns import (
    CLOCKS,
    USUAL_NAMES,
    Columns,
    Position,
    find_columns,
    is_idtracker,
    pairs_of,
    parsed_names,
    radians_per_unit,
    unit_of,
)
from animarl_envs.importing.table_rows import tracks_of_rows
from animarl_envs.importing.tracks import CENTROID, Tracks

Pairs = Mapping[str, Sequence[str] | Mapping[str, Sequence[str]]]

EXAMPLE_RATE = 30  # [Hz], in commands that are suggested


def _is_long(path: Path) -> bool:
    table = tables.table_or_none(path)
    return table is not None and find_columns(table).is_long


def _is_wide(path: Path) -> bool:
    table = tables.table_or_none(path)
    if table is None or len(table.names) > tables.MOST_COLUMNS:
        return table is not None
    return find_columns(table).is_wide


@register_track_reader(
    "long-table",
    "a row per frame and individual (CSV, TSV, text, Excel, Parquet); columns by habit or option",
    sniff=_is_long,
    extensions=tables.EXTENSIONS,
    generic=True,
    explain=lambda path: suggested_command(path),
)
def read_long_table(
    path: Path,
    frame: str | None = None,
    individual: str | None = None,
    keypoint: str | None = None,
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

    ``time`` names a column of times (numbers in ``time_unit``, or ISO 8601)
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
    columns = find_columns(table)
    given = {
        "frame": frame or time,
        "individual": individual,
        "keypoint": keypoint,
        "recording": recording,
        "arena": recording,
    }
    if any(given.get(part, part) is None for part in columns.unclear):
        raise InputError(f"{path}: {describe_columns(table)}")
    if x or y:
        plain = next(
            (one.columns for one in columns.positions if len(one.columns) == 2), ("x", "y")
        )
        columns = replace(
            columns, positions=(Position((x or plain[0], y or plain[1])),), refusal=""
        )
    require(not columns.refusal, f"{path}: {columns.refusal}")
    recording = recording or columns.recording
    by_name = [individual, columns.individual]
    if keypoint == columns.individual and keypoint is not None:
        by_name.pop()
    several = recording or columns.arena or keypoint or columns.keypoint
    columns = replace(
        columns.with_clock(frame, time, time_unit),
        individual=next(filter(None, by_name), None if several else "id"),
        keypoint=keypoint or columns.keypoint,
        recording=recording,
        arena=None if recording == columns.arena else columns.arena,
        confidence=confidence or columns.confidence,
        positions=columns.positions or (Position(("x", "y")),),
    )
    columns = replace(columns, unit=unit or unit_of(table, columns.positions))
    if columns.frame is None and columns.time is None:
        columns = replace(columns, frame="frame")  # whose absence is then said
    tracks = tracks_of_rows(table, columns, fps, y_down, progress, heading, individual is not None)
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

    Of an individual with keypoints it maps each of these, ``{a: {nose: [ax, ay]}}``; four columns
    are the left, upper, right and lower edge of a box. Without ``columns``, pairs such as ``x_male
    y_male``, ``male_x male_y`` or ``x1 y1`` are taken. Columns of frames, times and recordings are
    as of a long table; without one of frames or times each row is the next frame of its recording.
    """
    table = tables.open_table(path, encoding, sheet, decimal)
    table.check_names()
    parts = find_columns(table)
    if columns is None:
        require(not parts.refusal, f"{path}: {parts.refusal}")
        y_down = y_down or is_idtracker(table)
        if "individual" in parts.unclear:
            raise InputError(f"{path}: {describe_columns(table)}")
        first = next(iter(parts.positions), Position((), "all"))
        if len(parts.positions) > 1 or first.individual or first.keypoint != CENTROID:
            _refuse_lone(path, [one.bare for one in parsed_names(table.names)])
    else:
        parts = replace(parts, positions=_stated_positions(path, columns), tracks={})
    require(
        parts.positions,
        f"{path}: it has no pairs of x and y columns: name them, such as "
        "columns: {male: [mx, my], female: [fx, fy]}",
    )
    if not (frame or time or parts.frame or parts.time):
        _refuse_hidden_clock(table, parts)
    parts = replace(
        parts.with_clock(frame, time, time_unit),
        individual=None,
        keypoint=None,
        recording=recording or parts.recording,
        confidence=None,
        unit=unit or unit_of(table, parts.positions),
    )
    return tracks_of_rows(table, parts, fps, y_down, progress, stated=columns is not None)


def _stated_positions(path: Path, columns: Pairs) -> tuple[Position, ...]:
    """Return the positions that the option ``columns`` names."""
    positions = []
    for name, value in columns.items():
        parts = value if isinstance(value, Mapping) else {CENTROID: value}
        positions += [Position(tuple(own), str(name), str(part)) for part, own in parts.items()]
    require(
        positions and all(len(position.columns) in (2, 4) for position in positions),
        f"{path}: columns must name an x and a y column of each individual, such as "
        "columns: {male: [mx, my], female: [fx, fy]}",
    )
    return tuple(positions)


def suggested_command(path: Path) -> str | None:
    """Return a table's columns and how to say which is which; ``None`` for no table."""
    try:
        table = tables.open_table(path)
    except InputError as error:
        return str(error).removeprefix(f"{path}: ")
    return describe_columns(table) if len(table.names) > 1 else None


def describe_columns(table: tables.Table) -> str:
    """Return that it is not clear which column is which, and how to say it.

    A command is given where it reads the file.
    """
    columns, path = find_columns(table), table.path
    if columns.refusal:
        return columns.refusal
    listed = ", ".join(name or "(no name)" for name in table.names[:30])
    words = (
        f"its columns are {listed} ({table.description}), and which is which is not clear: name "
        "them by --source long-table with --option frame=COLUMN (or time), individual, x and y, or "
        "by --source wide-table --option 'columns={NAME: [X COLUMN, Y COLUMN]}'"
    )
    if options := _guess(table, columns):
        with contextlib.suppress(InputError):
            read_long_table(path, **options, fps=EXAMPLE_RATE)
            named = " ".join(f"--option {shlex.quote(f'{k}={v}')}" for k, v in options.items())
            fps = "" if "time" in options else f" --fps {EXAMPLE_RATE}"
            words += (
                f", such as: animarl import {shlex.quote(str(path))} --source long-table {named}"
                f"{fps} --out demos.npz" + " (with your frame rate)" * bool(fps)
            )
    return words


def _guess(table: tables.Table, columns: Columns) -> dict[str, str]:
    """Return options of a long table by the columns that are left, nothing where that is unclear.

    Words are names, and of two columns of numbers the first is x.
    """
    clock = {"frame": columns.frame} if columns.frame else {"time": columns.time}
    named = [*columns.positions[0].columns] if len(columns.positions) == 1 else []
    used = {
        columns.frame,
        columns.time,
        columns.recording,
        columns.arena,
        columns.individual,
        *named,
    }
    rest = [name for name in table.names if name and name not in used]
    texts = [name for name in rest if name in table.words_in]
    places = named or [name for name in rest if name not in texts]
    individual = columns.individual or (texts[0] if len(texts) == 1 else None)
    usual = {key for ranks in USUAL_NAMES.values() for rank in ranks for key in rank.split()}
    if len(places) != 2 or None in clock.values() or not (individual or columns.recording):
        return {}
    if not named and usual & {one.key for one in parsed_names(places)}:
        return {}
    options = {**clock, "individual": individual, "x": places[0], "y": places[1]}
    return {key: value for key, value in options.items() if value}


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


def _refuse_hidden_clock(table: tables.Table, columns: Columns) -> None:
    """Refuse a table whose rows are not consecutive frames."""
    unclear = ", ".join(part for part in CLOCKS if part in columns.unclear)
    require(
        not unclear,
        f"{table.path}: several of its columns may be of {unclear}: name the one by that option",
    )
    first, values = table.names[0], np.zeros(0)
    placed = itertools.chain(*(position.columns for position in columns.positions))
    if first not in {columns.recording, *table.words_in, *placed}:
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
