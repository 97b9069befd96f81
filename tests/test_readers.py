"""Readers: known answers on files written in each layout; whatever is damaged is refused."""

from __future__ import annotations

import io
import json
import os
import pickle
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from animarl_envs.arena import Arena
from animarl_envs.demos import Demonstrations
from animarl_envs.demos.readers import available_readers, find_reader, read, read_tracks
from animarl_envs.demos.readers.unpickle import load_object_npy, load_plain
from animarl_envs.errors import InputError

BODIES = np.cumsum(np.random.default_rng(0).normal(0, 1.0, (40, 2, 2)), axis=0) + [
    [50, 50],
    [70, 60],
]
POSE = BODIES[:, :, None] + np.array([[0.0, 0.0], [2.0, -1.0]])  # (frames, individuals, nodes, 2)
NAMES, NODES = ("male", "female"), ("head", "thorax")


def write_native(folder: Path) -> Path:
    recording = np.array(["a", "b", "c"])
    demos = Demonstrations(
        species="custom", individuals=NAMES, roles=("pursuer", "target"), dt=0.1,
        arena=Arena("open"), positions=BODIES[:36], lengths=np.full(3, 12),
        initial_velocity=np.zeros((3, 2, 2)), condition=np.zeros(3, np.int8),
        outcome=np.zeros(3, np.int8), split=np.array(["train", "val", "test"]),
        recording=recording,
        provenance={"source": "test", "licence": "none", "synthetic": True},
    )  # fmt: skip
    return demos.save(folder / "demos.npz")


def agents_arrays() -> dict[str, NDArray[Any]]:
    steps = np.array([5, 3, 9], dtype=np.int16)
    rng = np.random.default_rng(1)
    meta = {"cond": "c2ae/reward_share", "dt": 0.1, "damping": 0.25}
    return {
        "pos": rng.uniform(-0.9, 0.9, (int((steps + 1).sum()), 3, 2)).astype(np.float32),
        "actions": rng.integers(13, size=(int(steps.sum()), 3)).astype(np.int8),
        "n_steps": steps,
        "outcome": np.array([1, -1, 0], dtype=np.int8),
        "meta": np.array(json.dumps(meta)),
    }


def write_agents(folder: Path) -> Path:
    np.savez(folder / "episodes.npz", **agents_arrays())  # type: ignore[arg-type]
    return folder / "episodes.npz"


def write_slp(folder: Path) -> Path:
    import sleap_io as sio

    skeleton = sio.Skeleton(list(NODES))
    tracks = [sio.Track(name) for name in NAMES]
    video = sio.Video("clip.mp4", open_backend=False)
    frames = [
        sio.LabeledFrame(
            video=video, frame_idx=t,
            instances=[
                sio.Instance.from_numpy(POSE[t, i], skeleton=skeleton, track=tracks[i])
                for i in range(2)
            ],
        )
        for t in range(len(POSE))
    ]  # fmt: skip
    labels = sio.Labels(frames, videos=[video], skeletons=[skeleton], tracks=tracks)
    labels.save(str(folder / "clip.slp"), verbose=False)
    return folder / "clip.slp"


def write_analysis(folder: Path) -> Path:
    import h5py

    with h5py.File(folder / "clip.analysis.h5", "w") as file:
        file["tracks"] = POSE.transpose(1, 3, 2, 0)
        file["track_names"] = [name.encode() for name in NAMES]
        file["node_names"] = [name.encode() for name in NODES]
        file["point_scores"] = np.ones(POSE.shape[:3]).transpose(1, 2, 0)
    return folder / "clip.analysis.h5"


def dlc_frame() -> Any:
    import pandas as pd

    columns = pd.MultiIndex.from_tuples(
        [("net", a, n, c) for a in NAMES for n in NODES for c in ("x", "y", "likelihood")],
        names=["scorer", "individuals", "bodyparts", "coords"],
    )
    likely = np.full((*POSE.shape[:3], 1), 0.9)
    return pd.DataFrame(
        np.concatenate([POSE, likely], axis=3).reshape(len(POSE), -1), columns=columns
    )


def write_dlc_csv(folder: Path) -> Path:
    dlc_frame().to_csv(folder / "dlc.csv")
    return folder / "dlc.csv"


def write_dlc_h5(folder: Path) -> Path:
    path = folder / "dlc.h5"
    dlc_frame().to_hdf(path, key="df_with_missing", format="table", mode="w")
    return path


def write_long(folder: Path) -> Path:
    rows = ["frame,id,x,y"]
    for t in range(len(BODIES)):
        rows += [f"{t},{n},{BODIES[t, i, 0]!r},{BODIES[t, i, 1]!r}" for i, n in enumerate(NAMES)]
    (folder / "long.csv").write_text("\n".join(rows).replace("np.float64(", "").replace(")", ""))
    return folder / "long.csv"


def write_wide(folder: Path) -> Path:
    import pandas as pd

    frame = pd.DataFrame(
        BODIES.reshape(-1, 4), columns=["x_male", "y_male", "x_female", "y_female"]
    )
    frame.to_csv(folder / "wide.csv", index=False)
    return folder / "wide.csv"


def write_npy(folder: Path) -> Path:
    np.save(folder / "bodies.npy", BODIES)
    return folder / "bodies.npy"


def write_mat(folder: Path) -> Path:
    from scipy.io import savemat

    savemat(folder / "bodies.mat", {"bodies": BODIES})
    return folder / "bodies.mat"


def write_mat73(folder: Path) -> Path:
    import h5py

    with h5py.File(folder / "new.mat", "w", userblock_size=512) as file:
        file["bodies"] = BODIES.T  # MATLAB's order
    return folder / "new.mat"


def write_trex(folder: Path) -> Path:
    for i in range(2):
        arrays: dict[str, Any] = {
            "X#wcentroid": BODIES[:, i, 0],
            "Y#wcentroid": BODIES[:, i, 1],
            "frame": np.arange(len(BODIES)),
            "frame_rate": np.array(25.0),
        }
        np.savez(folder / f"video_fish{i}.npz", **arrays)
    return folder / "video_fish0.npz"


def write_idtracker_npy(folder: Path) -> Path:
    content = {"trajectories": BODIES, "frames_per_second": 25.0, "version": "5.2", "setup": None}
    np.save(folder / "trajectories.npy", np.array(content), allow_pickle=True)
    return folder / "trajectories.npy"


def write_idtracker_h5(folder: Path) -> Path:
    import h5py

    with h5py.File(folder / "trajectories.h5", "w") as file:
        file["trajectories"] = BODIES
        file.attrs["frames_per_second"] = 25.0
    return folder / "trajectories.h5"


def write_idtracker_csv(folder: Path) -> Path:
    table = np.column_stack([np.arange(len(BODIES)) / 25.0, BODIES.reshape(-1, 4)])
    np.savetxt(
        folder / "trajectories.csv", table, delimiter=",", header="time,x1,y1,x2,y2", comments=""
    )
    return folder / "trajectories.csv"


def write_mothvr(folder: Path) -> Path:
    lines = ["Time,X,Y,Theta,Odor,Wind"]
    for t in range(91):
        x = 300 - 250.0 * t / 90
        lines.append(f"{t / 30},{x},1.0,3.1,{'NRLB'[t % 4]},{'FRLB'[t // 4 % 4]}")
    (folder / "case1.csv").write_text("\n".join(lines))
    return folder / "case1.csv"


def _objects(nested: Any, shape: tuple[int, ...]) -> NDArray[Any]:
    out = np.empty(shape, dtype=object)
    for index in np.ndindex(*shape):
        entry = nested
        for i in index:
            entry = entry[i]
        out[index] = entry
    return out


def write_authors_agents(folder: Path) -> Path:
    scaled = BODIES / 200
    lists = [
        [[tuple(p) for p in (scaled[:, 0] + 0.1 * k).tolist()] for k in range(3)] for _ in range(2)
    ]
    lists.append([[(0.0, 0.1 * k)] for k in range(3)])  # one frame: left out
    path = folder / "pos_val_rep_2on1_share_equal_K_0.npz"
    np.savez(path, pos=_objects(lists, (3, 3))[None], allow_pickle=True)
    with zipfile.ZipFile(path) as archive:
        raw = archive.read("pos.npy")
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("pos.npy", raw)
    return path


def write_authors_fly(folder: Path) -> Path:
    body = np.concatenate([BODIES, BODIES], axis=2)[:, :1] / 200  # (frames, 1, 4)
    states = [[body + 0.1 * k, body[:4] + 0.1 * k] for k in range(3)]
    rewards = [[np.array([0.0, float(k == 1)]), np.zeros(2)] for k in range(3)]
    arrays = {
        "states": _objects(states, (3, 2)), "actions": _objects(rewards, (3, 2)),
        "rewards": _objects(rewards, (3, 2)),
    }  # fmt: skip
    path = folder / "data.npz"
    np.savez(path, **arrays)  # type: ignore[arg-type]
    return path


def write_authors_newt(folder: Path) -> Path:
    rng = np.random.default_rng(3)
    smooth = np.cumsum(rng.normal(0, 1e-3, (2000, 3, 2)), axis=0) + [[0.1, 0], [0.3, 0], [-0.3, 0]]
    episode = np.zeros((2000, 6, 2))
    episode[:, ::2] = smooth
    early, late = episode[:300].copy(), episode[:300].copy()
    early[:50] += 5.0
    late[200:] += 5.0
    np.savez(
        folder / "state_m1_data0.npz",
        ep0=episode,
        ep1=early,
        ep2=late,
        ep3=episode[:44],
    )
    for name, won in (("m1", 0.0), ("m2", 1.0)):
        arrays = {f"ep{i}": np.array([0, won]) for i in range(4)}
        np.savez(folder / f"reward_{name}_data0.npz", **arrays)  # type: ignore[arg-type]
    return folder / "state_m1_data0.npz"


def write_authors_silkmoth(folder: Path) -> Path:
    place = folder / "Odoronly" / "Movie2"
    place.mkdir(parents=True, exist_ok=True)
    table = np.zeros((61, 8))
    table[:, 0], table[:, 1] = np.arange(61) / 30, 300 - np.arange(61)
    table[::2, 4], table[:, 7] = 1, 3
    np.savetxt(place / "trial1_mod.csv", table, delimiter=",")
    return place / "trial1_mod.csv"


Writer = Callable[[Path], Path]
PLAIN: dict[str, tuple[Writer, str]] = {  # two individuals, BODIES
    "long": (write_long, "long-table"), "wide": (write_wide, "wide-table"),
    "npy": (write_npy, "numpy"), "mat": (write_mat, "matlab"), "mat73": (write_mat73, "matlab"),
    "idtracker_npy": (write_idtracker_npy, "idtracker"),
    "idtracker_h5": (write_idtracker_h5, "idtracker"),
    "idtracker_csv": (write_idtracker_csv, "idtracker"),
}  # fmt: skip
POSES: dict[str, tuple[Writer, str]] = {
    "slp": (write_slp, "sleap"), "analysis": (write_analysis, "sleap"),
    "dlc_csv": (write_dlc_csv, "deeplabcut"), "dlc_h5": (write_dlc_h5, "deeplabcut"),
}  # fmt: skip
OTHERS: dict[str, tuple[Writer, str]] = {
    "native": (write_native, "animarl"), "agents": (write_agents, "agents"),
    "trex": (write_trex, "trex"), "mothvr": (write_mothvr, "mothvr"),
    "authors_agents": (write_authors_agents, "authors-agents"),
    "authors_fly": (write_authors_fly, "authors-fly"),
    "authors_newt": (write_authors_newt, "authors-newt"),
    "authors_silkmoth": (write_authors_silkmoth, "authors-silkmoth"),
}  # fmt: skip
ALL = PLAIN | POSES | OTHERS


@pytest.mark.parametrize("kind", ALL)
def test_the_reader_is_found_by_a_look_at_the_file(kind: str, tmp_path: Path) -> None:
    write, source = ALL[kind]
    assert find_reader(write(tmp_path)).name == source


@pytest.mark.parametrize("kind", PLAIN)
def test_reader_of_bodies_returns_the_positions_written(kind: str, tmp_path: Path) -> None:
    (tracks,) = read_tracks(PLAIN[kind][0](tmp_path))
    np.testing.assert_allclose(np.sort(tracks.bodies, axis=1), np.sort(BODIES, axis=1), rtol=1e-12)
    if kind.startswith("idtracker"):
        assert tracks.frame_rate == pytest.approx(25.0)


@pytest.mark.parametrize("kind", POSES)
def test_reader_of_poses_returns_every_keypoint(kind: str, tmp_path: Path) -> None:
    (tracks,) = read_tracks(POSES[kind][0](tmp_path))
    assert tracks.individuals == NAMES and tracks.keypoints == NODES
    np.testing.assert_allclose(tracks.positions, POSE, rtol=1e-6)
    assert tracks.y_down


def test_reader_of_deeplabcut_keeps_likelihood_and_single_animals(tmp_path: Path) -> None:
    (tracks,) = read_tracks(write_dlc_csv(tmp_path))
    assert tracks.confidence is not None and (tracks.confidence == 0.9).all()
    single = dlc_frame()["net"]["male"]
    lines = [
        "scorer," + ",".join(["net"] * 6),
        "bodyparts," + ",".join(part for part, _ in single.columns),
        "coords," + ",".join(coordinate for _, coordinate in single.columns),
        *(f"{t}," + ",".join(map(repr, row)) for t, row in enumerate(single.to_numpy().tolist())),
    ]
    (tmp_path / "single.csv").write_text("\n".join(lines))
    (alone,) = read_tracks(tmp_path / "single.csv")
    np.testing.assert_allclose(alone.positions[:, 0], POSE[:, 0])


def test_movement_agrees_with_our_own_reader(tmp_path: Path) -> None:
    pytest.importorskip("movement")
    path = write_dlc_csv(tmp_path)
    (theirs,) = read_tracks(path, "movement", software="DeepLabCut", fps=25.0)
    (ours,) = read_tracks(path)
    assert theirs.individuals == ours.individuals and theirs.keypoints == ours.keypoints
    np.testing.assert_allclose(theirs.positions, ours.positions)


def test_trex_files_of_one_video_become_one_recording(tmp_path: Path) -> None:
    from animarl_envs.demos.following import follow
    from animarl_envs.demos.recipe import Recipe

    write_trex(tmp_path)
    files = sorted(tmp_path.glob("video_fish*.npz"))
    demos = follow(Recipe(target="fish1"), files)
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
    assert demos.signals["odour_left"].tolist() == [t % 4 in (2, 3) for t in range(15, 91, 15)]


def test_silkmoth_keeps_the_final_frame(tmp_path: Path) -> None:
    path = write_mothvr(tmp_path)
    path.write_text("\n".join(path.read_text().splitlines()[:-3]))
    assert read(path).positions[-1, 0, 0] == pytest.approx(0.3 - 0.25 * 87 / 90)


def test_authors_agents(tmp_path: Path) -> None:
    demos = read(write_authors_agents(tmp_path))
    assert demos.num_episodes == 2 and (demos.condition == 1).all()
    assert demos.individuals == ("predator_0", "predator_1", "prey")
    prey = BODIES[1:, 0] / 200
    np.testing.assert_allclose(demos.episode(0).positions[:, 2], prey)  # first in the file
    np.testing.assert_allclose(demos.episode(0).positions[:, 0], prey + 0.1)


def test_authors_flies_are_smoothed_and_thinned(tmp_path: Path) -> None:
    demos = read(write_authors_fly(tmp_path))
    assert demos.num_episodes == 1 and demos.outcome.tolist() == [2]
    assert demos.lengths.tolist() == [13] and demos.dt == pytest.approx(0.1)


def test_authors_newts_are_cut_as_in_the_paper(tmp_path: Path) -> None:
    demos = read(write_authors_newt(tmp_path))
    # The long one keeps its last 500 steps (less the first sample), the one with an early jump
    # starts behind it, a later jump and a short episode are dropped.
    assert demos.lengths.tolist() == [500, 83] and demos.outcome.tolist() == [2, 2]


def test_authors_silkmoths_carry_condition_and_plume(tmp_path: Path) -> None:
    demos = read(write_authors_silkmoth(tmp_path))
    assert demos.condition.tolist() == [1] and demos.outcome.tolist() == [1]
    assert demos.recording.tolist() == ["Odoronly/Movie2/trial1_mod"]


# -- bad input -----------------------------------------------------------------------------------


def _spoilt(tmp_path: Path, **changes: Any) -> Path:
    arrays = agents_arrays() | changes
    np.savez(tmp_path / "bad.npz", **arrays)
    return tmp_path / "bad.npz"


def _gap(arrays: dict[str, NDArray[Any]]) -> NDArray[Any]:
    pos = arrays["pos"].copy()
    pos[8, 1] = np.nan
    return pos


BAD_AGENTS: dict[str, tuple[Callable[[dict[str, NDArray[Any]]], dict[str, Any]], str]] = {
    "gap": (lambda a: {"pos": _gap(a)}, r"episode 1, frame 2, predator_1.*fill the gap"),
    "lengths": (lambda a: {"pos": a["pos"][:-1]}, r"pos has 19 frames, n_steps ask for 20"),
    "one frame": (lambda a: {"n_steps": np.array([0, 8, 9])}, r"episode 0 has no step"),
    "no frames": (
        lambda a: {k: a[k][:0] for k in ("pos", "actions", "n_steps", "outcome")}, "no step",
    ),
    "individuals": (lambda a: {"pos": a["pos"][:, :1]}, r"two individuals or more"),
    "dt": (lambda a: {"meta": np.array('{"cond": "x_share", "dt": 0}')}, r"dt is 0.0 s"),
    "outside": (lambda a: {"pos": a["pos"] * 100}, r"lies outside the arena.*scale the tracks"),
    "twice": (lambda a: {"pos": a["pos"][:, [0, 0, 2]]}, r"same track: drop the duplicate"),
    "meta": (lambda a: {"meta": np.array("x")}, r"meta is not the JSON"),
    "action": (lambda a: {"actions": a["actions"] + 5}, r"outside 0 to 12"),
    "pickle": (lambda a: {"pos": np.array([{"a": 1}], dtype=object)}, r"pickle|object"),
}  # fmt: skip


@pytest.mark.parametrize("kind", BAD_AGENTS)
def test_agents_reader_refuses(kind: str, tmp_path: Path) -> None:
    changes, message = BAD_AGENTS[kind]
    path = _spoilt(tmp_path, **changes(agents_arrays()))
    with pytest.raises(InputError, match=message) as caught:
        read(path, "agents")
    assert str(path) in str(caught.value) and "\n" not in str(caught.value)


def test_readers_refuse_text_truncation_folders_and_absence(tmp_path: Path) -> None:
    (tmp_path / "text.npz").write_text("not an archive")
    whole = write_native(tmp_path)
    (tmp_path / "cut.npz").write_bytes(whole.read_bytes()[:-200])
    for name in ("text.npz", "cut.npz"):
        for source in (None, "animarl", "agents", "numpy", "trex"):
            with pytest.raises(InputError, match=name):
                read(tmp_path / name, source)
    with pytest.raises(InputError, match="no such file"):
        read(tmp_path / "absent.npz")
    with pytest.raises(InputError):
        read(tmp_path, "animarl")
    with pytest.raises(InputError, match="source 'nonsense' is unknown"):
        read(whole, "nonsense")
    with pytest.raises(InputError, match="holds no episode"):
        read(whole).select(split="train", condition=1)


def test_readers_refuse_headers_that_ask_for_too_much(tmp_path: Path) -> None:
    buffer = io.BytesIO()
    np.lib.format.write_array_header_1_0(
        buffer, {"descr": "<f8", "fortran_order": False, "shape": (10**12, 3, 2)}
    )
    (tmp_path / "huge.npy").write_bytes(buffer.getvalue() + bytes(64))
    with pytest.raises(InputError, match="announces"):
        read_tracks(tmp_path / "huge.npy", "numpy")
    with zipfile.ZipFile(tmp_path / "huge.npz", "w") as archive:
        archive.writestr("a.npy", buffer.getvalue() + bytes(64))
    with pytest.raises(InputError, match="announces"):
        read_tracks(tmp_path / "huge.npz", "numpy")
    with zipfile.ZipFile(tmp_path / "bomb.npz", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("a.npy", bytes(200 * 2**20))
    with pytest.raises(InputError, match="more than 64 times"):
        read_tracks(tmp_path / "bomb.npz", "numpy")
    (tmp_path / "far.csv").write_text("frame,id,x,y\n0,a,0,0\n2000000000,a,1,1\n")
    with pytest.raises(InputError, match="more than 64 times"):
        read_tracks(tmp_path / "far.csv", "long-table")


@pytest.mark.parametrize("protocol", range(6))
def test_only_plain_objects_are_unpickled(protocol: int, tmp_path: Path) -> None:
    plain = {"a": [1, (2.5, "x")], "b": np.arange(6.0).reshape(2, 3), "c": np.float64(2.0)}
    found = load_plain(pickle.dumps(plain, protocol=protocol), "file")
    np.testing.assert_array_equal(found["b"], plain["b"])
    assert found["a"] == [1, (2.5, "x")] and found["c"] == 2.0
    for hostile in (os.system, Path("x"), Arena(), io.StringIO("x")):
        with pytest.raises(InputError, match="pickle that is damaged or not of numbers and lists"):
            load_plain(pickle.dumps({"a": hostile}, protocol=max(protocol, 2)), "file")


class _Allocates:
    def __reduce__(self) -> tuple[Any, ...]:
        return np.ndarray, ((10**12,),)


def test_unpickling_calls_no_constructor_that_allocates() -> None:
    with pytest.raises(InputError, match="pickle"):
        load_plain(pickle.dumps(_Allocates()), "file")
    many = b"\x80\x05\x96" + (2**40).to_bytes(8, "little") + b"."
    with pytest.raises(InputError, match="pickle"):
        load_plain(many, "file")


def test_a_pickle_that_repeats_itself_is_refused(tmp_path: Path) -> None:
    laugh: list[Any] = [0.0]
    for _ in range(30):
        laugh = [laugh] * 10
    path = tmp_path / "pos_val_rep_2on1_indiv_equal_K_0.npz"
    buffer = io.BytesIO()
    np.lib.format.write_array_header_1_0(
        buffer, {"descr": "|O", "fortran_order": False, "shape": ()}
    )
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("pos.npy", buffer.getvalue() + pickle.dumps(laugh))
    with pytest.raises(InputError, match="repeats itself"):
        read(path)
    assert load_object_npy(buffer.getvalue() + pickle.dumps([1]), path) == [1]


BAD_TABLES = {
    "letters": ("frame,id,x,y\n0,a,1,2\n1,a,oops,2\n", "cannot be read"),
    "duplicate": ("frame,id,x,y\n0,a,1,2\n0,a,1,2\n", "frame 0, a has two rows"),
    "no rows": ("frame,id,x,y\n", "no rows"),
    "negative": ("frame,id,x,y\n-1,a,1,2\n", "frame numbers from 0"),
    "columns": ("frame,who,x,y\n0,a,1,2\n", "0 columns 'id'"),
}


@pytest.mark.parametrize("kind", BAD_TABLES)
def test_long_table_reader_refuses(kind: str, tmp_path: Path) -> None:
    text, message = BAD_TABLES[kind]
    (tmp_path / "bad.csv").write_text(text)
    with pytest.raises(InputError, match=message):
        read_tracks(tmp_path / "bad.csv", "long-table")


def test_a_frame_rate_is_asked_for_where_the_file_has_none(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="give it with --fps"):
        read(write_npy(tmp_path))


# -- fuzzing -------------------------------------------------------------------------------------


def _mutated(raw: bytes, rng: np.random.Generator) -> bytes:
    data = bytearray(raw)
    kind = rng.integers(5)
    if kind == 0:  # cut short
        return bytes(data[: rng.integers(len(data))])
    if kind == 1:  # a piece repeated
        start = int(rng.integers(len(data)))
        return bytes(data[:start] + data[start // 2 : start] + data[start:])
    if kind == 2:  # a piece lost
        start = int(rng.integers(len(data)))
        return bytes(data[:start] + data[start + int(rng.integers(1, 64)) :])
    count = 1 if kind == 3 else int(rng.integers(1, 40))
    near = len(data) if rng.random() < 0.5 else min(len(data), 512)  # headers lie at the start
    for place in rng.integers(near, size=count):
        data[place] = rng.integers(256)
    return bytes(data)


def _fuzz(kind: str, folder: Path, count: int) -> int:
    write, source = ALL[kind]
    path = write(folder)
    raw, refused = path.read_bytes(), 0
    rng = np.random.default_rng(sum(kind.encode()))
    for _ in range(count):
        path.write_bytes(_mutated(raw, rng))
        try:
            options = {} if source in ("animarl", "agents") else {"frame_rate": 25.0}
            demos = read(path, source, **options)
        except InputError as error:
            assert "\n" not in str(error)
            refused += 1
        else:
            assert np.isfinite(demos.positions).all() and (demos.lengths >= 2).all()
            assert demos.positions.nbytes <= 64 * len(raw) + 16 * 2**20
    return refused


@pytest.mark.parametrize("kind", ALL)
def test_readers_never_crash_on_damaged_files(kind: str, tmp_path: Path) -> None:
    assert _fuzz(kind, tmp_path, 10) > 0


@pytest.mark.slow
@pytest.mark.parametrize("kind", ALL)
def test_readers_never_crash_on_many_damaged_files(kind: str, tmp_path: Path) -> None:
    assert _fuzz(kind, tmp_path, 110) > 0


def test_every_reader_is_fuzzed_or_named_here() -> None:
    covered = {source for _, source in ALL.values()}
    elsewhere = {"movement", "minari", "termites", "fly-groups"}
    assert {reader.name for reader in available_readers()} == covered | elsewhere
