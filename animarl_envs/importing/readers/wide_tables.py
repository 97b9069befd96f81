"""Wide tables: a row per frame, a pair of columns per individual; the same files as long ones."""

from __future__ import annotations

import re
from functools import partial
from pathlib import Path

import numpy as np

from animarl_envs.errors import InputError
from animarl_envs.importing.readers import clocks
from animarl_envs.importing.readers.column_names import (
    Columns,
    find_columns,
    pairs_of,
    parsed_names,
    refuse_unused_pair,
)
from animarl_envs.importing.readers.long_tables import LONE
from animarl_envs.importing.readers.registry import register_track_reader
from animarl_envs.importing.readers.tables import (
    EXTENSIONS,
    MOST_COLUMNS,
    Progress,
    Table,
    open_table,
    table_or_none,
)
from animarl_envs.importing.tracks import Tracks


def _is_wide(path: Path) -> bool:
    table = table_or_none(path)
    if table is None or len(table.names) > MOST_COLUMNS:
        return table is not None
    return len(wide_columns(table, find_columns(table))) > 0


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
    clock, frame = time or found.time, frame or found.frame
    recording = recording or found.recording
    times_in_words = clock is not None and clock in table.layout.words_in
    numbers = [name for pair in pairs.values() for name in pair] + ([frame] if frame else [])
    texts = [recording] if recording else []
    if clock is not None:
        (texts if times_in_words else numbers).append(clock)
    number, word = table.columns(list(dict.fromkeys(numbers)), texts, progress)
    bodies = np.stack([np.column_stack([number[a], number[b]]) for a, b in pairs.values()], axis=1)
    units = {one.column: one.unit for one in parsed_names(table.names, table.layout.units)}
    names, which = [path.stem], np.zeros(len(bodies), dtype=np.int64)
    if recording:
        names, which = word[recording].entries, word[recording].number
    tracks = []
    for at in dict.fromkeys(which.tolist()):
        rows = np.flatnonzero(which == at)
        place = partial(_place, table, rows)
        rate, start = fps, 0.0
        if frame is not None:
            clocks.refuse_uneven_frames(path, number[frame][rows], place)
        if clock is not None and (time is not None or fps is None):
            stated = time_unit or (found.time_unit if time is None else "") or None
            column = word[clock] if times_in_words else number[clock]
            when = clocks.seconds(path, clock, column, stated)[rows]
            rate, start = fps or clocks.even_rate(path, when, place), float(when[0])
            if time is None and stated is None and not times_in_words:
                clocks.check_rate(path, clock, rate)
        tracks.append(
            Tracks(
                recording=names[at],
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


def wide_columns(table: Table, found: Columns) -> dict[str, list[str]]:
    """Return pairs of an x and a y; a lone x and y where no animal is named."""
    if found.individual is not None or {"individual", "x"} & set(found.unclear):
        return {}  # of rows of several individuals, or of points that might be taken for them
    if found.x is not None and found.y is not None:
        return {LONE: [found.x, found.y]}
    known = {one.bare: one.column for one in parsed_names(table.names)}
    if len(known) < len(table.names):
        known = {name: name for name in table.names}
    return {who: [known[x], known[y]] for who, (x, y) in pairs_of(list(known)).items()}


def _place(table: Table, rows: np.ndarray, row: int) -> str:
    return table.place(int(rows[row]))


def _refuse_lone(path: Path, names: list[str]) -> None:
    """Refuse an x without its y, whose animal would be left out silently."""
    known = set(names)
    joined = any(re.match(r"x[^\W\d_]", x) for x, _ in pairs_of(names).values())  # as in xmale
    after = r"(?=.)" if joined else r"(?=[_ .]|\d+$)"
    for name in names:
        partners = [re.sub(f"^{own}{after}", other, name) for own, other in ("xy", "yx")]
        if ending := re.fullmatch(r"(.+[_ .])([xy])", name):
            partners.append(ending[1] + ("y" if ending[2] == "x" else "x"))
        for partner in partners:
            if partner not in known:
                raise InputError(
                    f"{path}: it has a column {name!r} and no {partner!r}: correct the header, or "
                    "name the pairs by the option columns"
                )
