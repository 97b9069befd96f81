"""DeepLabCut's predictions, ``.csv`` and ``.h5``.

A header of three levels (scorer, bodyparts, coords) or four (scorer, individuals, bodyparts,
coords); each body part has x, y and likelihood. The ``.h5`` keeps its header in a pickle, which is
opened by the restricted unpickler only: pandas reads such files with PyTables, which opens every
pickle that it finds in an attribute.
"""

import contextlib
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from animarl_envs.array_types import Floats
from animarl_envs.demos.episode import refusing_damage
from animarl_envs.errors import InputError, MissingExtraError, require
from animarl_envs.importing import tables
from animarl_envs.importing.clock import Place, refuse_uneven_frames
from animarl_envs.importing.hdf import is_hdf, open_hdf, read_dataset
from animarl_envs.importing.plain_pickle import load_plain
from animarl_envs.importing.readers.registry import numbers, register_track_reader
from animarl_envs.importing.tracks import LONE, Tracks

Column = tuple[str, str, str]  # individual, body part, coordinate
COORDINATES = ("x", "y", "likelihood")
UNIQUE = "single"  # DeepLabCut's "individual" that holds landmarks, such as corners of the arena


def _is_deeplabcut(path: Path) -> bool:
    if is_hdf(path):
        with (
            contextlib.suppress(InputError, MissingExtraError),
            refusing_damage(path),
            open_hdf(path) as file,
        ):
            return _group_of_table(file) is not None
        return False
    table = None if path.suffix.lower() in tables.PARQUET else tables.table_or_none(path)
    if table is None:
        return False
    first, second, *_ = table.first_lines(2)
    return first[:1] == ["scorer"] and second[:1] in (["individuals"], ["bodyparts"])


@register_track_reader(
    "deeplabcut",
    "DeepLabCut predictions (.csv, .h5), single- or multi-animal",
    sniff=_is_deeplabcut,
    extensions=(".h5", ".hdf5", *tables.EXTENSIONS),
)
def read_deeplabcut(path: Path, fps: float | None = None) -> list[Tracks]:
    """Read all body parts with their likelihood, in pixels; the files hold no frame rate.

    Frames may begin at any number. The unique body parts of a project with several animals are
    landmarks: they are left out, and named as not used.
    """
    columns, frames, values = _read_hdf(path) if is_hdf(path) else read_dlc_table(path)[1:]
    individuals = tuple(dict.fromkeys(column[0] for column in columns))
    landmarks = [part for owner, part, _ in columns if owner == UNIQUE and len(individuals) > 1]
    if landmarks:
        individuals = tuple(name for name in individuals if name != UNIQUE)
    parts = tuple(dict.fromkeys(part for owner, part, _ in columns if owner in individuals))
    stacked = np.full((len(values), len(individuals), len(parts), 3), np.nan)
    for (owner, part, coordinate), column in zip(columns, values.T, strict=True):
        if owner in individuals:
            place = individuals.index(owner), parts.index(part), COORDINATES.index(coordinate)
            stacked[:, *place] = column
    unused = [f"{part} (a unique body part)" for part in dict.fromkeys(landmarks)]
    return [
        Tracks(
            recording=path.stem,
            individuals=individuals,
            keypoints=parts,
            positions=stacked[..., :2],
            start=int(frames[0]),
            frame_rate=fps,
            y_down=True,
            confidence=stacked[..., 2],
            provenance={"file": path.name, "tracker": "DeepLabCut"}
            | ({"columns_not_used": unused} if unused else {}),
        )
    ]


def read_dlc_table(path: Path) -> tuple[tables.Table, list[Column], Floats, Floats]:
    """Return a table, its columns, the frame numbers, and the values ``(frames, columns)``."""
    layout = tables.open_table(path)
    rows = layout.first_lines(4)
    header = rows[: 3 if rows[2][:1] == ["coords"] else 4]
    levels = [row[0] if row else "" for row in header]
    if [*levels[:1], *levels[-2:]] != ["scorer", "bodyparts", "coords"] or (
        levels[1:-2] not in ([], ["individuals"])
    ):
        raise InputError(
            f"{path}: its header rows are {', '.join(levels)}, not scorer, (individuals,) "
            "bodyparts, coords: check --source"
        )
    columns = _columns(path, [row[1:] for row in header[1:]])
    names = ("frame", *map(" ".join, columns))
    table = replace(layout, names=names, units=(), first=len(header), words_in=())
    number, _ = table.columns(names)
    _check_frames(path, number["frame"], table.place)
    return table, columns, number["frame"], np.column_stack([number[name] for name in names[1:]])


def _group_of_table(file: Any) -> str | None:
    """Return the group of a file that holds predictions: pandas lets programs choose its name."""
    for name, group in file.items():
        header = group.attrs.get("non_index_axes")
        if name.startswith("df_with_missing") or (
            isinstance(header, bytes) and b"likelihood" in header
        ):
            return str(name)
    return None


def _read_hdf(path: Path) -> tuple[list[Column], Floats, Floats]:
    with open_hdf(path) as file:
        group = _group_of_table(file)
        require(
            group is not None and "table" in file[group],
            f"{path}: it is not stored as a table: export the predictions as .csv",
        )
        table = read_dataset(path, file, f"{group}/table")
        header = file[group].attrs.get("non_index_axes")
        labels = load_plain(bytes(header if isinstance(header, bytes) else b""), str(path))
    try:
        names = [tuple(str(part) for part in column) for column in labels[0][1]]
        levels = [list(level) for level in zip(*names, strict=True)][1:]
        (block,) = (name for name in table.dtype.names or () if name.startswith("values_block"))
        values = table[block].reshape(len(table), -1)
    except (TypeError, IndexError, KeyError, ValueError) as error:
        raise InputError(f"{path}: its header is not DeepLabCut's ({error}): check it") from None
    frames = np.asarray(table["index"], np.float64).ravel()
    _check_frames(path, frames, lambda row: f"row {row}")
    columns = _columns(path, levels)
    return columns, frames, numbers(path, "its table", values, "frames", len(names))


def _check_frames(path: Path, frames: Floats, place: Place) -> None:
    """Refuse rows that do not follow each other, from a first frame of any number."""
    counts = len(frames) > 0 and frames[0] >= 0 and frames[0] == np.floor(frames[0])
    refuse_uneven_frames(path, frames, place, first=frames[0] if counts else 0)


def _columns(path: Path, levels: Sequence[Sequence[str]]) -> list[Column]:
    """Return (individual, body part, coordinate) of each column; levels without the scorer."""
    if len(levels) == 2:
        levels = [[LONE] * len(levels[0]), *levels]
    same = len(levels) == 3 and len({len(level) for level in levels}) == 1
    require(same, f"{path}: the rows of its header differ in length: copy the file again")
    columns = [(a, b, c) for a, b, c in zip(*levels, strict=True)]
    once = len(set(columns)) == len(columns) > 0
    require(once, f"{path}: a column appears twice in its header: drop the duplicate")
    coordinates: dict[tuple[str, str], set[str]] = {}
    for owner, part, coordinate in columns:
        coordinates.setdefault((owner, part), set()).add(coordinate)
    for (owner, part), own in coordinates.items():
        require(
            {"x", "y"} <= own <= set(COORDINATES),
            f"{path}: {part!r} of {owner!r} has columns {', '.join(sorted(own))}, not x, "
            "y and likelihood: correct the header",
        )
    return columns
