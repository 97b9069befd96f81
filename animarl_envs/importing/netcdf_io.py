"""Episodes as netCDF, as the package ``movement`` lays out poses; :mod:`xarray` opens it."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from animarl_envs.demos.episode import Episodes
from animarl_envs.demos.summary import Unit
from animarl_envs.errors import require_extra
from animarl_envs.files import write_then_rename
from animarl_envs.importing.tracks import CENTROID

AXES = ("time", "space", "keypoints", "individuals")  # of positions; confidence has no space
Y_UP = "up"  # as in the arena; in images, as movement takes them, y grows downwards


def write_netcdf(
    out: Path, episodes: Episodes, heads: Sequence[Mapping[str, object]], unit: Unit
) -> None:
    """Write each episode as a dataset of movement: one alone as the file, several as its groups.

    ``heads`` are the attributes of each episode, its ``recording`` among them. Positions are in
    ``unit``, as the attribute ``space_unit`` says; time is in seconds.
    """
    with require_extra("writing netCDF", "data"):
        import h5py
    options = {"track_order": True, "locking": False}  # the part is locked already
    with write_then_rename(out) as part, h5py.File(part, "w", **options) as file:
        for number, head in enumerate(heads):
            group = file
            if len(heads) > 1:
                group = file.create_group(f"episode_{number:04d}", track_order=True)
            path = unit.per_arena_unit * episodes.path(number)
            seconds = np.arange(len(path)) * episodes.dt
            names = h5py.string_dtype()
            coordinates: dict[str, Any] = {
                "time": seconds,
                "space": np.array(["x", "y"], dtype=names),
                "keypoints": np.array([CENTROID], dtype=names),
                "individuals": np.array(list(episodes.individuals), dtype=names),
            }
            for axis, values in coordinates.items():
                group.create_dataset(axis, data=values).make_scale(axis)
            confidence = np.ones((len(path), 1, len(episodes.individuals)))
            for name, values, axes in (
                ("position", path.transpose(0, 2, 1)[:, :, None], AXES),
                ("confidence", confidence, AXES[:1] + AXES[2:]),
            ):
                variable = group.create_dataset(name, data=values)
                for place, axis in enumerate(axes):
                    variable.dims[place].attach_scale(group[axis])
            group.attrs.update(
                {
                    "source_software": "AnimaRL",
                    "ds_type": "poses",
                    "fps": 1.0 / episodes.dt,
                    "time_unit": "seconds",
                    "space_unit": unit.name,
                    "y_axis": Y_UP,
                    "condition_number": int(episodes.condition[number]),
                    **head,
                }
            )
