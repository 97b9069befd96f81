"""Episodes as movement's netCDF and as NWB: what others open, and what an import reads back."""

import json
import sys
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
from animarl_envs.errors import MissingExtraError
from animarl_envs.importing.netcdf_io import write_netcdf
from animarl_envs.importing.nwb_io import write_nwb
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


def test_nwb_has_a_position_for_each_episode(tmp_path: Path) -> None:
    pynwb = pytest.importorskip("pynwb")
    made, out = episodes(2), tmp_path / "tracks.nwb"
    write_nwb(out, made, [{"recording": f"rec {i}"} for i in range(2)], CM)
    with pynwb.NWBHDF5IO(out, "r") as file:
        found = file.read().processing["behavior"]["episode_0001"]
        prey = found.spatial_series["prey"]
        assert set(found.spatial_series) == set(made.individuals)
        assert (prey.unit, prey.rate) == ("cm", pytest.approx(1 / made.dt))
        assert json.loads(prey.comments) == {"recording": "rec 1"}
        np.testing.assert_allclose(prey.data[:], 10 * made.path(1)[:, 2])


def test_without_pynwb_one_sentence_says_what_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "pynwb", None)
    with pytest.raises(MissingExtraError, match=r"animarl\[nwb\]"):
        write_nwb(tmp_path / "tracks.nwb", episodes(1), [{"recording": "one"}], CM)


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


def test_the_notebook_opens_simulated_tracks(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for module in ("xarray", "h5netcdf", "movement"):
        pytest.importorskip(module)
    notebook = Path(__file__).parents[3] / "examples" / "open_simulated_tracks.ipynb"
    cells = json.loads(notebook.read_text(encoding="utf-8"))["cells"]
    monkeypatch.chdir(tmp_path)

    def run(command: list[str], check: bool) -> None:
        assert check and command[:3] == [sys.executable, "-m", "animarl_algos.cli.main"]
        animarl(*command[3:])

    monkeypatch.setattr("subprocess.run", run)  # in this process, which has compiled the worlds
    names: dict[str, Any] = {}
    for cell in cells:
        if cell["cell_type"] == "code":
            exec("".join(cell["source"]), names)
    assert names["speed"].mean() > 0 and len(names["table"]) > 100
