"""SLEAP: projects (``.slp``) and analysis files (``.h5``)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from animarl_envs.errors import InputError, MissingExtraError
from animarl_envs.importing.readers.hdf import hdf_keys, open_hdf, read_dataset
from animarl_envs.importing.readers.registry import register_track_reader
from animarl_envs.importing.tracks import Tracks


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
    if {"tracks", "track_names"} <= hdf_keys(path):
        return _analysis(path, fps)
    try:
        import sleap_io
    except ImportError as error:
        raise MissingExtraError("reading SLEAP projects", "tracking") from error
    with open_hdf(path) as file:
        keys = [k for k in ("points", "pred_points", "instances", "frames") if k in file]
        tables = {key: read_dataset(path, file, key) for key in keys}
    _check_places(path, tables)
    labels = sleap_io.load_slp(str(path), open_videos=False)
    if not labels.tracks:
        raise InputError(f"{path}: it has no tracks: track the individuals in SLEAP first")
    names = [track.name or f"track_{i}" for i, track in enumerate(labels.tracks)]
    nodes = labels.skeletons[0].node_names
    videos = [video for video in labels.videos if labels.find(video)]
    found = []
    for number, video in enumerate(videos):
        array = np.asarray(labels.numpy(video=video, return_confidence=True), dtype=np.float64)
        predicted = np.isfinite(array[..., 2]) & (array[..., 2] != 1.0)
        found.append(
            Tracks(
                recording=path.stem if len(videos) == 1 else f"{path.stem}/{number}",
                individuals=tuple(names), keypoints=tuple(nodes),
                positions=array[..., :2], frame_rate=fps, y_down=True,
                confidence=array[..., 2] if predicted.any() else None,
                provenance={"file": path.name, "tracker": "SLEAP"},
            )
        )  # fmt: skip
    return found


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


def _analysis(path: Path, fps: float | None) -> list[Tracks]:
    with open_hdf(path) as file:
        tracks = np.asarray(read_dataset(path, file, "tracks"), dtype=np.float64)
        names = [_text(name) for name in read_dataset(path, file, "track_names")]
        nodes = [_text(name) for name in read_dataset(path, file, "node_names")]
        scores = None
        if "point_scores" in file:
            scores = np.asarray(read_dataset(path, file, "point_scores"), dtype=np.float64)
    if tracks.ndim != 4 or tracks.shape[:3] != (len(names), 2, len(nodes)):
        raise InputError(
            f"{path}: tracks have shape {tracks.shape}, not ({len(names)}, 2, {len(nodes)}, "
            "frames): export the analysis file again"
        )
    if scores is not None and scores.shape != (len(names), len(nodes), tracks.shape[3]):
        raise InputError(
            f"{path}: point_scores have shape {scores.shape}, not ({len(names)}, {len(nodes)}, "
            f"{tracks.shape[3]}): export the analysis file again"
        )
    return [
        Tracks(
            recording=path.stem, individuals=tuple(names), keypoints=tuple(nodes),
            positions=tracks.transpose(3, 0, 2, 1), frame_rate=fps, y_down=True,
            confidence=None if scores is None else scores.transpose(2, 0, 1),
            provenance={"file": path.name, "tracker": "SLEAP"},
        )
    ]  # fmt: skip


def _text(value: Any) -> str:
    return value.decode() if isinstance(value, bytes) else str(value)
