"""What columns of a table are taken for: animals, their parts, boxes, places, or none of these."""

import shlex
from pathlib import Path

import numpy as np
import pytest
from commands import animarl
from refusals import refused

from animarl_envs.importing.readers import read, read_tracks
from animarl_envs.importing.table_columns import find_columns, split_names
from animarl_envs.importing.table_layout import Layout
from animarl_envs.importing.tracks import LONE

COUNT = 60
A, B = np.cumsum(np.random.default_rng(0).normal(0, 2, (2, COUNT, 2)), axis=1).round(3) + [
    [[100.0, 100.0]],
    [[300.0, 200.0]],
]


def written(folder: Path, header: str, *values: object, name: str = "t.csv") -> Path:
    """A table with these columns: numbers or words for each row, or one for all."""
    columns = [np.broadcast_to(value, COUNT) for value in values]
    rows = [",".join(map(str, row)) for row in zip(*columns, strict=True)]
    (folder / name).write_text("\n".join([*filter(None, [header]), *rows]) + "\n")
    return folder / name


def test_names_are_cut_in_individual_and_body_part() -> None:
    assert split_names(["nose", "left_ear", "tail2"]) == [
        ("", "nose"), ("", "left_ear"), ("", "tail2"),
    ]  # fmt: skip
    assert split_names(["B_nose", "W_nose"]) == [("B", "nose"), ("W", "nose")]
    assert split_names(["nose_B", "tail_base_B"]) == [("B", "nose"), ("B", "tail_base")]
    assert split_names(["inst0.head", "inst0.tail"]) == [("inst0", "head"), ("inst0", "tail")]
    assert split_names(["maleNose", "femaleNose"]) == [("male", "Nose"), ("female", "Nose")]
    assert split_names(["head1", "head2"]) == [("1", "head"), ("2", "head")]
    assert split_names(["male", "female"]) == [("male", "centroid"), ("female", "centroid")]
    assert split_names(["body1", "body2"]) == [("body1", "centroid"), ("body2", "centroid")]
    assert split_names(["nose", "male"]) is None
    assert split_names(["l_1", "l_2", "r_1", "r_2"]) is None


def columns_of(header: str) -> list[tuple[str, str, str]]:
    """Individual, keypoint and columns of each position that a header has."""
    found = find_columns(Layout(tuple(header.split(","))))
    assert not found.refusal
    return [(one.individual, one.keypoint, " ".join(one.columns)) for one in found.positions]


@pytest.mark.parametrize(
    ("header", "expected"),
    [
        ("a-x,a-y,c-x,c-y", [("a", "centroid", "a-x a-y"), ("c", "centroid", "c-x c-y")]),
        ("x,y,mate-x,mate-y", [("", "centroid", "x y"), ("mate", "centroid", "mate-x mate-y")]),
        ("x,y,vel_x,vel_y,std_x,std_y", [("", "centroid", "x y")]),
        ("x_a,y_a,x_std,y_std,a_vel_x,a_vel_y", [("a", "centroid", "x_a y_a")]),
        ("a_x,a_y,rot_x,rot_y,rot_z,rot_w,o_x,o_y,o_w", [("a", "centroid", "a_x a_y")]),
        ("a_x,a_y,corner1_x,corner1_y,top_left_x,top_left_y", [("a", "centroid", "a_x a_y")]),
        ("xmin,ymin,xmax,ymax", [("", "centroid", "xmin ymin xmax ymax")]),
        ("x_min,y_min,x_max,y_max", [("", "centroid", "x_min y_min x_max y_max")]),
        ("x,y,xmin,ymin,xmax,ymax", [("", "centroid", "x y")]),
        ("id,x1,y1,x2,y2", [("", "centroid", "x1 y1 x2 y2")]),
        ("bbox_x1,bbox_y1,bbox_x2,bbox_y2", [("", "centroid", "bbox_x1 bbox_y1 bbox_x2 bbox_y2")]),
        ("location-long,location-lat", [("", "centroid", "location-long location-lat")]),
        ("id,x,y,mate_x,mate_y", [("", "centroid", "x y")]),
        ("id,head.x,head.y,head.score", [("", "head", "head.x head.y")]),
    ],
)
def test_columns_of_positions_are_found_by_their_names(
    header: str, expected: list[tuple[str, str, str]]
) -> None:
    assert columns_of(header) == expected


UNCLEAR = {
    "x,y,x_f,y_f": "left over beside 'x' and 'y'",
    "nose_x,nose_y,implant_x,implant_y": "of several individuals or of parts of one",
    "x_l_1,y_l_1,x_l_2,y_l_2,x_r_1,y_r_1,x_r_2,y_r_2": "of several individuals or of parts of one",
    "x_center,y_center,x_centroid,y_centroid": "are each a position",
}


@pytest.mark.parametrize("header", UNCLEAR)
def test_pairs_that_fit_no_part_are_refused_with_options_that_work(
    header: str, tmp_path: Path
) -> None:
    names = header.split(",")
    values = [[*A.T, *B.T][k % 4] + k for k in range(len(names))]
    path = written(tmp_path, f"frame,{header}", np.arange(COUNT), *values)
    sentence = refused(path)
    assert UNCLEAR[header] in sentence
    words = shlex.split(
        sentence.partition("by --source ")[2] or sentence.partition("say --source ")[2]
    )
    assert words[1] == "--option"
    out = tmp_path / "demos.npz"
    more = ("--individuals", "1") if "option" in words[2] else ()
    animarl("import", path, "--source", *words[:3], "--fps", 25, "--out", out, *more)
    assert read(out).num_episodes


def test_keypoints_are_read_from_long_and_wide_tables(tmp_path: Path) -> None:
    frames = np.repeat(np.arange(COUNT // 2), 2)
    parts = np.tile(["nose", "tailbase"], COUNT // 2)
    for header in ("frame,node,x,y", "frame,id,x,y", "frame,bodypart,x,y"):
        (tracks,) = read_tracks(written(tmp_path, header, frames, parts, *A.T))
        assert tracks.individuals == (LONE,) and tracks.keypoints == ("nose", "tailbase")
        np.testing.assert_array_equal(tracks.positions[:, 0], A.reshape(-1, 2, 2))
    header = "frame,B_nose_x,B_nose_y,W_nose_x,W_nose_y,B_tail_x,B_tail_y,W_tail_x,W_tail_y"
    path = written(tmp_path, header, np.arange(COUNT), *A.T, *B.T, *(A - 5).T, *(B - 5).T)
    (tracks,) = read_tracks(path)
    assert tracks.individuals == ("B", "W") and tracks.keypoints == ("nose", "tail")
    np.testing.assert_array_equal(tracks.positions[:, 1, 1], B - 5)


def test_names_in_columns_follow_individuals_that_change_their_place(tmp_path: Path) -> None:
    """SLEAP's rows of frames: which individual an instance is stands in a column of its own."""
    swapped = np.arange(COUNT) % 7 == 0
    first, second = np.where(swapped[:, None], B, A), np.where(swapped[:, None], A, B)
    names = np.where(swapped, "f", "m"), np.where(swapped, "m", "f")
    header = "frame_idx,i0.track,i0.head.x,i0.head.y,i1.track,i1.head.x,i1.head.y"
    path = written(tmp_path, header, np.arange(COUNT), names[0], *first.T, names[1], *second.T)
    (tracks,) = read_tracks(path)
    assert tracks.individuals == ("f", "m")
    np.testing.assert_array_equal(tracks.positions[:, :, 0], np.stack([B, A], axis=1))


def test_corners_are_a_box_unless_they_are_two_animals(tmp_path: Path) -> None:
    header = "frame,x1,y1,x2,y2"
    size = np.random.default_rng(1).uniform(8, 12, (COUNT, 2))
    (box,) = read_tracks(written(tmp_path, header, np.arange(COUNT), *(A - size).T, *(A + size).T))
    np.testing.assert_allclose(box.bodies[:, 0], A)
    assert "edges of a box" in " ".join(box.provenance["notes"])
    (two,) = read_tracks(written(tmp_path, header, np.arange(COUNT), *A.T, *B.T))
    assert two.individuals == ("1", "2")


def test_degrees_are_projected_to_metres(tmp_path: Path) -> None:
    """A degree of latitude is 111.2 km, one of longitude at 60 degrees half of that."""
    metres = (A - A.mean(axis=0)) * [2, 1]
    longitude, latitude = (metres / 111_195).T + [[179.9999], [60.0]]
    longitude = (longitude + 180) % 360 - 180
    path = written(
        tmp_path, "time (s),location-long,location-lat,individual-local-identifier",
        np.arange(COUNT), longitude, latitude, "lion",
    )  # fmt: skip
    (tracks,) = read_tracks(path)
    assert tracks.unit == "m" and tracks.individuals == ("lion",)
    walked = np.diff(tracks.bodies[:, 0], axis=0)
    np.testing.assert_allclose(walked, np.diff(A, axis=0), atol=1e-3)


def test_arenas_of_a_table_are_recordings(tmp_path: Path) -> None:
    arena = np.repeat([0, 1], COUNT // 2)
    frame = np.tile(np.arange(COUNT // 2), 2)
    for column in ("arena", "dish", "well"):
        path = written(tmp_path, f"frame,{column},id,x,y", frame, arena, "fly", *A.T)
        assert [one.recording for one in read_tracks(path)] == ["t/0", "t/1"]
    path = written(
        tmp_path,
        "trial,frame,arena,id,x,y",
        "one",
        frame,
        arena,
        "fly",
        *(A + 500 * arena[:, None]).T,
    )
    first, second = read_tracks(path)
    assert (first.recording, second.recording) == ("one/0", "one/1")
    for one in (first, second):  # side by side in one image: each is moved to its own middle
        np.testing.assert_allclose(one.bodies.min(axis=(0, 1)), -one.bodies.max(axis=(0, 1)))


def test_what_looks_like_no_animal_is_said_unless_it_is_named(tmp_path: Path) -> None:
    header, out = "frame,a_x,a_y,b_x,b_y,thing_x,thing_y", tmp_path / "demos.npz"
    path = written(tmp_path, header, np.arange(COUNT), *A.T, *(A + [3, 4]).T, 5, 5)
    command = ("import", path, "--fps", 25, "--target", "none", "--out", out)
    printed = " ".join(animarl(*command).split())
    assert (
        "thing never moves, so it may be a landmark" in printed and "--individuals a,b" in printed
    )
    assert "a and b keep their distance" in printed and "--individuals a,thing" in printed
    printed = animarl(*command, "--individuals", "a,b,thing")
    assert "never moves" not in printed and "distance, so" not in printed


def test_tables_without_names_or_with_an_unfinished_line(tmp_path: Path) -> None:
    (tracks,) = read_tracks(written(tmp_path, "", np.arange(COUNT) / 25, *A.T))
    assert tracks.frame_rate == 25
    np.testing.assert_array_equal(tracks.bodies[:, 0], A)
    (tracks,) = read_tracks(written(tmp_path, "", np.arange(COUNT), *A.T))
    assert tracks.frame_rate is None and "no line of names" in tracks.provenance["notes"][0]
    path = written(tmp_path, "frame,id,x,y", np.arange(COUNT), "a", *A.T)
    whole = path.read_text().rstrip("\n")
    path.write_text(whole)
    (tracks,) = read_tracks(path)
    np.testing.assert_array_equal(tracks.bodies[:, 0], A)
    path.write_text(whole[:-5])
    (tracks,) = read_tracks(path)
    np.testing.assert_array_equal(tracks.bodies[:-1, 0], A[:-1])
    assert np.isnan(tracks.bodies[-1, 0, 1]) and "left out" in tracks.provenance["notes"][0]


def test_trajectories_of_idtracker_1(tmp_path: Path) -> None:
    values = [np.where(np.arange(COUNT) < 3, np.nan, v) for v in (*A.T, *B.T)]
    header = "X1\tY1\tProbId1\tX2\tY2\tProbId2"
    table = written(tmp_path, header.replace("\t", ","), *values[:2], 1.0, *values[2:], 0.9)
    path = tmp_path / "trajectories.txt"
    path.write_text(table.read_text().replace(",", "\t").replace("nan", "NaN"))
    (tracks,) = read_tracks(path)
    assert tracks.individuals == ("1", "2") and tracks.y_down
    assert np.isnan(tracks.bodies[:3]).all()
    np.testing.assert_array_equal(tracks.bodies[3:, 1], B[3:])


@pytest.mark.parametrize("lost", ["0", "0,0"])
def test_points_in_comma_tables_are_decimal_points(lost: str, tmp_path: Path) -> None:
    rows = [f"{t},{x:.3f},{y:.3f}" for t, (x, y) in enumerate(A)]
    rows[9] = f"9,{lost},0"[:5]
    (tmp_path / "t.csv").write_text("\n".join(["frame,x,y", *rows]) + "\n")
    (tracks,) = read_tracks(tmp_path / "t.csv")
    np.testing.assert_allclose(np.delete(tracks.bodies[:, 0], 9, axis=0), np.delete(A, 9, axis=0))


def test_a_suggested_command_reads_the_file_or_is_not_given(tmp_path: Path) -> None:
    values = np.arange(COUNT), np.repeat("a", COUNT), *A.T
    path = written(tmp_path, "frame,beast,east,north", *values)
    command = refused(path).partition("such as: ")[2].partition(" (with")[0]
    words = shlex.split(command)
    assert words[:2] == ["animarl", "import"]
    out = tmp_path / "demos.npz"
    animarl(*words[1:-1], out)
    assert read(out).individuals == ("a",)
    assert "animarl import" not in refused(written(tmp_path, "frame,a,b,c", *values[:1], *A.T, 1))
