"""Episodes as movement's netCDF: what xarray and movement open, and what an import reads back."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import animarl
from recordings import episodes_along

from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.demos.episode import Episodes
from animarl_envs.demos.summary import Unit
from animarl_envs.importing.netcdf_io import write_netcdf
from animarl_envs.importing.readers.registry import read_tracks

CM = Unit("cm", 10.0)


def episodes(count: int) -> Demonstrations:
    rng = np.random.default_rng(0)
    paths = [rng.normal(0, 0.1, (20 + i, 3, 2)).cumsum(axis=0) for i in range(count)]
    return replace(episodes_along(paths), condition=np.arange(count) % 2)


def written(out: Path, made: Episodes) -> Path:
    heads = [{"recording": f"rec {i}/0", "condition": "sham"} for i in range(len(made))]
    write_netcdf(out, made, heads, CM)
    return out


@pytest.mark.parametrize("engine", ["h5netcdf", "netcdf4"])
def test_netcdf_opens_as_a_dataset_of_movement(engine: Any, tmp_path: Path) -> None:
    xarray = pytest.importorskip("xarray")
    pytest.importorskip("h5netcdf" if engine == "h5netcdf" else "netCDF4")
    one, several = episodes(1), episodes(3)
    with xarray.open_dataset(written(tmp_path / "one.nc", one), engine=engine) as found:
        assert found.position.dims == ("time", "space", "keypoints", "individuals")
        assert found.confidence.dims == ("time", "keypoints", "individuals")
        assert found.individuals.values.tolist() == list(one.individuals)
        assert (found.attrs["fps"], found.attrs["space_unit"]) == (1 / one.dt, "cm")
        np.testing.assert_allclose(
            found.position.sel(space="y", individuals="prey").values[:, 0],
            10 * one.path(0)[:, 2, 1],
        )
        if engine == "h5netcdf":
            kinematics = pytest.importorskip("movement.kinematics")
            speed = kinematics.compute_speed(found.position)
            assert speed.dims == ("time", "keypoints", "individuals")
    out = written(tmp_path / "several.nc", several)
    with xarray.open_dataset(out, engine=engine, group="episode_0002") as found:
        assert found.attrs["recording"] == "rec 2/0" and len(found.time) == 22


def test_netcdf_is_read_back_as_it_was(tmp_path: Path) -> None:
    made = episodes(3)
    first, again = (written(tmp_path / f"{name}.nc", made) for name in "ab")
    assert first.read_bytes() == again.read_bytes()
    for number, tracks in enumerate(read_tracks(first)):
        assert tracks.recording == f"rec {number}/0" and tracks.condition == number % 2
        assert (tracks.unit, tracks.y_down) == ("cm", False)
        assert tracks.frame_rate == pytest.approx(1 / made.dt)
        np.testing.assert_allclose(tracks.bodies, 10 * made.path(number))


def test_netcdf_and_parquet_of_demonstrations_are_imported_again(tmp_path: Path) -> None:
    made = episodes(4)
    file = made.save(tmp_path / "demos.npz")
    for suffix in ("nc", "parquet"):
        out = tmp_path / f"tracks.{suffix}"
        animarl("data", "convert", file, "--out", out)
        back = tmp_path / f"{suffix}.npz"
        animarl("import", out, "--target", "prey", "--out", back)
        found = Demonstrations.load(back)
        assert found.individuals == made.individuals and len(found) == len(made)
        assert suffix != "nc" or found.condition.tolist() == made.condition.tolist()
