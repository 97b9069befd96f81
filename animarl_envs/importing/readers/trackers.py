"""Trackers: EthoVision, TRex, idtracker.ai, DeepLabCut, SLEAP, and tables that ``movement`` loads.

DeepLabCut's ``.csv`` and ``.h5`` have a header of three levels (scorer, bodyparts, coords) or four
(scorer, individuals, bodyparts, coords); each body part has x, y and likelihood. The ``.h5`` keeps
its header in a pickle, which is opened by the restricted unpickler only.

HDF5 is not handed to ``movement``: for DeepLabCut it calls ``pandas.read_hdf``, and PyTables below
that opens every pickle it finds in an attribute, which runs any code; for NWB it builds classes
that the file describes. The readers of this project open such files without either.
"""

import contextlib
import csv
import itertools
import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from animarl_envs.errors import InputError, require, require_extra
from animarl_envs.files import npz_members, read_npz
from animarl_envs.importing import tables
from animarl_envs.importing.clock import rate_of_rows, refuse_uneven_frames
from animarl_envs.importing.readers.arrays import (
    hdf_keys,
    is_hdf,
    load_plain,
    open_hdf,
    read_dataset,
)
from animarl_envs.importing.readers.registry import numbers, register_track_reader
from animarl_envs.importing.readers.table_files import read_long_table
from animarl_envs.importing.tables import Table, plain_table
from animarl_envs.importing.tracks import BODY_LENGTH, CENTROID, LONE, RATE_FROM, Tracks

ETHOVISION = "Number of header lines:"  # the first cell
ETHOVISION_CLOCKS = ("Trial time", "Recording time")
IDTRACKER_TIDY = ("frame", "time", "individual", "x", "y", "probability")
_TREX_NAME = re.compile(r"^(?P<recording>.+)_(?P<individual>(?:fish|id|agent)\d+)$")
_TREX_X = ("X#wcentroid", "X#pcentroid", "X")


def _is_ethovision(path: Path) -> bool:
    if path.suffix.lower() in tables.PARQUET:
        return False
    with contextlib.suppress(InputError, ImportError, IndexError):
        table = tables.table_or_none(
            path, tables.sheet_names(path)[0] if tables.is_workbook(path) else None
        )
        return table is not None and table.before[0][0] == ETHOVISION
    return False


@register_track_reader(
    "ethovision",
    "EthoVision exports (text, Excel): a subject per file or sheet, merged by the trial's name",
    sniff=_is_ethovision,
    extensions=tables.EXTENSIONS,
)
def read_ethovision(
    path: Path, encoding: str | None = None, progress: tables.Progress = None
) -> list[Tracks]:
    """All subjects of the file; unit and frame rate are in it. In EthoVision y grows upwards.

    Points (``X center``, ``X nose``, ``X tail``) become keypoints; what was not found is ``-``.
    """
    sheets = tables.sheet_names(path) if tables.is_workbook(path) else [None]
    return [_ethovision(tables.open_table(path, encoding, sheet), progress) for sheet in sheets]


def _ethovision(table: tables.Table, progress: tables.Progress) -> Tracks:
    path, names = table.path, table.names
    said = {row[0].rstrip(":").lower(): row[1] for row in table.before if len(row) > 1}
    points = {name[2:]: (name, "Y" + name[1:]) for name in names if re.match(r"X .", name)}
    clock = next((name for name in ETHOVISION_CLOCKS if name in names), None)
    lacking = [y for _, y in points.values() if y not in names]
    if clock is None or not points or lacking:
        what = "a time" if clock is None else (lacking or ["X center"])[0]
        raise InputError(f"{path}: it lacks the column {what!r}: export it with time, X and Y")
    wanted = [name for pair in points.values() for name in pair]
    units = {table.units[names.index(name)] for name in wanted}
    if len(units) != 1:
        raise InputError(f"{path}: its points have several units: export them in one")
    number, _ = table.columns([clock, *wanted], progress=progress)
    values = np.column_stack([number[name] for name in wanted])
    return Tracks(
        recording=said.get("trial name") or path.stem,
        individuals=(said.get("subject name") or table.sheet or "subject",),
        keypoints=tuple(points),
        positions=values.reshape(len(values), 1, -1, 2),
        frame_rate=rate_of_rows(path, number[clock], table.place),
        start_time=float(number[clock][0]),
        unit=units.pop() or "px",
        provenance={
            "file": path.name,
            "tracker": "EthoVision",
            "read_as": table.description,
            RATE_FROM: f"the column {clock}",
        },
    )


def _trex_x(members: set[str]) -> str | None:
    return next((name for name in _TREX_X if f"{name}.npy" in members), None)


@register_track_reader(
    "trex",
    "TRex exports, one NAME_fish0.npz per individual (give all files of a recording)",
    sniff=lambda path: {"frame.npy"} < npz_members(path) and _trex_x(npz_members(path)) is not None,
    extensions=(".npz",),
)
def read_trex(path: Path, fps: float | None = None, unit: str = "cm") -> list[Tracks]:
    """One individual; files of one recording are merged by their name. Missing frames are gaps."""
    arrays = read_npz(path)
    x_name = _trex_x({f"{name}.npy" for name in arrays}) or "X"
    names = ("frame", x_name, "Y" + x_name[1:])
    for name in names:
        require(name in arrays, f"{path}: it lacks the array {name!r}: export it from TRex")
    count = arrays["frame"].size
    frame, x, y = (numbers(path, name, arrays[name].ravel(), count) for name in names)
    whole = (frame >= 0) & (frame == np.floor(frame)) & (frame < 64 * len(frame) + 1e6)
    once = count > 0 and whole.all() and len(np.unique(frame)) == count
    require(once, f"{path}: frame numbers are not whole, or repeat: export the file again")
    index = frame.astype(np.int64)
    start = int(index.min())
    index = index - start
    positions = np.full((int(index.max()) + 1, 1, 1, 2), np.nan)
    positions[index, 0, 0] = np.column_stack([x, y])
    if "missing" in arrays and arrays["missing"].shape == frame.shape:
        positions[index[arrays["missing"].astype(bool)]] = np.nan
    match = _TREX_NAME.match(path.stem)
    told: dict[str, Any] = {"file": path.name, "tracker": "TRex"}
    if fps is None and "frame_rate" in arrays:
        told[RATE_FROM] = "the array frame_rate"
    if {"midline_length", "cm_per_pixel"} <= arrays.keys() and unit == "cm":
        pixels = numbers(path, "midline_length", arrays["midline_length"].ravel(), count)
        scale = _number(arrays["cm_per_pixel"]) or 1.0
        told[BODY_LENGTH] = float(
            np.nanmedian(np.where(np.isfinite(pixels), pixels, np.nan)) * scale
        )
    return [
        Tracks(
            recording=match["recording"] if match else path.stem,
            individuals=(match["individual"] if match else path.stem,),
            positions=positions, unit=unit, y_down=True, start=start,
            frame_rate=fps if fps is not None else _number(arrays.get("frame_rate")),
            provenance=told,
        )
    ]  # fmt: skip


@register_track_reader(
    "idtracker",
    "idtracker.ai trajectories (.h5, .csv)",
    sniff=lambda path: (
        (path.suffix == ".npy" and path.stem in {"trajectories", "with_gaps", "without_gaps"})
        or {"trajectories"} <= hdf_keys(path)
        or (path.suffix == ".csv" and _is_idtracker_csv(path))
    ),
    extensions=(".npy", ".h5", ".csv"),
)
def read_idtracker(path: Path, fps: float | None = None) -> list[Tracks]:
    """All individuals, in pixels; the frame rate is in the file. Recording: the file's name."""
    suffix = path.suffix.lower()
    if suffix == ".csv":
        table = tables.plain_table(path)
        if table.names == IDTRACKER_TIDY:
            told = {"file": path.name, "tracker": "idtracker.ai"}
            found = read_long_table(path, fps=fps, y_down=True)
            assert isinstance(found, list)
            return [replace(one, provenance=told) for one in found]
        count = sum(1 for name in table.names if re.fullmatch(r"x\d+", name))
        names = [f"{axis}{i + 1}" for i in range(count) for axis in "xy"]
        clock = [name for name in table.names[:1] if name in ("time", "seconds")]
        number, _ = table.columns([*clock, *names])
        values = np.column_stack([number[name] for name in names])
        positions = values.reshape(len(values), count, 2)
        rate = rate_of_rows(path, number[clock[0]], table.place) if clock else None
    elif suffix == ".npy":
        raise InputError(
            f"{path}: it holds a pickle, which is never opened: import trajectories.h5 or "
            "trajectories.csv of the same folder, or export them from idtracker.ai"
        )
    else:
        with open_hdf(path) as file:
            values = read_dataset(path, file, "trajectories")
            positions = numbers(path, "trajectories", values, "frames", "individuals", 2)
            rate = _number(file.attrs.get("frames_per_second"))
            if rate is None and "frames_per_second" in file:
                rate = _number(read_dataset(path, file, "frames_per_second"))
    return [
        Tracks(
            recording=path.stem,
            individuals=tuple(str(i + 1) for i in range(positions.shape[1])),
            positions=positions[:, :, None], frame_rate=fps or rate, y_down=True,
            provenance={"file": path.name, "tracker": "idtracker.ai"},
        )
    ]  # fmt: skip


def _is_idtracker_csv(path: Path) -> bool:
    """Return whether a table is of idtracker.ai: of version 6, of an earlier one, or by its name.

    Under another name ``x1, y1, x2, y2`` may be the corners of a box: any wide table is asked that.
    """
    names, named = tables.plain_table(path).names, path.stem.startswith("trajectories")
    dated = names[:2] in (("time", "x1"), ("seconds", "x1")) and (named or len(names) != 5)
    return dated or names == IDTRACKER_TIDY or (names[:2] == ("x1", "y1") and named)


def _number(value: NDArray[Any] | None) -> float | None:
    with contextlib.suppress(TypeError, ValueError, IndexError):
        return None if value is None else float(np.asarray(value, dtype=np.float64).ravel()[0])
    return None


Floats = NDArray[np.float64]
Column = tuple[str, str, str]  # individual, body part, coordinate
COORDINATES = ("x", "y", "likelihood")
MOVEMENT_TABLES = ("DeepLabCut", "LightningPose", "Anipose", "VIA-tracks")


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
    columns, values = (_dlc_csv if path.suffix.lower() == ".csv" else _dlc_hdf)(path)
    individuals = tuple(dict.fromkeys(column[0] for column in columns))
    parts = tuple(dict.fromkeys(column[1] for column in columns))
    stacked = np.full((len(values), len(individuals), len(parts), 3), np.nan)
    for (who, part, coordinate), column in zip(columns, values.T, strict=True):
        at = individuals.index(who), parts.index(part), COORDINATES.index(coordinate)
        stacked[:, *at] = column
    return [
        Tracks(
            recording=path.stem, individuals=individuals, keypoints=parts,
            positions=stacked[..., :2], frame_rate=fps, y_down=True, confidence=stacked[..., 2],
            provenance={"file": path.name, "tracker": "DeepLabCut"},
        )
    ]  # fmt: skip


def _dlc_csv(path: Path) -> tuple[list[Column], Floats]:
    """Columns and values ``(frames, columns)`` of a table whose rows are frames 0, 1, 2."""
    with path.open(newline="", encoding="utf-8-sig") as file:
        rows = list(itertools.islice(csv.reader(file), 4))
    header = rows[: 3 if len(rows) > 2 and rows[2][:1] == ["coords"] else 4]
    levels = [row[0] if row else "" for row in header]
    if [*levels[:1], *levels[-2:]] != ["scorer", "bodyparts", "coords"] or (
        levels[1:-2] not in ([], ["individuals"])
    ):
        raise InputError(
            f"{path}: its header rows are {', '.join(levels)}, not scorer, (individuals,) "
            "bodyparts, coords: check --source"
        )
    columns = _dlc_columns(path, [row[1:] for row in header[1:]])
    names = ("frame", *map(" ".join, columns))
    table = Table(names, first=len(header), path=path)
    number, _ = table.columns(names)
    refuse_uneven_frames(path, number["frame"], table.place, first=0)
    return columns, np.column_stack([number[name] for name in names[1:]])


def _dlc_hdf(path: Path) -> tuple[list[Column], Floats]:
    with open_hdf(path) as file:
        group = next(key for key in file if key.startswith("df_with_missing"))
        stored = "table" in file[group]
        require(stored, f"{path}: it is not stored as a table: export the predictions as .csv")
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
    refuse_uneven_frames(path, frames, lambda row: f"row {row}", first=0)
    return _dlc_columns(path, levels), numbers(path, "its table", values, "frames", len(names))


def _dlc_columns(path: Path, levels: Sequence[Sequence[str]]) -> list[Column]:
    """(individual, body part, coordinate) of each column; levels without the scorer."""
    if len(levels) == 2:
        levels = [[LONE] * len(levels[0]), *levels]
    same = len(levels) == 3 and len({len(level) for level in levels}) == 1
    require(same, f"{path}: the rows of its header differ in length: copy the file again")
    columns = [(a, b, c) for a, b, c in zip(*levels, strict=True)]
    twice = len(set(columns)) == len(columns) > 0
    require(twice, f"{path}: a column appears twice in its header: drop the duplicate")
    found: dict[tuple[str, str], set[str]] = {}
    for who, part, coordinate in columns:
        found.setdefault((who, part), set()).add(coordinate)
    for (who, part), own in found.items():
        require(
            {"x", "y"} <= own <= set(COORDINATES),
            f"{path}: {part!r} of {who!r} has columns {', '.join(sorted(own))}, not x, "
            "y and likelihood: correct the header",
        )
    return columns


# -- SLEAP -----------------------------------------------------------------------------------------


@register_track_reader(
    "sleap",
    "SLEAP projects (.slp) and analysis files (.h5)",
    sniff=lambda path: (
        {"instances", "frames", "points"} <= hdf_keys(path)
        or {"tracks", "track_names", "node_names"} <= hdf_keys(path)
    ),
    extensions=(".slp", ".h5", ".hdf5"),
)
def read_sleap(path: Path, fps: float | None = None) -> list[Tracks]:
    """Proofread or predicted tracks of all nodes, in pixels; SLEAP files hold no frame rate.

    A project of several videos gives a recording of each.
    """
    analysis = {"tracks", "track_names"} <= hdf_keys(path)
    names, nodes, found = (_sleap_analysis if analysis else _sleap_project)(path)
    return [
        Tracks(
            recording=path.stem if len(found) == 1 else f"{path.stem}/{number}",
            individuals=tuple(names), keypoints=tuple(nodes), positions=positions, frame_rate=fps,
            y_down=True, confidence=confidence,
            provenance={"file": path.name, "tracker": "SLEAP"},
        )
        for number, (positions, confidence) in enumerate(found)
    ]  # fmt: skip


Sleap = tuple[list[str], list[str], list[tuple[Floats, Floats | None]]]  # names, nodes, videos


def _sleap_project(path: Path) -> Sleap:
    with require_extra("reading SLEAP projects", "tracking"):
        import sleap_io
    with open_hdf(path) as file:
        keys = [k for k in ("points", "pred_points", "instances", "frames") if k in file]
        _check_places(path, {key: read_dataset(path, file, key) for key in keys})
    labels = sleap_io.load_slp(str(path), open_videos=False)
    if not labels.tracks:
        raise InputError(f"{path}: it has no tracks: track the individuals in SLEAP first")
    found = []
    for video in filter(labels.find, labels.videos):
        array = np.asarray(labels.numpy(video=video, return_confidence=True), dtype=np.float64)
        score = array[..., 2]
        predicted = np.isfinite(score) & (score != 1.0)
        found.append((array[..., :2], score if predicted.any() else None))
    names = [track.name or f"track_{i}" for i, track in enumerate(labels.tracks)]
    return names, labels.skeletons[0].node_names, found


def _check_places(path: Path, tables: dict[str, NDArray[Any]]) -> None:
    """Refuse frames and instances of a project that share rows or point outside the tables."""
    instances, frames = tables["instances"], tables["frames"]
    for what, ids in (("instances", instances["instance_id"]), ("frames", frames["frame_id"])):
        if len(np.unique(ids)) != len(ids):
            raise InputError(f"{path}: two of its {what} have one number: copy the file again")
    if not np.isin(instances["frame_id"], frames["frame_id"]).all():
        raise InputError(f"{path}: an instance is of no frame: copy the file again")
    points = {0: "points", 1: "pred_points"}  # of user's and predicted instances
    claims = [("instances", frames["instance_id_start"], frames["instance_id_end"])]
    for kind, key in points.items():
        own = instances[instances["instance_type"] == kind]
        claims.append((key, own["point_id_start"], own["point_id_end"]))
    if not set(np.unique(instances["instance_type"]).tolist()) <= set(points):
        raise InputError(f"{path}: an instance is of no known type: copy the file again")
    for key, start, end in claims:
        order = np.argsort(start, kind="stable")
        start, end = start[order].astype(np.int64), end[order].astype(np.int64)
        rows = len(tables.get(key, ()))
        if (start > end).any() or (start[1:] < end[:-1]).any() or (end > rows).any():
            raise InputError(
                f"{path}: entries of its table {key!r} are claimed twice or do not exist: copy the "
                "file again"
            )


def _sleap_analysis(path: Path) -> Sleap:
    with open_hdf(path) as file:
        names, nodes = (
            [one.decode() if isinstance(one, bytes) else str(one) for one in words]
            for words in (read_dataset(path, file, key) for key in ("track_names", "node_names"))
        )
        tracks = read_dataset(path, file, "tracks")
        scores = read_dataset(path, file, "point_scores") if "point_scores" in file else None
    axes = (len(names), len(nodes))
    tracks = numbers(path, "tracks", tracks, axes[0], 2, axes[1], "frames")
    if scores is not None:
        scores = numbers(path, "point_scores", scores, *axes, tracks.shape[3]).transpose(2, 0, 1)
    return names, nodes, [(tracks.transpose(3, 0, 2, 1), scores)]


# -- movement --------------------------------------------------------------------------------------


@register_track_reader(
    "movement",
    "tables that the movement package loads; option software, such as Anipose or LightningPose",
    sniff=lambda path: False,
    extensions=(),
)
def read_movement(
    path: Path, software: str = "DeepLabCut", fps: float | None = None
) -> list[Tracks]:
    """Poses of a ``movement`` dataset; ``software`` is its ``source_software``.

    Only ``.csv`` is handed to the package; see this module's text.
    """
    _check_movement_table(path, software)
    with require_extra("reading with movement", "tracking"):
        from loguru import logger
        from movement.io import load_dataset
    logger.disable("movement")  # what it says is in the message already
    try:
        dataset = load_dataset(path, source_software=software, fps=fps)
    finally:
        logger.enable("movement")
    position, confidence = dataset["position"], dataset.get("confidence")
    (who,) = {"individual", "individuals"} & set(position.dims)
    points = {"keypoint", "keypoints"} & set(position.dims)
    keypoints = tuple(str(name) for axis in points for name in position.coords[axis].values)
    scores = None
    if confidence is not None:
        scores = np.asarray(confidence.transpose("time", who, ...).values, dtype=np.float64)
        scores = scores.reshape(*scores.shape[:2], -1)
    values = position.transpose("time", who, *points, "space").values[..., :2]
    values = np.asarray(values, dtype=np.float64)
    return [
        Tracks(
            recording=path.stem,
            individuals=tuple(str(name) for name in position.coords[who].values),
            keypoints=keypoints or (CENTROID,),
            positions=values.reshape(*values.shape[:2], -1, 2),
            frame_rate=fps,
            y_down=True,
            confidence=scores,
            provenance={"file": path.name, "tracker": software, "read_by": "movement"},
        )
    ]


def _check_movement_table(path: Path, software: str) -> None:
    """Refuse what the package would open with PyTables or YAML, or read wrongly in silence."""
    require(
        path.suffix.lower() == ".csv" and not is_hdf(path),
        f"{path}: only .csv is read through movement, whose HDF5 can run code: use --source "
        "deeplabcut or sleap, or export .csv",
    )
    known = ", ".join(MOVEMENT_TABLES)
    writes = f"{path}: software {software!r} writes no table: choose one of {known}"
    require(software in MOVEMENT_TABLES, writes)
    table = plain_table(path)
    if software in ("DeepLabCut", "LightningPose"):
        _dlc_csv(path)  # its header and frames are refused there
    else:
        table.check_names()
    table.check_lines()
    if software == "Anipose":  # movement ignores its frame numbers
        number, _ = table.columns(["fnum"])
        refuse_uneven_frames(path, number["fnum"], table.place)
