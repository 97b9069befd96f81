"""Readers: known answers on files written in each layout.

What is read of every layout, number for number, is in the golden table of files.
"""

from pathlib import Path

import numpy as np
import pytest
from refusals import refuses

from animarl_envs.importing.readers import available_readers, find_reader, follow, read, read_tracks
from tools.fuzz.layouts import (
    BODIES,
    KINDS,
    NAMES,
    NODES,
    POSE,
    agents_arrays,
    write_agents,
    write_authors_agents,
    write_fly_groups,
    write_mothvr,
    write_slp,
    write_termites,
    write_trex,
)

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


def test_trex_files_of_one_video_become_one_recording(tmp_path: Path) -> None:
    from animarl_envs.importing.import_recipe import ImportRecipe

    write_trex(tmp_path)
    files = sorted(tmp_path.glob("video_fish*.npz"))
    demos = follow(ImportRecipe(target="fish1"), files)
    assert demos.individuals == ("fish0", "fish1") and demos.dt == pytest.approx(0.04)
    assert demos.recording.tolist() == ["video"]


def test_agents_reader(tmp_path: Path) -> None:
    demos, arrays = read(write_agents(tmp_path)), agents_arrays()
    np.testing.assert_array_equal(demos.positions, arrays["pos"].astype(np.float64))
    assert demos.lengths.tolist() == [6, 4, 10] and (demos.condition == 1).all()
    assert demos.outcome.tolist() == [1, -1, 0] and (demos.initial_velocity == 0).all()
    recorded = demos.signals["actions"]
    np.testing.assert_array_equal(recorded[recorded[:, 0] >= 0], arrays["actions"])
    assert (recorded[[5, 9, 19]] == -1).all()


def test_silkmoth_runs(tmp_path: Path) -> None:
    demos = read(write_mothvr(tmp_path))
    assert demos.outcome.tolist() == [1] and demos.dt == 0.5
    # 91 frames: 0, 15, ..., 90; the first only makes the first velocity.
    np.testing.assert_allclose(demos.positions[:, 0, 0], 0.3 - 0.25 * np.arange(15, 91, 15) / 90)
    assert demos.signals["odour_left"].all()  # a step of 15 frames, of which every fourth is hit
    assert demos.signals["wind"].tolist() == [t // 4 % 4 for t in range(15, 91, 15)]


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


def test_authors_agents(tmp_path: Path) -> None:
    demos = read(write_authors_agents(tmp_path))
    assert demos.num_episodes == 2 and (demos.condition == 1).all()
    assert demos.individuals == ("predator_0", "predator_1", "prey")
    prey = BODIES[1:, 0] / 200
    np.testing.assert_allclose(demos.episode(0).positions[:, 2], prey)  # first in the file
    np.testing.assert_allclose(demos.episode(0).positions[:, 0], prey + 0.1)


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


def test_termites_reader_returns_millimetres_male_first(tmp_path: Path) -> None:
    (tracks,) = read_tracks(write_termites(tmp_path))
    assert tracks.individuals == ("male", "female") and tracks.unit == "mm"
    np.testing.assert_allclose(tracks.bodies, BODIES * 0.45, atol=0.45 * 0.01)  # rounding in px
    assert tracks.frame_rate == 30.0 and tracks.y_down
    refuses("choose Cf or Rs", read_tracks, write_termites(tmp_path), kind="Rs")


def test_fly_groups_reader_returns_arena_units(tmp_path: Path) -> None:
    (tracks,) = read_tracks(write_fly_groups(tmp_path))
    assert tracks.recording == "CsCh_1" and tracks.individuals == ("fly_1", "fly_2")
    np.testing.assert_allclose(tracks.bodies, BODIES, atol=0.005)
    demos = read(write_fly_groups(tmp_path), target="fly_2")
    assert demos.arena.shape == "disc" and demos.dt == pytest.approx(1 / 12)


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


def test_wide_tables_are_mapped_by_options(tmp_path: Path) -> None:
    lines = [f"{t / 50},{x!r},{y!r}" for t, (x, y) in enumerate(BODIES[:, 0].tolist())]
    (tmp_path / "wide.csv").write_text("t,mx,my\n" + "\n".join(lines) + "\n")
    (tracks,) = read_tracks(
        tmp_path / "wide.csv", "wide-table", columns={"male": ["mx", "my"]}, time="t"
    )
    assert tracks.individuals == ("male",) and tracks.frame_rate == 50.0
    np.testing.assert_array_equal(tracks.bodies[:, 0], BODIES[:, 0])
    (tmp_path / "lone.csv").write_text("x,y\n1,2\n3,4\n")
    (lone,) = read_tracks(tmp_path / "lone.csv")
    assert lone.individuals == ("individual_0",) and lone.bodies[1, 0].tolist() == [3.0, 4.0]


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
