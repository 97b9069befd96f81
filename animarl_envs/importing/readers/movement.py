"""Files of the ``movement`` package: its netCDF, NWB with poses (ndx-pose), and tables it loads.

HDF5 is not handed to the package: for DeepLabCut it calls ``pandas.read_hdf``, and PyTables below
that opens every pickle it finds in an attribute, which runs any code; for NWB it builds classes
that the file describes. Here both are read as plain arrays.
"""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from animarl_envs.errors import require, require_extra
from animarl_envs.importing.clock import rate_of_rows, refuse_uneven_frames
from animarl_envs.importing.hdf import hdf_keys, hdf_text, is_hdf, open_hdf, read_dataset
from animarl_envs.importing.netcdf_io import Y_UP
from animarl_envs.importing.readers.deeplabcut import read_dlc_table
from animarl_envs.importing.readers.registry import register_track_reader
from animarl_envs.importing.table_layout import bare_unit
from animarl_envs.importing.tables import plain_table
from animarl_envs.importing.tracks import CENTROID, LONE, RATE_FROM, Tracks, merge

MOVEMENT_TABLES = ("DeepLabCut", "LightningPose", "Anipose", "VIA-tracks")
INDIVIDUALS, KEYPOINTS = ("individual", "individuals"), ("keypoint", "keypoints")  # by version


@register_track_reader(
    "netcdf",
    "movement's datasets, saved by to_netcdf (.nc)",
    sniff=lambda path: "position" in hdf_keys(path) or path.suffix == ".nc",
    extensions=(".nc",),
)
def read_netcdf(path: Path, fps: float | None = None) -> list[Tracks]:
    """Read poses or boxes of all individuals, in pixels; the first two axes of poses in space."""
    require(
        not _is_classic(path),
        f"{path}: it is of netCDF's classic format: save it by dataset.to_netcdf(path, "
        "engine='h5netcdf')",
    )
    with open_hdf(path) as file:
        groups = [file] if "position" in file else [file[name] for name in file]
        return [_netcdf_recording(path, group, fps) for group in groups]


def _netcdf_recording(path: Path, file: Any, fps: float | None) -> Tracks:
    """Read one dataset: the whole file, or a group of it."""
    values = read_dataset(path, file, "position")
    scores = read_dataset(path, file, "confidence") if "confidence" in file else None
    axes = _axes(path, file, "position")
    own = [next((n for n in names if n in axes), "") for names in (INDIVIDUALS, KEYPOINTS)]
    require(
        {"time", "space", own[0]} <= set(axes) <= {"time", "space", *own},
        f"{path}: position has the axes {', '.join(axes)}, not time, space, individuals and "
        "keypoints: save the dataset as movement makes it",
    )
    names, points, space = (
        [hdf_text(one) for one in read_dataset(path, file, axis)] if axis else [CENTROID]
        for axis in (*own, "space")
    )
    order = [axis for axis in ("time", *own, "space") if axis]
    values = values.transpose([axes.index(axis) for axis in order])
    if scores is not None:
        known = _axes(path, file, "confidence")
        same = sorted(known) == sorted(order[:-1])
        require(same, f"{path}: confidence has the axes {', '.join(known)}: save it again")
        scores = scores.transpose([known.index(axis) for axis in order[:-1]])
    time = read_dataset(path, file, "time")
    stated = {key: hdf_text(value) for key, value in file.attrs.items() if np.size(value) == 1}
    seconds = stated.get("time_unit", "frames") == "seconds"
    require(
        space[:2] == ["x", "y"], f"{path}: its space is {', '.join(space)}, not x, y: save it again"
    )
    shape = (len(time), len(names), len(points))
    values = values.reshape(*shape, -1)
    rate = rate_of_rows(path, time.astype(np.float64), lambda row: f"entry {row + 1} of time")
    return Tracks(
        recording=stated.get("recording", path.stem),
        individuals=tuple(names),
        keypoints=tuple(points),
        positions=values[..., :2].astype(np.float64),
        frame_rate=fps or (rate if seconds else None),
        start_time=float(time[0]) if seconds else 0.0,
        y_down=stated.get("y_axis") != Y_UP,
        unit=stated.get("space_unit", "px"),
        condition=int(stated.get("condition_number", 0)),
        confidence=None if scores is None else scores.reshape(shape).astype(np.float64),
        provenance={"file": path.name, "tracker": "movement", "columns_not_used": space[2:]}
        | ({RATE_FROM: "the coordinate time"} if seconds and fps is None else {}),
    )


def _is_classic(path: Path) -> bool:
    with path.open("rb") as file:
        return file.read(3) == b"CDF"


def _axes(path: Path, file: Any, key: str) -> list[str]:
    """Return the names of a variable's axes, which are those of its dimension scales."""
    scales = [next(iter(axis.values()), None) for axis in file[key].dims]
    require(None not in scales, f"{path}: {key} does not say its axes: save it by to_netcdf")
    return [str(scale.name).rpartition("/")[2] for scale in scales]  # type: ignore[union-attr]


@register_track_reader(
    "nwb",
    "NWB files with poses (ndx-pose)",
    sniff=lambda path: path.suffix.lower() == ".nwb",
    extensions=(".nwb",),
)
def read_nwb(path: Path, fps: float | None = None) -> list[Tracks]:
    """Read all estimated poses: a container is an individual, a processing module a recording.

    Files of one individual are merged by --merge-individuals.
    """
    with open_hdf(path, soft_links=True) as file:
        recordings: dict[str, list[str]] = {}

        def collect(name: str, thing: Any) -> None:
            if hdf_text(thing.attrs.get("neurodata_type", "")) == "PoseEstimation":
                recordings.setdefault(name.rpartition("/")[0], []).append(name)

        file.visititems(collect)
        require(
            recordings, f"{path}: it holds no PoseEstimation of ndx-pose: export the poses to it"
        )
        subject = "general/subject/subject_id"
        alone = hdf_text(read_dataset(path, file, subject)) if subject in file else LONE
        parts_of_all: list[Tracks] = []
        for module, containers in recordings.items():
            names = [name.rpartition("/")[2].removeprefix("track=") for name in containers]
            recording = (
                path.stem if len(recordings) == 1 else f"{path.stem}/{module.rpartition('/')[2]}"
            )
            parts = [_nwb_individual(path, file, name, fps) for name in containers]
            names = [alone] if len(names) == 1 else names
            parts_of_all += [
                replace(part, recording=recording, individuals=(name,))
                for part, name in zip(parts, names, strict=True)
            ]
    return merge(parts_of_all)


def _nwb_individual(path: Path, file: Any, container: str, fps: float | None) -> Tracks:
    """Return the series of one container, each a keypoint."""
    things = {name: file[container].get(name) for name in file[container]}  # None: a dead link
    series = {
        name: thing
        for name, thing in things.items()
        if thing is not None
        and hdf_text(thing.attrs.get("neurodata_type", "")) == "PoseEstimationSeries"
    }
    require(series, f"{path}: {container} has no series of poses: export it again")
    positions, scores, units = [], [], set()
    for name, one in series.items():
        data = read_dataset(path, file, f"{container}/{name}/data")
        flat = data.ndim == 2 and data.shape[1] in (2, 3) and data.dtype.kind in "iuf"
        require(flat, f"{path}: {name} of {container} has shape {data.shape}, not (frames, 2)")
        scale = one["data"].attrs.get("conversion", 1.0), one["data"].attrs.get("offset", 0.0)
        positions.append(data[:, :2] * float(scale[0]) + float(scale[1]))
        units.add(hdf_text(one["data"].attrs.get("unit", "")))
        if "confidence" in one:
            scores.append(read_dataset(path, file, f"{container}/{name}/confidence"))
    lengths = {len(one) for one in (*positions, *scores)}
    require(
        len(lengths) == len(units) == 1,
        f"{path}: the series of {container} differ in length or unit: export them in one",
    )
    first = next(iter(series))
    rate, start = fps, 0.0
    if "timestamps" in series[first]:
        time = read_dataset(path, file, f"{container}/{first}/timestamps").astype(np.float64)
        rate = fps or rate_of_rows(path, time, lambda row: f"timestamp {row + 1}")
        start = float(time[0])
    elif "starting_time" in series[first]:
        clock = series[first]["starting_time"]
        rate, start = fps or float(clock.attrs["rate"]), float(clock[()])
    return Tracks(
        recording=path.stem,
        individuals=(LONE,),
        keypoints=tuple(series),
        positions=np.stack(positions, axis=1)[:, None],
        frame_rate=rate,
        start_time=start,
        unit=bare_unit(units.pop()) or "px",
        y_down=True,
        confidence=np.stack(scores, axis=1)[:, None] if len(scores) == len(series) else None,
        provenance={"file": path.name, "tracker": "NWB"}
        | ({RATE_FROM: "its timestamps"} if rate and fps is None else {}),
    )


@register_track_reader(
    "movement",
    "tables that the movement package loads; option software, such as Anipose or LightningPose",
    sniff=lambda path: False,
    extensions=(),
)
def read_movement(
    path: Path, software: str = "DeepLabCut", fps: float | None = None
) -> list[Tracks]:
    """Return poses of a ``movement`` dataset; ``software`` is its ``source_software``.

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
    (individual,) = set(INDIVIDUALS) & set(position.dims)
    points = set(KEYPOINTS) & set(position.dims)
    keypoints = tuple(str(name) for axis in points for name in position.coords[axis].values)
    scores = None
    if confidence is not None:
        scores = np.asarray(confidence.transpose("time", individual, ...).values, dtype=np.float64)
        scores = scores.reshape(*scores.shape[:2], -1)
    values = position.transpose("time", individual, *points, "space").values[..., :2]
    values = np.asarray(values, dtype=np.float64)
    return [
        Tracks(
            recording=path.stem,
            individuals=tuple(str(name) for name in position.coords[individual].values),
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
        table, _, frames, _ = read_dlc_table(path)
        plain = table.separator == "," and table.content is None and frames[0] == 0
        require(
            plain,
            f"{path}: movement takes frames from 0 and commas only: use --source deeplabcut",
        )
    else:
        table.check_names()
    table.check_lines()
    if software == "Anipose":  # movement ignores its frame numbers
        number, _ = table.columns(["fnum"])
        refuse_uneven_frames(path, number["fnum"], table.place)
