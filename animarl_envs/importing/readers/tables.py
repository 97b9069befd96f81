"""Long tables (a row per frame and individual) and wide ones (a row per frame); CSV and Parquet.

Columns are named by options. A long table may hold several recordings, told apart by a column. The
frame rate comes from ``fps``, or from a column of times in seconds. Separators are comma, tab (in a
``.tsv``) or semicolon (where the header has no comma); ``decimal`` may be a comma.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from animarl_envs.errors import InputError
from animarl_envs.files import check_size
from animarl_envs.importing.readers.clocks import even_rate, frames_at, refuse_uneven_frames
from animarl_envs.importing.readers.registry import register_track_reader
from animarl_envs.importing.readers.tabular import (
    MOST_COLUMNS,
    check_header,
    column_names,
    numbered,
    pieces,
)
from animarl_envs.importing.tracks import Tracks

LONE = "individual_0"  # of a table with one x and one y
EXTENSIONS = (".csv", ".tsv", ".parquet", ".pq")
Progress = Callable[[float], None] | None
# Frame numbers, codes of recording and individual, positions (rows, 2), confidence.
_Part = tuple[NDArray[Any], NDArray[Any], NDArray[Any], NDArray[Any] | None]


@register_track_reader(
    "long-table",
    "a row per frame and individual (CSV, TSV, Parquet); columns frame, id, x, y by option",
    sniff=lambda path: {"frame", "id", "x", "y"} <= set(column_names(path)),
    extensions=EXTENSIONS,
    generic=True,
)
def read_long_table(
    path: Path,
    frame: str = "frame",
    individual: str = "id",
    x: str = "x",
    y: str = "y",
    confidence: str | None = None,
    recording: str | None = None,
    time: str | None = None,
    fps: float | None = None,
    unit: str = "px",
    y_down: bool = False,
    decimal: str = ".",
    progress: Progress = None,
) -> list[Tracks]:
    """One or more recordings; frames are whole numbers, missing rows are gaps.

    ``time`` names a column of seconds that stands in for ``frame``; without ``fps`` it gives the
    frame rate as well.
    """
    columns = [time or frame, individual, x, y]
    columns += [name for name in (confidence, recording) if name is not None]
    text = [name for name in (individual, recording) if name is not None]
    codes: dict[tuple[str, str], int] = {}
    parts: list[_Part] = []
    for piece in pieces(path, columns, text, progress, decimal):
        names = piece[individual]
        sets = piece[recording] if recording is not None else None
        which = _codes(codes, names, sets, path.stem)
        values = np.column_stack([piece[x], piece[y]])
        weight = piece[confidence] if confidence is not None else None
        if time is None:
            when: NDArray[Any] = _frame_numbers(path, frame, piece[frame])
        else:
            when = piece[time]
        parts.append((when, which, values, weight))
    if not parts or not codes:
        raise InputError(f"{path}: it has a header but no rows: check the file")
    if time is not None:
        rate, numbers = frames_at(path, np.concatenate([part[0] for part in parts]), fps)
        edges = np.cumsum([len(part[0]) for part in parts])[:-1]
        parts = [
            (own, *part[1:]) for own, part in zip(np.split(numbers, edges), parts, strict=True)
        ]
        fps = rate
    return _spread(path, codes, parts, fps, unit, y_down)


def _frame_numbers(path: Path, column: str, frames: NDArray[np.float64]) -> NDArray[np.int32]:
    bad = ~((frames >= 0) & (frames == np.floor(frames)) & (frames < 2**31))
    if bad.any():
        raise InputError(
            f"{path}: column {column!r} holds {frames[bad.argmax()]:g}: give whole numbers from 0"
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
) -> list[Tracks]:
    """Rows to arrays ``(frames, individuals, 1, 2)``, a Tracks per recording."""
    count = len(codes)
    last = np.full(count, -1, dtype=np.int64)
    for frames, which, _, _ in parts:
        np.maximum.at(last, which, frames)
    found = []
    for name in dict.fromkeys(recording for recording, _ in codes):
        own = {who: code for (recording, who), code in codes.items() if recording == name}
        individuals = tuple(sorted(own, key=_natural))
        frames_total = int(max(last[code] for code in own.values())) + 1
        check_size(path, frames_total * len(own) * 16, f"recording {name}")
        column = np.full(count, -1)
        column[[own[who] for who in individuals]] = np.arange(len(own))
        positions = np.full((frames_total, len(own), 1, 2), np.nan)
        weights = None
        if parts[0][3] is not None:
            weights = np.full((frames_total, len(own), 1), np.nan)
        seen = np.zeros((frames_total, len(own)), dtype=bool)
        for frames, which, values, weight in parts:
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
        found.append(
            Tracks(
                recording=name, individuals=individuals, positions=positions, frame_rate=fps,
                unit=unit, y_down=y_down, confidence=weights,
                provenance={"file": path.name},
            )
        )  # fmt: skip
    return found


@register_track_reader(
    "wide-table",
    "a row per frame (CSV, TSV, Parquet); columns x_NAME and y_NAME, or pairs by option",
    sniff=lambda path: len(_wide_columns(column_names(path)[:MOST_COLUMNS])) > 0,
    extensions=EXTENSIONS,
    generic=True,
)
def read_wide_table(
    path: Path,
    columns: dict[str, list[str]] | None = None,
    time: str | None = None,
    fps: float | None = None,
    unit: str = "px",
    y_down: bool = False,
    decimal: str = ".",
    progress: Progress = None,
) -> list[Tracks]:
    """One recording. ``columns`` maps each individual to its x and y column.

    Without ``columns``, pairs such as ``x_male y_male``, ``male_x male_y`` or ``x1 y1`` are taken.
    A column ``time`` [s] gives the frame rate and must run evenly; one that is called ``frame``
    must rise by one from row to row.
    """
    header = column_names(path)
    check_header(path, header)
    if columns is None:
        _refuse_lone(path, header)
    found = columns or _wide_columns(header)
    if not found or any(len(pair) != 2 for pair in found.values()):
        raise InputError(
            f"{path}: it has no pairs of x and y columns: name them, such as "
            "columns: {male: [mx, my], female: [fx, fy]}"
        )
    clocks = [time] if time else [name for name in ("frame",) if header.count(name) == 1]
    wanted = [name for pair in found.values() for name in pair] + clocks
    parts, clock = [], []
    for piece in pieces(path, wanted, (), progress, decimal):
        parts.append(
            np.stack([np.column_stack([piece[a], piece[b]]) for a, b in found.values()], axis=1)
        )
        clock += [piece[name] for name in clocks]
    if not parts:
        raise InputError(f"{path}: it has a header but no rows: check the file")
    if time is not None:
        fps = fps or even_rate(path, np.concatenate(clock))
    elif clocks:
        refuse_uneven_frames(path, np.concatenate(clock))
    return [
        Tracks(
            recording=path.stem, individuals=tuple(found),
            positions=np.concatenate(parts)[:, :, None], frame_rate=fps, unit=unit,
            y_down=y_down, provenance={"file": path.name},
        )
    ]  # fmt: skip


def _refuse_lone(path: Path, names: list[str]) -> None:
    """Refuse an x without its y, whose animal would be left out silently."""
    known = set(names)
    pairs = _wide_columns(names).values()
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


def _wide_columns(names: list[str]) -> dict[str, list[str]]:
    """Pairs of columns that differ in an x and a y."""
    found: dict[str, list[str]] = {}
    known = set(names)
    for name in names:
        for pattern in (r"^x[_ .]?(.+)$", r"^(.+)[_ .]x$"):
            match = re.match(pattern, name)
            if match is None:
                continue
            start = name.startswith("x")
            partner = "y" + name[1:] if start and pattern.startswith("^x") else name[:-1] + "y"
            if partner in known and partner != name:
                found[match.group(1)] = [name, partner]
                break
    return found or ({LONE: ["x", "y"]} if {"x", "y"} <= known else {})


def _natural(name: str) -> tuple[tuple[int, int, str], ...]:
    """Sort key under which 2 comes before 10."""
    pieces_of_name = re.findall(r"\d+|\D+", name)
    return tuple((0, int(p), "") if p.isdecimal() else (1, 0, p) for p in pieces_of_name)
