"""MATLAB files of Ctrax, JAABA and FlyTracker, whose structs are known by name."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from animarl_envs.array_types import Floats
from animarl_envs.demos.episode import refusing_damage
from animarl_envs.errors import InputError, MissingExtraError, require
from animarl_envs.importing.clock import rate_of_rows
from animarl_envs.importing.readers.arrays import matlab_variables
from animarl_envs.importing.readers.registry import register_track_reader
from animarl_envs.importing.tracks import Tracks

CTRAX = {"x_pos", "y_pos", "ntargets", "identity"}
USED = {"x", "y", "x_mm", "y_mm", "firstframe", "fps", "id", "timestamps", "pos x", "pos y"}


def variable_names(path: Path) -> set[str]:
    """Return the names of the variables in a ``.mat``; none if it is damaged or of version 7.3."""
    try:
        with refusing_damage(path):
            from scipy.io import whosmat

            return {name for name, _, _ in whosmat(path)}
    except (InputError, MissingExtraError):
        return set()


@register_track_reader(
    "ctrax",
    "Ctrax and JAABA (.mat with a struct trx, or with x_pos, y_pos, ntargets, identity)",
    sniff=lambda path: "trx" in (names := variable_names(path)) or names >= CTRAX,
    extensions=(".mat",),
)
def read_ctrax(path: Path, fps: float | None = None) -> list[Tracks]:
    """Read all animals of a movie, in mm where the struct has them, else in pixels."""
    variables = matlab_variables(path)
    if "trx" in variables:
        tracks = variables["trx"].ravel()
        fields = set(tracks.dtype.names or ())
        ending = "_mm" if {"x_mm", "y_mm"} <= fields else ""
        require(
            {f"x{ending}", f"y{ending}", "firstframe"} <= fields,
            f"{path}: its struct trx lacks x, y or firstframe: export it from Ctrax or JAABA again",
        )
        names = [_number(one["id"]) for one in tracks] if "id" in fields else []
        named = len({*names}) == len(tracks) > 0
        individuals = [f"{name:g}" for name in names] if named else None
        first = [int(_number(one["firstframe"])) - 1 for one in tracks]
        paths = [_points(path, one[f"x{ending}"], one[f"y{ending}"]) for one in tracks]
        stated = _number(tracks[0]["fps"]) if "fps" in fields else None
        rest = fields
    else:
        require(
            variables.keys() >= CTRAX,
            f"{path}: it lacks trx, or one of {', '.join(sorted(CTRAX))}: check --source",
        )
        targets = variables["ntargets"].ravel().astype(np.int64)
        frame = np.repeat(np.arange(len(targets)), targets)
        points = _points(path, variables["x_pos"], variables["y_pos"])
        owner = variables["identity"].ravel()
        require(
            len(points) == len(frame) == len(owner),
            f"{path}: ntargets adds up to {len(frame)} positions, and it holds {len(points)}: "
            "copy it again",
        )
        ids = np.unique(owner)
        individuals, first, paths = [f"{one:g}" for one in ids], [], []
        for one in ids:
            own = frame[owner == one]
            first.append(int(own.min()))
            paths.append(np.full((int(own.max()) - first[-1] + 1, 2), np.nan))
            paths[-1][own - first[-1]] = points[owner == one]
        stated, ending, rest = None, "", variables.keys() - CTRAX
    if fps is None and stated is None and "timestamps" in variables:
        time = variables["timestamps"].ravel().astype(np.float64)
        stated = rate_of_rows(path, time, lambda row: f"timestamp {row + 1}")
    return [
        _recording(
            path,
            path.stem,
            individuals,
            first,
            paths,
            rest,
            frame_rate=fps or stated,
            unit="mm" if ending else "px",
        )
    ]


@register_track_reader(
    "flytracker",
    "FlyTracker (*-track.mat), a recording of each chamber",
    sniff=lambda path: "trk" in variable_names(path),
    extensions=(".mat",),
)
def read_flytracker(path: Path, fps: float | None = None) -> list[Tracks]:
    """Read all flies in pixels; the frame rate stands in another file, the calibration."""
    struct = matlab_variables(path)["trk"]
    fields = set(struct.dtype.names or ())
    require(
        {"names", "data"} <= fields,
        f"{path}: its struct trk lacks names or data: export it from FlyTracker again",
    )
    trk = struct.ravel()[0]
    names = [str(np.ravel(cell)[0]) for cell in trk["names"].ravel()]
    data = np.asarray(trk["data"], dtype=np.float64)
    require(
        {"pos x", "pos y"} <= set(names) and data.ndim == 3 and data.shape[2] == len(names),
        f"{path}: its struct trk has fields {', '.join(names)[:200]}, and data of shape "
        f"{data.shape}: export it from FlyTracker again",
    )
    places = data[:, :, [names.index("pos x"), names.index("pos y")]]
    chambers = trk["flies_in_chamber"] if "flies_in_chamber" in fields else np.zeros(0)
    groups: list[Any] = list(chambers.ravel()) if chambers.dtype == object else []
    groups = [np.ravel(group).astype(int) for group in groups if np.size(group)]
    groups = groups or [np.arange(1, len(places) + 1)]
    return [
        _recording(
            path,
            path.stem if len(groups) == 1 else f"{path.stem}/chamber_{number}",
            None,  # numbered anew in each, so that chambers have the same animals
            [0] * len(group),
            [places[fly - 1] for fly in group],
            names,
            frame_rate=fps,
        )
        for number, group in enumerate(groups, start=1)
    ]


def _number(value: Any) -> float:
    return float(np.ravel(value)[0])


def _points(path: Path, x: Any, y: Any) -> Floats:
    require(np.size(x) == np.size(y), f"{path}: an animal has more x than y: copy it again")
    return np.column_stack([np.ravel(x), np.ravel(y)]).astype(np.float64)


def _recording(
    path: Path,
    recording: str,
    individuals: Sequence[str] | None,
    first: Sequence[int],
    paths: Sequence[Floats],
    fields: Any,
    **more: Any,
) -> Tracks:
    """Put each animal's path ``(frames, 2)`` at the frame where it begins."""
    require(len(paths) and min(first) >= 0, f"{path}: it holds no animal: check the tracking")
    start = min(first)
    first = [begin - start for begin in first]
    ends = [begin + len(one) for begin, one in zip(first, paths, strict=True)]
    positions = np.full((max(ends), len(paths), 1, 2), np.nan)
    for at, (begin, end, one) in enumerate(zip(first, ends, paths, strict=True)):
        positions[begin:end, at, 0] = one
    return Tracks(
        recording=recording,
        individuals=tuple(individuals or (str(i + 1) for i in range(len(paths)))),
        positions=positions,
        start=start,
        y_down=True,
        provenance={
            "file": path.name,
            "tracker": "FlyTracker" if "pos x" in fields else "Ctrax",
            "columns_not_used": sorted(set(fields) - USED),
        },
        **more,
    )
