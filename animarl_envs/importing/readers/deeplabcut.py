"""DeepLabCut: ``.csv`` and ``.h5`` of single- and multi-animal projects.

Both have a header of three levels (scorer, bodyparts, coords) or four (scorer, individuals,
bodyparts, coords); each body part has x, y and likelihood. The ``.h5`` keeps its header in a
pickle, which is opened by the restricted unpickler only.
"""

from __future__ import annotations

import csv
import itertools
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from animarl_envs.errors import InputError
from animarl_envs.importing.readers.hdf import hdf_keys, open_hdf, read_dataset
from animarl_envs.importing.readers.registry import register_track_reader
from animarl_envs.importing.readers.tables import Table, plain_table
from animarl_envs.importing.readers.text_layout import Layout
from animarl_envs.importing.readers.unpickle import load_plain
from animarl_envs.importing.tracks import Tracks

LONE = "individual_0"
Column = tuple[str, str, str]  # individual, body part, coordinate


@register_track_reader(
    "deeplabcut",
    "DeepLabCut predictions (.csv, .h5), single- or multi-animal",
    sniff=lambda path: (
        plain_table(path).names[:1] == ("scorer",)
        or any(key.startswith("df_with_missing") for key in hdf_keys(path))
    ),
    extensions=(".csv", ".h5"),
)
def read_deeplabcut(path: Path, fps: float | None = None) -> list[Tracks]:
    """All body parts with their likelihood, in pixels; the files hold no frame rate."""
    if path.suffix.lower() == ".csv":
        columns, values = read_deeplabcut_csv(path)
    else:
        columns, values = _hdf(path)
    individuals = tuple(dict.fromkeys(column[0] for column in columns))
    parts = tuple(dict.fromkeys(column[1] for column in columns))
    place = {column: i for i, column in enumerate(columns)}
    stacked = np.full((len(values), len(individuals), len(parts), 3), np.nan)
    for i, name in enumerate(individuals):
        for j, part in enumerate(parts):
            for k, coordinate in enumerate(("x", "y", "likelihood")):
                if (name, part, coordinate) in place:
                    stacked[:, i, j, k] = values[:, place[name, part, coordinate]]
    return [
        Tracks(
            recording=path.stem, individuals=individuals, keypoints=parts,
            positions=stacked[..., :2], frame_rate=fps, y_down=True, confidence=stacked[..., 2],
            provenance={"file": path.name, "tracker": "DeepLabCut"},
        )
    ]  # fmt: skip


def read_deeplabcut_csv(path: Path) -> tuple[list[Column], NDArray[np.float64]]:
    """Return columns and values ``(frames, columns)`` of a table whose rows are frames 0, 1, 2."""
    with path.open(newline="", encoding="utf-8-sig") as file:
        rows = list(itertools.islice(csv.reader(file), 4))
    header = rows[: 3 if len(rows) > 2 and rows[2][:1] == ["coords"] else 4]
    levels = [row[0] if row else "" for row in header]
    if levels not in (
        ["scorer", "bodyparts", "coords"],
        ["scorer", "individuals", "bodyparts", "coords"],
    ):
        raise InputError(
            f"{path}: its header rows are {', '.join(levels)}, not scorer, (individuals,) "
            "bodyparts, coords: check --source"
        )
    columns = _columns(path, [row[1:] for row in header[1:]])
    names = ("frame", *map(" ".join, columns))
    table = Table(path, Layout(names, ("",) * len(names), first=len(header)))
    number, _ = table.columns(names)
    _check_frames(path, number["frame"], table.place)
    return columns, np.column_stack([number[name] for name in names[1:]])


def _check_frames(path: Path, frames: NDArray[np.float64], place: Callable[[int], str]) -> None:
    """Refuse a row that is not the next frame: a gap or a swap would shift time silently."""
    wrong = np.flatnonzero(frames != np.arange(len(frames)))
    if len(wrong):
        row = int(wrong[0])
        raise InputError(
            f"{path}: {place(row)} is of frame {frames[row]:g}, not {row}: give every frame from "
            "0, in order, with empty cells where nothing was tracked"
        )


def _hdf(path: Path) -> tuple[list[Column], NDArray[np.float64]]:
    with open_hdf(path) as file:
        group = next(key for key in file if key.startswith("df_with_missing"))
        if "table" not in file[group]:
            raise InputError(
                f"{path}: it is not stored as a table: export the predictions as .csv instead"
            )
        table = read_dataset(path, file, f"{group}/table")
        header = file[group].attrs.get("non_index_axes")
        if not isinstance(header, bytes):
            raise InputError(f"{path}: it has no header 'non_index_axes': check --source")
        labels = load_plain(bytes(header), str(path))
    try:
        names = [tuple(str(part) for part in column) for column in labels[0][1]]
        levels = [list(level) for level in zip(*names, strict=True)][1:]
        fields = [name for name in table.dtype.names or () if name.startswith("values_block")]
        values = np.concatenate([table[name].reshape(len(table), -1) for name in fields], axis=1)
    except (TypeError, IndexError, KeyError, ValueError) as error:
        raise InputError(f"{path}: its header is not DeepLabCut's ({error}): check it") from None
    if len(names) != values.shape[1] or len(fields) != 1:
        raise InputError(
            f"{path}: {len(names)} names for {values.shape[1]} columns: export it as .csv instead"
        )
    if values.dtype.kind not in "iuf":
        raise InputError(f"{path}: its table holds {values.dtype}, not numbers: check --source")
    _check_frames(path, np.asarray(table["index"], np.float64).ravel(), lambda row: f"row {row}")
    return _columns(path, levels), values.astype(np.float64)


def _columns(path: Path, levels: Sequence[Sequence[str]]) -> list[Column]:
    """(individual, body part, coordinate) of each column; levels without the scorer."""
    if len(levels) == 2:
        levels = [[LONE] * len(levels[0]), *levels]
    if len(levels) != 3 or len({len(level) for level in levels}) != 1 or not levels[0]:
        raise InputError(f"{path}: the rows of its header differ in length: copy the file again")
    columns = [(a, b, c) for a, b, c in zip(*levels, strict=True)]
    if len(set(columns)) != len(columns):
        raise InputError(f"{path}: a column appears twice in its header: drop the duplicate")
    found: dict[tuple[str, str], set[str]] = {}
    for who, part, coordinate in columns:
        found.setdefault((who, part), set()).add(coordinate)
    for (who, part), coordinates in found.items():
        if not {"x", "y"} <= coordinates <= {"x", "y", "likelihood"}:
            raise InputError(
                f"{path}: {part!r} of {who!r} has columns {', '.join(sorted(coordinates))}, not x, "
                "y and likelihood: correct the header"
            )
    return columns
