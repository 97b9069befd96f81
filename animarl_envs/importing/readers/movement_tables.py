"""Whatever table the ``movement`` package loads.

HDF5 is not handed to it: for DeepLabCut it calls ``pandas.read_hdf``, and PyTables below that opens
every pickle it finds in an attribute, which runs any code; for NWB it builds classes that the file
describes. The readers of this project open such files without either.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from animarl_envs.errors import InputError, MissingExtraError
from animarl_envs.importing.readers.clocks import refuse_uneven_frames
from animarl_envs.importing.readers.deeplabcut import read_deeplabcut_csv
from animarl_envs.importing.readers.hdf import is_hdf
from animarl_envs.importing.readers.lines import check_lines
from animarl_envs.importing.readers.registry import register_track_reader
from animarl_envs.importing.readers.tables import plain_table
from animarl_envs.importing.tracks import Tracks

SOFTWARE = ("DeepLabCut", "LightningPose", "Anipose", "VIA-tracks")  # those of tables
FRAMES = {"Anipose": "fnum"}  # column of frame numbers, which movement ignores


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
    _check(path, software)
    try:
        from loguru import logger
        from movement.io import load_dataset
    except ImportError as error:
        raise MissingExtraError("reading with movement", "tracking") from error
    logger.disable("movement")  # what it says is in the message already
    try:
        dataset = load_dataset(path, source_software=software, fps=fps)
    finally:
        logger.enable("movement")
    array = dataset["position"]
    keypoints: tuple[str, ...] = ("centroid",)
    if "keypoint" in array.dims or "keypoints" in array.dims:
        axis = "keypoint" if "keypoint" in array.dims else "keypoints"
        keypoints = tuple(str(name) for name in array.coords[axis].values)
    else:
        axis = "keypoint"
        array = array.expand_dims({axis: list(keypoints)})
        dataset = dataset.assign(position=array)
    who = "individual" if "individual" in array.dims else "individuals"
    positions = array.transpose("time", who, axis, "space").values[..., :2]
    confidence = None
    if "confidence" in dataset:
        weights = dataset["confidence"]
        if axis not in weights.dims:
            weights = weights.expand_dims({axis: list(keypoints)})
        confidence = np.asarray(weights.transpose("time", who, axis).values, dtype=np.float64)
    return [
        Tracks(
            recording=path.stem,
            individuals=tuple(str(name) for name in array.coords[who].values),
            keypoints=keypoints,
            positions=np.asarray(positions, dtype=np.float64),
            frame_rate=fps,
            y_down=True,
            confidence=confidence,
            provenance={"file": path.name, "tracker": software, "read_by": "movement"},
        )
    ]


def _check(path: Path, software: str) -> None:
    """Refuse what the package would open with PyTables or YAML, or read wrongly in silence."""
    if path.suffix.lower() != ".csv" or is_hdf(path):
        raise InputError(
            f"{path}: only .csv is read through movement, whose HDF5 can run code: use --source "
            "deeplabcut or sleap, or export .csv"
        )
    if software not in SOFTWARE:
        raise InputError(
            f"{path}: software {software!r} writes no table: choose one of {', '.join(SOFTWARE)}"
        )
    table = plain_table(path)
    if software in ("DeepLabCut", "LightningPose"):
        read_deeplabcut_csv(path)  # its header and frames are refused there
    else:
        table.check_names()
    check_lines(path, table.layout.separator, len(table.names))
    if software in FRAMES:
        number, _ = table.columns([FRAMES[software]])
        refuse_uneven_frames(path, number[FRAMES[software]], table.place)
