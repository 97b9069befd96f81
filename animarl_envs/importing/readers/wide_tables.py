"""Wide tables: a row per frame, a pair of columns per individual; the same files as long ones."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from animarl_envs.errors import InputError
from animarl_envs.importing.readers.clocks import (
    check_rate,
    even_rate,
    refuse_uneven_frames,
    seconds,
)
from animarl_envs.importing.readers.habits import (
    Columns,
    columns_by_habit,
    named,
    pairs_of,
    refuse_left_over,
)
from animarl_envs.importing.readers.layouts import names_by_look
from animarl_envs.importing.readers.parquet import is_parquet, parquet_names
from animarl_envs.importing.readers.registry import register_track_reader
from animarl_envs.importing.readers.tables import EXTENSIONS, LONE, Progress, table_layout
from animarl_envs.importing.readers.tabular import MOST_COLUMNS, check_header, line_of, pieces
from animarl_envs.importing.tracks import Tracks


def _is_wide(path: Path) -> bool:
    names = list(parquet_names(path) if is_parquet(path) else names_by_look(path))[:MOST_COLUMNS]
    return len(wide_columns(names, columns_by_habit(names))) > 0


@register_track_reader(
    "wide-table",
    "a row per frame (CSV, TSV, text, Excel, Parquet); columns x_NAME, y_NAME, or pairs by option",
    sniff=_is_wide,
    extensions=EXTENSIONS,
    generic=True,
)
def read_wide_table(
    path: Path,
    columns: dict[str, list[str]] | None = None,
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
    """One or more recordings. ``columns`` maps each individual to its x and y column.

    Without ``columns``, pairs such as ``x_male y_male``, ``male_x male_y`` or ``x1 y1`` are taken.
    A column of times gives the frame rate and must run evenly; one of frames must rise by one from
    row to row; one of recordings tells them apart.
    """
    layout = table_layout(path, encoding, sheet, decimal)
    header = list(layout.names)
    check_header(path, header)
    habit = columns_by_habit(header, layout.units)
    found = columns or wide_columns(header, habit)
    if columns is None and habit.x is not None:
        refuse_left_over(path, header, habit)
    if columns is None and (habit.x is None or len(found) > 1):
        _refuse_lone(path, [one.bare for one in named(header)])
    if not found or any(len(pair) != 2 for pair in found.values()):
        raise InputError(
            f"{path}: it has no pairs of x and y columns: name them, such as "
            "columns: {male: [mx, my], female: [fx, fy]}"
        )
    by_habit = time is None
    clock = time or habit.time
    frame = frame or habit.frame
    recording = recording or habit.recording
    words_of_time = clock is not None and clock in layout.words_in
    wanted = [name for pair in found.values() for name in pair]
    wanted += [name for name in (clock, frame, recording) if name]
    text = [recording] if recording else []
    text += [clock] if clock is not None and words_of_time else []
    parts: list[dict[str, NDArray[Any]]] = list(pieces(path, wanted, text, progress, layout))
    if not parts or not sum(len(part[wanted[0]]) for part in parts):
        raise InputError(f"{path}: it has a header but no rows: check the file")
    table = {name: np.concatenate([part[name] for part in parts]) for name in dict.fromkeys(wanted)}
    bodies = np.stack([np.column_stack([table[a], table[b]]) for a, b in found.values()], axis=1)
    units = {one.column: one.unit for one in named(header, layout.units)}
    own_unit = unit or units[next(iter(found.values()))[0]] or "px"
    tracks = []
    names = table[recording] if recording else np.full(len(bodies), path.stem, dtype=object)
    for name in dict.fromkeys(names.tolist()):
        mine = names == name
        rows = np.flatnonzero(mine)

        def place(row: int, rows: NDArray[np.intp] = rows) -> str:
            return line_of(path, layout, int(rows[row]))

        rate, start = fps, 0.0
        if frame is not None:
            refuse_uneven_frames(path, table[frame][mine], place)
        if clock is not None and (time is not None or fps is None):
            stated = time_unit or (habit.time_unit if by_habit else "") or None
            when = seconds(path, clock, table[clock][mine], stated)
            rate, start = fps or even_rate(path, when, place), float(when[0])
            if by_habit and stated is None and not words_of_time:
                check_rate(path, clock, rate)
        tracks.append(
            Tracks(
                recording=str(name), individuals=tuple(found), positions=bodies[mine][:, :, None],
                frame_rate=rate, start=start, unit=own_unit, y_down=y_down,
                provenance={"file": path.name, "read_as": layout.words},
            )
        )  # fmt: skip
    return tracks


def wide_columns(names: list[str], habit: Columns) -> dict[str, list[str]]:
    """Pairs of columns that differ in an x and a y; a lone x and y where no animal is named."""
    if habit.individual is not None or {"individual", "x"} & set(habit.unclear):
        return {}  # of rows of several individuals, or of points that might be taken for them
    if habit.x is not None and habit.y is not None:
        return {LONE: [habit.x, habit.y]}
    known = {one.bare: one.column for one in named(names)}
    if len(known) < len(names):
        known = {name: name for name in names}
    return {who: [known[x], known[y]] for who, (x, y) in pairs_of(list(known)).items()}


def _refuse_lone(path: Path, names: list[str]) -> None:
    """Refuse an x without its y, whose animal would be left out silently."""
    known = set(names)
    pairs = pairs_of(names).values()
    joined = any(re.match(r"x[^\W\d_]", x) for x, _ in pairs)  # as xmale, ymale
    after = r"(?=.)" if joined else r"(?=[_ .]|\d+$)"
    for name in names:
        for own, other in ("xy", "yx"):
            partner = re.sub(f"^{own}{after}", other, name)
            if partner not in known:
                raise _lone(path, name, partner)
        ending = re.fullmatch(r"(.+[_ .])([xy])", name)
        if ending and (partner := ending[1] + ("y" if ending[2] == "x" else "x")) not in known:
            raise _lone(path, name, partner)


def _lone(path: Path, name: str, partner: str) -> InputError:
    return InputError(
        f"{path}: it has a column {name!r} and no {partner!r}: mend the header, or name the pairs "
        "by the option columns"
    )
