"""SLEAP: projects (``.slp``), analysis files (``.h5``), and tables of poses (``.csv``)."""

import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from animarl_envs.array_types import Floats
from animarl_envs.errors import InputError, require, require_extra
from animarl_envs.importing import tables
from animarl_envs.importing.hdf import hdf_keys, hdf_text, open_hdf, read_dataset
from animarl_envs.importing.readers.registry import numbers, register_track_reader
from animarl_envs.importing.table_checks import frame_numbers, refuse_two_rows
from animarl_envs.importing.tracks import LONE, Tracks

Sleap = tuple[list[str], list[str], list[tuple[Floats, Floats | None]]]  # names, nodes, videos
ANALYSIS = {"tracks", "track_names", "node_names"}
PROJECT = {"instances", "frames", "points"}
MATLAB_AXES = ["track", "xy", "node", "frame"]  # as SLEAP itself writes them
TABLE = {"frame_idx", "track"}
SCORE = "score"
NOT_TRACKED = (
    "it has several animals in a frame and no tracks: track the individuals in SLEAP first"
)


def _is_sleap(path: Path) -> bool:
    if path.suffix.lower() == ".csv":
        names = tables.plain_table(path).names
        return set(names) >= TABLE and bool(_nodes(names))
    keys = hdf_keys(path)
    return keys >= PROJECT or keys >= ANALYSIS


@register_track_reader(
    "sleap",
    "SLEAP projects (.slp), analysis files (.h5) and tables (.csv)",
    sniff=_is_sleap,
    extensions=(".slp", ".h5", ".hdf5", ".csv"),
)
def read_sleap(path: Path, fps: float | None = None) -> list[Tracks]:
    """Read proofread or predicted tracks of all nodes, in pixels, without a frame rate.

    A project of several videos gives a recording of each. A lone animal needs no track.
    """
    if path.suffix.lower() == ".csv":
        names, nodes, videos = _read_table(path)
    else:
        analysis = hdf_keys(path) >= ANALYSIS
        names, nodes, videos = (_read_analysis if analysis else _read_project)(path)
    return [
        Tracks(
            recording=path.stem if len(videos) == 1 else f"{path.stem}/{number}",
            individuals=tuple(names),
            keypoints=tuple(nodes),
            positions=positions,
            frame_rate=fps,
            y_down=True,
            confidence=confidence,
            provenance={"file": path.name, "tracker": "SLEAP"},
        )
        for number, (positions, confidence) in enumerate(videos)
    ]


def _read_project(path: Path) -> Sleap:
    with require_extra("reading SLEAP projects", "tracking"):
        import sleap_io
    with open_hdf(path) as file:
        keys = [k for k in ("points", "pred_points", "instances", "frames") if k in file]
        _check_rows(path, {key: read_dataset(path, file, key) for key in keys})
    labels = sleap_io.load_slp(str(path), open_videos=False)
    tracked = any(one.track is not None for frame in labels for one in frame.instances)
    names = [LONE]
    if tracked:
        names = [track.name or f"track_{i}" for i, track in enumerate(labels.tracks)]
    videos = []
    for video in filter(labels.find, labels.videos):
        array = np.asarray(
            labels.numpy(video=video, return_confidence=True, untracked=not tracked), np.float64
        )
        require(tracked or array.shape[1] == 1, f"{path}: {NOT_TRACKED}")
        if array.shape[1] < len(names):  # one animal in each frame, which need not be the same
            array = _spread(array, labels, video, len(names))
        score = array[..., 2]
        predicted = np.isfinite(score) & (score != 1.0)
        videos.append((array[..., :2], score if predicted.any() else None))
    require(videos, f"{path}: no frame of it is labelled: predict or label the animals first")
    return names, labels.skeletons[0].node_names, videos


def _spread(array: Floats, labels: Any, video: Any, count: int) -> Floats:
    """Return the poses of one animal a frame in the columns of their tracks."""
    spread = np.full((len(array), count, *array.shape[2:]), np.nan)
    for frame in labels.find(video):
        for one in frame.instances:
            if one.track is not None:
                spread[frame.frame_idx, labels.tracks.index(one.track)] = array[frame.frame_idx, 0]
    return spread


def _check_rows(path: Path, stored: dict[str, NDArray[Any]]) -> None:
    """Refuse frames and instances of a project that share rows or point outside the tables."""
    instances, frames = stored["instances"], stored["frames"]
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
        rows = len(stored.get(key, ()))
        if (start > end).any() or (start[1:] < end[:-1]).any() or (end > rows).any():
            raise InputError(
                f"{path}: entries of its table {key!r} are claimed twice or do not exist: copy the "
                "file again"
            )


def _read_analysis(path: Path) -> Sleap:
    with open_hdf(path) as file:
        names, nodes = (
            [hdf_text(one) for one in read_dataset(path, file, key)]
            for key in ("track_names", "node_names")
        )
        tracks = read_dataset(path, file, "tracks")
        axes = MATLAB_AXES
        if "dims" in file["tracks"].attrs:  # sleap-io's, which writes them in several orders
            axes = list(json.loads(hdf_text(file["tracks"].attrs["dims"])))
        scores = read_dataset(path, file, "point_scores") if "point_scores" in file else None
    known = sorted(axes) == sorted(MATLAB_AXES) and tracks.ndim == len(axes)
    require(known, f"{path}: its tracks have the axes {', '.join(axes)}: export it again")
    if not names:
        require(tracks.shape[axes.index("track")] == 1, f"{path}: {NOT_TRACKED}")
        names = [LONE]
    sizes: dict[str, Any] = {"track": len(names), "node": len(nodes), "xy": 2, "frame": "frames"}
    order = ("frame", "track", "node")
    tracks = numbers(path, "tracks", tracks, *(sizes[axis] for axis in axes))
    tracks = tracks.transpose([axes.index(axis) for axis in (*order, "xy")])
    if scores is not None:
        sizes["frame"] = len(tracks)
        axes = [axis for axis in axes if axis != "xy"]
        scores = numbers(path, "point_scores", scores, *(sizes[axis] for axis in axes))
        scores = scores.transpose([axes.index(axis) for axis in order])
    return names, nodes, [(tracks, scores)]


def _nodes(names: tuple[str, ...]) -> list[str]:
    """Return the nodes of a table: what has columns ``NODE.x`` and ``NODE.y``."""
    return [
        name.removesuffix(".x")
        for name in names
        if name.endswith(".x") and f"{name.removesuffix('.x')}.y" in names
    ]


def _read_table(path: Path) -> Sleap:
    """Read a table of instances; ``track`` is empty where a lone animal was not tracked."""
    table = tables.open_table(path)
    nodes = _nodes(table.names)
    scored = all(f"{node}.{SCORE}" in table.names for node in nodes)
    coordinates = ["x", "y", SCORE] if scored else ["x", "y"]
    columns = [f"{node}.{coordinate}" for node in nodes for coordinate in coordinates]
    tracked = "track" in table.words_in
    if not tracked:
        named, _ = table.columns(["track", "frame_idx"])
        tracked = bool(np.isfinite(named["track"]).any())
    number, word = table.columns(["frame_idx", *columns], ["track"] if tracked else [])
    names = word["track"].entries if tracked else [LONE]
    frames = frame_numbers(table, "frame_idx", number["frame_idx"])
    if not tracked:
        require(len(np.unique(frames)) == len(frames), f"{path}: {NOT_TRACKED}")
    cell = frames * len(names) + (word["track"].number if tracked else 0)
    refuse_two_rows(table, path.stem, cell, names, np.arange(len(frames)))
    shape = (int(frames.max()) + 1, len(names), len(nodes), len(coordinates))
    values = np.full(shape, np.nan)
    values.reshape(-1, len(columns))[cell] = np.column_stack([number[name] for name in columns])
    return names, nodes, [(values[..., :2], values[..., 2] if scored else None)]
