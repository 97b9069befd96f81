"""Readers: known answers on files written in each layout, and the recordings at hand.

What is read of every layout, number for number, is in the golden table of files.
"""

from pathlib import Path

import numpy as np
import pytest
from refusals import refused, refuses

from animarl_envs.demos.demonstrations import Demonstrations
from animarl_envs.fitting.result import fit_locomotion
from animarl_envs.fitting.transitions import transitions
from animarl_envs.importing.import_recipe import ImportRecipe
from animarl_envs.importing.readers import (
    available_readers,
    default_recipe,
    find_reader,
    follow,
    get_reader,
    read,
    read_tracks,
)
from animarl_envs.locomotion import Locomotion
from tools.fuzz.layouts import (
    BODIES,
    KINDS,
    NAMES,
    NODES,
    POSE,
    write_mothvr,
    write_slp,
    write_trex,
)
from tools.packaged_data.moth_comparison import RECORDED_FIT

HOLDING = {holds: [k for k in KINDS if KINDS[k].holds == holds] for holds in ("bodies", "poses")}
FOUND = [kind for kind in KINDS if kind != "movement"]  # which is only used when it is named


def test_every_reader_has_a_file_with_a_known_answer() -> None:
    assert {kind.source for kind in KINDS.values()} == {one.name for one in available_readers()}


@pytest.mark.parametrize("kind", FOUND)
def test_the_reader_is_found_by_a_look_at_the_file(kind: str, tmp_path: Path) -> None:
    assert find_reader(KINDS[kind].write(tmp_path)).name == KINDS[kind].source


@pytest.mark.parametrize("kind", HOLDING["bodies"])
def test_reader_of_bodies_returns_the_positions_written(kind: str, tmp_path: Path) -> None:
    (tracks,) = read_tracks(KINDS[kind].write(tmp_path))
    order = sorted(range(2), key=lambda i: tracks.individuals[i] in ("male", "1", "individual_0"))
    np.testing.assert_allclose(tracks.bodies[:, order[::-1]], BODIES, rtol=1e-12)
    if kind.startswith("idtracker"):
        assert tracks.frame_rate == pytest.approx(25.0)


@pytest.mark.parametrize("kind", HOLDING["poses"])
def test_reader_of_poses_returns_every_keypoint(kind: str, tmp_path: Path) -> None:
    (tracks,) = read_tracks(KINDS[kind].write(tmp_path), KINDS[kind].source)
    assert tracks.individuals == NAMES and tracks.keypoints == NODES
    np.testing.assert_allclose(tracks.positions, POSE, rtol=1e-6)
    assert tracks.y_down


def test_trex_reader_returns_positions_frame_rate_and_gaps(tmp_path: Path) -> None:
    path = write_trex(tmp_path)
    (tracks,) = read_tracks(path)
    np.testing.assert_array_equal(tracks.bodies[:, 0], BODIES[:, 0])
    assert tracks.frame_rate == 25.0 and tracks.unit == "cm" and tracks.recording == "video"
    with np.load(path) as archive:
        arrays = {key: archive[key] for key in archive.files}
    kept = np.arange(len(BODIES)) != 7
    for key in ("frame", "X#wcentroid", "Y#wcentroid"):
        arrays[key] = arrays[key][kept]
    np.savez(path, **arrays)
    (tracks,) = read_tracks(path)
    np.testing.assert_array_equal(tracks.bodies[kept, 0], BODIES[kept, 0])
    assert np.isnan(tracks.bodies[7]).all()


def test_trex_files_of_one_video_become_one_recording(tmp_path: Path) -> None:
    write_trex(tmp_path)
    files = sorted(tmp_path.glob("video_fish*.npz"))
    demos = follow(ImportRecipe(target="fish1"), files)
    assert demos.individuals == ("fish0", "fish1") and demos.dt == pytest.approx(0.04)
    assert demos.recording.tolist() == ["video"]


def test_a_hit_counts_in_the_step_of_its_frame_and_in_no_other(tmp_path: Path) -> None:
    """Frames 16 to 30 lead to the second sample, 30 included; frame 0 leads to none."""
    path = write_mothvr(tmp_path)
    hits = {0: "L", 16: "L", 30: "R", 31: "R", 89: "B"}
    lines = path.read_text().splitlines()
    for t in range(91):
        columns = lines[t + 1].split(",")
        lines[t + 1] = ",".join([*columns[:4], hits.get(t, "N"), *columns[5:]])
    path.write_text("\n".join(lines) + "\n")
    demos = read(path)
    assert demos.signals["odour_left"].tolist() == [False, True, False, False, False, True]
    assert demos.signals["odour_right"].tolist() == [False, True, True, False, False, True]


def test_silkmoth_keeps_the_final_frame(tmp_path: Path) -> None:
    path = write_mothvr(tmp_path)
    path.write_text("\n".join(path.read_text().splitlines()[:-3]) + "\n")
    assert read(path).positions[-1, 0, 0] == pytest.approx(0.3 - 0.25 * 87 / 90)


def test_tables_are_mapped_by_options(tmp_path: Path) -> None:
    """Other names, several recordings, times instead of frames, semicolons and decimal commas."""
    rows = [
        f"{run};{t / 25:.2f};{who};{BODIES[t, i, 0]:.6f};{BODIES[t, i, 1]:.6f}".replace(".", ",")
        for run in ("a", "b")
        for t in range(len(BODIES))
        for i, who in enumerate(NAMES)
    ]
    (tmp_path / "long.csv").write_text("run;t_s;animal;px;py\n" + "\n".join(rows) + "\n")
    found = read_tracks(
        tmp_path / "long.csv", "long-table", time="t_s", individual="animal", x="px", y="py",
        recording="run", decimal=",", unit="mm", y_down=True,
    )  # fmt: skip
    assert [tracks.recording for tracks in found] == ["a", "b"]
    for tracks in found:
        assert tracks.individuals == ("female", "male") and tracks.frame_rate == 25.0
        assert tracks.unit == "mm" and tracks.y_down
        np.testing.assert_allclose(tracks.bodies, BODIES[:, ::-1], atol=1e-6)


@pytest.mark.parametrize(
    ("name", "header", "row"),
    [
        ("any.csv", "time,x1,y1,x2,y2", "{time:.3f},{t},1,{t},2"),
        ("any.csv", "seconds,x1,y1,x2,y2", "{time:.3f},{t},1,{t},2"),
        ("trajectories.csv", "x1,y1,x2,y2", "{t},1,{t},2"),
        (
            "any.csv", "frame,time,individual,x,y,probability",
            "{t},{time:.3f},1,{t},1,0.9\n{t},{time:.3f},2,{t},2,0.8",
        ),
    ],
)  # fmt: skip
def test_tables_of_idtracker_of_all_versions_grow_downwards(
    name: str, header: str, row: str, tmp_path: Path
) -> None:
    rows = [row.format(t=t, time=t / 60) for t in range(200)]
    (tmp_path / name).write_text("\n".join([header, *rows]) + "\n")
    (tracks,) = read_tracks(tmp_path / name)
    assert tracks.y_down and tracks.provenance["tracker"] == "idtracker.ai"
    assert tracks.individuals == ("1", "2") and tracks.bodies[7].tolist() == [[7, 1], [7, 2]]
    assert tracks.frame_rate == (60.0 if "time" in row else None)
    assert (tracks.confidence is not None) == ("probability" in header)


@pytest.mark.parametrize("cells", ["(#),,(cm),(cm)", "#,-,(cm),(cm)", "[frame],[],[cm],[cm]"])
def test_a_row_of_units_with_an_odd_cell_gives_the_units(cells: str, tmp_path: Path) -> None:
    (tmp_path / "t.csv").write_text(f"frame,id,x,y\n{cells}\n0,a,1,2\n1,a,1,3\n")
    (tracks,) = read_tracks(tmp_path / "t.csv")
    assert tracks.unit == "cm" and len(tracks) == 2
    cm = default_recipe(get_reader("long-table"), frame_rate=9.0, scaling={"px_per_cm": 12.0})
    refuses("t: it is in cm, not in pixels: leave px_per_cm out", follow, cm, [tmp_path / "t.csv"])


@pytest.mark.parametrize("cell", [",", ";"])
def test_empty_rows_below_a_table_are_no_rows(cell: str, tmp_path: Path) -> None:
    path = tmp_path / "t.csv"
    path.write_text("frame,id,x,y\n0,a,1,2\n1,a,,\n,,,\n,,,\n".replace(",", cell))
    (tracks,) = read_tracks(path)
    assert len(tracks) == 2
    path.write_text(path.read_text() + "2,,,\n".replace(",", cell))
    assert "line 4 has no id" in refused(path)


def test_sleap_project_of_two_videos_gives_two_recordings(tmp_path: Path) -> None:
    import sleap_io as sio

    labels = sio.load_slp(str(write_slp(tmp_path)), open_videos=False)
    second = sio.Video("other.mp4", open_backend=False)
    moved = [
        sio.LabeledFrame(
            video=second, frame_idx=frame.frame_idx,
            instances=[
                sio.Instance.from_numpy(
                    one.numpy() + 5.0, skeleton=one.skeleton, track=one.track
                )
                for one in frame.instances
            ],
        )
        for frame in labels.labeled_frames[:30]
    ]  # fmt: skip
    both = sio.Labels(
        [*labels.labeled_frames, *moved], videos=[*labels.videos, second],
        skeletons=labels.skeletons, tracks=labels.tracks,
    )  # fmt: skip
    both.save(str(tmp_path / "both.slp"), verbose=False)
    first, other = read_tracks(tmp_path / "both.slp")
    assert (first.recording, other.recording) == ("both/0", "both/1")
    np.testing.assert_allclose(first.positions, POSE, rtol=1e-6)
    np.testing.assert_allclose(other.positions, POSE[:30] + 5.0, rtol=1e-6)


@pytest.fixture(scope="module")
def moths(data_dir: Path) -> Demonstrations:
    files = sorted((data_dir / "silkmoth_mothvr" / "raw").glob("*.csv"))
    return follow(default_recipe(get_reader("mothvr")), files)


@pytest.mark.realdata
def test_import_of_silkmoth_runs(moths: Demonstrations) -> None:
    assert moths.num_episodes == 24
    assert (moths.outcome == 1).sum() == 22 and (moths.outcome == 0).sum() == 2
    assert np.linalg.norm(moths.positions, axis=2).max() < 0.5  # metres
    last = moths.positions[moths.offsets[1:] - 1, 0]
    assert np.linalg.norm(last[moths.outcome == 1], axis=1).max() < 0.0512
    assert not (moths.lengths > 601).any()


@pytest.mark.realdata
def test_onset_fit_of_silkmoth_runs_is_near_the_published_reanalysis(moths: Demonstrations) -> None:
    (fit,) = fit_locomotion(moths, "onset", split=None).individuals
    assert fit.damping == pytest.approx(0.341, abs=0.005)
    assert fit.thrust == pytest.approx(0.0171, abs=0.0002)
    assert Locomotion(round(fit.damping, 3), round(fit.thrust, 4)) == RECORDED_FIT


@pytest.mark.realdata
@pytest.mark.parametrize("as_recorded", [False, True])
def test_import_of_termite_pairs_cut_from_three_to_one_body_length(
    as_recorded: bool, data_dir: Path
) -> None:
    path = data_dir / "termite_tandem" / "tracks_30fps_int16.npz"
    counts = {}
    for kind, body in (("Cf", 8.89), ("Rs", 5.5)):
        recipe = default_recipe(get_reader("termites"), options={"kind": kind}).to_dict()
        radius = 72.5  # of the dish [mm]
        recipe["scaling"] |= {"width": 2 * radius, "boundary": 2.0}  # a jump leads out of the dish
        recipe["cutting"] |= {
            "mode": "approach", "farther_than": 3 * body / radius, "closer_than": body / radius,
        }  # fmt: skip
        if as_recorded:
            recipe |= {"decision_rate": None, "cleaning": {}}
        demos = follow(ImportRecipe.from_dict(recipe), [path])
        counts[kind] = demos.num_episodes
        assert demos.roles == ("pursuer", "target") and demos.individuals == ("male", "female")
    # Two approaches lead through frames in which a termite was lost: held for 28, or at (0, 0).
    assert counts == ({"Cf": 80, "Rs": 58} if as_recorded else {"Cf": 73, "Rs": 57})


@pytest.mark.realdata
def test_import_of_the_sleap_clip_agrees_with_its_plain_array(data_dir: Path) -> None:
    folder = data_dir / "fly_courtship_sleapclip"
    (tracks,) = read_tracks(folder / "clip.2node.slp")
    with np.load(folder / "clip_2node_tracks.npz") as plain:
        np.testing.assert_array_equal(tracks.positions, plain["xy"].astype(np.float64))
        assert list(tracks.individuals) == plain["tracks"].tolist()


@pytest.mark.realdata
def test_a_shorter_last_interval_makes_no_slower_animal(moths: Demonstrations) -> None:
    """The last frame of a search is kept although it falls between decisions."""
    interval, last = moths.intervals(), moths.offsets[1:] - 1
    assert (interval[last] < moths.dt).mean() > 0.5
    assert np.allclose(np.delete(interval, last), moths.dt)
    moved = np.linalg.norm(moths.positions[last, 0] - moths.positions[last - 1, 0], axis=1)
    speed = np.linalg.norm(moths.velocities()[last, 0], axis=1)
    np.testing.assert_allclose(speed, moved / interval[last])
    assert speed[0] == np.linalg.norm(moths.episode(0).velocities[-1])
    fewer = (interval[last] < 0.999 * moths.dt).sum()
    assert len(transitions(moths, 0)) == (moths.lengths - 1).sum() - fewer
