"""Further layouts of trackers: several arenas, unique body parts, frames from anywhere, structs."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import openpyxl
import pytest
from refusals import refused, refuses
from scipy.io import savemat

from animarl_envs.importing.import_recipe import ImportRecipe
from animarl_envs.importing.readers import files_in, find_reader, follow, load_readers, read_tracks
from tools.fuzz.layouts import (
    BODIES,
    NAMES,
    NODES,
    POSE,
    dlc_frame,
    write_analysis,
    write_dlc_csv,
    write_dlc_h5,
    write_flytracker,
    write_idtracker_h5,
    write_netcdf,
    write_nwb,
    write_sleap_csv,
    write_trex_csv,
    write_trx,
)


@pytest.mark.parametrize("key", ["tracks", "keypoints", "df_with_missing"])
def test_deeplabcut_hdf_is_known_whatever_its_key(key: str, tmp_path: Path) -> None:
    path = tmp_path / "clip_el.h5"
    dlc_frame().to_hdf(path, key=key, format="table", mode="w")
    (tracks,) = read_tracks(path)
    assert find_reader(path).name == "deeplabcut" and tracks.individuals == NAMES
    np.testing.assert_array_equal(tracks.positions, POSE)


@pytest.mark.parametrize("first", [0, 7, 5000])
@pytest.mark.parametrize("suffix", [".csv", ".h5"])
def test_deeplabcut_frames_may_begin_anywhere(first: int, suffix: str, tmp_path: Path) -> None:
    table = dlc_frame()
    table.index += first
    path = tmp_path / f"clip{suffix}"
    if suffix == ".csv":
        table.to_csv(path)
    else:
        table.to_hdf(path, key="df_with_missing", format="table", mode="w")
    (tracks,) = read_tracks(path)
    assert tracks.start == first
    np.testing.assert_array_equal(tracks.positions, POSE)


@pytest.mark.parametrize("encoding", ["utf-8", "utf-16", "cp1252"])
@pytest.mark.parametrize(
    ("separator", "decimal"), [(";", ","), ("\t", "."), ("\t", ","), (";", ".")]
)
def test_deeplabcut_tables_are_known_in_the_dialects_of_spreadsheets(
    separator: str, decimal: str, encoding: str, tmp_path: Path
) -> None:
    table = dlc_frame().rename(columns={"head": "Schnäuzchen"})
    table.to_csv(tmp_path / "clip.txt", sep=separator, decimal=decimal, encoding=encoding)
    (tracks,) = read_tracks(tmp_path / "clip.txt")
    assert tracks.keypoints == ("Schnäuzchen", "thorax")
    np.testing.assert_array_equal(tracks.positions, POSE)


@pytest.mark.parametrize("suffix", [".csv", ".h5"])
def test_unique_body_parts_of_deeplabcut_are_no_animal(suffix: str, tmp_path: Path) -> None:
    table = dlc_frame()
    for coordinate in ("x", "y", "likelihood"):
        table["net", "single", "corner", coordinate] = 1.0
    path = tmp_path / f"clip{suffix}"
    if suffix == ".csv":
        table.to_csv(path)
    else:
        table.to_hdf(path, key="df_with_missing", format="table", mode="w")
    (tracks,) = read_tracks(path)
    assert tracks.individuals == NAMES and tracks.keypoints == NODES
    assert tracks.provenance["columns_not_used"] == ["corner (a unique body part)"]


def test_a_lone_animal_called_single_is_an_animal(tmp_path: Path) -> None:
    table = dlc_frame().rename(columns={"male": "single"})
    table.drop(columns="female", level="individuals").to_csv(tmp_path / "clip.csv")
    (tracks,) = read_tracks(tmp_path / "clip.csv")
    assert tracks.individuals == ("single",)


def save_analysis(path: Path, axes: str, **changes: Any) -> None:
    """Write an analysis file whose axes are in the order of these letters: f, t, n, x."""
    arrays = {"tracks": POSE, "point_scores": np.full(POSE.shape[:3], 0.9)} | changes
    words = {"f": "frame", "t": "track", "n": "node", "x": "xy"}
    with h5py.File(path, "w") as file:
        for name, array in arrays.items():
            own = [axis for axis in axes if axis != "x" or array.ndim == 4]
            file[name] = array.transpose(["ftnx".index(axis) for axis in own])
            file[name].attrs["dims"] = str([words[axis] for axis in own]).replace("'", '"')
        file["track_names"] = [name.encode() for name in NAMES[: arrays["tracks"].shape[1]]]
        file["node_names"] = [name.encode() for name in NODES]


@pytest.mark.parametrize("axes", ["ftnx", "txnf", "fnxt"])
def test_sleap_analysis_files_are_read_in_every_order_of_axes(axes: str, tmp_path: Path) -> None:
    save_analysis(tmp_path / "a.h5", axes)
    (tracks,) = read_tracks(tmp_path / "a.h5")
    assert tracks.individuals == NAMES and tracks.keypoints == NODES
    np.testing.assert_array_equal(tracks.positions, POSE)
    assert tracks.confidence is not None and (tracks.confidence == 0.9).all()


def without_names(path: Path) -> None:
    with h5py.File(path, "r+") as file:
        del file["track_names"]
        file["track_names"] = np.zeros(0)


def test_sleap_needs_tracks_for_several_animals_alone(tmp_path: Path) -> None:
    one = {"tracks": POSE[:, :1], "point_scores": np.ones((40, 1, 2))}
    save_analysis(tmp_path / "one.h5", "txnf", **one)
    without_names(tmp_path / "one.h5")
    (tracks,) = read_tracks(tmp_path / "one.h5")
    assert tracks.individuals == ("individual_0",)
    np.testing.assert_array_equal(tracks.positions, POSE[:, :1])
    without_names(write_analysis(tmp_path))
    assert "track the individuals in SLEAP" in refused(tmp_path / "clip.analysis.h5")
    table = write_sleap_csv(tmp_path)
    lines = table.read_text().splitlines()
    anonymous = [line.replace("female", "").replace("male", "") for line in lines]
    table.write_text("\n".join(anonymous) + "\n")
    assert "track the individuals in SLEAP" in refused(table)
    table.write_text("\n".join([anonymous[0], *anonymous[1::2]]) + "\n")
    (tracks,) = read_tracks(table)
    np.testing.assert_array_equal(tracks.positions, POSE[:, :1])


def save_project(path: Path, animals: list[tuple[int, int]], tracked: bool) -> None:
    """Write a project with these (frame, animal) alone."""
    import sleap_io as sio

    skeleton, video = sio.Skeleton(list(NODES)), sio.Video("clip.mp4", open_backend=False)
    tracks = [sio.Track(name) for name in NAMES] if tracked else []
    frames: dict[int, list[Any]] = {}
    for t, i in animals:
        track = {"track": tracks[i]} if tracked else {}
        frames.setdefault(t, []).append(sio.Instance.from_numpy(POSE[t, i], skeleton, **track))
    labelled = [sio.LabeledFrame(video, t, instances) for t, instances in frames.items()]
    sio.Labels(labelled, [video], [skeleton], tracks).save(str(path), verbose=False)


def test_sleap_projects_without_tracks_hold_one_animal(tmp_path: Path) -> None:
    save_project(tmp_path / "one.slp", [(t, 0) for t in range(40)], tracked=False)
    (tracks,) = read_tracks(tmp_path / "one.slp")
    assert tracks.individuals == ("individual_0",)
    np.testing.assert_allclose(tracks.positions, POSE[:, :1], rtol=1e-6)
    save_project(tmp_path / "two.slp", [(t, i) for t in range(40) for i in (0, 1)], tracked=False)
    assert "track the individuals in SLEAP" in refused(tmp_path / "two.slp")


def test_sleap_tracks_that_never_meet_are_two_animals(tmp_path: Path) -> None:
    save_project(tmp_path / "turns.slp", [(t, t // 20) for t in range(40)], tracked=True)
    (tracks,) = read_tracks(tmp_path / "turns.slp")
    assert tracks.individuals == NAMES
    np.testing.assert_allclose(tracks.positions[:20, 0], POSE[:20, 0], rtol=1e-6)
    np.testing.assert_allclose(tracks.positions[20:, 1], POSE[20:, 1], rtol=1e-6)
    assert np.isnan(tracks.positions[20:, 0]).all() and np.isnan(tracks.positions[:20, 1]).all()


def save_ethovision(path: Path, sheets: dict[str, tuple[str, str, int]]) -> None:
    """Write a sheet for each (arena, subject, animal); of animal -1 a manual scoring."""
    book = openpyxl.Workbook()
    book.remove(book.active)
    for title, (arena, subject, animal) in sheets.items():
        sheet = book.create_sheet(title)
        for row in (["Number of header lines:", "6"], ["Trial name", "Trial 1"],
                    ["Arena name", arena], ["Subject name", subject]):  # fmt: skip
            sheet.append(row)
        if animal < 0:
            sheet.append(["Trial time", "Subject", "Behavior", "Event"])
            sheet.append([0, subject, "rearing", "state start"])
            continue
        sheet.append(["Trial time", "X center", "Y center"])
        sheet.append(["s", "cm", "cm"])
        for t, (x, y) in enumerate(BODIES[:, animal].tolist()):
            sheet.append([t / 25, x, y])
    book.save(path)


def test_each_arena_of_ethovision_is_a_recording(tmp_path: Path) -> None:
    path = tmp_path / "raw.xlsx"
    save_ethovision(path, {f"{i}": (f"Arena {i}", "Subject 1", i) for i in (0, 1)})
    demos = follow(ImportRecipe(), [path])
    assert {*demos.recording} == {"Trial 1/Arena 0", "Trial 1/Arena 1"}
    assert demos.individuals == ("Subject 1",)
    for i in (0, 1):  # the same in files of their own
        save_ethovision(tmp_path / f"arena{i}.xlsx", {"a": (f"Arena {i}", "Subject 1", i)})
    again = follow(ImportRecipe(), [tmp_path / f"arena{i}.xlsx" for i in (0, 1)])
    assert {*again.recording} == {*demos.recording}
    save_ethovision(path, {f"{i}": ("Arena 1", f"Subject {i}", i) for i in (0, 1)})
    demos = follow(ImportRecipe(), [path])
    assert {*demos.recording} == {"Trial 1"} and len(demos.individuals) == 2


@pytest.mark.parametrize("order", [1, -1])
def test_sheets_of_manual_scoring_are_named_as_not_used(order: int, tmp_path: Path) -> None:
    sheets = {"Track": ("Arena 1", "mouse", 0), "Manual scoring": ("Arena 1", "mouse", -1)}
    save_ethovision(tmp_path / "raw.xlsx", dict(list(sheets.items())[::order]))
    (tracks,) = read_tracks(tmp_path / "raw.xlsx")
    assert tracks.provenance["columns_not_used"] == ["sheet Manual scoring"]
    np.testing.assert_allclose(tracks.bodies[:, 0], BODIES[:, 0], rtol=1e-12)


def test_trex_tables_have_y_downwards_and_gaps_where_the_fish_is_missing(tmp_path: Path) -> None:
    path = write_trex_csv(tmp_path)
    lines = path.read_text().splitlines()
    lines[8] = "7,inf,inf,0.28,1"
    path.write_text("\n".join(lines) + "\n")
    (tracks,) = read_tracks(path)
    assert (tracks.unit, tracks.y_down, tracks.frame_rate) == ("cm", True, 25.0)
    assert (tracks.recording, tracks.individuals) == ("video", ("fish0",))
    kept = np.arange(len(BODIES)) != 7
    np.testing.assert_array_equal(tracks.bodies[kept, 0], BODIES[kept, 0])
    assert np.isnan(tracks.bodies[7]).all()


def test_trx_structs_of_ctrax_place_each_fly_at_its_first_frame(tmp_path: Path) -> None:
    (tracks,) = read_tracks(write_trx(tmp_path))
    assert tracks.frame_rate == 25.0 and tracks.individuals == ("1", "2") and tracks.unit == "px"
    np.testing.assert_array_equal(tracks.bodies[:, 0], BODIES[:, 0])
    np.testing.assert_array_equal(tracks.bodies[1:, 1], BODIES[1:, 1])
    assert np.isnan(tracks.bodies[0, 1]).all()
    assert tracks.provenance["columns_not_used"] == ["theta"]


def test_each_chamber_of_flytracker_is_a_recording(tmp_path: Path) -> None:
    found = read_tracks(write_flytracker(tmp_path), fps=25.0)
    assert [one.recording for one in found] == [f"clip-track/chamber_{k}" for k in (1, 2)]
    for i, one in enumerate(found):
        assert one.individuals == ("1",)
        np.testing.assert_array_equal(one.bodies[:, 0], BODIES[:, i])


def test_other_structs_of_matlab_are_named_with_a_remedy(tmp_path: Path) -> None:
    savemat(tmp_path / "s.mat", {"session": {"mouse": BODIES, "rate": 25.0}})
    with h5py.File(tmp_path / "new.mat", "w", userblock_size=512) as file:
        file["session/mouse"] = BODIES.T
    for name in ("s.mat", "new.mat"):
        sentence = refused(tmp_path / name)
        assert "the struct session (mouse" in sentence and "save('tracks.mat'" in sentence


def test_netcdf_of_movement_is_read_as_movement_reads_it(tmp_path: Path) -> None:
    (tracks,) = read_tracks(write_netcdf(tmp_path))
    assert tracks.individuals == NAMES and tracks.frame_rate == 25.0 and tracks.y_down
    np.testing.assert_array_equal(tracks.positions, POSE)
    (tmp_path / "old.nc").write_bytes(b"CDF\x01" + bytes(40))
    assert "engine='h5netcdf'" in refused(tmp_path / "old.nc")


@pytest.mark.parametrize("engine", ["h5netcdf", "netcdf4"])
def test_netcdf_by_both_libraries_of_xarray(engine: Any, tmp_path: Path) -> None:
    pytest.importorskip("movement")
    from movement.io import load_poses

    dataset = load_poses.from_numpy(
        POSE.transpose(0, 3, 2, 1), individual_names=[*NAMES], keypoint_names=[*NODES], fps=25.0
    )
    dataset.attrs["source_software"] = "none"
    dataset.to_netcdf(tmp_path / "clip.nc", engine=engine)
    (tracks,) = read_tracks(tmp_path / "clip.nc")
    assert tracks.individuals == NAMES and tracks.keypoints == NODES
    np.testing.assert_array_equal(tracks.positions, POSE)


def test_nwb_with_poses_has_an_animal_for_each_container(tmp_path: Path) -> None:
    (tracks,) = read_tracks(write_nwb(tmp_path))
    places = [NAMES.index(name) for name in tracks.individuals]
    np.testing.assert_array_equal(tracks.positions, POSE[:, places])
    assert (tracks.frame_rate, tracks.start_time, tracks.keypoints) == (25.0, 2.0, NODES)
    with h5py.File(tmp_path / "clip.nwb", "r+") as file:
        for container in file["processing/behavior"].values():
            container.attrs["neurodata_type"] = "Other"
    assert "no PoseEstimation" in refused(tmp_path / "clip.nwb")
    with h5py.File(tmp_path / "clip.nwb", "r+") as file:
        file["general/away"] = h5py.ExternalLink("other.nwb", "/general")
    assert "link to elsewhere" in refused(tmp_path / "clip.nwb")


def never_written(path: Path) -> None:
    with h5py.File(path, "w") as file:
        file.create_dataset("trajectories", (40, 2, 2), "f8")


def half_written(path: Path) -> None:
    with h5py.File(path, "w") as file:
        file.create_dataset("trajectories", (40, 2, 2), "f8", chunks=(10, 2, 2))
        file["trajectories"][:20] = BODIES[:20]


@pytest.mark.parametrize("write", [never_written, half_written])
def test_datasets_that_were_never_written_are_no_zeros(
    write: Callable[[Path], None], tmp_path: Path
) -> None:
    write(tmp_path / "trajectories.h5")
    assert "never written" in refused(tmp_path / "trajectories.h5", fps=25.0)


def test_datasets_whose_empty_places_are_nan_have_gaps(tmp_path: Path) -> None:
    path = write_idtracker_h5(tmp_path)
    with h5py.File(path, "r+") as file:
        del file["trajectories"]
        whole = {"chunks": (10, 2, 2), "fillvalue": np.nan}
        file.create_dataset("trajectories", (40, 2, 2), "f8", **whole)[:20] = BODIES[:20]
    (tracks,) = read_tracks(path)
    np.testing.assert_array_equal(tracks.bodies[:20], BODIES[:20])
    assert np.isnan(tracks.bodies[20:]).all()


def test_arrays_with_more_animals_than_frames_are_asked_about(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", BODIES.transpose(1, 0, 2))
    sentence = refused(tmp_path / "a.npy", fps=25.0)
    assert "2 frames of 40 individuals" in sentence and "axes=[individual, frame, xy]" in sentence
    (tracks,) = read_tracks(tmp_path / "a.npy", axes=["individual", "frame", "xy"])
    np.testing.assert_array_equal(tracks.bodies, BODIES)


def test_a_folder_is_all_files_in_it(tmp_path: Path) -> None:
    write_dlc_csv(tmp_path)
    for name in ("film.mp4", ".hidden.csv", "notes"):
        (tmp_path / name).write_text("x")
    (tmp_path / "more").mkdir()
    extra = tmp_path / "more" / "b.csv"
    assert files_in([tmp_path]) == [tmp_path / "dlc.csv"]
    assert files_in([extra, tmp_path]) == [extra, tmp_path / "dlc.csv"]
    refuses("no file in the folder", files_in, [tmp_path / "more"])


def test_a_file_of_readers_that_fails_is_refused(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text("import nothing_of_this_name\n")
    refuses("mine.py: it cannot be run .ModuleNotFoundError", load_readers, tmp_path / "mine.py")


def test_hdf_files_beside_each_other_keep_their_readers(tmp_path: Path) -> None:
    found = {write(tmp_path): name for write, name in (
        (write_dlc_h5, "deeplabcut"), (write_analysis, "sleap"), (write_idtracker_h5, "idtracker"),
    )}  # fmt: skip
    assert {path: find_reader(path).name for path in found} == found
